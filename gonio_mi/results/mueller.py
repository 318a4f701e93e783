"""Mueller matrices of one incident direction, with their uncertainties."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..array_types import Flags, Floats
from ..errors import SettingError, shown
from ..single_precision import ROUNDING
from . import statistics
from .estimates import MIN_DEPOSITS, MIN_EVEN_HITS, MIN_HITS, SampledEstimates
from .tally import PolarisedTally, as_matrices

# How far the polarised part of a Stokes vector may exceed its first element: rounding.
STOKES_ROUNDING = 1e-9


def checked_stokes(stokes: object) -> Floats:
    """Stokes vector of real light, shape (4,).

    Raises
    ------
    ValueError
        If it is not four numbers, or light without power or too much polarised.
    """
    try:
        vector = np.array(stokes, dtype=float)
    except (TypeError, ValueError):
        vector = np.zeros(0)
    if vector.shape != (4,) or not np.isfinite(vector).all():
        raise SettingError(f"stokes must be four numbers I Q U V, got {shown(stokes)}")
    polarised = np.linalg.norm(vector[1:])
    if not vector[0] > 0 or polarised > vector[0] * (1 + STOKES_ROUNDING):
        raise SettingError(
            "stokes must be light, with I above 0 and Q^2 + U^2 + V^2 at most I^2, got "
            f"{shown(stokes)}"
        )
    return vector


@dataclass(frozen=True, eq=False)
class MuellerEstimates:
    """Estimates of all elements, of which the first is that of the `light`.

    Hemisphere 0 is the emitter's side. Matrices of its patches have the shape
    ``(n_theta, n_phi, channels, 4, 4)``, those of its total ``(channels, 4, 4)``.

    Attributes
    ----------
    tally : PolarisedTally
    light : SampledEstimates
        Of the first elements.
    """

    tally: PolarisedTally
    light: SampledEstimates

    def fraction(self, hemisphere: int) -> Floats:
        """Flux fractions of each patch."""
        return statistics.ratio(self.tally.matrices(hemisphere), self._incident)

    def std_err(self, hemisphere: int) -> Floats:
        """Standard errors of :meth:`fraction`; NaN where no ray carried anything.

        From the scatter of the batches; where a patch is `pooled`, at least that of
        the first element.
        """
        first = self.light.std_err(hemisphere)
        least = np.where(self.light.pooled(hemisphere), first, 0.0)
        found = np.fmax(self._scatter(hemisphere), least[..., None, None])
        found[np.isnan(first)] = np.nan
        return _with_first(found, first)

    def total(self, hemisphere: int) -> Floats:
        """Flux fraction of all patches together."""
        return statistics.ratio(self._sum(hemisphere), self._incident[:, 0, 0])

    def total_std_err(self, hemisphere: int) -> Floats:
        """Standard errors of :meth:`total`, from the batches."""
        return self._batch_std_err(self._sum(hemisphere), self._incident[:, 0, 0])

    def interval(self, hemisphere: int, level: float) -> tuple[Floats, Floats]:
        """Limits of :meth:`fraction`.

        By Student's t over the batches, but where few rays came, or where a patch is
        `pooled`: half the sum and half the difference of the first element and another
        are fluxes without a sign, which have limits like the first one, and the
        differences of these limit the other element.
        """
        hits = self.light.hits[hemisphere][..., None]
        low, high = self._student(
            self.fraction(hemisphere), self._scatter(hemisphere), hits, level
        )
        few = self._few(hemisphere) | self.light.pooled(hemisphere)
        if few.any():
            (low_sum, high_sum), (low_rest, high_rest) = (
                self._half_limits(hemisphere, (1 + level) / 2, sign) for sign in (1, -1)
            )
            few = few[..., None, None]
            low = np.where(few, low_sum - high_rest, low)
            high = np.where(few, high_sum - low_rest, high)
        least, most = self.light.interval(hemisphere, level)
        return _with_first(low, least), _with_first(high, most)

    def total_interval(self, hemisphere: int, level: float) -> tuple[Floats, Floats]:
        """Limits of :meth:`total`, by Student's t."""
        value, std_err = self.total(hemisphere), self.total_std_err(hemisphere)
        hits = self.light.hits[hemisphere].sum()
        low, high = self._student(value, std_err, hits, level)
        least, most = self.light.total_interval(hemisphere, level)
        return _with_first(low, least), _with_first(high, most)

    def stokes(
        self, hemisphere: int, vector: Floats, total: bool = False
    ) -> tuple[Floats, Floats]:
        """Stokes vectors for incident light, and their standard errors.

        Of each patch, ``(n_theta, n_phi, channels, 4)``, or of the `total`,
        ``(channels, 4)``; the errors of the elements, which are not independent, are in
        the batches.
        """
        sums, incident = self._stokes(hemisphere, vector, total), self._incident[..., 0]
        if total:
            incident = incident[:, 0, 0]
        std_err = self._batch_std_err(sums, incident)
        if not total:
            std_err[self.light.dark(hemisphere)] = np.nan
        return statistics.ratio(sums, incident), std_err

    def normalised_stokes(
        self, hemisphere: int, vector: Floats, total: bool = False
    ) -> tuple[Floats, Floats]:
        """Q / I, U / I and V / I as of :meth:`stokes`, and their standard errors.

        Of the shape ``(n_theta, n_phi, channels, 3)``, or of the `total`
        ``(channels, 3)``; NaN without light.
        """
        stokes = self._stokes(hemisphere, vector, total)
        light, polarised = stokes[..., :1], stokes[..., 1:]
        error = statistics.batch_std_err(polarised, light)
        return statistics.ratio(polarised, light), error

    def degree(
        self, hemisphere: int, vector: Floats, total: bool = False
    ) -> tuple[Floats, Floats]:
        """Degrees of polarisation as of :meth:`stokes`, and their standard errors.

        Of each patch, ``(n_theta, n_phi, channels)``, or of the `total`,
        ``(channels,)``; NaN without light, and errors for too few hits.
        """
        stokes = self._stokes(hemisphere, vector, total)
        light, polarised = stokes[..., 0], stokes[..., 1:]
        sums = polarised.sum(axis=0)
        length = np.linalg.norm(sums, axis=-1, keepdims=True)
        # to first order the degree changes with what is parallel to the sum alone
        axis = np.divide(sums, length, out=np.zeros(sums.shape), where=length > 0)
        parallel = np.sum(polarised * axis, axis=-1)
        error = statistics.batch_std_err(parallel, light)
        if not total:
            error = np.where(self._few(hemisphere), np.nan, error)
        return statistics.ratio(parallel, light), error

    def degree_interval(
        self, hemisphere: int, vector: Floats, level: float
    ) -> tuple[Floats, Floats]:
        """Limits of :meth:`degree` of each patch, by Student's t; 0 and 1 for few hits.

        Noise alone has a degree too: the lower one is 0 unless one of Q, U and V has
        limits on one side of 0 (Bonferroni).
        """
        n = self.light.n_batches
        value, std_err = self.degree(hemisphere, vector)
        low, high = statistics.student_interval(value, std_err, n, level)
        parts, errors = self.normalised_stokes(hemisphere, vector)
        of_each = 1 - (1 - level) / parts.shape[-1]
        n = np.asarray(n)[..., None]
        least, most = statistics.student_interval(parts, errors, n, of_each)
        may_be_0 = ((least <= 0) & (most >= 0)).all(axis=-1)
        few = self._few(hemisphere)
        return np.where(may_be_0 | few, 0, low), np.where(few, 1, np.minimum(high, 1))

    def _few(self, hemisphere: int) -> Flags:
        """Patches with too few hits for Student's t, ``(n_theta, n_phi, 1)``."""
        enough = MIN_HITS if self.light.independent else MIN_EVEN_HITS
        enough = MIN_DEPOSITS if self.light.deposited else enough
        found: Flags = self.light.hits[hemisphere][..., None] < enough
        return found

    def _stokes(self, hemisphere: int, vector: Floats, total: bool) -> Floats:
        """Sums of Stokes vectors for incident light, per batch."""
        matrices = self._sum(hemisphere) if total else self.tally.matrices(hemisphere)
        found: Floats = matrices @ vector
        return found

    @property
    def _incident(self) -> Floats:
        """Incident flux per batch, broadcastable to matrices of one hemisphere."""
        return self.tally.incident[:, None, None, :, None, None].astype(float)

    def _sum(self, hemisphere: int) -> Floats:
        """Sums over the patches of one hemisphere, per batch."""
        found: Floats = self.tally.matrices(hemisphere).sum(axis=(1, 2))
        return found

    def _scatter(self, hemisphere: int) -> Floats:
        """Standard errors from the batches alone."""
        return self._batch_std_err(self.tally.matrices(hemisphere), self._incident)

    def _batch_std_err(self, sums: Floats, incident: Floats) -> Floats:
        """Standard errors of ratios, as of the `light`."""
        return statistics.batch_std_err(sums, incident, self.light.unlike_power)

    def _student(
        self, value: Floats, std_err: Floats, hits: Floats, level: float
    ) -> tuple[Floats, Floats]:
        """Limits by Student's t, which leaves open what too few rays show."""
        light = value[..., :1, :1]
        with np.errstate(divide="ignore", invalid="ignore"):
            weight = light * self.light.rays / np.asarray(hits)[..., None, None]
        unseen = statistics.upper_limit(self.light.rays, level) * weight
        least = np.fmax(unseen, ROUNDING * light)
        n = np.asarray(self.light.n_batches)[..., None, None]
        return statistics.student_interval(value, std_err, n, level, least, least)

    def _half_limits(self, hemisphere: int, level: float, sign: int) -> list[Floats]:
        """Limits of half the sums, or differences, of the first element and each."""
        halves = replace(self.light, tally=self.tally.halves(sign))
        limits = halves.interval(hemisphere, level)
        return [as_matrices(one.reshape(*one.shape[:2], 16, -1)) for one in limits]


def _with_first(matrices: Floats, first: Floats) -> Floats:
    """Matrices with other first elements."""
    matrices = matrices.copy()
    matrices[..., 0, 0] = first
    return matrices

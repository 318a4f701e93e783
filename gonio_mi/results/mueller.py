"""Mueller matrices of one incident direction, with their uncertainties."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..array_types import Floats
from ..errors import SettingError, shown
from ..single_precision import ROUNDING
from . import statistics
from .estimates import Estimate, Estimates
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
class MuellerEstimate:
    """All elements of sums over patches, of which the first is that of the `light`.

    Matrices have the shape ``(..., channels, 4, 4)``.

    Attributes
    ----------
    sums : ndarray, shape (n_batches, ..., channels, 4, 4)
    light : Estimate
        Of the first elements.
    halves : callable
        Returns the Estimate of half the sums (1) or differences (-1) of the first
        element and each: ``(..., 16 * channels)``.
    """

    sums: Floats
    light: Estimate
    halves: Callable[[int], Estimate]

    @property
    def value(self) -> Floats:
        """Flux fractions."""
        return statistics.ratio(self.sums, self._incident)

    @property
    def std_err(self) -> Floats:
        """Standard errors of `value`; NaN where no ray carried anything.

        From the scatter of the batches; where the light is `pooled`, at least that of
        the first element.
        """
        first = self.light.std_err
        least = np.where(self.light.pooled, first, 0.0)
        found = np.fmax(self._scatter, least[..., None, None])
        found[np.isnan(first)] = np.nan
        return _with_first(found, first)

    def interval(self, level: float) -> tuple[Floats, Floats]:
        """Limits of `value`.

        By Student's t over the batches, but where few rays came, or where the light is
        `pooled`: half the sum and half the difference of the first element and another
        are fluxes without a sign, which have limits like the first one, and the
        differences of these limit the other element.
        """
        low, high = self._student(level)
        few = self.light.few | self.light.pooled
        if few.any():
            (low_sum, high_sum), (low_rest, high_rest) = (
                self._half_limits((1 + level) / 2, sign) for sign in (1, -1)
            )
            few = few[..., None, None]
            low = np.where(few, low_sum - high_rest, low)
            high = np.where(few, high_sum - low_rest, high)
        least, most = self.light.interval(level)
        return _with_first(low, least), _with_first(high, most)

    def stokes(self, vector: Floats) -> tuple[Floats, Floats]:
        """Stokes vectors for incident light, ``(..., channels, 4)``, and their errors.

        The errors of the elements, which are not independent, are in the batches.
        """
        sums, incident = self.sums @ vector, self._incident[..., 0]
        std_err = self._batch_std_err(sums, incident)
        std_err[self.light.dark] = np.nan
        return statistics.ratio(sums, incident), std_err

    def normalised_stokes(self, vector: Floats) -> tuple[Floats, Floats]:
        """Q / I, U / I and V / I as of :meth:`stokes`, and their standard errors.

        Of the shape ``(..., channels, 3)``; NaN without light.
        """
        stokes = self.sums @ vector
        light, polarised = stokes[..., :1], stokes[..., 1:]
        error = statistics.batch_std_err(polarised, light)
        return statistics.ratio(polarised, light), error

    def degree(self, vector: Floats) -> tuple[Floats, Floats]:
        """Degrees of polarisation as of :meth:`stokes`, and their standard errors.

        Of the shape ``(..., channels)``; NaN without light, and errors for too few
        hits.
        """
        stokes = self.sums @ vector
        light, polarised = stokes[..., 0], stokes[..., 1:]
        sums = polarised.sum(axis=0)
        length = np.linalg.norm(sums, axis=-1, keepdims=True)
        # to first order the degree changes with what is parallel to the sum alone
        axis = np.divide(sums, length, out=np.zeros(sums.shape), where=length > 0)
        parallel = np.sum(polarised * axis, axis=-1)
        error = statistics.batch_std_err(parallel, light)
        error = np.where(self.light.few, np.nan, error)
        return statistics.ratio(parallel, light), error

    def degree_interval(self, vector: Floats, level: float) -> tuple[Floats, Floats]:
        """Limits of :meth:`degree`, by Student's t; 0 and 1 for few hits.

        Noise alone has a degree too: the lower one is 0 unless one of Q, U and V has
        limits on one side of 0 (Bonferroni).
        """
        n = self.light.light.n_batches
        value, std_err = self.degree(vector)
        low, high = statistics.student_interval(value, std_err, n, level)
        parts, errors = self.normalised_stokes(vector)
        of_each = 1 - (1 - level) / parts.shape[-1]
        n = np.asarray(n)[..., None]
        least, most = statistics.student_interval(parts, errors, n, of_each)
        may_be_0 = ((least <= 0) & (most >= 0)).all(axis=-1)
        few = self.light.few | self.light.dark
        return np.where(may_be_0 | few, 0, low), np.where(few, 1, np.minimum(high, 1))

    @property
    def _incident(self) -> Floats:
        """Incident flux per batch, broadcastable to matrices."""
        shape = len(self.sums), *(1 for _ in self.sums.shape[1:-3])
        return self.light.incident.reshape(*shape, -1, 1, 1).astype(float)

    @property
    def _scatter(self) -> Floats:
        """Standard errors from the batches alone."""
        return self._batch_std_err(self.sums, self._incident)

    def _batch_std_err(self, sums: Floats, incident: Floats) -> Floats:
        """Standard errors of ratios, as of the `light`."""
        unlike = self.light.light.unlike_power
        return statistics.batch_std_err(sums, incident, unlike)

    def _student(self, level: float) -> tuple[Floats, Floats]:
        """Limits by Student's t, which leaves open what too few rays show."""
        rays = self.light.rays
        value, hits = self.value, np.asarray(self.light.hits)[..., None, None, None]
        light = value[..., :1, :1]
        with np.errstate(divide="ignore", invalid="ignore"):
            weight = light * rays / hits
        unseen = statistics.upper_limit(rays, level) * weight
        least = np.fmax(unseen, ROUNDING * light)
        n = np.asarray(self.light.light.n_batches)[..., None, None]
        return statistics.student_interval(value, self._scatter, n, level, least, least)

    def _half_limits(self, level: float, sign: int) -> list[Floats]:
        """Limits of half the sums, or differences, of the first element and each."""
        limits = self.halves(sign).interval(level)
        return [as_matrices(one.reshape(*one.shape[:-1], 16, -1)) for one in limits]


@dataclass(frozen=True, eq=False)
class MuellerEstimates:
    """Mueller matrices of one incident direction; hemisphere 0 is the emitter's side.

    Attributes
    ----------
    tally : PolarisedTally
    light : Estimates
        Of the first elements.
    """

    tally: PolarisedTally
    light: Estimates

    def patches(self, hemisphere: int) -> MuellerEstimate:
        """Matrices of each patch, ``(n_theta, n_phi, channels, 4, 4)``."""
        light = self.light.patches(hemisphere)
        sums = self.tally.matrices(hemisphere)
        return MuellerEstimate(
            sums, light, lambda sign: self._halves(sign).patches(hemisphere)
        )

    def total(self, hemisphere: int) -> MuellerEstimate:
        """Sums of the matrices of a hemisphere, ``(channels, 4, 4)``."""
        light = self.light.total(hemisphere)
        sums = self.tally.matrices(hemisphere).sum(axis=(1, 2))
        return MuellerEstimate(
            sums, light, lambda sign: self._halves(sign).total(hemisphere)
        )

    def _halves(self, sign: int) -> Estimates:
        return replace(self.light, tally=self.tally.halves(sign))


def _with_first(matrices: Floats, first: Floats) -> Floats:
    """Matrices with other first elements."""
    matrices = matrices.copy()
    matrices[..., 0, 0] = first
    return matrices

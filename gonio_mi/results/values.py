"""Values of a measurement with their uncertainties, derived from its tallies."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..array_types import Counts, Flags, Floats, Numbers
from ..collector import Subdivision
from ..errors import SettingError, checked_choice, checked_number
from ..settings import MeasurementSettings
from ..single_precision import ROUNDING
from . import statistics
from .estimates import (
    ControlledEstimate,
    Estimate,
    Estimates,
    IntegralEstimate,
    SampledEstimate,
    SplitEstimate,
)
from .mueller import MuellerEstimate, MuellerEstimates, checked_stokes
from .provenance import FACETS, Provenance
from .tally import Integrals, Ledger, PolarisedTally, Tally, holds_integrals

# What a record tells of each patch or of a hemisphere, and which are of the latter.
QUANTITIES, TOTALS = ("brdf", "btdf", "dhr", "dht"), ("dhr", "dht")


@dataclass(frozen=True, eq=False)
class MeasuredValues:
    """Exact sums of one incident direction or a stack, and all that follows from them.

    Its attributes are those of :class:`~gonio_mi.results.record.Record`.
    """

    subdivision: Subdivision
    theta_i: Floats
    phi_i: Floats
    channels: tuple[str, ...]
    tallies: tuple[Tally, ...]
    asked: MeasurementSettings = field(default_factory=MeasurementSettings)
    provenance: Provenance = field(default_factory=Provenance)
    stacked: bool = False

    # ------------------------------------------------------------------ values

    @cached_property
    def brdf(self) -> Floats:
        """Patch mean of the BRDF in 1/sr, shape ``(n_theta, n_phi, channels)``."""
        return self._value("brdf")

    @cached_property
    def btdf(self) -> Floats | None:
        """Patch mean of the BTDF in 1/sr, or None if there was no lower hemisphere.

        There is none where the specimen declares that it cannot transmit.
        """
        return self._value("btdf") if self.has_lower else None

    @cached_property
    def brdf_std_err(self) -> Floats:
        """Standard error of `brdf`; NaN where nothing was received or known.

        From the scatter of the batches, or under an emitter of finite size from
        leaving out each in turn; where a patch is `pooled`, at least that of as many
        heavy hits as are among its own on average over all patches. For integrals their
        estimated error, with that of the delta components.
        """
        return self._std_err("brdf")

    @cached_property
    def btdf_std_err(self) -> Floats | None:
        """Standard error of `btdf`, as of `brdf`."""
        return self._std_err("btdf") if self.has_lower else None

    @cached_property
    def dhr(self) -> Floats:
        """Directional-hemispherical reflectance, shape ``(channels,)``."""
        return self._value("dhr")

    @cached_property
    def dht(self) -> Floats | None:
        """Directional-hemispherical transmittance, or None without lower hemisphere.

        Of a periodic specimen it includes the light that passes openings, `direct`.
        """
        return self._value("dht") if self.has_lower else None

    @cached_property
    def direct(self) -> Floats:
        """Part of `dht` that passed a periodic specimen without any surface event.

        Shape ``(channels,)``. It left straight on, a delta: a patch of `btdf` holds its
        mean. 0 for a finite specimen, beside which light is ``missed``, and where the
        `order` that was collected is not 0 or ``all``.
        """
        return self._value("direct")

    @cached_property
    def direct_std_err(self) -> Floats:
        """Standard error of `direct`, as of `brdf`; NaN for a single batch."""
        return self._std_err("direct")

    @cached_property
    def dhr_std_err(self) -> Floats:
        """Standard error of `dhr`, as of `brdf`; NaN for a single batch."""
        return self._std_err("dhr")

    @cached_property
    def dht_std_err(self) -> Floats | None:
        """Standard error of `dht`, as of `brdf`; NaN for a single batch."""
        return self._std_err("dht") if self.has_lower else None

    @property
    def polarised(self) -> bool:
        """Whether Mueller matrices were measured, in a polarised variant."""
        return all(isinstance(tally, PolarisedTally) for tally in self.tallies)

    @cached_property
    def brdf_mueller(self) -> Floats | None:
        """Patch mean of the Mueller matrix of the BRDF, None without polarisation.

        In 1/sr, of the shape ``(n_theta, n_phi, channels, 4, 4)``; the first element is
        `brdf`. It takes the Stokes vector (I, Q, U, V) of the incident light to that of
        the light that leaves, each in the frame of s = k x z and p = k x s about its
        direction k of flight: Q = I_s - I_p, U > 0 for light that oscillates half-way
        from s to p, V > 0 for a field that turns clockwise in the eye of whoever looks
        towards the source. Along the z axis s is along y.
        """
        return self._matrix(self._value, "brdf")

    @cached_property
    def btdf_mueller(self) -> Floats | None:
        """Patch mean of the Mueller matrix of the BTDF, like `brdf_mueller`."""
        return self._matrix(self._value, "btdf")

    @cached_property
    def brdf_mueller_std_err(self) -> Floats | None:
        """Standard error of the elements of `brdf_mueller`; NaN as of `brdf`."""
        return self._matrix(self._std_err, "brdf")

    @cached_property
    def btdf_mueller_std_err(self) -> Floats | None:
        """Standard error of the elements of `btdf_mueller`."""
        return self._matrix(self._std_err, "btdf")

    @cached_property
    def dhr_mueller(self) -> Floats | None:
        """Sum of the Mueller matrices of all reflected flux, ``(channels, 4, 4)``.

        Each in the frame of the direction in which it leaves, as of `brdf_mueller`.
        """
        return self._matrix(self._value, "dhr")

    @cached_property
    def dht_mueller(self) -> Floats | None:
        """Sum of the Mueller matrices of all transmitted flux, like `dhr_mueller`."""
        return self._matrix(self._value, "dht")

    @cached_property
    def dhr_mueller_std_err(self) -> Floats | None:
        """Standard error of the elements of `dhr_mueller` from the batches."""
        return self._matrix(self._std_err, "dhr")

    @cached_property
    def dht_mueller_std_err(self) -> Floats | None:
        """Standard error of the elements of `dht_mueller` from the batches."""
        return self._matrix(self._std_err, "dht")

    def stokes(self, incident: ArrayLike, of: str = "brdf") -> tuple[Floats, Floats]:
        """Stokes vectors of the light that leaves, and their standard errors.

        Parameters
        ----------
        incident : array_like, shape (4,)
            Stokes vector (I, Q, U, V) of the incident light in the frame of
            `brdf_mueller`, such as ``[1, 1, 0, 0]`` for light that is polarised along
            s. No other measurement is needed: all elements are known.
        of : {"brdf", "btdf", "dhr", "dht"}

        Returns
        -------
        values, std_err : ndarray
            In 1/sr, ``(n_theta, n_phi, channels, 4)``; of totals ``(channels, 4)``.

        Raises
        ------
        ValueError
            If `incident` is no light, for another `of`, or without Mueller matrices or
            lower hemisphere.
        """
        solid = 1.0 if of in TOTALS else self._projected[..., None]
        return self._of_stokes(incident, of, lambda one, s: one.stokes(s), solid)

    def normalised_stokes(
        self, incident: ArrayLike, of: str = "brdf"
    ) -> tuple[Floats, Floats]:
        """Q / I, U / I and V / I of the light that leaves, and their standard errors.

        Of :meth:`stokes`, with the same parameters; errors are those of the ratios, to
        which Q and I contribute together. Of the shape
        ``(n_theta, n_phi, channels, 3)``, of totals ``(channels, 3)``; NaN without
        light.
        """
        return self._of_stokes(incident, of, lambda one, s: one.normalised_stokes(s))

    def degree(self, incident: ArrayLike, of: str = "brdf") -> tuple[Floats, Floats]:
        """Degrees of polarisation of the light that leaves, and their standard errors.

        Polarised part over power of :meth:`stokes`, with the same parameters. Of the
        shape ``(n_theta, n_phi, channels)``, of totals ``(channels,)``; NaN without
        light, and errors for fewer hits than Student's t needs (:meth:`interval`).
        Noise makes a degree near 0 larger, by about its error.
        """
        return self._of_stokes(incident, of, lambda one, s: one.degree(s))

    def degree_interval(
        self, incident: ArrayLike, level: float = 0.95, of: str = "brdf"
    ) -> tuple[Floats, Floats]:
        """Limits of the :meth:`degree` of patches, `of` ``"brdf"`` or ``"btdf"``.

        By Student's t over the batches, and from 0 to 1 for fewer hits than it needs.
        The lower one is 0 unless one of Q, U and V is known not to be 0.
        """
        level = checked_number("level", level, 1e-12, 1, "between 0 and 1")
        checked_choice("of", of, ("brdf", "btdf"))
        return self._of_stokes(
            incident, of, lambda one, s: one.degree_interval(s, level)
        )

    @property
    def flux_fraction(self) -> Floats:
        """Received over incident flux, ``(n_hemispheres, n_theta, n_phi, channels)``.

        The raw measured quantity; it sums to ``dhr`` and ``dht``. Where the first order
        is a sum over `facets` it may be negative in a faint patch, by chance; `brdf`
        is 0 there.
        """
        fractions = np.empty((len(self.tallies), *self.tallies[0].sums.shape[1:]))
        for own, tally in zip(fractions, self.tallies):
            own[:] = statistics.ratio(tally.sums, tally.incident[:, None, None, None])
        return self._squeeze(fractions)

    @property
    def counts(self) -> Counts:
        """Rays per patch, uint64, shape ``(n_hemispheres, n_theta, n_phi)``.

        For the estimator `next_event` deposits: several from one ray, or none; for
        `split` branches of rays, and points of the surface.
        """
        return self._squeeze(np.stack([tally.hits for tally in self.tallies]))

    @property
    def ray_keys(self) -> dict[str, str]:
        """Texts by which a table names the rays: `seed` and `sampler`.

        A merged record has several seeds, with commas in between. Empty if no seed is
        known, or for integrals.
        """
        own = self.provenance
        if not own.seeds or holds_integrals(self.tallies):
            return {}
        keys = {"seed": ", ".join(map(str, own.seeds))}
        return keys | ({} if own.sampler is None else {"sampler": own.sampler})

    @property
    def without_hit(self) -> Flags:
        """Whether a patch is known by an upper limit only, shaped like `counts`."""
        return self._squeeze(np.stack([one.without_hit for one in self.estimates]))

    @cached_property
    def pooled(self) -> Flags:
        """Whether a patch's own hits tell too little of its scatter, like `counts`.

        Hits more than twice as heavy as its mean one make the patches of its hemisphere
        scatter, and it has scattered as by fewer than 30 of them, and by less than
        their share in all hits lets expect, or has received one: bright spots on a dark
        specimen, of which it has seen none, or one too many. Its standard error and
        interval take their weight from all patches; in some channel at least.
        """
        hemispheres = range(self.n_hemispheres)
        flags = [[one.patches(i).pooled for i in hemispheres] for one in self.estimates]
        return read_only_array(self._squeeze(np.any(flags, axis=-1)))

    @property
    def ledger(self) -> Ledger:
        """:class:`Ledger` over all batches and incident directions."""
        return Ledger.from_counts(sum(one.fates.sum(axis=0) for one in self.tallies))

    @property
    def n_batches(self) -> int:
        """Independent batches per incident direction."""
        return min(tally.n_batches for tally in self.tallies)

    @property
    def has_lower(self) -> bool:
        """Whether there was a lower hemisphere."""
        return self.n_hemispheres == 2

    @property
    def n_hemispheres(self) -> int:
        """1, or 2 if there was a lower one."""
        return min(tally.hits.shape[0] for tally in self.tallies)

    # ------------------------------------------------------------ uncertainties

    @cached_property
    def estimates(self) -> tuple[Estimates, ...]:
        """:class:`gonio_mi.results.estimates.Estimates` of each incident direction."""
        return tuple(map(self._estimates, self.tallies, self.theta_i))

    def interval(self, level: float = 0.95, of: str = "brdf") -> tuple[Floats, Floats]:
        """Interval that covers the true patch mean with probability `level`.

        Patches, totals, `direct` and quantities have the same rules. Exact binomial
        (Clopper-Pearson) for counted independent rays. Otherwise Student's t over the
        batches, with fewer degrees of freedom where they had unlike parts of the light
        of an emitter of finite size. For fewer than 100 independent hits, the exact
        binomial interval of the hits times the mean weight of a hit; for fewer than 30
        with other samplers, which scatter less, the narrower of that and Student's t.
        In both cases the interval of weights that are unlike reaches at
        least to the limits for weighted counts (Fay and Feuer 1997), of which one of
        their mean weight, by power, may have been missed. What received no hit has an
        upper limit, and so has a channel that none of its hits carried: the flux that
        would have left it empty with probability ``(1 - level) / 2``, at the larger of
        unit weight and the largest mean weight of a patch. All batches may give the
        same sum, and all rays may have been received: no interval by Student's t is
        narrower than what so many rays of another kind, of which none was seen, would
        change, nor than the rounding of single precision. Where all rays were received
        with weight 1 they can only be lost.

        A patch that is `pooled` has few of the heavy hits that make all patches
        scatter, or none. Their weight is the third over the second cumulant of sums
        between batches, over all patches; as many of them as explain the patch's own
        scatter count as Poisson's, and one more may have been missed (Fay and Feuer
        1997): the interval reaches at least to these limits. It takes at least three
        batches, and heavy hits that some patch
        received: what is rarer than one in all rays, no interval of them knows.

        Deposits of `next_event` are of very unlike weights: below 300 of them, where
        they scatter more than half as many that are alike and independent, and in all
        patches where three of four do so, the interval reaches at least to the limits
        for weighted counts (Fay and Feuer 1997), of which one of unit weight may have
        been missed.

        Where the first order is known without rays, a sum over mirror facets
        (`transport` of the provenance ``facets``) or over points of the surface
        (`split`, which count as hits), the interval is at least that of a Poisson
        count of as many rays of weight 1, or in patches branches of a 16th of it, as
        explain the scatter, of which one more may have been missed.

        Integrals (estimator `quadrature`) may be wrong by their error, the largest that
        they are estimated to have, at any `level`; Student's t for delta components,
        which are sampled, is added to it.

        Parameters
        ----------
        level : float
            In (0, 1).
        of : str
            ``"brdf"``, ``"btdf"``, ``"dhr"``, ``"dht"`` or ``"direct"``; of all but the
            last with ``_mueller`` for the elements of a Mueller matrix, each by
            itself: Student's t, and where hits are few, limits from the intervals
            of fluxes, M00 + M_k and M00 - M_k.

        Returns
        -------
        low, high : ndarray
            Shaped like the quantity; NaN where a single batch leaves it unknown.

        Raises
        ------
        ValueError
            For another `level` or `of`, or if there is no lower hemisphere.
        """
        level = checked_number("level", level, 1e-12, 1, "between 0 and 1")
        matrices = tuple(f"{name}_mueller" for name in QUANTITIES)
        checked_choice("of", of, (*QUANTITIES, "direct", *matrices))
        quantity = of.removesuffix("_mueller")
        if of in matrices:
            self._check_polarised()
        self._hemisphere(quantity)
        pairs = [one.interval(level) for one in self._each(of)]
        return self._both(pairs, self._solid(of))

    # ------------------------------------------------------------------ internals

    def _each(self, of: str) -> list[Any]:
        """Estimate of a quantity or its matrix, of each incident direction."""
        quantity = of.removesuffix("_mueller")
        known: Any = self.estimates
        if quantity != of:
            pairs: Any = zip(self.tallies, self.estimates)
            known = [MuellerEstimates(tally, light) for tally, light in pairs]
        if of == "direct":
            return [one.direct for one in known]
        hemisphere = self._hemisphere(quantity)
        if quantity in TOTALS:
            return [one.total(hemisphere) for one in known]
        return [one.patches(hemisphere) for one in known]

    def _solid(self, of: str) -> Floats | float:
        """Projected solid angles by which a quantity of patches is divided, or 1."""
        quantity = of.removesuffix("_mueller")
        if quantity not in QUANTITIES or quantity in TOTALS:
            return 1.0
        return self._projected if quantity == of else self._projected[..., None, None]

    def _value(self, of: str) -> Floats:
        """Value of a quantity, read-only; patches of chance below 0 are 0 on facets."""
        each = np.stack([one.value for one in self._each(of)])
        if of in ("brdf", "btdf") and self.provenance.transport == FACETS:
            each = np.maximum(each, 0.0)
        return read_only_array(self._squeeze(each) / self._solid(of))

    def _std_err(self, of: str) -> Floats:
        """Standard error of a quantity, read-only."""
        each = np.stack([one.std_err for one in self._each(of)])
        return read_only_array(self._squeeze(each) / self._solid(of))

    def _matrix(self, what: Callable[[str], Floats], of: str) -> Floats | None:
        """A property of the Mueller matrices of a quantity, if there are some."""
        lower = of in ("btdf", "dht")
        if not self.polarised or (lower and not self.has_lower):
            return None
        return what(f"{of}_mueller")

    def _of_stokes(
        self,
        incident: ArrayLike,
        of: str,
        pair: Callable[[MuellerEstimate, Floats], tuple[Floats, Floats]],
        solid: Floats | float = 1.0,
    ) -> tuple[Floats, Floats]:
        """Pairs that Mueller matrices of a quantity return for Stokes vectors."""
        vector = checked_stokes(incident)
        checked_choice("of", of, QUANTITIES)
        self._check_polarised()
        each = self._each(f"{of}_mueller")
        return self._both([pair(one, vector) for one in each], solid)

    def _check_polarised(self) -> None:
        """Raise SettingError unless there are Mueller matrices."""
        if not self.polarised:
            raise SettingError(
                "Mueller matrices need a polarised variant, such as "
                "llvm_ad_mono_polarized, got a record of "
                f"{self.provenance.variant or 'another one'}"
            )

    def _hemisphere(self, of: str) -> int:
        """Hemisphere of a quantity, which the record must have."""
        hemisphere = int(of in ("btdf", "dht"))
        if hemisphere and not self.has_lower:
            raise SettingError(f"of must be brdf or dhr for a record without {of}")
        return hemisphere

    @property
    def _projected(self) -> Floats:
        return self.subdivision.projected_solid_angles[..., None]

    def _estimates(self, tally: Tally, theta_i: float) -> Estimates:
        """Estimates of one incident direction, by the kind of its tally."""
        kind: Callable[..., Estimate] = SampledEstimate
        rounding = ROUNDING
        if isinstance(tally, Integrals):
            kind = IntegralEstimate
        elif self.asked.joins_points:
            kind = SplitEstimate
        elif self.provenance.transport == FACETS:
            kind = ControlledEstimate
            # a line falls by the cosine of its way: so much further off it passes what
            # begins at a rounded height
            rounding = ROUNDING / float(np.cos(np.radians(theta_i)))
        return Estimates(
            tally,
            kind,
            independent=self.provenance.sampler == "independent",
            deposited=self.asked.sends_points,
            passes=self.provenance.passes,
            rounding=rounding,
            solid=self.subdivision.projected_solid_angles,
        )

    def _both(
        self, pairs: Sequence[tuple[Floats, Floats]], solid: Floats | float = 1.0
    ) -> tuple[Floats, Floats]:
        """Two quantities of each incident direction, over solid angles."""
        first, second = np.stack(pairs, axis=1)
        return self._squeeze(first / solid), self._squeeze(second / solid)

    def _squeeze(self, array: Numbers) -> Numbers:
        return array if self.stacked else array[0]


def read_only_array(array: Numbers) -> Numbers:
    """The array, into which nobody can write from now on."""
    array.flags.writeable = False
    return array

"""The result of a measurement: values, uncertainties, ledger and how it was made."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from os import PathLike
from typing import Any, ClassVar

import numpy as np

from ..array_types import Counts, Flags, Floats, Numbers
from ..collector import Subdivision
from ..errors import (
    SettingError,
    abridged,
    checked_choice,
    checked_number,
    printable,
    shown,
)
from ..settings import MeasurementSettings
from ..settings.measurement_settings import MOST_RAYS
from . import statistics
from .estimates import Estimates, IntegralEstimates, SampledEstimates
from .provenance import (
    MERGED,
    STACKED,
    Provenance,
    check_alike,
    names_told,
    read_only,
    told_settings,
    with_settings,
)
from .tally import Integrals, Ledger, Tally, holds_integrals, sent_text

__all__ = ["Record"]


# Channels that are wavelengths, from 100 to 9999 nm.
WAVELENGTH = re.compile(r"([1-9]\d{2,3}(?:\.\d+)?)nm")


@dataclass(frozen=True, eq=False)
class Record:
    """What the collector received, at one incident direction or a stack of them.

    Only exact sums are stored; everything else is derived. For a stack all arrays have
    the incident direction as an additional first axis. Nothing of it can be changed:
    what it is made of becomes read-only, arrays included.

    Attributes
    ----------
    subdivision : Subdivision
        The patches of either hemisphere.
    theta_i, phi_i : ndarray of float64, shape (n_incident,)
        Incident direction in degrees, towards the centre of the emitter; ``theta_i``
        counts from the normal of the lit face.
    channels : tuple of str
        ``("Y",)``, ``("R", "G", "B")`` or wavelengths such as ``"550nm"``.
    tallies : tuple of Tally
        One per incident direction.
    asked : MeasurementSettings
        The settings that were asked for, as far as a record tells them.
    provenance : Provenance
        How it came about.
    stacked : bool
        Whether it was asked for as a stack.
    """

    subdivision: Subdivision
    theta_i: Floats
    phi_i: Floats
    channels: tuple[str, ...]
    tallies: tuple[Tally, ...]
    asked: MeasurementSettings = field(default_factory=MeasurementSettings)
    provenance: Provenance = field(default_factory=Provenance)
    stacked: bool = False

    # what rooms above this one do with a record: files and plots set it
    writer: ClassVar[Callable[[Record, str | PathLike[str]], None]]
    labeller: ClassVar[Callable[[Record], Any]]
    plotter: ClassVar[Callable[..., Any]]
    viewer: ClassVar[Callable[[Record], str]]

    def __post_init__(self) -> None:
        object.__setattr__(self, "asked", self._known(self.asked))
        _frozen(self.theta_i)
        _frozen(self.phi_i)
        for tally in self.tallies:
            tally.freeze()

    def __reduce__(self) -> tuple[Any, ...]:
        """What copies are made of: they are read-only too."""
        return Record, tuple(getattr(self, one.name) for one in fields(self))

    # ------------------------------------------------------------------ values

    @cached_property
    def brdf(self) -> Floats:
        """Patch mean of the BRDF in 1/sr, shape ``(n_theta, n_phi, channels)``."""
        return self._per_patch(lambda one: one.fraction(0))

    @cached_property
    def btdf(self) -> Floats | None:
        """Patch mean of the BTDF in 1/sr, or None if there was no lower hemisphere.

        There is none where the specimen declares that it cannot transmit.
        """
        return self._per_patch(lambda one: one.fraction(1)) if self.has_lower else None

    @cached_property
    def brdf_std_err(self) -> Floats:
        """Standard error of `brdf`; NaN where nothing was received or known.

        From the scatter of the batches; where a patch is `pooled`, at least what the
        mean square of a hit in all patches makes of its number of hits. For integrals
        their estimated error, with that of the delta components.
        """
        return self._per_patch(lambda one: one.std_err(0))

    @cached_property
    def btdf_std_err(self) -> Floats | None:
        """Standard error of `btdf`, as of `brdf`."""
        return self._per_patch(lambda one: one.std_err(1)) if self.has_lower else None

    @cached_property
    def dhr(self) -> Floats:
        """Directional-hemispherical reflectance, shape ``(channels,)``."""
        return self._of_each(lambda one: one.total(0))

    @cached_property
    def dht(self) -> Floats | None:
        """Directional-hemispherical transmittance, or None without lower hemisphere.

        Of a periodic specimen it includes the light that passes openings, `direct`.
        """
        return self._of_each(lambda one: one.total(1)) if self.has_lower else None

    @cached_property
    def direct(self) -> Floats:
        """Part of `dht` that passed a periodic specimen without any surface event.

        Shape ``(channels,)``. It left straight on, a delta: a patch of `btdf` holds its
        mean. 0 for a finite specimen, beside which light is ``missed``, and where the
        `order` that was collected is not 0 or ``all``.
        """
        return self._of_each(lambda one: one.direct)

    @cached_property
    def direct_std_err(self) -> Floats:
        """Standard error of `direct` from the batches; NaN for a single batch."""
        return self._of_each(lambda one: one.direct_std_err)

    @cached_property
    def dhr_std_err(self) -> Floats:
        """Standard error of `dhr` from the batches; NaN for a single batch."""
        return self._of_each(lambda one: one.total_std_err(0))

    @cached_property
    def dht_std_err(self) -> Floats | None:
        """Standard error of `dht` from the batches; NaN for a single batch."""
        if not self.has_lower:
            return None
        return self._of_each(lambda one: one.total_std_err(1))

    @property
    def flux_fraction(self) -> Floats:
        """Received over incident flux, ``(n_hemispheres, n_theta, n_phi, channels)``.

        The raw measured quantity; it sums to ``dhr`` and ``dht``.
        """
        fractions = [
            statistics.ratio(tally.sums, tally.incident[:, None, None, None])
            for tally in self.tallies
        ]
        return self._squeeze(np.stack(fractions))

    @property
    def counts(self) -> Counts:
        """Rays per patch, uint64, shape ``(n_hemispheres, n_theta, n_phi)``.

        For the estimator `next_event` deposits: several from one ray, or none.
        """
        return self._squeeze(np.stack([tally.hits for tally in self.tallies]))

    @property
    def ray_keys(self) -> dict[str, str]:
        """Texts by which a table names the rays: `seed` and `sampler`.

        A merged record has several seeds, with commas in between. Empty if no seed is
        known, or for integrals.
        """
        own = self.provenance
        if not own.seeds or self.asked.estimator.integrates:
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
        scatter, and it has scattered as by fewer than 30 of them: bright spots on a
        dark specimen, of which it has seen none, or one too many. Its standard error
        and interval take their weight from all patches; in some channel at least.
        """
        hemispheres = range(1 + self.has_lower)
        flags = [[one.pooled(i) for i in hemispheres] for one in self.estimates]
        return _frozen(self._squeeze(np.any(flags, axis=-1)))

    @property
    def ledger(self) -> Ledger:
        """:class:`Ledger` over all batches and incident directions."""
        total = Ledger()
        for tally in self.tallies:
            total = total + tally.ledger
        return total

    @property
    def n_batches(self) -> int:
        """Independent batches per incident direction."""
        return min(tally.n_batches for tally in self.tallies)

    @property
    def has_lower(self) -> bool:
        """Whether there was a lower hemisphere."""
        return all(tally.hits.shape[0] == 2 for tally in self.tallies)

    # ------------------------------------------------------------ uncertainties

    @cached_property
    def estimates(self) -> tuple[Estimates, ...]:
        """:class:`gonio_mi.results.estimates.Estimates` of each incident direction."""
        return tuple(map(self._estimates, self.tallies))

    def interval(self, level: float = 0.95, of: str = "brdf") -> tuple[Floats, Floats]:
        """Interval that covers the true patch mean with probability `level`.

        Exact binomial (Clopper-Pearson) for counted independent rays. Otherwise
        Student's t over the batches; for patches with fewer than 100 hits (30 with
        samplers other than `independent`, which scatter less and for which it is wider
        than need be) the exact binomial interval of the hits, times the mean weight of
        a hit. A patch without a hit has an upper limit, and so has a channel that none
        of its hits carried: the flux that would have left it empty with probability
        ``(1 - level) / 2``, at the larger of unit weight and the largest mean weight
        seen. All batches may give the same sum, and all rays
        may have been received: no interval by Student's t is narrower than what so
        many rays of another kind, of which none was seen, would change, nor than the
        rounding of single precision. Where all rays were received with weight 1 they
        can only be lost.

        A patch that is `pooled` has few of the heavy hits that make all patches
        scatter, or none. Their weight is the third over the second cumulant of sums
        between batches, over all patches; as many of them as explain the patch's own
        scatter count as Poisson's, and one more may have been missed (Fay and Feuer
        1997): the interval reaches at least to these limits, and so do those of
        totals. It takes at least three batches, and heavy hits that some patch
        received: what is rarer than one in all rays, no interval of them knows.

        Deposits of `next_event` are of very unlike weights: below 300 of them, where
        they scatter more than half as many that are alike and independent, and in all
        patches where three of four do so, the interval reaches at least to the limits
        for weighted counts (Fay and Feuer 1997), of which one of unit weight may have
        been missed.

        Integrals (estimator `quadrature`) may be wrong by their error, the largest that
        they are estimated to have, at any `level`; Student's t for delta components,
        which are sampled, is added to it.

        Parameters
        ----------
        level : float
            In (0, 1).
        of : {"brdf", "btdf", "dhr", "dht", "direct"}

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
        checked_choice("of", of, ("brdf", "btdf", "dhr", "dht", "direct"))
        if of == "direct":
            both = [one.direct_interval(level) for one in self.estimates]
            low, high = np.stack(both, axis=1)
            return self._squeeze(low), self._squeeze(high)
        hemisphere = int(of in ("btdf", "dht"))
        if hemisphere and not self.has_lower:
            raise SettingError(f"of must be brdf or dhr for a record without {of}")
        of_all = of in ("dhr", "dht")
        limits = [
            (one.total_interval if of_all else one.interval)(hemisphere, level)
            for one in self.estimates
        ]
        low, high = np.stack(limits, axis=1)
        solid = 1.0 if of_all else self._projected
        return self._squeeze(low / solid), self._squeeze(high / solid)

    # --------------------------------------------------------------- composition

    def __len__(self) -> int:
        return len(self.tallies)

    @classmethod
    def stack(cls, records: Iterable[Record]) -> Record:
        """One record of the incident directions of all `records`, in their order.

        Raises
        ------
        ValueError
            If there is none, or two differ in anything but the incident directions.
        """
        records = list(records)
        if not records:
            raise SettingError("records must hold at least one to be stacked, got none")
        for other in records[1:]:
            records[0]._check_alike(other, STACKED, "stacked")
        channels = max((record.channels for record in records), key=len)
        return replace(
            records[0],
            theta_i=np.concatenate([record.theta_i for record in records]),
            phi_i=np.concatenate([record.phi_i for record in records]),
            channels=channels,
            tallies=tuple(
                tally.spread(len(channels))
                for record in records
                for tally in record.tallies
            ),
            provenance=Provenance.stacked([one.provenance for one in records]),
            stacked=True,
        )

    def __getitem__(self, index: int | slice) -> Record:
        """Record of one incident direction of the stack; a stack for a slice."""
        if isinstance(index, slice):
            if not self.tallies[index]:
                raise SettingError(
                    f"a stack must hold at least one incident direction, got {index} "
                    f"of {len(self)}"
                )
            return replace(
                self,
                theta_i=self.theta_i[index],
                phi_i=self.phi_i[index],
                tallies=self.tallies[index],
                stacked=True,
            )
        tally = self.tallies[index]
        return replace(
            self,
            theta_i=self.theta_i[index : index + 1 or None],
            phi_i=self.phi_i[index : index + 1 or None],
            tallies=(tally,),
            stacked=False,
        )

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, Record)
            and self.subdivision == other.subdivision
            and np.array_equal(self.theta_i, other.theta_i, equal_nan=True)
            and np.array_equal(self.phi_i, other.phi_i, equal_nan=True)
            and self.channels == other.channels
            and self.asked == other.asked
            and self.provenance == other.provenance
            and self.stacked == other.stacked
            and self.tallies == other.tallies
        )

    def __repr__(self) -> str:
        angles = ", ".join(
            f"({theta:g}, {phi:g})"
            for theta, phi in zip(self.theta_i[:3], self.phi_i[:3])
        ) + (", ..." if len(self) > 3 else "")
        return (
            f"<Record of {printable(self.provenance.name)}: "
            f"{abridged(str(self.subdivision), 60)}, "
            f"incident (theta_i, phi_i) = {angles} degrees, "
            f"{sent_text(self.tallies)}, dhr {np.array2string(self.dhr, precision=5)}>"
        )

    def merge(self, other: Record) -> Record:
        """Record of the rays of both: same measurement, another seed.

        Raises
        ------
        ValueError
            If the two differ in anything but their rays, batches and seed (specimens
            and emitters by their digests), were made with the same seed, whose rays
            would be counted twice, or hold integrals.
        """
        self._check_alike(other, MERGED, "merged")
        for key in ("theta_i", "phi_i"):
            a, b = getattr(self, key).tolist(), getattr(other, key).tolist()
            if not np.array_equal(a, b, equal_nan=True):
                raise SettingError(
                    f"records must agree in {key} to be merged, got {shown(a)} and "
                    f"{shown(b)}"
                )
        if holds_integrals((*self.tallies, *other.tallies)):
            raise SettingError("records of the estimator quadrature cannot be merged")
        provenance = self.provenance.merged(other.provenance)
        tallies = tuple(a + b for a, b in zip(self.tallies, other.tallies))
        channels = max(self.channels, other.channels, key=len)
        return replace(self, tallies=tallies, channels=channels, provenance=provenance)

    @cached_property
    def settings(self) -> Mapping[str, Any]:
        """All that is needed to repeat the measurement, in JSON's types; read-only.

        Of `asked` and `provenance`, what is known, by the names of :func:`measure`.
        """
        told: Mapping[str, Any] = read_only(told_settings(self.asked, self.provenance))
        return told

    def with_settings(self, **changes: object) -> Record:
        """Return the record with other values of some `settings`.

        Raises
        ------
        TypeError, ValueError
            For a name or a value that no setting of a record has.
        """
        asked, provenance = with_settings(self.asked, self.provenance, changes)
        return replace(self, asked=asked, provenance=provenance)

    def with_provenance(self, **changes: Any) -> Record:
        """Return the record with other values of some attributes of `provenance`."""
        return replace(self, provenance=replace(self.provenance, **changes))

    def save(self, path: str | PathLike[str]) -> None:
        """Write to ``.npz`` or ``.exr``, both lossless; the file appears when complete.

        Raises
        ------
        ValueError
            For another file ending.
        OSError
            If it cannot be written.
        """
        Record.writer(self, path)

    def plot(self, path: str | PathLike[str] | None = None, *, index: int = 0) -> Any:
        """Figure of one incident direction; see :func:`gonio_mi.plot`."""
        return Record.plotter(self, path, index=index)

    def to_xarray(self) -> Any:
        """Labelled arrays; see :func:`gonio_mi.files.netcdf.dataset`."""
        return Record.labeller(self)

    def _repr_html_(self) -> str:
        """Picture, numbers and warnings, for notebooks."""
        return Record.viewer(self)

    # ------------------------------------------------------------------ internals

    @property
    def _projected(self) -> Floats:
        return self.subdivision.projected_solid_angles[..., None]

    def _check_alike(self, other: Record, free: set[str], purpose: str) -> None:
        """Raise ValueError if collector, channels or a setting not in `free` differ."""
        check_alike(self._told, other._told, free, purpose)
        both = {self.channels, other.channels}
        # of a grey specimen one channel stands for three
        if len(both) > 1 and both != {("Y",), ("R", "G", "B")}:
            raise SettingError(
                f"records must agree in channels to be {purpose}, got "
                f"{shown(self.channels)} and {shown(other.channels)}"
            )

    @property
    def _told(self) -> dict[str, Any]:
        """The settings, and the collector as what it was resolved to."""
        return {**self.settings, "collector": str(self.subdivision)}

    def _known(self, asked: MeasurementSettings) -> MeasurementSettings:
        """Settings that were asked for, with what the record knows of the others."""
        found = (WAVELENGTH.fullmatch(name) for name in self.channels)
        nm = tuple(float(match[1]) for match in found if match)
        default, own = MeasurementSettings(), self.provenance
        return replace(
            default,
            **{name: getattr(asked, name) for name in names_told(asked, own)},
            collector=self.subdivision,
            hemispheres="both" if self.has_lower else "upper",
            wavelengths=nm or default.wavelengths,
            rays=min(own.rays or default.rays, MOST_RAYS),
            seed=own.seeds[0] if own.seeds else default.seed,
            sampler=own.sampler,
        )

    def _estimates(self, tally: Tally) -> Estimates:
        """Estimates of one incident direction, by the kind of its tally."""
        passes = self.provenance.passes
        if isinstance(tally, Integrals):
            return IntegralEstimates(tally, passes=passes)
        return SampledEstimates(
            tally,
            independent=self.provenance.sampler == "independent",
            deposited=self.asked.estimator.deposits,
            passes=passes,
        )

    def _per_patch(self, quantity: Callable[[Estimates], Floats]) -> Floats:
        """A quantity of the estimates over solid angles, read-only."""
        return _frozen(self._of_each(quantity) / self._projected)

    def _of_each(self, quantity: Callable[[Estimates], Floats]) -> Floats:
        """A quantity of the estimates of each incident direction, read-only."""
        each = np.stack([quantity(one) for one in self.estimates])
        return _frozen(self._squeeze(each))

    def _squeeze(self, array: Numbers) -> Numbers:
        return array if self.stacked else array[0]


def _frozen(array: Numbers) -> Numbers:
    """The array, into which nobody can write from now on."""
    array.flags.writeable = False
    return array

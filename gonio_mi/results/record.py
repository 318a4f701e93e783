"""The result of a measurement: values, uncertainties, ledger and how it was made."""

from __future__ import annotations

import operator
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from os import PathLike
from typing import Any

import numpy as np

from ..annexes import ask
from ..array_types import Floats
from ..errors import SettingError, SettingTypeError, abridged, printable, shown
from ..settings import DEFAULTS, MeasurementSettings
from ..settings.measurement_settings import MAX_RAYS
from .gradients import Differentiated
from .patch_means import PatchMeans
from .provenance import (
    FREE_WHEN_MERGED,
    FREE_WHEN_STACKED,
    Provenance,
    check_alike,
    read_only,
    reported_names,
    settings_mapping,
    with_settings,
)
from .tally import holds_integrals, sent_text
from .values import MeasuredValues, read_only_array

# Channels that are wavelengths, from 100 to 9999 nm.
WAVELENGTH = re.compile(r"([1-9]\d{2,3}(?:\.\d+)?)nm")

# Incident directions, and reflectances, that a line on a record lists.
MAX_SHOWN = 3


@dataclass(frozen=True, eq=False)
class Record(MeasuredValues, Differentiated):
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
        The settings that were specified, as far as a record reports them.
    provenance : Provenance
        How it came about.
    stacked : bool
        Whether it was asked for as a stack.
    back : Record, optional
        Of a whole material that transmits, what is measured with light from behind, as
        with ``side="back"``. All else here is of the front alone.
    """

    back: Record | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "asked", self._known(self.asked))
        read_only_array(self.theta_i)
        read_only_array(self.phi_i)
        for tally in self.tallies:
            tally.freeze()

    def __reduce__(self) -> tuple[Any, ...]:
        """What copies are made of: they are read-only too."""
        return Record, tuple(getattr(self, one.name) for one in fields(self))

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
            records[0]._check_alike(other, FREE_WHEN_STACKED, "stacked")
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
            back=None,
        )

    def __iter__(self) -> Iterator[Record]:
        """Records of the incident directions, one after the other."""
        return (self[index] for index in range(len(self)))

    def __getitem__(self, index: int | slice) -> Record:
        """Record of one incident direction of the stack; a stack for a slice."""
        if isinstance(index, slice):
            if not self.tallies[index]:
                raise SettingError(
                    f"a stack must hold at least one incident direction, got {index} "
                    f"of {len(self)}"
                )
            part, tallies = index, self.tallies[index]
        else:
            index = self._checked_index(index)
            part, tallies = slice(index, index + 1 or None), (self.tallies[index],)
        found = replace(
            self,
            theta_i=self.theta_i[part],
            phi_i=self.phi_i[part],
            tallies=tallies,
            stacked=isinstance(index, slice),
            back=None,
        )
        if "estimates" in vars(self):
            vars(found)["estimates"] = self.estimates[part]
        return found

    def _checked_index(self, index: object) -> int:
        """Number of an incident direction; IndexError if the stack has no such one."""
        if not hasattr(index, "__index__") or isinstance(index, bool):
            raise SettingTypeError(
                f"index must be a whole number or a slice, got {shown(index)}"
            )
        number = operator.index(index)
        if not -len(self) <= number < len(self):
            raise IndexError(
                f"index must be that of one of {len(self)} incident directions, "
                f"got {number}"
            )
        return number

    def __array__(self, *_: object, **__: object) -> Any:
        """No array stands for all of a record, not even that of patches."""
        raise SettingTypeError(
            "a Record is no array: take one of its attributes, such as brdf or dhr"
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
            and self.back == other.back
        )

    def __repr__(self) -> str:
        angles = ", ".join(
            f"({theta:g}, {phi:g})"
            for theta, phi in zip(self.theta_i[:MAX_SHOWN], self.phi_i[:MAX_SHOWN])
        ) + (", ..." if len(self) > MAX_SHOWN else "")
        dhr = np.array2string(self.dhr.ravel(), precision=5)
        if self.dhr.size > MAX_SHOWN:
            dhr = f"{self.dhr.min():.5g} to {self.dhr.max():.5g}"
        return (
            f"<Record of {printable(self.provenance.name)}: "
            f"{abridged(str(self.subdivision), 60)}, "
            f"incident (theta_i, phi_i) = {angles} degrees, "
            f"{sent_text(self.tallies)}, dhr {dhr}>"
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
        self._check_alike(other, FREE_WHEN_MERGED, "merged")
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
        backs = self.back, other.back
        back = backs[0].merge(backs[1]) if backs[0] and backs[1] else None
        return replace(
            self, tallies=tallies, channels=channels, provenance=provenance, back=back
        )

    @cached_property
    def settings(self) -> Mapping[str, Any]:
        """All that is needed to repeat the measurement, in JSON's types; read-only.

        Of `asked` and `provenance`, what is known, by the names of :func:`measure`.
        """
        mapping: Mapping[str, Any]
        mapping = read_only(settings_mapping(self.asked, self.provenance))
        return mapping

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
        ask("files", "save")(self, path)

    def plot(self, path: str | PathLike[str] | None = None, *, index: int = 0) -> Any:
        """Figure of one incident direction; see :func:`gonio_mi.plot`."""
        return ask("plots", "plot")(self, path, index=index)

    def quantity(self, what: Any, over: Any = None, **how: Any) -> Any:
        """Quantity of a name, or a weighted sum of patches, with its uncertainty.

        See :func:`gonio_mi.analysis.quantities.quantity.record_quantity`.
        """
        return ask("analysis", "record_quantity")(self, what, over, **how)

    def covariance(self, weights: Any) -> Any:
        """Covariance of weighted sums of patches, from the batches.

        See :func:`gonio_mi.analysis.quantities.functionals.covariance`.
        """
        return ask("analysis", "covariance")(self, weights)

    def to_xarray(self) -> Any:
        """Labelled arrays; see :func:`gonio_mi.files.netcdf.dataset`."""
        return ask("files", "dataset")(self)

    def _repr_html_(self) -> str:
        """Picture, numbers and warnings, for notebooks."""
        shown: str = ask("reports", "notebook_view")(self)
        return shown

    # ------------------------------------------------------------------ internals

    def _check_alike(self, other: Record, free: set[str], purpose: str) -> None:
        """Raise ValueError if collector, channels or a setting not in `free` differ."""
        mine, theirs = self.provenance, other.provenance
        if mine is not theirs or self.asked != other.asked:
            check_alike(self._conditions, other._conditions, free, purpose)
        both = {self.channels, other.channels}
        # of a grey specimen one channel stands for three
        if len(both) > 1 and both != {("Y",), ("R", "G", "B")}:
            raise SettingError(
                f"records must agree in channels to be {purpose}, got "
                f"{shown(self.channels)} and {shown(other.channels)}"
            )

    @property
    def _conditions(self) -> dict[str, Any]:
        """The settings, and the collector as what it was resolved to."""
        return {**self.settings, "collector": str(self.subdivision)}

    def _known(self, asked: MeasurementSettings) -> MeasurementSettings:
        """Settings that were asked for, with what the record knows of the others."""
        found = (WAVELENGTH.fullmatch(name) for name in self.channels)
        nm = tuple(float(match[1]) for match in found if match)
        default, own = DEFAULTS, self.provenance
        return replace(
            default,
            **{name: getattr(asked, name) for name in reported_names(asked, own)},
            collector=self.subdivision,
            hemispheres="both" if self.has_lower else "upper",
            wavelengths=nm or default.wavelengths,
            rays=min(own.rays or default.rays, MAX_RAYS),
            seed=own.seeds[0] if own.seeds else default.seed,
            sampler=own.sampler,
        )


# ------------------------------------------------------------------- values as arrays


def fractions_of(record: Record | PatchMeans) -> Floats:
    """Flux fractions with the incident direction as first axis, also of one."""
    return record.flux_fraction if record.stacked else record.flux_fraction[None]


# ---------------------------------------------------------------------------- channels

# CIE XYZ of the channels R, G and B, linear sRGB (IEC 61966-2-1).
XYZ = np.array(
    [
        [0.412453, 0.357580, 0.180423],
        [0.212671, 0.715160, 0.072169],
        [0.019334, 0.119193, 0.950227],
    ]
)


def wavelengths_nm(channels: Sequence[str]) -> Floats | None:
    """Wavelengths of channels such as ``"550nm"``, shape (n,); None for any others."""
    matches = [re.fullmatch(r"([0-9]+(?:\.[0-9]+)?)nm", name) for name in channels]
    found = [match[1] for match in matches if match]
    return np.array(found, dtype=float) if len(found) == len(channels) else None


def chosen_channel(place: object, names: Sequence[str], channel: str | None) -> str:
    """The channel that is asked for, ``550`` for ``550nm`` too, or the only one.

    Raises
    ------
    SettingError
        If there are several, or none is called so.
    """
    if channel is None and len(names) == 1:
        return names[0]
    for name in (channel, f"{channel}nm"):
        if name in names:
            return str(name)
    known = abridged(", ".join(names), 120)
    found = "; none was said: say --channel"
    if channel is not None:
        found = f", got {shown(channel)}"
    raise SettingError(f"channel must be one of {known} for {place}{found}")


def checked_records(given: Any, several: bool = True) -> list[Record]:
    """List of one record, or of `several`; SettingTypeError for anything else."""
    alone = isinstance(given, Record) or not isinstance(given, Iterable)
    records = [given] if alone or not several else [*given]
    if not records or not all(isinstance(one, Record) for one in records):
        text = f"record must be a Record{' or several' * several}, got {shown(given)}"
        raise SettingTypeError(text)
    return records


def both_sides(records: Iterable[Record]) -> list[Record]:
    """Records, and those of their backs."""
    pairs = ((replace(one, back=None), one.back) for one in records)
    return [one for pair in pairs for one in pair if one is not None]

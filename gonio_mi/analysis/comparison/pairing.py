"""Pairs of points of a record and of another, or a model; unlike conditions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from ...array_types import Integers
from ...collector.directions import direction
from ...collector.hemisphere import EDGE
from ...errors import LABEL, SettingError, abridged, abridged_apart
from ...files.measured_table import MeasuredTable
from ...results.azimuth_symmetry import sharing
from ...results.provenance import shared_seeds
from ...results.record import Record
from ...results.tally import holds_integrals
from ...settings import MeasurementSettings, declarations
from ..points import CountedPoints, Model, Points
from ..points.predictions import near_field
from .agreement import PointPairs


def pair_with_record(
    record: Record, other: Record, relative: float
) -> tuple[list[PointPairs], list[str]]:
    """Sets of points of two records, patch by patch."""
    for what, a, b in (
        ("collector", record.subdivision, other.subdivision),
        ("channels", record.channels, other.channels),
        ("number of incident directions", len(record), len(other)),
    ):
        if a != b:
            raise SettingError(
                f"the records must have the same {what} to be compared patch by patch, "
                f"got {abridged(str(a), 60)} and {abridged(str(b), 60)}"
            )
    notes = unlike_conditions(record, other)
    both = record.has_lower and other.has_lower
    if not both:
        _check_dark_below(record, other, notes)
    sets, alike = [], list(map(max, sharing(record), sharing(other)))
    for k in range(len(record)):
        incident, same = incident_of(record, k), incident_of(other, k)
        if not same_direction(incident, same):
            raise SettingError(
                "the records must have the same incident directions, got (theta_i, "
                f"phi_i) = ({incident[0]:.6g}, {incident[1]:.6g}) and ({same[0]:.6g}, "
                f"{same[1]:.6g}) degrees"
            )
        here = Detectors.of(record, k, 1 + both)
        second = CountedPoints.of(other, k, *here.where)
        sets.append(here.paired(second.with_stated(relative), alike[k]))
    return sets, notes


def pair_with_model(
    record: Record, model: Model, relative: float
) -> tuple[list[PointPairs], list[str]]:
    """Sets of points of a record and of a model, detector by detector."""
    sets = []
    for k in range(len(record)):
        here = Detectors.of(record, k, record.n_hemispheres)
        found = model.points(record[k]).with_stated(relative)
        sets.append(here.paired(found, sharing(record)[k]))
    return sets, notes_on_model(model, record)


@dataclass(eq=False)
class Detectors:
    """Detectors of a record under one incident direction, in each channel."""

    record: Record
    index: int
    hemisphere: Integers
    patch: Integers
    channel: Integers

    @classmethod
    def of(cls, record: Record, index: int, n_hemispheres: int) -> Detectors:
        """Detectors of the upper hemisphere, or of both."""
        shape = n_hemispheres, record.subdivision.n_detectors, len(record.channels)
        return cls(record, index, *(a.ravel() for a in np.indices(shape)))

    @property
    def where(self) -> tuple[Integers, Integers, Integers]:
        """Hemisphere, channel and patch of each."""
        return self.hemisphere, self.channel, self.patch

    def paired(self, other: Points, alike: int) -> PointPairs:
        """Pairs with what was found there otherwise."""
        theta_i, phi_i = incident_of(self.record, self.index)
        theta, phi = (one.ravel() for one in self.record.subdivision.middles)
        theta_o, n = np.degrees(theta)[self.patch], len(self.patch)
        mine = CountedPoints.of(self.record, self.index, *self.where)
        columns = {
            "theta_i": np.full(n, theta_i),
            "phi_i": np.full(n, phi_i),
            "theta_o": np.where(self.hemisphere, 180 - theta_o, theta_o),
            "phi_o": np.degrees(phi)[self.patch],
            "channel": np.array(self.record.channels)[self.channel],
        }
        pairs = zip(self.hemisphere.tolist(), self.channel.tolist())
        keys = [(self.index, *pair) for pair in pairs]
        return PointPairs(columns, mine, other, mine.solid, keys, sharing=alike)


def check_uncertainties(record: Record) -> None:
    """Raise ValueError for a record whose scatter is not known."""
    if record.n_batches >= 2 or all(one.binomial for one in record.estimates):
        return
    if holds_integrals(record.tallies):
        raise SettingError(
            "the record must be of rays, whose scatter is known, got integrals: give "
            "the specimen instead, or measure it with the estimator weighted"
        )
    raise SettingError(
        "the record must have at least 2 batches for its uncertainties to be "
        f"known, got {record.n_batches}"
    )


def incident_of(record: Record, k: int) -> tuple[float, float]:
    """Polar angle and azimuth of an incident direction of a stack, in degrees."""
    return record.theta_i[k], record.phi_i[k]


def same_direction(a: Any, b: Any) -> Any:
    """Whether two directions, in degrees, are equal to single precision."""
    first, second = (direction(*np.radians(pair)) for pair in (a, b))
    return np.linalg.norm(first - second, axis=-1) <= EDGE


def _check_dark_below(record: Record, other: Record, notes: list[str]) -> None:
    """Raise ValueError if light of a hemisphere that one lacks would be left out."""
    which, one = ("first", other) if other.has_lower else ("second", record)
    if not one.has_lower:
        return
    if any(tally.sums[:, 1].any() for tally in one.tallies):
        raise SettingError(
            "the records must have the same hemispheres if light came to the lower "
            f"one: measure the {which} with hemispheres='both'"
        )
    notes.append("only one has a lower hemisphere, to which no light came")


def labels(record: Record, other: Record) -> tuple[str, str]:
    """What tells two records apart, as short texts: a setting that differs."""
    for name in ("specimen", "order", "estimator", "variant", "emitter", "sampler"):
        one, two = (str(r.settings.get(name)) for r in (record, other))
        if one != two:
            prefix = "" if name == "specimen" else f"{name} "
            one, two = abridged_apart([one, two], LABEL)
            return prefix + one, prefix + two
    one, two = (f"seed {r.ray_keys.get('seed')}" for r in (record, other))
    return (one, two) if one != two else ("record", "other")


UNLIKE = "the conditions are not the same, and may change what is measured: "

# What is said of a model beside the data by which it is known.
FITTED = "fitted to these values, with which it agrees better than with others"

# What is declared as a setting, or is known of the light. Estimators, samplers, rays
# and Russian roulette change how well something is known, not what; wavelengths are
# channels; collectors and hemispheres are compared elsewhere.
CONDITIONS = (
    *("side", "footprint", "divergence", "incident", "emission", "emitter"),
    *("collector_radius", "period", "order", "max_depth", "max_scatterings"),
)

# Those that matter for a model, which has far-field light of either side.
OF_MODELS = ("order", "max_depth", "max_scatterings")


def unlike_conditions(
    record: Record, other: Record, names: Sequence[str] = CONDITIONS
) -> list[str]:
    """A note on the conditions in which two records differ; none if they do not."""
    mine, theirs = conditions_of(record), conditions_of(other)
    cut = record.ledger.truncated or other.ledger.truncated
    unlike = [
        f"{name} {abridged(str(mine[name]), 60)} and {abridged(str(theirs[name]), 60)}"
        for name in names
        if name in mine.keys() & theirs.keys()
        and mine[name] != theirs[name]
        and (cut or name not in ("max_depth", "max_scatterings"))
    ]
    key = "emitter_digest"
    if mine.get(key) != theirs.get(key) and mine["emitter"] == theirs["emitter"]:
        unlike.append(f"emitters that are both {mine['emitter']}, but not the same")
    return [UNLIKE + ", ".join(unlike)] if unlike else []


def notes_on_model(model: Model, data: Record | MeasuredTable) -> list[str]:
    """Notes on data that a model was fitted to, or whose conditions differ."""
    own = model.record
    if isinstance(own, MeasuredTable) and isinstance(data, MeasuredTable):
        is_it = own.name == data.name
    else:
        is_it = own is data
    notes = [f"{model.label} was {FITTED}"] * is_it
    here, known = map(_channels, (data, own))
    if here and known and not {*here} <= {*known}:
        texts = (abridged(", ".join(one), 60) for one in (here, known))
        notes.append(UNLIKE + "channels " + " and ".join(texts))
    if isinstance(data, Record):
        notes += [UNLIKE + one for one in near_field(data)]
        if isinstance(own, Record):
            notes += unlike_conditions(data, own, OF_MODELS)
    return notes


def _channels(one: Record | MeasuredTable) -> tuple[str, ...]:
    """Names of channels; empty for monochrome data."""
    if isinstance(one, MeasuredTable):
        return (one.channel,) if one.channel else ()
    return () if one.channels == ("Y",) else one.channels


Measured: TypeAlias = Record | MeasuredTable | Model


def same_rays(first: Sequence[Measured], other: Measured) -> list[str]:
    """Notes on what has the seed, and so the rays, of what it agrees with."""
    if isinstance(other, Record):
        both = "both records"
    else:
        both = f"{other.label if isinstance(other, Model) else other.name} and the "
        both += "record" if isinstance(first[0], Record) else "other"
    seeds = dict.fromkeys(shared_seeds(_rays(one), _rays(other)) for one in first)
    return [
        f"{both} have the seed {seed}: their rays are not independent, so that they "
        "agree too well; measure one again with another seed"
        for seed in filter(None, seeds)
    ]


def _rays(one: Measured) -> Mapping[str, str]:
    """Identifiers of its rays."""
    return one.ray_keys if isinstance(one, Record) else one.rays


def conditions_of(record: Record) -> Mapping[str, Any]:
    """Settings of a record; younger ones than it are as by default."""
    declared = declarations(MeasurementSettings)
    defaults = {
        name: declared[name].text(declared[name].default)
        for name in CONDITIONS
        if name in declared
    }
    del defaults["max_scatterings"]  # it is told where there are media
    return defaults | {"emitter": "DirectionalEmitter"} | dict(record.settings)

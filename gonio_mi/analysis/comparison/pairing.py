"""Pairs of points of a record and of what it is compared with; unlike conditions."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ...array_types import Flags, Floats
from ...collector.apertures import is_above
from ...collector.directions import direction
from ...collector.hemisphere import EDGE
from ...errors import LABEL, SettingError, abridged, abridged_apart
from ...files.measured_table import MeasuredTable
from ...results.azimuth_symmetry import sharing
from ...results.provenance import shared_seeds
from ...results.record import Record
from ...results.tally import holds_integrals
from ...settings import MeasurementSettings, declarations
from ..points import CountedPoints, Points
from .agreement import PointPairs
from .patch_variation import REMEDY, variation_within

DIRECTIONS = ("theta_i", "phi_i", "theta_o", "phi_o")

# Note on a table, which comes before all numbers: they mean little without it.
NO_UNCERTAINTY = (
    "its values count as exact, unless `uncertainty` (--uncertainty) is given"
)


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
    patches = record.subdivision
    n_hemispheres = 2 if both else 1
    shape = n_hemispheres, patches.n_detectors, len(record.channels)
    hemisphere, patch, channel = (a.ravel() for a in np.indices(shape))
    theta, phi = (angle.ravel() for angle in patches.middles)
    theta_o = np.degrees(theta)[patch]
    sets, alike = [], list(map(max, sharing(record), sharing(other)))
    for k in range(len(record)):
        incident, same = _incident(record, k), _incident(other, k)
        if not _same(incident, same):
            raise SettingError(
                "the records must have the same incident directions, got (theta_i, "
                f"phi_i) = ({incident[0]:.6g}, {incident[1]:.6g}) and ({same[0]:.6g}, "
                f"{same[1]:.6g}) degrees"
            )
        where = k, hemisphere, channel, patch
        first = CountedPoints.of(record, *where)
        second = CountedPoints.of(other, *where, relative)
        columns = {
            "theta_i": np.full(len(patch), incident[0]),
            "phi_i": np.full(len(patch), incident[1]),
            "theta_o": np.where(hemisphere, 180 - theta_o, theta_o),
            "phi_o": np.degrees(phi)[patch],
            "channel": np.array(record.channels)[channel],
        }
        keys = [(k, h, c) for h, c in zip(hemisphere.tolist(), channel.tolist())]
        sets.append(
            PointPairs(
                columns,
                first,
                second,
                weight=first.solid,
                total_of=keys,
                sharing=alike[k],
            )
        )
    return sets, notes


def pair_with_table(
    records: Sequence[Record], table: MeasuredTable
) -> tuple[list[PointPairs], list[str]]:
    """Sets of points of a table, each with the records that hold it.

    Points of patches whose variation is not known are left out, with a note.
    """
    notes = [*table.notes, *_stated(table)]
    # the common factor is fitted
    points = Points.of_table(replace(table, scale_uncertainty=0.0))
    sets = []
    hemisphere = int(table.quantity == "btdf")
    v = direction(np.radians(pole_angle(table.theta_o)), np.radians(table.phi_o))
    left, coarse = np.ones(len(table), bool), np.zeros(len(table), bool)
    for record in records:
        if hemisphere and not record.has_lower:
            raise SettingError(
                f"{table.name} holds btdf, but the record has no lower hemisphere; "
                "measure it with hemispheres='both'"
            )
        channel = _channel(record, table, notes)
        notes += unlike_incident_cone(record, table)
        patch, held = record.subdivision.detectors(v)
        in_patches = _stand_for_points(record.subdivision, table)
        for k in range(len(record)):
            incident = _incident(record, k)
            here = left & held & _same(incident, (table.theta_i, table.phi_i))
            left &= ~here
            of_patches = partial(CountedPoints.of, record, k, hemisphere, channel)
            variation = None
            if in_patches and here.any():
                inside = record.subdivision, patch[here]
                variation, known = variation_within(*inside, of_patches)
                coarse[here], here[here] = ~known, known
            if not (n := int(here.sum())):
                continue
            columns: dict[str, Any] = {k: getattr(table, k)[here] for k in DIRECTIONS}
            means = of_patches(patch[here])
            sets.append(
                PointPairs(
                    columns | {"channel": np.full(n, record.channels[channel])},
                    means,
                    points[here],
                    weight=means.solid,
                    total_of=[tuple(np.round(incident, 3))] * n,
                    variation=variation,
                    sharing=sharing(record)[k],
                )
            )
    beyond = left & _reach_below(records, table)
    if beyond.any() and not beyond.all():
        notes.append(
            f"{beyond.sum()} of {len(table)} points, whose apertures reach below the "
            "horizon, are left out"
        )
        left &= ~beyond
    if left.any():
        raise SettingError(_lacking(records, table, int(np.argmax(left))))
    _tell_coarse(records[0], table, coarse, notes)
    return sets, list(dict.fromkeys(notes))


def _stated(table: MeasuredTable) -> list[str]:
    """Notes on the uncertainties that a table states, or does not."""
    notes = []
    if not (table.bsdf_std_err.any() or table.scale_uncertainty):
        stated = "no uncertainty" if table.sigma is None else "an uncertainty of 0"
        notes.append(f"{table.name} states {stated}: {NO_UNCERTAINTY}")
    if table.sigma is not None and table.uncertainty:
        notes.append(
            f"the uncertainty of {table.uncertainty:.3g} of each value adds to that of "
            "the column in quadrature"
        )
    return notes


def _stand_for_points(patches: Any, table: MeasuredTable) -> bool:
    """Whether means over patches stand for the points of a table.

    False for apertures, and if the table itself holds patch means, as exported files
    do; ValueError if the apertures are not as wide as those of the table.
    """
    own, stated = patches.aperture_half_angle, table.aperture_half_angle
    if own is None:
        return table.header.get("collector") != str(patches)
    if stated is not None and not np.isclose(stated, own, rtol=EDGE, atol=0):
        raise SettingError(
            f"the record's apertures must have the half-angle of {table.name}, "
            f"{stated:g} degrees, got {own:g}"
        )
    return False


def _reach_below(records: Sequence[Record], table: MeasuredTable) -> Flags:
    """Points around which the apertures of records cannot stand."""
    half_angle = records[0].subdivision.aperture_half_angle
    if half_angle is None:
        return np.zeros(len(table), bool)
    return ~np.asarray(is_above(pole_angle(table.theta_o), half_angle))


def _tell_coarse(
    record: Record, table: MeasuredTable, coarse: Flags, notes: list[str]
) -> None:
    """Note points that were left out; ValueError if these are all."""
    n = int(coarse.sum())
    if not n:
        return
    why = (
        f"the patches of {abridged(str(record.subdivision), 40)} are too coarse for "
        f"{n} of {len(table)} points, where lobes are steep or the horizon is near"
    )
    if n == len(table):
        raise SettingError(f"{why}: {REMEDY}")
    notes.append(f"{why}: these are left out")


def _lacking(records: Sequence[Record], table: MeasuredTable, row: int) -> str:
    """Sentence on what no record has of a row of the table."""
    incident = (table.theta_i[row], table.phi_i[row])
    own = [one for r in records for one in zip(r.theta_i, r.phi_i)]
    if any(_same(one, incident) for one in own):
        what, known = "aperture around theta_o, phi_o", "others"
        of = (table.theta_o[row], table.phi_o[row])
    else:
        what, of = "incident direction", incident
        known = "; ".join(
            f"{theta:.6g}, {phi:.6g}"
            for record in records[:4]
            for theta, phi in zip(record.theta_i[:4], record.phi_i[:4])
        )
    return (
        f"the record must have each {what} of {table.name}, but lacks "
        f"{of[0]:g}, {of[1]:g} degrees (it has {known})"
    )


def _channel(record: Record, table: MeasuredTable, notes: list[str]) -> int:
    """Index of the record's channel that a table's values belong to."""
    names = list(record.channels)
    if table.channel in names:
        return names.index(table.channel)
    if names == ["Y"] and table.channel is not None:
        of = f"{table.channel} of the table"
        notes.append(f"the record is monochrome: it stands for {of}")
    if names == ["Y"] or (table.channel is None and len(names) == 1):
        return 0
    said = "no channel" if table.channel is None else f"channel {table.channel}"
    raise SettingError(
        f"the table's header must name a channel of the record "
        f"({', '.join(names)}), but {table.name} names {said}"
    )


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


def _incident(record: Record, k: int) -> tuple[float, float]:
    """Polar angle and azimuth of an incident direction of a stack, in degrees."""
    return record.theta_i[k], record.phi_i[k]


def _same(a: Any, b: Any) -> Any:
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


def pole_angle(theta_o: Floats) -> Floats:
    """Angle from the pole of its own hemisphere, in degrees."""
    return np.where(theta_o > 90, 180 - theta_o, theta_o)


UNLIKE = "the conditions are not the same, and may change what is measured: "

# What is declared as a setting, or is known of the light. Estimators, samplers, rays
# and Russian roulette change how well something is known, not what; wavelengths are
# channels; collectors and hemispheres are compared elsewhere.
CONDITIONS = (
    *("side", "footprint", "divergence", "incident", "emission", "emitter"),
    *("collector_radius", "period", "order", "max_depth", "max_scatterings"),
)


def unlike_conditions(record: Record, other: Record) -> list[str]:
    """A note on the conditions in which two records differ; none if they do not."""
    mine, theirs = _known(record), _known(other)
    cut = record.ledger.truncated or other.ledger.truncated
    unlike = [
        f"{name} {abridged(str(mine[name]), 60)} and {abridged(str(theirs[name]), 60)}"
        for name in CONDITIONS
        if name in mine.keys() & theirs.keys()
        and mine[name] != theirs[name]
        and (cut or name not in ("max_depth", "max_scatterings"))
    ]
    key = "emitter_digest"
    if mine.get(key) != theirs.get(key) and mine["emitter"] == theirs["emitter"]:
        unlike.append(f"emitters that are both {mine['emitter']}, but not the same")
    return [UNLIKE + ", ".join(unlike)] if unlike else []


def unlike_incident_cone(record: Record, table: MeasuredTable) -> list[str]:
    """A note on light that came in another cone than a table says; or none."""
    known, told = _known(record), table.emitter_half_angle
    collimated = str(known["emitter"]).startswith("Directional")
    # where the table is silent, a divergence was said with the comparison
    other_cone = collimated and told and abs(known["divergence"] - told) > 1e-6
    if known["incident"] != "none":
        said = f"filled patches of incidence ({abridged(str(known['incident']), 40)})"
    elif other_cone:
        said = f"had a divergence of {known['divergence']:g} degrees"
    else:
        return []
    light = f"the light of {table.name} came within {told:g} degrees"
    return [f"{UNLIKE}{light}, that of the record {said}"]


def same_rays(records: Sequence[Record], other: Record | MeasuredTable) -> list[str]:
    """Notes on records that have the seed, and so the rays, of what they agree with."""
    if isinstance(other, MeasuredTable):
        both, theirs = f"{other.name} and the record", other.rays
    else:
        both, theirs = "both records", other.ray_keys
    seeds = dict.fromkeys(shared_seeds(one.ray_keys, theirs) for one in records)
    return [
        f"{both} have the seed {seed}: their rays are not independent, so that they "
        "agree too well; measure one again with another seed"
        for seed in filter(None, seeds)
    ]


def _known(record: Record) -> Mapping[str, Any]:
    """Settings of a record; younger ones than it are as by default."""
    declared = declarations(MeasurementSettings)
    defaults = {
        name: declared[name].text(declared[name].default)
        for name in CONDITIONS
        if name in declared
    }
    del defaults["max_scatterings"]  # it is told where there are media
    return defaults | {"emitter": "DirectionalEmitter"} | dict(record.settings)

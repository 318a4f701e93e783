"""Pairs of points of tables and of what they are compared with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from ...array_types import Flags, Floats, Integers
from ...collector.apertures import is_above
from ...collector.directions import direction
from ...collector.hemisphere import EDGE
from ...errors import SettingError, abridged, number_of
from ...files.measured_table import COLUMNS, MeasuredTable
from ...results.azimuth_symmetry import sharing
from ...results.record import Record
from ..points import CountedPoints, Model, Points
from .agreement import PointPairs
from .pairing import UNLIKE, conditions_of, incident_of, notes_on_model, same_direction
from .patch_variation import REMEDY, variation_within

DIRECTIONS = ("theta_i", "phi_i", "theta_o", "phi_o")

# Farthest that directions of two tables may be apart, whose angles are often rounded to
# a hundredth of a degree.
SAME = np.radians(0.01)

# Note on a table, which comes before all numbers: they mean little without it.
NO_UNCERTAINTY = (
    "its values count as exact, unless `uncertainty` (--uncertainty) is given"
)


def pair_with_table(
    records: Sequence[Record], table: MeasuredTable
) -> tuple[list[PointPairs], list[str]]:
    """Sets of points of a table, each with the records that hold it.

    Points of patches whose variation is not known are left out, with a note.
    """
    notes = [*table.notes, *_stated(table)]
    points = _values(table)
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
            incident = incident_of(record, k)
            here = left & held & same_direction(incident, (table.theta_i, table.phi_i))
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


def pair_at_table(
    first: Any, other: MeasuredTable | Model, relative: float
) -> tuple[list[PointPairs], list[str]]:
    """Points of a table and of a model, or those that two tables have in common.

    Parameters
    ----------
    first, other : MeasuredTable or Model
        At least one of them a table.
    relative : float
        Standard uncertainty of the values of a model that is the other.
    """
    if not isinstance(other, MeasuredTable):
        table, notes = first, [*notes_on_model(other, first), *_stated(first)]
        mine, theirs = _values(table), other.points(table).with_stated(relative)
    elif isinstance(first, Model):
        table, notes = other, [*notes_on_model(first, other), *_stated(other)]
        mine, theirs = first.points(table), _values(table)
    else:
        table, mine, theirs, notes = _common(first, other)
    columns: dict[str, Any] = {name: getattr(table, name) for name in DIRECTIONS}
    columns["channel"] = np.full(len(table), table.channel or "Y")
    weight = np.abs(np.cos(np.radians(columns["theta_o"])))
    incident = np.round([columns["theta_i"], columns["phi_i"]], 3).T.tolist()
    total_of = [tuple(one) for one in incident]
    return [PointPairs(columns, mine, theirs, weight, total_of)], notes


def _values(table: MeasuredTable) -> Points:
    """Values of a table without its common factor, which is fitted."""
    return Points.of_table(replace(table, scale_uncertainty=0.0))


def _common(
    first: MeasuredTable, other: MeasuredTable
) -> tuple[MeasuredTable, Points, Points, list[str]]:
    """Rows of the other in directions of both, the values of each there, and notes.

    Values of one direction count together, as their mean.
    """
    _check_alike(first, other)
    notes = list(dict.fromkeys([*_stated(first), *_stated(other)]))
    (mine, own, told), (theirs, rows, also) = map(_means, (first, other))
    names = table_names(first, other)
    notes += [f"{name} {said}" for name, said in zip(names, (told, also)) if said]
    where = _directions(first)[own], _directions(other)[rows]
    distance, nearest = cKDTree(where[0]).query(where[1])
    shared = np.flatnonzero(distance <= SAME)
    if not len(shared):
        raise SettingError(
            "two tables are compared where they have the same directions, but "
            f"{names[0]} has none of {names[1]} within {np.degrees(SAME):.2g} "
            "degrees: a model that is fitted to one of them has values everywhere"
        )
    if len(shared) < len(rows):
        notes.append(
            f"{len(shared)} of the {len(rows)} points of {names[1]} are in "
            f"{names[0]} too: the others are left out"
        )
    shared = shared[np.argsort(nearest[shared], kind="stable")]
    for name in ("aperture_half_angle", "emitter_half_angle"):
        one, two = getattr(first, name), getattr(other, name)
        if one != two:
            notes.append(f"{UNLIKE}{name} {one} and {two}")
    columns = {name: getattr(other, name)[rows[shared]] for name in COLUMNS}
    sigma = None if other.sigma is None else other.sigma[rows[shared]]
    table = replace(other, **columns, sigma=sigma)
    return table, mine[nearest[shared]], theirs[shared], notes


def _check_alike(first: MeasuredTable, other: MeasuredTable) -> None:
    """Raise ValueError for tables of unlike light, or without any uncertainty."""
    names = table_names(first, other)
    for name in ("quantity", "channel"):
        one, two = getattr(first, name), getattr(other, name)
        alike = (one == "btdf") == (two == "btdf") if name == "quantity" else one == two
        if not alike:
            raise SettingError(
                f"the tables must hold the same {name} to be compared, got {one} of "
                f"{names[0]} and {two} of {names[1]}"
            )
    if not any(
        one.bsdf_std_err.any() or one.scale_uncertainty for one in (first, other)
    ):
        raise SettingError(
            f"a comparison needs an uncertainty, but neither {names[0]} nor "
            f"{names[1]} states one: give `uncertainty` (--uncertainty)"
        )


def table_names(first: MeasuredTable, other: MeasuredTable) -> tuple[str, str]:
    """What to call two tables, of which only one may have a name."""
    if first.name != other.name:
        return first.name, other.name
    return "the first table", "the second table"


def _means(table: MeasuredTable) -> tuple[Points, Integers, str]:
    """Values without repeats, the row of each, and a note on how many there were."""
    points, where = _values(table), _directions(table)
    rounded = np.round(where / SAME).astype(int)
    _, rows, group, n = np.unique(
        rounded, axis=0, return_index=True, return_inverse=True, return_counts=True
    )
    if len(rows) == len(table):
        return points, np.arange(len(table)), ""
    order = np.argsort(rows)  # as in the table
    group, n, rows = np.argsort(order)[group.ravel()], n[order], rows[order]
    value, variance, welch = (
        np.bincount(group, one) / n**power
        for one, power in ((points.value, 1), (points.std_err**2, 2), (points.welch, 4))
    )
    dof = np.full(len(rows), np.inf)
    np.divide(variance**2, welch, out=dof, where=welch > 0)
    means = Points(value, np.sqrt(variance), dof=dof)
    said = f"has several values in {number_of(int(np.sum(n > 1)), 'direction')}: "
    return means, rows, said + "their means are compared"


def _directions(table: MeasuredTable) -> Floats:
    """Unit vectors of incidence and exit, shape (n, 6)."""
    pairs = (table.theta_i, table.phi_i), (table.theta_o, table.phi_o)
    return np.hstack([direction(*np.radians(pair)) for pair in pairs])


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
    if any(same_direction(one, incident) for one in own):
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


def unlike_incident_cone(record: Record, table: MeasuredTable) -> list[str]:
    """A note on light that came in another cone than a table says; or none."""
    known, told = conditions_of(record), table.emitter_half_angle
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


def pole_angle(theta_o: Floats) -> Floats:
    """Angle from the pole of its own hemisphere, in degrees."""
    return np.where(theta_o > 90, 180 - theta_o, theta_o)

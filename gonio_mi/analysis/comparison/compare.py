"""Comparison of a record with another record or with measured values: the tests."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ...array_types import Flags, Floats
from ...collector.directions import azimuths_deg
from ...errors import (
    LABEL,
    SettingError,
    SettingTypeError,
    abridged,
    abridged_apart,
    checked_number,
    shown,
)
from ...files.measured_table import ANGLE_DIGITS, COLUMNS, NUMBERS, MeasuredTable
from ...results.record import Record, checked_records
from ...results.tally import (
    ELEMENT_NAMES,
    PolarisedTally,
    holds_integrals,
    without_chance,
)
from ...specimen.specimen_text import SpecimenLike
from ..points import Model
from .agreement import MIN_STUDENT_HITS, PointPairs, judge, mostly_few
from .comparison import Comparison
from .measure_like import is_specimen, measure_like
from .pairing import (
    FITTED,
    check_uncertainties,
    labels,
    pair_with_model,
    pair_with_record,
    same_rays,
)
from .patch_variation import left_undecided
from .table_pairs import pair_at_table, pair_with_table, table_names

# Note on a record of integrals.
OF_EVAL = (
    "the values are integrals of eval, to their own error: whether sample agrees with "
    "it, gonio-mi validate tells"
)

# Note on quasi-Monte Carlo rays.
POWERLESS = (
    f"with quasi-Monte Carlo rays and fewer than {MIN_STUDENT_HITS} hits in most "
    "patches the chi-square has next to no power to find a difference; take more "
    "rays, or the sampler independent"
)

# Probability with which a right model is rejected.
ALPHA = 1e-3


def compare(
    record: Record | Sequence[Record] | MeasuredTable | Model | SpecimenLike,
    other: Record | MeasuredTable | Model | SpecimenLike,
    *,
    uncertainty: float | None = None,
    scale_uncertainty: float | None = None,
    alpha: float = ALPHA,
    **settings: Any,
) -> Comparison:
    r"""Compare a record, a table or a fit with another one.

    The difference of each point over its standard error, from both uncertainties, is
    taken as Student's t with Welch's degrees of freedom, or those of a table if they
    are fewer, and turned into the normal score z of the same probability. A patch with
    fewer than 1000 hits has the smaller score of that and of the exact test of its hits
    (of Poisson's law, spread by the uncertainty of the measured value; for two records
    given their sum), so that empty patches count too. Three tests share `alpha`
    (Bonferroni):

    * the sum of the squares of z (and of the fitted common factor, in units of its
      uncertainty), as a chi-square whose degrees of freedom ``n**2 / trace(R**2)`` come
      from the correlation R of the points that the batches tell. Errors of a fit's
      parameters are common to all directions, and each is a chi-square of its own.
      Quasi-Monte Carlo rays (`sobol`) scatter less than the exact test of few hits
      allows: with fewer than 1000 hits in most patches this test has next to no power,
      on the safe side, and a note says so;
    * the largest ``abs(z)``, as if the points were independent, which is on the safe
      side (Sidak);
    * the flux through all points together, per incident direction, hemisphere and
      channel, if it had 1000 hits: a small error everywhere shows here.

    Parameters
    ----------
    record : Record, sequence of Record, MeasuredTable, Fit, dict, str or path
        Several, if `other` is a table: what `measure_like` returns. A specimen (a
        dictionary, an object of Mitsuba, a scene file) is measured as `other` was. Two
        tables are compared where they have the same directions. Of a record or a
        specimen beside a table or a fit, the former comes first in the result.
    other : Record, MeasuredTable, Fit, dict, str or path
        A specimen is measured as the record was. A fit has the values of its model at
        the detectors of a record, or at the points of a table, with the covariance of
        its parameters. Of two tables values of one direction count as their mean.
        A record must have the same collector, channels and incident directions: there
        is no honest way from one set of patch means to another. Where only one has a
        lower hemisphere, no light may have come there. Of records of polarised variants
        all elements of Mueller matrices are compared, as half the sum of each with the
        first one; with a record or table without them the first one alone. A note tells
        other conditions that are not the same: side, footprint, divergence, order and
        so on; and, if they agree, a seed that is the same, as then the rays are, too.
        Of a table each point is compared with the mean of the patch that holds it,
        within what the BRDF may do there; points of patches that are too coarse are
        left out.
    uncertainty : float, optional
        Relative standard uncertainty of each value of `other`, independent between
        points and in addition to what `other` knows itself: 0.005 is 0.5 %. Default:
        what the table says.
    scale_uncertainty : float, optional
        The same of a factor common to all its values: calibration.
    alpha : float
        Probability in (0, 1) with which two that have the same true values fail.
    **settings
        Of `measure_like`, for a specimen.

    Returns
    -------
    Comparison

    Raises
    ------
    TypeError, ValueError
        If the two cannot be compared: the message names what differs.
    """
    alpha = checked_number("alpha", alpha, 1e-100, 1, "a probability between 0 and 1")
    first, other = _with_specimen_measured(record, other, settings)
    given = {"uncertainty": uncertainty, "scale_uncertainty": scale_uncertainty}
    if isinstance(other, MeasuredTable):
        stated: Any = {name: x for name, x in given.items() if x is not None}
        other = replace(other, **stated)
    records = [] if isinstance(first, (MeasuredTable, Model)) else first
    integrated = not isinstance(other, Record) and any(
        without_chance(one.tallies) for one in records
    )
    for one in (*records, other):
        if isinstance(one, Record) and not integrated:
            check_uncertainties(one)
    sets, notes, compared, scale = _paired(first, other, given)
    if integrated:
        notes.append(OF_EVAL)
    measured = [*records, other] if isinstance(other, Record) else records
    z, errors, statistics, p_values = judge(sets, scale)
    if len(p_values) * min(p_values.values()) >= alpha:
        if not any(note.endswith(FITTED) for note in notes):
            notes += same_rays(records or [first], other)
        if any(map(_is_even, measured)) and mostly_few(sets):
            notes.append(POWERLESS)
    undecided = left_undecided(sets, scale, p_values, alpha, notes)
    points = [
        one.columns
        | {"value": one.mine.value, "std_err": one.mine.reported_error}
        | {"other": one.other.value}
        for one in sets
    ]
    names = (*sets[0].columns, "value", "std_err", "other")
    columns = {name: np.concatenate([one[name] for one in points]) for name in names}
    columns |= {name: azimuths_deg(columns[name]) for name in ("phi_i", "phi_o")}
    found = Comparison(
        **columns,
        other_std_err=errors,
        z=z,
        statistics=statistics,
        p_values=p_values,
        alpha=alpha,
        notes=tuple(notes),
        labels=compared,
        undecided=undecided,
        within_patches=any(one.variation is not None for one in sets),
    )
    if records and isinstance(other, MeasuredTable) and found.verdict == "differ":
        more = _note_on_azimuths(records, other, alpha)
        found = replace(found, notes=(*found.notes, *more))
    return found


def _with_specimen_measured(
    record: Any, other: Any, settings: dict[str, Any]
) -> tuple[Any, Any]:
    """The two sides; a specimen is measured as the other side was."""
    sides = Record, MeasuredTable, Model
    if isinstance(other, Record) and isinstance(record, (MeasuredTable, Model)):
        record, other = other, record
    if is_specimen(other) and isinstance(record, MeasuredTable):
        record, other = other, record
    if is_specimen(record) and isinstance(other, (Record, MeasuredTable)):
        record = measure_like(record, other, **settings)
    elif is_specimen(other) and isinstance(record, Record):
        other = measure_like(other, record, **settings)[0]
    elif settings:
        raise SettingTypeError(f"{min(settings)} applies to a specimen, got none")
    if isinstance(other, Model) and not isinstance(record, (*sides[:2], Sequence)):
        raise SettingTypeError(
            f"a fit is compared with a record or a table, got {shown(record)}"
        )
    if not isinstance(other, sides):
        raise SettingTypeError(
            f"other must be a Record, a MeasuredTable or a Fit, got {shown(other)}"
        )
    if isinstance(record, (MeasuredTable, Model)):
        return record, other
    records = checked_records(record)
    if not isinstance(other, MeasuredTable) and len(records) != 1:
        raise SettingTypeError(
            "record must be one Record, unless the other is a table, got several"
        )
    return records, other


def _note_on_azimuths(
    records: Sequence[Record], table: MeasuredTable, alpha: float
) -> list[str]:
    """Note that a table would agree, were its azimuths counted in another way."""
    ways = {
        "its mirror image at the plane of incidence": 2 * table.phi_i - table.phi_o,
        "the table with azimuths of exit clockwise": -table.phi_o,
        "the table with azimuths of exit 180 degrees on": table.phi_o + 180,
    }
    for way, azimuth in ways.items():
        if np.allclose(*np.exp(1j * np.radians([table.phi_o, azimuth]))):
            continue  # all in the plane of incidence
        turned = replace(table, phi_o=azimuth)
        try:
            sets, notes = pair_with_table(records, turned)
        except SettingError:  # apertures stand elsewhere: most of them may not
            both = _measured_both_ways(table, azimuth)
            if 2 * both.sum() < len(table):
                continue
            names = [*COLUMNS, *(["sigma"] if table.sigma is not None else [])]
            columns = {name: getattr(turned, name)[both] for name in names}
            turned = replace(turned, **columns)
            sets, notes = pair_with_table(records, turned)
        scale = table.scale_uncertainty
        p_values = judge(sets, scale)[3]
        undecided = left_undecided(sets, scale, p_values, alpha, notes)
        if not undecided and len(p_values) * min(p_values.values()) >= alpha:
            return [f"{way} would agree"]
    return []


def _measured_both_ways(table: MeasuredTable, azimuth: Floats) -> Flags:
    """Points whose direction of exit is the table's with the other azimuths too."""

    def places(phi_o: Floats) -> list[tuple[float, ...]]:
        """Both directions of each point, rounded."""
        polar = table.theta_i, table.theta_o
        turns = np.radians([table.phi_i, phi_o])
        columns = np.round([*polar, *np.cos(turns), *np.sin(turns)], ANGLE_DIGITS) + 0.0
        return [tuple(one) for one in columns.T.tolist()]

    known = {*places(table.phi_o)}
    return np.array([place in known for place in places(azimuth)])


def _paired(
    first: Sequence[Record] | MeasuredTable | Model,
    other: Any,
    given: Mapping[str, float | None],
) -> tuple[list[PointPairs], list[str], tuple[str, str], float]:
    """Sets of points, notes, labels, and the uncertainty of a common factor.

    Of records that both have Mueller matrices all elements are channels.
    """
    relative, scale = (
        checked_number(name, value or 0, *NUMBERS[name])
        for name, value in given.items()
    )
    if isinstance(other, MeasuredTable):
        scale = other.scale_uncertainty
    if isinstance(first, (MeasuredTable, Model)):
        sets, notes = pair_at_table(first, other, relative)
        one, two = _label(first), _label(other)
        if isinstance(first, MeasuredTable):
            scale = float(np.hypot(scale, first.scale_uncertainty))
            if isinstance(other, MeasuredTable):
                one, two = abridged_apart(table_names(first, other), LABEL)
        return sets, notes, (one, two), scale
    record, told = first[0], []
    if isinstance(other, MeasuredTable):
        sets, notes = pair_with_table(first, other)
        return sets, notes, (_label(record), _label(other)), scale
    if isinstance(other, Model):
        sets, notes = pair_with_model(record, other, relative)
        return sets, notes, (_label(record), _label(other)), scale
    compared = labels(record, other)
    if record.polarised and other.polarised:
        record, other = _as_channels(record), _as_channels(other)
    elif record.polarised or other.polarised:
        told.append("one record has no Mueller matrices: M00 is compared")
    sets, notes = pair_with_record(record, other, relative)
    return sets, told + notes, compared, scale


def _label(one: Record | MeasuredTable | Model) -> str:
    """What to call one of two."""
    if isinstance(one, Model):
        return abridged(f"fit of {one.label}", LABEL)
    return abridged(one.provenance.name if isinstance(one, Record) else one.name, LABEL)


def _as_channels(record: Record) -> Record:
    """Record of light whose channels are elements, each with half of the first."""
    names = ["", *(f" (M00 + {element})/2" for element in ELEMENT_NAMES)]
    tallies = [one for one in record.tallies if isinstance(one, PolarisedTally)]
    return replace(
        record,
        channels=tuple(f"{one}{name}" for name in names for one in record.channels),
        tallies=tuple(one.halves() for one in tallies),
    )


def _is_even(record: Record) -> bool:
    """Whether its rays are quasi-Monte Carlo: more even than independent ones."""
    sampled = not holds_integrals(record.tallies)
    return sampled and record.provenance.sampler != "independent"

"""A specimen, measured the way that a table or a record was."""

import os
from collections.abc import Sequence
from contextlib import nullcontext
from typing import Any

import mitsuba as mi
import numpy as np

from ...campaigns.execution import ExecutionContext, records_of
from ...campaigns.measure import measure_whole
from ...collector.apertures import Apertures, disjoint_groups, is_above
from ...collector.directions import direction
from ...collector.hemisphere import Subdivision
from ...errors import (
    SettingError,
    SettingTypeError,
    SpecimenError,
    VariantError,
    muted,
    shown,
)
from ...files.measured_table import MeasuredTable
from ...progress import counted
from ...results.record import Record, wavelengths_nm
from ...results.tally import holds_integrals, without_chance
from ...settings.measurement_settings import ANY_SPECIMEN
from ...specimen.specimen_text import SpecimenLike
from .table_pairs import pole_angle

# Distance in scene units that stands for a source far away.
FAR_DISTANCE = 1000.0

# Relative standard error of each aperture, by itself: a quarter of the table's own, in
# between these, or the lower where the table has none; and rays at most.
ERROR_RATIO, MIN_REL_ERR, MAX_REL_ERR = 0.25, 1e-3, 1e-2
# Error of integrals, which is no matter of chance, beside that.
INTEGRAL_RATIO = 0.1
MAX_RAYS = 10**8

# Settings of a record with which it can be measured again.
REPEATED_SETTINGS = (
    *("estimator", "points", "footprint", "divergence", "emission"),
    *("max_depth", "rr_depth"),
    *("period", "order", "side", "collector_radius", "incident"),
)
SAMPLING_SETTINGS = ("rays", "sampler", "batches")

PRECISION_SETTINGS = {"rays", "rel_err", "noise", "estimator", "trace"}


def measure_like(
    specimen: SpecimenLike,
    like: MeasuredTable | Record,
    *,
    aperture_half_angle: float | None = None,
    seed: int | None = None,
    progress: bool = False,
    **settings: Any,
) -> tuple[Record, ...]:
    """Measure at the solid angles of a table's points, or as a record was measured.

    Around each direction of a table stands a circular aperture, so that no patch mean
    stands for a point; a table of patch means, as `export` writes them, has its own
    patches, unless an aperture is given. Apertures that overlap are measured one group
    after the other, each with its own rays. Unless `rays`, `rel_err`, `noise`,
    `estimator` or `trace` is given, rays are taken until their error is small beside
    the table's; light is deposited from every event towards every aperture
    (``next_event``, traced). On a flat specimen without delta components no ray is
    needed: ``eval`` is integrated over each aperture (``quadrature``), to an error that
    is nothing beside that of the table. A table that states no uncertainty is compared
    with rays all the same, whose scatter it is then judged by.

    Parameters
    ----------
    specimen : dict, mi.BSDF, mi.Scene, str or path
        See :func:`measure`.
    like : MeasuredTable or Record
        The `emitter_half_angle` of a table makes a round source of uniform radiance at
        `emitter_distance`, by default far away; without it the beam is collimated, or
        has the `divergence` that is given; in a spectral variant its channel, such as
        ``"550nm"``, is the wavelength. Of a record the collector, the incident
        directions, the wavelengths and what else it knows of its measurement are taken;
        it must have been lit by a collimated beam.
    aperture_half_angle : float, optional
        In degrees, if the table does not say it.
    seed : int, optional
        By default 0, from which others are derived; for a record the next one to its
        own, so that rays are others.
    progress : bool
        Show a progress bar on standard error, of incident directions.
    **settings
        Of :func:`measure`; `rays` are those of each direction. `executor` and `folder`
        are for directions that share a collector, which apertures do not.

    Returns
    -------
    tuple of Record
        One or more for each incident direction of the table, for :func:`compare`; or
        one that is like the record.

    Raises
    ------
    TypeError, ValueError
        If there is neither aperture's half-angle nor collector, or every aperture
        reaches below the horizon, where those that do are left out; and as
        :func:`measure`.
    """
    for key in {"theta_i", "phi_i", "collector"} & settings.keys():
        what = "record" if isinstance(like, Record) else "table"
        raise SettingTypeError(
            f"{key} must come from the {what}, got {shown(settings[key])}"
        )
    if isinstance(like, Record):
        if aperture_half_angle is not None:
            raise SettingError(
                "aperture_half_angle applies to tables only, for a record has its "
                f"collector, got {shown(aperture_half_angle)}"
            )
        return (_like_record(specimen, like, seed, settings, progress),)
    half_angle = like.aperture_half_angle or aperture_half_angle
    patches_or_angle = like.patches if half_angle is None else half_angle
    if patches_or_angle is None:
        raise without_aperture(like)
    return _like_table(specimen, like, patches_or_angle, seed or 0, settings, progress)


def is_specimen(thing: object) -> bool:
    """Whether something is what is measured: a dictionary, an object, a scene file."""
    is_file = isinstance(thing, (str, os.PathLike)) and str(thing).endswith(".xml")
    return is_file or isinstance(thing, (dict, mi.Object))


def without_aperture(table: MeasuredTable) -> SettingError:
    """Error for a table that does not say its detector, of which nothing was said."""
    return SettingError(
        f"aperture_half_angle (--aperture-half-angle) must be given: {table.name} "
        "does not say it"
    )


def _like_table(
    specimen: SpecimenLike,
    table: MeasuredTable,
    patches_or_angle: Subdivision | float,
    seed: int,
    settings: dict[str, Any],
    progress: bool,
) -> tuple[Record, ...]:
    """Records in the patches of a table, or in apertures of a half-angle."""
    if table.emitter_half_angle:
        if settings.get("divergence"):
            raise SettingError(
                f"divergence applies to a collimated beam, but {table.name} has an "
                f"emitter_half_angle of {table.emitter_half_angle:g} degrees"
            )
        distance = table.emitter_distance or FAR_DISTANCE
        settings.setdefault("emitter", far_source([table.emitter_half_angle], distance))
    nm = wavelengths_nm([table.channel or ""])
    if nm is not None and mi.is_spectral:
        settings.setdefault("wavelengths", nm.tolist())
    lower = "both" if table.quantity == "btdf" else "upper"
    settings.setdefault("hemispheres", lower)
    asked = {k for k in PRECISION_SETTINGS & settings.keys() if settings[k] is not None}
    if not asked:
        settings |= {"max_rays": MAX_RAYS, "rays": None}
    # the comparison knows which precision was reached
    ignored = "(rel_err|noise) of .* was not reached"
    with nullcontext() if asked else muted(ignored):
        if not isinstance(patches_or_angle, Subdivision):
            ways = [settings | way for way in ([{}] if asked else _ways(table))]
            return _in_apertures(
                specimen, table, patches_or_angle, seed, ways, progress
            )
        if not asked:
            settings["noise"] = _noise(table, patches_or_angle)
        settings |= {"collector": patches_or_angle, "seed": _other_seed(seed, 0)}
        return tuple(_stack(specimen, table.incident, settings, progress))


def _in_apertures(
    specimen: SpecimenLike,
    table: MeasuredTable,
    half_angle: float,
    seed: int,
    ways: list[dict[str, Any]],
    progress: bool,
) -> tuple[Record, ...]:
    """Records in apertures of a half-angle, measured in the first way that can."""
    records: list[Record] = []
    for theta_i, phi_i in counted(table.incident, progress, unit="direction"):
        here = (table.theta_i == theta_i) & (table.phi_i == phi_i)
        here &= is_above(pole_angle(table.theta_o), half_angle)
        theta_o = pole_angle(table.theta_o[here])
        # the same direction once, whatever the turn of its azimuth
        cones = dict.fromkeys(zip(theta_o.tolist(), (table.phi_o[here] % 360).tolist()))
        for group in disjoint_groups(list(cones), half_angle) if cones else []:
            n = len(records)
            own = {
                "theta_i": theta_i,
                "phi_i": phi_i,
                "collector": Apertures(half_angle, tuple(group)),
                "seed": _other_seed(seed, n) if n or table.rays else seed,
            }
            records.append(first_that_can(specimen, ways, own))
    if not records:
        raise SettingError(
            f"each aperture of half-angle {half_angle:g} degrees of {table.name} "
            "reaches below the horizon"
        )
    return tuple(records)


def _other_seed(seed: int, n: int) -> int:
    """Seed derived from another, which a table may be of that is a record's."""
    return int(np.random.SeedSequence((seed, n)).generate_state(1)[0])


def _stack(
    specimen: SpecimenLike,
    incidents: Sequence[tuple[float, float]],
    settings: dict[str, Any],
    progress: bool,
) -> Record:
    """Stack of incident directions, which share launches, tasks or workers."""
    executor, folder = settings.get("executor"), settings.get("folder")
    where = ExecutionContext(executor, folder, progress=progress)
    own = {k: v for k, v in settings.items() if k not in ("executor", "folder")}
    return records_of({"specimen": specimen}, incidents, where, own)["specimen"]


def _ways(table: MeasuredTable) -> list[dict[str, Any]]:
    """Settings to measure a table's apertures with, the cheapest first."""
    known = table.bsdf_std_err[table.bsdf > 0] / table.bsdf[table.bsdf > 0]
    wanted = _error_beside(float(np.median(known)) if known.size else 0.0)
    ways: list[dict[str, Any]] = [
        {"rel_err": wanted, "estimator": "next_event", "trace": True},
        {"rel_err": wanted, "estimator": "weighted"},
    ]
    if table.bsdf_std_err.any():
        integrals = {"rel_err": INTEGRAL_RATIO * wanted, "estimator": "quadrature"}
        ways.insert(0, integrals)
    return ways


def first_that_can(
    specimen: SpecimenLike, ways: list[dict[str, Any]], own: dict[str, Any]
) -> Record:
    """Record in the first of the `ways` that can; those before it are dropped.

    Delta components beside integrals need rays, of which few meet an aperture.
    """
    while len(ways) > 1:
        try:
            record = measure_whole(specimen, **ways[0] | own)
            if not holds_integrals(record.tallies) or without_chance(record.tallies):
                return record
        except (SpecimenError, VariantError):
            pass
        del ways[0]
    return measure_whole(specimen, **ways[0] | own)


def _error_beside(typical: float) -> float:
    """Relative error that is small beside a typical one of a table."""
    return float(np.clip(ERROR_RATIO * typical, MIN_REL_ERR, MAX_REL_ERR))


def _noise(table: MeasuredTable, patches: Subdivision) -> float:
    """Part of the light that rays may misplace in a table's patches, all together.

    Its brightest patches are known best, and by rays, too: an error that is the same
    for each would take many times the rays for the dim ones, of which it knows little.
    """
    theta_o, phi_o = np.radians(pole_angle(table.theta_o)), np.radians(table.phi_o)
    patch = patches.patch(direction(theta_o, phi_o))
    solid = patches.projected_solid_angles.ravel()[patch]
    light = np.abs(table.bsdf) @ solid
    typical = float(table.bsdf_std_err @ solid / light) if light else 0.0
    # half the mean of the absolute value of a normal deviate
    return _error_beside(typical) / float(np.sqrt(2 * np.pi))


def _like_record(
    specimen: SpecimenLike,
    record: Record,
    seed: int | None,
    settings: dict[str, Any],
    progress: bool,
) -> Record:
    """Record of another specimen, measured as one was."""
    known, emitter = record.settings, str(record.provenance.emitter)
    collimated = emitter.startswith("DirectionalEmitter")
    if record.provenance.emitter_digest or not collimated:
        raise SettingError(
            f"the record's emitter {emitter:.60} is not stored in the record: measure "
            "the specimen under that emitter too, and compare the two records"
        )
    sampling = () if holds_integrals(record.tallies) else SAMPLING_SETTINGS
    names = (*REPEATED_SETTINGS, *sampling)
    again = {name: known[name] for name in names if known.get(name) is not None}
    given = {name: value for name, value in settings.items() if value is not None}
    if given.keys() & {"rel_err", "noise", "rays"}:
        again.pop("rays", None)
    nm = wavelengths_nm(record.channels)
    if nm is not None:
        again["wavelengths"] = nm.tolist()
    again["collector"] = record.subdivision
    again["hemispheres"] = "both" if record.has_lower else "upper"
    own = max(record.provenance.seeds, default=0) + 1
    again |= given | {"seed": own if seed is None else seed}
    incidents = list(zip(record.theta_i.tolist(), record.phi_i.tolist()))
    try:
        stack = _stack(specimen, incidents, again, progress)
    except SpecimenError:
        # of a campaign's directions, those that it refuses are of rays alone
        if "estimator" in given or not record.asked.joins_points:
            raise
        again["estimator"] = ANY_SPECIMEN
        if "folder" in again:  # which holds the settings of before
            again["folder"] = f"{again['folder']}_{ANY_SPECIMEN}"
        stack = _stack(specimen, incidents, again, progress)
    return stack if record.stacked else stack[0]


def far_source(half_angles: Sequence[float], distance: float) -> dict[str, Any]:
    """Source of uniform radiance above the specimen, that faces it.

    A disk of one half-angle in degrees, or a rectangle of two, along x and y.
    """
    sides = [float(distance * np.tan(np.radians(angle))) for angle in half_angles]
    above = mi.ScalarTransform4f().translate([0, 0, distance])
    return {
        "type": "disk" if len(sides) == 1 else "rectangle",
        "to_world": above.rotate([1, 0, 0], 180).scale([sides[0], sides[-1], 1]),
        "emitter": {"type": "area", "radiance": {"type": "spectrum", "value": 1.0}},
    }

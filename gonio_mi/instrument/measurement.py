"""One measurement, here and at once: loads, sends batches, and makes the record."""

from __future__ import annotations

import logging
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from os import PathLike
from typing import Any

import mitsuba as mi
import numpy as np

from ..errors import SettingError, VariantError
from ..memory import check_memory
from ..results.processors import joined_processors
from ..results.record import Record
from ..results.tally import Tally, batch_sizes
from ..settings import MeasurementSettings
from ..settings.parsed import checked_incident
from ..transport.bench import Bench
from ..transport.kernels import launches_kernels
from ..transport.specimen import Specimen
from .batches import Target, rounds
from .incidence import described_digest, emitter_scene, incident_angles, incident_key
from .instrument import Instrument
from .loading import check_variant, load_specimen, specimen_name
from .named_files import check_named_files
from .resuming import check_resumable
from .scene_settings import own_settings, sampler_of
from .sending import send_all

__all__ = ["measure_each", "measure_here", "measure_whole", "whole"]

logger = logging.getLogger(__name__)

# Light is said to be created where the intervals of this level begin above all that
# came, and by more than what a path of so many events loses to single precision.
SURE = 1 - 1e-9
PATH_ROUNDING = 1000 * float(np.finfo(np.float32).eps)


def measure_here(
    specimen: Any, theta_i: Any = None, phi_i: Any = 0.0, **settings: Any
) -> Record:
    """Record of a specimen; see :func:`~gonio_mi.instrument.measuring.measure`."""
    check_variant()
    patches = checked_incident("incident", settings.get("incident"))
    incidents, stacked = incident_angles(theta_i, phi_i, patches)
    record = measure_each(specimen, incidents, **settings)
    return record if stacked else record[0]


@launches_kernels()
def measure_each(
    specimen: Any,
    incidents: Sequence[tuple[float, float] | None],
    *,
    progress: bool = False,
    resume: Record | None = None,
    parameters: dict[str, Any] | None = None,
    emitter: dict[str, Any] | None = None,
    **given: Any,
) -> Record:
    """Stack of the incident directions, each ``(theta_i, phi_i)`` in degrees or None.

    All else as of :func:`~gonio_mi.instrument.measuring.measure`.
    """
    check_variant()
    given = {name: value for name, value in given.items() if value is not None}
    asked = MeasurementSettings().changed(**given)  # refused before anything is loaded
    _check_together(given, asked, incidents, emitter)
    scene, settings = _prepared(specimen, parameters, given, resume)
    instrument = Instrument(settings, sampler_of(settings))
    measured = Specimen(scene, settings.period)
    measured.name = specimen_name(specimen, parameters)
    instrument.check(measured)
    described = described_digest(emitter)
    scenes = [
        emitter_scene(scene, emitter, incident, settings.side) for incident in incidents
    ]
    benches = [
        instrument.bench(measured, lit.emitters(), incident, described)
        for lit, incident in zip(scenes, incidents)
    ]
    plan = batch_sizes(settings.rays, settings.batches)
    _check_sums_fit(instrument, benches, plan)
    finished: list[list[Tally]] = [[] for _ in benches]
    if resume is not None:
        check_resumable(resume, instrument, benches, settings.seed, plan)
        finished[: len(resume)] = [[tally] for tally in resume.tallies]

    started = time.perf_counter()
    keys = [(settings.seed, *incident_key(incident)) for incident in incidents]
    target = Target.of(settings)
    complete = send_all(instrument, benches, keys, plan, target, finished, progress)
    records = [
        instrument.record(bench, Tally.join(tallies), settings.seed)
        for bench, tallies in zip(benches, finished)
        if tallies
    ]
    _warn_of_created_light(records)
    record = Record.stack(records)
    if resume is not None:
        parts = joined_processors(resume.settings, record.settings)
        record = record.with_settings(**parts)
    logger.info("measured for %.3g s: %r", time.perf_counter() - started, record)
    if target:
        record = record.with_settings(**target.reached(record))
        if complete:
            _warn_unless_reached(record, target)
    if not complete:
        record = record.with_settings(interrupted=True)
        _warn_of_interruption(instrument, record, len(benches))
    return record


def measure_whole(specimen: Any, *args: Any, **settings: Any) -> Record:
    """Like :func:`measure_here`; after Ctrl-C KeyboardInterrupt instead of a part."""
    return whole(measure_here, specimen, *args, **settings)


def whole(measure: Callable[..., Record], *args: Any, **settings: Any) -> Record:
    """Return what is measured, or raise KeyboardInterrupt if it is a part."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "interrupted: ", RuntimeWarning)
        record = measure(*args, **settings)
    if record.settings.get("interrupted"):
        raise KeyboardInterrupt
    return record


def _check_together(
    given: Mapping[str, Any],
    asked: MeasurementSettings,
    incidents: Sequence[tuple[float, float] | None],
    emitter: object,
) -> None:
    """Raise ValueError for settings that exclude each other, or have nothing to say."""
    if "wavelengths" in given and not mi.is_spectral:
        raise VariantError(
            "wavelengths need a spectral variant, such as llvm_ad_spectral, "
            f"got {mi.variant()}"
        )
    patches = asked.incident
    if patches is not None and (emitter is not None or asked.divergence):
        other = "divergence" if asked.divergence else "emitter"
        raise SettingError(
            f"incident goes without {other}: it says which directions a beam has, "
            f"got {patches!s:.40}"
        )
    if None in incidents and emitter is None and asked.side != "front":
        raise SettingError(
            "side goes with theta_i: without it the scene's emitter decides where "
            f"light comes from, got side {asked.side}"
        )
    if not given.keys() & {"rel_err", "noise"} and "max_rays" in given:
        raise SettingError(
            f"max_rays goes with rel_err, got {asked.max_rays!r} without"
        )


def _prepared(
    specimen: Any,
    parameters: dict[str, Any] | None,
    given: dict[str, Any],
    resume: object,
) -> tuple[mi.Scene, MeasurementSettings]:
    """Scene of a specimen, and the settings with which it is measured."""
    scene = load_specimen(specimen, parameters, given.get("period"))
    settings = _settled(own_settings(scene), given, resume)
    if mi.is_spectral and isinstance(specimen, (str, PathLike, dict)):
        check_named_files(specimen, parameters, settings.wavelengths)
    return scene, settings


def _settled(
    own: dict[str, Any], given: dict[str, Any], resume: object
) -> MeasurementSettings:
    """Settings that are `given`, else the scene's `own`, else the defaults."""
    settings = MeasurementSettings().changed(**own | given)
    if settings.estimator == "quadrature":
        if resume is not None:
            raise SettingError(
                "resume is for sampled rays, got the estimator quadrature"
            )
        return settings
    others = {"rays": given.get("rays"), "resume": resume}
    for goal, also in (("noise", {"rel_err": given.get("rel_err")}), ("rel_err", {})):
        for name, other in (others | also).items():
            if goal in given and other is not None:
                raise SettingError(f"{goal} and {name} exclude each other, got both")
    if given.keys() & {"rays", "noise"}:  # instead of what the scene asks for
        settings = replace(settings, rel_err=None)
    return settings


def _check_sums_fit(
    instrument: Instrument, benches: Sequence[Bench], plan: Sequence[int]
) -> None:
    """Raise ValueError if the sums of all benches do not fit into memory."""
    sums = sum(bench.n_collected for bench in benches)
    # while they are joined; and beside those of the rounds before
    n_rounds = len(rounds(plan, min(map(instrument.round_rays, benches))))
    copies = 2 * min(n_rounds, 2)
    check_memory(
        f"{sums} patches in {len(plan)} batches",
        copies * 8 * sums * len(plan) * len(mi.Spectrum()),
        "take fewer patches, incident directions or batches",
    )


def _warn_of_created_light(records: Sequence[Record]) -> None:
    """Warn if more light left than came, beyond chance and single precision."""
    for record in records:
        total, low = record.dhr, record.interval(SURE, "dhr")[0]
        if record.dht is not None:
            total, low = total + record.dht, low + record.interval(SURE, "dht")[0]
        if np.any(low > 1 + PATH_ROUNDING):
            theta_i, phi_i = record.theta_i[0], record.phi_i[0]
            warnings.warn(
                f"the BSDF creates light: {np.max(total):.6g} of what came leaves for "
                f"incidence at theta_i {theta_i:g}, phi_i {phi_i:g}",
                RuntimeWarning,
                stacklevel=3,
            )
            return


def _warn_unless_reached(record: Record, target: Target) -> None:
    reached = record.settings["reached"]
    if not reached <= target.goal:
        where = "" if target.of_noise else " in the worst patch"
        warnings.warn(
            f"{target.name} of {target.goal:g} was not reached with "
            f"{target.max_rays:g} rays: it is {reached:.3g}{where}",
            RuntimeWarning,
            stacklevel=3,
        )


def _warn_of_interruption(
    instrument: Instrument, record: Record, n_incident: int
) -> None:
    """Warn of what is left of so many incident directions."""
    settings = instrument.settings
    if instrument.integrates or Target.of(settings):
        kept = f"{len(record)} of {n_incident} incident directions"
        kept += "" if instrument.integrates else ", the last one less precise"
    else:
        asked = settings.rays * n_incident * instrument.passes
        kept = f"{record.ledger.emitted} of {asked} rays; resume= carries it on"
    warnings.warn(f"interrupted: the record holds {kept}", RuntimeWarning, stacklevel=3)

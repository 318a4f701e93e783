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

from ..errors import SettingError, VariantError
from ..memory import check_memory
from ..results.processors import joined_processors
from ..results.record import Record
from ..results.tally import Tally, batch_sizes
from ..settings import MeasurementSettings
from ..settings.orders import Order
from ..settings.parsed import checked_incident
from ..transport.bench import Bench
from ..transport.kernels import launches_kernels
from ..transport.specimen import Specimen
from .batches import Target, rounds
from .incidence import described_digest, emitter_scene, incident_angles, incident_key
from .instrument import Instrument
from .loading import check_variant, load_specimen, specimen_name
from .named_files import check_named_files
from .remarks import (
    warn_of_created_light,
    warn_of_interruption,
    warn_unless_reached,
)
from .resuming import check_resumable
from .scene_settings import own_settings, sampler_of
from .sending import send_all

__all__ = ["measure_each", "measure_here", "measure_stacks", "measure_whole", "whole"]

logger = logging.getLogger(__name__)

# Estimators whose rays are each of the one order in which they leave.
COUNTS_EXITS = ("weighted", "analog")


def measure_here(
    specimen: Any, theta_i: Any = None, phi_i: Any = 0.0, **settings: Any
) -> Record:
    """Record of a specimen; see :func:`~gonio_mi.instrument.measuring.measure`."""
    check_variant()
    patches = checked_incident("incident", settings.get("incident"))
    incidents, stacked = incident_angles(theta_i, phi_i, patches)
    record = measure_each(specimen, incidents, **settings)
    return record if stacked else record[0]


def measure_each(
    specimen: Any, incidents: Sequence[tuple[float, float] | None], **settings: Any
) -> Record:
    """Stack of the incident directions, each ``(theta_i, phi_i)`` in degrees or None.

    All else as of :func:`~gonio_mi.instrument.measuring.measure`.
    """
    (record,) = measure_stacks(specimen, incidents, (), **settings)
    return record


@launches_kernels()
def measure_stacks(
    specimen: Any,
    incidents: Sequence[tuple[float, float] | None],
    orders: Sequence[Order],
    *,
    progress: bool = False,
    resume: Record | None = None,
    parameters: dict[str, Any] | None = None,
    emitter: dict[str, Any] | None = None,
    **given: Any,
) -> list[Record]:
    """Stacks of the incident directions: of each of the orders, if there are any."""
    check_variant()
    given = {name: value for name, value in given.items() if value is not None}
    if orders:
        given["order"] = Order(most=max(order.most for order in orders))
    asked = MeasurementSettings().changed(**given)  # refused before anything is loaded
    _check_together(given, asked, incidents, emitter)
    scene, settings = _prepared(specimen, parameters, given, resume)
    one_by_one = Target.of(settings) or settings.estimator not in COUNTS_EXITS
    if len(orders) > 1 and one_by_one:
        given |= {"progress": progress, "parameters": parameters, "emitter": emitter}
        records: list[Record] = []
        for one in orders:
            records += measure_stacks(specimen, incidents, [one], **given)
            if records[-1].settings.get("interrupted"):
                break
        return records
    if len(orders) == 1:
        settings, orders = replace(settings, order=orders[0]), ()
    instrument = Instrument(settings, sampler_of(settings))
    measured = Specimen(scene, settings.period)
    measured.name = specimen_name(specimen, parameters)
    instrument.check(measured)
    described = described_digest(emitter)
    # scenes are kept, for with them their emitters go; no comprehension, for its cells
    # would keep the specimen as long as an error
    scenes, benches = [], []
    for incident in incidents:
        scenes.append(emitter_scene(scene, emitter, incident, settings.side))
        lit = scenes[-1].emitters()
        benches.append(instrument.bench(measured, lit, incident, described, orders))
    keys = [(settings.seed, *incident_key(incident)) for incident in incidents]
    return _sent(instrument, benches, keys, resume, progress)


def _sent(
    instrument: Instrument,
    benches: Sequence[Bench],
    keys: Sequence[tuple[int, ...]],
    resume: Record | None,
    progress: bool,
) -> list[Record]:
    """Send all rays, and make of them a stack of records for each order."""
    settings = instrument.settings
    plan, target = batch_sizes(settings.rays, settings.batches), Target.of(settings)
    _check_sums_fit(instrument, benches, plan)
    finished: list[list[Tally]] = [[] for _ in benches]
    if resume is not None:
        check_resumable(resume, instrument, benches, settings.seed, plan)
        finished[: len(resume)] = [[tally] for tally in resume.tallies]

    started = time.perf_counter()
    complete = send_all(instrument, benches, keys, plan, target, finished, progress)
    records = _records(instrument, benches, finished)
    if resume is not None:
        parts = joined_processors(resume.settings, records[0].settings)
        records = [records[0].with_settings(**parts)]
    seconds = time.perf_counter() - started
    logger.info("measured for %.3g s: %r", seconds, records[0])
    if target:
        records = [records[0].with_settings(**target.reached(records[0]))]
        if complete:
            warn_unless_reached(records[0], target)
    if not complete:
        records = [record.with_settings(interrupted=True) for record in records]
        warn_of_interruption(instrument, records[0], len(benches))
    return records


def _records(
    instrument: Instrument,
    benches: Sequence[Bench],
    finished: Sequence[list[Tally]],
) -> list[Record]:
    """Record of each order, or the one of all rays: stacks of what was finished."""
    done = [
        (bench, Tally.join(tallies))
        for bench, tallies in zip(benches, finished)
        if tallies
    ]
    seed, orders, found = instrument.settings.seed, benches[0].orders, []
    if not orders:
        found.append([instrument.record(bench, tally, seed) for bench, tally in done])
    for number, order in enumerate(orders):
        found.append(
            [
                instrument.record(bench, tally.apart()[number], seed).with_settings(
                    order=str(order)
                )
                for bench, tally in done
            ]
        )
    for records in found:
        warn_of_created_light(records)
    return [Record.stack(records) for records in found]


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
    n_orders = max(1, len(benches[0].orders))
    sums = n_orders * sum(bench.n_collected for bench in benches)
    # while they are joined; and beside those of the rounds before
    n_rounds = len(rounds(plan, min(map(instrument.round_rays, benches))))
    copies = 2 * min(n_rounds, 2)
    check_memory(
        f"{sums} patches in {len(plan)} batches",
        copies * 8 * sums * len(plan) * len(mi.Spectrum()),
        "take fewer patches, incident directions, batches or orders at once",
    )

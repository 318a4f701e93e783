"""From tallies to records: their provenance, warnings, and whether one carries on."""

from __future__ import annotations

import datetime
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..errors import (
    MAX_VALUE,
    SettingError,
    SettingTypeError,
    SpecimenError,
    abridged_apart,
    shown,
    warn,
)
from ..results.provenance import Provenance, settings_mapping
from ..results.record import Record
from ..results.tally import Ledger, Tally, batch_sizes
from ..settings import MeasurementSettings
from ..specimen.scene_objects import class_of
from ..specimen.wavelengths import channel_names
from ..transport.launch import transport_of
from ..transport.sampling import sampler_name
from ..transport.setup import Setup
from ..variants import processor
from ..version import __version__
from .schedule import Target, rays_sent, rounds

# Light is said to be created where the intervals of this level begin above all that
# came, and by more than what a path of so many events loses to single precision.
CREATION_LEVEL = 1 - 1e-9
PATH_ROUNDING = 1000 * float(np.finfo(np.float32).eps)


def record_of(setup: Setup, tally: Tally) -> Record:
    """Record of a finished `tally`, with all that is needed to repeat it."""
    n = tally.n_batches
    return _stack_of([setup], [tally], *settings_and_provenance(setup, n))[0]


def _stack_of(
    setups: Sequence[Setup],
    tallies: Sequence[Tally],
    asked: MeasurementSettings,
    provenance: Provenance,
) -> Record:
    """Stack of finished `tallies`, at setups that differ in their direction only."""
    lead = setups[0]
    for tally in tallies:
        _check_ledger(tally.ledger, lead)
    if mi.is_rgb:
        tallies = [tally.first(1) if tally.achromatic else tally for tally in tallies]
    channels = max(tally.channels for tally in tallies)
    return Record(
        subdivision=lead.collector.subdivision,
        theta_i=np.array([setup.theta_i for setup in setups]),
        phi_i=np.array([setup.phi_i for setup in setups]),
        channels=channel_names(lead.settings.wavelengths, channels),
        tallies=tuple(tally.spread(channels) for tally in tallies),
        asked=asked,
        provenance=provenance,
        stacked=True,
    )


def _check_ledger(ledger: Ledger, setup: Setup) -> None:
    """Raise SpecimenError if nothing was measured, and warn of what went wrong."""
    if 0 < ledger.missed == ledger.emitted:
        raise SpecimenError(
            f"the footprint {setup.settings.footprint} must meet the specimen, "
            f"but all {ledger.emitted} rays missed it: if it has openings, give its "
            "period, such as --period box"
        )
    met = ledger.emitted - ledger.missed - ledger.unlit
    closed = "a shape with a medium must be closed, and overlap no other, but"
    if 0 < ledger.astray == met:
        raise SpecimenError(
            f"{closed} all {met} rays that met it left the scene inside of a medium, "
            "or met a surface of another one; layers that are open at their sides are "
            "measured with --period box, and two shapes about one medium share it by a "
            "reference"
        )
    if ledger.invalid:
        called = setup.method.functions(setup.specimen.surfaces[0].bsdf())
        functions = " or ".join(f"{name}()" for name in sorted(called, reverse=True))
        matrix = "elements above the first, " if mi.is_polarized else ""
        near = " or the emitter is too near for single rays,"
        near = "" if setup.beam.collimated else near
        warn(
            f"the BSDF's {functions} returned a weight that is negative, NaN or "
            f"above 32768 (along a path 2**30), {matrix}or no unit direction,{near} "
            f"for {ledger.invalid} of {ledger.emitted} rays; they are in the ledger's "
            "row invalid and in no patch"
        )
    if ledger.astray:
        warn(
            f"{closed} {ledger.astray} of {ledger.emitted} rays left the scene inside "
            "of a medium or met a surface that is said to lie in another one; they are "
            "in the ledger's row astray and in no patch; layers that are open at their "
            "sides are measured with --period box"
        )


def records_of(
    setups: Sequence[Setup],
    finished: Sequence[Sequence[Tally]],
    complete: bool,
    resume: Record | None = None,
) -> list[Record]:
    """Record of each order, or the one of all rays: stacks of what was `finished`.

    Light that was created gives a warning, and a precision that was not reached.
    `resume` is the record that was carried on. Ctrl-C meanwhile costs no rays: they
    are made again, as interrupted.
    """
    try:
        return _records(setups, finished, complete, resume)
    except KeyboardInterrupt:
        return _records(setups, finished, False, resume)


def _records(
    setups: Sequence[Setup],
    finished: Sequence[Sequence[Tally]],
    complete: bool,
    resume: Record | None,
) -> list[Record]:
    sent = [setup for setup, tallies in zip(setups, finished) if tallies]
    done = [Tally.join(tallies) for tallies in finished if tallies]
    orders = setups[0].orders
    asked, provenance = settings_and_provenance(setups[0], done[0].n_batches)
    if not orders:
        records = [_stack_of(sent, done, asked, provenance)]
    else:
        records = [
            _stack_of(sent, tallies, replace(asked, order=order), provenance)
            for order, tallies in zip(orders, zip(*(one.apart() for one in done)))
        ]
    for record in records:
        _warn_of_created_light(record)
    if (gradients := setups[0].gradients) and gradients.unsound:
        warn(
            f"the derivative of {gradients.unsound} rays was not finite or above "
            "2**30; they count as 0 in gradients"
        )
    if resume is not None:
        (record,) = records
        provenance = record.provenance.joined((resume.provenance, record.provenance))
        records = [replace(record, provenance=provenance)]
    if target := Target.of(setups[0].settings):
        records = [records[0].with_provenance(**target.reached(records[0]))]
        reached = records[0].provenance.reached or 0.0
        if complete and not reached <= target.goal:
            where = "" if target.of_noise else " in the worst patch"
            warn(
                f"{target.name} of {target.goal:g} was not reached with "
                f"{target.max_rays:g} rays: it is {reached:.3g}{where}"
            )
    if not complete:
        records = [record.with_provenance(interrupted=True) for record in records]
    return records


def warn_of_interruption(setups: Sequence[Setup], record: Record) -> None:
    """Warn of what is left of the incident directions."""
    settings, n_incident = setups[0].settings, len(setups)
    integrates = setups[0].method.integrates
    if integrates or Target.of(settings):
        kept = f"{len(record)} of {n_incident} incident directions"
        kept += ", some of them less precise" if setups[0].samples else ""
    else:
        asked = settings.rays * n_incident * len(setups[0].passes)
        kept = f"{record.ledger.emitted} of {asked} rays; resume= continues it"
    warn(f"interrupted: the record holds {kept}")


def _warn_of_created_light(stack: Record) -> None:
    """Warn if more light left than came, beyond chance and single precision."""
    total = stack.dhr if stack.dht is None else stack.dhr + stack.dht
    # no interval begins above its value
    for i in np.flatnonzero((total > 1 + PATH_ROUNDING).any(axis=1)).tolist():
        record = stack[i]
        low = record.interval(CREATION_LEVEL, "dhr")[0]
        if record.dht is not None:
            low = low + record.interval(CREATION_LEVEL, "dht")[0]
        if np.any(low > 1 + PATH_ROUNDING):
            theta_i, phi_i = record.theta_i[0], record.phi_i[0]
            warn(
                f"the BSDF is not energy conserving: {np.max(total[i]):.6g} times the "
                f"incident flux leaves at theta_i {theta_i:g}, phi_i {phi_i:g}"
            )
            return


# A parameter of a medium that has more, such as a grid, is told by its size.
MAX_NUMBERS = 4


def settings_and_provenance(
    setup: Setup, batches: int | None = None
) -> tuple[MeasurementSettings, Provenance]:
    """What was asked for of a measurement, and how it came about."""
    settings, specimen = setup.settings, setup.specimen
    goals: dict[str, Any] = {}
    digests: dict[str, Any] = setup.digests
    if setup.method.integrates:
        goals = {"rel_err": settings.integral_err}
    side = "front" if setup.beam.side > 0 else "back"
    known = setup.gradients.columns if setup.gradients else ()
    columns = tuple(one.name for one in known)
    provenance = Provenance(
        specimen=specimen.name,
        surface=specimen.description,
        media=tuple(map(_medium_text, specimen.media)),
        defects=setup.defects,
        **digests,
        transmission=specimen.transmission,
        edges=specimen.edges,
        emitter=setup.beam.emitter.class_name(),
        transport=transport_of(setup),
        choice=setup.choice,
        columns=columns,
        sampler=sampler_name(setup.sampler),
        seeds=(settings.seed,),
        rays=settings.rays if setup.samples else 0,
        batches=batches,
        passes=len(setup.passes),
        variant=mi.variant(),
        versions={
            "gonio_mi": __version__,
            "mitsuba": mi.__version__,
            "drjit": dr.__version__,
            "numpy": np.__version__,
            "python": sys.version.split()[0],
        },
        processors=(processor(),),
        created=datetime.datetime.now(datetime.timezone.utc).isoformat("T", "seconds"),
    )
    return replace(settings, side=side, **goals), provenance


def _medium_text(medium: Any) -> str:
    """One line on a medium: its classes and numbers; of large arrays, their size.

    What is no number, of a plugin of somebody's own, is left out.
    """
    numbers = {}
    for name, value in mi.traverse(medium):
        try:
            flat = np.ravel(np.array(value, dtype=float))
        except (TypeError, ValueError):
            continue
        name = name.removesuffix(".value").removesuffix(".value")
        few = "/".join(f"{number:g}" for number in flat)
        if mi.is_spectral and flat.size == 3:
            few = "of a colour"  # the numbers are coefficients of its spectrum
        numbers[name] = few if flat.size <= MAX_NUMBERS else f"{flat.size} numbers"
    phase = class_of(medium.phase_function())
    told = ", ".join(f"{name} {value}" for name, value in numbers.items())
    return f"{class_of(medium)} with {phase}: {told}"


# What digests are of, and the settings that tell it in words.
DIGESTS = {
    "digest": ("another specimen", ("specimen", "surface")),
    "emitter_digest": ("another emitter", ("emitter",)),
    "plugin_digest": ("other code of plugins", ()),
}


def _difference(key: str, others: Mapping[str, Any], own: Mapping[str, Any]) -> str:
    """How two settings differ; of digests what they are of, and its words."""
    if key not in DIGESTS:
        return f"{key}={shown(others.get(key))} instead of {shown(own[key])}"
    what, words = DIGESTS[key]
    for word in words:
        if own.get(word) != others.get(word):
            texts = str(others.get(word)), str(own.get(word))
            other, one = abridged_apart(texts, MAX_VALUE)
            return f"{what}: {other} instead of {one}"
    named = f", also called {shown(own[words[0]])}" if words else ""
    return f"{what}{named}"


# Settings that say nothing of the rays.
UNCOMPARED = {"created", "defects", "versions", "processors", "specimen", "choice"}


def check_resumable(resume: Record, setups: Sequence[Setup], step: int) -> None:
    """Raise ValueError unless `resume` is the beginning of this measurement.

    Parameters
    ----------
    resume : Record
    setups : sequence of Setup
        For each incident direction; the record may hold the first ones only.
    step : int
        Rays of each batch in the first rounds; the record may hold those of whole
        :func:`~.schedule.rounds`, or of the first round the first batches only.
    """
    if not isinstance(resume, Record):
        raise SettingTypeError(f"resume must be a Record, got {shown(resume)}")
    if len(resume) > len(setups):
        raise SettingError(
            f"resume must hold at most {len(setups)} incident directions, "
            f"got {len(resume)}"
        )
    nm, n = setups[0].settings.wavelengths, len(resume.channels)
    for i, setup in enumerate(setups[: len(resume)]):
        own = settings_mapping(*settings_and_provenance(setup)) | {
            "channels": channel_names(nm, n),
            "collector": str(setup.collector.subdivision),
            "theta_i": setup.theta_i,
            "phi_i": setup.phi_i,
            "hemispheres": "both" if setup.shape[0] == 2 else "upper",
        }
        others = dict(resume.settings) | {
            "channels": resume.channels,
            "collector": str(resume.subdivision),
            "theta_i": float(resume.theta_i[i]),
            "phi_i": float(resume.phi_i[i]),
            "hemispheres": "both" if resume.has_lower else "upper",
        }
        for key in sorted(own.keys() - UNCOMPARED):
            if own[key] != others.get(key) and own[key] == own[key]:
                raise SettingError(
                    "resume must be a record of this measurement, but it was made with "
                    f"{_difference(key, others, own)}"
                )
    settings = setups[0].settings
    plan = batch_sizes(settings.rays, settings.batches)
    for setup, tally in zip(setups, resume.tallies):
        sent = rays_sent([tally], len(setup.passes))
        ends = rounds(plan, step)
        if sent not in ends and sent != ends[0][: len(sent)]:
            raise SettingError(
                "resume must be a record of this measurement, but it was made in "
                f"{len(sent)} batches of up to {max(sent)} rays instead of "
                f"{len(plan)} of up to {max(plan)}"
            )

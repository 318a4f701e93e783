"""From tallies to records, and warnings about what was measured."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace

import mitsuba as mi
import numpy as np

from ..errors import SpecimenError
from ..results.record import Record
from ..results.tally import Ledger, Tally
from ..transport.bench import Bench
from ..transport.wavelengths import channel_names
from .description import described
from .schedule import Target

__all__ = ["record_of", "records_of", "warn_of_interruption"]

# Light is said to be created where the intervals of this level begin above all that
# came, and by more than what a path of so many events loses to single precision.
SURE = 1 - 1e-9
PATH_ROUNDING = 1000 * float(np.finfo(np.float32).eps)


def record_of(bench: Bench, tally: Tally) -> Record:
    """Record of a finished `tally`, with all that is needed to repeat it."""
    settings, ledger = bench.settings, tally.ledger
    if 0 < ledger.missed == ledger.emitted:
        raise SpecimenError(
            f"the footprint {settings.footprint} must meet the specimen, "
            f"but all {ledger.emitted} rays missed it"
        )
    _check_arrived(ledger)
    functions = "sample() or eval()" if settings.estimator.deposits else "sample()"
    _warn_of_invalid(ledger, functions, bench.beam.collimated)
    _warn_of_astray(ledger)
    if not mi.is_spectral and tally.achromatic:
        tally = tally.first(1)
    asked, provenance = described(bench)
    return Record(
        subdivision=bench.collector.subdivision,
        theta_i=np.array([bench.theta_i]),
        phi_i=np.array([bench.phi_i]),
        channels=channel_names(settings.wavelengths, tally.channels),
        tallies=(tally,),
        asked=asked,
        provenance=replace(provenance, batches=tally.n_batches),
    )


def records_of(
    benches: Sequence[Bench],
    finished: Sequence[Sequence[Tally]],
    complete: bool,
    resume: Record | None = None,
) -> list[Record]:
    """Record of each order, or the one of all rays: stacks of what was `finished`.

    Light that was created gives a warning, and a precision that was not reached.
    `resume` is the record that was carried on.
    """
    done = [
        (bench, Tally.join(tallies))
        for bench, tallies in zip(benches, finished)
        if tallies
    ]
    orders, found = benches[0].orders, []
    if not orders:
        found.append([record_of(bench, tally) for bench, tally in done])
    for number, order in enumerate(orders):
        apart = [record_of(bench, tally.apart()[number]) for bench, tally in done]
        found.append(
            [replace(one, asked=replace(one.asked, order=order)) for one in apart]
        )
    for each in found:
        _warn_of_created_light(each)
    records = [Record.stack(each) for each in found]
    if resume is not None:
        (record,) = records
        parts = resume.provenance, record.provenance
        provenance = record.provenance.joined(parts)
        records = [replace(record, provenance=provenance)]
    if target := Target.of(benches[0].settings):
        records = [records[0].with_provenance(**target.reached(records[0]))]
        if complete:
            _warn_unless_reached(records[0], target)
    if not complete:
        records = [record.with_provenance(interrupted=True) for record in records]
    return records


def _warn_unless_reached(record: Record, target: Target) -> None:
    """Warn if the record is less precise than its target."""
    reached = record.provenance.reached or 0.0
    if not reached <= target.goal:
        where = "" if target.of_noise else " in the worst patch"
        warnings.warn(
            f"{target.name} of {target.goal:g} was not reached with "
            f"{target.max_rays:g} rays: it is {reached:.3g}{where}",
            RuntimeWarning,
            stacklevel=3,
        )


def warn_of_interruption(benches: Sequence[Bench], record: Record) -> None:
    """Warn of what is left of the incident directions."""
    settings, n_incident = benches[0].settings, len(benches)
    integrates = settings.estimator.integrates
    if integrates or Target.of(settings):
        kept = f"{len(record)} of {n_incident} incident directions"
        kept += "" if integrates else ", the last one less precise"
    else:
        asked = settings.rays * n_incident * len(benches[0].passes)
        kept = f"{record.ledger.emitted} of {asked} rays; resume= carries it on"
    warnings.warn(f"interrupted: the record holds {kept}", RuntimeWarning, stacklevel=3)


def _warn_of_created_light(records: Sequence[Record]) -> None:
    """Warn if more light left than came, beyond chance and single precision."""
    for record in records:
        total = record.dhr if record.dht is None else record.dhr + record.dht
        if not np.any(total > 1 + PATH_ROUNDING):
            continue  # no interval begins above its value
        low = record.interval(SURE, "dhr")[0]
        if record.dht is not None:
            low = low + record.interval(SURE, "dht")[0]
        if np.any(low > 1 + PATH_ROUNDING):
            theta_i, phi_i = record.theta_i[0], record.phi_i[0]
            warnings.warn(
                f"the BSDF creates light: {np.max(total):.6g} of what came leaves for "
                f"incidence at theta_i {theta_i:g}, phi_i {phi_i:g}",
                RuntimeWarning,
                stacklevel=3,
            )
            return


def _warn_of_invalid(ledger: Ledger, functions: str, collimated: bool) -> None:
    if ledger.invalid:
        near = "" if collimated else " or the emitter is too near for single rays,"
        warnings.warn(
            f"the BSDF's {functions} returned a negative, infinite or NaN weight, or "
            f"no unit direction,{near} for {ledger.invalid} of {ledger.emitted} "
            "rays; they are in the ledger's row invalid and in no patch",
            RuntimeWarning,
            stacklevel=3,
        )


def _check_arrived(ledger: Ledger) -> None:
    """Raise SpecimenError where all rays that met the specimen went astray."""
    met = ledger.emitted - ledger.missed - ledger.unlit
    if 0 < ledger.astray == met:
        raise SpecimenError(
            "a shape with a medium must be closed, and overlap no other, but all "
            f"{met} rays that met it left the scene inside of a medium, or met a "
            "surface of another one; layers that are open at their sides are measured "
            "with --period box, and two shapes about one medium share it by a reference"
        )


def _warn_of_astray(ledger: Ledger) -> None:
    if ledger.astray:
        warnings.warn(
            "a shape with a medium must be closed, and overlap no other, but "
            f"{ledger.astray} of {ledger.emitted} rays left the scene inside of a "
            "medium or met a surface that is said to lie in another one; they are in "
            "the ledger's row astray and in no patch; layers that are open at their "
            "sides are measured with --period box",
            RuntimeWarning,
            stacklevel=3,
        )

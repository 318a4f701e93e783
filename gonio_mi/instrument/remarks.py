"""Warnings about what was measured: created light, precision, interruption."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np

from ..results.record import Record
from .batches import Target
from .instrument import Instrument

__all__ = ["warn_of_created_light", "warn_of_interruption", "warn_unless_reached"]

# Light is said to be created where the intervals of this level begin above all that
# came, and by more than what a path of so many events loses to single precision.
SURE = 1 - 1e-9
PATH_ROUNDING = 1000 * float(np.finfo(np.float32).eps)


def warn_of_created_light(records: Sequence[Record]) -> None:
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


def warn_unless_reached(record: Record, target: Target) -> None:
    """Warn if the record is less precise than its target."""
    reached = record.settings["reached"]
    if not reached <= target.goal:
        where = "" if target.of_noise else " in the worst patch"
        warnings.warn(
            f"{target.name} of {target.goal:g} was not reached with "
            f"{target.max_rays:g} rays: it is {reached:.3g}{where}",
            RuntimeWarning,
            stacklevel=3,
        )


def warn_of_interruption(
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

"""What must hold of any record, so that a file that says otherwise is no record."""

import math

import numpy as np

from ..results.record import Record
from ..results.tally import Integrals, Tally
from .header import require

__all__ = ["check_record"]

# A polar angle of incidence that was computed may be this much below 0 degrees.
BELOW_NORMAL = 1e-4

# Azimuths are taken modulo a turn; beyond this nothing is left of them.
MOST_TURNED = 1e6


def check_record(record: Record) -> None:
    """Raise FileFormatError unless the parts of a record can be what they are."""
    _check_angles(record.theta_i, record.phi_i)
    for tally in record.tallies:
        _check_tally(tally, record)


def _check_angles(theta_i: np.ndarray, phi_i: np.ndarray) -> None:
    """Raise FileFormatError unless light can come from there; NaN is not known."""
    for theta, phi in zip(theta_i.tolist(), phi_i.tolist()):
        require(
            math.isnan(theta) or -BELOW_NORMAL <= theta < 90,
            f"its theta_i is {theta:g}, not in [0, 90) degrees",
        )
        require(math.isnan(phi) or abs(phi) <= MOST_TURNED, f"its phi_i is {phi:g}")


def _check_tally(tally: Tally, record: Record) -> None:
    """Raise FileFormatError unless the sums of one incident direction fit each other.

    Every ray in a patch is one in the ledger and the reverse, and light that was
    received had to come. Sums that 64 bits do not hold would be wrong in silence.
    """
    estimator, integrated = record.asked.estimator, isinstance(tally, Integrals)
    require(
        estimator.integrates == integrated,
        f"its estimator is {estimator} and its errors of integrals are "
        f"{'there' if integrated else 'missing'}",
    )
    for name in tally.arrays:
        require(
            float(getattr(tally, name).sum(dtype=float)) < 2.0**64,
            f"its {name} add up to more than 64 bits hold",
        )
    ledger = tally.ledger
    require(
        bool(ledger.direct) or not tally.direct.any(), "it has direct light of no ray"
    )
    if not estimator.deposits:
        left = (ledger.reflected, ledger.transmitted + ledger.direct)
        for hits, listed in zip(tally.hits, left):
            counted = int(hits.sum())
            require(
                counted == listed,
                f"its patches received {counted} rays and its ledger says {listed}",
            )
        if not integrated:
            empty = tally.sums[:, tally.hits == 0]
            require(not empty.any(), "patches without a hit received light")
    met = ledger.emitted - ledger.missed - ledger.unlit
    incident = tally.incident.sum(axis=0, dtype=float)
    require(
        not (met or integrated) or bool((incident > 0).all()),
        "it received light of an incident power of 0",
    )
    rays, passes = record.provenance.rays, record.provenance.passes
    goal = record.asked.precision or record.asked.noise
    if goal is None and rays is not None:
        require(
            ledger.emitted <= rays * passes,
            f"its ledger holds {ledger.emitted} rays of {rays} x {passes} asked for",
        )

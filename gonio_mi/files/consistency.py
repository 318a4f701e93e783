"""What must hold of any record, so that a file that says otherwise is no record."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..collector import Subdivision
from ..errors import shown
from ..results.campaign_text import campaign_is_sound
from ..results.integral_sums import Integrals
from ..results.record import Record
from ..results.tally import Tally
from .header import require

__all__ = ["check_record"]

# A polar angle of incidence that was computed may be this much below 0 degrees.
BELOW_NORMAL = 1e-4

# Azimuths are taken modulo a turn; beyond this nothing is left of them.
MOST_TURNED = 1e6

WORDS = (str,)
NUMBER = (int, float)
NUMBER_OR_WORDS = (int, float, str)

# Types of the settings that are read again; any may be None.
KINDS = {
    **dict.fromkeys(("specimen", "surface", "emitter", "emission", "side"), WORDS),
    **dict.fromkeys(("estimator", "transport", "sampler", "variant"), WORDS),
    **dict.fromkeys(("created", "collector", "transmission"), WORDS),
    **dict.fromkeys(("digest", "emitter_digest"), WORDS),
    **dict.fromkeys(("footprint", "period", "order"), NUMBER_OR_WORDS),
    **dict.fromkeys(("rel_err", "noise", "reached", "collector_radius"), NUMBER),
    **dict.fromkeys(("rays", "batches", "passes", "max_depth", "points"), (int,)),
    "rr_depth": (int,),
    "seed": (int, list),
    "versions": (dict,),
    "interrupted": (bool,),
}
# Counts, and the least that they can be.
LEAST = {"rays": 0, "batches": 1, "passes": 1, "max_depth": 0, "points": 1}
CHOICES = {
    "side": ("front", "back"),
    "estimator": ("analog", "weighted", "quadrature", "next_event"),
}


def check_record(record: Record) -> None:
    """Raise FileFormatError unless the parts of a record can be what they are."""
    _check_settings(record.settings, record.subdivision)
    _check_angles(record.theta_i, record.phi_i)
    for tally in record.tallies:
        _check_tally(tally, record.settings)


def _check_settings(settings: Mapping[str, Any], patches: Subdivision) -> None:
    """Raise FileFormatError unless each setting has a value that it can have."""
    for key, kinds in KINDS.items():
        value = settings.get(key)
        if value is None:
            continue
        is_bool = isinstance(value, bool) and bool not in kinds
        good = isinstance(value, kinds) and not is_bool and value == value
        if good and key in LEAST:
            good = LEAST[key] <= value < 2**63
        good &= value in CHOICES.get(key, [value])
        require(good, f"its setting {key} is {shown(value)}")
    versions = settings.get("versions") or {}
    require(
        isinstance(versions, dict)
        and all(isinstance(v, str) for v in versions.values()),
        "its setting versions is not a dictionary of texts",
    )
    processors = settings.get("processors") or []
    require(
        isinstance(processors, list) and all(isinstance(p, str) for p in processors),
        "its setting processors is not a list of texts",
    )
    campaign = settings.get("campaign")
    require(
        campaign is None or campaign_is_sound(campaign),
        f"its setting campaign is {shown(campaign)}",
    )
    collector = settings.get("collector")
    require(
        collector in (None, str(patches)),
        f"its setting collector is {shown(collector)}, its patches are "
        f"{shown(str(patches))}",
    )


def _check_angles(theta_i: np.ndarray, phi_i: np.ndarray) -> None:
    """Raise FileFormatError unless light can come from there; NaN is not known."""
    for theta, phi in zip(theta_i.tolist(), phi_i.tolist()):
        require(
            math.isnan(theta) or -BELOW_NORMAL <= theta < 90,
            f"its theta_i is {theta:g}, not in [0, 90) degrees",
        )
        require(math.isnan(phi) or abs(phi) <= MOST_TURNED, f"its phi_i is {phi:g}")


def _check_tally(tally: Tally, settings: Mapping[str, Any]) -> None:
    """Raise FileFormatError unless the sums of one incident direction fit each other.

    Every ray in a patch is one in the ledger and the reverse, and light that was
    received had to come. Sums that 64 bits do not hold would be wrong in silence.
    """
    estimator, integrated = settings.get("estimator"), isinstance(tally, Integrals)
    require(
        estimator is None or (estimator == "quadrature") == integrated,
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
    if estimator != "next_event":
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
    rays, passes = settings.get("rays"), settings.get("passes") or 1
    goal = settings.get("rel_err") or settings.get("noise")
    if goal is None and isinstance(rays, int):
        require(
            ledger.emitted <= rays * passes,
            f"its ledger holds {ledger.emitted} rays of {rays} x {passes} asked for",
        )

"""The numbers of a record, as a dictionary for machines."""

import math
from typing import Any

import numpy as np

from .doubts import doubts
from .precision import FLOOR, lobe, patch_values, precision
from .record import Record
from .tally import holds_integrals

__all__ = ["LEVEL", "summarize"]

LEVEL = 0.95
N_WORST = 5


def summarize(record: Record) -> dict[str, Any]:
    """Return the numbers of `record` in JSON's types.

    Parameters
    ----------
    record : Record

    Returns
    -------
    dict
        ``integrals``, whether these stand for rays, but for delta components;
        ``settings``, with ``collector`` and ``channels``; ``level`` of the intervals;
        one entry per incident direction in ``directions``, where ``direct`` is None but
        for periodic specimens whose direct light is collected; ``ledger`` over all,
        ``worst_patches``, of the largest relative standard error among those that
        reach a tenth of the mean; ``warnings``, a list of sentences. Angles are in
        degrees, ``brdf`` and ``btdf`` in 1/sr. What is not known is None, and the
        ``hits`` of a patch that is an integral.
    """
    looks = [record[i] for i in range(len(record))]
    directions = [_direction(look) for look in looks]
    patches = [patch for look in looks for patch in _worst_patches(look)]
    patches.sort(key=lambda patch: -patch["rel_err"])
    numbers = {
        "integrals": holds_integrals(record.tallies),
        "settings": dict(record.settings)
        | {
            "collector": str(record.subdivision),
            "hemispheres": "both" if record.has_lower else "upper",
            "channels": list(record.channels),
        },
        "level": LEVEL,
        "directions": directions,
        "ledger": record.ledger.rows | {"emitted": record.ledger.emitted},
        "worst_patches": patches[:N_WORST],
    }
    return _known(numbers | {"warnings": doubts(record, directions)})


def _direction(look: Record) -> dict[str, Any]:
    """Numbers of one incident direction."""
    worst, n_lobe = precision(look, FLOOR)
    return {
        "theta_i": float(look.theta_i[0]),
        "phi_i": float(look.phi_i[0]),
        "dhr": _totals(look, "dhr"),
        "dht": _totals(look, "dht") if look.has_lower else None,
        "direct": _totals(look, "direct") if _has_direct(look) else None,
        "ledger": look.ledger.rows | {"emitted": look.ledger.emitted},
        "n_patches": look.counts.size,
        "n_without_hit": int(np.sum(look.without_hit)),
        "n_pooled": int(np.sum(look.pooled)),
        "n_lobe": n_lobe,
        "rel_err_lobe": worst,
    }


def _has_direct(look: Record) -> bool:
    """Whether direct light was collected, however little there was."""
    collected = look.asked.order.least == 0
    return look.asked.period != "none" and collected


def _totals(look: Record, quantity: str) -> list[dict[str, Any]]:
    """One hemisphere's total, per channel."""
    low, high = look.interval(LEVEL, of=quantity)
    std_err = getattr(look, f"{quantity}_std_err")
    columns = zip(look.channels, getattr(look, quantity), std_err, low, high)
    keys = ("channel", "value", "std_err", "low", "high")
    return [
        dict(zip(keys, [channel, *map(float, floats)])) for channel, *floats in columns
    ]


def _worst_patches(look: Record) -> list[dict[str, Any]]:
    """Patches worth reporting with the largest relative standard error."""
    quantities = ("brdf", "btdf") if look.has_lower else ("brdf",)
    value = patch_values(look, "brdf", "btdf")
    std_err = patch_values(look, "brdf_std_err", "btdf_std_err")
    relative = np.full(value.shape, np.nan)
    weights = look.subdivision.projected_solid_angles
    for channel in range(len(look.channels)):
        here = lobe(value[..., channel], weights, FLOOR)
        one = relative[..., channel]
        one[here] = std_err[..., channel][here] / value[..., channel][here]
    # NaN sorts last
    order = np.argsort(-relative, axis=None, kind="stable")[:N_WORST]
    worst = []
    for index in zip(*np.unravel_index(order, value.shape)):
        if not np.isfinite(relative[index]):
            break
        hemisphere, i, j, channel = index
        hits = int(look.counts[hemisphere, i, j])
        integral = holds_integrals(look.tallies) and not hits
        theta_o, phi_o = (np.degrees(a[i, j]) for a in look.subdivision.middles)
        worst.append(
            {
                "theta_i": float(look.theta_i[0]),
                "phi_i": float(look.phi_i[0]),
                "of": quantities[hemisphere],
                "channel": look.channels[channel],
                "theta_o": float(180 - theta_o if hemisphere else theta_o),
                "phi_o": float(phi_o),
                "value": float(value[index]),
                "std_err": float(std_err[index]),
                "rel_err": float(relative[index]),
                "hits": None if integral else hits,
            }
        )
    return worst


def _known(value: Any) -> Any:
    """`value` with None in place of NaN and infinity, which JSON does not have."""
    if isinstance(value, dict):
        return {key: _known(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_known(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value

"""The numbers of a record: as a dictionary for machines, as text for people."""

import math
import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..single_precision import ROUNDING
from .campaign_text import campaign_text
from .precision import FLOOR, precision
from .processors import processors
from .record import Record
from .tally import Ledger

__all__ = ["exceeds_error", "summarize", "summary_text"]

LEVEL = 0.95
N_WORST = 5
WIDTH = 88

# A smaller share of rays beside the patches is rounding: `diffuse` alone sends 2 in 1e7
# along the horizon.
STRAY = 1e-6

# How light gets to the other side of a specimen whose BSDFs declare no transmission: by
# what a few thousand straight rays found.
PASSED = {
    "none": "leaked to the other side, where straight rays find no gap and no BSDF "
    "declares transmission: the geometry is not closed",
    "gaps": "went to the other side through gaps of the geometry or around its edges, "
    "as they should between threads or fibres but not in a closed surface",
}

# What `missed` rays ask for: of a finite specimen, and of a record that was made before
# what passes a periodic cell was direct light.
MISSED = {
    False: "missed the specimen; they are not part of the incident flux: if it stands "
    "for a larger surface with openings, give a period, which counts them as "
    "transmitted; if these are its edges, take a smaller footprint",
    True: "missed the specimen through openings of its cell; they are not part of the "
    "incident flux, as an older gonio-mi had it: measure again, and they are "
    "transmitted",
}

MAIN_ROWS = ("reflected", "transmitted", "absorbed")


def summarize(record: Record) -> dict[str, Any]:
    """Return the numbers of `record` in JSON's types.

    Parameters
    ----------
    record : Record

    Returns
    -------
    dict
        ``settings``, with ``collector`` and ``channels``; ``level`` of the intervals;
        one entry per incident direction in ``directions``, where ``direct`` is None but
        for periodic specimens whose direct light is collected; ``ledger`` over all,
        ``worst_patches``, of the largest relative standard error among those that
        received something; ``warnings``, a list of sentences. Angles are in degrees,
        ``brdf`` and ``btdf`` in 1/sr. What is not known is None.
    """
    looks = [record[i] for i in range(len(record))]
    directions = [_direction(look) for look in looks]
    patches = [patch for look in looks for patch in _worst_patches(look)]
    patches.sort(key=lambda patch: -patch["rel_err"])
    numbers = {
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
    return _known(numbers | {"warnings": _warnings(record, directions)})


def summary_text(numbers: dict[str, Any]) -> str:
    """Return the text for people of what :func:`summarize` returned."""
    blocks = [
        _settings_text(numbers),
        _totals_text(numbers),
        _ledger_text(numbers["ledger"]),
        _patches_text(numbers),
    ]
    if numbers["settings"].get("campaign"):
        blocks.insert(1, campaign_text(numbers["settings"]["campaign"], WIDTH))
    warnings = [_filled("warning   ", text) for text in numbers["warnings"]]
    if warnings:
        blocks.append("\n".join(warnings))
    return "\n\n".join(blocks)


# ------------------------------------------------------------------------- numbers


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
        "n_lobe": n_lobe,
        "rel_err_lobe": worst,
    }


def _has_direct(look: Record) -> bool:
    """Whether direct light was collected, however little there was."""
    settings = look.settings
    collected = settings.get("order", "all") in ("all", "0")
    return (
        settings.get("period", "none") != "none"
        and collected
        and not (look.ledger.missed)
    )


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
    """Patches of one direction with the largest relative standard error."""
    quantities = ("brdf", "btdf") if look.has_lower else ("brdf",)
    value = np.stack([getattr(look, quantity) for quantity in quantities])
    std_err = np.stack(
        [getattr(look, f"{quantity}_std_err") for quantity in quantities]
    )
    relative = np.full(value.shape, np.nan)
    np.divide(std_err, value, out=relative, where=value > 0)
    # NaN sorts last
    order = np.argsort(-relative, axis=None, kind="stable")[:N_WORST]
    worst = []
    for index in zip(*np.unravel_index(order, value.shape)):
        if not np.isfinite(relative[index]):
            break
        hemisphere, i, j, channel = index
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
                "hits": int(look.counts[hemisphere, i, j]),
            }
        )
    return worst


def _warnings(record: Record, directions: list[dict[str, Any]]) -> list[str]:
    """Sentences on what makes the result doubtful, or its bits hard to repeat."""
    ledger, sentences = record.ledger, []
    media = "media" in record.settings
    called = "sample()"
    if record.settings.get("estimator") == "next_event":
        called += " or eval()"
    if ledger.invalid:
        sentences.append(
            f"{_share(ledger.invalid, ledger)} are invalid: the BSDF's {called} "
            "returned a weight that is negative, infinite or NaN, or no unit "
            "direction; their flux is in no patch"
        )
    if ledger.truncated:
        limits = "max_depth or max_scatterings" if media else "max_depth"
        sentences.append(
            f"{_share(ledger.truncated, ledger)} were truncated by {limits}; their "
            "flux is in no patch"
        )
    if ledger.astray:
        sentences.append(
            f"{_share(ledger.astray, ledger)} went astray: a shape with a medium is "
            "open or overlaps another; their flux is in no patch"
        )
    rows = {
        "sideways": "left sideways, over the edge of the specimen, into no patch",
        "missed": MISSED[record.settings.get("period", "none") != "none"],
        "direct": "passed openings of the periodic cell straight on and are "
        "transmitted, as they should between threads or slats but not in a closed "
        "surface",
    }
    if media:
        del rows["direct"]  # it passed a layer, as it should
    transmission = record.settings.get("transmission")
    if ledger.direct and transmission == "none":
        transmission = "gaps"  # which the few thousand rays did not find
    passed = PASSED.get(str(transmission))
    if passed:
        rows["transmitted"] = passed
    for row, sentence in rows.items():
        if any(exceeds_error(direction, row) for direction in directions):
            sentences.append(
                f"{_share(getattr(ledger, row), ledger)} {sentence}: more than the "
                "statistical error"
            )
    several = processors(record.settings)
    if len(several) > 1:
        sentences.append(
            "its parts were measured on unlike processors, or with other vectors or "
            f"LLVM ({'; '.join(several)}): the statistics hold, but no single one "
            "of them repeats these bits"
        )
    return sentences


def exceeds_error(direction: dict[str, Any], row: str) -> bool:
    """Whether a row of the ledger is larger than the totals' statistical error.

    `direction` is one of those of :func:`summarize`.
    """
    totals = direction["dhr"] + (direction["dht"] or [])
    # half the interval; NaN, where it is not known, is skipped by fmax
    half = np.array([(total["high"] - total["low"]) / 2 for total in totals])
    error = np.fmax.reduce(half, initial=STRAY)
    return direction["ledger"][row] > error * direction["ledger"]["emitted"]


def _share(n: int, ledger: Ledger) -> str:
    return f"{_grouped(n)} of {_grouped(ledger.emitted)} rays"


def _known(value: Any) -> Any:
    """`value` with None in place of NaN and infinity, which JSON does not have."""
    if isinstance(value, dict):
        return {key: _known(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_known(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


# ---------------------------------------------------------------------------- text


def _settings_text(numbers: dict[str, Any]) -> str:
    """What was measured, and how."""
    settings = numbers["settings"]

    def _shown(key: str) -> Any:
        return settings.get(key, "?")

    n_directions = len(numbers["directions"])
    emitted = numbers["ledger"]["emitted"]
    named = "rel_err" if settings.get("rel_err") is not None else "noise"
    goal = settings.get(named)
    rays = settings.get("rays", 0) if goal is None else 0
    asked = n_directions * rays * settings.get("passes", 1)
    radius = settings.get("collector_radius")
    lines = [
        ("specimen", _shown("specimen")),
        ("surface", _shown("surface")),
        (
            "light",
            f"{_shown('emitter')} on the {_shown('side')}, "
            f"footprint {_shown('footprint')}, emission {_shown('emission')}",
        ),
        (
            "collector",
            f"{_shown('collector')}, hemispheres {_shown('hemispheres')}, "
            + (f"radius {radius:g}" if radius else "far field"),
        ),
        (
            "rays",
            _grouped(emitted)
            + (f" of {_grouped(asked)} asked for" if emitted < asked else "")
            + (f" over {n_directions} incident directions" if n_directions > 1 else "")
            + f", batches {_shown('batches')}, seed {_shown('seed')}"
            + (f", {named} {goal:g} asked for" if goal is not None else ""),
        ),
        (
            "method",
            f"estimator {_shown('estimator')}, "
            + (f"points {settings['points']}, " if "points" in settings else "")
            + f"sampler {_shown('sampler')}, transport "
            f"{_shown('transport')}, period {_shown('period')}, "
            f"order {_shown('order')}, max_depth {_shown('max_depth')}, "
            f"rr_depth {_shown('rr_depth')}",
        ),
        (
            "made",
            f"{_shown('created')}, variant {_shown('variant')}, "
            + ", ".join(f"{k} {v}" for k, v in settings.get("versions", {}).items())
            + ", on "
            + "; ".join(processors(settings)),
        ),
    ]
    return "\n".join(_filled(f"{name:<10}", text) for name, text in lines)


def _totals_text(numbers: dict[str, Any]) -> str:
    """Reflectance and transmittance with their intervals."""
    header = ["theta_i", "phi_i", "of", "channel", "value", "std_err"]
    header += [f"{numbers['level']:.0%} low", f"{numbers['level']:.0%} high"]
    rows = []
    for direction in numbers["directions"]:
        angles = [_angle(direction["theta_i"]), _angle(direction["phi_i"])]
        shown = ["dhr", "dht", *(["direct"] if direction["ledger"]["direct"] else [])]
        for quantity in shown:
            for total in direction[quantity] or []:
                decimals = _decimals(total["value"], total["std_err"])
                rows.append(
                    [
                        *angles,
                        quantity,
                        total["channel"],
                        _fixed(total["value"], decimals),
                        _std_err(total, decimals),
                        _fixed(total["low"], decimals),
                        _fixed(total["high"], decimals),
                    ]
                )
    return _table(header, rows)


def _ledger_text(ledger: dict[str, int]) -> str:
    """Where the rays went: all rows but those that are zero."""
    emitted = ledger["emitted"]
    shown = {
        name: n
        for name, n in ledger.items()
        if name != "emitted" and (n or name in MAIN_ROWS)
    }
    rows = [[name, _grouped(n), _percent(n, emitted)] for name, n in shown.items()]
    rows.append(["sum", _grouped(sum(shown.values())), _percent(emitted, emitted)])
    return _table(["ledger", "rays", "%"], rows)


def _patches_text(numbers: dict[str, Any]) -> str:
    """How well the patches are known, and the worst of them."""
    directions = numbers["directions"]
    n = sum(direction["n_patches"] for direction in directions)
    empty = sum(direction["n_without_hit"] for direction in directions)
    lobe = sum(direction["n_lobe"] for direction in directions)
    errors = [direction["rel_err_lobe"] for direction in directions]
    text = (
        f"{_grouped(n)}, of which {_grouped(empty)} without a hit and {_grouped(lobe)} "
    )
    text += f"brighter than {FLOOR:g} of the mean"
    if None not in errors:
        text += f", the worst of these known to {100 * max(errors):.3g} %"
    worst = numbers["worst_patches"]
    if not worst:
        return _filled("patches   ", text + "; their standard errors are not known")
    header = ["worst of", "channel", "theta_i", "phi_i", "theta_o", "phi_o"]
    rows = [
        [
            patch["of"],
            patch["channel"],
            *(
                _angle(patch[angle])
                for angle in ("theta_i", "phi_i", "theta_o", "phi_o")
            ),
            f"{patch['value']:.4g}",
            f"{patch['std_err']:.2g}",
            f"{100 * patch['rel_err']:.3g}",
            _grouped(patch["hits"]),
        ]
        for patch in worst
    ]
    table = _table([*header, "value", "+- std_err", "%", "hits"], rows)
    return _filled("patches   ", text) + "\n\n" + table


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Columns aligned to the right, the first one to the left."""
    lines = [header, *rows]
    widths = [max(len(line[i]) for line in lines) for i in range(len(header))]
    return "\n".join(
        "  ".join(
            cell.rjust(width) if i else cell.ljust(width)
            for i, (cell, width) in enumerate(zip(line, widths))
        )
        for line in lines
    )


def _filled(label: str, text: str) -> str:
    """`text` behind its label, in lines of at most `WIDTH`."""
    return textwrap.fill(
        text,
        WIDTH,
        initial_indent=label,
        subsequent_indent=" " * len(label),
        break_on_hyphens=False,
    )


def _grouped(n: int) -> str:
    """Whole number with its digits in groups of three."""
    return f"{n:,}".replace(",", " ")


def _percent(n: int, total: int) -> str:
    """Share in per cent that is 0 or 100 for nothing and all only."""
    if not total:
        return "-"
    text = f"{100 * n / total:.4f}"
    if n and text == "0.0000":
        return "<0.0001"
    return ">99.9999" if n < total and text == "100.0000" else text


def _angle(degrees: float | None) -> str:
    return "-" if degrees is None else f"{round(degrees, 6) + 0.0:.4g}"


def _decimals(value: float, std_err: float | None) -> int:
    """Decimals that show two digits of a standard error, but no more than are known.

    Mitsuba computes in single precision, which carries some seven digits of the value.
    """
    if not std_err:
        return 6
    least = max(std_err, ROUNDING * abs(value))
    return min(max(1 - math.floor(math.log10(least)), 2), 12)


def _std_err(total: dict[str, Any], decimals: int) -> str:
    """Text of a standard error, or of the rounding in which it is lost."""
    rounding = ROUNDING * abs(total["value"] or 0)
    if total["std_err"] and total["std_err"] < rounding:
        return f"<{rounding:.{decimals}f}"
    return _fixed(total["std_err"], decimals)


def _fixed(value: float | None, decimals: int) -> str:
    return "-" if value is None else f"{value:.{decimals}f}"

"""The numbers of a record, as text for people."""

import math
import textwrap
from collections.abc import Sequence
from typing import Any

from ..errors import abridged
from ..single_precision import ROUNDING
from .campaign_outcome import CampaignOutcome
from .doubts import grouped
from .precision import FLOOR
from .provenance import UNKNOWN

__all__ = ["aligned", "percent", "summary_text", "total_cells"]

WIDTH = 88
LONGEST_SURFACE = 400
MAIN_ROWS = ("reflected", "transmitted", "absorbed")

# Decimals of a total, below which numbers are written with a power of ten.
MOST_DECIMALS = 12

# Rows of totals that are shown, in halves from both ends.
MOST_ROWS = 40


def summary_text(numbers: dict[str, Any], most_rows: int = MOST_ROWS) -> str:
    """Return what :func:`~gonio_mi.results.summary.summarize` found, for people.

    Of more totals than `most_rows`, those in the middle are left out.
    """
    blocks = [
        _settings_text(numbers),
        _totals_text(numbers, most_rows),
        _ledger_text(numbers),
        _patches_text(numbers),
    ]
    warnings = [_filled("warning   ", text) for text in numbers["warnings"]]
    if warnings:
        blocks.append("\n".join(warnings))
    if numbers["settings"].get("campaign"):
        # what decides, below a table that may be long
        used = len(numbers["directions"]) - len(_copies(numbers))
        outcome = CampaignOutcome.from_mapping(numbers["settings"]["campaign"])
        blocks.append(outcome.text(used, WIDTH))
    return "\n\n".join(blocks)


def _settings_text(numbers: dict[str, Any]) -> str:
    """What was measured, and how."""
    settings = numbers["settings"]

    def _shown(key: str) -> Any:
        return settings.get(key, "?")

    radius = settings.get("collector_radius")
    lines = [
        ("specimen", _shown("specimen")),
        ("surface", abridged(str(_shown("surface")), LONGEST_SURFACE)),
        *(("medium", medium) for medium in settings.get("media", [])),
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
        ("rays", _rays_text(numbers)),
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
            + "; ".join(settings.get("processors") or [UNKNOWN]),
        ),
    ]
    return "\n".join(_filled(f"{name:<10}", text) for name, text in lines)


def _rays_text(numbers: dict[str, Any]) -> str:
    """How many rays were sent, or what stands for them."""
    settings, emitted = numbers["settings"], numbers["ledger"]["emitted"]
    n_directions = len(numbers["directions"])
    over = f" over {n_directions} incident directions" if n_directions > 1 else ""
    named = "rel_err" if settings.get("rel_err") is not None else "noise"
    goal = settings.get(named)
    wanted = f", {named} {goal:g} asked for" if goal is not None else ""
    if numbers["integrals"] and not emitted:
        return (
            f"none: the BSDF is integrated over each patch{over and ','}{over}{wanted}"
        )
    rays = settings.get("rays", 0) if goal is None else 0
    asked = n_directions * rays * settings.get("passes", 1)
    return (
        grouped(emitted)
        + (f" of {grouped(asked)} asked for" if emitted < asked else "")
        + (" for delta components, all else integrated" * numbers["integrals"])
        + f"{over}, batches {settings.get('batches', '?')}"
        + f", seed {settings.get('seed', '?')}{wanted}"
    )


def _totals_text(numbers: dict[str, Any], most_rows: int) -> str:
    """Reflectance and transmittance with their intervals; of copies no line."""
    level = f"{numbers['level']:.0%} "
    ends = ["error", "low", "high"]
    if not _without_rays(numbers):
        ends = ["std_err", level + "low", level + "high"]
    header = ["theta_i", "phi_i", "of", "channel", "value", *ends]
    rows = []
    copies = _copies(numbers)
    measured = [
        one
        for one in numbers["directions"]
        if (one["theta_i"], one["phi_i"]) not in copies
    ] or numbers["directions"]
    for direction in measured:
        angles = [_angle(direction["theta_i"]), _angle(direction["phi_i"])]
        shown = ["dhr", "dht", *(["direct"] if direction["ledger"]["direct"] else [])]
        for quantity in shown:
            for total in direction[quantity] or []:
                cells = total_cells(total)
                rows.append([*angles, quantity, total["channel"], *cells])
    left_out = len(numbers["directions"]) - len(measured)
    said = f"\n{left_out} copies of these are left out" if left_out else ""
    lines = aligned(header, rows).split("\n")
    if len(rows) > most_rows:
        half = most_rows // 2
        left = f"... {len(rows) - 2 * half} rows are left out: show --all has them ..."
        lines[1 + half : -half] = [left]
    return "\n".join(lines) + said


def total_cells(total: dict[str, Any]) -> list[str]:
    """Texts of a total, its standard error, and the ends of its interval."""
    decimals = _decimals(total["value"], total["std_err"])
    value, *ends = (_fixed(total[key], decimals) for key in ("value", "low", "high"))
    return [value, _std_err(total, decimals), *ends]


def _copies(numbers: dict[str, Any]) -> set[tuple[float, float]]:
    """Incident directions that a campaign copied from others."""
    symmetry = (numbers["settings"].get("campaign") or {}).get("symmetry") or {}
    copies = {tuple(copy) for copy in symmetry.get("copies", ())}
    held = {(one["theta_i"], one["phi_i"]) for one in numbers["directions"]}
    return copies & held


def _without_rays(numbers: dict[str, Any]) -> bool:
    """Whether all values are integrals, whose errors are none of chance."""
    return bool(numbers["integrals"] and not numbers["ledger"]["emitted"])


def _ledger_text(numbers: dict[str, Any]) -> str:
    """Where the rays went: all rows but those that are zero."""
    ledger = numbers["ledger"]
    emitted = ledger["emitted"]
    if _without_rays(numbers):
        text = (
            "empty, for integrals send no rays; error is the largest that the "
            "integrals are estimated to have, no standard error: low and high are the "
            "value less and plus it"
        )
        return _filled("ledger    ", text)
    shown = {
        name: n
        for name, n in ledger.items()
        if name != "emitted" and (n or name in MAIN_ROWS)
    }
    rows = [[name, grouped(n), percent(n, emitted)] for name, n in shown.items()]
    rows.append(["sum", grouped(sum(shown.values())), percent(emitted, emitted)])
    lines = [aligned(["ledger", "rays", "% of rays"], rows)]
    beyond = shown["transmitted"] + shown.get("direct", 0)
    if beyond and numbers["settings"].get("hemispheres") == "upper":
        lines.append(
            f"{percent(beyond, emitted)} % of the rays left on the other side, where "
            "nothing was collected"
        )
    if numbers["settings"].get("estimator") != "analog":
        lines.append(
            "rays are counted, whatever power they carry: shares of power stand above"
        )
    return "\n".join(lines)


def _patches_text(numbers: dict[str, Any]) -> str:
    """How well the patches are known, and the worst of them."""
    directions = numbers["directions"]
    n = sum(direction["n_patches"] for direction in directions)
    empty = sum(direction["n_without_hit"] for direction in directions)
    pooled = sum(direction["n_pooled"] for direction in directions)
    lobe = sum(direction["n_lobe"] for direction in directions)
    errors = [direction["rel_err_lobe"] for direction in directions]
    text = f"{grouped(n)}, of which "
    if not numbers["integrals"]:
        text += f"{grouped(empty)} without a hit and "
    text += f"{grouped(lobe)} brighter than {FLOOR:g} of the mean"
    if None not in errors:
        text += (
            f", {'error' if _without_rays(numbers) else 'std_err'} of these at most "
            f"{100 * max(errors):.3g} %"
        )
    if pooled:
        text += (
            f"; {grouped(pooled)} with few or none of the heavy hits that scatter: "
            "their uncertainty comes from all patches"
        )
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
            "-" if patch["hits"] is None else grouped(patch["hits"]),
        ]
        for patch in worst
    ]
    header += ["value", "+- std_err", "%", "hits"]
    if _without_rays(numbers):
        # no hits, nor the cells below, which no line of the table ends with
        header[-3:] = ["+- error", "%"]
    table = aligned(header, rows)
    return _filled("patches   ", text) + "\n\n" + table


def aligned(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Columns aligned to the right, the first one to the left."""
    lines = [header, *(row[: len(header)] for row in rows)]
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


def percent(n: int, total: int) -> str:
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
    return min(max(1 - math.floor(math.log10(least)), 2), MOST_DECIMALS)


def _std_err(total: dict[str, Any], decimals: int) -> str:
    """Text of a standard error, or of the rounding in which it is lost."""
    rounding = ROUNDING * abs(total["value"] or 0)
    if total["std_err"] and total["std_err"] < rounding:
        return f"<{rounding:.{decimals}f}"
    return _fixed(total["std_err"], decimals)


def _fixed(value: float | None, decimals: int) -> str:
    """Text of so many decimals; nothing at all is 0."""
    if value is None:
        return "-"
    text = f"{value:.{decimals}f}"
    if value == 0 or (decimals == MOST_DECIMALS and not float(text)):
        return f"{value + 0.0:.2g}"
    return text

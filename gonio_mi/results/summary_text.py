"""The summary of a record as text for people."""

import math
import textwrap
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from operator import itemgetter

import numpy as np

from ..errors import abridged
from ..settings.values import joined
from ..single_precision import ROUNDING
from .planning import FLOOR, lobe
from .record import Record
from .statistics import student_interval
from .summary import LEVEL, Summary, Total
from .tally import grouped, without_chance

WIDTH = 88
MAX_SURFACE = 400
# Characters of a text that are told: in a file it may have any number.
MAX_TEXT = 10_000

# Rows of the ledger that are shown even if they are zero, and the name of one that is
# no row.
MAIN_ROWS = ("reflected", "transmitted", "absorbed", "sum")
NAMES = {"over_the_edge": "of these over the edge"}

# What some rows of the ledger mean where rays have weights.
MEANINGS = {
    "absorbed": "weight 0, for instance when sampled below the horizon",
    "rejected": "`sample` failed (zero density)",
}

# Decimals of a total, below which numbers are written with a power of ten.
MAX_DECIMALS = 12

# Times as wide as Student's interval, beyond which it is said what an interval allows.
MAX_UNEXPLAINED = 2

# Rows of totals that are shown, in halves from both ends; of more directions that a
# campaign has chosen, the lowest, the highest and the least certain of each quantity.
MAX_ROWS, MAX_CHOSEN = 40, 6


def summary_text(
    summary: Summary,
    most_rows: int | None = None,
    stokes: Sequence[float] | None = None,
) -> str:
    """Return a summary as text for people.

    Of more totals than `most_rows` some are left out. `stokes` is the Stokes vector of
    the light whose polarisation is told: unpolarised by default, and none of records
    without Mueller matrices.
    """
    campaign = summary.record.provenance.campaign
    most_rows = most_rows or (MAX_CHOSEN if campaign else MAX_ROWS)
    blocks = [
        _settings_text(summary),
        _totals_text(summary, most_rows),
        _ledger_text(summary),
        _patches_text(summary),
    ]
    if summary.record.provenance.columns:
        blocks.insert(2, _slopes_text(summary, most_rows))
    if stokes is not None or summary.record.polarised:
        vector = (1.0, 0.0, 0.0, 0.0) if stokes is None else stokes
        blocks.insert(2, _stokes_text(summary.record, vector, most_rows))
    warnings = [_filled("warning   ", text) for text in summary.warnings]
    if warnings:
        blocks.append("\n".join(warnings))
    if campaign:
        # what decides, below a table that may be long
        n_used = len(summary.directions) - len(_copies(summary))
        blocks.append(campaign.text(n_used, WIDTH))
    if summary.back is not None:
        blocks += ["lit from behind:", summary_text(summary.back, most_rows, stokes)]
    return "\n\n".join(blocks)


def _settings_text(summary: Summary) -> str:
    """What was measured, and how."""
    record = summary.record
    asked, own = record.asked, record.provenance
    surface = abridged(_or_unknown(own.surface), MAX_SURFACE)
    emitter = (
        f"{_or_unknown(own.emitter)} on the {asked.side}, footprint {asked.footprint}, "
        f"emission {asked.emission}"
    )
    radius = asked.collector_radius
    distance = f"radius {radius:g}" if radius else "far field"
    collector = f"{record.subdivision}, hemispheres {asked.hemispheres}, {distance}"
    points = f"points {asked.points}, " if asked.sends_points else ""
    method = (
        f"estimator {asked.estimator}, {points}sampler {_or_unknown(own.sampler)}, "
        f"transport {_or_unknown(own.transport)}, period {joined(asked.period)}, "
        f"order {asked.order}, max_depth {asked.max_depth}, rr_depth {asked.rr_depth}"
    )
    versions = ", ".join(f"{name} {number}" for name, number in own.versions.items())
    made = (
        f"{_or_unknown(own.created)}, variant {_or_unknown(own.variant)}, {versions}, "
        f"on {'; '.join(own.each_processor)}"
    )
    lines = [
        ("specimen", _or_unknown(own.specimen)),
        ("surface", surface),
        *(("medium", medium) for medium in own.media),
        ("light", emitter),
        ("collector", collector),
        ("rays", _rays_text(summary)),
        ("method", method),
        *([("chosen", own.choice)] if own.choice else []),
        ("made", made),
    ]
    return "\n".join(_filled(f"{name:<10}", text) for name, text in lines)


def _or_unknown(value: object) -> str:
    return "?" if value is None else str(value)


def _rays_text(summary: Summary) -> str:
    """How many rays were sent, or what stands for them."""
    asked, own = summary.record.asked, summary.record.provenance
    emitted, n_directions = summary.ledger["emitted"], len(summary.directions)
    over = f" over {n_directions} incident directions" if n_directions > 1 else ""
    named = "noise" if asked.rel_err is None else "rel_err"
    goal = asked.noise if asked.rel_err is None else asked.rel_err
    wanted = "" if goal is None else f", {named} {goal:g} asked for"
    if without_chance(summary.record.tallies):
        comma = "," if over else ""
        return f"none: the BSDF is integrated over each patch{comma}{over}{wanted}"
    rays = (own.rays or 0) if goal is None else 0
    expected = n_directions * rays * own.passes
    text = grouped(emitted)
    if emitted < expected:
        text += f" of {grouped(expected)} asked for"
    if summary.integrals:
        text += " for delta components, all else integrated"
    seed = own.seeds[0] if len(own.seeds) == 1 else list(own.seeds) or None
    return (
        f"{text}{over}, batches {_or_unknown(own.batches)}, seed {_or_unknown(seed)}"
        f"{wanted}"
    )


def _totals_text(summary: Summary, most_rows: int) -> str:
    """Reflectance and transmittance with their intervals; of copies no line."""
    level = f"{LEVEL:.0%} "
    ends = ["error", "low", "high"]
    if not without_chance(summary.record.tallies):
        ends = ["std_err", level + "low", level + "high"]
    header = ["theta_i", "phi_i", "of", "channel", "value", *ends]
    rows, shown = [], []
    copies = _copies(summary)
    measured = [
        one for one in summary.directions if (one.theta_i, one.phi_i) not in copies
    ] or summary.directions
    for one in measured:
        angles = [_angle(one.theta_i), _angle(one.phi_i)]
        for of, total in one.totals:
            if of != "direct" or one.ledger["direct"]:
                rows.append([*angles, of, total.channel, *total_cells(total)])
                shown.append(total)
    left_out = len(summary.directions) - len(measured)
    said = f"\n{left_out} copies of these are left out" if left_out else ""
    lines = aligned(header, rows).split("\n")
    if len(rows) > most_rows:
        half = most_rows // 2
        kept = [*range(half), *range(len(rows) - half, len(rows))]
        if summary.record.provenance.campaign:
            kept = _extremes(rows, shown)
            half = len(kept)
        left = f"... {len(rows) - len(kept)} rows are left out: show --all has them ..."
        lines = [lines[0], *(lines[1 + number] for number in kept)]
        lines.insert(1 + half, left)
    if any(error.startswith("<") for *_, error, _low, _high in rows):
        said += "\n<: below single-precision rounding"
    n_batches = summary.record.n_batches
    if not summary.integrals and any(_leaves_open(one, n_batches) for one in shown):
        text = "an interval far wider than its std_err leaves room for light so rare "
        text += "that no ray may have met it"
        said += f"\n{_filled('', text)}"
    return "\n".join(lines) + said


def _slopes_text(summary: Summary, most_rows: int) -> str:
    """Derivatives of the totals by parameters, with their intervals."""
    level = f"{LEVEL:.0%} "
    header = ["theta_i", "phi_i", "of", "channel", "by", "derivative", "std_err"]
    rows = [
        [_angle(one.theta_i), _angle(one.phi_i), own.of, own.channel, own.by]
        + [
            f"{math.nan if x is None else x:.{digits}g}"
            for x, digits in zip(
                (own.value, own.std_err, own.low, own.high), (6, 2, 6, 6)
            )
        ]
        for one in summary.directions
        for own in one.gradients
    ]
    text = aligned([*header, level + "low", level + "high"], rows[:most_rows])
    if len(rows) > most_rows:
        text += f"\n... {len(rows) - most_rows} rows are left out: show --all has them"
    return text


def _extremes(rows: Sequence[Sequence[str]], totals: Sequence[Total]) -> list[int]:
    """Which rows have the lowest, the highest, the least certain total of a kind."""
    of_kind = defaultdict(list)
    for number, (row, total) in enumerate(zip(rows, totals)):
        value, std_err = total.value or 0.0, total.std_err or 0.0
        of_kind[row[2], row[3]].append((value, std_err, number))
    found = set()
    for some in of_kind.values():
        found |= {min(some)[2], max(some)[2], max(some, key=itemgetter(1))[2]}
    return sorted(found)


def _leaves_open(total: Total, n_batches: int) -> bool:
    """Whether its interval is far wider than Student's t alone makes it."""
    value, low, high = total.value, total.low, total.high
    if value is None or total.std_err is None or low is None or high is None:
        return False
    std_err = np.array(max(total.std_err, ROUNDING * abs(value)))
    _, half = student_interval(np.array(0.0), std_err, n_batches, LEVEL)
    return bool(max(value - low, high - value) > MAX_UNEXPLAINED * half)


def _stokes_text(record: Record, stokes: Sequence[float], most_rows: int) -> str:
    """Stokes vectors of all flux that leaves, each in frames of s = k x z."""
    header = ["theta_i", "phi_i", "of", "channel", "I"]
    header += ["Q/I", "U/I", "V/I", "std_err", "degree", "std_err"]
    rows = []
    for single in record:
        angles = [_angle(float(x[0])) for x in (single.theta_i, single.phi_i)]
        for of in ("dhr", "dht")[: record.n_hemispheres]:
            for channel, light, parts, error, degree, its_error in zip(
                record.channels,
                single.stokes(stokes, of)[0][:, 0],
                *single.normalised_stokes(stokes, of),
                *single.degree(stokes, of),
            ):
                if not light > 0:
                    continue
                cells = [_rounded(x, 5) for x in (light, *parts)]
                cells += [_of_part(float(np.max(error))), _rounded(degree, 5)]
                cells.append(_of_part(its_error))
                rows.append([*angles, of, channel, *cells])
    text = f"incident Stokes vector: {' '.join(f'{x:g}' for x in stokes)}\n"
    text += aligned(header, rows[:most_rows])
    if len(rows) > most_rows:
        text += f"\n... {len(rows) - most_rows} rows are left out: show --all has them"
    note = (
        "the first std_err is the largest of the three; degree of polarisation: of all "
        "flux together, each direction in its own frame of s and p"
    )
    if any(cell.startswith("<") for row in rows for cell in row):
        note += "; <: below single-precision rounding"
    return f"{text}\n{_filled('', note)}\n{_filled('', _greatest(record, stokes))}"


def _greatest(record: Record, stokes: Sequence[float]) -> str:
    """Which patch worth reporting has the greatest degree of polarisation."""
    text = f"greatest degree of a patch brighter than {FLOOR:g} of the mean: "
    found = []
    for single in record:
        quantities = ("brdf", "btdf")[: record.n_hemispheres]
        light = np.stack([single.stokes(stokes, of)[0][..., 0] for of in quantities])
        degrees, errors = np.stack([single.degree(stokes, of) for of in quantities], 1)
        weights = record.subdivision.projected_solid_angles
        bright = np.stack(
            [lobe(light[..., i], weights) for i in range(light.shape[-1])], axis=-1
        )
        if bright.any():
            degrees = np.where(bright, degrees, -1)
            place = np.unravel_index(np.argmax(degrees), degrees.shape)
            found.append((float(degrees[place]), float(errors[place]), single, place))
    if not any(degree for degree, *_ in found):
        return text + "0"
    degree, error, single, (hemisphere, i, j, channel) = max(found, key=itemgetter(0))
    theta_o, phi_o = (float(np.degrees(a[i, j])) for a in record.subdivision.middles)
    names = ["theta_i", "phi_i", "theta_o", "phi_o"]
    angles = [single.theta_i[0], single.phi_i[0]]
    angles += [180 - theta_o if hemisphere else theta_o, phi_o]
    where = ", ".join(
        f"{name} {_angle(x)}" for name, x in zip(names, angles) if not math.isnan(x)
    )
    if math.isnan(theta_o):
        where += " outside of the apertures"
    return (
        f"{text}{_rounded(degree, 5)} +- {_of_part(error)} at {where}, channel "
        f"{record.channels[channel]}"
    )


def total_cells(total: Total) -> list[str]:
    """Texts of a total, its standard error or rounding, and its interval's ends."""
    decimals = _decimals(total.value, total.std_err)
    error = _fixed(total.std_err, decimals)
    rounding = ROUNDING * abs(total.value or 0)
    if total.std_err and total.std_err < rounding:
        error = f"<{rounding:.{decimals}f}"
    ends = [_fixed(one, decimals) for one in (total.low, total.high)]
    return [_fixed(total.value, decimals), error, *ends]


def _copies(summary: Summary) -> set[tuple[float | None, float | None]]:
    """Incident directions that a campaign copied from others."""
    campaign = summary.record.provenance.campaign
    held = {(one.theta_i, one.phi_i) for one in summary.directions}
    return held.intersection(campaign.copies if campaign else ())


def ledger_cells(
    ledger: Mapping[str, int], emitted: int, always: Collection[str] = ()
) -> list[list[str]]:
    """Name, rays and per cent of the rows of a ledger; of empty rows only `always`."""
    return [
        [NAMES.get(name, name), grouped(n), percent(n, emitted)]
        for name, n in ledger.items()
        if n or name in always
    ]


def _ledger_text(summary: Summary) -> str:
    """Where the rays went: all rows but those that are zero."""
    ledger = summary.ledger
    emitted = ledger["emitted"]
    if without_chance(summary.record.tallies):
        text = (
            "empty: quadrature traces no rays; error is the largest that the "
            "integrals are estimated to have, no standard error: low and high are the "
            "value less and plus it"
        )
        return _filled("ledger    ", text)
    numbers = {**summary.record.ledger.rows, "sum": emitted}
    numbers["over_the_edge"] = ledger["over_the_edge"]
    rows = ledger_cells(numbers, emitted, MAIN_ROWS)
    lines = [aligned(["ledger", "rays", "% of rays"], rows)]
    beyond = ledger["transmitted"] + ledger["direct"]
    if beyond and not summary.record.has_lower:
        lines.append(
            f"{percent(beyond, emitted)} % of the rays left on the other side, where "
            "nothing was collected"
        )
    if any(tally.scale != 1 for tally in summary.record.tallies):
        totals = "dhr and dht above are" if summary.record.has_lower else "dhr above is"
        lines += [f"this table counts rays, not power; {totals} of power"]
        said = [f"{row}: {text}" for row, text in MEANINGS.items() if ledger[row]]
        lines += ["; ".join(said)] if said else []
    return "\n".join(lines)


def _patches_text(summary: Summary) -> str:
    """How well the patches are known, and the worst of them."""
    directions = summary.directions
    only_integrals = without_chance(summary.record.tallies)
    n, empty, pooled, lobe = (
        sum(getattr(direction, f"n_{name}") for direction in directions)
        for name in ("patches", "without_hit", "pooled", "lobe")
    )
    errors = [direction.rel_err_lobe for direction in directions]
    text = f"{grouped(n)}, of which "
    if not summary.integrals:
        text += f"{grouped(empty)} without a hit and "
    text += f"{grouped(lobe)} brighter than {FLOOR:g} of the mean"
    known = [error for error in errors if error is not None]
    if len(known) == len(errors):
        kind = "error" if only_integrals else "std_err"
        text += f", {kind} of these at most {100 * max(known):.3g} %"
    if pooled:
        text += (
            f"; {grouped(pooled)} with too few bright hits: their uncertainty is "
            "pooled over all patches"
        )
    if not summary.worst_patches:
        return _filled("patches   ", text + "; their standard errors are not known")
    header = ["worst of", "channel", "theta_i", "phi_i", "theta_o", "phi_o"]
    rows = [
        [
            patch.of,
            patch.channel,
            *map(_angle, (patch.theta_i, patch.phi_i, patch.theta_o, patch.phi_o)),
            f"{patch.value:.4g}",
            f"{patch.std_err:.2g}",
            f"{100 * patch.rel_err:.3g}",
            "-" if patch.hits is None else grouped(patch.hits),
        ]
        for patch in summary.worst_patches
    ]
    header += ["value", "+- std_err", "%", "hits"]
    if only_integrals:
        # no hits, nor the cells below, which no line of the table ends with
        header[-3:] = ["+- error", "%"]
    table = aligned(header, rows)
    if any(patch.theta_o is None for patch in summary.worst_patches):
        table += "\ntheta_o -: all directions outside of the apertures"
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
        abridged(text, MAX_TEXT),
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


def _decimals(value: float | None, std_err: float | None) -> int:
    """Decimals that show two digits of a standard error, but no more than are known.

    Mitsuba computes in single precision, which carries some seven digits of the value.
    """
    if not std_err or value is None:
        return 6
    least = max(std_err, ROUNDING * abs(value))
    return min(max(1 - math.floor(math.log10(least)), 2), MAX_DECIMALS)


def _rounded(value: float, decimals: int) -> str:
    """Text of so many decimals, without a sign of zero."""
    return f"{round(float(value), decimals) + 0.0:.{decimals}f}"


def _of_part(std_err: float) -> str:
    """Text of the standard error of a part of 1, or of the rounding in which it is."""
    return f"<{ROUNDING:.1g}" if std_err < ROUNDING else f"{std_err:.2g}"


def _fixed(value: float | None, decimals: int) -> str:
    """Text of so many decimals; nothing at all is 0."""
    if value is None:
        return "-"
    text = f"{value:.{decimals}f}"
    if value == 0 or (decimals == MAX_DECIMALS and not float(text)):
        return f"{value + 0.0:.2g}"
    return text

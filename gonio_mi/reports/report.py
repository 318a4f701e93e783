"""Records as HTML: a page that moves, and what a notebook shows."""

import base64
import html
import json
import zlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib import resources
from importlib.util import find_spec
from itertools import groupby
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..array_types import Floats, Singles
from ..collector import Subdivision
from ..collector.directions import direction
from ..errors import (
    LABEL,
    PackageError,
    abridged_apart,
    to_install,
)
from ..files import check_output
from ..plots import plot, plot_mueller, sheet
from ..plots.figure import evenly
from ..plots.plot import received
from ..progress import bar
from ..results.record import Record, checked_records
from ..results.summary import Summary, summarize
from ..results.summary_text import ledger_cells, summary_text, total_cells
from .page import figure, picture_and_text, save_page

# Patch values of one record, over all directions, hemispheres and channels, that a
# browser still shows with ease: 1000 directions of two hemispheres of 30x90 patches.
MAX_VALUES = 1000 * 2 * 30 * 90

# Directions in polar angle and in azimuth at which the page knows the patch.
RASTER = 720, 720

# Bits of the mantissa of an uncertainty that are kept: 1e-4 of it.
MANTISSA_BITS = 12


# Settings that tell records of one specimen apart in their names, first to last.
DISTINGUISHING_SETTINGS = (
    *("order", "period", "side", "footprint", "divergence", "incident", "emission"),
    *("emitter", "collector_radius", "max_depth", "max_scatterings", "variant"),
    *("estimator", "sampler", "points", "rays", "batches", "seed"),
)


def report(
    records: Record | Sequence[Record],
    path: str | PathLike[str],
    *,
    progress: bool = False,
) -> None:
    """Write one HTML page on which records can be looked at, without a network.

    It has the maps of reflection and transmission, where the pointer shows each patch's
    value, standard error, 95 % interval, rays and solid angle; sliders over the
    incident polar angles and azimuths; one channel or another, linear or logarithmic;
    a cut through any azimuth with its intervals; the lobe in three dimensions; totals,
    ledger and settings; and the numbers as CSV. Of several records, named by the
    settings in which they differ, any two stand beside each other; if they have one
    collector and the same channels, with their difference in standard errors. Where no
    ray came, the upper limit over 1.96 is taken for one. Of a record with more
    than 5.4 million patch values evenly chosen incident directions are shown, and the
    page says so. The page knows the patches of 720 x 720 directions of a hemisphere:
    patches between these are in its CSV only. Of records of polarised variants, all
    elements of the Mueller matrices at the first incident direction are drawn below,
    if Matplotlib is there.

    Plotly draws it (the extra ``report``): a kept library that has maps and
    surfaces in three dimensions and whose script can be put into the page.

    Parameters
    ----------
    records : Record or sequence of Record
    path : str or path
        Ends in ``.html``.
    progress : bool
        Show a progress bar on standard error.

    Raises
    ------
    ImportError
        Without Plotly.
    TypeError, ValueError
        If `records` holds something else, or none; for another file ending.
    OSError
        If the file cannot be written.
    """
    records = checked_records(records)
    check_report(path)
    from plotly.offline import get_plotlyjs

    ours = resources.files(__package__)
    total = sum(map(len, records))
    names = names_apart(records)
    with bar(progress, total=total, desc="report", unit="direction") as done:
        packed = [packed_record(one, name, done) for one, name in zip(records, names)]
    data = json.dumps({"records": packed})
    data = data.replace("<", "\\u003c")  # no text of a record ends the script
    body = [
        (ours / "record_page.html").read_text("utf-8"),
        f"<script>{get_plotlyjs()}</script>",
        f'<script type="application/json" id="data">{data}</script>',
        f"<script>{(ours / 'record_page.js').read_text('utf-8')}</script>",
    ]
    body += [_sheets_of_elements(one) for one in records if one.polarised]
    save_page(path, "; ".join(names), body)


def _sheets_of_elements(record: Record) -> str:
    """Maps of all elements of Mueller matrices at the first incident direction.

    Nothing without matplotlib.
    """
    try:
        drawn = [plot_mueller(record, of=of) for of in received(record[0])]
    except PackageError:
        return ""
    return "<h2>Elements of Mueller matrices</h2>" + "".join(map(figure, drawn))


def check_report(path: str | PathLike[str]) -> None:
    """Raise one clear sentence unless a report can be made and written to `path`.

    Raises
    ------
    ImportError
        Without Plotly.
    ValueError, OSError
        If the ending is not ``.html``, or the file cannot be written.
    """
    if find_spec("plotly") is None:
        raise PackageError(f"reports need plotly: {to_install('report')}")
    check_output(path, (".html",))


def notebook_view(record: Record) -> str:
    """Return a record as HTML: its picture, a sheet of a stack, and its numbers.

    Without matplotlib there are the numbers alone.
    """
    summary = summarize(record)
    warnings = "".join(f"<p>Warning: {html.escape(w)}</p>" for w in summary.warnings)
    text = summary_text(replace(summary, warnings=[]))
    draw = sheet if len(record) > 1 else plot
    shown = picture_and_text(lambda: draw(record), text, "numbers")
    return f"<p><code>{html.escape(repr(record))}</code></p>{warnings}{shown}"


def names_apart(records: Sequence[Record]) -> list[str]:
    """Short, distinct names of records that are compared.

    The specimens, with the settings in which records of the same name differ; alike
    only if all of these are.
    """
    names = abridged_apart([one.provenance.name for one in records], LABEL)
    columns = [[f"collector {one.subdivision}" for one in records]]
    for key in DISTINGUISHING_SETTINGS:
        columns.append([f"{key} {r.settings.get(key, 'unknown')}" for r in records])
    for column in columns:
        said = {*zip(names, column)}
        unlike = {name for name in names if sum(n == name for n, _ in said) > 1}
        names = [
            f"{name}, {text}" if name in unlike else name
            for name, text in zip(names, column)
        ]
    return names


def packed_record(
    record: Record, label: str = "", report: Callable[[float], Any] | None = None
) -> dict[str, Any]:
    """Data of a record for the page, in JSON's types.

    Arrays are little-endian, deflated and in base 64. ``raster`` is the patch of
    each direction, ``(polar angle, azimuth)`` at the middles of equal steps;
    ``values`` has one block per incident direction with, one after the other, the
    patch means in 1/sr, standard errors, distances from the mean to the lower and
    upper end of the 95 % interval, each float32 of the shape ``(hemispheres, patches,
    channels)``, and the rays per patch, uint32 of ``(hemispheres, patches)``. Of more
    than `MAX_VALUES` values evenly chosen directions are kept, and ``notes`` says so.
    `report` is told of each direction that is packed.
    """
    patches, n_all = record.subdivision, len(record)
    each = record.n_hemispheres * patches.n_patches * len(record.channels)
    kept = evenly(n_all, max(1, MAX_VALUES // each))
    summary = summarize(record)
    notes = list(summary.warnings)
    if len(kept) < n_all:
        words = f"{len(kept)} of the record's {n_all} incident directions, evenly"
        notes.insert(0, f"This page has {words}.")
    directions = [_direction_rows(summary, i) for i in kept]
    blocks = []
    for number in kept:
        blocks.append(_block(record[number]))
        if report is not None:
            report(1)
    middles = [np.degrees(np.ravel(angle)) for angle in patches.middles]
    return {
        "name": record.provenance.name,
        "label": label,
        "collector": str(patches),
        "channels": list(record.channels),
        "hemispheres": record.n_hemispheres,
        "patches": patches.n_patches,
        "detectors": patches.n_detectors,
        "solid": _packed(patches.solid_angles.astype("<f4")),
        "theta": _packed(middles[0].astype("<f4")),
        "phi": _packed(middles[1].astype("<f4")),
        "raster": _packed(raster(patches)),
        "raster_shape": RASTER,
        "integrals": summary.integrals,
        "directions": directions,
        "rings": _rings(directions),
        "values": blocks,
        "notes": notes,
        "text": summary_text(summary),
    }


def _direction_rows(summary: Summary, index: int) -> dict[str, Any]:
    """Angles of an incident direction, and the rows of its totals and its ledger."""
    found = summary.directions[index]
    emitted = found.ledger["emitted"]
    exact = summary.integrals and not emitted
    kinds = ("largest error", "limits") if exact else ("std_err", "95 % interval")
    rows = [["", "value", *kinds]]
    for name, total in found.totals:
        channel = total.channel if len(found.dhr) > 1 else ""
        value, error, low, high = total_cells(total)
        rows.append([f"{name} {channel}", value, error, f"{low} to {high}"])
    if exact:
        rows.append(["rays", "none: integrals", "", ""])
    else:
        rows.append(["ledger (counts rays, not power)", "rays", "share of rays", ""])
    for name, n, share in ledger_cells(found.ledger, emitted):
        rows.append([name, n, f"{share} %", ""])
    return {"theta_i": found.theta_i, "phi_i": found.phi_i, "rows": rows}


def _rings(directions: Sequence[dict[str, Any]]) -> list[list[int]]:
    """Numbers of the directions, by polar angle and then by azimuth."""
    angles = [(one["theta_i"], one["phi_i"]) for one in directions]
    order = sorted(range(len(angles)), key=lambda i: [one or 0 for one in angles[i]])
    return [list(ring) for _, ring in groupby(order, lambda i: angles[i][0])]


def raster(patches: Subdivision) -> NDArray[Any]:
    """Patch of each direction of a raster; uint32, of the shape `RASTER`.

    Rows are equal steps of the polar angle, columns of the azimuth, at their middles.
    """
    n_theta, n_phi = RASTER
    theta = (np.arange(n_theta) + 0.5) * np.pi / 2 / n_theta
    phi = (np.arange(n_phi) + 0.5) * 2 * np.pi / n_phi
    v = direction(*np.meshgrid(theta, phi, indexing="ij"))
    return patches.patch(v).astype("<u4")


def _block(single: Record) -> str:
    """Patch means, their uncertainties and hits at one incident direction."""
    shown = ("brdf", "btdf") if single.has_lower else ("brdf",)
    n_channels = len(single.channels)

    def flat(arrays: list[Any]) -> Floats:
        return np.stack([np.reshape(one, (-1, n_channels)) for one in arrays])

    mean = flat([getattr(single, of) for of in shown])
    std_err = flat([getattr(single, f"{of}_std_err") for of in shown])
    limits = [single.interval(0.95, of=of) for of in shown]
    low, high = (flat([pair[end] for pair in limits]) for end in (0, 1))
    arrays = [mean.astype("<f4")]
    arrays += [_rounded(one) for one in (std_err, mean - low, high - mean)]
    hits = np.minimum(single.counts, np.iinfo(np.uint32).max).astype("<u4")
    return _packed(*arrays, hits)


def _rounded(values: Floats) -> Singles:
    """Numbers of `MANTISSA_BITS` bits, which deflate well; NaN where not finite."""
    mantissa, exponent = np.frexp(values)
    mantissa = np.round(mantissa * 2**MANTISSA_BITS) / 2**MANTISSA_BITS
    rounded = np.where(np.isfinite(values), np.ldexp(mantissa, exponent), np.nan)
    return rounded.astype("<f4")


def _packed(*arrays: NDArray[Any]) -> str:
    """The bytes of arrays, one after the other, deflated, in base 64."""
    raw = b"".join(np.ascontiguousarray(one).tobytes() for one in arrays)
    return base64.b64encode(zlib.compress(raw, 6)).decode("ascii")

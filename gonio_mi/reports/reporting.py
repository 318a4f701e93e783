"""One page of records that moves: maps, cuts, lobes, numbers; opened from disk."""

import json
from collections.abc import Sequence
from importlib import resources
from os import PathLike

from ..errors import PackageError, SettingError, SettingTypeError
from ..files import check_output, replacing
from ..progress import bar
from ..results.record import Record
from .packing import packed_record
from .page import html_page

__all__ = ["check_report", "report"]


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
    ledger and settings; and the numbers as CSV. Two records of one collector can stand
    beside each other, with their difference in standard errors. Of a record with more
    than 5.4 million patch values evenly chosen incident directions are shown, and the
    page says so. The page knows the patches of 720 x 720 directions of a hemisphere:
    patches between these are in its CSV only.

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
    records = [records] if isinstance(records, Record) else list(records)
    if not records:
        raise SettingError("records must hold at least one record, got none")
    for one in records:
        if not isinstance(one, Record):
            raise SettingTypeError(
                f"records must be records of gonio_mi, got {type(one).__name__}"
            )
    check_report(path)
    from plotly.offline import get_plotlyjs

    ours = resources.files(__package__)
    total = sum(map(len, records))
    with bar(progress, total=total, desc="report", unit="direction") as done:
        packed = [packed_record(one, done) for one in records]
    data = json.dumps({"records": packed})
    data = data.replace("<", "\\u003c")  # no text of a record ends the script
    body = [
        (ours / "record_page.html").read_text("utf-8"),
        f"<script>{get_plotlyjs()}</script>",
        f'<script type="application/json" id="data">{data}</script>',
        f"<script>{(ours / 'record_page.js').read_text('utf-8')}</script>",
    ]
    title = ", ".join(str(one.settings.get("specimen")) for one in records)
    page = html_page(title, body, (ours / "record_page.css").read_text("utf-8"))
    with replacing(path) as stream:
        stream.write(page.encode("utf-8", "backslashreplace"))


def check_report(path: str | PathLike[str]) -> None:
    """Raise one clear sentence unless a report can be made and written to `path`.

    Raises
    ------
    ImportError
        Without Plotly.
    ValueError, OSError
        If the ending is not ``.html``, or the file cannot be written.
    """
    try:
        import plotly.offline  # noqa: F401
    except ImportError:
        raise PackageError(
            'reports need plotly: run pip install "gonio-mi[report]"'
        ) from None
    check_output(path, (".html",))

"""All formats of this room, and files read by them: as tables and as materials."""

import contextlib
import functools
import importlib
import pkgutil
from collections.abc import Iterator, Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from ... import files
from ...errors import FileFormatError, SettingError, check_regular, no_file, shown
from ...files.measured_table import MeasuredTable, repeats_noted
from ...results.patch_means import PatchMeans
from ...results.record import Record, chosen_channel
from ..tables.reader import Specified, read_text
from .format import Format, without_mark
from .scatter import Scatter, scatter_means

QUANTITIES = ("brdf", "btdf")

# Bytes that tell what a file is.
HEAD_BYTES = 100_000


@functools.cache
def _all() -> tuple[Format, ...]:
    """Formats that the modules beside this one list."""
    package, here = __package__ or "", str(Path(__file__).parent)
    names = sorted(one.name for one in pkgutil.iter_modules([here]))
    modules = [importlib.import_module(f"{package}.{name}") for name in names]
    return tuple(one for module in modules for one in getattr(module, "FORMATS", ()))


def endings_of(can: str, of: str = "endings") -> tuple[str, ...]:
    """Endings of formats that have a part of `Format`, such as ``"scatter"``.

    Those that are read, or of ``"writes"`` those that are written.
    """
    able = [one for one in _all() if getattr(one, can)]
    return tuple(dict.fromkeys(e for one in able for e in getattr(one, of)))


def lost_in_each() -> str:
    """One line per format on what its files cannot hold."""
    rows = ((" ".join(one.endings), one) for one in _all() if one.loses)
    return "\n".join(f"  {name:18} {one.program}: {one.loses}" for name, one in rows)


def written_as(path: str | PathLike[str]) -> tuple[Format, str]:
    """Format that a record is written in to a path, and its ending in small letters.

    The longest of those known, as ``.zemax.bsdf``.
    """
    name, endings = Path(path).name.lower(), endings_of("writes", "writes")
    ending = max(filter(name.endswith, endings), key=len)
    return next(one for one in _all() if ending in one.writes), ending


def format_of(path: str | PathLike[str]) -> Format | None:
    """Format of a file, by its beginning or its name; None of a plain table or record.

    Raises
    ------
    OSError
        If it cannot be opened.
    """
    check_regular(path)
    with open(path, "rb") as stream:
        head = without_mark(stream.read(HEAD_BYTES)).decode("latin-1")
    head = head.replace("\r\n", "\n").replace("\r", "\n")
    ending = Path(path).suffix.lower()
    by_name = [one for one in _all() if ending in one.endings]
    sure = [one for one in by_name if one.begins is None]
    seen = [one for one in _all() if one.begins and one.begins.match(head)]
    seen += [one for one in _all() if one.begins and one.begins.search(head)]
    both = [one for one in seen if one in by_name]
    read = [one for one in by_name if not one.refused]
    return next(iter([*sure, *both, *seen, *read]), None)


@contextlib.contextmanager
def _named(place: object) -> Iterator[None]:
    """Context in which errors carry the name of the file."""
    try:
        yield
    except SettingError as error:
        raise type(error)(f"{place}: {error}") from None


def read_scatter(path: str | PathLike[str]) -> Scatter:
    """Scatter data of a file that holds grids: a material.

    Raises
    ------
    OSError
        If the file cannot be opened.
    FileFormatError
        If it is damaged or something else: one sentence.
    """
    with open(path, "rb") as stream, _named(f"cannot load {path}"):
        known = format_of(path)
        if known is not None and known.refused:
            raise FileFormatError(known.refused.format(path=path))
        if known is None or known.scatter is None:
            raise FileFormatError("it is a table to compare with, not a material")
        return known.scatter(stream)


def load_material(
    path: str | PathLike[str], side: str = "front"
) -> Record | PatchMeans:
    """Record of one batch, the sum of all, or patch means of another tool.

    Parameters
    ----------
    path : str or path
        Ends in ``.npz`` or ``.exr`` for a record; in ``.xml`` for a Radiance BSDF; in
        ``.bsdf``, ``.brdf``, ``.anisotropicbsdf``, ``.json``, ``.xompt`` or
        ``.binary`` for the scatter data of another program.
    side : {"front", "back"}
        The lit face, where the file holds both.

    Returns
    -------
    Record or PatchMeans

    Raises
    ------
    ValueError
        For another ending.
    OSError
        If the file cannot be opened.
    FileFormatError
        If it is damaged, something else, or lacks reflection from that side.
    """
    ending = Path(path).suffix.lower()
    if ending not in {e for one in _all() for e in one.endings}:
        return files.load_added_up(path)
    if not Path(path).exists():
        raise FileNotFoundError(no_file(path))
    known = format_of(path)
    if known is None or known.material is None:
        scatter = read_scatter(path)
        with _named(f"cannot load {path}"):
            return scatter_means(scatter)
    with open(path, "rb") as stream, _named(f"cannot load {path}"):
        return known.material(stream, side)


def read_measured(
    path: str | PathLike[str],
    channel: str | None = None,
    *,
    quantity: str | None = None,
    columns: Mapping[str, str] | None = None,
    azimuth: str | None = None,
    panel_reflectance: float | None = None,
) -> MeasuredTable:
    """Read measured values from text with columns, or from a file of another program.

    What we write ourselves has comment lines ``# key: value``, one line with the names
    of the columns, and one line for each value, separated by commas::

        # units: 1/sr
        # quantity: brdf
        # uncertainty: 0.005
        # aperture_half_angle: 0.75
        # emitter_half_angle: 0.25
        theta_i,phi_i,theta_o,phi_o,value,sigma
        45,0,30,180,0.3181,0.0004

    The columns, in any order, and their ranges are those of :class:`MeasuredTable`;
    `sigma` may be left out, and ``degrees_of_freedom`` tells how well it is known. The
    keys, all optional, are its settings, with ``units``, which must be ``1/sr`` (or 1,
    for a reflectance factor), and ``aperture_solid_angle`` in sr instead of
    ``aperture_half_angle``. Further keys are kept as text in `header`, comment lines
    without a colon are skipped, and so are empty lines. A key that looks like a
    misspelt one is refused.

    Of others' texts the columns are known by names such as ``theta_i/deg``,
    ``Viewing Zenith [deg]``, ``src_a``, ``BRDF (1/sr)`` or ``550nm``; cells are
    separated by tabs, semicolons, commas or blanks, numbers may have decimal commas,
    and lines of a title may come first. A matrix names its angles in the first cell,
    ``theta_o/theta_i`` for rows and columns. Rows at 90 degrees are left out. What was
    inferred is in `notes`; what is ambiguous is asked for.

    Parameters
    ----------
    path : str or path
        Ends in ``.astm`` for text after ASTM E1392
        (:mod:`gonio_mi.exchange.formats.astm`); in
        ``.json`` or ``.xompt`` for OpenMATERIAL, in ``.binary`` for MERL. Files of
        Zemax, Speos and FRED are known by what they hold; any other is text with
        columns.
    channel : str, optional
        Of several, such as ``"550nm"``.
    quantity : {"brdf", "brdf_cos", "btdf", "reflectance_factor"}, optional
        What the values are, if the file does not say it.
    columns : mapping of str, optional
        Name of the column, or a number, for ``theta_i``, ``phi_i``, ``theta_o``,
        ``phi_o``, ``delta_phi``, ``value``, ``sigma`` or ``wavelength``; a unit after
        it as in ``:rad``, ``:um`` or ``:%``, of `sigma` also ``:rel``, ``:abs`` or
        ``:k=2``, says what the name does not.
    azimuth : {"specimen", "source", "mirror"}, optional
        What azimuths of exit are counted from, counter-clockwise: from +x as those of
        incidence are, from the side of the source, or from that of the mirror
        direction, where signed polar angles are positive too.
    panel_reflectance : float, optional
        Of the reference panel that the values are relative to: they are multiplied with
        it. Default: 1, and asked for where the title of reflectance factors states it.

    Returns
    -------
    MeasuredTable

    Raises
    ------
    OSError
        If the file cannot be opened.
    ValueError
        If the file leaves a question open, or lacks what is asked for.
    FileFormatError
        If it is not such a table: one sentence with the file, the line, the column and
        the value.
    """
    if Path(path).suffix.lower() in endings_of("material"):
        raise FileFormatError(
            f"{path} is not a table of values: measure it as a material, "
            f"goniometric:filename={path}, and compare the records"
        )
    known = format_of(path)
    if known is None:
        said = channel, quantity, columns or {}, azimuth, panel_reflectance
        return repeats_noted(read_text(path, Specified(*said)))
    if known.refused:
        raise FileFormatError(f"{path}: {known.refused.format(path=path)}")
    if (columns, azimuth, panel_reflectance) != (None, None, None):
        raise SettingError(
            "columns, azimuth and panel_reflectance apply to text with columns, got "
            f"{path}"
        )
    if quantity not in (None, "brdf", *(() if known.reflection_only else ("btdf",))):
        held = "brdf" if known.reflection_only else "brdf or btdf"
        raise SettingError(f"{path} holds {held}, got the quantity {shown(quantity)}")
    if known.points is not None:
        with open(path, "rb") as stream, _named(path):
            points = known.points(stream, quantity)
    else:
        scatter = read_scatter(path)
        names = [name for h, name in enumerate(QUANTITIES) if scatter.of(h)]
        quantity = names[0] if quantity is None and len(names) == 1 else quantity
        if quantity is None or quantity not in names:
            raise SettingError(
                f"{path} holds {' and '.join(names)}: say --quantity "
                f"{' or '.join(names)}"
            )
        points = scatter.points(quantity)
    channel = chosen_channel(path, points.channels, channel)
    values = points.values[:, points.channels.index(channel)]
    rows = ~(np.isnan(values) & points.partial)
    several = len(points.channels) > 1 or channel.endswith("nm")
    numbers: Any = *points.angles[rows].T, values[rows]
    settings: Any = {"quantity": quantity or "brdf", "name": str(path)}
    settings |= {"channel": channel if several else None}
    settings |= {"header": points.header, "notes": points.notes}
    try:
        table = MeasuredTable(*numbers, **settings)
    except ValueError as error:
        raise FileFormatError(f"{path}: {error}") from None
    return repeats_noted(table)

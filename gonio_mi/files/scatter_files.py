"""Scatter data of other programs, by what the files are."""

from os import PathLike
from pathlib import Path

import numpy as np

from ..errors import FileFormatError, SettingError, shown, unknown_channel
from . import fred, merl, open_material, speos, tensor_file, zemax
from .measured_table import MeasuredTable
from .scatter import Scatter

__all__ = ["ENDINGS", "is_scatter", "read_scatter", "scatter_table"]

# Of materials; FRED's tables have no ending of their own.
ENDINGS = (".bsdf", ".brdf", ".anisotropicbsdf", ".json", ".xompt", ".binary")
JSON = (".json", ".xompt")

# Bytes that tell what a file is.
HEAD = 100_000


def is_scatter(path: str | PathLike[str]) -> bool:
    """Whether a file is, or by its name should be, one of these formats.

    Raises
    ------
    OSError
        If it cannot be opened.
    """
    with open(path, "rb") as stream:
        head = stream.read(HEAD)
    tests = zemax.is_zemax, speos.is_speos, fred.is_fred
    return Path(path).suffix.lower() in ENDINGS or any(test(head) for test in tests)


def read_scatter(path: str | PathLike[str]) -> Scatter:
    """Scatter data of a file that holds grids: a material.

    Raises
    ------
    OSError
        If the file cannot be opened.
    FileFormatError
        If it is damaged or something else: one sentence.
    """
    ending = Path(path).suffix.lower()
    with open(path, "rb") as stream:
        head = stream.read(HEAD)
        stream.seek(0)
        try:
            if ending == ".binary":
                return merl.read(stream)
            if ending in JSON:
                return open_material.read(stream)
            if speos.is_speos(head):
                return speos.read(stream)
            if head.startswith(tensor_file.MAGIC):
                raise FileFormatError(
                    "it is a material of Mitsuba's plugin measured: use "
                    f"measured:filename={path}"
                )
            if fred.is_fred(head):
                raise FileFormatError("it is a table to compare with, and no material")
            return zemax.read(stream)
        except FileFormatError as error:
            raise FileFormatError(f"cannot load {path}: {error}") from None


def scatter_table(
    path: str | PathLike[str], channel: str | None, quantity: str | None
) -> MeasuredTable:
    """Table of the values that a file holds.

    Parameters
    ----------
    path : str or path
    channel : str, optional
        Of several.
    quantity : {"brdf", "btdf"}, optional
        If the file holds both.

    Raises
    ------
    OSError
        If the file cannot be opened.
    ValueError
        If the channel or quantity must be said.
    FileFormatError
        If it is damaged or something else.
    """
    with open(path, "rb") as stream:
        head = stream.read(HEAD)
    is_json = Path(path).suffix.lower() in JSON
    if (is_json or fred.is_fred(head)) and quantity not in (None, "brdf"):
        raise SettingError(f"{path} holds brdf, got the quantity {shown(quantity)}")
    if fred.is_fred(head):
        return _rows_of_fred(path)
    if is_json:
        return _rows_of_json(path, channel)
    scatter = read_scatter(path)
    held = [name for k, name in enumerate(("brdf", "btdf")) if scatter.of(k)]
    if quantity is None and len(held) == 1:
        quantity = held[0]
    if quantity not in held:
        raise SettingError(
            f"{path} holds {' and '.join(held)}: say --quantity {' or '.join(held)}"
        )
    channel = _chosen(path, list(scatter.channels), channel)
    try:
        return scatter.table(channel, quantity, str(path))
    except ValueError as error:
        raise FileFormatError(f"{path}: {error}") from None


def _chosen(path: object, names: list[str], channel: str | None) -> str:
    """The channel that is asked for, or the only one."""
    if channel is None and len(names) == 1:
        return names[0]
    if channel is not None and f"{channel}nm" in names:
        return f"{channel}nm"
    if channel is None or channel not in names:
        raise unknown_channel(path, names, channel)
    return channel


def _rows_of_fred(path: str | PathLike[str]) -> MeasuredTable:
    """Table of a file of FRED."""
    with open(path, "rb") as stream:
        try:
            rows = fred.read(stream)
            above = rows[:, 2] < 90
            notes = ["incidences are told by their specular directions"]
            if not above.all():
                left = np.count_nonzero(~above)
                notes.append(f"{left} rows at or below the horizon are left out")
            rows = rows[above]
            theta_i, phi_i, theta_o, phi_o, value = rows.T
            return MeasuredTable(
                *(theta_i, phi_i, theta_o, phi_o, value),
                name=str(path),
                notes=tuple(notes),
            )
        except ValueError as error:
            raise FileFormatError(f"{path}: {error}") from None


def _rows_of_json(path: str | PathLike[str], channel: str | None) -> MeasuredTable:
    """Table of an OpenMATERIAL file, which need be no grid."""
    try:
        with open(path, "rb") as stream:
            rows, header = open_material.rows(stream)
    except FileFormatError as error:
        raise FileFormatError(f"{path}: {error}") from None
    nm = rows[:, 0]
    names = {f"{one:.6g}nm": one for one in np.unique(nm)}
    channel = _chosen(path, list(names), channel)
    # what is told for 90 degrees is no direction of a table
    here = (nm == names[channel]) & (rows[:, 1] < 90) & (rows[:, 2] < 90)
    if not here.any():
        raise FileFormatError(f"{path}: it has no directions above the horizon")
    theta_i, theta_o, phi_o, value = rows[here, 1:].T
    return MeasuredTable(
        theta_i,
        np.zeros(len(theta_i)),
        theta_o,
        phi_o,
        value,
        channel=channel,
        header=header,
        name=str(path),
        notes=("azimuths count from the source",),
    )

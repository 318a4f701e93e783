"""Tables of measured values from files: plain CSV, and text after ASTM E1392."""

from collections.abc import Mapping
from os import PathLike
from pathlib import Path

import numpy as np

from ..errors import FileFormatError, SettingError, shown, unknown_channel
from . import astm
from .measured_table import MeasuredTable
from .measured_text import Said, read_text
from .scatter_files import is_scatter, scatter_table

__all__ = ["MeasuredTable", "read_measured"]


def read_measured(
    path: str | PathLike[str],
    channel: str | None = None,
    *,
    quantity: str | None = None,
    columns: Mapping[str, str] | None = None,
    azimuth: str | None = None,
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
    and lines of a title may come first. What was inferred is in `notes`; what is
    ambiguous is asked for.

    Parameters
    ----------
    path : str or path
        Ends in ``.astm`` for text after ASTM E1392, see :mod:`gonio_mi.files.astm`; in
        ``.json`` or ``.xompt`` for OpenMATERIAL, in ``.binary`` for MERL. Files of
        Zemax, Speos and FRED are known by what they hold; any other is text with
        columns.
    channel : str, optional
        Of several, such as ``"550nm"``.
    quantity : {"brdf", "brdf_cos", "btdf", "reflectance_factor"}, optional
        What the values are, if the file does not say it.
    columns : mapping of str, optional
        Name of the column, or a number, for ``theta_i``, ``phi_i``, ``theta_o``,
        ``phi_o``, ``delta_phi``, ``value``, ``sigma`` or ``wavelength``; ``:rad`` or
        ``:deg`` after the name of an angle says its unit.
    azimuth : {"specimen", "source", "mirror"}, optional
        What azimuths of exit are counted from, counter-clockwise: from +x as those of
        incidence are, from the side of the source, or from that of the mirror
        direction, where signed polar angles are positive too.

    Returns
    -------
    MeasuredTable

    Raises
    ------
    OSError
        If the file cannot be opened.
    ValueError
        If something must be said that the file leaves open, or is not there.
    FileFormatError
        If it is not such a table: one sentence with the file, the line, the column and
        the value.
    """
    ending = Path(path).suffix.lower()
    if ending == ".xml":
        raise FileFormatError(
            f"{path} is no table of values: measure it as a material, "
            f"goniometric:filename={path}, and compare the records"
        )
    others = ending == ".astm" or is_scatter(path)
    if others and (columns is not None or azimuth is not None):
        raise SettingError(f"columns and azimuth go with a text of columns, got {path}")
    if ending == ".astm":
        if quantity not in (None, "brdf"):
            raise SettingError(f"{path} holds brdf, got the quantity {shown(quantity)}")
        return _read_astm(path, channel)
    if others:
        return scatter_table(path, channel, quantity)
    return read_text(path, Said(channel, quantity, columns, azimuth))


def _read_astm(path: str | PathLike[str], channel: str | None) -> MeasuredTable:
    """One channel of a file after ASTM E1392."""
    with open(path, "rb") as stream:
        try:
            angles, values, names, header = astm.read(stream)
        except FileFormatError as error:
            raise FileFormatError(f"{path}: {error}") from None
    if channel is None and len(names) == 1:
        channel = names[0]
    if channel is None or channel not in names:
        raise unknown_channel(path, names, channel)
    try:
        in_degrees = np.abs(angles).max(initial=0) > 2 * np.pi
        angles = angles if in_degrees else np.degrees(angles)
        theta_i, phi_i, theta_o, phi_o = angles.T
        return MeasuredTable(
            theta_i,
            phi_i,
            theta_o,
            phi_o,
            values[:, names.index(channel)],
            channel=channel if len(names) > 1 or channel.endswith("nm") else None,
            header=header,
            name=str(path),
            notes=(f"angles are in {'degrees' if in_degrees else 'radians'}",),
        )
    except ValueError as error:
        raise FileFormatError(f"{path}: {error}") from None

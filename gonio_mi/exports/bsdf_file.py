"""From a specimen to a BSDF file: all measurements that it needs, and the file."""

from __future__ import annotations

from os import PathLike
from typing import Any

import mitsuba as mi
import numpy as np

from ..errors import SettingError, checked_choice
from ..files import check_output
from ..files.radiance_xml import Product
from ..instrument.measurement import measure_whole
from ..results.record import Record
from .exporting import export
from .radiance_export import BASES, incidence

__all__ = ["CELLS", "RAYS", "bsdf", "hemispherical"]

# Rays for each incident patch where nothing is asked for.
RAYS = 2**16

# Cells per axis of tensor trees: of rank 3 and 4.
CELLS = {"tensor3": 32, "tensor4": 16}

# What the file decides, and not its user.
FIXED = ("theta_i", "phi_i", "incident", "collector", "side", "hemispheres")


def bsdf(
    specimen: Any,
    path: str | PathLike[str],
    basis: str = "klems",
    *,
    solar: Any = None,
    product: Product | None = None,
    cells: int | None = None,
    parameters: dict[str, Any] | None = None,
    progress: bool = False,
    **settings: Any,
) -> dict[str, Record]:
    """Measure all that a Radiance BSDF file says of a specimen, and write it.

    Light fills each incident patch of the file and is collected in the file's own
    patches, so that nothing is resampled: both sides, reflection and transmission.

    Parameters
    ----------
    specimen : dict, mi.BSDF, mi.Scene, str or path
        What :func:`gonio_mi.measure` takes. Its face to +z, the front, looks into the
        room, its +y is up.
    path : str or path
        Ends in ``.xml``.
    basis : {"klems", "klems-half", "klems-quarter", "tensor3", "tensor4"}
        Patches of the file: 145, 77 or 41 in each hemisphere, or a tensor tree, of
        rank 3 for isotropic specimens.
    solar : optional
        The specimen with what it does to all sunlight, if that differs.
    product : Product, optional
        What else the file states.
    cells : int, optional
        Per axis of tensor trees, a power of two. Default: 32 for rank 3, 16 for 4.
    parameters : dict, optional
        Values for the ``$name`` parameters of a scene file.
    progress : bool
        Show progress bars.
    **settings
        Other settings of :func:`gonio_mi.measure`. Default: ``rays=2**16`` for each
        incident patch; or ``rel_err`` or ``noise``.

    Returns
    -------
    dict of Record
        ``"front"`` and ``"back"``; with `solar` ``"solar front"`` and ``"solar back"``
        too.

    Raises
    ------
    TypeError, ValueError
        If a setting is out of its range, or one that the file decides.
    OSError
        If the file cannot be written.
    KeyboardInterrupt
        After Ctrl-C: nothing is written.
    """
    check_output(path, (".xml",))
    checked_choice("basis", basis, BASES)
    for name in FIXED:
        if settings.get(name) is not None:
            raise SettingError(f"{name} is decided by the file, got {settings[name]!r}")
    nm = settings.get("wavelengths")
    nm = np.atleast_1d(550.0 if nm is None else nm)
    if mi.is_spectral and len(nm) > 1:
        raise SettingError(
            f"wavelengths must be one for a file, or none in an rgb variant, got {nm}"
        )
    asked = _checked_cells(basis, cells)
    incident, collector = incidence(basis, asked)
    if all(settings.get(name) is None for name in ("rays", "rel_err", "noise")):
        settings["rays"] = RAYS
    directions: dict[str, Any] = {}
    if basis == "tensor3":
        directions["theta_i"] = np.degrees(incident.middles[0][:, 1])
        directions["phi_i"] = 180.0
    records = {}
    for prefix, measured in (("", specimen), ("solar ", solar)):
        for side in ("front", "back") if measured is not None else ():
            records[prefix + side] = measure_whole(
                measured,
                **directions,
                **settings,
                incident=incident,
                collector=collector,
                side=side,
                parameters=parameters,
                progress=progress,
            )
    light = [records["front"], records["back"]]
    sunlight = [records[name] for name in records if name.startswith("solar")]
    export(light, path, basis, product=product, solar=sunlight)
    return records


def _checked_cells(basis: str, cells: int | None) -> int:
    """Cells per axis of a tensor tree; of a Klems basis there are none."""
    if cells is None:
        return CELLS.get(basis, 2)
    if basis not in CELLS:
        raise SettingError(f"cells goes with the basis tensor3 or tensor4, got {basis}")
    if cells not in [2**k for k in range(2, 9)]:
        raise SettingError(f"cells must be a power of two from 4 to 256, got {cells!r}")
    return int(cells)


def hemispherical(record: Record) -> tuple[float, float]:
    """Reflectance and transmittance of diffuse light, mean of the channels.

    Of a record whose light fills all patches of incidence: the mean over those, by
    their projected solid angle.
    """
    from ..collector import subdivision

    patches = subdivision(record.settings["incident"])
    weight = patches.projected_solid_angles.ravel()
    numbers = patches.patch(_towards(record))
    weight = weight[numbers] / weight[numbers].sum()
    dht: Any = 0.0 if record.dht is None else weight @ record.dht.mean(axis=1)
    return float(weight @ record.dhr.mean(axis=1)), float(dht)


def _towards(record: Record) -> Any:
    from ..collector.directions import direction

    return direction(np.radians(record.theta_i), np.radians(record.phi_i))

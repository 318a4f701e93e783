"""From a specimen to a BSDF file: all measurements that it needs, and the file."""

from collections.abc import Mapping
from concurrent.futures import Executor
from os import PathLike
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from ...annexes import check_there
from ...campaigns.campaign import campaign
from ...campaigns.measure import measure_whole
from ...collector import EqualProjectedSolidAngle
from ...collector.directions import direction
from ...errors import SettingError, checked_choice, warn
from ...files import check_output
from ...results.prediction_error import prediction_error
from ...results.record import Record
from ...settings.values import checked_wavelengths
from ...specimen.specimen_text import SpecimenLike
from ..formats.radiance import Product
from ..formats.radiance_basis import BASES, TO_X, Basis
from .daylight import SOLAR, VISIBLE, VISIBLE_NM, of_daylight
from .exporting import export

# Rays for each incident patch where nothing is asked for.
RAYS = 2**16

# Cells per axis of tensor trees: of rank 3 and 4.
CELLS = {"tensor3": 32, "tensor4": 16}

# Rays and patches of the trial of isotropy, and the total variation distance between
# the specimen and itself turned at which it is anisotropic.
TRIAL_RAYS, TRIAL_PATCHES = 2**14, EqualProjectedSolidAngle(4, 24)
MAX_ANISOTROPY = 0.02

# Settings that the file decides.
FIXED = ("theta_i", "phi_i", "incident", "collector", "side", "hemispheres")


def bsdf(
    specimen: SpecimenLike,
    path: str | PathLike[str],
    basis: str = "klems",
    *,
    solar: Any = None,
    product: Product | None = None,
    cells: int | None = None,
    executor: Executor | int | None = None,
    folder: str | PathLike[str] | None = None,
    **settings: Any,
) -> dict[str, Record]:
    """Measure everything that a Radiance BSDF file contains, and write it.

    Light fills each incident patch of the file and is collected in the file's own
    patches, so that nothing is resampled: both sides, reflection and transmission. The
    back has the seed of the front plus one, so that the errors of both are independent.

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
        The scene with solar-weighted material data, for the Solar block. From
        wavelengths that stand for sunlight it is known without.
    product : Product, optional
        What else the file states.
    cells : int, optional
        Per axis of tensor trees, a power of two. Default: 32 for rank 3, 16 for 4.
    executor, folder : optional
        As of :func:`gonio_mi.campaign`: where to measure, and where finished incident
        patches are kept, so that a call that was interrupted goes on. `folder` has the
        records in the end, ``front.npz`` and so on.
    **settings
        Other arguments of :func:`gonio_mi.measure`, or with `executor` or `folder` of
        :func:`gonio_mi.campaign`. Default: ``rays=2**16`` for each incident patch; or
        ``rel_err`` or ``noise``; in spectral variants 16 ``wavelengths``, for visible
        light.

    Returns
    -------
    dict of Record
        What the file holds: ``"front"`` and ``"back"``, and where it has sunlight
        ``"solar front"`` and ``"solar back"``.

    Raises
    ------
    TypeError, ValueError
        If a setting is out of its range, or one that the file decides.
    OSError
        If the file cannot be written.
    KeyboardInterrupt
        After Ctrl-C: no file is written.
    """
    check_there("materials", "a file .xml")
    check_output(path, (".xml",))
    checked_choice("basis", basis, BASES)
    for name in FIXED:
        if settings.get(name) is not None:
            raise SettingError(f"{name} is decided by the file, got {settings[name]!r}")
    if mi.is_spectral:
        asked = settings.get("wavelengths")
        nm = checked_wavelengths("wavelengths", VISIBLE_NM if asked is None else asked)
        settings["wavelengths"] = nm
        if len(nm) > 1:
            VISIBLE.check(np.array(nm))
            if solar is not None:
                SOLAR.check(np.array(nm))
    size = _checked_cells(basis, cells)
    own = Basis.named(basis, size)
    incident, collector = own.incident, own.patches
    if all(settings.get(name) is None for name in ("rays", "rel_err", "noise")):
        settings["rays"] = RAYS
    if basis == "tensor3":
        _warn_unless_isotropic(specimen, settings)
        settings["theta_i"] = np.degrees(incident.middles[0][:, 1])
        settings["phi_i"] = TO_X
    settings |= {"incident": incident, "collector": collector}
    sides: dict[str, list[Record]] = {"": [], "solar ": []}
    for prefix, measured in (("", specimen), ("solar ", solar)):
        if measured is None:
            continue
        given = settings
        for side in ("front", "back"):
            name = (prefix + side).replace(" ", "_")
            record = _side(measured, name, executor, folder, side=side, **given)
            sides[prefix].append(record)
            given = settings | {"seed": record.asked.seed + 1}
    _warn_of_black_side(*sides[""])
    light, sunlight = of_daylight(sides[""], sides["solar "])
    export(light, path, basis, product=product, solar=sunlight)
    records = dict(zip(("front", "back"), light))
    return records | dict(zip(("solar front", "solar back"), sunlight))


def _warn_unless_isotropic(specimen: SpecimenLike, settings: dict[str, Any]) -> None:
    """Warn of a specimen that scatters differently turned by 45 or 90 degrees."""
    asked: Any = {"rays": TRIAL_RAYS, "rel_err": None, "noise": None}
    asked |= {"collector": TRIAL_PATCHES}
    n = TRIAL_PATCHES.shape[1]
    for side in ("front", "back"):
        azimuths = 7.5, 52.5, 97.5  # middles of sectors
        given = settings | asked | {"side": side}
        found = measure_whole(specimen, 40, azimuths, **given)
        for k in (1, 2):
            turned = np.roll(found.flux_fraction[0], k * n // 8, axis=2)
            missed = prediction_error(found[k], turned)
            if missed.exceeds(MAX_ANISOTROPY):
                warn(
                    "the specimen is not isotropic, as the basis tensor3 takes it: "
                    f"turned by {45 * k} degrees it scatters {missed.error:.0%} of its "
                    "flux elsewhere; take tensor4 or klems"
                )
                return


def _warn_of_black_side(front: Record, back: Record) -> None:
    """Warn if light leaves the specimen when it comes from one side only."""
    lit, dark = (front, back) if _leaves(front) else (back, front)
    if _leaves(lit) and not _leaves(dark):
        warn(
            f"the {dark.asked.side} of the specimen is black in the file, as that of a "
            "one-sided BSDF is: nest the BSDF in the plugin twosided, unless this is "
            "meant"
        )


def _leaves(record: Record) -> bool:
    """Whether any light leaves the specimen."""
    return any(of is not None and of.any() for of in (record.dhr, record.dht))


def _side(
    specimen: SpecimenLike,
    name: str,
    executor: Executor | int | None,
    folder: str | PathLike[str] | None,
    **settings: Any,
) -> Record:
    """Record of one side, here and at once, or in a campaign of its own."""
    if executor is None and folder is None:
        return measure_whole(specimen, **settings)
    own = None if folder is None else Path(folder) / name
    given = {"executor": executor, "folder": own, **settings}
    record = campaign({name: specimen}, **given)[name]
    if own is not None:
        record.save(own.with_suffix(".npz"))
    return record


def _checked_cells(basis: str, cells: int | None) -> int:
    """Cells per axis of a tensor tree; of a Klems basis there are none."""
    if cells is None:
        return CELLS.get(basis, 2)
    if basis not in CELLS:
        raise SettingError(
            f"cells applies to the basis tensor3 or tensor4, got {basis}"
        )
    if cells not in [2**k for k in range(2, 9)]:
        raise SettingError(f"cells must be a power of two from 4 to 256, got {cells!r}")
    return int(cells)


# Polar angles in degrees that differ by less are the same ring.
RING_TOLERANCE = 1e-3


def properties(records: Mapping[str, Record]) -> dict[str, dict[str, dict[str, float]]]:
    """Transmittances and reflectances, by the lit side and the light.

    Parameters
    ----------
    records : mapping of Record
        Of one channel, as :func:`bsdf` returns them.

    Returns
    -------
    dict
        By the side, and ``"normal"``, the mean of the incident patches that touch the
        normal, or ``"diffuse"``, that of all by their projected solid angle:
        ``tau_vis``, ``rho_vis``, of sunlight ``tau_sol``, ``rho_sol``, and where light
        passes openings ``tau_direct_vis``. Of each also its standard error, with the
        ending ``_std_err``.
    """
    found: dict[str, dict[str, dict[str, float]]] = {}
    for name, record in records.items():
        *solar, side = name.split()
        ending = "sol" if solar else "vis"
        patches: Any = record.asked.incident
        toward = direction(np.radians(record.theta_i), np.radians(record.phi_i))
        solid = patches.projected_solid_angles.ravel()[patches.patch(toward)]
        near = record.theta_i <= record.theta_i.min() + RING_TOLERANCE
        quantities = {"tau": "dht", "rho": "dhr"}
        if record.ledger.direct:
            quantities["tau_direct"] = "direct"
        for light, weight in (("normal", solid * near), ("diffuse", solid)):
            row = found.setdefault(side, {}).setdefault(light, {})
            for symbol, quantity in quantities.items():
                share, key = weight / weight.sum(), f"{symbol}_{ending}"
                row[key] = row[f"{key}_std_err"] = 0.0
                if getattr(record, quantity) is not None:  # else none is transmitted
                    value = getattr(record, quantity)[:, 0]
                    error = getattr(record, f"{quantity}_std_err")[:, 0]
                    row[key] = float(share @ value)
                    row[f"{key}_std_err"] = float(np.linalg.norm(share * error))
    return found

"""Records as labelled arrays of xarray, and as NetCDF and HDF5 files."""

import json
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO

import numpy as np

from ..errors import PackageError, to_install
from ..results.record import Record, wavelengths_nm
from .header import FRAMES

CONVENTIONS = (
    "Patch means in 1/sr, without cosine. Angles in degrees: theta_i from the normal "
    "of the lit face, phi from +x counter-clockwise, theta from the pole of either "
    "hemisphere; the mirror direction has phi = phi_i + 180."
)

# What a standard error is, for whoever reads the file.
STD_ERR = "standard error (k = 1); of integrals the largest error, estimated"


def dataset(record: Record) -> Any:
    """Labelled arrays of a record.

    Parameters
    ----------
    record : Record

    Returns
    -------
    xarray.Dataset
        `bsdf` and `std_err` in 1/sr, with the dimensions ``incident, hemisphere, ring,
        sector, channel``; `counts` without the last; of polarised variants `mueller`
        and `mueller_std_err` with ``stokes_out, stokes_in`` after it; as coordinates
        `theta_i`, `phi_i` and the middles `theta`, `phi` of the patches in degrees, and
        `wavelength` in nm of channels that have one; the settings as JSON.

    Raises
    ------
    ImportError
        Without xarray.
    """
    try:
        import xarray
    except ImportError:
        raise PackageError(
            "labelled arrays and NetCDF files need xarray, which is not installed: "
            f"{to_install('netcdf')}"
        ) from None
    stack = list(record)
    names = ["reflection", "transmission"][: record.n_hemispheres]
    quantities = ["brdf", "btdf"][: len(names)]
    values, errors = (
        np.array([[getattr(one, name + end) for name in quantities] for one in stack])
        for end in ("", "_std_err")
    )
    counts = np.stack([one.counts for one in stack]).astype(float)
    theta, phi = (np.degrees(angle) for angle in record.subdivision.middles)
    patches = "incident", "hemisphere", "ring", "sector"
    unit = {"units": "sr-1"}
    degrees = {"units": "degree"}
    solid, coordinates = record.subdivision.projected_solid_angles, {}
    wavelengths = wavelengths_nm(record.channels)
    if wavelengths is not None:
        coordinates["wavelength"] = ("channel", wavelengths, {"units": "nm"})
    matrices = {}
    if record.polarised:
        dimensions = (*patches, "channel", "stokes_out", "stokes_in")
        for ending, name in (("", "mueller"), ("_std_err", "mueller_std_err")):
            of_each = [
                [getattr(one, f"{quantity}_mueller{ending}") for quantity in quantities]
                for one in stack
            ]
            matrices[name] = (dimensions, np.array(of_each), unit | {"frames": FRAMES})
    return xarray.Dataset(
        matrices
        | {
            "bsdf": ((*patches, "channel"), values, unit),
            "std_err": ((*patches, "channel"), errors, unit | {"long_name": STD_ERR}),
            "counts": (patches, counts),
            "projected_solid_angle": (patches[2:], solid, {"units": "sr"}),
        },
        coords={
            "theta_i": ("incident", record.theta_i, degrees),
            "phi_i": ("incident", record.phi_i, degrees),
            "hemisphere": names,
            "theta": (patches[2:], theta, degrees),
            "phi": (patches[2:], phi, degrees),
            "channel": list(record.channels),
            **coordinates,
        },
        attrs={
            "collector": str(record.subdivision),
            "conventions": CONVENTIONS,
            "settings": json.dumps(record.settings),
        },
    )


def write(record: Record, stream: BinaryIO, engine: str = "scipy") -> None:
    """Write a record to a binary stream, by an engine of xarray.

    ``scipy`` makes NetCDF 3, and ``h5netcdf`` NetCDF 4: an HDF5 file, whose dimension
    scales, attributes ``units`` and texts any reader of HDF5 has without xarray.

    Raises
    ------
    ImportError
        Without xarray, or without the package h5netcdf for that engine.
    """
    arrays = dataset(record)
    if find_spec(engine) is None:
        raise PackageError(
            f"HDF5 files need {engine}, which is not installed: {to_install('netcdf')}"
        )
    with TemporaryDirectory() as folder:
        path = Path(folder) / "record"
        arrays.to_netcdf(path, engine=engine)
        stream.write(path.read_bytes())

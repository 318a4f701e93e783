"""Records as material files of Mitsuba's plugin `measured`."""

import warnings
from os import PathLike
from typing import Any

import mitsuba as mi
import numpy as np

from ..array_types import Floats, Numbers
from ..errors import SettingError, VariantError, abridged
from ..files import replacing, tensor_file
from ..files.channels import wavelengths_nm
from ..instrument.measurement import measure_whole
from ..results.record import Record
from .loss import Loss, losses
from .resampling import Material, half_vector_grid

__all__ = ["write_measured"]

# Vertices per side of the grid of half vectors.
GRID = 128

# With which what was written is measured again.
RAYS = 2**20


def write_measured(record: Record, path: str | PathLike[str]) -> list[Loss]:
    """Write a record for Mitsuba's `measured`, and return its losses.

    Parameters
    ----------
    record : Record
        Of one channel, R, G, B or wavelengths; its reflection is written.
    path : str or path

    Raises
    ------
    VariantError
        If Mitsuba's variant is not one of rgb, or spectral for wavelengths.
    ValueError
        If the record's incident directions are no grid.
    """
    spectral = _is_spectral(record)
    wavelengths: Any = wavelengths_nm(record.channels)
    fields = _fields(Material(record), wavelengths, spectral)
    fields = {name: array.astype(np.float32) for name, array in fields.items()}
    text = record.settings.get("specimen", "a record").encode()
    fields["description"] = np.frombuffer(text, np.uint8)
    fields["jacobian"] = np.zeros(1, np.uint8)
    with replacing(path) as stream:
        tensor_file.write(fields, stream)
    with open(path, "rb") as stream:
        tensor_file.read(stream)
    settings = {"collector": record.subdivision, "rays": RAYS}
    if spectral:
        settings["wavelengths"] = wavelengths.tolist()
    with warnings.catch_warnings():
        # what Mitsuba's interpolation adds is told as a loss of the file
        warnings.filterwarnings("ignore", "the BSDF creates light")
        again = [
            measure_whole(
                {"type": "measured", "filename": str(path)}, *angles, **settings
            )
            for angles in zip(record.theta_i, record.phi_i)
        ]
    return losses(record, np.stack([one.flux_fraction[:1] for one in again]))


def _is_spectral(record: Record) -> bool:
    """Whether the file is for spectral variants, or raise."""
    spectral = wavelengths_nm(record.channels) is not None
    wanted = "spectral" if spectral else "rgb"
    if not (mi.variant() or "").endswith(wanted):
        raise VariantError(
            f"Mitsuba's measured needs a variant of {wanted} for a .bsdf file of "
            f"{abridged(', '.join(record.channels), 80)}, such as "
            f"llvm_ad_{wanted}, got "
            f"{mi.variant()}"
        )
    if not spectral and record.channels not in (("Y",), ("R", "G", "B")):
        raise SettingError(
            "a .bsdf file takes records of one channel, of R, G, B or of wavelengths, "
            f"got {abridged(', '.join(record.channels), 80)}"
        )
    return spectral


def _fields(material: Material, wavelengths: Any, spectral: bool) -> dict[str, Numbers]:
    """Arrays of the file, but for the texts."""
    theta_i, phi_i = material.theta_i, material.phi_i
    if len(phi_i) == 1:
        origins, azimuths = phi_i, np.zeros(1)
    else:
        turned = np.unique(np.mod(phi_i + 180, 360) - 180)
        azimuths = np.unique([-180, *turned, 180])
        origins, phi_i = np.zeros(len(azimuths)), azimuths
    values = np.stack(
        [
            [half_vector_grid(material, theta, phi, origin, GRID) for theta in theta_i]
            for phi, origin in zip(phi_i, origins)
        ]
    )
    fields = {
        "theta_i": np.radians(theta_i),
        "phi_i": np.radians(azimuths),
        "ndf": np.ones((2, 2)),
        "sigma": np.ones((2, 2)),
        "vndf": np.ones((*values.shape[:2], 2, 2)),
        "luminance": _importance(values.mean(axis=2), theta_i, azimuths, origins),
    }
    if spectral:
        order = np.argsort(wavelengths)
        fields["wavelengths"] = wavelengths[order]
        fields["spectra"] = values[:, :, order]
    else:
        fields["rgb"] = values.repeat(3, axis=2) if values.shape[2] == 1 else values
    return fields


def _importance(
    values: Floats, theta_i: Floats, azimuths: Floats, origins: Floats
) -> Floats:
    """Light per area of the grid of half vectors: where `measured` samples."""
    u = np.linspace(0, 1, GRID)
    theta_m, turn = u**2 * (np.pi / 2), 2 * np.pi * u[:, None] - np.pi
    weights = np.empty_like(values)
    for (j, i), _ in np.ndenumerate(values[..., 0, 0]):
        theta, phi = np.radians(theta_i[i]), np.radians(azimuths[j])
        relative = turn if len(azimuths) == 1 else turn - phi + np.radians(origins[j])
        cosine = np.sin(theta) * np.sin(theta_m) * np.cos(relative)
        cosine = cosine + np.cos(theta) * np.cos(theta_m)
        weights[j, i] = values[j, i] * u * np.sin(theta_m) * np.maximum(cosine, 0)
    # sampled a little everywhere, lest values are interpolated where none would be
    return weights + 1e-4 * np.maximum(weights.mean(axis=(2, 3), keepdims=True), 1e-12)

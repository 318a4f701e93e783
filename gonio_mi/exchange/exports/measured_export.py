"""Records as material files of Mitsuba's plugin `measured`."""

from __future__ import annotations

from os import PathLike
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...array_types import Floats, Numbers
from ...collector.directions import direction
from ...collector.hemisphere import Subdivision
from ...errors import VariantError, abridged, muted
from ...files import replacing, tensor_file
from ...instrument.measure import measure_each
from ...materials.resampling import Material, half_vector_grids, vectors
from ...progress import counted
from ...results.record import Record, wavelengths_nm
from ...specimen.loading import loaded
from ...specimen.wavelengths import passes, wavelength_lanes
from ...transport.surface_events import flux_context
from .loss import Loss, losses

# Vertices per side of the grid of half vectors.
GRID = 128

# Points at which the written file is evaluated. Where two halves of them differ by more
# than this fraction of the flux, so many rays are sent instead.
READ_BACK_POINTS, MAX_DIFFERENCE, READ_BACK_RAYS = 2**16, 2e-3, 2**20


def write_measured(
    record: Record, path: str | PathLike[str], progress: bool
) -> list[Loss]:
    """Write a record for Mitsuba's `measured`, and return its losses.

    Parameters
    ----------
    record : Record
        Of one channel, R, G, B or wavelengths; its reflection is written.
    path : str or path
    progress : bool

    Raises
    ------
    VariantError
        If Mitsuba's variant is not one of rgb, or spectral for wavelengths.
    ValueError
        If the record's incident directions are no grid.
    """
    wavelengths = _checked_wavelengths(record)
    fields = _fields(Material(record), wavelengths, progress)
    fields = {name: array.astype(np.float32) for name, array in fields.items()}
    text = record.provenance.name.encode()
    fields["description"] = np.frombuffer(text, np.uint8)
    fields["jacobian"] = np.zeros(1, np.uint8)
    with replacing(path) as stream:
        tensor_file.write(fields, stream)
    nm = None if wavelengths is None else wavelengths.tolist()
    return losses(record, _written(str(path), record, nm, progress))


def _written(
    filename: str, record: Record, nm: list[float] | None, progress: bool
) -> Floats:
    """Flux fractions that a file has in the record's patches."""
    material = {"type": "measured", "filename": filename}
    bsdf = loaded("the file", mi.load_dict, material)
    patches, incidents = record.subdivision, list(zip(record.theta_i, record.phi_i))
    wo = vectors(_halved(patches))
    halves = np.empty((len(incidents), len(record.channels), patches.n_patches, 2))
    numbers = range(len(incidents))
    for number in counted(numbers, progress, desc="read back", unit="direction"):
        halves[number] = _asked(bsdf, incidents[number], wo, nm, halves.shape[1:])
    halves *= patches.solid_angles.ravel()[:, None]
    flux = np.moveaxis(halves.sum(axis=-1), 1, 2)
    flux = flux.reshape(-1, 1, *patches.shape, len(record.channels))
    apart = np.abs(np.diff(halves, axis=-1)).sum(axis=(1, 2, 3))
    rough = np.flatnonzero(apart > MAX_DIFFERENCE * halves.sum(axis=(1, 2, 3)))
    if rough.size:
        settings = {"collector": patches, "rays": READ_BACK_RAYS, "wavelengths": nm}
        settings |= {"whole": True, "progress": progress}
        # flux that Mitsuba's interpolation adds counts as a loss of the file
        with muted("the BSDF is not energy conserving"):
            some = [incidents[i] for i in rough]
            again = measure_each(material, some, **settings)
        flux[rough] = again.flux_fraction[:, :1]
    return flux


def _halved(patches: Subdivision) -> Floats:
    """Points of all patches that stand for equal solid angles, ``(n, 3)``.

    Every other one of a patch comes before the rest of it.
    """
    n = 2 * max(2, round(np.sqrt(READ_BACK_POINTS / patches.n_patches) / 2))
    low, high, left, right = patches.cells_about_pole().T[:, :, None]
    step = (np.arange(n) + 0.5) / n
    theta = np.arccos(np.cos(low) + step * (np.cos(high) - np.cos(low)))
    phi = left + step * (right - left)
    points = direction(theta[:, :, None], phi[:, None]).reshape(-1, n**2, 3)
    parity = np.indices((n, n)).sum(axis=0).ravel() % 2
    return points[:, np.argsort(parity, kind="stable")].reshape(-1, 3)


def _asked(
    bsdf: mi.BSDF,
    incident: tuple[float, float],
    wo: Any,
    nm: list[float] | None,
    shape: tuple[int, ...],
) -> Floats:
    """Halves of the mean light of a BSDF over each patch in 1/sr, of this `shape`."""
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.wi = mi.Vector3f(direction(*np.radians(incident)).tolist())
    dr.make_opaque(si.wi)
    sums = []
    for some in passes(nm):
        si.wavelengths = wavelength_lanes(some and tuple(some))
        light = bsdf.eval(flux_context(), si, wo)
        sums += list(light)[: some and len(some)]
    dr.eval(sums)  # in one kernel: block_sum takes one for each
    size = dr.width(wo) // (shape[1] * shape[2])
    sums = [dr.block_sum(one, size) for one in sums[: shape[0]]]
    dr.eval(sums)
    return np.reshape([one.numpy() for one in sums], shape) / (2 * size)


def _checked_wavelengths(record: Record) -> Floats | None:
    """Wavelengths of a file for spectral variants, None for colours; or raise."""
    wavelengths = wavelengths_nm(record.channels)
    wanted = "rgb" if wavelengths is None else "spectral"
    if not (mi.variant() or "").endswith(wanted):
        raise VariantError(
            f"Mitsuba's measured needs a variant of {wanted} for a .bsdf file of "
            f"{abridged(', '.join(record.channels), 80)}, such as llvm_ad_{wanted}, "
            f"got {mi.variant()}"
        )
    return wavelengths


def _fields(
    material: Material, wavelengths: Floats | None, progress: bool
) -> dict[str, Numbers]:
    """Arrays of the file, except texts."""
    theta_i, phi_i = material.theta_i, material.phi_i
    origins, azimuths = phi_i, np.zeros(1)
    if len(phi_i) > 1:
        azimuths = np.unique([-180, *(np.mod(phi_i + 180, 360) - 180), 180])
        origins, phi_i = np.zeros(len(azimuths)), azimuths
    turns = list(zip(np.mod(phi_i, 360).tolist(), origins))  # the first may be the last
    grids = {
        turn: half_vector_grids(material, *turn, GRID)
        for turn in counted(set(turns), progress, desc="write", unit="azimuth")
    }
    values = np.stack([grids[turn] for turn in turns])
    fields = {
        "theta_i": np.radians(theta_i),
        "phi_i": np.radians(azimuths),
        "ndf": np.ones((2, 2)),
        "sigma": np.ones((2, 2)),
        "vndf": np.ones((*values.shape[:2], 2, 2)),
        "luminance": _importance(values.mean(axis=2), theta_i, azimuths, origins),
    }
    if wavelengths is not None:
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

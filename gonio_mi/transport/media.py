"""The media inside of a specimen's shapes, and whether they are media at all."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..errors import SpecimenError, abridged
from ..settings import Estimator
from ..single_precision import FEW_ROUNDINGS
from .scene_objects import class_of

__all__ = ["check_media", "differ_by_channel", "media_of"]

# Points inside of a medium at which its coefficients are looked at.
N_POINTS = 2**12


def media_of(surfaces: Sequence[mi.Shape]) -> list[mi.Medium]:
    """List of the media on either side of `surfaces`, each of them once."""
    found = {}
    for shape in surfaces:
        for medium in _sides(shape):
            if medium is not None:
                found[medium.ptr] = medium
    return list(found.values())


def check_media(
    specimen: Any, wavelengths: Sequence[mi.Spectrum], estimator: Estimator
) -> None:
    """Raise SpecimenError for media that light cannot reach, or that are no media.

    Parameters
    ----------
    specimen : Specimen
    wavelengths : sequence of mi.Spectrum or mi.Color0f
        Of each pass.
    estimator : Estimator
        One that collects rays where they leave; others say nothing of media.
    """
    surfaces = specimen.surfaces
    if not estimator.follows_exits:
        raise SpecimenError(
            "a specimen with a medium must be measured by the estimator weighted or "
            f"analog, got {estimator}"
        )
    for medium in specimen.media:
        borders = [
            shape
            for shape in surfaces
            if any(
                side is not None and side.ptr == medium.ptr for side in _sides(shape)
            )
        ]
        flags = [shape.bsdf().flags() for shape in borders]
        if not any(mi.has_flag(f, mi.BSDFFlags.Transmission) for f in flags):
            shape = borders[0]
            raise SpecimenError(
                f"the medium of the {shape.class_name()} {shape.id()!r} must be behind "
                "a BSDF that transmits, such as null or dielectric, got "
                f"{class_of(shape.bsdf())}, which hides it"
            )
        name = f"the medium {class_of(medium)} of the {borders[0].class_name()}"
        if medium.phase_function() is None:
            raise SpecimenError(f"{name} must have a phase function, got none")
        _check_data(name, medium)
        for lanes in wavelengths:
            try:
                _check_coefficients(name, medium, specimen.low, specimen.high, lanes)
            except RuntimeError as error:
                said = abridged(" ".join(str(error).split()), 200)
                raise SpecimenError(
                    f"{name} fails in the variant {mi.variant()}: {said}"
                ) from error


def differ_by_channel(media: Sequence[mi.Medium], wavelengths: mi.Spectrum) -> bool:
    """Whether the free paths of light depend on its channel, in any of the `media`.

    Only of homogeneous media one point tells that they do not.
    """
    if len(mi.Spectrum()) == 1:
        return False
    for medium in media:
        if not medium.is_homogeneous():
            return True
        majorant = np.array(medium.get_majorant(_interactions(wavelengths))).ravel()
        if np.any(majorant != majorant[0]):
            return True
    return False


def _sides(shape: mi.Shape) -> tuple[Any, Any]:
    return shape.interior_medium(), shape.exterior_medium()


def _interactions(wavelengths: mi.Spectrum) -> mi.MediumInteraction3f:
    """Medium interaction at the origin, of light that came down."""
    mei = dr.zeros(mi.MediumInteraction3f)
    mei.wi = mi.Vector3f(0, 0, 1)
    mei.sh_frame = mi.Frame3f(mei.wi)
    mei.wavelengths = wavelengths
    return mei


def _check_data(name: str, medium: mi.Medium) -> None:
    """Raise SpecimenError for numbers of a grid or its scale that cannot be."""
    parameters = mi.traverse(medium)
    for key in ("sigma_t", "albedo"):
        grid = f"{key}.data"
        if grid not in parameters:
            continue
        data = np.array(parameters[grid])
        if mi.is_spectral and data.shape[-1] != 1:
            continue  # coefficients of spectra, not values
        _check_range(name, key, float(data.min()), float(data.max()))


def _check_coefficients(
    name: str, medium: mi.Medium, low: Any, high: Any, wavelengths: mi.Spectrum
) -> None:
    """Raise SpecimenError for coefficients that cannot be, at points of the box."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, N_POINTS)
    mei = _interactions(wavelengths)
    mei.wi = mi.warp.square_to_uniform_sphere(sampler.next_2d())
    mei.sh_frame = mi.Frame3f(mei.wi)
    x, y = sampler.next_2d()
    part = mi.Vector3f(x, y, sampler.next_1d())
    mei.p = mi.Point3f(low.tolist()) + part * mi.Vector3f((high - low).tolist())
    majorant = np.array(medium.get_majorant(mei), dtype=float)
    scattering, rest, extinction = (
        np.array(c, dtype=float) for c in medium.get_scattering_coefficients(mei)
    )
    _check_range(name, "sigma_t", extinction.min(), extinction.max())
    _check_range(name, "majorant", majorant.min(), majorant.max())
    if not majorant.max() > 0:
        raise SpecimenError(
            f"{name} must have a sigma_t above 0 somewhere, got a majorant of "
            f"{majorant.max():g}: take the medium out of the scene"
        )
    with np.errstate(invalid="ignore", divide="ignore"):
        albedo = np.where(extinction > 0, scattering / extinction, 0.0)
    _check_range(name, "albedo", albedo.min(), albedo.max())
    if rest.min() < -FEW_ROUNDINGS * majorant.max():
        raise SpecimenError(
            f"{name} must have a majorant that no sigma_t exceeds, got "
            f"{majorant.max():g} and {extinction.max():g}"
        )


def _check_range(name: str, quantity: str, low: float, high: float) -> None:
    """Raise SpecimenError for what is negative, not finite, or an albedo above 1."""
    if not (low >= 0 and high < np.inf):
        worst = low if not low >= 0 else high
        raise SpecimenError(
            f"{name} must have a {quantity} that is finite and not negative, "
            f"got {worst:g}"
        )
    if quantity == "albedo" and high > 1 + FEW_ROUNDINGS:
        raise SpecimenError(f"{name} must have an albedo of at most 1, got {high:g}")

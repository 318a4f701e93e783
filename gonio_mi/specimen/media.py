"""The media of a specimen, and checks of their data and phase functions.

Rays ask a phase function for `sample` alone: whether `eval` agrees is found out before.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Floats, Integers
from ..errors import SpecimenError, abridged, is_ctrl_c
from ..single_precision import FEW_ROUNDINGS
from ..variants import check_unpolarised
from .scene_objects import class_of, is_foreign, traversed

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


def check_media(specimen: Any, wavelengths: Sequence[mi.Spectrum]) -> None:
    """Raise SpecimenError for media that light cannot reach, or that are no media.

    And VariantError in polarised variants, whose phase functions are not modelled.

    Parameters
    ----------
    specimen : Specimen
    wavelengths : sequence of mi.Spectrum or mi.Color0f
        Of each pass.
    """
    check_unpolarised("a specimen with a medium")
    surfaces = specimen.surfaces
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
        mei = _interactions(wavelengths, mi.Vector3f(0, 0, 1))
        majorant = np.array(medium.get_majorant(mei)).ravel()
        if np.any(majorant != majorant[0]):
            return True
    return False


def _sides(shape: mi.Shape) -> tuple[Any, Any]:
    return shape.interior_medium(), shape.exterior_medium()


def _interactions(wavelengths: mi.Spectrum, wi: mi.Vector3f) -> mi.MediumInteraction3f:
    """Interactions with a medium at the origin, of light from `wi`."""
    mei = dr.zeros(mi.MediumInteraction3f)
    mei.wi = wi
    mei.sh_frame = mi.Frame3f(wi)
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
    wi = mi.warp.square_to_uniform_sphere(sampler.next_2d())
    mei = _interactions(wavelengths, wi)
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


# Where light comes from, off all axes, and rays for each.
ASKED_FROM = ((0.3, -0.5, 0.8), (-0.6, 0.4, -0.7), (0.7, 0.6, 0.3), (-0.2, -0.9, -0.4))
N_ASKED = 2**16

# Probability that a right phase function is said to be wrong, over the random numbers
# that it is asked with. They are the same at each call.
FALSE_ALARM = 1e-6

# Rings about the direction of flight, each cut into four, whose light is compared; and
# that of the octants.
RINGS = np.radians([1, 3, 10, 30, 60, 90, 120, 150, 170, 177, 179])
N_RINGED = 4 * (len(RINGS) + 1)
N_CELLS = N_RINGED + 8

# Mitsuba's phase functions whose `sample` and `eval` agree, as the tests ask them; of
# `hg` up to a peak that single precision resolves.
SOUND = ("IsotropicPhaseFunction", "RayleighPhaseFunction", "HGPhaseFunction")
MAX_SOUND_G = 0.99

# What `eval` is integrated by: the sphere, with this share of the points, and lobes of
# Henyey and Greenstein about the direction of flight and back.
UNIFORM = 0.4
LOBES = np.array([sign * g for g in (0.8, 0.97, 0.996, 0.9995) for sign in (1, -1)])


@dataclass(frozen=True)
class PhaseAnswers:
    """How a phase function scatters light from some directions, by either method.

    Attributes
    ----------
    along : ndarray, shape (directions, 3)
        Directions of flight.
    sampled, evaluated : ndarray, shape (directions, cells)
        Share of the light that is scattered into each cell of the sphere: by `sample`,
        and the integral of `eval`.
    tolerance : ndarray, shape (directions, cells)
        By how much they may differ by chance: everywhere, with a probability of at
        least ``1 - FALSE_ALARM``.
    nonsense : float
        Share of the directions for which `eval` is infinite, NaN or negative.
    """

    along: Floats
    sampled: Floats
    evaluated: Floats
    tolerance: Floats
    nonsense: float

    @property
    def misplaced(self) -> Floats:
        """Share of the light of each direction that the methods place in other rings.

        Noise alone makes it 0.01 to 0.02.
        """
        apart = np.abs(self.sampled - self.evaluated)[:, :N_RINGED]
        return apart.sum(axis=1) / 2

    @property
    def excess(self) -> float:
        """Largest difference, in units of its tolerance."""
        return float(np.max(np.abs(self.sampled - self.evaluated) / self.tolerance))


def ask_phase_function(
    phase: mi.PhaseFunction,
    wavelengths: mi.Spectrum,
    low: Any = (0, 0, 0),
    high: Any = (1, 1, 1),
) -> PhaseAnswers:
    """Ask a phase function where it scatters light, at points of a box.

    The tolerance is the bound of Maurer and Pontil (2009) for means of any bounded
    numbers; `eval` over the density of the points is taken to be bounded by the largest
    value that was met.

    Parameters
    ----------
    phase : mi.PhaseFunction
    wavelengths : mi.Spectrum or mi.Color0f
        Of the light, whose channels are averaged.
    low, high : sequence of 3 float
        Corners of the box.
    """
    wi, frames, asked, u, density, towards, reached = _questions()
    mei = _interactions(wavelengths, mi.Vector3f(*wi[asked].T))
    corner, extent = np.array(low, float), np.subtract(high, low, dtype=float)
    mei.p = mi.Point3f(*(corner[:, None] + extent[:, None] * u[:3]))
    ctx = mi.PhaseFunctionContext(None, mi.TransportMode.Importance)
    u1, u2 = mi.Float(u[3]), mi.Point2f(*u[4:])
    flights, weight, _ = phase.sample(ctx, mei, u1, u2, mi.Bool(True))
    value, _ = phase.eval_pdf(ctx, mei, mi.Vector3f(*towards.T), mi.Bool(True))

    power, ratio = _means(weight, asked), _means(value, asked) / density
    sane = (ratio >= 0) & (ratio < np.inf)
    ratio[~sane] = 0
    met, known = np.array(flights, float).T, asked * N_CELLS
    kinds = zip(_cells(met, frames[asked]), reached)
    pairs = [(known + one, known + other) for one, other in kinds]
    sampled, evaluated, squares = (np.zeros(len(wi) * N_CELLS) for _ in range(3))
    for one, other in pairs:
        n, same = len(squares), one == other
        sampled += np.bincount(one, power, n)
        evaluated += np.bincount(other, ratio, n)
        squares += np.bincount(one, power**2, n) + np.bincount(other, ratio**2, n)
        squares -= 2 * np.bincount(one[same], (power * ratio)[same], n)
    sampled, evaluated, squares = (
        x.reshape(-1, N_CELLS) / N_ASKED for x in (sampled, evaluated, squares)
    )
    variance = np.maximum(squares - (sampled - evaluated) ** 2, 0)
    level = np.log(4 * variance.size / FALSE_ALARM)
    span = power.max() + ratio.max()
    tolerance = np.sqrt(2 * variance * level / N_ASKED)
    tolerance += 7 * span * level / (3 * (N_ASKED - 1))
    return PhaseAnswers(-wi, sampled, evaluated, tolerance, float(1 - sane.mean()))


@functools.cache
def _questions() -> tuple[Any, ...]:
    """Constant directions and random numbers for all phase functions.

    Directions to the light and their frames; for each ray the index of its frame, six
    random numbers, a density, a direction drawn from it, and the cells of that.
    """
    rng = np.random.default_rng(0)
    wi = np.array(ASKED_FROM) / np.linalg.norm(ASKED_FROM, axis=1, keepdims=True)
    across = np.cross(wi, [1.0, 0.0, 0.0])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    frames = np.stack([across, np.cross(wi, across), -wi], axis=1)
    asked = np.repeat(np.arange(len(wi)), N_ASKED)
    u = rng.random((9, len(asked)), dtype=np.float32)
    local, density = _points(u[:3].astype(float))
    towards = np.einsum("in,nij->nj", local, frames[asked])
    reached = _cells(towards, frames[asked])
    return wi, frames, asked, u[3:], density, towards, reached


def phase_defect(
    phase: mi.PhaseFunction, wavelengths: mi.Spectrum, low: Any, high: Any
) -> str | None:
    """Sentence on a phase function whose methods disagree; None if they agree.

    And for one in Python without `eval_pdf`, which no ray has a use for.
    """
    if is_sound(phase):
        return None
    try:
        found = ask_phase_function(phase, wavelengths, low, high)
    except Exception as error:
        # a plugin may raise anything; of `sample` the measurement will
        if is_ctrl_c(error):
            raise
        return None
    name = f"the phase function {class_of(phase)}"
    if found.nonsense:
        return (
            f"eval() of {name} is infinite, NaN or negative in {found.nonsense:.2g} of "
            "the directions near its peaks; what is measured is sample()"
        )
    if found.excess <= 1:
        return None
    worst = int(np.argmax(found.misplaced))
    flight = ", ".join(f"{x:.2f}" for x in found.along[worst])
    return (
        f"sample() and eval() of {name} disagree on {found.misplaced[worst]:.2f} of "
        f"the light that flies along ({flight}); what is measured is sample()"
    )


def is_sound(phase: mi.PhaseFunction) -> bool:
    """Whether it is one of Mitsuba's that need not be asked."""
    if is_foreign(type(phase)) or class_of(phase) not in SOUND:
        return False
    own = traversed(phase)
    return not ("g" in own and np.any(np.abs(np.array(own["g"])) > MAX_SOUND_G))


def _points(u: Floats) -> tuple[Floats, Floats]:
    """Directions about the flight, shape (3, n), and their density."""
    number = np.floor((u[0] - UNIFORM) / (1 - UNIFORM) * len(LOBES)).astype(int)
    g = LOBES[np.maximum(number, 0)]
    term = (1 - g**2) / (1 - g + 2 * g * u[1])
    # 1 - cos, without cancellation
    less = np.where(number < 0, 2 * u[1], (term - 1 + g) * (term + 1 - g) / (2 * g))
    less = np.clip(less, 0, 2)
    density = np.full(len(less), UNIFORM / (4 * np.pi))
    for g in LOBES:
        base = (1 - g) ** 2 + 2 * g * less
        lobe = (1 - g**2) / (4 * np.pi * base * np.sqrt(base))
        density += (1 - UNIFORM) / len(LOBES) * lobe
    sine, phi = np.sqrt(less * (2 - less)), 2 * np.pi * u[2]
    return np.array([sine * np.cos(phi), sine * np.sin(phi), 1 - less]), density


def _cells(directions: Floats, frames: Floats) -> tuple[Integers, Integers]:
    """Ring and quarter, and octant, that each direction is in."""
    x, y, z = np.einsum("nj,nij->in", directions, frames)
    ring = np.searchsorted(RINGS, np.arctan2(np.hypot(x, y), z))
    octant = (directions > 0) @ np.array([1, 2, 4])
    return 4 * ring + 2 * (x > 0) + (y > 0), N_RINGED + octant


def _means(spectrum: Any, like: Integers) -> Floats:
    """Mean over the channels, one for each point."""
    return np.mean([np.zeros(len(like)) + np.array(x) for x in spectrum], axis=0)

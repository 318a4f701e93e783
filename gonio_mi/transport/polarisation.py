"""Power and polarisation of light on its way: Mueller matrices of polarised variants.

In these variants a throughput is the Mueller matrix from the source to the beam, both
in frames of s = k x z. So light of any polarisation is measured at once. Its first
element is the power that unpolarised light leaves. Mitsuba's frames jump at the
horizon, along which light flies between walls of 45 degrees: none is kept from one
event to the next. In other variants a throughput is a power, and nothing here adds a
step to a kernel.
"""

from __future__ import annotations

from functools import reduce
from typing import Any

import drjit as dr
import mitsuba as mi

from ..results.tally import N_ELEMENTS
from ..single_precision import BSDF_ROUNDING

# Sine of the polar angle below which a beam is taken for vertical: rounding.
MIN_SINE = 2.0**-20

# Elements over the first one, above which a matrix is that of no surface: of a real one
# none is larger than the first, in any frames, and a sample's weight scales them alike.
# Rounding is left: at most 10 of 2**-24 in 15 of Mitsuba's BSDFs, of 2**18 directions.
MAX_ELEMENT = 1 + BSDF_ROUNDING

# What rounding may leave of elements where there is no light.
ROUNDING = 2.0**-18

# How far below 0 rounding may take the first element of a product of matrices, over
# the product of their first elements.
DARK = 2.0**-12

# Places of what polarised light adds to the power, and of what polarises light.
ROW, COLUMN = ((0, 1), (0, 2), (0, 3)), ((1, 0), (2, 0), (3, 0))


def n_channels() -> int:
    """Number of channels that a ray carries."""
    return len(mi.UnpolarizedSpectrum())


def n_elements() -> int:
    """Number of elements of a Mueller matrix beside the first; 0 if there is none."""
    return N_ELEMENTS if mi.is_polarized else 0


def power_of(throughput: mi.Spectrum) -> mi.UnpolarizedSpectrum:
    """Power that unpolarised light leaves: the first element."""
    return throughput[0, 0] if mi.is_polarized else throughput


def other_elements(throughput: mi.Spectrum) -> list[mi.UnpolarizedSpectrum]:
    """All elements but the first, row by row."""
    return [throughput[i // 4, i % 4] for i in range(1, 16)]


def new_light(power: mi.UnpolarizedSpectrum) -> mi.Spectrum:
    """Throughput of light that met nothing yet."""
    return _times(mi.Spectrum(1.0), power) if mi.is_polarized else power


def in_instrument_frames(
    si: mi.SurfaceInteraction3f,
    answer: mi.Spectrum,
    d: mi.Vector3f,
    local_wo: mi.Vector3f,
    wo: mi.Vector3f,
) -> mi.Spectrum:
    """What a BSDF answers for light along `d`, in frames of s = k x z.

    `wo` is given in the frame of shading and in the world.
    """
    if not mi.is_polarized:
        return answer
    basis = mi.mueller.stokes_basis
    into = _turn(d, _plane_axis(d), si.to_world(basis(-si.wi)))
    out = _turn(wo, si.to_world(basis(local_wo)), _plane_axis(wo))
    return out @ answer @ into


def product(answer: mi.Spectrum, throughput: mi.Spectrum) -> tuple[mi.Spectrum, Any]:
    """Throughput after an event, and whether it is one.

    It is none where an answer of a polarised variant, or the product, is that of no
    surface.
    """
    if not mi.is_polarized:
        return throughput * answer, True
    light = answer[0, 0]
    # false for NaN
    valid = _largest(answer) <= MAX_ELEMENT * light + ROUNDING
    found = answer @ throughput
    least = -DARK * light * throughput[0, 0]
    valid &= found[0, 0] >= least
    found = dr.select(dr.all(valid) & dr.any(found[0, 0] > 0), found, 0.0)
    found[0, 0] = dr.maximum(found[0, 0], 0)
    return found, dr.all(valid)


def scaled(
    throughput: mi.Spectrum, power: mi.UnpolarizedSpectrum | mi.Float
) -> mi.Spectrum:
    """Light of the same polarisation with another power."""
    if not mi.is_polarized:
        return power
    old = throughput[0, 0]
    return _times(throughput, dr.select(old > 0, power / old, 0.0))


def _times(matrix: mi.Spectrum, power: mi.UnpolarizedSpectrum) -> mi.Spectrum:
    """Matrix of each channel times its power."""
    found = mi.Spectrum(matrix)
    for i in range(16):
        found[i // 4, i % 4] = matrix[i // 4, i % 4] * power
    return found


def _largest(matrix: mi.Spectrum) -> mi.UnpolarizedSpectrum:
    """Largest size of the elements but the first; NaN if one is.

    Of the first row and the first column the length, which is the same in all frames.
    """
    sizes = [dr.abs(matrix[i, j]) for i in (1, 2, 3) for j in (1, 2, 3)]
    row, column = ([matrix[i] for i in places] for places in (ROW, COLUMN))
    sizes += [dr.sqrt(x * x + y * y + z * z) for x, y, z in (row, column)]
    return reduce(dr.maximum, sizes)


def _plane_axis(k: mi.Vector3f) -> mi.Vector3f:
    """Axis s = k x z of beams along `k`; along the z axis that of the azimuth 0."""
    sine = dr.norm(mi.Vector2f(k.x, k.y))
    upright = sine < MIN_SINE
    s = mi.Vector3f(k.y, -k.x, 0) / dr.select(upright, 1.0, sine)
    return dr.select(upright, mi.Vector3f(0, 1, 0), s)


def _turn(k: mi.Vector3f, old: mi.Vector3f, new: mi.Vector3f) -> mi.Spectrum:
    """Matrix that expresses Stokes vectors of beams along `k` in another frame."""
    cosine, sine = dr.dot(old, new), dr.dot(k, dr.cross(old, new))
    scale = dr.rcp(cosine * cosine + sine * sine)
    c = (cosine * cosine - sine * sine) * scale
    s = 2 * cosine * sine * scale
    turn = mi.Spectrum(1.0)
    turn[1, 1] = turn[2, 2] = mi.UnpolarizedSpectrum(c)
    turn[1, 2] = mi.UnpolarizedSpectrum(s)
    turn[2, 1] = mi.UnpolarizedSpectrum(-s)
    return turn

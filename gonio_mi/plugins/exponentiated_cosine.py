r"""Directions distributed as a power of the cosine to an axis, in single precision.

A cosine near 1 has lost the angle, and its 1000th power amplifies what is left of it.
Angles are taken from the chord between the vectors, :math:`|d - a|^2 = 4
\sin^2(\alpha / 2)`, and powers through :math:`\log\cos\alpha = -2 \mathrm{atanh}
\tan^2(\alpha / 2)`.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from gonio_mi.errors import checked_choice, checked_number
from gonio_mi.plugins.bsdf_functions import GLOSSY
from gonio_mi.plugins.properties import given

# What the lobe about the mirror direction stands for; see plugin `cosinelobe`.
FORMS = ("unit", "modified_phong")

# A lobe 6e-4 rad wide: the rounding of a direction in float32 is 1e-4 of that.
MAX_EXPONENT = 1e6

# Largest float32 below 1: keeps atanh finite at a right angle.
BELOW_ONE = 1 - 2.0**-24


def exponent(props: mi.Properties, name: str, default: float) -> mi.Float:
    """Return the property `name`, an exponent, as a variable that kernels read."""
    condition = f"a number from 0 to {MAX_EXPONENT:.0f}"
    above = MAX_EXPONENT * (1 + 2.0**-52)
    number = checked_number(*given(props, name, default), 0, above, condition)
    value = mi.Float(number)
    dr.make_opaque(value)
    return value


def form(props: mi.Properties) -> str:
    """Return the property `normalisation`, one of :data:`FORMS`."""
    return checked_choice(*given(props, "normalisation", "unit"), FORMS)


def flags(form: str) -> int:
    """Flags of the component that is the lobe."""
    return GLOSSY | mi.BSDFFlags.NonSymmetric if form == "unit" else GLOSSY


def cosine_power(n: mi.Float, axis: mi.Vector3f, d: mi.Vector3f) -> mi.Float:
    """``cos(alpha) ** n`` between unit vectors; 0 for 90 degrees and more."""
    sin2_half = dr.squared_norm(d - axis) * 0.25
    tan2_half = dr.minimum(sin2_half / (1 - sin2_half), BELOW_ONE)
    power = dr.exp(n * (-2 * dr.atanh(tan2_half)))
    return dr.select(sin2_half < 0.5, power, 0)


def density(n: mi.Float, axis: mi.Vector3f, d: mi.Vector3f) -> mi.Float:
    r"""Density in 1/sr at `d`: :math:`\frac{n + 1}{2 \pi} \cos^n \alpha`."""
    return (n + 1) * dr.inv_two_pi * cosine_power(n, axis, d)


def polar(n: mi.Float, sample: mi.Float) -> tuple[mi.Float, mi.Float]:
    """Sine and cosine of an angle with density proportional to ``cos**n * sin``."""
    log_cos = dr.log(1 - sample) / (n + 1)
    cosine = dr.exp(log_cos)
    # 1 - cos^2 without cancellation
    return dr.sqrt(-2 * cosine * dr.sinh(log_cos)), cosine


def around(n: mi.Float, axis: mi.Vector3f, sample: mi.Point2f) -> mi.Vector3f:
    """Unit vector with :func:`density` about `axis`, from a 2D `sample`."""
    sin, cos = polar(n, sample.y)
    sin_phi, cos_phi = dr.sincos(dr.two_pi * sample.x)
    local = mi.Vector3f(sin * cos_phi, sin * sin_phi, cos)
    return dr.normalize(mi.Frame3f(axis).to_world(local))


def throughput(
    form: str, n: mi.Float, mode: mi.TransportMode, wi: mi.Vector3f, wo: mi.Vector3f
) -> mi.Float:
    """BRDF times cosine of `wo`, over :func:`density`; for unit reflectance.

    The form ``unit`` is not reciprocal, so that it depends on the transport mode: in
    importance mode light arrives from `wi`, in radiance mode from `wo`.
    """
    cos_i, cos_o = mi.Frame3f.cos_theta(wi), mi.Frame3f.cos_theta(wo)
    if form == "modified_phong":
        return (n + 2) / (n + 1) * cos_o
    if mode == mi.TransportMode.Importance:
        return mi.Float(1)
    return cos_o / cos_i

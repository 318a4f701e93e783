"""Where formulas break: horizon and normal, first and last random numbers, limits."""

from __future__ import annotations

from itertools import product
from typing import Any

import mitsuba as mi
import numpy as np

from ..array_types import Flags, Floats, Numbers
from ..collector.directions import direction
from .conditions import Condition
from .equality import BSDF_ROUNDING
from .evidence import INTERFACE, Evidence
from .parameters import changed, traversed
from .probe import PluginFault, Probe, numbers, spectral

__all__ = ["check_ends", "check_roughness"]

# Part of an image that single pixels are.
SINGLE = 1e-3

# Polar angles of incidence in degrees, and the ends of random numbers in [0, 1).
ANGLES = (0, 1e-3, 89.99, 90, 90.01, 120, 179.999, 180)
LAST = float(np.nextafter(np.float32(1), np.float32(0)))
NUMBERS = (0.0, 0.5, LAST)

# Names of parameters that are a roughness, and the limits to try.
ROUGHNESSES = ("alpha", "alpha_u", "alpha_v", "roughness")
LIMITS = (1e-3, 1.0)


def check_ends(evidence: Evidence, bsdf: mi.BSDF, where: str = "") -> None:
    """All functions are finite and at least 0 at the ends.

    Directions: sampled ones, and some at the normal, the horizon, the mirror direction
    and straight on.
    """
    for theta_i, phi_i in product(ANGLES, (0.0, 25.0)):
        condition = Condition(theta_i, phi_i)
        place = f"at {condition}{where}"
        try:
            _check_condition(evidence, Probe(bsdf, condition), place)
        except PluginFault as fault:  # elsewhere it answers
            mistake = f"`{fault.function}` {fault.what}, at an end of its domain"
            evidence.breach("ends", fault.function, place, mistake, off=SINGLE)


def _check_condition(evidence: Evidence, probe: Probe, place: str) -> None:
    """The same of one direction of incidence."""
    corners = np.array(list(product(NUMBERS, repeat=3)), dtype=np.float32)
    wi = probe.condition.wi
    one = probe.sample(mi.Float(corners[:, 0]), mi.Point2f(corners[:, 1:].T))
    n = len(corners)
    weight, wo = spectral(one.weight, n), spectral(one.bs.wo, n)
    pdf = numbers(one.bs.pdf, n)
    given = (weight != 0).any(axis=1)
    _finite(evidence, "sample", "weight", weight, corners, place)
    _finite(evidence, "sample", "pdf", pdf[given], corners[given], place)
    _unit(evidence, wo, given, corners, place)
    extra = [wi, -wi, wi * [-1, -1, 1], wi * [-1, -1, -1]]
    extra += list(direction(np.radians([0, 89.99, 90, 90.01, 180]), 0.3))
    good = given & np.isfinite(wo).all(axis=1)
    vectors = np.concatenate([wo[good], extra])
    v = mi.Vector3f(np.ascontiguousarray(vectors.T, dtype=np.float32))
    n = len(vectors)
    joint, values = probe.eval_pdf(v), spectral(probe.eval(v), n)
    black = (values == 0).all(axis=1)
    for function, value in (
        ("eval", values),
        ("pdf", numbers(probe.pdf(v), n)),
        ("eval_pdf", spectral(joint[0], n)),
        ("eval_pdf", numbers(joint[1], n)),
    ):
        _finite(evidence, function, "value", value, vectors, place, "wo", black)


def check_roughness(evidence: Evidence, bsdf: mi.BSDF) -> None:
    """The ends again at the limits of roughness, if the plugin has such parameters."""
    try:
        params = traversed(bsdf)
    except PluginFault:
        return  # a property of its own
    names = [
        key
        for key in params.keys()  # noqa: SIM118
        if key.removesuffix(".value").split(".")[-1] in ROUGHNESSES
        and isinstance(params[key], (float, mi.Float))
    ]
    for limit in LIMITS if names else ():
        with changed(bsdf, {key: type(params[key])(limit) for key in names}):
            check_ends(evidence, bsdf, f", roughness {limit:g}")


def _finite(
    evidence: Evidence,
    function: str,
    what: str,
    value: Numbers,
    inputs: Numbers,
    place: str,
    name: str = "sample",
    black: Flags | None = None,
) -> None:
    """Where `black`, a negative density does no harm."""
    if not value.size:
        return
    wrong: Any = ~np.isfinite(value) | (value < 0)
    wrong = wrong if wrong.ndim == 1 else wrong.any(axis=1)
    if wrong.any():
        example = np.ravel(value[wrong][0])
        example = example[~np.isfinite(example) | (example < 0)][0]
        harmless = (
            black is not None and black[wrong].all() and np.isfinite(value[wrong]).all()
        )
        evidence.breach(
            "ends",
            function,
            f"{what} {example:g} {place}, {name} {_text(inputs[wrong][0])}",
            f"`{function}` gives {example:g} at an end of its domain",
            size=float(wrong.sum()),
            effect=INTERFACE if harmless else None,
            off=SINGLE,
        )


def _unit(
    evidence: Evidence, wo: Floats, given: Flags, corners: Numbers, place: str
) -> None:
    length = np.linalg.norm(wo, axis=1)
    wrong = given & ~(np.abs(length - 1) < BSDF_ROUNDING)
    if wrong.any():
        evidence.breach(
            "ends",
            "sample",
            f"direction {_text(wo[wrong][0])} {place}, "
            f"sample {_text(corners[wrong][0])}",
            "`sample` gives a direction of another length than 1 at an end",
            off=SINGLE,
        )


def _text(values: Floats) -> str:
    return "(" + ", ".join(f"{x:.8g}" for x in values) + ")"

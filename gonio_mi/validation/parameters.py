"""Parameters of a BSDF, as ``mi.traverse`` finds them, and gradients by them."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator, Mapping
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Floats
from ..instrument.loading import with_own_tensors
from .collecting import Drawn
from .conditions import Condition
from .evidence import INTERFACE, Evidence
from .probe import PluginFault, Probe, blamed, spectral

__all__ = ["changed", "check_parameters", "coloured", "traversed"]

# Relative steps of central differences, whose error falls with their square: where the
# three do not agree, there is nothing to compare with.
STEPS = (2.0**-4, 2.0**-6, 2.0**-8)

# How many times the changes between steps a gradient may be off, and how many roundings
# a value has.
SLACK = 4
ROUNDINGS = 64

# Relative change of a value that a step may make.
STEEP = 0.2

# Part of the directions whose values may jump with a parameter.
JUMPS = 0.1

# How much a grey parameter keeps in each channel; none gains.
TINT = (1.0, 0.8, 0.6)

# Names of parameters that are a colour.
COLOURS = re.compile("reflectance|transmittance|colou?r|albedo|tint")


def traversed(bsdf: mi.BSDF) -> Any:
    """Parameters of a BSDF; raises PluginFault if the plugin does."""
    with blamed("traverse"):
        return mi.traverse(bsdf)


@contextlib.contextmanager
def changed(bsdf: mi.BSDF, values: Mapping[str, Any]) -> Iterator[None]:
    """Give parameters other values, by name, until the end of the block."""
    params = traversed(bsdf) if values else {}
    before = {name: type(params[name])(params[name]) for name in values}
    try:
        _assign(params, values)
        yield
    finally:
        _assign(params, before)


def _assign(params: Any, values: Mapping[str, Any]) -> None:
    for name, value in values.items():
        params[name] = value
    if values:
        with blamed("parameters_changed"):
            params.update()


def check_parameters(evidence: Evidence, bsdf: mi.BSDF, drawn: Drawn) -> None:
    """``traverse`` answers, and gradients of ``eval`` agree with its differences."""
    try:
        params = traversed(bsdf)
        usable = drawn.smooth & np.isfinite(drawn.eval).all(axis=1)
        if usable.any() and hasattr(dr, "enable_grad") and "_ad_" in mi.variant():
            wo = mi.Vector3f(np.ascontiguousarray(drawn.wo[usable].T))
            for name in _differentiable(params):
                _check_gradient(evidence, bsdf, drawn.condition, params, name, wo)
    except PluginFault as fault:
        # images need none of it
        effect = INTERFACE if fault.function == "traverse" else None
        text = str(fault)
        evidence.breach("parameters", fault.function, text, text, effect=effect)


def _differentiable(params: Any) -> Iterator[str]:
    """Names of numbers and colours that may be differentiated, within their range.

    At 0 and 1, most ranges end, where a lobe may be left out.
    """
    for name in params.keys():  # noqa: SIM118
        value = params[name]
        fixed = params.flags(name) & mi.ParamFlags.NonDifferentiable.value
        if fixed or not isinstance(value, (mi.Float, mi.Color3f)):
            continue
        if not np.isin(np.ravel(np.array(value)), (0.0, 1.0)).any():
            yield name


def _check_gradient(
    evidence: Evidence,
    bsdf: mi.BSDF,
    condition: Condition,
    params: Any,
    name: str,
    wo: mi.Vector3f,
) -> None:
    """Gradients of ``eval``, one for each direction, against central differences."""
    kind, value = type(params[name]), type(params[name])(params[name])
    size = float(np.max(np.abs(np.array(value))))

    def answer(step: float) -> Floats:
        with changed(bsdf, {name: kind(value + step * size)}):
            return spectral(Probe(bsdf, condition).eval(wo), dr.width(wo)).sum(axis=1)

    pairs = [(answer(h), answer(-h), 2 * h * size) for h in STEPS]
    coarse, middle, fine = ((above - below) / width for above, below, width in pairs)
    # each value is known to some roundings
    noise = ROUNDINGS * np.finfo(np.float32).eps * (pairs[-1][0] + pairs[-1][1])
    changes = np.abs(fine - middle) + np.abs(middle - coarse)
    slack = SLACK * changes + noise / pairs[-1][2]
    gradient = _gradient(bsdf, condition, name, kind(value), wo)
    wrong = ~(np.abs(gradient - fine) <= slack)
    # where the smallest step changes much, differences know nothing of the slope
    here = answer(0.0)
    wrong &= np.all([np.abs(x - here) <= STEEP * here for x in pairs[-1][:2]], axis=0)
    # jumps, of which a gradient knows nothing, are in few directions
    if wrong.mean() > JUMPS:
        own, due = (float(np.median(x[wrong])) for x in (gradient, fine))
        evidence.breach(
            "parameters",
            "eval",
            f"by {name}: for {wrong.mean():.3g} of the directions at {condition}, with "
            f"the median {own:.4g} where differences have {due:.4g}",
            f"gradients of `eval` by {name} are not its changes",
            size=float(wrong.mean()),
        )


def _gradient(
    bsdf: mi.BSDF, condition: Condition, name: str, variable: Any, wo: mi.Vector3f
) -> Floats:
    """Derivatives of ``eval`` by a parameter, summed over channels, shape ``(n,)``."""
    dr.enable_grad(variable)
    with changed(bsdf, {name: variable}):
        answer = Probe(bsdf, condition).eval(wo)
        with blamed("eval"):
            flags = dr.ADFlag.Default | dr.ADFlag.AllowNoGrad
            dr.forward(variable, flags=flags)
        return spectral(dr.grad(answer), dr.width(wo)).sum(axis=1)


def coloured(bsdf: mi.BSDF, specimen: dict[str, Any]) -> mi.BSDF:
    """BSDF of the dictionary `specimen`, with its grey parameters tinted, in rgb.

    `bsdf` is the same as it is; it is returned where there is nothing to tint.
    """
    tints = _tints(bsdf) if mi.is_rgb else {}
    if not tints:
        return bsdf
    try:
        return mi.load_dict(with_own_tensors(specimen | tints))
    except Exception:
        return bsdf  # what such a parameter may be is up to the plugin


def _tints(bsdf: mi.BSDF) -> dict[str, Any]:
    """Tinted colours by name, as in a dictionary; none without ``traverse``."""
    try:
        params = mi.traverse(bsdf)
    except Exception:
        return {}  # `answers` says so
    tints = {}
    for key in params.keys():  # noqa: SIM118
        name, value = key.removesuffix(".value"), params[key]
        # a texture may be grey; what a plugin keeps as one number stays one
        colour = mi.Color3f if key == name else (mi.Float, mi.Color3f)
        if not COLOURS.search(name) or not isinstance(value, colour):
            continue
        value = np.ravel(value)
        if "." not in name and np.ptp(value) == 0 and 0 < value[0] <= 1:
            tint = [float(value[0]) * share for share in TINT]
            tints[name] = {"type": "rgb", "value": tint}
    return tints

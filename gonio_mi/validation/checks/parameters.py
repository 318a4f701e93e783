"""Parameters of a BSDF, as ``mi.traverse`` finds them, and gradients by them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...array_types import Floats
from ..conditions import Condition
from ..evidence import INTERFACE, Evidence
from ..probe import PluginFault, Probe, blamed, changed, spectral, traversed, vectors
from ..samples import Samples

__all__ = ["check_samples"]

# Relative steps of central differences, whose error falls with their square: where the
# three do not agree, there is nothing to compare with.
STEPS = (2.0**-4, 2.0**-6, 2.0**-8)

# How many times the changes between steps a gradient may be off, and how many roundings
# a value has.
STEP_SLACK = 4
N_ROUNDINGS = 64

# Relative change of a value that a step may make.
MAX_CHANGE = 0.2

# Part of the directions whose values may jump with a parameter.
MAX_JUMPS = 0.1


def check_samples(evidence: Evidence, samples: Samples) -> None:
    """``traverse`` answers, and gradients of ``eval`` agree with its differences."""
    try:
        params = traversed(evidence.bsdf)
        usable = samples.smooth & np.isfinite(samples.eval).all(axis=1)
        if usable.any() and hasattr(dr, "enable_grad") and "_ad_" in mi.variant():
            wo = vectors(samples.wo[usable])
            for name in _differentiable(params):
                _check_gradient(evidence, samples.condition, params, name, wo)
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
    condition: Condition,
    params: Any,
    name: str,
    wo: mi.Vector3f,
) -> None:
    """Gradients of ``eval``, one for each direction, against central differences."""
    bsdf, kind = evidence.bsdf, type(params[name])
    value = kind(params[name])
    size = float(np.max(np.abs(np.array(value))))

    def answer(step: float) -> Floats:
        with changed(bsdf, {name: kind(value + step * size)}):
            return spectral(Probe(bsdf, condition).eval(wo), dr.width(wo)).sum(axis=1)

    pairs = [(answer(h), answer(-h), 2 * h * size) for h in STEPS]
    coarse, middle, fine = ((above - below) / width for above, below, width in pairs)
    # each value is known to some roundings
    noise = N_ROUNDINGS * np.finfo(np.float32).eps * (pairs[-1][0] + pairs[-1][1])
    changes = np.abs(fine - middle) + np.abs(middle - coarse)
    slack = STEP_SLACK * changes + noise / pairs[-1][2]
    gradient = _gradient(bsdf, condition, name, kind(value), wo)
    wrong = ~(np.abs(gradient - fine) <= slack)
    # where the smallest step changes much, differences know nothing of the slope
    here = answer(0.0)
    wrong &= np.all(
        [np.abs(x - here) <= MAX_CHANGE * here for x in pairs[-1][:2]], axis=0
    )
    # jumps, of which a gradient knows nothing, are in few directions
    if wrong.mean() > MAX_JUMPS:
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

"""Gradients of functions, forward and backward, are their changes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...array_types import Flags, Floats, Integers
from ...mitsuba_compat import floats
from ...single_precision import BSDF_ROUNDING
from ...specimen.bsdf_trial import PluginFault
from ..arrays import answer_of, drawn, of_eval, parameters
from ..conditions import Condition, Effort
from ..evidence import INTERFACE, Evidence
from ..judgements import equal
from ..mistakes import EVAL, EVAL_PDF, PDF, Claim, Function
from ..probe import (
    Probe,
    as_plugin_fault,
    assign,
    changed,
    number_parameters,
    spectral,
    vectors,
)
from ..samples import Samples
from .parameters import (
    GOLDEN,
    PARAMETERS,
    Parameters,
    may_update_often,
    opaque,
    turns,
)


def gradient(
    bsdf: Any, ctx: Any, si: Any, u: Any, what: Any, name: str
) -> tuple[float, float]:
    """By how much the sum of all answers changes with a parameter, and its gradient."""
    (bs, _), params = drawn(bsdf, ctx, si, u), parameters(bsdf)

    def total(x: Any) -> Any:
        params.update({name: x})
        return dr.sum(what(bsdf, ctx, si, bs.wo, u), axis=None)

    x, flags = type(params[name])(params[name]), dr.ADFlag.AllowNoGrad
    change = np.ravel(total(x + 1e-3) - total(x - 1e-3))[0] / 2e-3
    dr.enable_grad(x)
    forward = np.sum(dr.forward_to(total(x), flags=flags))
    dr.backward(total(x), flags=flags)
    found = [forward, np.sum(dr.grad(x))]
    return change, max(found, key=lambda one: abs(one - change))


# Relative steps of central differences, whose error falls with their square: where the
# three do not agree, there is nothing to compare with.
STEPS = (2.0**-4, 2.0**-6, 2.0**-8)

# Number in place of 1 from which no step leads beyond 1.
BELOW_1 = 0.875

# How many times the changes between steps a gradient may be off, and how many roundings
# a value has.
STEP_SLACK = 4
N_ROUNDINGS = 64

# Relative change of a value that a step may make.
MAX_CHANGE = 0.2

# Part of the directions whose values may jump with a parameter.
MAX_JUMPS = 0.1

# Directions in which all functions are asked by all parameters at once.
N_ASKED = 2**10

# The graph stays: all functions follow what an update has prepared.
FLAGS = dr.ADFlag.ClearVertices | dr.ADFlag.AllowNoGrad

# What functions answer, a value before a density.
FUNCTIONS: Mapping[Function, Callable[[Probe, mi.Vector3f], tuple[Any, ...]]] = {
    EVAL: lambda probe, wo: (probe.eval(wo),),
    PDF: lambda probe, wo: (probe.pdf(wo),),
    EVAL_PDF: Probe.eval_pdf,
}


class _Line:
    """Parameters along a line on which no two numbers of them change alike.

    Attributes
    ----------
    kinds, values, slopes : dict
    size : float
        The largest number of the first.
    """

    def __init__(self, params: Any, names: Sequence[str]) -> None:
        self.kinds = {name: type(params[name]) for name in names}
        values = {name: np.array(params[name], dtype=float) for name in names}
        # most ranges end at 1
        self.values = {name: np.where(x == 1, BELOW_1, x) for name, x in values.items()}
        self.size = float(np.abs(self.values[names[0]]).max())
        self.slopes = {
            name: x / self.size * (1 - turns(x) / 2) * (1 - i * GOLDEN % 1 / 2)
            for i, (name, x) in enumerate(self.values.items())
        }

    def at(self, step: float = 0, along: mi.Float | None = None) -> dict[str, Any]:
        """Values at a step, which depend on a variable if there is one."""
        found = {}
        for name, kind in self.kinds.items():
            value = opaque(kind, self.values[name] + step * self.slopes[name])
            if along is not None:
                value += along * opaque(kind, self.slopes[name])
                dr.make_opaque(value)
            found[name] = value
        return found


def check_samples(evidence: Evidence, plan: Effort, samples: Samples) -> None:
    """Check ``traverse``, and gradients against finite differences.

    Of ``eval`` forward, by each parameter; of all functions also backward, by all
    parameters at once, and by each where that shows something. The latter where
    updates may be many. In radiance mode, which is that of differentiable rendering,
    over a sweep of incident directions and places, if that shows nothing.
    """
    try:
        params, values = number_parameters(evidence.bsdf, mi.TensorXf)
    except PluginFault as fault:
        evidence.breach_of_fault(PARAMETERS, fault, effect=INTERFACE)
        return
    usable = samples.smooth & np.isfinite(samples.eval).all(axis=1)
    if not usable.any() or evidence.noisy or "_ad_" not in mi.variant():
        return
    fixed = mi.ParamFlags.NonDifferentiable.value
    # not at 0, where most ranges end and a lobe may vanish
    names = [k for k, x in values.items() if np.array(x).any()]
    names = [name for name in names if not params.flags(name) & fixed]
    probe, wo = Probe(evidence.bsdf, samples.condition), samples.wo[usable]
    closely = may_update_often(evidence, plan)
    if closely and len(names) > 1:
        try:
            found = _wrong_gradients(probe, _Line(params, names), wo[:N_ASKED], True)
            wrong = {guess.functions for guess, *_ in found}
            # what `eval_pdf` says of a wrong `eval` is no news
            closely = bool(wrong - {EVAL, EVAL_PDF} if EVAL in wrong else wrong)
        except PluginFault:
            closely = True  # by which?
    own = np.flatnonzero(usable)
    _check_each(evidence, params, names, probe, wo, closely, samples.condition, own)
    swept = evidence.sweeps[0]
    usable = swept.smooth & np.isfinite(swept.eval).all(axis=1)
    if evidence.of("parameters") or evidence.of_volumes or not usable.any():
        return
    own = np.flatnonzero(usable)[: 4 * N_ASKED]
    sweep = replace(swept.condition, mode="radiance", fields=())
    probe = Probe(evidence.bsdf, sweep).of_lanes(mi.UInt32(own))
    _check_each(evidence, params, names, probe, swept.wo[own], False, sweep, own)


def _check_each(
    evidence: Evidence,
    params: Any,
    names: Sequence[str],
    probe: Probe,
    wo: Floats,
    closely: bool,
    asked: Condition,
    own: Integers,
) -> None:
    """Check gradients by each parameter, of its `own` samples of a condition."""
    for name in names:
        try:
            line = _Line(params, [name])
            for guess, text, size, wrong in _wrong_gradients(probe, line, wo, closely):
                at, text = asked.middle(_mask(asked, own[wrong])), f"by {name}: {text}"
                shown = Claim(gradient, equal, (answer_of(guess.functions), name))
                how = {"found": text, "size": size, "shown": shown}
                evidence.breach(PARAMETERS, guess, at, **how)
        except PluginFault as fault:
            if fault.function == "parameters_changed":
                continue  # a step beyond a range
            shown = Claim(gradient, equal, (of_eval, name))
            evidence.breach_of_fault(PARAMETERS, fault, shown=shown)


def _mask(asked: Condition, own: Integers) -> Flags:
    """Mask of the samples of these numbers."""
    mask = np.zeros(len(asked.spots), dtype=bool)
    mask[own[own < len(mask)]] = True
    return mask


def _wrong_gradients(
    probe: Probe, line: _Line, wo: Floats, closely: bool
) -> Iterator[tuple[Any, str, float, Flags]]:
    """Guess, text, size and mask of wrong gradients, of each direction, along a line.

    Unless `closely`, of ``eval`` forward alone.
    """
    name, asked = ", ".join(line.kinds), [*FUNCTIONS] if closely else [EVAL]
    params = mi.traverse(probe.bsdf)

    def answers(step: float) -> dict[Function, Floats]:
        if step:  # updates may take long
            assign(params, line.at(step))
        return {one: _columns(FUNCTIONS[one](probe, vectors(wo)), wo) for one in asked}

    along = dr.opaque(mi.Float, 0)
    dr.enable_grad(along)
    with changed(probe.bsdf, line.at()):
        here = answers(0)
        pairs = [(answers(h * line.size), answers(-h * line.size)) for h in STEPS]
        assign(params, line.at(0, along))
        slopes = _forward(probe, asked, along, wo)
        # densities may be detached in all functions: those of samples are
        detached = all(not x[:, -1].any() for f, x in slopes.items() if f != EVAL)
        for one in asked:
            slope, each = slopes[one], [[x[one] for x in pair] for pair in pairs]
            due, wrong, small = _differences(here[one], each, slope, line)
            if detached and one != EVAL:
                wrong[:, -1] = False
            # jumps, of which a gradient knows nothing, are in few directions
            share = float(wrong.any(axis=1).mean())
            if share > MAX_JUMPS:
                # colours may exchange theirs
                i = int(wrong.sum(axis=0).argmax())
                own, expected = (np.median(x[wrong[:, i], i]) for x in (slope, due))
                text = f"for {share:.3g} of the directions, with the median {own:.4g} "
                text += f"where differences have {expected:.4g}"
                yield Parameters.GRADIENT(one, name=name), text, share, wrong[:, i]
            elif closely and (right := small & ~wrong.any(axis=1)).any():
                by = _backward(probe, one, along, wo[right], slope[right])
                own, expected, slack = by
                if not abs(own - expected) <= slack:
                    text = f"{own:.4g} where forward gradients have {expected:.4g}"
                    yield Parameters.BACKWARD(one, name=name), text, 1.0, right


def _rows(parts: tuple[Any, ...]) -> list[mi.Float]:
    """All channels of all parts of an answer."""
    return [x for part in parts for x in ([part] if type(part) is mi.Float else part)]


def _columns(parts: tuple[Any, ...], wo: Floats) -> Floats:
    """The same, shape (n, columns)."""
    return spectral(_rows(parts), len(wo))


def _differences(
    here: Floats, pairs: Sequence[Sequence[Floats]], slope: Floats, line: _Line
) -> tuple[Floats, Flags, Flags]:
    """Central differences, where a gradient is not theirs, and where they are small."""
    widths = [2 * h * line.size for h in STEPS]
    coarse, middle, fine = ((a - b) / width for (a, b), width in zip(pairs, widths))
    # each value is known to some roundings
    noise = N_ROUNDINGS * np.finfo(np.float32).eps * (pairs[-1][0] + pairs[-1][1])
    changes = np.abs(fine - middle) + np.abs(middle - coarse)
    wrong = ~(np.abs(slope - fine) <= STEP_SLACK * changes + noise / widths[-1])
    # where the smallest step changes much, differences know nothing of the slope
    each = [np.abs(x - here) <= MAX_CHANGE * here for x in pairs[-1]]
    small = np.all(each, axis=0)
    return fine, wrong & small, small.all(axis=1)


def _forward(
    probe: Probe, asked: Sequence[Function], along: mi.Float, wo: Floats
) -> dict[Function, Floats]:
    """Derivatives of answers by what parameters depend on, shape (n, columns)."""
    # one answer may follow from another, whose gradient would be cleared
    end, towards = dr.opaque(mi.Float, 1), vectors(wo)
    answers = {f: tuple(x * end for x in FUNCTIONS[f](probe, towards)) for f in asked}
    with as_plugin_fault(str(asked[0])):
        dr.forward(along, flags=FLAGS)
    return {k: _columns(tuple(map(dr.grad, x)), wo) for k, x in answers.items()}


def _backward(
    probe: Probe, function: Function, along: mi.Float, wo: Floats, slope: Floats
) -> tuple[float, float, float]:
    """Derivative of a weighted sum, what it should be, and how far it may be off."""
    answer = FUNCTIONS[function](probe, vectors(wo))
    weights, total = 0.5 + turns(slope), mi.Float(0)
    for row, weight in zip(_rows(answer), weights.T):
        total += dr.sum(row * floats(weight))
    dr.set_grad(along, 0)
    with as_plugin_fault(str(function)):
        dr.backward(total, flags=FLAGS)
    each = weights * slope
    own = float(np.ravel(dr.grad(along))[0])
    return own, float(each.sum()), BSDF_ROUNDING * float(np.abs(each).sum())

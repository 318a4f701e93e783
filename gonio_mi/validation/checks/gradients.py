"""Gradients of functions, forward and backward, are their changes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...array_types import Flags, Floats, Integers
from ...mitsuba_compat import floats
from ...single_precision import BSDF_ROUNDING
from ...specimen.bsdf_trial import PluginFault
from ..arrays import answer_of, drawn, parameters
from ..conditions import Condition, Effort
from ..densities import Means
from ..evidence import INTERFACE, Evidence
from ..judgements import apart, equal
from ..mistakes import EVAL, EVAL_PDF, PDF, SAMPLE, Claim, Function
from ..probe import (
    Probe,
    as_plugin_fault,
    assign,
    changed,
    number_parameters,
    spectral,
    vectors,
)
from ..samples import MAX_SCORE, UNDERFLOW, Samples
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
    dr.set_grad(x, 1)
    forward = np.sum(dr.forward_to(total(x), flags=flags))
    dr.set_grad(x, 0)
    dr.backward(total(x), flags=flags)
    found = [forward, np.sum(dr.grad(x))]
    return change, max(found, key=lambda one: abs(one - change))


def weight_slope(bsdf: Any, ctx: Any, si: Any, u: Any, name: str, kind: int) -> Means:
    """How the mean weight of a discrete lobe changes with a parameter, and as told."""
    params, along = parameters(bsdf), mi.Float(0)
    x = type(params[name])(params[name])

    def weights(change: Any) -> Any:
        params.update({name: x + change})
        bs, weight = drawn(bsdf, ctx, si, u)
        return dr.select(bs.sampled_type == kind, dr.sum(weight), 0)

    h = float(np.abs(np.array(x)).max()) / 16
    far, near = (np.array(weights(s) - weights(-s)) / (2 * s) for s in (h, h / 2))
    dr.enable_grad(along)
    dr.set_grad(along, 1)
    told = np.array(dr.forward_to(weights(along), flags=dr.ADFlag.AllowNoGrad))
    params.update({name: x})
    error = np.std(near - told) / near.size**0.5
    error += abs(np.mean(far - near)) + 1e-6 / h  # of differences, and of roundings
    return np.mean(near), np.mean(told), error


def weight_slopes(bsdf: Any, ctx: Any, si: Any, u: Any) -> Any:
    """The same of all discrete lobes and numbers of a BSDF."""
    bs, params = drawn(bsdf, ctx, si, u)[0], parameters(bsdf)
    kinds = np.unique(np.array(bs.sampled_type) & int(mi.BSDFFlags.Delta))
    fixed, found = mi.ParamFlags.NonDifferentiable.value, [(0, 0, 1)]
    for name, x in list(params) if np.any(kinds) else ():
        if dr.is_float_v(x) and np.array(x).any() and not params.flags(name) & fixed:
            found += [weight_slope(bsdf, ctx, si, u, name, int(k)) for k in kinds if k]
    return np.transpose(found)


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

# Directions in which all functions are asked by all parameters at once, and the least
# samples of a discrete lobe.
N_ASKED, MIN_ASKED = 2**10, 32

# The graph stays: all functions follow what an update has prepared.
FLAGS = dr.ADFlag.ClearVertices | dr.ADFlag.AllowNoGrad


def _light(probe: Probe, u: mi.Vector3f) -> tuple[mi.Spectrum, mi.Float]:
    """What samples send, by a density that is held, and that density.

    So integrators take a lobe that was chosen: its weight may change, and neither its
    probability nor its direction.
    """
    bs, weight = probe.sample(u.x, mi.Point2f(u.y, u.z))
    density = dr.detach(bs.pdf)
    return weight * density, density


# What functions answer, a value before a density, to directions or random numbers.
FUNCTIONS: Mapping[Function, Callable[[Probe, mi.Vector3f], tuple[Any, ...]]] = {
    EVAL: lambda probe, wo: (probe.eval(wo),),
    PDF: lambda probe, wo: (probe.pdf(wo),),
    EVAL_PDF: Probe.eval_pdf,
    SAMPLE: _light,
}
DIRECTED = EVAL, PDF, EVAL_PDF


@dataclass(frozen=True)
class _Asked:
    """Functions that are asked about a part of some samples.

    Attributes
    ----------
    probe : Probe
    own : ndarray
        Numbers of the samples.
    rows : ndarray, shape (n, 3)
        Their directions; of discrete ones their random numbers.
    functions : sequence of Function
    both_ways : bool
        Whether backward, too.
    kind : int
        Type of discrete samples; 0 of others.
    """

    probe: Probe
    own: Integers
    rows: Floats
    functions: Sequence[Function] = (EVAL,)
    both_ways: bool = False
    kind: int = 0

    @classmethod
    def directions(
        cls, bsdf: mi.BSDF, samples: Samples, most: int | None = None
    ) -> _Asked | None:
        """The value of ``eval`` where samples have a density; None of none."""
        usable = samples.smooth & np.isfinite(samples.eval).all(axis=1)
        own = _evenly(np.flatnonzero(usable), most)
        probe = _probe_of(bsdf, samples, own)
        return cls(probe, own, samples.wo[own]) if own.size else None

    @classmethod
    def lobes(cls, bsdf: mi.BSDF, samples: Samples) -> Iterator[_Asked]:
        """Weights of discrete lobes, of each type."""
        usable = samples.discrete & np.isfinite(samples.flux).all(axis=1)
        for kind in np.unique(samples.type[usable]):
            lobe = np.flatnonzero(usable & (samples.type == kind))
            if lobe.size >= MIN_ASKED:
                own = _evenly(lobe, 4 * N_ASKED)
                probe = _probe_of(bsdf, samples, own)
                yield cls(probe, own, samples.u[own], (SAMPLE,), kind=int(kind))

    @property
    def noun(self) -> str:
        """What is asked about."""
        return "samples of a discrete lobe" if self.kind else "directions"

    @property
    def mistake(self) -> Parameters:
        """What is wrong."""
        return Parameters.WEIGHT if self.kind else Parameters.GRADIENT

    def shown(self, function: Function, name: str) -> Claim:
        """How a script shows a wrong gradient by a parameter."""
        if self.kind:
            return Claim(weight_slope, apart, (name, self.kind))
        return Claim(gradient, equal, (answer_of(function), name))


def _evenly(own: Integers, most: int | None) -> Integers:
    """About `most` of some samples, of all angles of a sweep."""
    # an odd step meets both sides, which alternate
    return own[:: len(own) // most | 1] if most else own


def _probe_of(bsdf: mi.BSDF, samples: Samples, own: Integers) -> Probe:
    """Probe of these samples alone."""
    return Probe(bsdf, samples.condition).of_lanes(mi.UInt32(own))


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
    updates may be many. Of the weights of discrete lobes, where ``eval`` is 0, by each
    parameter. In radiance mode, which is that of differentiable rendering, over a sweep
    of incident directions and places, if that shows nothing.
    """
    bsdf = evidence.bsdf
    try:
        params, values = number_parameters(bsdf, mi.TensorXf)
    except PluginFault as fault:
        evidence.breach_of_fault(PARAMETERS, fault, effect=INTERFACE)
        return
    if evidence.noisy or "_ad_" not in mi.variant():
        return
    fixed = mi.ParamFlags.NonDifferentiable.value
    # not at 0, where most ranges end and a lobe may vanish
    names = [k for k, x in values.items() if np.array(x).any()]
    names = [name for name in names if not params.flags(name) & fixed]
    if not names:
        return
    if (one := _Asked.directions(bsdf, samples)) is not None:
        if may_update_often(evidence, plan):
            one = replace(one, functions=DIRECTED, both_ways=True)
        if one.both_ways and len(names) > 1 and not _shows(one, params, names):
            one = replace(one, functions=(EVAL,), both_ways=False)
        _check_each(evidence, params, names, one)
    # not at normal incidence, where the front is asked first
    others = (*evidence.whole[1:], *evidence.whole[:1])
    lobes = next((one for one in others if one.discrete.any()), None)
    for one in _Asked.lobes(bsdf, lobes) if lobes else ():
        _check_each(evidence, params, names, one)
    if evidence.of("parameters") or evidence.of_volumes:
        return
    swept = evidence.sweeps[0]
    radiance = replace(swept.condition, mode="radiance", fields=())
    swept = replace(swept, condition=radiance)
    for one in (
        _Asked.directions(bsdf, swept, 4 * N_ASKED),
        *_Asked.lobes(bsdf, swept),
    ):
        if one is not None:
            _check_each(evidence, params, names, one)


def _shows(asked: _Asked, params: Any, names: Sequence[str]) -> bool:
    """Whether gradients by all parameters at once show what `eval` alone does not."""
    few = replace(asked, own=asked.own[:N_ASKED], rows=asked.rows[:N_ASKED])
    try:
        found = _wrong_gradients(few, _Line(params, names))
        wrong = {guess.functions for guess, *_ in found}
    except PluginFault:
        return True  # by which?
    # what `eval_pdf` says of a wrong `eval` is no news
    return bool(wrong - {EVAL, EVAL_PDF} if EVAL in wrong else wrong)


def _check_each(
    evidence: Evidence, params: Any, names: Sequence[str], asked: _Asked
) -> None:
    """Check gradients by each parameter."""
    condition = asked.probe.condition
    for name in names:
        try:
            line = _Line(params, [name])
            for guess, text, size, wrong in _wrong_gradients(asked, line):
                at = condition.middle(_mask(condition, asked.own[wrong]))
                shown = asked.shown(guess.functions, name)
                how = {"found": f"by {name}: {text}", "size": size, "shown": shown}
                evidence.breach(PARAMETERS, guess, at, **how)
        except PluginFault as fault:
            if fault.function == "parameters_changed":
                continue  # a step beyond a range
            shown = asked.shown(EVAL, name)
            evidence.breach_of_fault(PARAMETERS, fault, shown=shown)


def _mask(asked: Condition, own: Integers) -> Flags:
    """Mask of the samples of these numbers."""
    mask = np.zeros(len(asked.spots), dtype=bool)
    mask[own[own < len(mask)]] = True
    return mask


def _wrong_gradients(
    asked: _Asked, line: _Line
) -> Iterator[tuple[Any, str, float, Flags]]:
    """Guess, text, size and mask of wrong gradients, of each sample, along a line."""
    name, probe, rows = ", ".join(line.kinds), asked.probe, asked.rows
    params = mi.traverse(probe.bsdf)

    def answers(step: float) -> dict[Function, Floats]:
        if step:  # updates may take long
            assign(params, line.at(step))
        each = ((one, FUNCTIONS[one](probe, vectors(rows))) for one in asked.functions)
        return {one: _columns(answer, rows) for one, answer in each}

    along = dr.opaque(mi.Float, 0)
    dr.enable_grad(along)
    with changed(probe.bsdf, line.at()):
        here = answers(0)
        pairs = [(answers(h * line.size), answers(-h * line.size)) for h in STEPS]
        assign(params, line.at(0, along))
        slopes = _forward(asked, along)
        # densities may be detached in all functions: those of samples are
        detached = all(not x[:, -1].any() for f, x in slopes.items() if f != EVAL)
        for one in asked.functions:
            slope, each = slopes[one], [[x[one] for x in pair] for pair in pairs]
            due, wrong, small = _differences(here[one], each, slope, line)
            if detached and one != EVAL:
                wrong[:, -1] = False
            if asked.kind and _cancel(np.where(wrong, slope - due, 0), here[one]):
                continue
            # jumps, of which a gradient knows nothing, are in few directions
            share = float(wrong.any(axis=1).mean())
            if share > MAX_JUMPS:
                # colours may exchange theirs
                i = int(wrong.sum(axis=0).argmax())
                own, expected = (np.median(x[wrong[:, i], i]) for x in (slope, due))
                text = f"for {share:.3g} of the {asked.noun}, with the median {own:.4g}"
                text += f" where differences have {expected:.4g}"
                yield asked.mistake(one, name=name), text, share, wrong[:, i]
            elif asked.both_ways and (right := small & ~wrong.any(axis=1)).any():
                by = _backward(probe, one, along, rows[right], slope[right])
                own, expected, slack = by
                if not abs(own - expected) <= slack:
                    text = f"{own:.4g} where forward gradients have {expected:.4g}"
                    yield Parameters.BACKWARD(one, name=name), text, 1.0, right


def _cancel(off: Floats, here: Floats) -> bool:
    """Whether errors of weights have the mean 0, as of lobes of one direction may be.

    Of a parameter that moves light from one to the other, as far as chance may tell.
    """
    each = off / np.maximum(here[:, -1:], UNDERFLOW)
    error = each.std(axis=0) / len(each) ** 0.5
    return bool(np.all(np.abs(each.mean(axis=0)) <= MAX_SCORE * error))


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
    # where the smallest step changes much, or one is beyond a range, they know nothing
    each = [np.abs(x - here) <= MAX_CHANGE * here for x in pairs[-1]]
    small = np.all(each, axis=0) & np.isfinite(changes)
    return fine, wrong & small, small.all(axis=1)


def _forward(asked: _Asked, along: mi.Float) -> dict[Function, Floats]:
    """Derivatives of answers by what parameters depend on, shape (n, columns)."""
    # one answer may follow from another, whose gradient would be cleared
    end, given = dr.opaque(mi.Float, 1), vectors(asked.rows)
    each = ((one, FUNCTIONS[one](asked.probe, given)) for one in asked.functions)
    answers = {one: tuple(x * end for x in answer) for one, answer in each}
    with as_plugin_fault(str(asked.functions[0])):
        dr.forward(along, flags=FLAGS)
    slopes = {one: tuple(map(dr.grad, answer)) for one, answer in answers.items()}
    return {one: _columns(slope, asked.rows) for one, slope in slopes.items()}


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

"""`traverse` answers; gradients of `eval` are its changes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...array_types import Floats
from ...transport.bsdf_trial import PluginFault
from ..conditions import Condition, Effort, Sweep
from ..evidence import BIAS, BREAKS, INTERFACE, MAX_P, SAME, Evidence, Question
from ..kinds import Kind
from ..mistakes import EVAL, PDF, SAMPLE, Function, Mistake
from ..probe import (
    Probe,
    as_plugin_fault,
    assign,
    changed,
    number_parameters,
    numbers,
    spectral,
    uniform,
    update,
    vectors,
)
from ..samples import Samples, beyond_rounding, unequal
from . import answers
from .consistency import check_sweep

PARAMETERS = Question(
    "parameters",
    __doc__,
    BREAKS,
    "prb and all that change or differentiate parameters",
    volumes=SAME,
    rank=3,
)


class Parameters(Mistake):
    """What is wrong with parameters."""

    STALE = "{who} does not follow a change of {name}"
    STALE_ALONE = "{those} {does} not follow a change of {name} alone"
    UPDATE = "{who} changes {those} where no parameter has changed"
    GRADIENT = "gradients of {who} by {name} are not its changes"


# Step of a sequence that is spread evenly: the golden section.
GOLDEN = (5**0.5 - 1) / 2

# Largest and smallest relative steps that all functions must follow, or steps of a 0.
FAR, NEAR = 0.5, 2.0**-4

# Parameters that are changed alone, and rays that tell whether all functions follow.
MAX_ALONE, N_UPDATED = 8, 2**10

# How near to 1 the length of a direction is.
UNIT = 1e-4

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


def check_samples(evidence: Evidence, samples: Samples) -> None:
    """Check ``traverse``, and gradients of ``eval`` against finite differences."""
    try:
        params, values = number_parameters(evidence.bsdf, mi.TensorXf)
        usable = samples.smooth & np.isfinite(samples.eval).all(axis=1)
        if usable.any() and hasattr(dr, "enable_grad") and "_ad_" in mi.variant():
            wo = vectors(samples.wo[usable])
            for name, value in values.items():
                fixed = params.flags(name) & mi.ParamFlags.NonDifferentiable.value
                # not at 0, where most ranges end and a lobe may vanish
                if not fixed and np.array(value).any():
                    _check_gradient(evidence, samples.condition, params, name, wo)
    except PluginFault as fault:
        # images need none of it
        effect = INTERFACE if fault.function == "traverse" else ""
        evidence.breach_of_fault(PARAMETERS, fault, effect=effect)


def check_changes(evidence: Evidence, plan: Effort, sides: Sequence[str]) -> None:
    """Check that all functions follow a change of all parameters, or of each alone."""
    known = [*evidence.breaches, *(t for t in evidence.tests if t.p < MAX_P)]
    if any(one.effect == BIAS for one in known):
        return  # a change adds nothing to what is wrong before
    values = _changeable(evidence.bsdf)
    if not values:
        return
    # those in C++ may rebuild tables at each update, which takes longer than all else
    if type(evidence.bsdf) is not mi.BSDF or plan != Effort.named("quick"):
        _check_updates(evidence, values, sides)
    others = {name: _other(value) for name, value in values.items()}
    after = _after(evidence, plan, sides, others)
    if after is not None and not _biases(after):
        text = "directions after a change of all parameters"
        evidence.test(PARAMETERS, _least_p(after), text)
        return
    # together, they may be out of their range
    for name in values:
        found = _alone(evidence, plan, sides, name, values[name])
        if found is None:
            continue
        function = _stale(evidence.sweeps[0], found)
        guess = Parameters.STALE(function, name=name)
        breaches = [b.statistic for b in found.breaches if b.effect == BIAS]
        if breaches:
            text = f"after a change of {name}: {breaches[0]}"
            evidence.breach(PARAMETERS, guess, found=text, size=2.0, about=name)
        else:
            text = min(found.tests, key=lambda test: test.p).statistic
            text, p = f"after a change of {name}: {text}", len(values) * _least_p(found)
            how = {"kind": Kind.DENSITY_AFTER_A_CHANGE, "about": name, "guess": guess}
            evidence.test(PARAMETERS, min(1.0, p), text, **how)
        return


def _check_updates(
    evidence: Evidence, values: dict[str, Any], sides: Sequence[str]
) -> None:
    """Check that an update of all parameters changes nothing that needs no change.

    Neither at first, nor after one parameter got another value, in its range or not.
    """
    bsdf = evidence.bsdf
    sweep = Sweep(side=sides[0], both=len(sides) > 1, n=N_UPDATED)
    probe, random = Probe(bsdf, sweep), uniform(sweep.n, (evidence.seed, 5))
    wo = spectral(probe.sample(*random)[0].wo, sweep.n)

    def asked() -> dict[str, Floats]:
        """Of each function, shape (n, ...)."""
        bs, weight = probe.sample(*random)
        pdf, drawn = numbers(bs.pdf, sweep.n), spectral(bs.wo, sweep.n)
        found = np.column_stack([pdf, drawn, spectral(weight, sweep.n)])
        found[~found[:, 4:].any(axis=1)] = 0  # no sample
        return {"eval": probe.values(wo), "pdf": probe.densities(wo), "sample": found}

    how: dict[str, Any]
    names = few(values) if len(values) > 1 else ()
    for name in ("", *names):
        others = {name: _other(values[name])} if name else {}
        try:
            with changed(bsdf, others):
                before = asked()
                update(bsdf, values)
                after = asked()
        except PluginFault as fault:
            if name:
                continue  # a value that is refused
            evidence.breach_of_fault(PARAMETERS, fault)
            return
        own = [
            function
            for function, answer in before.items()
            if beyond_rounding(unequal(answer, after[function], 0.0))
        ]
        if own:
            those = " and ".join(f"`{one}`" for one in own)
            guess = Parameters.UPDATE(Function.PARAMETERS_CHANGED, those=those)
            how = {"kind": Kind.UPDATE, "about": own[0]}
            if name:
                fields = {"does": "does" if len(own) == 1 else "do", "name": name}
                function, how = Function.named(own[0]), {"about": name}
                guess = Parameters.STALE_ALONE(function, those=those, **fields)
            text = f"another answer after an update of all parameters, at {sweep}"
            evidence.breach(PARAMETERS, guess, found=text, size=3.0, **how)
            return


def _changeable(bsdf: mi.BSDF) -> dict[str, Any]:
    """Numbers, colours, vectors and tables of a BSDF, by name."""
    vector_kinds = (mi.Vector2f, mi.Point2f, mi.Vector3f, mi.Point3f, mi.Normal3f)
    try:
        _, known = number_parameters(bsdf, mi.TensorXf, *vector_kinds)
    except PluginFault:
        return {}  # a property of its own
    return {k: x for k, x in known.items() if np.isfinite(np.array(x)).all()}


def few(values: dict[str, Any]) -> list[str]:
    """Names of at most `MAX_ALONE` of them, evenly chosen."""
    return list(values)[:: -(-len(values) // MAX_ALONE)]


def _other(value: Any, step: float | None = None) -> Any:
    """Another value, of a relative step; without it a large one in usual ranges."""
    x = np.array(value, dtype=float)
    turns, size = _turns(x), np.abs(x).max(initial=0)
    table = isinstance(value, mi.TensorXf)
    may_be_unit = x.size > 1 and not isinstance(value, (mi.Color3f, mi.Spectrum))
    if size == 0:
        x = x + (step or FAR)
    else:
        if step is None:
            # not beyond 1, where ranges end
            step = -FAR if size <= 1 or table else FAR
        if may_be_unit and not table and abs(np.linalg.norm(x) - 1) < UNIT:
            x = x + step * turns
            x = x / np.linalg.norm(x)
        else:
            # a table not in proportion, of which a density knows nothing
            x = x * (1 + step * (turns if table else 1))
    other = type(value)(np.float32(x))
    dr.make_opaque(other)
    return other


def _turns(x: Floats) -> Floats:
    """Numbers from 0 to 1 spread evenly, of the shape of an array; the first is 0."""
    return np.reshape(np.arange(x.size) * GOLDEN % 1, x.shape)


def _after(
    evidence: Evidence, plan: Effort, sides: Sequence[str], values: dict[str, Any]
) -> Evidence | None:
    """Evidence after a change of parameters; None if the plugin refuses a value."""
    found = Evidence(evidence.bsdf, evidence.seed, evidence.questions)
    try:
        with changed(evidence.bsdf, values):
            check_sweep(found, plan, sides)
            probe = Probe(evidence.bsdf, Condition(40.0, 25.0, sides[0]))
            answers.check_lattice(found, probe)
    except PluginFault:
        return None
    return found


def _alone(
    evidence: Evidence, plan: Effort, sides: Sequence[str], name: str, value: Any
) -> Evidence | None:
    """What is wrong after any change of one parameter; None if nothing is.

    A change out of its range proves nothing: values are improper, or all functions
    follow a smaller one, as far as that can be seen without chance.
    """
    worst = None
    for step in (None, NEAR, -NEAR):
        found = _after(evidence, plan, sides, {name: _other(value, step)})
        if found is None or found.of("answers"):
            continue
        if not _biases(found):
            return None
        worst = worst or found
        if not any(b.effect == BIAS for b in found.breaches):
            break
    return worst


def _least_p(found: Evidence) -> float:
    """Probability that chance makes the worst of all tests as bad as it is."""
    tests = found.tests
    return min(1.0, len(tests) * min((test.p for test in tests), default=1.0))


def _biases(found: Evidence) -> bool:
    """Whether something certainly fails after a change."""
    return _least_p(found) < MAX_P or any(b.effect == BIAS for b in found.breaches)


def _stale(before: Samples, found: Evidence) -> Function:
    """Function whose answers stayed the same where those of others changed."""
    after = found.sweeps[0]
    still = (before.wo == after.wo).all(axis=1) & before.usable & after.usable

    def same(answer: Callable[[Samples], Floats]) -> bool:
        return not beyond_rounding(unequal(answer(before), answer(after), 0.0) & still)

    names = {b.name for b in found.breaches if b.effect == BIAS}
    if "sampled_weight" in names and "sampled_pdf" not in names:
        stale_eval, stale_weight = same(lambda x: x.eval), same(lambda x: x.flux)
        if stale_eval != stale_weight:
            return EVAL if stale_eval else SAMPLE
        return EVAL | SAMPLE
    if "sampled_pdf" in names or not names:
        if same(lambda one: one.pdf) and not same(lambda one: one.sampled_pdf):
            return PDF
        return SAMPLE if still[before.usable].all() else SAMPLE | PDF
    return next(b.guess.functions for b in found.breaches if b.effect == BIAS)


def _check_gradient(
    evidence: Evidence, condition: Condition, params: Any, name: str, wo: mi.Vector3f
) -> None:
    """Check gradients of ``eval``, one per direction, against central differences.

    Along a line on which no two numbers of a colour or a table change alike.
    """
    bsdf, kind = evidence.bsdf, type(params[name])
    x = np.array(params[name], dtype=float)
    # most ranges end at 1
    x = np.where(x == 1, BELOW_1, x)
    size = float(np.max(np.abs(x)))
    slope = kind(np.float32(x / size * (1 - _turns(x) / 2)))
    value = kind(np.float32(x))

    def answer(step: float) -> Floats:
        assign(params, {name: kind(value + step * size * slope)})
        return spectral(Probe(bsdf, condition).eval(wo), dr.width(wo))

    along = mi.Float(0)
    dr.enable_grad(along)
    with changed(bsdf, {name: value}):  # once there and back: updates may take long
        here = spectral(Probe(bsdf, condition).eval(wo), dr.width(wo))
        pairs = [(answer(h), answer(-h), 2 * h * size) for h in STEPS]
        assign(params, {name: kind(value + along * slope)})
        gradient = _gradient(bsdf, condition, along, wo)
    coarse, middle, fine = ((above - below) / width for above, below, width in pairs)
    # each value is known to some roundings
    noise = N_ROUNDINGS * np.finfo(np.float32).eps * (pairs[-1][0] + pairs[-1][1])
    changes = np.abs(fine - middle) + np.abs(middle - coarse)
    slack = STEP_SLACK * changes + noise / pairs[-1][2]
    wrong = ~(np.abs(gradient - fine) <= slack)
    # where the smallest step changes much, differences know nothing of the slope
    wrong &= np.all(
        [np.abs(x - here) <= MAX_CHANGE * here for x in pairs[-1][:2]], axis=0
    )
    # jumps, of which a gradient knows nothing, are in few directions
    share = float(wrong.any(axis=1).mean())
    if share > MAX_JUMPS:
        # colours may exchange theirs
        i = int(wrong.sum(axis=0).argmax())
        own, due = (float(np.median(x[wrong[:, i], i])) for x in (gradient, fine))
        evidence.breach(
            PARAMETERS,
            Parameters.GRADIENT(EVAL, name=name),
            condition,
            statistic=f"by {name}: for {share:.3g} of the directions at {condition}, "
            f"with the median {own:.4g} where differences have {due:.4g}",
            size=share,
            kind=Kind.GRADIENT,
            about=name,
        )


def _gradient(
    bsdf: mi.BSDF, condition: Condition, variable: mi.Float, wo: mi.Vector3f
) -> Floats:
    """Derivatives of ``eval`` by what a parameter depends on, shape (n, channels)."""
    answer = Probe(bsdf, condition).eval(wo)
    with as_plugin_fault("eval"):
        flags = dr.ADFlag.Default | dr.ADFlag.AllowNoGrad
        dr.forward(variable, flags=flags)
    return spectral(dr.grad(answer), dr.width(wo))

"""`traverse` answers; functions follow parameters, and gradients are changes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...array_types import Floats
from ...transport.bsdf_trial import PluginFault
from ..conditions import Condition, Effort, Sweep
from ..evidence import BIAS, BREAKS, MAX_P, SAME, Evidence, Question
from ..kinds import Kind
from ..mistakes import EVAL, PDF, SAMPLE, Function, Mistake
from ..probe import (
    Probe,
    changed,
    number_parameters,
    numbers,
    spectral,
    uniform,
    update,
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
    BACKWARD = "backward gradients of {who} by {name} are not its changes"
    GRADIENT = "gradients of {who} by {name} are not its changes"


# Step of a sequence that is spread evenly: the golden section.
GOLDEN = (5**0.5 - 1) / 2

# Largest and smallest relative steps that all functions must follow, or steps of a 0.
FAR, NEAR = 0.5, 2.0**-4

# Parameters that are changed alone, and rays that tell whether all functions follow.
MAX_ALONE, N_UPDATED = 8, 2**10

# How near to 1 the length of a direction is.
UNIT = 1e-4


def check_changes(evidence: Evidence, plan: Effort, sides: Sequence[str]) -> None:
    """Check that all functions follow a change of all parameters, or of each alone."""
    known = [*evidence.breaches, *(t for t in evidence.tests if t.p < MAX_P)]
    if any(one.effect == BIAS for one in known):
        return  # a change adds nothing to what is wrong before
    values = _changeable(evidence.bsdf)
    if not values:
        return
    if may_update_often(evidence, plan):
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


def may_update_often(evidence: Evidence, plan: Effort) -> bool:
    """Whether there is time for many updates of parameters.

    Plugins in C++ may rebuild tables at each, which takes longer than all else.
    """
    return type(evidence.bsdf) is not mi.BSDF or plan != Effort.named("quick")


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
    spread, size = turns(x), np.abs(x).max(initial=0)
    table = isinstance(value, mi.TensorXf)
    may_be_unit = x.size > 1 and not isinstance(value, (mi.Color3f, mi.Spectrum))
    if size == 0:
        x = x + (step or FAR)
    else:
        if step is None:
            # not beyond 1, where ranges end
            step = -FAR if size <= 1 or table else FAR
        if may_be_unit and not table and abs(np.linalg.norm(x) - 1) < UNIT:
            x = x + step * spread
            x = x / np.linalg.norm(x)
        else:
            # a table not in proportion, of which a density knows nothing
            x = x * (1 + step * (spread if table else 1))
    other = type(value)(np.float32(x))
    dr.make_opaque(other)
    return other


def turns(x: Floats) -> Floats:
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

"""`traverse` answers; functions follow parameters, and gradients are changes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...array_types import Floats
from ...mitsuba_compat import floats
from ...specimen.bsdf_trial import PluginFault
from ..arrays import (
    Sides,
    answer_of,
    density,
    drawn,
    parameters,
    rows,
    smooth,
    sphere,
)
from ..conditions import Condition, Effort, Sweep
from ..densities import Means
from ..evidence import (
    BIAS,
    BREAKS,
    MAX_P,
    SAME,
    Breach,
    Evidence,
    Question,
    answered,
)
from ..judgements import apart, by_sample, same
from ..mistakes import EVAL, PDF, SAMPLE, Claim, Function, Guess, Mistake
from ..probe import (
    Probe,
    changed,
    number_parameters,
    update,
)
from ..samples import Samples, beyond_rounding, samples_of, unequal
from . import answers
from .consistency import check_identities, check_sweep
from .sampled_pdf import sampled_pdf
from .sampled_weight import sampled_weight


def followed(
    bsdf: Any, ctx: Any, si: Any, u: Any, stated: Any, name: str, to: Any
) -> Any:
    """A property holds after a change of a parameter."""
    params = parameters(bsdf)
    own = params[name]
    other = dr.select(own == 0, 0.5, own / 2) if to is None else type(own)(to)
    params.update({name: other})
    return stated(bsdf, ctx, si, u)


def same_density(bsdf: Any, ctx: Any, si: Any, u: Any) -> Means:
    """Samples have the density of `pdf`."""
    # the mean of 1 / (1 + p) over directions of the density p is that of p / (1 + p)
    # over even ones, whose density is 1
    bs, weight = drawn(bsdf, ctx, si, u)
    wos = bs.wo, sphere(u.y, u.z)
    p, q = (4 * np.pi * density(bsdf, ctx, si, wo)[0] for wo in wos)
    x, y = smooth(bs, weight) / (1 + p), q / (1 + q)
    return np.mean(x), np.mean(y), np.std(x - y) / len(x) ** 0.5


def returned(bsdf: Any, ctx: Any, si: Any, u: Any, what: Any) -> Sides:
    """Answers return when all parameters do."""
    bs, weight = drawn(bsdf, ctx, si, u)
    before, params = rows(what(bsdf, ctx, si, bs.wo, u)), parameters(bsdf)
    for factor in (0.5, 2):
        for name, x in list(params):
            if dr.is_array_v(x) and dr.is_float_v(x):
                params[name] = factor * x
        params.update()
    return before, rows(what(bsdf, ctx, si, bs.wo, u)), smooth(bs, weight)


PARAMETERS = Question(
    "parameters",
    __doc__,
    BREAKS,
    "prb and all that change or differentiate parameters",
    volumes=SAME,
    rank=3,
    shown=Claim(answered, same, ("traverse",)),
)


class Parameters(Mistake):
    """Mistakes in parameters."""

    STALE = "{who} does not follow a change of {name}"
    STALE_ALONE = "{those} {does} not follow a change of {name} alone"
    WRONG_AT = "{who} does not follow a change of {name} to {to}"
    UPDATE = "`parameters_changed` changes {those} where no parameter has changed"
    REMEMBERED = "{those} {does} not return when all parameters do"
    BACKWARD = "backward gradients of {who} by {name} are not its changes"
    GRADIENT = "gradients of {who} by {name} are not its changes"
    WEIGHT = """gradients of the weight of {who} by {name} are not the changes of its
        discrete lobe"""


# Step of a sequence that is spread evenly: the golden section.
GOLDEN = (5**0.5 - 1) / 2

# Largest and smallest relative steps that all functions must follow, or steps of a 0.
FAR, NEAR = 0.5, 2.0**-4

# Values to which numbers go further: down if they went up, else halfway to 1, next to
# 1, and to the smallest roughness or share that is usual.
FURTHER: tuple[Callable[[Floats], Floats], ...] = (
    lambda x: np.where(np.abs(x) > 1, x / 2, np.sign(x) * (1 + np.abs(x)) / 2),
    lambda x: np.where(np.abs(x) > 1, 1.25 * x, np.sign(x) * 0.98),
    lambda x: np.sign(x) * 1e-3,
)

# Parameters that are changed alone, and rays that tell whether all functions follow.
MAX_ALONE, N_UPDATED = 8, 2**10

# How near to 1 the length of a direction is.
UNIT = 1e-4


def check_changes(evidence: Evidence, plan: Effort, sides: Sequence[str]) -> None:
    """Check that functions follow changes of parameters, and return with them."""
    known = [*evidence.breaches, *(t for t in evidence.tests if t.p < MAX_P)]
    if any(one.effect == BIAS for one in known):
        return  # a change adds nothing to what is wrong before
    values = _changeable(evidence.bsdf)
    if not values:
        return
    sweep = Sweep(side=sides[0], both=len(sides) > 1, n=N_UPDATED)
    asked = evidence.bsdf, sweep, sweep.n, (evidence.seed, 5), False
    try:
        # numbers of another kind than at first may round otherwise
        update(evidence.bsdf, values)
        first = samples_of(*asked)
        by_chance = _differing(evidence, first)
        if may_update_often(evidence, plan):
            _check_updates(evidence, values, asked, by_chance)
        _check_values(evidence, plan, sides, values)
        own = _differing(evidence, first, by_chance)
    except PluginFault as fault:
        evidence.breach_of_fault(PARAMETERS, fault)
        return
    if own and not evidence.of("parameters"):
        guess = _blamed(own, Parameters.REMEMBERED)
        text = "another answer after parameters were changed and changed back"
        shown = _returned(own[0])
        evidence.breach(PARAMETERS, guess, found=text, size=3.0, shown=shown)


def check_instances(evidence: Evidence) -> None:
    """Check that answers stay where another instance is loaded, and is changed.

    Of plugins in Python, whose class may keep what belongs to an instance.
    """
    plugin = type(getattr(evidence.bsdf, "phase_function", evidence.bsdf))
    if evidence.load is None or plugin in (mi.BSDF, mi.PhaseFunction) or evidence.noisy:
        return
    biased = any(one.effect == BIAS for one in evidence.breaches)
    if biased or evidence.of("answers"):
        return  # it adds nothing, or `sample` draws numbers of its own
    usual: Any = evidence.sweeps[0].condition
    asked = replace(usual, n=N_UPDATED), N_UPDATED, (evidence.seed, 6), False
    before = samples_of(evidence.bsdf, *asked)
    try:
        other = evidence.load()
        values = _changeable(other)
        with changed(other, {name: _other_value(x) for name, x in values.items()}):
            own = _differing(evidence, before)
    except PluginFault:
        return  # of a value out of its range
    for function in own:
        guess = answers.Answers.OF_INSTANCE(function)
        shown = Claim(answers.again, by_sample, (answer_of(function),))
        how = {"found": "other values", "size": 2.0, "shown": shown}
        evidence.breach(answers.ANSWERS, guess, usual, **how)
        return


def _check_values(
    evidence: Evidence, plan: Effort, sides: Sequence[str], values: dict[str, Any]
) -> None:
    """Check that all functions follow a change of all parameters, or of each alone."""
    others = {name: _other_value(value) for name, value in values.items()}
    after = _after_sweep(evidence, plan, sides, others)
    if after is not None and not _biases(after):
        text = "directions after a change of all parameters"
        evidence.test(PARAMETERS, _corrected_p(after), text)
        _check_further(evidence, plan, values)
        return
    # together, they may be out of their range
    for name in values:
        found = _after_one_change(evidence, plan, sides, name, values[name])
        if found is None:
            continue
        guess = Parameters.STALE(_stale(evidence.sweeps[0], found), name=name)
        text = f"after a change of {name}: "
        if wrong := _breaches(found):
            text += wrong[0].statistic
            shown = _followed(guess.functions, name)
            evidence.breach(PARAMETERS, guess, found=text, size=2.0, shown=shown)
        else:
            p = min(1.0, len(values) * _corrected_p(found))
            text += min(found.tests, key=lambda test: test.p).statistic
            shown = Claim(followed, apart, (same_density, name, None))
            evidence.test(PARAMETERS, p, text, guess=guess, shown=shown)
        return


def _check_further(evidence: Evidence, plan: Effort, values: dict[str, Any]) -> None:
    """Check that functions agree where numbers are others again, and where tiny."""
    kinds = (mi.Float, mi.Color3f, mi.Spectrum)
    usual: Any = evidence.sweeps[0].condition
    sweep, key = replace(usual, n=N_UPDATED), (evidence.seed, 4)

    def identities(found: Evidence) -> None:
        found.sweeps.append(samples_of(evidence.bsdf, sweep, N_UPDATED, key))
        check_identities(found, found.sweeps[0])

    for further in FURTHER:
        others = {
            name: opaque(type(x), further(np.array(x, dtype=float)))
            for name, x in values.items()
            if isinstance(x, kinds) and np.array(x).any()
        }
        if not others:
            return
        after = _asked_after(evidence, others, identities)
        # together, they may be out of their range
        alone: Any = may_update_often(evidence, plan)
        if after and not after.of("answers"):
            alone = _breaches(after)
        for name in evenly_chosen(others) if alone else ():
            found = _asked_after(evidence, {name: others[name]}, identities)
            wrong = _breaches(found) if found and not found.of("answers") else []
            if not (found and wrong):
                continue
            to = ", ".join(f"{x:.3g}" for x in np.ravel(np.array(others[name])))
            before = samples_of(evidence.bsdf, sweep, N_UPDATED, key, False)
            function = _stale(before, found)
            if function is SAMPLE and found.of("sampled_pdf"):
                function |= PDF  # `sample` is not stale for sure
            guess = Parameters.WRONG_AT(function, name=name, to=to)
            text = f"after a change of {name} to {to}: {wrong[0].statistic}"
            shown = _followed(function, name, np.ravel(np.array(others[name])).tolist())
            evidence.breach(PARAMETERS, guess, found=text, size=2.0, shown=shown)
            return


def may_update_often(evidence: Evidence, plan: Effort) -> bool:
    """Whether there is time for many updates of parameters.

    Plugins in C++ may rebuild tables at each, which takes longer than all else.
    """
    plugin = getattr(evidence.bsdf, "phase_function", evidence.bsdf)
    in_python = type(plugin) not in (mi.BSDF, mi.PhaseFunction)
    return in_python or plan != Effort.named("quick")


def _differing(
    evidence: Evidence, before: Samples, but: Sequence[Function] = ()
) -> list[Function]:
    """Functions that answer otherwise than before, `but` for some."""
    probe = Probe(evidence.bsdf, before.condition)
    own = answers.asked_again(before, probe, exact=True)
    return [one for one in own if one not in but]


def _blamed(own: Sequence[Function], mistake: Parameters, **fields: str) -> Guess:
    """A mistake of an update, or of the one function that changes by it."""
    alone = own[0] if len(own) == 1 else Function(0)
    fields["those"] = " and ".join(one.quoted for one in own)
    fields["does"] = "does" if len(own) == 1 else "do"
    return mistake(alone | Function.PARAMETERS_CHANGED, **fields)


def _returned(function: Function) -> Claim:
    """How a script shows that a function does not return with all parameters."""
    return Claim(returned, by_sample, (answer_of(function),))


def _followed(function: Function, name: str, to: Any = None) -> Claim:
    """How a script shows that a function does not follow a parameter."""
    of_density = function.names[0] in ("sample", "pdf")
    stated = sampled_pdf if of_density else sampled_weight
    if to is not None:
        to = to[0] if len(to) == 1 else to
    return Claim(followed, by_sample, (stated, name, to))


def _check_updates(
    evidence: Evidence,
    values: dict[str, Any],
    asked: tuple[Any, ...],
    by_chance: Sequence[Function],
) -> None:
    """Check that an update of all parameters changes nothing that needs no change.

    Neither at first, nor after one parameter got another value, in its range or not.
    What is `asked` are arguments of :func:`samples_of`; functions that answer
    `by_chance` are others anyway.
    """
    names = evenly_chosen(values) if len(values) > 1 else ()
    for name in ("", *names):
        others = {name: _other_value(values[name])} if name else {}
        try:
            with changed(evidence.bsdf, others):
                before = samples_of(*asked)
                update(evidence.bsdf, values)
                own = _differing(evidence, before, by_chance)
        except PluginFault:
            if name:
                continue  # a value that is refused
            raise
        if own:
            guess = _blamed(own, Parameters.UPDATE)
            shown = _returned(own[0])
            if name:
                guess = _blamed(own, Parameters.STALE_ALONE, name=name)
                guess = replace(guess, functions=own[0])
                shown = _followed(own[0], name)
            text = "another answer after an update of all parameters"
            evidence.breach(PARAMETERS, guess, found=text, size=3.0, shown=shown)
            return


def _changeable(bsdf: mi.BSDF) -> dict[str, Any]:
    """Numbers, colours, vectors and tables of a BSDF, by name."""
    vector_kinds = (mi.Vector2f, mi.Point2f, mi.Vector3f, mi.Point3f, mi.Normal3f)
    try:
        _, known = number_parameters(bsdf, mi.TensorXf, *vector_kinds)
    except PluginFault:
        return {}  # a property of its own
    return {k: x for k, x in known.items() if np.isfinite(np.array(x)).all()}


def evenly_chosen(values: dict[str, Any]) -> list[str]:
    """Names of at most `MAX_ALONE` of them, evenly chosen."""
    return list(values)[:: -(-len(values) // MAX_ALONE)]


def _other_value(value: Any, step: float | None = None) -> Any:
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
    return opaque(type(value), x)


def opaque(kind: type, x: Floats) -> Any:
    """A value of a parameter, in memory."""
    if dr.is_tensor_v(kind):
        return kind(floats(np.ravel(x)), np.shape(x))
    rows = np.reshape(x, (1 if kind is mi.Float else dr.size_v(kind), -1))
    return kind(*map(floats, rows))


def turns(x: Floats) -> Floats:
    """Numbers from 0 to 1 spread evenly, of the shape of an array; the first is 0."""
    return np.reshape(np.arange(x.size) * GOLDEN % 1, x.shape)


def _after_sweep(
    evidence: Evidence, plan: Effort, sides: Sequence[str], values: dict[str, Any]
) -> Evidence | None:
    """Evidence after a change of parameters; None if the plugin refuses a value."""
    return _asked_after(evidence, values, lambda found: check_sweep(found, plan, sides))


def _asked_after(
    evidence: Evidence, values: dict[str, Any], check: Callable[[Evidence], None]
) -> Evidence | None:
    """Evidence of a check after a change; None if the plugin refuses a value."""
    found = Evidence(evidence.bsdf, evidence.seed, evidence.questions)
    side = evidence.sweeps[0].condition.side
    probe = Probe(evidence.bsdf, Condition(40.0, 25.0, side))
    try:
        with changed(evidence.bsdf, values):
            check(found)
            answers.check_lattice(found, probe)
    except PluginFault:
        return None
    return found


def _after_one_change(
    evidence: Evidence, plan: Effort, sides: Sequence[str], name: str, value: Any
) -> Evidence | None:
    """What is wrong after any change of one parameter; None if nothing is.

    A change out of its range proves nothing: values are improper, or all functions
    follow a smaller one, as far as that can be seen without chance.
    """
    worst = None
    for step in (None, NEAR, -NEAR):
        found = _after_sweep(evidence, plan, sides, {name: _other_value(value, step)})
        if found is None or found.of("answers"):
            continue
        if not _biases(found):
            return None
        worst = worst or found
        if not _breaches(found):
            break
    return worst


def _corrected_p(found: Evidence) -> float:
    """Probability that chance makes the worst of all tests as bad as it is."""
    return min([1.0, *(len(found.tests) * test.p for test in found.tests)])


def _biases(found: Evidence) -> bool:
    """Whether something certainly fails after a change."""
    return _corrected_p(found) < MAX_P or bool(_breaches(found))


def _breaches(found: Evidence) -> list[Breach]:
    """Those that bias images."""
    return [one for one in found.breaches if one.effect == BIAS]


def _stale(before: Samples, found: Evidence) -> Function:
    """Function whose answers stayed the same where those of others changed."""
    after = found.sweeps[0]
    still = (before.wo == after.wo).all(axis=1) & before.usable & after.usable

    def same(answer: Callable[[Samples], Floats]) -> bool:
        return not beyond_rounding(unequal(answer(before), answer(after), 0.0) & still)

    names = {b.name for b in _breaches(found)}
    if "sampled_weight" in names and "sampled_pdf" not in names:
        stale_eval, stale_weight = same(lambda x: x.eval), same(lambda x: x.flux)
        if stale_eval != stale_weight:
            return EVAL if stale_eval else SAMPLE
        return EVAL | SAMPLE
    if "sampled_pdf" in names or not names:
        if same(lambda one: one.pdf) and not same(lambda one: one.sampled_pdf):
            return PDF
        return SAMPLE if still[before.usable].all() else SAMPLE | PDF
    return _breaches(found)[0].guess.functions

"""All functions return finite, non-negative values."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from functools import cache
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...array_types import Flags, Floats, Numbers
from ...collector.directions import direction
from ..arrays import (
    Sides,
    answer_of,
    drawn,
    full,
    lit_from,
    of_direction,
    of_eval,
    of_sampled_pdf,
    of_weight,
    rows,
    smooth,
    sphere,
    unsigned,
    value,
)
from ..conditions import POSITION, TURN
from ..evidence import ALL, BIAS, INTERFACE, MIN_RANDOM, NOISE, Evidence, Question
from ..judgements import by_sample, improper as any_improper
from ..mistakes import EVAL, PDF, SAMPLE, Claim, Function, Guess, Mistake
from ..probe import Probe, numbers, spectral, vectors
from ..samples import Samples, beyond_rounding, means_differ, unequal


def proper(bsdf: Any, ctx: Any, si: Any, u: Any, what: Any) -> tuple[Any]:
    """Answers are finite and not negative, of samples and in all directions."""
    bs, _ = drawn(bsdf, ctx, si, u)
    both = (what(bsdf, ctx, si, wo, u) for wo in (bs.wo, sphere(u.y, u.z)))
    found = np.hstack([unsigned(full(answer)) for answer in both])
    return (found,)


def again(bsdf: Any, ctx: Any, si: Any, u: Any, what: Any) -> Sides:
    """Answers are the same after other calls."""
    bs, weight = drawn(bsdf, ctx, si, u)
    first = rows(what(bsdf, ctx, si, bs.wo, u))
    others, _ = drawn(bsdf, ctx, si, mi.Point3f(u.y, u.x, u.z))
    value(bsdf, ctx, si, others.wo)
    return first, rows(what(bsdf, ctx, si, bs.wo, u)), smooth(bs, weight)


def backwards(bsdf: Any, ctx: Any, si: Any, u: Any, what: Any) -> Sides:
    """Answers are the same if rays are asked in another order."""
    wi = mi.warp.square_to_cosine_hemisphere(mi.Point2f(u.y, u.z))
    si = lit_from(si, dr.mulsign(wi, si.wi.z))
    bs, weight = drawn(bsdf, ctx, si, u)
    first = rows(what(bsdf, ctx, si, bs.wo, u))
    i = dr.width(u) - 1 - dr.arange(mi.UInt32, dr.width(u))
    wi, wo, u = (dr.gather(mi.Vector3f, mi.Vector3f(x), i) for x in (si.wi, bs.wo, u))
    last = rows(what(bsdf, ctx, lit_from(si, wi), wo, u))
    return first, last[..., ::-1], smooth(bs, weight)


def together(bsdf: Any, ctx: Any, si: Any, u: Any, what: Any, n: int) -> Sides:
    """Answers are the same in a call of `n` rays."""
    bs, weight = drawn(bsdf, ctx, si, u)
    i = np.arange(n) % 1024
    last = i[-1024:]
    first = rows(what(bsdf, ctx, si, bs.wo, u))[..., last]
    many = (dr.gather(type(x), x, mi.UInt32(i)) for x in (si, bs.wo, u))
    others = rows(what(bsdf, ctx, *many))[..., -1024:]
    return first, others, smooth(bs, weight)[last]


def in_the_world(bsdf: Any, ctx: Any, si: Any, u: Any, what: Any) -> Sides:
    """Local answers do not depend on how the surface is turned in the world."""
    bs, weight = drawn(bsdf, ctx, si, u)
    flat = type(si)(si)
    flat.sh_frame = mi.Frame3f([0, 0, 1])
    turned, there = (rows(what(bsdf, ctx, x, bs.wo, u)) for x in (si, flat))
    return turned, there, smooth(bs, weight)


def albedo(bsdf: Any, ctx: Any, si: Any, u: Any) -> Sides:
    """The reflectance of a Lambertian is pi times `eval` over the cosine."""
    bs, weight = drawn(bsdf, ctx, si, u)
    cosine = np.abs(rows(bs.wo.z))
    due = np.pi * value(bsdf, ctx, si, bs.wo) / np.fmax(cosine, 1e-3)
    reported = rows(bsdf.eval_diffuse_reflectance(si, True))
    return reported, due, smooth(bs, weight) & (cosine[0] > 1e-3)


ANSWERS = Question(
    "answers",
    __doc__,
    BIAS,
    ALL,
    volumes="both functions return finite, non-negative values; `eval` and "
    "`pdf` are the answers of `eval_pdf`",
    rank=0,
    matrices="all functions return finite matrices",
    shown=Claim(proper, any_improper, (of_eval,)),
)


class Answers(Mistake):
    """Mistakes in answers."""

    IMPROPER = "the {what} of {who} is {value}"
    IMPROPER_IN_PLACES = "the {what} of {who} is {value} in places"
    APPLIES_A_TRANSFORM = "{who} applies `{transform}` to wo, which is local"
    MIXES_COORDINATES = "{who} mixes local and world coordinates"
    MIXES_IN_WEIGHT = "{who} mixes local and world coordinates in its weight"
    IN_THE_WORLD = """{who} returns directions in world coordinates instead of local
        ones"""
    OF_FIELD = "{who}: {how} on {point}.{field}"
    OF_ORDER = "{who} depends on the place of a ray in the array"
    OF_NUMBER = "{who} depends on the number of rays that are asked together"
    OTHER_ALBEDO = "{who} is not the reflectance of `eval`, {due:.4g}"
    OF_INSTANCE = """{who} depends on another instance of the plugin: the class keeps
        what belongs to one"""
    OF_CALLS = "{who} returns different values when called again"
    BY_CHANCE = "{who} draws random numbers of its own, and is not reproducible"


# What `sample` answers.
OF_SAMPLES = {"weight": of_weight, "pdf": of_sampled_pdf, "direction": of_direction}

# Properties that hold unless two functions contradict each other.
AGREEMENTS = (
    *("directions", "sampling", "weights", "sampled_pdf", "sampled_weight"),
    *("eval_pdf", "eval_pdf_sample"),
)

# What chance in a function does to images, whose means are right.
BY_CHANCE = {EVAL: NOISE, SAMPLE: INTERFACE}

# Directions of the lattice on the sphere.
N_LATTICE = 2**12

# What a function does whose answers change for no reason that is known.
MIXED = (Answers.MIXES_COORDINATES, Answers.MIXES_IN_WEIGHT)

# Properties that are lacking if two functions depend differently on a field.
OF_TWO = {
    "sampled_weight": EVAL | SAMPLE,
    "sampled_pdf": SAMPLE | PDF,
    "sampling": SAMPLE | PDF,
    "weights": EVAL | SAMPLE,
}

# What a lobe can be: names as in mi.BSDFFlags.
LOBES = (
    *("Null", "DiffuseReflection", "DiffuseTransmission", "GlossyReflection"),
    *("GlossyTransmission", "DeltaReflection", "DeltaTransmission"),
)

# Relative difference of a reflectance that is the same.
MAX_ALBEDO_OFF = 1e-3

# Distance of two directions that are the same, however they round.
MAX_DISPLACEMENT = 1e-3


@ANSWERS.asks("samples")
def check_samples(evidence: Evidence, samples: Samples) -> None:
    """Check that all answers about samples are finite and at least 0."""
    given = samples.given
    smooth = given & ~samples.delta
    everywhere = np.ones_like(given)
    cases: list[tuple[Function, str, Floats, Flags]] = [
        (SAMPLE, "weight", samples.full("weight"), everywhere),
        (SAMPLE, "pdf", samples.sampled_pdf, given),
        # components of a vector may be negative
        (SAMPLE, "direction", np.abs(samples.wo), given),
        (EVAL, "value", samples.full("eval"), smooth),
        (PDF, "value", samples.pdf, smooth),
    ]
    if samples.reverse is not None:
        cases.insert(4, (EVAL, "value", samples.full("reverse"), smooth))
    for name in ("eval_pdf", "eval_pdf_sample"):
        joint = samples.joint.get(name, ())
        cases += [(Function.named(name), "value", x, smooth) for x in joint]
    for function, what, answer, where in cases:
        wrong = improper(answer) & where
        if wrong.any():
            fields = {"what": what, "value": example(answer[wrong])}
            guess = Answers.IMPROPER_IN_PLACES(function, **fields)
            own = OF_SAMPLES[what] if function is SAMPLE else answer_of(function)
            shown = Claim(proper, any_improper, (own,))
            evidence.breach(ANSWERS, guess, samples, wrong, shown=shown)


@cache
def lattice() -> Floats:
    """Directions on the sphere, evenly spread, shape (n, 3)."""
    z = (np.arange(N_LATTICE) + 0.5) / N_LATTICE * 2 - 1
    return direction(np.arccos(z), np.arange(N_LATTICE) * np.pi * (5**0.5 - 1))


def check_lattice(evidence: Evidence, probe: Probe) -> tuple[Floats, Floats]:
    """Check the same on a lattice of directions on the sphere, sampled or not.

    Returns
    -------
    value, density : ndarray
        Answers of ``eval`` and ``pdf`` there.
    """
    wo = lattice()
    value, density = probe.values(wo), probe.densities(wo)
    for function, answer in ((EVAL, value), (PDF, density)):
        wrong = improper(answer)
        if wrong.any():
            i = int(wrong.argmax())
            x, y, z = wo[i]
            theta, phi = np.degrees([np.arccos(z), np.arctan2(y, x)])
            black = np.isfinite(answer[wrong]).all() and not value[wrong].any()
            fields = {"what": "value", "value": example(answer[wrong])}
            guess = Answers.IMPROPER_IN_PLACES(function, **fields)
            share, place = float(wrong.mean()), f"{theta:.0f}, phi_o {phi % 360:.0f}"
            text = f"{share:.3g} of all directions, such as theta_o {place}"
            how = {"size": share, "off": share, "effect": INTERFACE if black else ""}
            how["shown"] = Claim(proper, any_improper, (answer_of(function),))
            evidence.breach(ANSWERS, guess, probe.condition, found=text, **how)
    return value, density


def check_frames(evidence: Evidence) -> None:
    """Check that local answers do not depend on the surface's rotation in the world.

    A model may depend on its place in the world as long as its functions agree. It is a
    mistake only if they contradict each other on a turned surface and on no other, or
    if a transform that is applied once too often explains all differences. A turned
    surface is moved, too: where that alone changes the answers, one function has
    forgotten the place, or another has it without reason.
    """
    flat, turned = (
        {
            (b.name, b.guess.functions)
            for b in evidence.breaches
            if b.name in AGREEMENTS and b.effect == BIAS
            if b.condition is not None and not b.condition.fields
            if b.condition.turned == is_turned
        }
        for is_turned in (False, True)
    )
    for samples in evidence.whole:
        found = None
        if samples.condition.turned and samples.usable.any():
            found = _turned_answer(evidence.bsdf, samples)
        if found is None:
            continue
        guess, wrong = found
        place = _turned_answer(evidence.bsdf, samples, moved=True) is None
        if not place and (turned - flat or guess.mistake not in MIXED):
            who = guess.functions
            what = of_direction if who is SAMPLE else answer_of(who)
            shown = Claim(in_the_world, by_sample, (what,))
            others: dict[str, Any] = {"size": 2.0, "off": None, "shown": shown}
            text = "where the surface is turned,"
            evidence.breach(ANSWERS, guess, samples, wrong, found=text, **others)
        else:
            _remark_on_place(evidence, guess.functions)
        return


def _remark_on_place(evidence: Evidence, function: Function) -> None:
    """Remark that answers depend on where the surface is in the world."""
    text = f"{function.quoted} depends on where the surface is in the world"
    if evidence.of_volumes:
        text = "it depends on axes of the world"
    # all of Mitsuba's own phase functions draw azimuths from such an axis
    if not evidence.of_volumes or function is not SAMPLE:
        evidence.remark("answers", text)


def _turned_answer(
    bsdf: mi.BSDF, samples: Samples, moved: bool = False
) -> tuple[Guess, Flags] | None:
    """Function whose answers change with the surface's rotation, or None.

    With its mistake, and the samples that show it. `sample` comes last, for its answers
    may follow from those of the others. Unless the surface is `moved` in both cases,
    its place changes, too.
    """
    probe = Probe(bsdf, replace(samples.condition, turned=False))
    if moved:
        probe.p = mi.Point3f(POSITION.tolist())
    usable, wo = samples.usable, samples.wo
    for function, answer, here, slack in (
        (EVAL, probe.values, samples.eval, samples.eval_slack),
        (PDF, probe.densities, samples.pdf, samples.pdf_slack),
    ):
        wrong = unequal(answer(wo), here, slack) & usable
        if beyond_rounding(wrong):
            for name, axes in (("to_local", TURN), ("to_world", TURN.T)):
                # a mask may ask for the side of either
                alike = usable & ((wo @ axes)[:, 2] * wo[:, 2] > 0)
                other = beyond_rounding(unequal(answer(wo @ axes), here, slack) & alike)
                if beyond_rounding(alike & wrong) and not other:
                    return Answers.APPLIES_A_TRANSFORM(function, transform=name), wrong
            return Answers.MIXES_COORDINATES(function), wrong
    bs, weight = probe.sample(*samples.random)
    flat = spectral(bs.wo, samples.n)
    wrong = _displaced(flat, wo) & samples.smooth
    if beyond_rounding(wrong):
        same = not beyond_rounding(_displaced(flat @ TURN.T, wo) & samples.smooth)
        mistake = Answers.IN_THE_WORLD if same else Answers.MIXES_COORDINATES
        return mistake(SAMPLE), wrong
    wrong = unequal(spectral(weight, samples.n), samples.weight, 0.0) & samples.smooth
    return (Answers.MIXES_IN_WEIGHT(SAMPLE), wrong) if beyond_rounding(wrong) else None


def _displaced(a: Floats, b: Floats) -> Flags:
    """Mask of directions that differ by more than rounding, even at the horizon."""
    return np.abs(a - b).max(axis=1) > MAX_DISPLACEMENT


def asked_again(
    samples: Samples, probe: Probe, i: mi.UInt32 | None = None, exact: bool = False
) -> dict[Function, Flags]:
    """Functions whose answers about samples are others, with masks of these samples.

    In the order of the numbers `i`, of as many as there are; the last tell. Without
    slack if they are to be `exact`, for a slack has what earlier calls changed.
    """
    slacks = samples.eval_slack, samples.pdf_slack
    if exact:
        slacks = np.zeros_like(samples.eval), np.zeros_like(samples.pdf)
    if i is None:
        i = dr.arange(mi.UInt32, samples.n)
    n, kept = dr.width(i), min(dr.width(i), samples.n)
    last = dr.arange(mi.UInt32, kept) + (n - kept)
    given = samples.wi, samples.wo, samples.u
    wi, wo, u = (dr.gather(mi.Vector3f, vectors(x), i) for x in given)
    dr.make_opaque(wi, wo, u)

    def end(answer: Any) -> Floats:
        """Of the last samples, shape (kept, ...)."""
        kind = type(answer)
        found = dr.gather(kind, answer + dr.zeros(kind, n), last)
        return spectral([found] if kind is mi.Float else found, kept)

    probe.of_lanes(i)
    bs, weight = probe.sample(u.x, mi.Point2f(u.y, u.z), wi=wi)
    own = numbers(dr.gather(mi.UInt32, i, last), kept)
    lit, usable = samples.given[own], samples.usable[own]
    differs = {
        EVAL: unequal(end(probe.eval(wo, wi=wi)), samples.eval[own], slacks[0][own]),
        PDF: unequal(end(probe.pdf(wo, wi=wi))[:, 0], samples.pdf[own], slacks[1][own]),
        SAMPLE: unequal(end(weight), samples.weight[own], 0.0) & lit
        | unequal(end(bs.pdf)[:, 0], samples.sampled_pdf[own], slacks[1][own]) & usable
        | _displaced(end(bs.wo), samples.wo[own]) & usable,
    }
    found = {}
    for function, wrong in differs.items():
        mask = np.zeros(samples.n, dtype=bool)
        mask[own] = wrong & (lit if function is SAMPLE else usable)
        if beyond_rounding(mask[own]):
            found[function] = mask
    return found


def check_same(
    evidence: Evidence,
    samples: Samples,
    mistake: Answers,
    shown: Claim,
    i: mi.UInt32 | None = None,
    exact: bool = False,
) -> None:
    """Check that answers about samples are the same when these are asked again.

    Parameters as of :func:`asked_again`.
    """
    found = asked_again(samples, Probe(evidence.bsdf, samples.condition), i, exact)
    # whatever the surroundings are
    told = replace(samples, condition=replace(samples.condition, fields=()))
    for function, wrong in found.items():
        own = replace(shown, given=(answer_of(function), *shown.given))
        how: dict[str, Any] = {"size": 2.0, "off": None, "shown": own}
        if _is_by_chance(evidence, samples, function, wrong):
            mistake, how["effect"] = Answers.BY_CHANCE, BY_CHANCE[function]
        evidence.breach(ANSWERS, mistake(function), told, wrong, **how)
        return


def _is_by_chance(
    evidence: Evidence, samples: Samples, function: Function, wrong: Flags
) -> bool:
    """Whether a function draws numbers of its own, with the same means each time.

    Many answers must be others: a few have another cause.
    """
    if function is not SAMPLE or wrong.mean() <= MIN_RANDOM:
        return function is EVAL and evidence.noisy
    bs, weight = Probe(evidence.bsdf, samples.condition).sample(*samples.random)
    wo, weight = spectral(bs.wo, samples.n), spectral(weight, samples.n)
    usable = samples.usable & np.isfinite(weight).all(axis=1)
    both = samples.weight[usable], weight[usable]
    return not means_differ(*both, samples.wo[usable], wo[usable])


def add_field(evidence: Evidence, field: str, names: Collection[str]) -> None:
    """Add that functions depend on a field differently: properties `names` lack there.

    `evidence` is that of a sweep in which this field alone varies.
    """
    samples = evidence.sweeps[0]
    usual = replace(samples.condition, fields=())
    changed = asked_again(samples, Probe(evidence.bsdf, usual), exact=True)
    for name, both in OF_TWO.items():
        seeing = [one for one in changed if one in both]
        if name not in names or not seeing:
            continue
        how = "both depend differently"
        if len(seeing) == 1:
            blind = both & ~seeing[0]
            how = f"{seeing[0].quoted} depends, and {blind.quoted} does not,"
        point = "mei" if evidence.of_volumes else "si"
        guess = Answers.OF_FIELD(both, how=how, point=point, field=field)
        claim = next(one.shown for one in evidence.questions if one.name == name)
        more = {"size": 1.5, "off": None, "shown": claim}
        evidence.breach(ANSWERS, guess, samples, changed[seeing[0]], **more)
        return


ALBEDO = Claim(albedo, by_sample)


def check_albedo(evidence: Evidence) -> None:
    """Check range of ``eval_diffuse_reflectance``, and its value if Lambertian."""
    samples = evidence.whole[0]
    function, all_flags = Function.EVAL_DIFFUSE_REFLECTANCE, int(evidence.bsdf.flags())
    reported = Probe(evidence.bsdf, samples.condition).of_surface(str(function))
    guess = None
    if improper(reported[None]).any():
        fields = {"what": "value", "value": example(reported[None])}
        guess = Answers.IMPROPER(function, **fields)
    lobes = sum(int(getattr(mi.BSDFFlags, lobe)) for lobe in LOBES)
    usable = samples.usable & samples.reflected
    if all_flags & lobes == int(mi.BSDFFlags.DiffuseReflection) and usable.any():
        _, value, counts = samples.hold(albedo)
        value = value[counts & usable]
        due = np.median(value, axis=0)
        even = np.ptp(value, axis=0).max() < MAX_ALBEDO_OFF * due.max()
        if even and np.abs(reported - due).max() > MAX_ALBEDO_OFF * due.max():
            guess = Answers.OTHER_ALBEDO(function, due=due.max())
    if guess:
        text, how = f"{reported.max():.4g}", {"effect": INTERFACE, "shown": ALBEDO}
        evidence.breach(ANSWERS, guess, samples.condition, found=text, **how)


def improper(value: Numbers) -> Flags:
    """Mask of rows that are negative or not finite, shape ``(n,)``."""
    wrong: Any = ~(unsigned(value.T).T >= 0) | ~np.isfinite(value)
    return wrong.any(axis=tuple(range(1, wrong.ndim)))


def example(improper_rows: Numbers) -> str:
    """The first number of the first row that is negative or not finite."""
    row = np.ravel(unsigned(improper_rows.T).T[0])
    return f"{row[improper(row)][0]:g}"

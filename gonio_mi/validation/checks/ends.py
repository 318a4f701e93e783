"""Finite at the ends: horizon, normal, random numbers, roughness."""

from collections.abc import Generator, Sequence
from itertools import product
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...array_types import Flags, Floats, Numbers
from ...collector.directions import direction
from ...single_precision import BSDF_ROUNDING
from ...specimen.bsdf_trial import PluginFault
from ..arrays import (
    answer_of,
    drawn,
    lit,
    lit_from,
    of_eval,
    rows,
    sphere,
)
from ..conditions import Condition, Given
from ..evidence import BIAS, INTERFACE, SAME, Evidence, Question, answered
from ..judgements import improper as any_improper, same
from ..mistakes import EVAL, PDF, SAMPLE, Claim, Function, Mistake
from ..probe import (
    Probe,
    changed,
    full,
    number_parameters,
    numbers,
    random_numbers,
    spectral,
    vectors,
)
from .answers import OF_SAMPLES, example, improper


def corners(si: Any) -> Any:
    """Interactions of light from the ends, and the ends of random numbers."""
    ends = np.array([0, 0.5, np.nextafter(np.float32(1), np.float32(0))], np.float32)
    u = np.array(np.meshgrid(ends, ends, ends)).reshape(3, -1)
    for theta in np.radians([0, 1e-3, 89.99, 90, 90.01, 120, 179.999, 180]):
        there = type(si)(si)
        wi = np.round([[np.sin(theta)], [0], [np.cos(theta)]], 9)
        there.wi = mi.Vector3f(np.tile(wi, u.shape[1]))
        yield there, mi.Point3f(u)


def at_ends(bsdf: Any, ctx: Any, si: Any, _: Any, what: Any) -> tuple[Any]:
    """Answers are finite and not negative at the ends of angles and numbers."""
    found = []
    for there, u in corners(si):
        bs, _ = drawn(bsdf, ctx, there, u)
        wi, mirror = there.wi, mi.reflect(there.wi)
        for wo in (bs.wo, wi, -wi, mirror, -mirror):
            real = dr.squared_norm(wo) > 0.5
            answer = rows(what(bsdf, ctx, there, wo, u))
            found.append(np.where(real, answer, 0).ravel())
    return (np.concatenate(found),)


def straight(bsdf: Any, ctx: Any, si: Any, u: Any, what: Any) -> tuple[Any]:
    """Answers are finite and not negative where wo is wi, -wi, or the mirror's."""
    there = lit_from(si, sphere(u.y, u.z))
    wi, mirror = there.wi, mi.reflect(there.wi)
    found = [rows(what(bsdf, ctx, there, wo, u)) for wo in (wi, -wi, mirror)]
    return (np.hstack(found),)


def length_at_ends(bsdf: Any, ctx: Any, si: Any, _: Any) -> tuple[Any]:
    """Directions have the length 1 at the ends of angles and numbers."""
    found = []
    for there, u in corners(si):
        bs, weight = drawn(bsdf, ctx, there, u)
        off = np.abs(np.linalg.norm(rows(bs.wo), axis=0) - 1)
        found.append(1e-3 - np.where(lit(weight), off, 0))
    return (np.concatenate(found),)


ENDS = Question(
    "ends",
    __doc__,
    BIAS,
    "all integrators, in single pixels",
    volumes=SAME,
    rank=3,
    shown=Claim(at_ends, any_improper, (of_eval,)),
)


class Ends(Mistake):
    """What is wrong at an end of the domain."""

    RAISES = "{who} {what}, at an end of its domain"
    LENGTH = "{who} gives a direction of another length than 1 at an end"
    IMPROPER = "{who} gives {value} at an end of its domain"
    ALONG = "{who} gives {value} for light exactly along the surface"


# Fraction of an image that single pixels are.
PIXELS = 1e-3

# A cosine that is 0 but for the rounding of a unit vector.
GRAZING = 2.0**-24

# Polar angles of incidence in degrees, and the ends of random numbers in [0, 1).
ANGLES = (0, 1e-3, 89.99, 90, 90.01, 120, 179.999, 180)
LAST = float(np.nextafter(np.float32(1), np.float32(0)))
NUMBERS = (0.0, 0.5, LAST)

# Directions, of which a tenth rounds to more than the length 1.
N_STRAIGHT = 2**11

# Names of parameters that are a roughness, and the limits to try.
LIMITS = dict.fromkeys(("alpha", "alpha_u", "alpha_v", "roughness"), (1e-3, 1.0))


# Incident directions: at all angles, and with a cosine of exactly 0, which none has.
CONDITIONS = [
    *(Condition(theta_i, phi_i) for theta_i, phi_i in product(ANGLES, (0.0, 25.0))),
    Condition(90.0, lit=(1.0, 0.0, 0.0)),
]


def _check_ends(
    evidence: Evidence, where: str = "", conditions: Sequence[Condition] = CONDITIONS
) -> None:
    """Check that all functions are finite and at least 0 at the ends of their domain.

    They are asked for sampled directions, and at the normal, at the horizon, in the
    mirror direction and straight on: of all conditions together, or, where that raises,
    of one after the other.
    """
    probe, wi = Probe(evidence.bsdf, conditions[0]), [one.wi for one in conditions]
    checks = [_check(evidence, one.wi, f"at {one}{where}") for one in conditions]
    asked: Any = [next(check) for check in checks]
    n_before = len(evidence.breaches)
    try:
        for ask in (_samples, _answers):
            lengths = [*map(len, asked)]
            probe.wi = vectors(np.repeat(wi, lengths, axis=0))
            answers = ask(probe, np.concatenate(asked))
            each = zip(*(np.split(x, np.cumsum(lengths)[:-1]) for x in answers))
            asked = [check.send(one) for check, one in zip(checks, each)]
    except PluginFault as fault:
        if len(conditions) > 1:
            del evidence.breaches[n_before:]
            for one in conditions:
                _check_ends(evidence, where, [one])
            return
        guess = Ends.RAISES(Function.named(fault.function), what=fault.what)
        raises = Claim(answered, same, (fault.function,))
        how = {"off": PIXELS, "shown": raises}
        evidence.breach(ENDS, guess, found=f"at {conditions[0]}{where}", **how)


def _samples(probe: Probe, u: Floats) -> tuple[Numbers, ...]:
    """Weights, directions and densities of samples."""
    (bs, weight), n = probe.sample(*random_numbers(u)), len(u)
    return spectral(weight, n), spectral(bs.wo, n), numbers(bs.pdf, n)


def _answers(probe: Probe, wo: Floats) -> tuple[Numbers, ...]:
    """Values and densities towards directions, and both of ``eval_pdf``."""
    (value, pdf), n = probe.eval_pdf(vectors(wo)), len(wo)
    joint = spectral(value, n), numbers(pdf, n).astype(float)
    return probe.values(wo), probe.densities(wo), *joint


@ENDS.asks("parameters")
def check_straight(evidence: Evidence, question: Question = ENDS) -> None:
    """Check directions wo that are wi, straight on, or the mirror's, of many wi.

    By rounding, a product of unit vectors may be more than 1; and there the three
    directions of a plane of incidence are one line.
    """
    wi = np.random.default_rng(0).normal(size=(N_STRAIGHT, 3))
    wi /= np.linalg.norm(wi, axis=1)[:, None]
    middle = np.full((N_STRAIGHT, 2), 0.5)
    probe = Probe(evidence.bsdf, Given(lit_by=wi, at=middle))
    for words, wo in (
        ("wo = wi", wi),
        ("wo = -wi", -wi),
        ("wo in the mirror direction", wi * [-1, -1, 1]),
    ):
        values = full(probe.eval(vectors(wo)), N_STRAIGHT)
        answers = values, probe.densities(wo)
        for function, answer in zip((EVAL, PDF), answers):
            wrong = ~np.isfinite(answer).reshape(N_STRAIGHT, -1).all(axis=1)
            if wrong.any():
                guess = Ends.IMPROPER(function, value=example(answer[wrong]))
                text = f"value {example(answer[wrong])} where {words}, for "
                text += f"{100 * wrong.mean():.3g} % of all incident directions"
                shown = Claim(straight, any_improper, (answer_of(function),))
                how = {"found": text, "off": PIXELS, "size": 2.0, "shown": shown}
                evidence.breach(question, guess, **how)


@ENDS.asks("parameters")
def check_bsdf(evidence: Evidence) -> None:
    """Check the ends, and again at limits of parameters."""
    _check_ends(evidence)
    try:
        _, params = number_parameters(evidence.bsdf)
    except PluginFault:
        return  # a property of its own
    limits = {"g": (-0.999, 0.999)} if evidence.of_volumes else LIMITS
    own = {
        key: limits[last]
        for key, value in params.items()
        if (last := key.removesuffix(".value").split(".")[-1]) in limits
        and isinstance(value, mi.Float)
    }
    for values in zip(*own.values()):
        given = {key: type(params[key])(x) for key, x in zip(own, values)}
        text = ", ".join(f"{key} {x:g}" for key, x in zip(own, values))
        with changed(evidence.bsdf, given):
            _check_ends(evidence, f", {text}")


def _check(
    evidence: Evidence, wi: Floats, place: str
) -> Generator[Numbers | None, tuple[Floats, ...], None]:
    """Check one incident direction; yield what to ask, and get answers."""
    numbers = np.array(list(product(NUMBERS, repeat=3)), dtype=np.float32)
    weight, wo, pdf = yield numbers
    given = (weight != 0).any(axis=1)
    extra = [wi, -wi, wi * [-1, -1, 1], wi * [-1, -1, -1]]
    extra += list(direction(np.radians([0, 89.99, 90, 90.01, 180]), 0.3))
    good = given & np.isfinite(wo).all(axis=1)
    directions = np.concatenate([wo[good], extra])
    along = np.full(len(wo), abs(wi[2]) < GRAZING)
    _check_finite(evidence, SAMPLE, "weight", weight, numbers, place, along)
    found = pdf[given], numbers[given], place, along[given]
    _check_finite(evidence, SAMPLE, "pdf", *found)
    length = np.linalg.norm(wo, axis=1)
    wrong = given & ~(np.abs(length - 1) < BSDF_ROUNDING)
    if (wrong := wrong & ~(along & ~np.isfinite(length))).any():
        text = f"{_text(wo[wrong][0])} {place}, sample {_text(numbers[wrong][0])}"
        shown = Claim(length_at_ends, any_improper)
        how = {"found": f"direction {text}", "shown": shown}
        evidence.breach(ENDS, Ends.LENGTH(SAMPLE), off=PIXELS, **how)
    values, density, *joint = yield directions
    black, densities = (values == 0).all(axis=1), [density, joint[1]]
    along = np.minimum(np.abs(directions[:, 2]), abs(wi[2])) < GRAZING
    if np.isnan([x[black & along] for x in densities]).any():
        # and dark: Mitsuba's own do it
        text = "`pdf` is NaN for light exactly along the surface, where `eval` is black"
        evidence.remark("ends", text)
        dark = black & along
        densities = [np.where(dark & np.isnan(x), 0.0, x) for x in densities]
    for function, value in (
        (EVAL, values),
        (PDF, densities[0]),
        (Function.EVAL_PDF, joint[0]),
        (Function.EVAL_PDF, densities[1]),
    ):
        own = value, directions, place, along, black
        _check_finite(evidence, function, "value", *own)
    yield None


def _check_finite(
    evidence: Evidence,
    function: Function,
    what: Any,
    value: Numbers,
    inputs: Numbers,
    place: str,
    along: Flags,
    black: Flags | None = None,
) -> None:
    """Check values at `inputs`, which are directions or random numbers.

    A negative density does no harm in directions that are `black`. What is not finite
    for light exactly `along` the surface is in no image: a set of measure zero.
    """
    wrong = improper(value)
    lost = along & ~np.isfinite(value if value.ndim == 1 else value.sum(axis=1))
    for part, off in ((wrong & ~lost, PIXELS), (wrong & lost, 0.0)):
        if not part.any():
            continue
        text = example(value[part])
        name = "sample" if black is None else "wo"
        harmless = black is not None and black[part].all()
        harmless = harmless and np.isfinite(value[part]).all()
        guess = (Ends.IMPROPER if off else Ends.ALONG)(function, value=text)
        size, effect = float(part.sum()), INTERFACE if harmless else ""
        how = {"size": size * (1 if off else PIXELS), "effect": effect}
        asked = OF_SAMPLES.get(what) or answer_of(function)
        how["shown"] = Claim(at_ends, any_improper, (asked,))
        text = f"{what} {text} {place}, {name} {_text(inputs[part][0])}"
        evidence.breach(ENDS, guess, found=text, off=off, of_flux=not off, **how)


def _text(values: Floats) -> str:
    return "(" + ", ".join(f"{x:.8g}" for x in values) + ")"

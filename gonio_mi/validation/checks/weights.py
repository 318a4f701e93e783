"""The mean of sampled weights is the integral of `eval`."""

from typing import Any

import numpy as np

from ...array_types import Floats
from ..arrays import of_eval
from ..conditions import Condition
from ..densities import all_around, directions, in_box, total, weights
from ..evidence import BIAS, MAX_P, MINOR, NOISE, SAME, SAMPLED, Evidence, Question
from ..integrals import SUM_ERROR
from ..judgements import apart, most_apart
from ..maps import FourMaps, unexplained_fraction, unexplained_light
from ..mistakes import EVAL, PDF, SAMPLE, Claim, Mistake
from ..probe import Probe
from ..samples import Samples, beyond_rounding
from .answers import lattice

WEIGHTS = Question(
    "weights",
    __doc__,
    BIAS,
    SAMPLED,
    volumes=SAME,
    identity=True,
    needed=True,
    shown=Claim(in_box, apart, (weights,)),
)


class Weights(Mistake):
    """Where light is, and none is sampled or evaluated."""

    DARK = "{who} is 0 where `sample` scatters light"
    DARK_AND_IMPOSSIBLE = "{who} and `pdf` are 0 where `sample` scatters light"
    ALL_FAIL = "{who} always fails where `pdf` integrates to {mass:.3g}"
    DARK_SIDE = """{who} scatters light from a side that `flags` does not declare, and
        `sample` none"""
    NOT_SAMPLED = "`eval` sends {part:.3g} of its light where `pdf` is 0"
    SIDE_NOT_SAMPLED = """`eval` sends {part:.3g} of its light to a side where `pdf` is
        0 and `sample` never goes"""


# Density that no sample ever meets: where `pdf` falls below it before it is 0 (as that
# of Mitsuba's facets does), the light of `eval` is a matter of tails, not of a hole.
UNDERFLOW = 1e-12

# Mass of a density that a few thousand samples do not miss.
MIN_MASS = 0.01

# Fraction of the light that must be judged for a verdict on weights.
MIN_JUDGED = 0.9


def check_scores(evidence: Evidence, maps: FourMaps, question: Question) -> None:
    """Test the scores of all patches: their sum, mean, spread and worst."""
    scores, texts = maps.scores(question.name), maps.scores(question.name).statistics
    off, _ = unexplained_fraction(maps, question.name)
    if off * abs(maps.condition.wi[2]) < MINOR:
        off = max(off, unexplained_light(maps, question.name, MAX_P))
    for view, p in scores.p_values.items():
        how = {"off": off, "of_flux": True}
        evidence.test(question, p, texts[view], maps.condition, **how)


@WEIGHTS.asks("samples")
def check_samples(evidence: Evidence, samples: Samples) -> None:
    """Check that ``eval`` and ``pdf`` are not 0 where ``sample`` scatters light."""
    usable = samples.usable
    dark = usable & (samples.eval == 0).all(axis=1)
    # by chance, where it is another one at each call: then means are compared
    if beyond_rounding(dark) and not evidence.noisy:
        both = beyond_rounding(dark & (samples.pdf == 0))
        part = f"{100 * dark.sum() / usable.sum():.3g} % of the samples with light"
        guess = (Weights.DARK_AND_IMPOSSIBLE if both else Weights.DARK)(EVAL)
        text, size = f"{part} at {samples.condition}", 1 + float(dark.mean())
        evidence.breach(WEIGHTS, guess, samples, dark, statistic=text, size=size)


def check_unsampled_side(evidence: Evidence, condition: Condition) -> bool:
    """Check and return whether ``eval`` is black from a side that is never sampled."""
    value = np.nan_to_num(Probe(evidence.bsdf, condition).values(lattice()), nan=0)
    light = 4 * np.pi * float(value.mean(axis=0).max())
    if light > 0:
        how: dict[str, Any] = {"size": light, "off": min(light, 1.0)}
        how["shown"] = Claim(total, apart, (of_eval, 0))
        how["found"] = f"{light:.3g} of the light"
        evidence.breach(WEIGHTS, Weights.DARK_SIDE(EVAL), condition, **how)
    return light == 0


def check_unsampled(
    evidence: Evidence, samples: Samples, values: Floats, densities: Floats
) -> None:
    """Check that some samples do not fail where much of ``pdf`` is illuminated.

    `values` and `densities` are answers on the lattice of directions.
    """
    lit = np.nan_to_num(values).max(axis=1) > 0
    mass = 4 * np.pi * float(np.mean(np.nan_to_num(densities) * lit))
    if samples.given.any() or mass < MIN_MASS or evidence.noisy:
        return
    guess, at = Weights.ALL_FAIL(SAMPLE, mass=mass), samples.condition
    found = f"no direction from {samples.n} random numbers"
    shown = Claim(all_around, most_apart, (directions,))
    how = {"found": found, "size": 1.0, "off": 1.0, "shown": shown}
    evidence.breach(WEIGHTS, guess, at, **how)


@WEIGHTS.asks("maps")
def check_maps(evidence: Evidence, maps: FourMaps) -> None:
    """Test sums of weights, and check that samples reach all light of ``eval``.

    Light that samples meet too rarely to judge is reported.
    """
    check_scores(evidence, maps, WEIGHTS)
    due, flux = maps.due, maps.smooth_flux.mean()
    lost = due.unreached.values.sum()
    # on a side where samples never go
    sides = due.unreached.values.reshape(2, -1).sum(axis=1)
    beyond = sides[maps.totals.counts.reshape(2, -1).sum(axis=1) == 0].sum()
    mistake, function = Weights.NOT_SAMPLED, PDF
    if beyond > lost / 2:
        mistake, function = Weights.SIDE_NOT_SAMPLED, EVAL
    bound = max(due.unreached.sum_bound, SUM_ERROR * max(flux, 1))
    if lost > bound and due.least > UNDERFLOW:
        part = lost / flux
        how = {"size": lost, "off": min(part, 1.0), "of_flux": True}
        guess, text = mistake(function, part=part), f"{part:.3g} of the light"
        evidence.breach(WEIGHTS, guess, maps.condition, found=text, **how)
    elif maps.judged < MIN_JUDGED:
        evidence.downgraded["weights"] = NOISE
        evidence.undecided["weights"] = (
            f"tails are too heavy: {1 - maps.judged:.2g} of the light at "
            f"{maps.condition} is in weights that {maps.totals.n} samples meet too "
            "rarely, importance sampling closer to `eval` would remove it"
        )

"""From failed properties to the one function that explains them, and its mistake.

The table is read once, from above: the first row that fails and has an explanation
names the function. Where two answers about the same samples differ, the factor between
them tells the mistake (:mod:`.ratios`); where counts and ``pdf`` differ, these do
(:mod:`.counts`).
"""

from collections.abc import Mapping

import mitsuba as mi
import numpy as np

from ...array_types import Floats
from ..checks.answers import Answers, asked_again
from ..checks.components import alone, are_apart
from ..checks.weights import Weights
from ..evidence import EFFECTS, INTERFACE, MODEL, NOISE, Evidence, Question
from ..mistakes import EVAL, PDF, SAMPLE, Guess, Mistake
from ..probe import Probe
from ..samples import beyond_rounding, unequal
from .counts import as_turned, guess_of_counts
from .ratios import OF_PDF, OF_SAMPLED_PDF, explain, explain_weights, ratios_of

# Fraction of the share of the largest failure below which another is no symptom of it,
# but a smaller one beside it, and explains nothing.
MAX_MINOR = 0.2


class Diagnosis(Mistake):
    """Mistakes diagnosed from all failures together."""

    ANY = "`sample` or `eval` is wrong"
    NOT_DIVIDED_BY_CHANCE = """{who} weight lacks division by the probability with which
        a direction is not rejected"""
    SLIGHTLY = """{who}: one of their densities is wrong by {off:.2g} on average, less
        than counts of directions tell at this effort"""
    OTHER_MEAN = "{who}: the mean weight is not the integral of `eval`"
    ONE_COMPONENT = "{who} is that of component {component} alone"
    PLAIN_SUM = "{who} is the sum of its components', without the probability of each"


# Sum of squared scores that counts of directions may hide.
MAX_UNSEEN = 100

# What is left where nothing explains a failure.
ANY = Diagnosis.ANY(SAMPLE)


def likely_mistake(
    evidence: Evidence, failed: Mapping[str, str], shares: Mapping[str, float | None]
) -> Guess:
    """Likely guilty function and mistake.

    Parameters
    ----------
    evidence : Evidence
    failed, shares : dict
        Effect by name of property, and share of the light that it is about.
    """
    worst = min(failed.values(), key=EFFECTS.index)
    # what is of the interface explains nothing else
    failed = {n: x for n, x in failed.items() if not x == INTERFACE != worst}
    if not mi.is_polarized:
        own = {name: shares[name] for name in failed if failed[name] == worst}
        largest = max((x for x in own.values() if x is not None), default=0.0)
        minor = {n for n, x in own.items() if x is not None and x < MAX_MINOR * largest}
        wrong_mean = "weights" in failed and "sampled_weight" not in failed
        if wrong_mean or "sampled_pdf" in failed:
            # only counts explain a wrong mean, and tell which of two densities is right
            minor.discard("sampling")
        failed = {name: effect for name, effect in failed.items() if name not in minor}

    def rank(one: Question) -> tuple[bool, int, int]:
        """What explains others first, but for a law that a model may choose."""
        chosen = worst == MODEL and one.name == "delta"
        return chosen, one.rank, EFFECTS.index(failed[one.name])

    questions = [one for one in evidence.questions if one.name in failed]
    if not mi.is_polarized:
        questions = [one for one in questions if failed[one.name] == worst]
    for question in sorted(questions, key=rank):
        if question.identity:
            return next(filter(None, (guess(evidence, failed) for guess in ODD)))
        if question.explain is not None:
            guess = question.explain(evidence)
        else:
            guess = evidence.guess(question.name) or evidence.suspect(question.name)
        if guess is not None:
            return guess
    return ANY


# ------------------------------------------------ what contradicts the other functions


def _noise(evidence: Evidence, failed: Mapping[str, str]) -> Guess | None:
    """Weights that make up for directions rejected at random, or should."""
    if failed.get("sampled_weight") != NOISE:
        return None
    if "weights" in failed:
        return Diagnosis.NOT_DIVIDED_BY_CHANCE(SAMPLE)
    noisy = [b for b in evidence.of("sampled_weight") if b.effect == NOISE]
    return noisy[0].guess


def _zero_where_lit(evidence: Evidence, failed: Mapping[str, str]) -> Guess | None:
    """One of them is 0 where another is not, unless directions are elsewhere."""
    if "weights" not in failed:
        return None
    guess = evidence.guess("weights")
    if guess and guess.mistake is Weights.DARK_AND_IMPOSSIBLE:
        return as_turned(evidence) or guess
    return guess


def _density_without_light(
    evidence: Evidence, failed: Mapping[str, str]
) -> Guess | None:
    """A density where no light is."""
    harmless = failed.get("sampling") == INTERFACE
    return evidence.guess("sampling") if harmless else None


def _without_counts(evidence: Evidence, failed: Mapping[str, str]) -> Guess | None:
    """Where directions are drawn with the density of ``pdf``, as far as is known."""
    if "sampling" in failed:
        return None
    if "sampled_pdf" in failed:
        guess = explain(ratios_of(evidence, OF_SAMPLED_PDF), OF_SAMPLED_PDF)
        off = _difference(evidence)
        n = max((maps.totals.n for maps in evidence.maps), default=0)
        if _density(evidence, failed) and n * off**2 < MAX_UNSEEN:
            guess = Diagnosis.SLIGHTLY(SAMPLE | PDF, off=off)
        return guess
    if "weights" in failed and not evidence.of("sampled_weight"):
        return _changed(evidence) or Diagnosis.OTHER_MEAN(EVAL | SAMPLE)
    return explain_weights(evidence)


def _difference(evidence: Evidence) -> float:
    """Root mean square of the pdf of ``sample`` over that of ``pdf``, less 1."""
    each = []
    for samples in (*evidence.whole, *evidence.sweeps):
        own = samples.usable & (samples.pdf > 0)
        ratio = samples.sampled_pdf[own] / samples.pdf[own]
        each.append(np.mean((ratio - 1) ** 2) if own.any() else 0.0)
    return float(max(each, default=0.0)) ** 0.5


def _changed(evidence: Evidence) -> Guess | None:
    """What answers otherwise than where weights and ``eval`` still agreed."""
    first = evidence.whole[0]
    probe = Probe(evidence.bsdf, first.condition)
    return next(map(Answers.OF_CALLS, asked_again(first, probe, exact=True)), None)


def _density(evidence: Evidence, failed: Mapping[str, str]) -> Guess | None:
    """A factor of ``pdf``, where `sample` returns another one and weights are right.

    Unless these are `eval` over ``pdf``: then what `sample` returns is wrong.
    """
    known = "sampled_weight" in failed or "weights" in failed
    if known or not evidence.of("sampled_pdf"):
        return None
    ratios = ratios_of(evidence, OF_PDF)
    for one in ratios:
        own = one.samples
        off = unequal(own.flux, own.eval, own.eval_slack)
        if beyond_rounding(off & one.wrong):
            return explain(ratios_of(evidence, OF_SAMPLED_PDF), OF_SAMPLED_PDF)
    return explain(ratios, OF_PDF)


def _counts(evidence: Evidence, failed: Mapping[str, str]) -> Guess:
    """Directions against ``pdf``."""
    # a weight that is `eval` over a wrong `pdf` is wrong, too
    by_pdf = not (evidence.of("sampled_weight") or evidence.of("sampled_pdf"))
    return guess_of_counts(evidence, by_pdf or "weights" in failed) or ANY


def _wrong_mixture(evidence: Evidence, _: Mapping[str, str]) -> Guess | None:
    """How ``pdf`` combines its components wrongly; None if it is their mixture."""
    samples = evidence.whole[0]
    if evidence.bsdf.component_count() < 2 or not samples.smooth.any():
        return None
    each = alone(evidence, samples)

    def is_it(density: Floats) -> bool:
        differs = unequal(density, samples.pdf, samples.pdf_slack) & samples.smooth
        return not beyond_rounding(differs)

    if not are_apart(evidence.bsdf, samples, each) or each.pdf.any(axis=1).sum() < 2:
        return None  # no component can be asked alone, or one is all
    own = [i for i, density in enumerate(each.pdf) if is_it(density)]
    if len(own) == 1:
        return Diagnosis.ONE_COMPONENT(PDF, component=own[0])
    whole = not own and is_it(each.pdf.sum(axis=0))
    return Diagnosis.PLAIN_SUM(PDF) if whole else None


# What is asked in turn; the first that knows tells.
ODD = (
    _noise,
    _zero_where_lit,
    _density_without_light,
    _without_counts,
    _wrong_mixture,
    _density,
    _counts,
)

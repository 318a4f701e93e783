"""From failed properties to the one function that explains them, and its mistake.

`HYPOTHESES` is what is asked in turn; the first that knows tells.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

import mitsuba as mi

from ..evidence import BIAS, EFFECTS, INTERFACE, MODEL, Evidence, Question
from ..mistakes import EVAL, SAMPLE, Guess
from . import cosines, counts, densities, light
from .case import Case, Diagnosis

Hypothesis = Callable[[Case], Guess | None]


class Asked(NamedTuple):
    """Hypotheses about a failed property, and whether a case is one that they explain.

    Each returns a guess, or None where it does not know.
    """

    about: str
    when: Callable[[Case], bool]
    hypotheses: tuple[Hypothesis, ...]


def asked(about: str, when: Callable[[Case], bool], *hypotheses: Hypothesis) -> Asked:
    """A row of `HYPOTHESES`."""
    return Asked(about, when, hypotheses)


def plainly(guess: Guess) -> Hypothesis:
    """What is known as soon as it is asked."""
    return lambda _: guess


def worst(name: str) -> Hypothesis:
    """What the worst breach of a property tells."""
    return lambda case: case.evidence.guess(name)


def of_only_component(*hypotheses: Hypothesis) -> Hypothesis:
    """Hypotheses about the only component whose counts are wrong."""

    def tells(case: Case) -> Guess | None:
        one = case.only_component
        return first_told(one, hypotheses) if one else None

    return tells


def first_told(case: Case, hypotheses: Iterable[Hypothesis]) -> Guess | None:
    """Guess of the first hypothesis that knows; None if none does."""
    return next(filter(None, (tells(case) for tells in hypotheses)), None)


# Guesses that nothing but the case tells.
ANY = Diagnosis.ANY(SAMPLE)
NOT_DIVIDED = Diagnosis.NOT_DIVIDED_BY_CHANCE(SAMPLE)
OTHER_MEAN = Diagnosis.OTHER_MEAN(EVAL | SAMPLE)

# Properties that compare two functions: which is wrong, all of these tell together.
TWO = "two functions"

# Of counts, of all components together and of one alone.
MASSES = (
    counts.side_left_out,
    counts.distorted,
    counts.without_direction,
    counts.unnormalised,
)
ALONE = counts.other_than_alone, counts.other_probability

HYPOTHESES = (
    # a wrong cosine, of all of `eval` or of a part
    asked("reciprocity", Case.is_asymmetric_often, cosines.of_the_whole),
    asked("reciprocity", Case.components_tell, cosines.of_a_component),
    asked("reciprocity", Case.is_asymmetric, cosines.of_a_parameter),
    asked("reciprocity", Case.is_asymmetric, cosines.at_the_horizon),
    asked("reciprocity", Case.is_asymmetric_as_one, cosines.of_a_lobe),
    # light that comes from nowhere
    asked("energy", Case.always, light.of_discrete_lobe, light.gained),
    # what joint functions share
    asked("eval_pdf_sample", Case.always, worst("eval_pdf")),
    # directions that are rejected at random
    asked(TWO, Case.is_noisy_and_wrong, plainly(NOT_DIVIDED)),
    asked(TWO, Case.is_noisy, light.rejected_by_chance),
    # one is 0 where another is not
    asked(TWO, Case.is_dark, counts.turned),
    asked(TWO, Case.mean_is_wrong, worst("weights")),
    asked(TWO, Case.density_is_unlit, worst("sampling")),
    # directions are those of `pdf`, as far as is known
    asked(TWO, Case.densities_differ, densities.slightly_off, densities.of_sample),
    asked(TWO, Case.mean_alone_is_wrong, light.changed_answers, plainly(OTHER_MEAN)),
    asked(TWO, Case.single_components_differ, light.of_a_component),
    asked(
        TWO,
        Case.directions_hold,
        light.other_sums,
        light.exchanged_colours,
        light.of_lobe_alone,
        light.whoever_gains,
    ),
    asked(TWO, Case.reciprocity_tells, light.whoever_is_asymmetric),
    asked(TWO, Case.directions_hold, light.of_either),
    # directions are not those of `pdf`
    asked(TWO, Case.densities_may_mix, densities.wrong_mixture),
    asked(TWO, Case.other_density_is_returned, densities.of_sample_alone),
    asked(TWO, Case.other_density_is_returned, densities.of_pdf),
    asked(TWO, Case.chance_explains_maps, counts.suspect),
    asked(TWO, Case.is_not_counted, plainly(ANY)),
    asked(TWO, Case.always, counts.turned, *MASSES),
    asked(TWO, Case.weights_are_right, counts.not_of_sample),
    asked(TWO, Case.always, counts.rejected),
    asked(TWO, Case.always, of_only_component(*MASSES, counts.rejected, *ALONE)),
    asked(TWO, Case.always, *ALONE),
)


def told(case: Case, about: str) -> Guess | None:
    """What the first of all hypotheses about a property that knows tells."""
    rows = (row for row in HYPOTHESES if row.about == about)
    guesses = (first_told(case, row.hypotheses) for row in rows if row.when(case))
    return next(filter(None, guesses), None)


# Fraction of the share of the largest failure below which another is no symptom of it,
# but a smaller one beside it, and explains nothing.
MAX_MINOR = 0.2


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
        failed = _symptoms(failed, shares, worst)
    case = Case(evidence, failed)

    def rank(one: Question) -> tuple[bool, int, int]:
        """What explains others first, but for a law that a model may choose."""
        chosen = worst == MODEL and one.name == "delta"
        return chosen, one.rank, EFFECTS.index(failed[one.name])

    questions = [one for one in evidence.questions if one.name in failed]
    if not mi.is_polarized:
        questions = [one for one in questions if failed[one.name] == worst]
    for one in sorted(questions, key=rank):
        guess = None
        if not mi.is_polarized:
            guess = told(case, TWO if one.identity else one.name)
        guess = guess or evidence.guess(one.name) or evidence.suspect(one.name)
        if guess is not None:
            return guess
    return ANY


def _symptoms(
    failed: Mapping[str, str], shares: Mapping[str, float | None], worst: str
) -> dict[str, str]:
    """What fails but for smaller failures beside the largest one."""
    own = {name: shares[name] for name in failed if failed[name] == worst}
    largest = max((x for x in own.values() if x is not None), default=0.0)
    minor = {n for n, x in own.items() if x is not None and x < MAX_MINOR * largest}
    wrong_mean = "weights" in failed and "sampled_weight" not in failed
    if wrong_mean or "sampled_pdf" in failed:
        # only counts explain a wrong mean, and tell which of two densities is right
        minor.discard("sampling")
    return {name: effect for name, effect in failed.items() if name not in minor}


def explain_reciprocity(evidence: Evidence) -> None:
    """Explain a lack of reciprocity by a power of the cosines, if one does.

    If it does for all samples from all directions, within rounding, it is a mistake in
    ``eval`` and no law of a model: of the whole, of a component that is asked alone, or
    of the part of ``eval`` that a parameter changes. Where a lobe cannot be asked
    alone, it is so if all is a sum, nowhere negative, of a right lobe and a wrong one,
    which stays lit as wo falls to the horizon. One that means it so (Phong's, of 1975,
    has no cosine) can declare NonSymmetric.
    """
    case = Case(evidence)
    found = [b for b in evidence.of("reciprocity") if b.guess.functions is EVAL]
    guess = told(case, "reciprocity") if found else None
    if guess is None:
        return
    if guess.mistake is cosines.Cosine.OF_A_LOBE:
        evidence.change(case.asymmetries, guess=guess)
        return
    worst = max(case.asymmetries or found, key=lambda one: one.size)
    # a part of it may be seen at one direction
    for one in [worst] if guess.fields["part"] else case.asymmetries:
        evidence.change([one], effect=BIAS, guess=guess, size=1 + one.size)

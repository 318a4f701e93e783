"""From failed properties to the one function that explains them, and its mistake.

`HYPOTHESES` is what is asked in turn; the first that knows tells.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import mitsuba as mi

from ..evidence import BIAS, EFFECTS, INTERFACE, MODEL, NOISE, Evidence, Question
from ..mistakes import EVAL, PDF, SAMPLE, Function, Guess
from . import answers, cosines, counts
from .case import Case, Diagnosis
from .ratios import Factor

# Whether hypotheses apply to a case, and what one of them guesses; None where it does
# not know.
Condition = Callable[[Case], bool]
Hypothesis = Callable[[Case], Guess | None]

# Fraction of the share of the largest failure below which another is no symptom of it,
# but a smaller one beside it, and explains nothing.
MAX_MINOR = 0.2


def fails(name: str, *effects: str) -> Condition:
    """A property fails, with one of these effects if some are given."""
    return lambda case: case.failed.get(name) in (effects or EFFECTS)


def holds(name: str) -> Condition:
    """A property holds, or does not matter beside what fails."""
    return lambda case: name not in case.failed


def differs(name: str) -> Condition:
    """Something was found that contradicts a property, whether that matters or not."""
    return lambda case: bool(case.evidence.of(name))


def agrees(name: str) -> Condition:
    """Nothing was."""
    return lambda case: not case.evidence.of(name)


def known(guess: Guess) -> Hypothesis:
    """What is so as soon as it is asked."""
    return lambda _: guess


def worst(name: str) -> Hypothesis:
    """What the worst breach of a property tells."""
    return lambda case: case.evidence.guess(name)


def suspect(name: str) -> Hypothesis:
    """What the worst test of a property tells."""
    return lambda case: case.evidence.suspect(name)


def light_of(functions: Function) -> Hypothesis:
    """Guess about one or both from the ratio of weight times pdf to ``eval``."""
    return lambda case: case.light.blame(functions)


def density_of(function: Function) -> Hypothesis:
    """Guess about one of them from the ratio of the pdf of `sample` to ``pdf``."""
    return lambda case: case.densities.blame(function)


def of_only_component(case: Case) -> Guess | None:
    """What is asked `OF_ONE`, of the only component whose counts are wrong."""
    one = case.only_component
    return told(one, OF_ONE) if one else None


# Guesses that a case alone tells.
ANY = Diagnosis.ANY(SAMPLE)
NOT_DIVIDED = Diagnosis.NOT_DIVIDED_BY_CHANCE(SAMPLE)
OTHER_MEAN = Diagnosis.OTHER_MEAN(EVAL | SAMPLE)
OTHER_SUMS = Factor.OTHER_SUMS(SAMPLE)

# Subjects beside the names of properties: what compares two functions, of which all
# tell together; one component of several; and an ``eval`` that is not reciprocal, of
# which it is asked what it is before it is known to fail.
TWO, OF_ONE, ASYMMETRY = "two functions", "one component", "asymmetry"

# Weights are right, and `sample` returns another density than ``pdf``.
OTHER_PDF = holds("weights"), holds("sampled_weight"), differs("sampled_pdf")

# Directions are those of ``pdf``, as far as is known: `sample` returns another one, or
# the mean of the weights alone is wrong.
OTHER_THAN_SAYS = holds("sampling"), fails("sampled_pdf")
MEAN_ALONE = holds("sampling"), fails("weights"), agrees("sampled_weight")

# What the counts of all components, or of one alone, are asked for.
MASSES = (
    *(counts.side_left_out, counts.distorted),
    *(counts.without_direction, counts.unnormalised),
)
LOBES = counts.other_than_alone, counts.other_probability

# About which property, when, and what is asked in turn.
HYPOTHESES: Sequence[tuple[str, Sequence[Condition], Sequence[Hypothesis]]] = (
    # a wrong cosine, of all of `eval` or of a part
    (ASYMMETRY, [Case.is_often_asymmetric], [cosines.of_the_whole]),
    (ASYMMETRY, [Case.components_tell], [cosines.of_a_component]),
    (ASYMMETRY, [Case.is_asymmetric], [cosines.of_a_parameter]),
    (ASYMMETRY, [Case.is_asymmetric], [cosines.at_the_horizon]),
    (ASYMMETRY, [Case.is_asymmetric_as_one], [cosines.of_a_lobe]),
    # light that comes from nowhere
    ("energy", [], [answers.discrete_lobe, answers.gained_light]),
    # joint functions are wrong alike
    ("eval_pdf_sample", [], [worst("eval_pdf")]),
    # directions are rejected at random
    (TWO, [fails("sampled_weight", NOISE), fails("weights")], [known(NOT_DIVIDED)]),
    (TWO, [fails("sampled_weight", NOISE)], [worst("sampled_weight")]),
    # one function is 0 where another is not
    (TWO, [fails("weights"), Case.is_dark], [counts.turned]),
    (TWO, [fails("weights")], [worst("weights")]),
    (TWO, [fails("sampling", INTERFACE)], [worst("sampling")]),
    # the pdf that `sample` returns, which counts of directions would tell if they could
    (TWO, [*OTHER_THAN_SAYS, *OTHER_PDF], [answers.slightly_off]),
    (TWO, OTHER_THAN_SAYS, [density_of(SAMPLE)]),
    # each weight is `eval` over `pdf`, and their mean is wrong
    (TWO, MEAN_ALONE, [answers.changed_answers, known(OTHER_MEAN)]),
    # weights are not `eval` over `pdf`, of which one may be wrong
    (TWO, [holds("sampling"), Case.components_differ], [worst("components")]),
    (TWO, [holds("sampling"), Case.components_differ], [worst("sampled_weight")]),
    (TWO, [holds("sampling"), Case.has_no_light], [known(OTHER_SUMS)]),
    (TWO, [holds("sampling")], [answers.exchanged_colours, answers.lobe_alone]),
    (TWO, [holds("sampling")], [answers.whoever_gains]),
    (TWO, [holds("sampling"), Case.is_symmetric], [answers.whoever_is_asymmetric]),
    (TWO, [holds("sampling")], [light_of(EVAL | SAMPLE)]),
    # directions are not those of `pdf`, which is another than that of `sample`
    (TWO, [Case.has_several_components], [answers.wrong_mixture]),
    (TWO, OTHER_PDF, [answers.returned_pdf, density_of(PDF)]),
    # directions are not those of `pdf`
    (TWO, [Case.chance_explains_counts], [suspect("sampling")]),
    (TWO, [Case.is_not_counted], [known(ANY)]),
    (TWO, [], [counts.turned, *MASSES]),
    (TWO, [Case.weights_are_right], [counts.not_of_sample]),
    (TWO, [], [counts.rejected]),
    (TWO, [], [of_only_component, *LOBES]),
    (OF_ONE, [], [*MASSES, counts.rejected, *LOBES]),
)


def told(case: Case, about: str) -> Guess | None:
    """Guess of the first hypothesis about a property that knows; None if none does."""
    for name, conditions, hypotheses in HYPOTHESES:
        if name == about and all(applies(case) for applies in conditions):
            for tells in hypotheses:
                if guess := tells(case):
                    return guess
    return None


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
    questions = evidence.questions
    if not mi.is_polarized:
        own = {name: shares[name] for name in failed if failed[name] == worst}
        largest = max((x for x in own.values() if x is not None), default=0.0)
        minor = {n for n, x in own.items() if x is not None and x < MAX_MINOR * largest}
        wrong_mean = "weights" in failed and "sampled_weight" not in failed
        if wrong_mean or "sampled_pdf" in failed:
            # only counts explain a wrong mean, and tell which of two densities is right
            minor.discard("sampling")
        failed = {name: effect for name, effect in failed.items() if name not in minor}
        questions = [one for one in questions if failed.get(one.name) == worst]
    case = Case(evidence, failed)

    def rank(one: Question) -> tuple[bool, int, int]:
        """What explains others first, but for a law that a model may choose."""
        chosen = worst == MODEL and one.name == "delta"
        return chosen, one.rank, EFFECTS.index(failed[one.name])

    for one in sorted((one for one in questions if one.name in failed), key=rank):
        about = TWO if one.identity else one.name
        guess = None if mi.is_polarized else told(case, about)
        guess = guess or evidence.guess(one.name) or evidence.suspect(one.name)
        if guess is not None:
            return guess
    return ANY


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
    guess = told(case, ASYMMETRY) if found else None
    if guess is None:
        return
    if guess.mistake is cosines.Cosine.OF_A_LOBE:
        evidence.change(case.asymmetries, guess=guess)
        return
    worst = max(case.asymmetries or found, key=lambda one: one.size)
    # a part of it may be seen at one direction
    for one in [worst] if guess.fields["part"] else case.asymmetries:
        evidence.change([one], effect=BIAS, guess=guess, size=1 + one.size)

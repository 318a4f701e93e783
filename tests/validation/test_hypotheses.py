"""The list of hypotheses on who is guilty: complete, and asked in its order."""

import inspect

import pytest

from gonio_mi.validation.evidence import BIAS, NOISE, Evidence
from gonio_mi.validation.guilt import answers, cosines, counts, hypotheses
from gonio_mi.validation.guilt.case import Case, Diagnosis
from gonio_mi.validation.guilt.hypotheses import HYPOTHESES, fails, holds, known, told
from gonio_mi.validation.mistakes import EVAL, PDF, SAMPLE
from gonio_mi.validation.questions import PROPERTIES

SUBJECTS = {hypotheses.TWO, hypotheses.OF_ONE, hypotheses.ASYMMETRY}


def public(module):
    """Functions of a module that take a case."""
    for name, one in inspect.getmembers(module, inspect.isfunction):
        if one.__module__ == module.__name__ and not name.startswith("_"):
            yield one


def named(one):
    """Name of the property that a condition or a hypothesis is made of, if any."""
    return inspect.getclosurevars(one).nonlocals.get("name")


@pytest.mark.parametrize("module", [answers, cosines, counts])
def test_every_hypothesis_is_asked(module):
    asked = {one for _, _, each in HYPOTHESES for one in each}
    assert {*public(module)} <= asked


def test_every_row_is_about_what_a_verdict_prints():
    """What is misspelt would never be asked."""
    for about, conditions, each in HYPOTHESES:
        assert about in PROPERTIES or about in SUBJECTS
        own = {named(one) for one in (*conditions, *each) if named(one)}
        assert own <= {*PROPERTIES}


def test_the_first_that_knows_tells(monkeypatch):
    guesses = [Diagnosis.OTHER_MEAN(one) for one in (EVAL, PDF, SAMPLE)]
    first, second, third = map(known, guesses)
    rows = (
        ("energy", [], [third]),
        ("weights", [holds("weights")], [third]),
        ("weights", [fails("weights", NOISE)], [third]),
        ("weights", [fails("weights"), holds("sampling")], [lambda _: None, first]),
        ("weights", [], [second]),
    )
    monkeypatch.setattr(hypotheses, "HYPOTHESES", rows)
    for failed, due in (
        ({"weights": BIAS}, guesses[0]),
        ({"weights": BIAS, "sampling": BIAS}, guesses[1]),
        ({"weights": NOISE}, guesses[2]),
        ({}, guesses[2]),
    ):
        assert told(Case(Evidence(), failed), "weights") is due
    assert told(Case(Evidence(), {}), "answers") is None

"""Verdicts hang on codes, not on sentences: all of these may be changed."""

from dataclasses import replace

import broken_bsdfs
import broken_phase_functions
import polarised_bsdfs
import pytest
import short_bsdfs
from broken_bsdfs import judged

from gonio_mi.validation import examination, questions, validate
from gonio_mi.validation.guilt import hypotheses
from gonio_mi.validation.mistakes import Mistake

# A right one, and broken ones told by breaches, ratios, counts, cosines, modes, flags,
# parameters, remarks, and by what raises.
SURFACES = (
    *("mixture", "weight_with_cosine", "pdf_half_a_percent_off"),
    *("value_without_cosine", "eval_ignores_component", "radiance_without_eta2"),
    *("discrete_pdf_not_probability", "flags_isotropic", "pdf_raises", "roulette"),
    *("lobe_by_place", "stale_pdf"),
)
VOLUMES = ("right_lobe", "draws_another_g")
MATRICES = ("facets", "not_turned", "sample_depolarises", "polarizer_twice_as_bright")


@pytest.fixture
def plugins(mono):
    # the last one has a name that two have
    for module in (broken_phase_functions, short_bsdfs, broken_bsdfs):
        module.register()
    return mono


def all_mistakes(kind=Mistake):
    """All of all modules."""
    yield from kind
    for one in kind.__subclasses__():
        yield from all_mistakes(one)


def change_sentences(monkeypatch):
    """Replace every sentence of a mistake, and every question, by its code."""
    for one in all_mistakes():
        monkeypatch.setattr(one, "sentence", f"{type(one).__name__} {one.name}")
    for name in ("OF_SURFACES", "OF_MATRICES", "OF_VOLUMES"):
        own = getattr(questions, name)
        others = tuple(replace(one, text=one.name.upper()) for one in own)
        monkeypatch.setattr(examination, name, others)


def said(verdict):
    """What a verdict says, but for its sentences, and the sentences."""
    told = [verdict.guess, *(one.guess for one in verdict.properties)]
    codes = [guess and (guess.functions, guess.mistake) for guess in told]
    facts = [(one.status, one.effect, one.function) for one in verdict.properties]
    order = [one.name for one in verdict.failures]
    return (verdict.function, codes, facts, order), str(verdict)


def judged_now(name):
    return validate({"type": name}, effort="quick")


def check_alike(verdict, name, monkeypatch, alike=True):
    """Judge a plugin again after all sentences are changed."""
    before, text = said(verdict)
    change_sentences(monkeypatch)
    after, changed = said(judged_now(name))
    assert (before == after) == alike
    assert text != changed


@pytest.mark.usefixtures("plugins")
@pytest.mark.parametrize("name", [*SURFACES, *VOLUMES])
def test_sentences_decide_nothing(name, monkeypatch):
    check_alike(judged(name, "quick"), name, monkeypatch)


@pytest.mark.parametrize("name", MATRICES)
def test_sentences_of_matrices_decide_nothing(name, polarised, monkeypatch):
    del polarised
    polarised_bsdfs.register()
    check_alike(judged_now(name), name, monkeypatch)


@pytest.mark.usefixtures("plugins")
def test_twin_a_guess_by_words_is_seen(monkeypatch):
    def of_words(case):
        guesses = (one.guess for one in case.evidence.breaches)
        return next((one for one in guesses if "weight" in str(one)), None)

    first = hypotheses.TWO, (), (of_words,)
    rows = (first, *hypotheses.HYPOTHESES)
    monkeypatch.setattr(hypotheses, "HYPOTHESES", rows)
    name = "weight_with_cosine"
    check_alike(judged_now(name), name, monkeypatch, alike=False)


def test_every_sentence_has_a_code_of_its_own():
    """Two mistakes of one sentence would be one."""
    for kind in Mistake.__subclasses__():
        assert len(kind) == len(kind.__members__)

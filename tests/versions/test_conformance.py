"""The conformance table: what is asked, what is red, and the page."""

import sys

import pytest
from reproduced import code_of

from gonio_mi.versions import conformance
from gonio_mi.versions.conformance import ask_versions, questions, save_table

pytestmark = pytest.mark.usefixtures("mono")


@pytest.fixture
def few(monkeypatch):
    """One right plugin, and one of whose defects the handbook has a script."""
    glass = {"type": "roughdielectric", "alpha": 0.3, "distribution": "ggx"}
    ones = [{"type": "diffuse"}, glass | {"sample_visible": False}]
    monkeypatch.setattr(conformance, "bsdfs", lambda: iter([ones]))
    flakes = [
        one
        for some in conformance.phase_functions()
        for one in some[::2]
        if one["type"] == "sggx"
    ]
    lobe = [{"type": "hg", "g": 0.5}, *flakes, {"type": "no_such_phase_function"}]
    monkeypatch.setattr(conformance, "phase_functions", lambda: iter([lobe]))
    kept = ("sampled_weight", "sampled_pdf", "sampling at theta_i 60")
    asked = [
        x for x in conformance.QUESTIONS if f"{x[0]} at theta_i {x[1]}".startswith(kept)
    ]
    monkeypatch.setattr(conformance, "QUESTIONS", asked)


def test_every_script_is_short_and_plain():
    found = list(questions("llvm_ad_mono"))
    plugins = {case.partition(",")[0] for case, _, _ in found}
    assert len(plugins) == 18 + 6  # BSDFs and phase functions
    for _, _, text in found:
        assert len(code_of(text)) <= 20
        assert "gonio" not in text


@pytest.mark.usefixtures("few")
def test_table(tmp_path):
    answers = ask_versions([sys.executable], ["llvm_ad_mono"])
    wrong = {(one.case, one.name.partition(" ")[0]) for one in answers if one.wrong}
    # of microflakes those off the axes, with the right mass in other directions
    assert wrong == {
        ("roughdielectric, parameters 2", "sampled_weight"),
        ("sggx, parameters 3", "sampling"),
    }
    save_table(answers, tmp_path / "table.html")
    page = (tmp_path / "table.html").read_text()
    assert page.count("#cec") == 3  # diffuse, hg and flakes of all directions alike
    assert page.count("#fbb") == 2
    assert page.count("no answer") == 1
    assert "sample_visible" in page

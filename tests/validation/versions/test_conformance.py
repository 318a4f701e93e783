"""The conformance table: what is asked, what is red, and the page."""

import sys
from dataclasses import replace
from types import SimpleNamespace

import mitsuba as mi
import pytest
from reproduced import is_short

from gonio_mi.cli import main
from gonio_mi.commands.arguments import INCOMPLETE
from gonio_mi.validation.versions import conformance
from gonio_mi.validation.versions.asking import answers_of
from gonio_mi.validation.versions.conformance import (
    LIMITS,
    ask_versions,
    questions,
    save_table,
)
from gonio_mi.validation.versions.stock import bsdfs, phase_functions
from gonio_mi.validation.versions.worker import all_said, said


@pytest.fixture
def few(monkeypatch):
    """Right plugins, two with defects of which the handbook has scripts, and none."""
    glass = {"type": "roughdielectric", "alpha": 0.3, "distribution": "ggx"}
    mirror = {"type": "conductor"}  # has nothing but a discrete lobe
    ones = [{"type": "diffuse"}, glass | {"sample_visible": False}, mirror]
    monkeypatch.setattr(conformance, "bsdfs", lambda: iter([ones]))
    monkeypatch.setattr(conformance, "_measured", list)
    stock = conformance.phase_functions

    def lobes():
        yield [{"type": "hg", "g": 0.5}, {"type": "no_such_phase_function"}]
        yield from (ones[::2] for ones in stock() if ones[0]["type"] == "sggx")

    monkeypatch.setattr(conformance, "phase_functions", lobes)
    kept = ("sampled_weight", "sampled_pdf", "sampling at theta_i 60")
    asked = [
        x for x in conformance.QUESTIONS if f"{x[0]} at theta_i {x[1]}".startswith(kept)
    ]
    monkeypatch.setattr(conformance, "QUESTIONS", asked)
    monkeypatch.setattr(conformance, "_materials", dict)


POLARISED = "llvm_ad_mono_polarized", "llvm_ad_spectral_polarized"
VARIANTS = "llvm_ad_mono", *POLARISED, "scalar_rgb"


@pytest.mark.parametrize("variant", VARIANTS)
def test_every_script_is_short_and_plain(variant):
    if variant not in mi.variants():
        pytest.skip(f"this Mitsuba has no {variant}")
    mi.set_variant(variant)  # the next test sets its own
    found = list(questions(variant))
    # BSDFs and phase functions; a file of `measured` has colours
    of_colours, of_polarisation = not mi.is_monochromatic, 3 * mi.is_polarized
    n_plugins = 18 + of_colours + of_polarisation + 6
    assert len({one.plugin for one in found}) == n_plugins
    for one in (one for ones in (*bsdfs(), *phase_functions()) for one in ones):
        mi.load_dict(one)  # which raises for a parameter that it does not have
    for one in found:
        assert is_short(one.script)
        assert "gonio" not in one.script
        assert "dr.opaque(" not in one.script  # Dr.Jit 1.3 makes no vectors by it


@pytest.mark.parametrize("variant", POLARISED)
@pytest.mark.usefixtures("polarised")
def test_every_script_answers_in_a_polarised_variant(variant, monkeypatch):
    """Those of phase functions, of which one has a defect, and of a right BSDF."""
    if variant not in mi.variants():
        pytest.skip(f"this Mitsuba has no {variant}")
    mi.set_variant(variant)
    grey = [{"type": "diffuse"}]
    monkeypatch.setattr(conformance, "bsdfs", lambda: iter([grey]))
    monkeypatch.setattr(conformance, "_measured", list)
    kept = {"sggx": 2}  # a sphere is no defect
    asked = [x for x in questions(variant) if x.number == kept.get(x.plugin, 1)]
    told = [(one, *said(one.script, LIMITS)) for one in asked]
    assert not [line for _, line, _ in told if line.startswith("raised")]
    wrong = {(one.plugin, one.name.partition(" ")[0]) for one, _, far in told if far}
    assert wrong == {("sggx", "sampling"), ("sggx", "weights")}


@pytest.mark.usefixtures("few")
def test_table(tmp_path):
    answers = list(ask_versions([sys.executable], ["llvm_ad_mono", "scalar_rgb"]))
    wrong = {
        (one.question.plugin, one.question.number, one.question.name.partition(" ")[0])
        for one in answers
        if one.wrong
    }
    silent = {one.question.plugin for one in answers if one.raised}
    assert silent == {"no_such_phase_function"}
    # of microflakes those off the axes, with the right mass in other directions
    assert wrong == {
        ("roughdielectric", 2, "sampled_weight"),
        ("sggx", 2, "sampling"),
    }
    path = tmp_path / "table.html"
    save_table(answers, path)
    page = path.read_text()
    assert page.count('<td class="right">') == 3  # diffuse, conductor, hg
    assert page.count('<td class="wrong">') == 2
    assert page.count('<td class="silent">') == 1
    assert "sample_visible" in page
    # a variant that answers nothing leaves one question to each plugin
    answered = [
        replace(one, text="raised E", wrong=False) if "llvm" in one.variant else one
        for one in answers
    ]
    save_table(answered, path)
    assert path.read_text().count('<td class="silent">') == 6


SCRIPT = "import numpy as np\nx = np.random.default_rng({}).random()\n"


@pytest.mark.parametrize("known", [True, False])
def test_only_what_is_confirmed_is_wrong(known):
    # with other random numbers the two agree, or do not
    text = SCRIPT.format(0) + "y = x + 1 if KNOWN or x > 0.6 else x\n"
    text += 'print(f"{x} and {y}: {(y - x) * 100:.3g} standard errors")'
    _, *told = all_said([text.replace("KNOWN", str(known))], LIMITS, {})
    assert [wrong for _, wrong in told] == [known]


def test_a_script_that_ends_the_process_costs_no_other():
    scripts = ["print(1)", "import os; os.abort()", "print('to us'); print(3)"]
    told = answers_of(sys.executable, scripts, limits=LIMITS, files={})
    version, *_ = mi.__version__.split("+")
    assert list(told) == [
        (version, "1", False),
        (version, "raised an error that ended the process", False),
        (version, "3", False),
    ]


@pytest.mark.usefixtures("few")
def test_ctrl_c_keeps_the_answers_so_far(tmp_path, monkeypatch, capsys):
    every = list(ask_versions([sys.executable], ["llvm_ad_mono"]))

    def pressed(*_):
        yield from every[:5]
        raise KeyboardInterrupt

    monkeypatch.setattr(conformance, "ask_versions", pressed)
    path = tmp_path / "table.html"
    assert main(["conformance", "-o", str(path)]) == INCOMPLETE
    assert f"{path} has the 5 answers so far" in capsys.readouterr().err
    assert "<p>5 answers" in path.read_text()


def test_scripts_leave_nothing_behind():
    kept = []

    class Counted:
        def __del__(self):
            kept.append(1)

    sys.modules["counted"] = SimpleNamespace(Counted=Counted)
    try:
        said("from counted import Counted\nx = Counted()\nf = lambda: x", LIMITS)
    finally:
        del sys.modules["counted"]
    assert kept == [1]

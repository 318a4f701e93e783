"""Means over patches beside points of a table: what they can tell, and what not."""

import budget
import mitsuba as mi
import numpy as np
import pytest
from closed_forms import eval_flux

import gonio_mi as gonio
from gonio_mi.analysis.comparison import compare, patch_variation
from gonio_mi.analysis.comparison.figure import comparison_figure, p_text
from gonio_mi.cli import main
from gonio_mi.collector.directions import direction
from gonio_mi.files.measured_table import MeasuredTable

PLASTIC = {"type": "roughplastic", "alpha": 0.2}
METAL = {"type": "roughconductor", "alpha": 0.3}
NARROW = {"type": "roughconductor", "alpha": 0.03}


def sampled(bsdf, theta_i=30.0, wrong=1.0, **settings):
    """Table of a BSDF at points, in and out of the plane of incidence; no patches."""
    theta_o = np.concatenate([np.arange(5.0, 76, 5)] * 3)
    phi_o = np.repeat([0.0, 100.0, 180.0], 15)
    wo = direction(np.radians(theta_o), np.radians(phi_o))
    values = wrong * eval_flux(mi.load_dict(bsdf), theta_i, 0, wo)[:, 0] / wo[:, 2]
    zeros = np.zeros(len(values))
    return MeasuredTable(zeros + theta_i, zeros, theta_o, phi_o, values, **settings)


@pytest.fixture(scope="module")
def metal():
    """Record of a metal lobe in coarse patches."""
    mi.set_variant("llvm_ad_mono")
    return gonio.measure(METAL, 30, collector="projected:12x24", rays=2**18)


@pytest.mark.parametrize("collector", ["projected:30x30", "angle:18x36", "klems"])
@pytest.mark.parametrize("bsdf", [PLASTIC, METAL, {"type": "diffuse"}], ids=str)
def test_a_brdf_at_points_is_not_said_to_differ_from_itself(bsdf, collector):
    """Its values are exact, and the noise of the means is small; five per cent differ.

    Those of the plastic, whose lobe these patches resolve.
    """
    record = gonio.measure(bsdf, 30, collector=collector, rays=2**22)
    comparison = compare(record, sampled(bsdf), alpha=budget.ALPHA)
    assert comparison.verdict != "differ", str(comparison)
    assert any("means over patches stand for" in note for note in comparison.notes)
    for wrong in (1.0, 0.95, 1.05) if bsdf is PLASTIC else ():
        table = sampled(PLASTIC, wrong=wrong, uncertainty=0.005)
        comparison = compare(record, table, alpha=budget.ALPHA)
        assert (comparison.verdict == "differ") == (wrong != 1), str(comparison)


def test_where_patches_cannot_decide_it_is_said(metal, tmp_path, capsys):
    """The specimen itself decides, either way."""
    path, table = tmp_path / "run.npz", tmp_path / "points.csv"
    metal.save(path)
    for wrong, code in ((1.0, 0), (1.05, 3)):
        stated = {"uncertainty": 0.005, "aperture_half_angle": 0.5}
        sampled(METAL, wrong=wrong, **stated).save(table)
        alpha = ["--alpha", str(budget.ALPHA)]
        assert main(["compare", str(path), str(table), *alpha]) == 2
        out = capsys.readouterr().out
        assert "verdict     cannot be decided with these patches" in out
        assert "compare the specimen itself with the table" in out
        word = "roughconductor:alpha=0.3"
        assert main(["compare", word, str(table), *alpha]) == code
        capsys.readouterr()


def test_no_verdict_calls_equal_what_patches_cannot_decide(metal):
    """A fifth too bright all over; twin: twice as bright is told."""
    undecided = "cannot be decided with these patches"
    verdicts = ("undecided", undecided), ("differ", "DIFFER")
    for wrong, (verdict, words) in zip((1.2, 2.0), verdicts):
        table = sampled(METAL, wrong=wrong, uncertainty=0.02)
        comparison = compare(metal, table, alpha=budget.ALPHA)
        assert comparison.verdict == verdict
        assert f"points: {verdict}, p" in repr(comparison)
        title = comparison_figure(comparison).get_suptitle()
        assert title.startswith((f"{words}: p = ", f"{words}: p < "))


def test_agreement_is_no_closer_than_patches_tell(metal, tmp_path, capsys):
    """Exact: text and picture say so; twin: of detectors at the points they do not."""
    table = sampled(METAL, uncertainty=0.5)
    words = "agree within what these patches can decide: p = "
    comparison = compare(metal, table)
    assert f"verdict     {words}" in str(comparison)
    assert comparison_figure(comparison).get_suptitle().startswith(words)
    table.save(tmp_path / "points.csv")
    told = ["--aperture-half-angle", "0.5"]
    word = "roughconductor:alpha=0.3"
    assert main(["compare", word, str(tmp_path / "points.csv"), *told]) == 0
    assert "verdict     agree: p = " in capsys.readouterr().out


def test_a_lobe_on_a_diffuse_ground_may_hide_about_the_pole(monkeypatch):
    """All sectors there are alike; twin: without the rule for it, equals differ."""
    shiny = {"type": "roughplastic", "alpha": 0.1}
    record = gonio.measure(shiny, 0, collector="solid:10x20", rays=2**20)
    theta_o, phi_o = np.repeat(np.arange(1.0, 8), 8), np.tile(np.arange(8) * 45.0, 7)
    wo = direction(np.radians(theta_o), np.radians(phi_o))
    values = eval_flux(mi.load_dict(shiny), 0, 0, wo)[:, 0] / wo[:, 2]
    table = MeasuredTable(0 * theta_o, 0 * theta_o, theta_o, phi_o, values)
    with pytest.raises(ValueError, match="too coarse for 56 of 56"):
        compare(record, table, alpha=budget.ALPHA)
    monkeypatch.setattr(patch_variation, "MIN_PEAK", np.inf)
    assert compare(record, table, alpha=budget.ALPHA).verdict == "differ"


def test_a_lobe_narrower_than_its_patch_is_left_out():
    """What is dark all around is compared: the lobe is elsewhere."""
    record = gonio.measure(NARROW, 30, collector="projected:12x24", rays=2**16)
    comparison = compare(record, sampled(NARROW), alpha=budget.ALPHA)
    assert comparison.passed
    assert any("too coarse for" in note for note in comparison.notes)
    assert comparison.other.max() < 1e-3
    lobe = np.array([30.0]), np.array([0.0]), np.array([30.0]), np.array([180.0])
    with pytest.raises(ValueError, match=r"too coarse for 1 of 1 .* specimen itself"):
        compare(record, MeasuredTable(*lobe, np.array([1.0])))


def test_probabilities_that_underflow_are_not_nought():
    """Twins: those that do not, and none at all."""
    assert p_text(0.0) == "p < 2e-308"
    assert p_text(1e-300) == "p = 1e-300"
    assert p_text(float("nan")) == "p = nan"

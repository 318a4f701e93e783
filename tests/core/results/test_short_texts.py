"""Texts that are too long say so, and records keep all that they hold."""

import mitsuba as mi
import pytest
import synthetic

import gonio_mi as gonio
from gonio_mi.errors import LABEL, abridged
from gonio_mi.results.summary import summarize
from gonio_mi.results.summary_text import summary_text

NESTED = {
    "type": "blendbsdf",
    "weight": 0.3,
    "a": {"type": "principled", "roughness": 0.4},
    "b": {"type": "roughconductor", "alpha": 0.123},
}


@pytest.mark.parametrize(
    ("text", "longest", "short"),
    [
        ("alpha=0.2", 9, "alpha=0.2"),
        ("eta = 1.5, alpha = 0.2, k = 3", 24, "eta = 1.5, ..."),
        ("a long description of words", 20, "a long ..."),
        ("plastic:alpha=0.2,eta=1.5,k=3", 28, "plastic:alpha=0.2, ..."),
        ("/of/one/file/without/a/gap", 16, "/of/one/file..."),
    ],
)
def test_a_cut_is_seen_and_after_a_parameter(text, longest, short):
    assert abridged(text, longest) == short
    assert len(short) <= longest


def test_a_record_holds_the_description_of_a_nested_specimen():
    mi.set_variant("llvm_ad_mono")
    record = gonio.measure(NESTED, 30, 0, rays=100, collector="projected:2x2")
    text = record.settings["surface"]
    assert "alpha_u = UniformSpectrum[value=[0.123]]" in text, (
        "the last one's parameter"
    )
    assert text.count("[") == text.count("]")
    shown = " ".join(summary_text(summarize(record)).split())
    assert text not in shown, "which the numbers for people abridge"
    assert ", ... light " in shown


@pytest.mark.needs("analysis")
def test_labels_of_specimens_that_differ_late():
    from gonio_mi.analysis.comparison.pairing import labels

    name = "principled:base_color=0.2/0.3/0.4,metallic=0.3,anisotropic=0.25,roughness="
    one, two = (
        synthetic.record().with_settings(specimen=f"{name}{x}") for x in (0.4, 0.5)
    )
    assert labels(one, two) == ("... roughness=0.4", "... roughness=0.5")
    folder = f"/home/{'a/' * LABEL}scene_"
    one_file, another = (
        synthetic.record().with_settings(specimen=f"{folder}{x}.xml") for x in (4, 5)
    )
    found = labels(one_file, another)
    assert max(map(len, found)) <= LABEL
    assert [label[-5:] for label in found] == ["4.xml", "5.xml"]
    short = synthetic.record().with_settings(specimen="diffuse")
    assert labels(one, short)[0] == (
        "principled:base_color=0.2/0.3/0.4,metallic=0.3, ..."
    )

"""Comparisons say in which conditions two measurements differ."""

from dataclasses import replace

import pytest
import synthetic

import gonio_mi as gonio
from gonio_mi.analysis.comparison import compare
from gonio_mi.analysis.comparison.pairing import CONDITIONS
from gonio_mi.files.measured_table import MeasuredTable
from gonio_mi.results.tally import Fate
from gonio_mi.settings import MeasurementSettings, declarations

# Settings that change how well something is known, or are compared by themselves.
OTHERS = {
    *("rays", "rel_err", "noise", "max_rays", "floor", "batches", "estimator"),
    "gradients",
    *("points", "sampler", "seed", "rr_depth", "trace"),
    *("wavelengths", "collector", "hemispheres"),
}
VALUES = {
    "side": "back",
    "footprint": 0.2,
    "divergence": 0.5,
    "incident": "klems",
    "emission": "equal_power",
    "emitter": "AreaLight",
    "collector_radius": 4.0,
    "period": "box",
    "order": "2",
    "max_depth": 3,
    "max_scatterings": 7,
}


def said(record, other):
    """What the notes of a comparison say of conditions."""
    notes = compare(record, other).notes
    return [note for note in notes if note.startswith("the conditions are not")]


def test_every_setting_is_a_condition_or_none():
    settings = declarations(MeasurementSettings).keys()
    assert settings - OTHERS == set(CONDITIONS) - {"emitter"}
    assert VALUES.keys() == set(CONDITIONS)


@pytest.mark.parametrize("name", CONDITIONS)
def test_a_comparison_tells_each_condition(name):
    record, other = synthetic.record(seed=1), synthetic.record(seed=2)
    tallies = []
    for one in (record, other):
        fates = one.tallies[0].fates.copy()
        fates[:, Fate.TRUNCATED] = 1  # without which no depth matters
        tallies.append(replace(one.tallies[0], fates=fates))
    record, other = (
        replace(one, tallies=(tally,)) for one, tally in zip((record, other), tallies)
    )
    if name == "max_scatterings":  # told where there are media only
        record, other = (one.with_provenance(media=("fog",)) for one in (record, other))
    other_way = other.with_settings(**{name: VALUES[name]})
    alike = record.with_settings(**{name: VALUES[name]})
    (note,) = said(record, other_way)
    assert f"{name} " in note
    assert f" and {VALUES[name]}" in note
    assert said(record, record.with_settings(seed=2)) == []
    assert said(alike, other_way) == []


def test_emitters_of_one_class_are_told_apart():
    record = synthetic.record(seed=1).with_settings(emitter="AreaLight")
    one, other = (record.with_settings(emitter_digest=name) for name in "ab")
    (note,) = said(one, other)
    assert "emitters that are both AreaLight" in note
    assert said(one, one) == []


def test_records_as_they_are_measured():
    """Of light in a patch, in a cone and in one direction; depth without a cut."""
    glossy = {"type": "roughconductor", "alpha": 0.2}
    settings = {"theta_i": 30, "collector": "projected:4x8", "rays": 2**10}
    straight = gonio.measure(glossy, **settings)
    cone = gonio.measure(glossy, **settings, divergence=5, seed=1)
    patch = gonio.measure(glossy, **settings, incident="klems", seed=1)
    shallow = gonio.measure(glossy, **settings, max_depth=5, estimator="analog", seed=1)
    assert "divergence 0.0 and 5.0" in said(straight, cone)[0]
    assert "incident none and klems" in said(straight, patch)[0]
    assert said(straight, shallow) == []


def test_a_table_that_says_how_its_light_came():
    record = synthetic.record()
    one = [30.0], [20.0], [40.0], [0.0], [0.3]
    silent, cone = MeasuredTable(*one), MeasuredTable(*one, emitter_half_angle=0.5)
    assert said(record, silent) == []
    assert (
        "within 0.5 degrees, that of the record had a divergence of 0"
        in (said(record, cone)[0])
    )
    assert said(record.with_settings(divergence=0.5), cone) == []
    assert "filled patches" in said(record.with_settings(incident="klems"), silent)[0]

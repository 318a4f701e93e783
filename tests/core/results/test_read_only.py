"""A record cannot be changed: not its settings, its arrays, nor what is derived."""

import copy
import json
import pickle
from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest
import synthetic

from gonio_mi.results.provenance import read_only
from gonio_mi.results.tally import Integrals, Tally

SETTINGS = {"seed": [1, 2], "versions": {"numpy": "2"}, "task": {"a": [3]}}
COPIES = {
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    "pickle": lambda value: pickle.loads(pickle.dumps(value)),
    "replace": replace,
}


def settled():
    return synthetic.record().with_settings(**SETTINGS)


def arrays_of(record):
    yield from (record.theta_i, record.phi_i)
    for tally in record.tallies:
        yield from (getattr(tally, name) for name in tally.arrays)
    yield from (record.brdf, record.brdf_std_err, record.dhr, record.dhr_std_err)


def integrated(both=False):
    """Record of integrals, without rays."""
    record = synthetic.record(both=both)
    (tally,) = record.tallies
    flux = np.full((*tally.hits.shape, 1), 1e-3)
    none = Tally.empty(len(tally.hits), tally.hits.shape[1:], 1, tally.scale)
    tallies = (Integrals.beside(none, flux, flux * 1e-3),)
    return replace(record, tallies=tallies).with_settings(estimator="quadrature")


def refused(holder, change):
    """Check that one sentence refuses a `change` of what holds settings."""
    with pytest.raises(TypeError, match="settings of a record cannot be changed"):
        change(holder)


def test_settings_cannot_be_changed():
    """Nor lists in them: whatever changes a dictionary or a list is refused."""
    record = settled()
    for holder, base in ((record.settings, dict), (record.settings["seed"], list)):
        own = vars(type(holder))
        changing = {name for name, x in own.items() if x is own["__setitem__"]}
        for name in changing:
            refused(holder, lambda one, name=name: getattr(one, name)())
        # the others change nothing, of a dictionary or a list either
        one = base(SETTINGS) if base is dict else [2, 1]
        others = vars(base).keys() - changing
        for name in others - {"__init__", "__class_getitem__", "__new__"}:
            before = copy.deepcopy(one)
            for arguments in ((), (0,), ("x",), ("b", 1), (0, 0), ({"b": 1},), ([3],)):
                try:
                    getattr(one, name)(*arguments)
                except (TypeError, ValueError, IndexError, KeyError, AttributeError):
                    continue
            assert one == before, name
    assert record == settled()


def test_settings_are_a_copy_of_what_was_given():
    given = copy.deepcopy(SETTINGS)
    record = synthetic.record().with_settings(**given)
    given["seed"].append(3)
    given["versions"]["numpy"] = "3"
    given["task"]["a"].append(4)
    assert SETTINGS.items() <= record.settings.items()


def test_settings_are_values_of_json():
    text = json.dumps(SETTINGS)
    settings = read_only(SETTINGS)
    assert json.dumps(settings) == text
    assert settings == SETTINGS == json.loads(text)
    assert type(settings | {}) is dict
    refused(settings["task"]["a"], lambda one: one.append(4))


@pytest.mark.parametrize("name", COPIES)
@pytest.mark.parametrize("made", [settled, integrated])
def test_copies_are_equal_and_read_only(made, name):
    record = made()
    again = COPIES[name](record)
    assert again == record
    assert type(again.tallies[0]) is type(record.tallies[0])
    assert not any(array.flags.writeable for array in arrays_of(again))
    refused(again.settings, lambda d: d.update(a=1))
    refused(again.settings["versions"], lambda d: d.update(a=1))
    assert again != record.with_settings(footprint=0.2)


@pytest.mark.parametrize("both", [False, True])
@pytest.mark.parametrize("made", [synthetic.record, integrated])
def test_arrays_cannot_be_changed(made, both):
    record = made(both=both)
    for array in arrays_of(record):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
    with pytest.raises(FrozenInstanceError):
        record.tallies[0].sums = record.tallies[0].sums * 2
    with pytest.raises(FrozenInstanceError):
        record.settings = {}


def test_nothing_integrated_passes_a_plane():
    """Without a ray direct light is 0 all the same, not between 0 and 1."""
    record = integrated(both=True)
    assert record.n_batches == 1
    assert record.direct == record.direct_std_err == 0
    np.testing.assert_array_equal(record.interval(of="direct"), [[0.0], [0.0]])
    assert not record.without_hit.any()
    assert not record.counts.any()


def test_kinds_of_tallies_differ():
    """Integrals without error are no rays, though their sums are alike."""
    (one,) = integrated().tallies
    rest = {name: getattr(one, name) for name in Tally.arrays}
    sampled = Tally(scale=one.scale, **rest)
    assert one != sampled
    assert sampled != one
    assert one == replace(one)

"""Records tell the processor that Dr.Jit compiled for, and if there were several."""

import json
import re

import drjit as dr
import numpy as np
import pytest
import synthetic

import gonio_mi as gonio
from gonio_mi import llvm, variants
from gonio_mi.results.summary import summarize
from gonio_mi.results.summary_text import summary_text

OTHER = ("a-processor", 4)


def measured(seed=0, **settings):
    return gonio.measure(
        {"type": "diffuse"}, 30, rays=1000, collector="angle:2x2", seed=seed, **settings
    )


@pytest.fixture
def elsewhere(monkeypatch):
    """Call a function as on a processor of another name and width of vectors."""

    def call(function, *args, **settings):
        with monkeypatch.context() as patch:
            patch.setattr(variants, "target", lambda: OTHER)
            return function(*args, **settings)

    return call


def told(record):
    """Processors of the one warning that `show` gives for several, or none."""
    numbers = summarize(record)
    found = [text for text in numbers.warnings if "unlike processors" in text]
    assert len(found) <= 1
    assert all(text in " ".join(summary_text(numbers).split()) for text in found)
    return re.search(r"\((.*)\)", found[0]).group(1).split("; ") if found else []


def test_the_record_names_it():
    """Exact: the name, the width of Dr.Jit's own packets, and LLVM's version."""
    [text] = measured().settings["processors"]
    name, width = variants.target()
    version = llvm.dotted(dr.detail.llvm_version())
    assert text == f"{name}, vectors of {width}, LLVM {version}"
    assert width in (2, 4, 8, 16, 32)
    shown = " ".join(summary_text(summarize(measured())).split())
    assert f"on {text}" in shown
    assert told(measured()) == []


def test_merged_resumed_and_stacked_parts_are_told(elsewhere):
    here, there = measured(), elsewhere(measured, 1)
    both = [*here.provenance.processors, *there.provenance.processors]
    assert "a-processor, vectors of 4" in both[1]
    assert told(there) == []
    merged = here.merge(there)
    assert told(merged) == both
    assert np.array_equal(merged.counts, here.counts + there.counts)
    begun = measured()
    assert told(elsewhere(measured, resume=begun)) == both
    assert told(measured(resume=begun)) == []
    assert told(gonio.Record.stack([here, elsewhere(measured)])) == both


def test_a_campaign_that_moved_is_told(elsewhere, tmp_path):
    """The second half of a folder, measured elsewhere, joins the first one."""
    how = {"folder": tmp_path, "collector": "angle:2x2", "rel_err": 0.5}
    specimen, angles = {"matt": {"type": "diffuse"}}, [0, 30]
    first = gonio.campaign(specimen, theta_i=angles, **how)["matt"]
    assert told(first) == []
    last = sorted(tmp_path.glob("[0-9]*.npz"))[-1]
    last.unlink()
    record = elsewhere(gonio.campaign, specimen, theta_i=angles, **how)["matt"]
    assert len(told(record)) == 2
    assert record.tallies == first.tallies


def test_old_records_load_and_are_unknown(tmp_path):
    """Merged with each other nothing is said, with a new one that one is unknown."""
    old, new = measured(), measured(1)
    old = old.with_provenance(processors=())
    old.save(tmp_path / "old.npz")
    loaded = gonio.load(tmp_path / "old.npz")
    assert "processors" not in loaded.settings
    assert told(loaded) == []
    assert "processors" not in loaded.merge(old.with_settings(seed=2)).settings
    assert told(loaded.merge(new)) == ["unknown", *new.provenance.processors]
    assert json.dumps(summarize(loaded).as_mapping())


@pytest.mark.parametrize("value", ["one", [1], {"a": "b"}, 3])
def test_what_is_no_list_of_texts_is_refused(tmp_path, value):
    synthetic.telling(measured(), processors=value).save(tmp_path / "x.npz")
    with pytest.raises(gonio.FileFormatError, match="processors"):
        gonio.load(tmp_path / "x.npz")


def test_where_the_library_is_another_one(monkeypatch, tmp_path):
    monkeypatch.setattr(variants.dr, "__file__", str(tmp_path / "__init__.py"))
    assert "vectors of unknown width" in variants.processor()

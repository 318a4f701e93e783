"""Damaged files and odd command lines end in an answer or in one sentence.

A few trials of each, seconds in all; ``GONIO_FUZZ=2000`` makes as many, and
``GONIO_FUZZ_KEEP=folder`` keeps what fails.
"""

import os

import fuzz
import pytest
from scatter_trials import SCATTER

TRIALS = int(os.environ.get("GONIO_FUZZ", "15"))

pytestmark = pytest.mark.skipif(
    not os.path.exists("/proc/self/status"), reason="limits memory as Linux does"
)


@pytest.mark.parametrize(
    "names",
    [
        ["npz", "exr", "csv", "astm", "klems", "tensor", "tensor file"],
        ["bsdf", "npy", "png", "image", "goniometric", "scene"],
        ["sur", "x3p", "tiff"],
        ["command"],
        [*SCATTER],
    ],
    ids=["our readers", "specimens", "surfaces", "command line", "scatter files"],
)
def test_trials(tmp_path, names):
    if "x3p" in names:
        pytest.importorskip("SurfaceTopography")
    assert fuzz.trials(names, TRIALS, tmp_path) == []


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("raises", "KeyError"),
        ("speaks", "500 characters"),
        ("differs", "another answer"),
        ("dies", "the process ended with -6"),
        ("prints", "oh"),
        ("takes", "MemoryError"),
    ],
)
def test_twin_trials_find_each_fault(tmp_path, name, wrong):
    failures = fuzz.trials([f"broken: {name}"], 2, tmp_path)
    assert failures
    assert all(wrong in failure["wrong"] for failure in failures)

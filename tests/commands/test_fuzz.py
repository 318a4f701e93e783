"""Damaged files and odd command lines end in an answer or in one sentence.

A few trials of each, seconds in all; ``GONIO_FUZZ=2000`` makes as many, and
``GONIO_FUZZ_KEEP=folder`` keeps what fails.
"""

import os

import fuzz
import pytest
from scatter_trials import SCATTER

TRIALS = int(os.environ.get("GONIO_FUZZ", "10"))

pytestmark = pytest.mark.skipif(
    not os.path.exists("/proc/self/status"), reason="limits memory as Linux does"
)


@pytest.mark.parametrize(
    "names",
    [
        ["npz", "exr", "csv", "astm", "klems", "tensor", "tensor file", *SCATTER],
        ["bsdf", "npy", "png", "image", "goniometric", "scene"],
        ["sur", "x3p", "tiff"],
        ["command"],
    ],
    ids=["readers", "specimens", "surfaces", "command line"],
)
def test_trials(tmp_path, names):
    if "x3p" in names:
        pytest.importorskip("SurfaceTopography")
    assert fuzz.trials(names, TRIALS, tmp_path) == []


FAULTS = {
    "raises": "KeyError",
    "speaks": "500 characters",
    "differs": "another answer",
    "takes": "MemoryError",
}


def test_twin_trials_find_each_fault(tmp_path):
    names = [f"broken: {name}" for name in (*FAULTS, "prints")]
    *failures, last = fuzz.trials(names, 2, tmp_path)
    for name, wrong in FAULTS.items():
        found = [one["wrong"] for one in failures if one["kind"] == f"broken: {name}"]
        assert len(found) == 2
        assert all(wrong in one for one in found)
    assert len(failures) == 2 * len(FAULTS)
    assert (last["kind"], last["wrong"]) == (names, "ohoh")
    (dead,) = fuzz.trials(["broken: dies"], 1, tmp_path)
    assert "the process ended with -6" in dead["wrong"]

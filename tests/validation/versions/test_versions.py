"""Two versions of Mitsuba compared; the other one is this one, in disguise."""

import json
import sys
from pathlib import Path

import budget
import numpy as np
import pytest

from gonio_mi import cli
from gonio_mi.errors import SettingError, SpecimenError
from gonio_mi.validation.versions import Difference, Differences, diff
from gonio_mi.validation.versions.differing import _albedo, _sizes, _worst

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="a shell's script")

# A Lambertian that is another one where the variable is set: what changes is its value.
PLUGIN = """
import os
import drjit as dr
import mitsuba as mi

CHANGED = os.environ.get("GONIO_TEST_VERSION", "")

class Lambertian(mi.BSDF):
    def __init__(self, props):
        super().__init__(props)
        self.m_flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide
        self.m_components = [self.m_flags]
        self.reflectance = mi.Float(0.8)

    def traverse(self, callback):
        name = "albedo" if "parameters" in CHANGED else "reflectance"
        callback.put(name, self.reflectance, mi.ParamFlags.Differentiable)

    def sample(self, ctx, si, sample1, sample2, active):
        bs = dr.zeros(mi.BSDFSample3f)
        if "sample" in CHANGED:
            sample2 = mi.Point2f(sample2.y, sample2.x)
        bs.wo = mi.warp.square_to_cosine_hemisphere(sample2)
        bs.pdf, bs.eta = dr.inv_pi * bs.wo.z, 1.0
        bs.sampled_type = mi.UInt32(+mi.BSDFFlags.DiffuseReflection)
        weight = 0.8 * (1.001 if "weights" in CHANGED else 1)
        return bs, mi.Spectrum(weight) & (active & (si.wi.z > 0) & (bs.pdf > 0))

    def eval(self, ctx, si, wo, active):
        ok = active & (si.wi.z > 0) & (wo.z > 0)
        tilt = 1 + 0.01 * wo.x if "eval" in CHANGED else 1
        return mi.Spectrum(0.8 * tilt * dr.inv_pi * wo.z) & ok

    def pdf(self, ctx, si, wo, active):
        return dr.select(active & (si.wi.z > 0) & (wo.z > 0), dr.inv_pi * wo.z, 0)

    def to_string(self):
        return "Lambertian[]"

mi.register_bsdf("two_versions", Lambertian)
"""


def environment(folder, script):
    """Virtual environment whose Python is a script."""
    python = folder / "bin/python"
    python.parent.mkdir(parents=True)
    python.write_text(f"#!/bin/sh\n{script}\n")
    python.chmod(0o755)
    return folder


def disguised(folder, changed):
    return environment(
        folder, f'GONIO_TEST_VERSION={changed} exec "{sys.executable}" "$@"'
    )


@pytest.fixture
def plugin(tmp_path):
    path = tmp_path / "two_versions.py"
    path.write_text(PLUGIN)
    return str(path)


@pytest.mark.parametrize(
    ("changed", "differs"),
    [
        ("sample,parameters", {"sample", "parameters"}),
        ("weights", {"weights", "albedo"}),
    ],
)
def test_what_differs_is_named(tmp_path, plugin, changed, differs):
    """Each change is seen where it is, and nowhere else; so below with two more."""
    other = disguised(tmp_path / "venv", changed)
    found = diff({"type": "two_versions"}, other, plugins=[plugin])
    assert {part.function for part in found.parts if part.differs} == differs
    assert not found.same
    if "parameters" in differs:
        assert "albedo in" in found["parameters"].text
    # the light is the same, be it other samples
    assert found["albedo"].differs == ("albedo" in differs)


def test_command(capsys):
    assert cli.main(["diff", "diffuse", "--against", sys.executable]) == 0
    assert "1 of 1 are the same" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("changed", "differs"), [("nothing", set()), ("eval", {"eval"}), ("sample", None)]
)
def test_two_saved_files(tmp_path, plugin, capsys, changed, differs):
    """They say what both versions say side by side; samples may be others."""
    other = str(disguised(tmp_path / "venv", changed))
    files = [str(tmp_path / f"{name}.json") for name in ("own", "other")]
    common = ["diff", "two_versions", "--plugin", plugin]
    assert cli.main([*common, "--save", files[0]]) == 0
    assert cli.main([*common, "--against", other, "--save", files[1]]) == 0
    assert cli.main(["diff", *files, "--json"]) == (3 if differs != set() else 0)
    (answer,) = json.loads(capsys.readouterr().out)
    found = {part["function"]: part for part in answer["parts"] if part["differs"]}
    assert answer["name"] == "two_versions"
    if differs is None:
        # directions are not the same, and the lattice tells that values are
        differs = {"sample"}
    else:
        code = cli.main([*common, "--against", other, "--json"])
        assert code == (3 if differs else 0)
        (beside,) = json.loads(capsys.readouterr().out)
        own = [part for part in beside["parts"] if part["differs"]]
        assert {part["function"] for part in own} == differs
        for part in own:
            assert part["meaning"].startswith("images change")
            # 0.01 sin over 2^-14 + 16 * 2^-21 / cos, at most, has its maximum near 60
            # degrees; less is displaced
            assert 110 < part["size"] < 0.01 * 2**14
        sizes = [[part["size"] for part in x["parts"]] for x in (answer, beside)]
        # rounding: values have single precision, and what a displaced direction may
        # change is kept in it
        assert sizes[0] == pytest.approx(sizes[1], rel=2**-22, abs=0)
    assert found.keys() == differs


def test_files_that_cannot_be_compared(tmp_path, capsys):
    own, seeded, two, nothing = (str(tmp_path / f"{name}.json") for name in "abcd")
    assert cli.main(["diff", "diffuse", "--save", own]) == 0
    (entry,) = json.loads(Path(own).read_text())
    asked = entry["asked"] | {"seed": 1}
    Path(seeded).write_text(json.dumps([entry | {"asked": asked}]))
    Path(two).write_text(json.dumps([entry, entry | {"name": "another"}]))
    Path(nothing).write_text(json.dumps([entry | {"arrays": "AA=="}]))
    empty = str(tmp_path / "empty.json")
    Path(empty).write_text("[]")
    for words, message in (
        ([empty, empty], "holds no answers"),
        ([own, own, "--against", sys.prefix], "cannot be combined with --against"),
        (["mine:filename=a.json", "--against", "nowhere"], "must be a virtual"),
        ([own, seeded], "ask diffuse with the same seed, got 0 and 1"),
        ([own, two], "the same BSDFs, got another in one"),
        ([own, nothing], "holds no answers"),
        ([own, str(tmp_path / "absent.json")], "cannot be read"),
        ([own, "diffuse"], "BSDFs, or two files"),
        (["diffuse"], "needs --against"),
    ):
        assert cli.main(["diff", *words]) == 1
        assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("script", "error", "message"),
    [
        ("exit 7", SpecimenError, "ended with 7"),
        ("echo out of order >&2; exit 1", SpecimenError, "out of order"),
        (f'exec "{sys.executable}" -S "$@"', SettingError, "pip install mitsuba numpy"),
    ],
)
def test_a_broken_environment_is_one_sentence(tmp_path, script, error, message):
    broken = environment(tmp_path / "venv", script)
    with pytest.raises(error, match=message) as found:
        diff({"type": "diffuse"}, broken)
    assert str(broken) in str(found.value)
    assert "\n" not in str(found.value)


def test_arguments(tmp_path):
    with pytest.raises(SettingError, match="no bin/python"):
        diff({"type": "diffuse"}, tmp_path)
    with pytest.raises(SpecimenError, match="no_such_bsdf"):
        diff({"type": "no_such_bsdf"}, sys.executable)
    with pytest.raises(SpecimenError, match="texts, bitmaps and dictionaries, got"):
        diff({"type": "diffuse", "reflectance": np.ones(3)}, sys.executable)


def test_equal_albedos_of_other_samples():
    """Normal scores of 200 pairs of one law; twin: one is 1 % off."""

    def scores(scale):
        rng = np.random.default_rng(1)
        found = []
        for _ in range(200):
            a, b = ({"weight": rng.random((4096, 1)) + 0.5} for _ in range(2))
            b["weight"] *= scale
            _, size, _ = _albedo(["here"], [(a, b)], 1e-3)
            off = a["weight"].mean() - b["weight"].mean()
            found.append(np.sign(off) * size)
        return np.array(found)

    budget.agree(budget.verdict(scores(1.0)))
    budget.disagree(budget.verdict(scores(1.01)))


def test_sizes_are_in_units_of_rounding():
    a, b = (
        np.array([1.0, np.nan, 1.0, 0.0]),
        np.array([1 + 2.0**-13, np.nan, np.nan, 0]),
    )
    assert _sizes(a, b, 0.0).tolist() == [pytest.approx(2, rel=2**-12), 0, np.inf, 0]
    assert _sizes(a, b, 2.0**-13)[0] < 2 / 16


def test_no_number_is_none_in_json():
    """One version says NaN where the other has values: JSON has no infinity."""
    nothing, ones = np.full(4, np.nan), np.ones(4)
    view = _sizes(nothing, ones, 0.0), nothing, ones
    part = Difference("eval", *_worst(["normal"], [view], ""), "it changes")
    assert part.differs
    found = Differences("a", ("1", "2"), (part,)).to_dict()
    assert found["parts"][0]["size"] is None
    json.dumps(found, allow_nan=False)


def test_the_example_is_where_most_light_differs():
    """Not in the tail of a lobe, though it differs by more of itself there."""
    here = np.r_[np.full(50, 2.0), np.full(50, 1e-9)]
    there = np.r_[np.full(50, 2.02), np.full(50, 2e-9)]
    sizes = _sizes(here, there, 0.0)
    assert sizes[-1] > sizes[0] > 1
    _, size, text = _worst(["normal"], [(sizes, here, there)], "")
    assert "up to 2 and 2.02; " in text
    assert size == sizes.max()

"""Records of different specimens are never mixed. All is exact."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import mitsuba as mi
import numpy as np
import plain_bsdf
import pytest

import gonio_mi as gonio
from gonio_mi.results.tally import Tally
from gonio_mi.specimen.digest import digest, file_digest
from gonio_mi.specimen.loading import load_specimen

SETTINGS = {"rays": 800, "batches": 4, "collector": "projected:3x3"}


def checkered(value):
    """Bitmap whose mean, which is in its text, is always the same."""
    pixels = np.full((4, 4, 1), 0.5, np.float32)
    pixels[0, 0], pixels[3, 3] = value, 1 - value
    bitmap = mi.Bitmap(pixels)
    texture = {"type": "bitmap", "bitmap": bitmap, "raw": True}
    return {"type": "diffuse", "reflectance": texture}


def blended(value):
    """Two BSDFs whose Mitsuba texts agree in their first 200 characters."""
    metal = {"type": "roughconductor", "alpha": 0.123}
    matt = {"type": "diffuse", "reflectance": value}
    matt = {"type": "twosided", "bsdf": matt}
    metal = {"type": "twosided", "bsdf": metal}
    return {"type": "blendbsdf", "weight": 0.5, "metal": metal, "matt": matt}


def block(height):
    stretch = mi.ScalarTransform4f().scale([1, 1, height])
    return {"type": "cube", "to_world": stretch, "bsdf": {"type": "diffuse"}}


def emitter(radiance, half=0.3):
    turned = mi.ScalarTransform4f().translate([0, 0, 2]).rotate([1, 0, 0], 180)
    light = {"type": "area", "radiance": radiance}
    return {"type": "rectangle", "to_world": turned.scale(half), "emitter": light}


def textured(value):
    pixels = np.ones((2, 2, 1), np.float32)
    pixels[0, 0] = value
    bitmap = mi.Bitmap(pixels)
    return emitter({"type": "bitmap", "bitmap": bitmap, "raw": True})


def sky(value):
    pixels = np.ones((4, 8, 3), np.float32)
    pixels[0] = value
    return {"type": "envmap", "bitmap": mi.Bitmap(pixels)}


MAKERS = {
    "checkered": checkered,
    "blended": blended,
    "block": block,
    "size": lambda x: emitter(1.0, half=x),
    "texture": textured,
    "sky": sky,
}
EMITTERS = ("size", "texture", "sky")


def measured(specimen, theta_i=30, **settings):
    return gonio.measure(specimen, theta_i, **SETTINGS | settings)


def made(name, value, **settings):
    """Record of a specimen, or of another one in the light of an emitter."""
    one = MAKERS[name](value)
    if name in EMITTERS:
        return measured({"type": "principled"}, emitter=one, **settings)
    return measured(one, **settings)


def interrupted(record):
    """Sums and fates of the first two batches of a record."""
    tally = record.tallies[0]
    first = Tally(
        tally.hits // 2,
        tally.sums[:2],
        tally.incident[:2],
        tally.fates[:2],
        tally.scale,
    )
    return replace(record, tallies=(first,))


@pytest.mark.parametrize("name", MAKERS)
def test_what_differs_is_never_mixed(name, tmp_path):
    """Neither merged, nor resumed, nor in one folder."""
    what = "emitter" if name in EMITTERS else "specimen"
    one, same, other = (
        made(name, value, seed=seed) for seed, value in enumerate((0.2, 0.2, 0.9))
    )
    assert one.merge(same).n_batches == 8
    with pytest.raises(ValueError, match=f"agree in the {what} to be merged"):
        one.merge(other)
    resumed = made(name, 0.2, resume=interrupted(one))
    np.testing.assert_array_equal(resumed.brdf, one.brdf)
    with pytest.raises(ValueError, match=f"it was made with another {what}"):
        made(name, 0.9, resume=interrupted(one))
    folder = {"theta_i": [30], "folder": tmp_path}
    first = made(name, 0.2, **folder)
    assert made(name, 0.2, **folder) == first
    said = "this very campaign" + ", .* with emitter" * (what == "emitter")
    with pytest.raises(ValueError, match=said):
        made(name, 0.9, **folder)


def test_what_differs_is_told_in_words():
    """By the specimens' names, or else their parameters."""
    one = measured({"type": "roughconductor", "alpha": 0.2})
    words = "specimen: roughconductor:alpha=0.2 instead of roughconductor:alpha=0.3"
    with pytest.raises(ValueError, match=words):
        measured({"type": "roughconductor", "alpha": 0.3}, resume=interrupted(one))
    with pytest.raises(ValueError, match=r"=\[0.2\].* instead of .*=\[0.9\]"):
        measured(blended(0.9), resume=interrupted(measured(blended(0.2))))
    other = replace(one, provenance=replace(one.provenance, digest="0"))
    with pytest.raises(ValueError, match="agree in the specimen to be stacked"):
        gonio.Record.stack([one, other])


def test_a_turned_emitter_is_the_same_emitter():
    matt = {"type": "diffuse"}
    stack, alone = (
        measured(matt, theta_i, emitter=emitter(1.0)) for theta_i in ([0, 30, 60], 60)
    )
    for key in ("digest", "emitter_digest"):
        assert stack.settings[key] == alone.settings[key]
    assert measured(matt).settings["emitter_digest"] is None


def digests(name):
    """Of a specimen and of the emitter."""
    settings = made(name, 0.2).settings
    return [settings["digest"], str(settings["emitter_digest"])]


SCRIPT = """
import sys
import gonio_mi as gonio, mitsuba as mi
mi.set_variant("llvm_ad_mono")
sys.path[:0] = sys.argv[1:]
import test_digest
for name in test_digest.MAKERS:
    print(*test_digest.digests(name))
"""


def test_another_process_has_the_same_digests():
    here = [text for name in MAKERS for text in digests(name)]
    folders = [Path(__file__).parent, Path(plain_bsdf.__file__).parent]
    there = subprocess.run(
        [sys.executable, "-c", SCRIPT, *folders],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"PYTHONHASHSEED": "7"},
    )
    assert there.stdout.split() == here
    # of specimens, emitters, the specimen that these light, and of no emitter
    assert len(set(here)) == len(MAKERS) + 2


def test_a_specimen_that_is_measured_again_has_its_digest():
    scene = mi.load_dict({"type": "scene", "block": block(0.2), "e": emitter(1.0)})
    assert len({measured(scene).settings["digest"] for _ in range(3)}) == 1
    before = measured(scene).settings["digest"]
    parameters = mi.traverse(scene)
    parameters["block.bsdf.reflectance.value"] = 0.25
    parameters.update()
    assert measured(scene).settings["digest"] != before


@pytest.fixture
def wordless():
    """BSDF plugin whose text holds an address, as Python's own texts do."""

    class TestWordless(plain_bsdf.plain()):
        def load(self, props):
            self.word = props.get("word", "a")

        def to_string(self):
            return f"Wordless[{object.__repr__(self)}, {self.word}]"

    plain_bsdf.register([TestWordless])


def of_each(specimens):
    return [digest(load_specimen(one).shapes()) for one in specimens]


@pytest.mark.usefixtures("wordless")
def test_addresses_are_no_part_of_it():
    one, same, other = of_each({"type": "test_wordless", "word": w} for w in "aab")
    assert one == same != other


KEPT = {
    "number": lambda value: value,
    "lists": lambda value: [("a", 1.0), (value, None)],
    "array": lambda value: np.full((2, 2), value),
    "jit": lambda value: mi.Float(value),
    "texture": lambda value: mi.load_dict({"type": "uniform", "value": value}),
    "bsdf": lambda value: mi.load_dict({"type": "diffuse", "reflectance": value}),
}


@pytest.mark.parametrize("kind", KEPT)
def test_what_a_plugin_in_python_keeps_is_seen(kind):
    """Records of reflectances 0.5 and 0.8 were merged to 0.65 without a word."""

    class TestSecretive(plain_bsdf.plain()):
        def load(self, props):
            self.kept = KEPT[kind](props.get("reflectance"))

        def to_string(self):
            return "Secretive[]"

    plain_bsdf.register([TestSecretive])
    plain = [{"type": "test_secretive", "reflectance": x} for x in (0.5, 0.5, 0.8)]
    for specimens in (plain, [{"type": "twosided", "bsdf": one} for one in plain]):
        one, same, other = of_each(specimens)
        assert one == same != other


@pytest.mark.usefixtures("wordless")
def test_a_file_that_a_plugin_keeps_is_what_it_holds(tmp_path):
    """Wherever it is: it may be elsewhere on another machine."""
    digests = []
    for name, content in (("a", "1"), ("b", "1"), ("c", "2")):
        path = tmp_path / name
        path.write_text(content)
        plugin = mi.load_dict({"type": "test_wordless"})
        plugin.word, plugin.file = "", str(path)
        digests.append(digest([plugin]))
    assert digests[0] == digests[1] != digests[2]


def test_a_python_file_has_one_digest_in_all_locales(tmp_path, monkeypatch):
    """It is read as Python reads it, and what it imports as UTF-8."""
    plugin, helper = tmp_path / "plugin.py", tmp_path / "helper_in_danish.py"
    source = "# coding: latin-1\nimport helper_in_danish\nNAME = 'Kj\xe6r'\n"
    plugin.write_bytes(source.encode("latin-1"))
    helper.write_text("NAME = 'K\xf8hler'\n", encoding="utf-8")
    own = file_digest(plugin)

    def in_another_locale(path, encoding="ascii", errors="strict"):
        return path.read_bytes().decode(encoding, errors)

    monkeypatch.setattr(Path, "read_text", in_another_locale)
    assert file_digest(plugin) == own
    monkeypatch.undo()
    helper.write_text("NAME = 'K\xe6hler'\n", encoding="utf-8")
    assert file_digest(plugin) != own


@pytest.mark.parametrize(
    "statement",
    ["import {}", "from {} import (\n    NAME,\n)", "from . import (\n    {},\n)"],
)
def test_a_digest_sees_helpers_however_they_are_imported(tmp_path, statement):
    """Exact; the twin: what no statement names may change."""
    plugin, helper = tmp_path / "plugin.py", tmp_path / "the_helper.py"
    plugin.write_text(statement.format("the_helper"))
    other = tmp_path / "another.py"
    digests = []
    for name, text in ((helper, "A = 1"), (other, "A = 1"), (helper, "A = 2")):
        name.write_text(text)
        digests.append(file_digest(plugin))
    assert digests[0] == digests[1] != digests[2]


@pytest.mark.needs("materials")
def test_a_folder_sees_the_files_that_a_specimen_names(tmp_path):
    def groove(depth):
        shape = mi.load_dict(block(depth))
        shape.write_ply(str(tmp_path / "mesh.ply"))

    def picture(value):
        mi.Bitmap(np.full((4, 4, 1), value, np.float32)).write(str(tmp_path / "t.exr"))

    def table(value):
        specimen = {"type": "diffuse", "reflectance": value}
        measured(specimen, [0, 30, 60]).save(tmp_path / "g.npz")

    mesh = '<shape type="ply"><string name="filename" value="mesh.ply"/></shape>'
    (tmp_path / "mesh.xml").write_text(f'<scene version="3.0.0">{mesh}</scene>')
    texture = {"type": "bitmap", "filename": str(tmp_path / "t.exr"), "raw": True}
    for change, specimen in (
        (groove, str(tmp_path / "mesh.xml")),
        (picture, {"type": "diffuse", "reflectance": texture}),
        (table, {"type": "goniometric", "filename": str(tmp_path / "g.npz")}),
    ):
        folder = tmp_path / change.__name__
        change(0.2)
        measured(specimen, [30], folder=folder)
        measured(specimen, [30], folder=folder)
        change(0.9)
        with pytest.raises(ValueError, match="the specimen of specimen was another"):
            measured(specimen, [30], folder=folder)

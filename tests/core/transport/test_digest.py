"""Records of different specimens are never mixed. All is exact."""

import functools
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

import gonio_mi as gonio
from gonio_mi.instrument.loading import load_specimen
from gonio_mi.results.tally import Tally
from gonio_mi.transport.digest import digest, file_digest

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


SPECIMENS = (checkered, blended, block)
EMITTERS = {
    "size": lambda x: emitter(1.0, half=x),
    "texture": textured,
    "sky": sky,
}


def measured(specimen, seed=0, **settings):
    return gonio.measure(specimen, 30, seed=seed, **SETTINGS | settings)


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


@pytest.mark.usefixtures("mono")
@pytest.mark.parametrize("make", SPECIMENS)
def test_different_specimens_cannot_be_mixed(make):
    one, same, other = (measured(make(x), s) for s, x in enumerate((0.2, 0.2, 0.9)))
    assert one.merge(same).n_batches == 8
    with pytest.raises(ValueError, match="agree in the specimen to be merged"):
        one.merge(other)
    with pytest.raises(ValueError, match="agree in the specimen to be stacked"):
        gonio.Record.stack(
            [one, replace(other, provenance=replace(one.provenance, digest="0"))]
        )
    resumed = measured(make(0.2), resume=interrupted(one))
    np.testing.assert_array_equal(resumed.brdf, one.brdf)
    with pytest.raises(ValueError, match="it was made with another specimen"):
        measured(make(0.9), resume=interrupted(one))


@pytest.mark.usefixtures("mono")
def test_what_differs_is_told_in_words():
    """By the specimens' names, or else their parameters."""
    one = measured({"type": "roughconductor", "alpha": 0.2})
    words = "specimen: roughconductor:alpha=0.2 instead of roughconductor:alpha=0.3"
    with pytest.raises(ValueError, match=words):
        measured({"type": "roughconductor", "alpha": 0.3}, resume=interrupted(one))
    with pytest.raises(ValueError, match=r"=\[0.2\].* instead of .*=\[0.9\]"):
        measured(blended(0.9), resume=interrupted(measured(blended(0.2))))


@pytest.mark.usefixtures("mono")
@pytest.mark.parametrize("make", EMITTERS.values(), ids=EMITTERS)
def test_different_emitters_cannot_be_mixed(make):
    matt = {"type": "diffuse"}
    one, same, other = (
        measured(matt, s, emitter=make(x)) for s, x in enumerate((0.2, 0.2, 0.9))
    )
    assert one.merge(same).n_batches == 8
    with pytest.raises(ValueError, match="agree in the emitter to be merged"):
        one.merge(other)
    with pytest.raises(ValueError, match="it was made with another emitter"):
        measured(matt, emitter=make(0.9), resume=interrupted(one))


@pytest.mark.usefixtures("mono")
def test_a_turned_emitter_is_the_same_emitter():
    matt, settings = {"type": "diffuse"}, SETTINGS | {"emitter": emitter(1.0)}
    stack = gonio.measure(matt, [0, 30, 60], **settings)
    alone = gonio.measure(matt, 60, **settings)
    for key in ("digest", "emitter_digest"):
        assert stack.settings[key] == alone.settings[key]
    assert measured(matt).settings["emitter_digest"] is None


SCRIPT = """
import sys
import gonio_mi as gonio, mitsuba as mi
mi.set_variant("llvm_ad_mono")
sys.path.insert(0, sys.argv[1])
import test_digest
for make in test_digest.SPECIMENS:
    print(test_digest.measured(make(0.2)).settings["digest"])
for make in test_digest.EMITTERS.values():
    record = test_digest.measured({"type": "principled"}, emitter=make(0.2))
    print(record.settings["digest"], record.settings["emitter_digest"])
"""


@pytest.mark.usefixtures("mono")
def test_another_process_has_the_same_digests():
    here = [measured(make(0.2)).settings["digest"] for make in SPECIMENS]
    for make in EMITTERS.values():
        settings = measured({"type": "principled"}, emitter=make(0.2)).settings
        here += [settings["digest"], settings["emitter_digest"]]
    there = subprocess.run(
        [sys.executable, "-c", SCRIPT, Path(__file__).parent],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"PYTHONHASHSEED": "7"},
    )
    assert there.stdout.split() == here
    assert len(set(here)) == len(SPECIMENS) + 1 + len(EMITTERS)


@pytest.mark.usefixtures("mono")
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

    class Wordless(mi.BSDF):
        def __init__(self, props):
            super().__init__(props)
            self.diffuse = mi.load_dict({"type": "diffuse"})
            self.m_components = [self.diffuse.flags(0)]
            self.m_flags = self.diffuse.flags()
            self.word = props.get("word", "a")

        def sample(self, *arguments):
            return self.diffuse.sample(*arguments)

        def to_string(self):
            return f"Wordless[{object.__repr__(self)}, {self.word}]"

    mi.register_bsdf("test_wordless", Wordless)


@pytest.mark.usefixtures("mono", "wordless")
def test_addresses_are_no_part_of_it():
    plugins = [{"type": "test_wordless", "word": word} for word in ("a", "a", "b")]
    scenes = [load_specimen(plugin) for plugin in plugins]
    digests = [digest(scene.shapes()) for scene in scenes]
    assert digests[0] == digests[1] != digests[2]


def secretive(kind):
    """Maker of BSDFs in Python that tell Mitsuba nothing, but keep a reflectance."""

    class Secretive(mi.BSDF):
        def __init__(self, props):
            super().__init__(props)
            value = props.get("reflectance")
            self.kept = {
                "number": lambda: value,
                "lists": lambda: [("a", 1.0), (value, None)],
                "array": lambda: np.full((2, 2), value),
                "jit": lambda: mi.Float(value),
                "bsdf": lambda: None,
                "texture": lambda: mi.load_dict({"type": "uniform", "value": value}),
            }[kind]()
            inner = {"type": "uniform", "value": value}
            self.inner = mi.load_dict({"type": "diffuse", "reflectance": inner})
            self.m_components = [self.inner.flags(0)]
            self.m_flags = self.inner.flags()
            if kind != "bsdf":  # not seen: what a function knows
                self.inner = functools.partial(getattr, self.inner)

        def sample(self, *arguments):
            return self.function("sample")(*arguments)

        def eval(self, *arguments):
            return self.function("eval")(*arguments)

        def pdf(self, *arguments):
            return self.function("pdf")(*arguments)

        def function(self, name):
            return getattr(self.inner, name) if kind == "bsdf" else self.inner(name)

        def to_string(self):
            return "Secretive[]"

    mi.register_bsdf(f"test_secretive_{kind}", Secretive)
    return lambda value: {"type": f"test_secretive_{kind}", "reflectance": value}


@pytest.mark.usefixtures("mono")
@pytest.mark.parametrize("kind", ["number", "lists", "array", "jit", "texture", "bsdf"])
def test_what_a_plugin_in_python_keeps_is_seen(kind):
    """Records of reflectances 0.5 and 0.8 were merged to 0.65 without a word."""
    make = secretive(kind)
    for nest in (lambda bsdf: bsdf, lambda bsdf: {"type": "twosided", "bsdf": bsdf}):
        one, same, other = (
            measured(nest(make(value)), seed)
            for seed, value in enumerate((0.5, 0.5, 0.8))
        )
        assert one.merge(same).n_batches == 8
        with pytest.raises(ValueError, match="agree in the specimen to be merged"):
            one.merge(other)


@pytest.mark.usefixtures("mono", "wordless")
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


@pytest.mark.usefixtures("mono")
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


def test_a_folder_sees_the_data_of_bitmaps(tmp_path):
    for make in SPECIMENS:
        folder = tmp_path / make.__name__
        first = gonio.measure(make(0.2), [30], **SETTINGS, folder=folder)
        again = gonio.measure(make(0.2), [30], **SETTINGS, folder=folder)
        assert again == first
        with pytest.raises(ValueError, match="must hold this very campaign"):
            gonio.measure(make(0.9), [30], **SETTINGS, folder=folder)


@pytest.mark.needs("materials")
@pytest.mark.usefixtures("mono")
def test_a_folder_sees_the_files_that_a_specimen_names(tmp_path):
    def groove(depth):
        shape = mi.load_dict(block(depth))
        shape.write_ply(str(tmp_path / "mesh.ply"))

    def picture(value):
        mi.Bitmap(np.full((4, 4, 1), value, np.float32)).write(str(tmp_path / "t.exr"))

    def table(value):
        angles = {"theta_i": [0, 30, 60]}
        specimen = {"type": "diffuse", "reflectance": value}
        gonio.measure(specimen, **angles, **SETTINGS).save(tmp_path / "g.npz")

    mesh = '<shape type="ply"><string name="filename" value="mesh.ply"/></shape>'
    (tmp_path / "mesh.xml").write_text(f'<scene version="3.0.0">{mesh}</scene>')
    texture = {"type": "bitmap", "filename": str(tmp_path / "t.exr"), "raw": True}
    for change, specimen in (
        (groove, str(tmp_path / "mesh.xml")),
        (picture, {"type": "diffuse", "reflectance": texture}),
        (table, {"type": "goniometric", "filename": str(tmp_path / "g.npz")}),
    ):
        settings = SETTINGS | {"folder": tmp_path / change.__name__}
        change(0.2)
        gonio.measure(specimen, [30], **settings)
        gonio.measure(specimen, [30], **settings)
        change(0.9)
        with pytest.raises(ValueError, match="the specimen of specimen was another"):
            gonio.measure(specimen, [30], **settings)


@pytest.mark.usefixtures("mono")
def test_a_folder_sees_the_data_of_emitters(tmp_path):
    settings = SETTINGS | {"folder": tmp_path}
    matt = {"type": "diffuse"}
    gonio.measure(matt, [0, 30], **settings, emitter=textured(0.2))
    gonio.measure(matt, [0, 30], **settings, emitter=textured(0.2))
    with pytest.raises(ValueError, match=r"very campaign, .* with emitter"):
        gonio.measure(matt, [0, 30], **settings, emitter=textured(0.9))

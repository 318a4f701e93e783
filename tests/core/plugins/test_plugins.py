"""The plugins live through changes of variant and refuse what they cannot do."""

import ast
import importlib
import inspect
import re
import subprocess
import sys

import mitsuba as mi
import numpy as np
import pytest

import gonio_mi as gonio
from gonio_mi import kernels
from gonio_mi.kernels import registered_by_others


def scene():
    return {
        "type": "scene",
        "integrator": {"type": "goniophotometer", "rays": 10_000},
        "sensor": {"type": "collector", "film": {"type": "patches"}},
        "emitter": {"type": "directional", "direction": [0, 0, -1]},
        "shape": {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": 0.5}},
    }


def test_change_of_variant_there_and_back():
    first = gonio.measure({"type": "diffuse"}, 30, rays=10_000)
    for name in ("llvm_ad_rgb", "llvm_ad_spectral", "llvm_ad_mono"):
        mi.set_variant(name)
        image = np.array(mi.render(mi.load_dict(scene())))
        # an achromatic specimen has one channel in each of them
        assert image.shape == (30, 30, 1)
        record = gonio.measure({"type": "diffuse", "reflectance": 0.5}, 0, rays=10_000)
        # exact in mono; a spectrum of 0.5 is so to single precision
        expected = 0.5 * record.ledger.reflected / record.ledger.emitted
        assert np.all(np.abs(record.dhr - expected) <= 2.0**-22)
    again = gonio.measure({"type": "diffuse"}, 30, rays=10_000)
    assert again.tallies == first.tallies


@pytest.mark.parametrize("order", ["before", "after"])
def test_import_before_or_after_set_variant(order):
    lines = ["import mitsuba as mi", "mi.set_variant('llvm_ad_mono')"]
    lines.insert(0 if order == "before" else 2, "import gonio_mi")
    lines.append("print(mi.load_dict({'type': 'patches'}).subdivision)")
    assert said(lines) == "projected:30x30"


def test_modules_are_run_when_a_plugin_is_first_made():
    """Not by a variant, and once for each in which one is made, in any thread."""
    kinds = "cosinelobe", "glossymixture", "anisotropicphong"
    lines = [
        "import sys, gonio_mi, mitsuba as mi",
        "def run(): return sum('.plugins.bsdfs.' in name for name in sys.modules)",
        f"scene = {{str(i): {{'type': 'sphere', 'bsdf': {{'type': {kinds}[i % 3]}}}}",
        "         for i in range(24)}",
        "counts, classes = [], set()",
        "for variant in ('llvm_ad_mono', 'llvm_ad_rgb', 'llvm_ad_mono'):",
        "    mi.set_variant(variant)",
        "    counts.append(run())",
        "    shapes = mi.load_dict({'type': 'scene'} | scene).shapes()",
        "    classes |= {type(shape.bsdf()) for shape in shapes}",
        "print(counts, run(), len(classes))",
    ]
    assert said(lines) == "[0, 3, 3] 3 9"


def test_a_class_that_is_imported_is_that_of_the_plugins():
    """Before the first one is made, and after a change of variant."""
    lines = [
        "import gonio_mi, mitsuba as mi",
        "alike = []",
        "for variant in ('llvm_ad_mono', 'llvm_ad_rgb', 'llvm_ad_mono'):",
        "    mi.set_variant(variant)",
        "    from gonio_mi.plugins.bsdfs.cosinelobe import CosineLobe",
        "    alike.append(issubclass(CosineLobe, mi.BSDF))",
        "    alike.append(type(mi.load_dict({'type': 'cosinelobe'})) is CosineLobe)",
        "print(alike)",
    ]
    assert said(lines) == str([True] * 6)


def said(lines):
    """What a process prints that runs some lines."""
    command = [sys.executable, "-c", "\n".join(lines)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return done.stdout.strip()


@pytest.mark.parametrize(
    ("given", "named"), [((), {}), ((["a"], print), {}), (("a",), {"factory": print})]
)
def test_what_cannot_be_registered_is_said_in_words_of_mitsuba(given, named):
    before = set(registered_by_others)
    with pytest.raises(TypeError, match="incompatible function arguments"):
        mi.register_bsdf(*given, **named)
    assert registered_by_others == before


def test_plugins_that_are_registered_are_noted(monkeypatch):
    """By the function of Mitsuba and of its variant, and none of ours."""
    noted = set()
    monkeypatch.setattr(kernels, "registered_by_others", noted)
    importlib.reload(gonio.plugins)
    mi.register_bsdf("test_noted", print)
    mi.register_bsdf(name="test_named", constructor=print)
    of_variant = sys.modules[f"mitsuba.{mi.variant()}"]
    of_variant.register_bsdf("test_of_variant", print)
    assert noted == {"test_noted", "test_named", "test_of_variant"}


@pytest.mark.parametrize("name", ["scalar_rgb", "scalar_mono"])
def test_other_variants_are_refused_in_a_sentence(name):
    if name not in mi.variants():
        pytest.skip("not in this build")
    mi.set_variant(name)
    with pytest.raises((gonio.VariantError, gonio.SpecimenError), match="llvm or cuda"):
        gonio.measure({"type": "diffuse"}, 30, rays=10)


def test_no_variant_is_said():
    code = "import gonio_mi", "try: gonio_mi.measure({'type': 'diffuse'}, 30)"
    told = said([*code, "except gonio_mi.VariantError as error: print(error)"])
    assert "a Mitsuba variant must be set first" in told


@pytest.mark.parametrize(
    ("plugin", "name", "value"),
    [
        ("goniophotometer", "rays", 0),
        ("goniophotometer", "batches", 0),
        ("goniophotometer", "estimator", "best"),
        ("goniophotometer", "footprint", -1.0),
        ("goniophotometer", "emission", "equal"),
        ("goniophotometer", "max_depth", 0),
        ("patches", "subdivision", "projected"),
        ("patches", "hemispheres", "lower"),
        ("collector", "radius", -1.0),
    ],
)
def test_bad_parameters_are_named(plugin, name, value):
    settings = {"type": plugin, name: value}
    if plugin == "collector":
        settings["film"] = {"type": "patches"}
    with pytest.raises(RuntimeError, match=str(value)):
        mi.load_dict(settings)


def test_foreign_sensor_and_film_are_refused():
    wrong = scene() | {"sensor": {"type": "perspective"}}
    with pytest.raises(RuntimeError) as caught:
        mi.render(mi.load_dict(wrong))
    # Mitsuba's own wrapper stands between the error and the caller
    assert "needs a sensor of type collector" in str(caught.value.__cause__)
    with pytest.raises(RuntimeError, match="film must be of type patches"):
        mi.load_dict({"type": "collector", "film": {"type": "hdrfilm"}})


def test_collectors_load_nothing_while_a_scene_is_loaded(monkeypatch):
    """A nested load frees the paths in which Mitsuba's other threads look for files."""
    load_dict = mi.load_dict
    monkeypatch.setattr(mi, "load_dict", lambda *_: pytest.fail("a nested load"))
    collector = load_dict({"type": "collector", "film": {"type": "patches"}})
    assert "Sobol" in str(collector.sampler())


@pytest.mark.parametrize("theta_i", [90, 90.001, -1, float("nan")])
def test_angles_out_of_range_are_refused(theta_i):
    with pytest.raises(ValueError, match="theta_i must be"):
        gonio.measure({"type": "diffuse"}, theta_i)


@pytest.mark.parametrize(
    ("plugin", "of"),
    [
        ("cosinelobe", None),
        ("glossymixture", None),
        ("anisotropicphong", None),
        ("heightfield", "gonio_mi.plugins.shapes.heightfield"),
    ],
)
def test_examples_of_manual_pages_load_and_are_the_same(plugin, of):
    """The scene file and the dictionary of a docstring, word for word."""
    if of is None:
        manual = type(mi.load_dict({"type": plugin})).__doc__
    else:
        made = vars(importlib.import_module(of)).values()
        manual = next(x.__doc__ for x in made if "code-tab" in str(x.__doc__))
    file, python = re.split(r".. code-tab:: \w+\n", inspect.cleandoc(manual))[1:]
    loaded = mi.load_string(file.strip().replace(">", ' version="3.0.0">', 1))
    assert str(loaded) == str(mi.load_dict(ast.literal_eval("{" + python + "}")))


@pytest.mark.needs("materials")
def test_goniometric_asks_for_arrays(tmp_path):
    """In a scalar variant it says so, in one sentence."""
    mi.set_variant("scalar_rgb")
    with pytest.raises(RuntimeError, match="needs a variant that computes with"):
        mi.load_dict({"type": "goniometric", "filename": str(tmp_path / "a.npz")})

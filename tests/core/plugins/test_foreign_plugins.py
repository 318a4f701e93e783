"""Plugins in Python as others write them: what works in Mitsuba is measured.

What does not is said in one sentence that is true, and never as a bug of ours.
"""

import os
import sys
import threading

import mitsuba as mi
import pytest

import gonio_mi as gonio
from gonio_mi import cli
from gonio_mi.quadrature import evaluator
from gonio_mi.specimen import specimen
from gonio_mi.specimen.loading import load_plugin_file
from gonio_mi.specimen.scene_objects import traversed
from gonio_mi.threads import two_threads
from gonio_mi.transport import launch

ALBEDO = 0.625  # exact in binary: so are its sums over rays of one weight

# Lambertian BSDFs. The first looks into its arguments, the second has colours only;
# others forget something, or answer without a form.
PLUGINS = """
import os
import threading
import drjit as dr
import mitsuba as mi
import numpy as np
sys_path_entry = os.path.dirname(__file__)
import sys
sys.path.insert(0, sys_path_entry + "/helpers")
from lookup import weight_of

class Matte(mi.BSDF):
    def __init__(self, props):
        super().__init__(props)
        self.m_flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide
        self.m_components = [self.m_flags]

    def weight(self, si, wo):
        return mi.Spectrum(0.625)

    def sample(self, ctx, si, sample1, sample2, active):
        bs = dr.zeros(mi.BSDFSample3f)
        bs.wo = mi.warp.square_to_cosine_hemisphere(sample2)
        bs.pdf, bs.eta = mi.warp.square_to_cosine_hemisphere_pdf(bs.wo), 1.0
        bs.sampled_type = mi.UInt32(+mi.BSDFFlags.DiffuseReflection)
        return bs, self.weight(si, bs.wo)

    def eval(self, ctx, si, wo, active):
        return self.weight(si, wo) * dr.inv_pi * dr.maximum(wo.z, 0)

    def pdf(self, ctx, si, wo, active):
        return mi.warp.square_to_cosine_hemisphere_pdf(wo)

    def to_string(self):
        return "Matte[]"

class Looked(Matte):
    def weight(self, si, wo):
        arrays = [np.array(one).T for one in (si.wi, wo, si.uv, si.p)]
        return mi.Spectrum(mi.Float(weight_of(np.concatenate(arrays, axis=1))))

class Coloured(Matte):
    def weight(self, si, wo):
        return mi.Color3f(0.625)

class ColouredInside(Matte):
    def weight(self, si, wo):
        return mi.Spectrum([0.1, 0.2, 0.3])

class Helped(Matte):
    def weight(self, si, wo):
        return weight_of(None)

class Voiceless(Matte):
    def to_string(self):
        return nowhere

class Listed(Matte):
    def weight(self, si, wo):
        return [mi.Float(0.625)] * 3

    def eval(self, ctx, si, wo, active):
        return [one * dr.inv_pi * dr.maximum(wo.z, 0) for one in self.weight(si, wo)]

class Empty(Matte):
    def sample(self, ctx, si, sample1, sample2, active):
        return mi.BSDFSample3f(), 0.0

class Untraversed(Matte):
    def traverse(self, callback):
        callback.put_old("weight", 0.625)

class Nesting(Matte):
    built_by = []
    beside_another = threading.Barrier(1)

    def __init__(self, props):
        super().__init__(props)
        self.beside_another.wait(60)
        self.built_by.append(threading.get_ident())
        self.ground = mi.load_dict({"type": "diffuse"})

class Lacking(mi.BSDF):
    def to_string(self):
        return "Lacking[]"

for kind in (Matte, Looked, Coloured, ColouredInside, Helped, Voiceless, Listed, Empty,
             Untraversed, Nesting, Lacking):
    mi.register_bsdf("foreign_" + kind.__name__.lower(), kind)
"""

LOOKUP = """
def weight_of(array):
    return 0 * array[:, 0] + 0.625
"""


@pytest.fixture
def plugin(tmp_path):
    """Path of a plugin file that finds a module of its own by its ``__file__``."""
    (tmp_path / "helpers").mkdir()
    (tmp_path / "helpers" / "lookup.py").write_text(LOOKUP)
    path = tmp_path / "foreign.py"
    path.write_text(PLUGINS)
    return path


@pytest.fixture
def refusal(plugin, capsys, monkeypatch):
    """Function that returns the sentence by which a plugin's measurement is refused."""

    def refusal(name, *options):
        monkeypatch.chdir(plugin.parent)  # its file is named without a folder
        words = ["measure", f"foreign_{name}", "--theta-i", "30", "--rays", "1e4"]
        assert cli.main([*words, "--plugin", plugin.name, *options]) == 1
        err = capsys.readouterr().err
        assert err.count("\n") == 1
        assert "this is a bug" not in err
        return err

    return refusal


def dhr(specimen, **settings):
    """Reflectance at one angle; exact where each ray has the same weight."""
    settings = {"rays": 4096, "collector": "projected:2x4"} | settings
    return gonio.measure(specimen, theta_i=30, **settings).dhr


LOOKED = {"type": "foreign_looked"}


@pytest.mark.parametrize("footprint", ["full", "point"])
@pytest.mark.parametrize("estimator", ["weighted", "analog"])
@pytest.mark.parametrize("of", [LOOKED, {"type": "twosided", "nested": LOOKED}])
def test_plugins_may_look_into_their_arguments(of, estimator, footprint, plugin, rgb):  # noqa: ARG001
    """Exact for weights; an analog count is that of its own rays."""
    load_plugin_file(plugin)
    found = dhr(of, estimator=estimator, footprint=footprint)
    if estimator == "weighted":
        assert found == pytest.approx(ALBEDO, rel=2**-40)
    else:
        assert (found > 0).all()


def test_a_file_that_sets_its_own_variant_is_told(tmp_path, rgb):  # noqa: ARG001
    """As most files in public do; the twin sets the one that is set."""
    path = tmp_path / "sets.py"
    path.write_text("import mitsuba as mi\nmi.set_variant('llvm_ad_mono')\n")
    told = "sets the variant llvm_ad_mono, instead of llvm_ad_rgb"
    with pytest.warns(RuntimeWarning, match=told):
        load_plugin_file(path)
    assert mi.variant() == "llvm_ad_mono"
    load_plugin_file(path)
    path.write_text("raise ImportError('jit_init(): the CUDA backend is not there')\n")
    with pytest.raises(gonio.SpecimenError, match=r"; leave out its mi\.set_variant$"):
        load_plugin_file(path)
    path.write_text("raise ImportError('no backend')\n")
    with pytest.raises(gonio.SpecimenError, match=r"no backend \(sets\.py, line 1\)$"):
        load_plugin_file(path)


POSTPONED = """from __future__ import annotations
from dataclasses import dataclass
import mitsuba as mi
from .tints import TINT

@dataclass
class Tint:
    value: float = TINT

class Tinted(mi.BSDF):
    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.ground = mi.load_dict({"type": "diffuse", "reflectance": Tint().value})
        self.m_components = [self.ground.flags()]
        self.m_flags = self.ground.flags()

    def sample(self, *asked): return self.ground.sample(*asked)
    def eval(self, *asked): return self.ground.eval(*asked)
    def pdf(self, *asked): return self.ground.pdf(*asked)
    def eval_pdf(self, *asked): return self.ground.eval_pdf(*asked)

mi.register_bsdf("foreign_tinted", Tinted)
"""


@pytest.mark.parametrize("named", ["a file", "a package"])
def test_files_of_a_package(named, tmp_path, rgb):  # noqa: ARG001
    """Exact: relative imports, dataclasses with postponed annotations; path as before.

    The twin: a folder that is no package.
    """
    folder, before = tmp_path / "tinting", list(sys.path)
    folder.mkdir()
    (folder / "tinted.py").write_text(POSTPONED)
    for tint in (0.25, 0.5):  # as it is now, not as it was imported
        (folder / "tints.py").write_text(f"TINT = {tint}\n")
        if named == "a file":
            load_plugin_file(folder / "tinted.py")
        else:
            with pytest.raises(gonio.SpecimenError, match=r"has no __init__\.py$"):
                load_plugin_file(folder)
            (folder / "__init__.py").write_text("from . import tinted\n")
            load_plugin_file(folder)
            (folder / "__init__.py").unlink()
        assert dhr({"type": "foreign_tinted"}) == pytest.approx(tint, rel=2**-20)
    assert set(sys.path) - set(before) == {str(folder)}
    sys.path[:] = before


def test_names_that_files_register(plugin, rgb, tmp_path):  # noqa: ARG001
    """Near ones are told of a typo; one of Mitsuba's own is refused."""
    load_plugin_file(plugin)
    path = tmp_path / "tinged.py"
    path.write_text(POSTPONED.replace("tinted", "tinged").replace("from .", "# "))
    with pytest.raises(gonio.SpecimenError, match="TINT"):
        load_plugin_file(path)
    with pytest.raises(gonio.SpecimenError, match=r"did you mean foreign_tinged\?$"):
        dhr({"type": "foreign_tingd"})
    path.write_text(POSTPONED.replace("foreign_tinted", "diffuse"))
    with pytest.raises(gonio.SpecimenError, match="another name than diffuse, which"):
        load_plugin_file(path)


def test_integrals_of_plugins_that_look_into_their_arguments(plugin, rgb):  # noqa: ARG001
    """Rounding: single precision of values that are summed in double precision."""
    load_plugin_file(plugin)
    found = dhr(LOOKED, estimator="quadrature", rays=None)
    assert found == pytest.approx(ALBEDO, rel=2**-20)


def test_what_rays_share_would_be_too_short(plugin, rgb, monkeypatch):  # noqa: ARG001
    """The twin: without copies for each ray the plugin's own code fails."""
    load_plugin_file(plugin)
    for module in (specimen, evaluator):
        monkeypatch.setattr(module, "holds_foreign_plugins", lambda _: False)
    # nor has anything in the loop of a lane's rays a value
    with pytest.raises(RuntimeError, match="side effect"):
        dhr(LOOKED)
    monkeypatch.setattr(launch, "_shares_words", lambda _: False)
    with pytest.raises(ValueError, match="dimensions"):
        dhr(LOOKED)


@pytest.mark.parametrize("name", ["voiceless", "listed", "untraversed"])
def test_what_mitsuba_renders_is_measured(name, plugin, rgb):  # noqa: ARG001
    """No description or traversal is needed; a list of channels is a spectrum."""
    load_plugin_file(plugin)
    of = {"type": f"foreign_{name}"}
    assert dhr(of) == pytest.approx(ALBEDO, rel=2**-40)
    integral = dhr(of, estimator="quadrature", rays=None)
    assert integral == pytest.approx(ALBEDO, rel=2**-20)


def test_a_plugin_that_cannot_be_traversed_keeps_its_method(plugin, rgb):  # noqa: ARG001
    """What a verdict tells of it, and Mitsuba, is not hidden."""
    load_plugin_file(plugin)
    bsdf = mi.load_dict({"type": "foreign_untraversed"})
    held = mi.load_dict({"type": "twosided", "nested": bsdf})
    assert traversed(held).hierarchy
    with pytest.raises(AttributeError, match="put_old"):
        mi.traverse(bsdf)


@pytest.mark.parametrize("options", [(), ("--estimator", "quadrature"), ("--trace",)])
@pytest.mark.parametrize("name", ["coloured", "colouredinside"])
def test_plugins_of_other_variants_are_told_theirs(refusal, name, options):
    said = refusal(name, *options)
    assert "Color1f" in said
    assert "; another variant may do (llvm_ad_rgb, llvm_ad_spectral)" in said


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("helped", "lookup.py, line 3, in weight_of: TypeError: 'NoneType'"),
        ("lacking", "the BSDF Lacking must have the method sample"),
        ("listed", "`sample` must return a Color1f, got a list of 3; another variant"),
        ("empty", "`sample` must return one value per ray, 1, got 0\n"),
    ],
)
def test_plugins_that_fail_are_named_with_their_line(refusal, name, words):
    assert words in refusal(name)


def test_lines_of_installed_packages_are_not_the_users(plugin, refusal):
    """Wherever these are: the line is that of the file which calls them."""
    (plugin.parent / "helpers").rename(plugin.parent / "site-packages")
    plugin.write_text(PLUGINS.replace("/helpers", "/site-packages"))
    assert "foreign.py, line " in refusal("helped")


def test_plugins_that_look_into_recorded_arguments_are_named(refusal):
    """In geometry rays are followed by recorded code, where NumPy has no values."""
    assert "foreign.py, line " in refusal("looked", "--trace")


@pytest.mark.needs("validation")
def test_a_verdict_names_the_method_that_is_missing(plugin, rgb):  # noqa: ARG001
    load_plugin_file(plugin)
    verdict = gonio.validate({"type": "foreign_lacking"}, effort="quick")
    assert (verdict.function, verdict.mistake) == ("sample", "`sample` is missing")


def test_a_plugin_file_that_raises_tells_the_line(plugin, refusal):
    plugin.write_text("import mitsuba\n\nraise RuntimeError('not here')\n")
    assert "raised RuntimeError: not here (foreign.py, line 3)" in refusal("matte")


def test_a_module_is_run_as_it_is_now(tmp_path, monkeypatch, rgb):  # noqa: ARG001
    """However soon after the last time it was edited, or written beside others."""
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    monkeypatch.setattr(sys, "path", sys.path[:])
    plugin = tmp_path / "plugin.py"

    def run(name, number):
        """Run a plugin file that imports a module, all of the same second."""
        plugin.write_text(f"import {name}\n")
        (tmp_path / f"{name}.py").write_text(f"NUMBER = {number}\n")
        for path in (tmp_path / f"{name}.py", tmp_path):
            os.utime(path, (1e9, 1e9))
        load_plugin_file(plugin)
        return sys.modules[name].NUMBER

    assert [run("edited_module", number) for number in (1, 2)] == [1, 2]
    assert run("another_module", 3) == 3
    assert not sys.dont_write_bytecode  # it is as it was


def test_our_own_bugs_stay_ours(plugin, monkeypatch, capsys, tmp_path):
    """The twin: an error of ours beside a plugin file that took no part in it."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))  # where what a report needs is kept
    monkeypatch.setattr("tempfile.tempdir", None)
    # what is called with it fails in a line of ours
    monkeypatch.setattr("gonio_mi.specimen.specimen.check_works", None)
    words = ["measure", "foreign_matte", "--theta-i", "30", "--plugin", str(plugin)]
    assert cli.main(words) == 1
    assert "this is a bug of gonio-mi" in capsys.readouterr().err


def test_plugins_are_built_one_after_another(plugin, tmp_path):
    """In other threads, files are looked for in paths that a nested load has freed."""
    load_plugin_file(plugin)
    nesting = type(mi.load_dict({"type": "foreign_nesting"}))
    scene = tmp_path / "scene.xml"
    nested = '<float name="weight" value="0.5"/>' + 2 * '<bsdf type="foreign_nesting"/>'
    scene.write_text(
        '<scene version="3.0.0"><shape type="rectangle">'
        f'<bsdf type="blendbsdf">{nested}</bsdf></shape></scene>'
    )
    nesting.built_by.clear()
    dhr(scene)
    assert {*nesting.built_by} == {threading.get_ident()}
    # Mitsuba's default: two are built at once, each in a thread of its own
    nesting.built_by.clear()
    nesting.beside_another = threading.Barrier(2)
    with two_threads():
        mi.load_file(str(scene), optimize=False)  # two nodes remain
    assert len({*nesting.built_by}) == 2

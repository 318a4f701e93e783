# ruff: noqa: ARG002 (every method has Mitsuba's signature)
"""Reproducers: those of the handbook still show each defect, those of findings do."""

import ast
import builtins
import importlib
import inspect
from dataclasses import replace
from pathlib import Path

import broken_bsdfs
import drjit as dr
import mitsuba as mi
import numpy as np
import plain_bsdf
import polarised_bsdfs
import pytest
from broken_bsdfs import judged
from reproduced import code_of, is_short, told

from gonio_mi import cli, validation
from gonio_mi.errors import SettingError
from gonio_mi.single_precision import BSDF_ROUNDING
from gonio_mi.validation import (
    PROPERTIES,
    Property,
    Verdict,
    reproducer,
    save_report,
    validate,
)
from gonio_mi.validation.arrays import of_eval, of_pdf
from gonio_mi.validation.checks.frames import JUMP
from gonio_mi.validation.checks.sampled_pdf import sampled_pdf
from gonio_mi.validation.densities import directions
from gonio_mi.validation.judgements import apart
from gonio_mi.validation.mistakes import Claim
from gonio_mi.validation.questions import OF_SURFACES
from gonio_mi.validation.reproducers import script

ROOT = Path(validation.__file__).parents[2]
HANDBOOK = sorted(Path(__file__).parents[2].glob("notebooks/reproducers/*.py"))


@pytest.mark.parametrize("path", HANDBOOK, ids=lambda path: path.stem)
def test_defect_of_the_installed_mitsuba(path):
    """If this fails, Mitsuba has mended it, and the table of stock plugins must go."""
    text = path.read_text(encoding="utf-8")
    assert "gonio" not in text
    assert len(code_of(text)) <= 20
    assert told(text) > 1


# The same where there is no defect, by a change of the script.
MENDED = {
    "blendbsdf_gradients": ('"weight.value"', '"bsdf_0.specular_reflectance.value"'),
    "plastic_gradients": ('"plastic"', '"conductor"'),
    "thindielectric_gradients": ('"eta"', '"specular_reflectance.value"'),
    "beckmann_density": ('"alpha"', '"distribution": "ggx", "alpha"'),
    "bumpmap_polarisation": ("0.3 * x + 0.2 * y", "0 * x"),
    "conductor_all_normals": ("False", "True"),
    "hair_density": ('"hair", "sigma_a": 0.0', '"diffuse"'),
    "hair_in_mono": ('("llvm_ad_mono", ', "("),
    "measured_polarized_straight_back": ("si, si.wi)", "si, mi.Vector3f(0, 0, 1))"),
    "normalmap_polarisation": ("= mi.Normal3f(0.5, 0.1, ", "= mi.Normal3f(0, 0, 1 or "),
    "principledthin_types": ("principledthin", "roughplastic"),
    "retarder_jump": ("mi.Vector3f(0.6, y, 0.8)", "mi.Vector3f(0.6, 0.1, 0.8)"),
    "rough_glass_all_normals": ("False", "True"),
    "roughplastic_below_the_horizon": (
        '"roughplastic", "alpha": 0.3, "distribution": "ggx"',
        '"diffuse"',
    ),
    "twosided_polarisation": ("-0.6)", "0.6)"),
}

# The same defect in other parameters.
ALSO = {
    "conductor_all_normals": ('"alpha"', '"distribution": "ggx", "alpha"'),
    "retarder_jump": (', "theta": 20.0', ""),
    "roughplastic_gradients": ('params["alpha"]', 'params["eta"]'),
}


@pytest.mark.parametrize(
    ("name", "changes", "remains"),
    [(*one, False) for one in MENDED.items()] + [(*one, True) for one in ALSO.items()],
)
def test_a_script_says_whether_a_defect_is_there(name, changes, remains):
    text = next(one for one in HANDBOOK if one.stem == name).read_text(encoding="utf-8")
    changed = text.replace(*changes)
    assert changed != text
    assert (told(changed) > 1) == remains


# Of each broken plugin all properties that fail, the worst first.
FAIL = {
    "eval_nan_at_grazing": "answers ends sampled_weight reciprocity",
    "eval_without_cosine": "reciprocity sampled_weight weights energy",
    "pdf_uniform": "sampled_pdf sampling",
    "sample_not_unit": "directions ends weights sampling",
    "eval_without_pi": "sampled_weight weights energy",
    "eval_ignores_active": "masks",
    "discrete_pdf_not_probability": "delta components",
    "flags_of_another_lobe": "flags",
    "eval_ignores_component": "components sampled_weight weights",
    "eval_other_at_normal": "continuity reciprocity",
    "importance_with_eta2": "reciprocity adjoint",
    "gradient_detached": "parameters",
    "eval_pdf_of_one_lobe": "eval_pdf eval_pdf_sample",
    "eval_pdf_sample_without_cosine": "eval_pdf_sample",
}

# By which of them each property is shown; `cost` never fails.
SHOWN = {
    "answers": "eval_nan_at_grazing",
    "directions": "sample_not_unit",
    "sampling": "pdf_uniform",
    "weights": "eval_without_cosine",
    "sampled_pdf": "pdf_uniform",
    "sampled_weight": "eval_without_cosine",
    "eval_pdf": "eval_pdf_of_one_lobe",
    "eval_pdf_sample": "eval_pdf_sample_without_cosine",
    "energy": "eval_without_pi",
    "continuity": "eval_other_at_normal",
    "reciprocity": "eval_without_cosine",
    "reciprocity of a lobe": "importance_with_eta2",
    "adjoint": "importance_with_eta2",
    "delta": "discrete_pdf_not_probability",
    "flags": "flags_of_another_lobe",
    "components": "eval_ignores_component",
    "masks": "eval_ignores_active",
    "ends": "eval_nan_at_grazing",
    "parameters": "gradient_detached",
}


@pytest.fixture
def plugins(mono):
    broken_bsdfs.register()
    return mono


@pytest.mark.usefixtures("plugins")
def test_each_property_has_a_broken_plugin_and_a_right_one():
    """It fails with what it explains, and nothing else; so do no right ones."""
    assert {name.partition(" ")[0] for name in SHOWN} == PROPERTIES.keys() - {"cost"}
    for name, failing in FAIL.items():
        verdict = judged(name, "quick")
        assert [one.name for one in verdict.failures] == failing.split(), str(verdict)
    for name in ("mixture", "glass", "grey"):
        assert not judged(name, "quick").failures
    held = {one.name for one in judged("mixture", "quick").properties}
    assert held == PROPERTIES.keys()


@pytest.mark.parametrize("shown", SHOWN)
@pytest.mark.usefixtures("plugins")
def test_finding_is_shown_by_its_script(shown):
    name, _, _ = shown.partition(" ")
    text = reproducer(judged(SHOWN[shown], "quick"), name)
    assert is_short(text), text
    assert told(text) > 1, text


# The same of Mueller matrices, and a right plugin, of which the script must say so.
SHOWN_MATRICES = {
    "sample_not_turned": (("sampled_weight",), "facets"),
    "incident_not_turned": (("frames", "reciprocity"), "facets"),
    "handedness_flipped": (("realisable",), "facets"),
    "radiance_depolarises": (("adjoint",), "facets"),
    "polarizer_twice_as_bright": (("first_element", "energy"), "polarizer"),
    "retarder": (("frames", "adjoint"), "polarizer"),
    "sample_mode_ignored": (("sampled_weight",), "facets"),
    "radiance_off": (("first_element",), "facets"),
    "world_frames": (("frames",), "facets"),
    "sample_depolarises_somewhere": (("sampled_weight",), "facets"),
}


@pytest.fixture(scope="module")
def matrices():
    """Register plugins of matrices, in both variants that judge them."""
    for variant in ("llvm_ad_mono", "llvm_ad_mono_polarized"):
        mi.set_variant(variant)
        polarised_bsdfs.register()


@pytest.mark.parametrize("name", SHOWN_MATRICES)
@pytest.mark.usefixtures("matrices", "polarised")
def test_finding_of_matrices_is_shown_by_its_script(name):
    wrong = {"type": name} | ({"theta": 20.0} if name == "retarder" else {})
    verdict = validate(wrong, effort="quick", strict=True)
    findings, right = SHOWN_MATRICES[name]
    for finding in findings:
        text = reproducer(verdict, finding)
        assert is_short(text), text
        assert told(text) > 1, text
        assert told(text.replace(f'"{name}"', f'"{right}"')) < 1, text


@pytest.mark.usefixtures("matrices", "polarised")
def test_jump_of_matrices_is_shown_by_its_script():
    """Near wo = wi the frame of a facet is that of a small, rounded sine."""
    verdict = validate({"type": "r_p_wrong"}, effort="quick")
    text = reproducer(verdict, "frames")
    mended = text.replace('"r_p_wrong"', '"r_p_right"')
    assert told(text) > JUMP / BSDF_ROUNDING > told(mended)


def register_pairs():
    """Register plugins whose mistake shows only in some answers, and right twins."""
    plain = plain_bsdf.plain()

    class Coloured(plain):
        colours, others = (0.8, 0.5, 0.2), (0.8, 0.5, 0.2)

        def value(self, ctx, si, wo):
            return mi.Color3f(*self.colours) * dr.inv_pi * wo.z

        def weight(self, ctx, si, bs):
            return mi.Color3f(*self.others)

    class OtherColours(Coloured):
        others = (0.2, 0.5, 0.8)

    class EachRay(plain):
        def value(self, ctx, si, wo):
            first = self.of(si.wi.z)
            return plain.value(self, ctx, si, wo) * (0.9 + 0.2 * first)

        def of(self, cosine):
            return cosine

    class FirstRay(EachRay):
        def of(self, cosine):
            return float(np.ravel(np.array(cosine))[0])

    class Mixture(plain):
        """Of two powers of the cosine, whose share is kept where it is `stale`."""

        stale = ()

        def load(self, props):
            self.share = mi.Float(0.4)
            self.known = mi.Float(self.share)

        def traverse(self, callback):
            callback.put("share", self.share, mi.ParamFlags.Differentiable)

        def of(self, name):
            return self.known if name in self.stale else self.share

        def mixture(self, share, wo):
            return (share + (1 - share) * 2 * wo.z**2) * dr.inv_pi * wo.z

        def value(self, ctx, si, wo):
            return mi.Spectrum(0.7 * self.mixture(self.share, wo))

        def density(self, ctx, si, wo):
            return self.mixture(self.of("pdf"), wo)

        def direction(self, ctx, si, sample1, sample2):
            z = dr.sqrt(sample2.x)
            z = dr.select(sample1 < self.of("sample"), z, dr.sqrt(z))
            s, c = dr.sincos(dr.two_pi * sample2.y)
            r = dr.safe_sqrt(1 - z * z)
            return mi.Vector3f(r * c, r * s, z)

    class StalePdf(Mixture):
        stale = ("pdf",)

    class StaleSample(Mixture):
        stale = ("sample",)

    class Placed(mi.PhaseFunction):
        """Isotropic, or to one side by the place: so say both functions."""

        forgotten = False

        def __init__(self, props):
            mi.PhaseFunction.__init__(self, props)
            self.m_flags = mi.PhaseFunctionFlags.Anisotropic
            self.m_components = [self.m_flags]

        def density(self, p, mei, wo):
            return dr.inv_four_pi * (1 - 0.8 * dr.sin(p.x) * dr.dot(wo, mei.wi))

        def sample(self, ctx, mei, sample1, sample2, active=True):
            wo = mi.warp.square_to_uniform_sphere(sample2)
            kept = sample1 < 0.5 * dr.four_pi * self.density(mei.p, mei, wo)
            wo = dr.select(kept, wo, -wo)
            return wo, mi.Spectrum(1.0), self.eval_pdf(ctx, mei, wo, active)[1]

        def eval_pdf(self, ctx, mei, wo, active=True):
            p = mi.Point3f(0) if self.forgotten else mei.p
            pdf = self.density(p, mei, wo)
            return mi.Spectrum(pdf), pdf

        def to_string(self):
            return "Placed[]"

    class PlaceForgotten(Placed):
        forgotten = True

    plugins = [EachRay, FirstRay, Mixture, StalePdf, StaleSample]
    plain_bsdf.register(plugins + ([Coloured, OtherColours] if mi.is_rgb else []))
    mi.register_phase("placed", Placed)
    mi.register_phase("place_forgotten", PlaceForgotten)


PAIRS = {
    "first_ray": "each_ray",
    "stale_pdf": "mixture",
    "stale_sample": "mixture",
    "place_forgotten": "placed",
}


@pytest.mark.parametrize("name", PAIRS)
def test_what_only_some_answers_tell_is_shown(name):
    show_worst(name, PAIRS[name])


@pytest.mark.usefixtures("rgb")
def test_exchanged_colours_are_shown():
    """Their mean is the same."""
    show_worst("other_colours", "coloured")


def show_worst(wrong, right):
    """The script of the worst failure shows it, and says so of a right plugin."""
    register_pairs()
    text = reproducer(validate({"type": wrong}, effort="quick"))
    assert is_short(text), text
    assert told(text) > 1, text
    assert told(text.replace(f'"{wrong}"', f'"{right}"')) < 1, text


def test_every_property_is_shown_by_a_function():
    assert all(one.shown for one in OF_SURFACES if one.name != "cost")


# What properties are given besides.
GIVEN = {
    "what": of_eval,
    "part": 1,
    "alone": of_pdf,
    "of": directions,
    "low": [0.0, 0.0],
    "high": [1.0, 0.5],
    "due": 1,
    "function": "pdf",
    "i": 0,
    "n": 300,
    "name": "alpha",
    "to": None,
    "stated": sampled_pdf,
    "normal": [0.0, 0.0, 1.0],
}


def stated_functions():
    """All functions of the package that state a property."""
    found = {}
    for path in Path(validation.__file__).parent.rglob("*.py"):
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        if "commands" in name or "worker" in name or "pytest" in name:
            continue
        for one in vars(importlib.import_module(name)).values():
            if not inspect.isfunction(one) or one.__module__ != name:
                continue
            given = [*inspect.signature(one).parameters]
            if given[:3] == ["bsdf", "ctx", "si"] and given[3] in ("u", "_"):
                found[f"{path.stem}.{one.__name__}"] = one, given[4:]
    return found


STATED = stated_functions()


def test_there_are_as_many_properties():
    assert len(STATED) > 50


@pytest.mark.parametrize("name", STATED)
@pytest.mark.parametrize("of_volumes", [False, True])
def test_every_property_has_a_short_script(name, of_volumes):
    """Of a plugin of which nothing is known; it names nothing that is not there."""
    stated, names = STATED[name]
    given = tuple(GIVEN[one] for one in names if one in GIVEN)
    claim = Claim(stated, apart, given)
    found = Property("answers", "fails", "", shown=claim, of_volumes=of_volumes)
    settings = {"variant": mi.variant()}
    word = "phase" if of_volumes else "bsdf"
    source = f'{word} = mi.load_dict({{"type": "own"}})'
    text = script(Verdict("own", (), None, None, settings, source=source), found)
    assert is_short(text)
    assert ": Any" not in text
    known = {*vars(builtins), "dr", "mi", "np", "__name__"}
    tree = ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(node, ast.arg):
            known.add(node.arg)
        elif isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            known.add(node.name)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            known.add(node.id)
    named = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
    assert named <= known


@pytest.mark.usefixtures("plugins")
def test_what_has_no_script(tmp_path):
    wrong = {"type": "weight_with_cosine"}
    with pytest.raises(SettingError, match="dictionary or a file, got an object"):
        reproducer(validate(mi.load_dict(wrong), effort="quick"))
    verdict = judged("weight_with_cosine", "quick")
    with pytest.raises(SettingError, match="needs masks that fails"):
        reproducer(verdict, "masks")
    save_report(replace(verdict, maps=()), tmp_path / "report.html")
    assert "Reproducer: weights" in (tmp_path / "report.html").read_text()


# Too bright, by a function whose source Dr.Jit reads.
TRANSFORMED = """
import drjit as dr, mitsuba as mi

class Transformed(mi.BSDF):
    def __init__(self, props):
        mi.BSDF.__init__(self, props)
        self.m_flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide
        self.m_components = [self.m_flags]

    @dr.syntax
    def lit(self, si, wo):
        above = wo.z > 0
        if si.wi.z < 0:
            above = mi.Bool(False)
        return above

    def sample(self, ctx, si, sample1, sample2, active):
        bs = dr.zeros(mi.BSDFSample3f)
        bs.wo = mi.warp.square_to_cosine_hemisphere(sample2)
        bs.pdf, bs.eta = self.pdf(ctx, si, bs.wo, active), 1.0
        bs.sampled_type = mi.UInt32(int(mi.BSDFFlags.DiffuseReflection))
        return bs, mi.Spectrum(0.5) & (bs.pdf > 0)

    def eval(self, ctx, si, wo, active):
        return mi.Spectrum(dr.inv_pi * wo.z) & (active & self.lit(si, wo))

    def pdf(self, ctx, si, wo, active):
        return dr.select(active & self.lit(si, wo), dr.inv_pi * wo.z, 0)

    def to_string(self):
        return "Transformed[]"

mi.register_bsdf("transformed", Transformed)
"""


def test_a_plugin_file_may_have_source_that_is_read(tmp_path, capsys):
    plugin, script_of = tmp_path / "transformed.py", tmp_path / "bug.py"
    plugin.write_text(TRANSFORMED)
    command = ["validate", "transformed", "--effort", "quick", "--plugin", plugin]
    command += ["--variant", mi.variant(), "--reproducer", script_of]
    cli.main(list(map(str, command)))
    capsys.readouterr()
    assert told(script_of.read_text()) > 1

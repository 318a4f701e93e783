"""Reproducers: those of the handbook still show each defect, those of findings do."""

import re
from pathlib import Path

import broken_bsdfs
import mitsuba as mi
import polarised_bsdfs
import pytest
from reproduced import code_of, told

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
from gonio_mi.validation.checks.frames import JUMP
from gonio_mi.validation.kinds import Kind, MatrixKind
from gonio_mi.validation.reproducer import script

HANDBOOK = sorted(Path(__file__).parents[2].glob("notebooks/reproducers/*.py"))


@pytest.mark.parametrize("path", HANDBOOK, ids=lambda path: path.stem)
@pytest.mark.usefixtures("mono")
def test_defect_of_the_installed_mitsuba(path):
    """If this fails, Mitsuba has mended it, and the table of stock plugins must go."""
    text = path.read_text(encoding="utf-8")
    assert "gonio" not in text
    assert len(code_of(text)) <= 20
    assert told(text) > 1


# The same where there is no defect, by a change of the script.
MENDED = {
    "beckmann_density": ('"alpha"', '"distribution": "ggx", "alpha"'),
    "bumpmap_polarisation": ("0.3 * x + 0.2 * y", "0 * x"),
    "hair_in_mono": ('("llvm_ad_mono", ', "("),
    "measured_polarized_straight_back": ("si, si.wi)", "si, mi.Vector3f(0, 0, 1))"),
    "normalmap_polarisation": ("= mi.Normal3f(0.5, 0.1, ", "= mi.Normal3f(0, 0, 1 or "),
    "principledthin_types": ("principledthin", "roughplastic"),
    "twosided_polarisation": ("-0.6)", "0.6)"),
}


@pytest.mark.parametrize("name", MENDED)
@pytest.mark.usefixtures("mono")
def test_a_script_says_so_when_a_defect_is_gone(name):
    text = next(one for one in HANDBOOK if one.stem == name).read_text(encoding="utf-8")
    mended = text.replace(*MENDED[name])
    assert mended != text
    assert told(mended) < 1


# Of each kind of finding one; `raises` are shown by the call that raises.
SHOWN = {
    "eval_nan_at_grazing": ("answers", "ends"),
    "eval_without_cosine": ("reciprocity", "weights", "sampled_weight"),
    "pdf_uniform": ("sampled_pdf", "sampling"),
    "sample_not_unit": ("directions",),
    "eval_without_pi": ("energy",),
    "eval_ignores_active": ("masks",),
    "discrete_pdf_not_probability": ("delta",),
    "flags_of_another_lobe": ("flags",),
    "eval_ignores_component": ("components",),
    "eval_other_at_normal": ("continuity",),
    "importance_with_eta2": ("adjoint", "reciprocity"),
    "gradient_detached": ("parameters",),
    "eval_pdf_of_one_lobe": ("eval_pdf",),
}


@pytest.fixture
def plugins(mono):
    broken_bsdfs.register()
    return mono


@pytest.mark.parametrize("name", SHOWN)
@pytest.mark.usefixtures("plugins")
def test_finding_is_shown_by_its_script(name):
    verdict = validate({"type": name}, effort="quick", strict=True)
    for finding in SHOWN[name]:
        text = reproducer(verdict, finding)
        assert len(code_of(text)) <= 20, text
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
        assert len(code_of(text)) <= 20, text
        assert told(text) > 1, text
        assert told(text.replace(f'"{name}"', f'"{right}"')) < 1, text


@pytest.mark.usefixtures("matrices", "polarised")
def test_jump_of_matrices_is_shown_by_its_script():
    """Near wo = wi the frame of a facet is that of a small, rounded sine."""
    verdict = validate({"type": "r_p_wrong"}, effort="quick")
    text = reproducer(verdict, "frames")
    mended = text.replace('"r_p_wrong"', '"r_p_right"')
    assert told(text) > JUMP / BSDF_ROUNDING > told(mended)


@pytest.mark.parametrize("kind", [*Kind, *MatrixKind], ids=str)
@pytest.mark.usefixtures("mono")
def test_every_kind_has_a_short_script(kind):
    """Of a plugin of which nothing is known; no word of the template is left."""
    name = kind.name.lower() if kind.name.lower() in PROPERTIES else "answers"
    found = Property(name, "fails", "", function="sample", kind=kind, about="weight")
    settings = {"variant": mi.variant()}
    source = 'bsdf = mi.load_dict({"type": "own"})'
    text = script(Verdict("own", (), None, None, settings, source=source), found)
    compile(text, "reproducer.py", "exec")
    assert len(code_of(text)) <= 20
    if kind not in (Kind.MOMENTS, Kind.MOMENTS_OF_WEIGHTS):  # by way of others
        assert not re.findall(r"\b[A-Z]{3,}\b", text)


@pytest.mark.usefixtures("plugins")
def test_what_has_no_script(tmp_path):
    wrong = {"type": "weight_with_cosine"}
    with pytest.raises(SettingError, match="dictionary or a file, got an object"):
        reproducer(validate(mi.load_dict(wrong), effort="quick"))
    verdict = validate(wrong, effort="quick")
    with pytest.raises(SettingError, match="needs masks that fails"):
        reproducer(verdict, "masks")
    save_report(verdict, tmp_path / "report.html")
    assert "Reproducer: weights" in (tmp_path / "report.html").read_text()

"""Verdicts on right and on broken BSDFs: the power of `validate`, and its answers.

GONIO_EFFORT=normal (or thorough) examines the broken ones harder than quick.
"""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import broken_bsdfs
import budget
import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from broken_bsdfs import EITHER, MISTAKES, RIGHT, judged
from plain_bsdf import lobes, over, plain

from gonio_mi import SpecimenError, cli
from gonio_mi.testing import assert_bsdf_valid
from gonio_mi.threads import thread_count
from gonio_mi.validation import POLARISED, PROPERTIES, draw, save_report, validate
from gonio_mi.validation.checks import cost, delta
from gonio_mi.validation.checks.sampling import SAMPLING
from gonio_mi.validation.commands import validate as command
from gonio_mi.validation.commands.validate import told
from gonio_mi.validation.conditions import Condition
from gonio_mi.validation.evidence import EFFECTS, Breach, Evidence
from gonio_mi.validation.examination import coloured
from gonio_mi.validation.questions import OF_MATRICES, OF_SURFACES
from gonio_mi.validation.samples import samples_of
from gonio_mi.validation.verdict import Verdict, properties_of

ALPHA = budget.ALPHA
ROOT = Path(__file__).parents[2]
OBLIQUE = Condition(40.0, 25.0)
EFFORT = os.environ.get("GONIO_EFFORT", "quick")


@pytest.mark.parametrize("name", PROPERTIES | POLARISED)
def test_property_has_an_effect_and_words(name):
    own = [one for one in (*OF_SURFACES, *OF_MATRICES) if one.name == name]
    assert all(Breach(one, "").effect in EFFECTS for one in own)
    assert f"`{name}`" in (ROOT / "notebooks/findings.md").read_text(encoding="utf-8")


def test_readme_counts_the_properties():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert f"checks {len(PROPERTIES)} properties" in text


@pytest.fixture
def plugins(mono):
    broken_bsdfs.register()
    return mono


def strictly(verdict):
    """The same with ``strict``, which decides by what was found."""
    return replace(verdict, settings=verdict.settings | {"strict": True})


@pytest.mark.usefixtures("plugins")
def test_strict_finds_the_same():
    verdict = validate({"type": "roulette"}, effort="quick", strict=True)
    assert verdict.to_dict() == strictly(judged("roulette", "quick")).to_dict()
    assert not verdict.passed
    assert judged("roulette", "quick").passed


@pytest.mark.usefixtures("plugins")
@pytest.mark.parametrize("name", RIGHT)
def test_right_plugin_passes(name):
    verdict = validate({"type": name}, effort=EFFORT, alpha=ALPHA)
    assert verdict.passed, str(verdict)
    assert verdict.function is None


@pytest.mark.usefixtures("plugins")
@pytest.mark.parametrize("name", MISTAKES)
def test_mistake_is_seen_and_its_function_named(name):
    """The twins of the test above; the budget of a verdict is that of the user."""
    verdict = strictly(judged(name, EFFORT))
    assert not verdict.passed, str(verdict)
    named = verdict.function.split(" or ")
    assert MISTAKES[name] in named, str(verdict)
    if EFFORT == "quick" or name not in EITHER:
        # harder looks may tell more
        assert len(named) == 1 + (name in EITHER), str(verdict)
    assert f"`{MISTAKES[name]}`" in verdict.mistake or "pdf" in verdict.mistake
    assert verdict.headline.startswith(f"{name}: FAILS: {verdict.failures[0].effect}")


@pytest.mark.usefixtures("plugins")
@pytest.mark.promise("names the function that is most likely wrong")
def test_a_lacking_cosine_is_named():
    """One of the above, which is quick."""
    verdict = judged("eval_without_cosine", "quick")
    assert (verdict.passed, verdict.function) == (False, "eval")


@pytest.mark.usefixtures("plugins")
def test_verdict_is_deterministic():
    first, second = (
        judged("mixture", "quick"),
        validate({"type": "mixture"}, effort="quick"),
    )
    assert first.to_dict() == second.to_dict()
    other = validate({"type": "mixture"}, effort="quick", seed=1)
    assert other["sampling"].statistic != first["sampling"].statistic


@pytest.mark.usefixtures("plugins")
def test_a_verdict_is_that_of_any_number_of_threads():
    """Exact; and a script keeps its own."""
    with thread_count(3):
        found = validate({"type": "eval_without_pi"}, effort="quick")
        assert dr.thread_count() == 3
    with thread_count(1):
        again = validate({"type": "eval_without_pi"}, effort="quick")
    assert again.to_dict() == found.to_dict()


@pytest.mark.parametrize(("program", "changes"), [(True, [1]), (False, [])])
def test_only_the_program_changes_its_threads(program, changes, monkeypatch, capsys):
    """Idle ones cost half of the time of `quick`."""
    changed = []
    verdicts = [judged("mixture", "quick")], {}
    monkeypatch.setattr(command, "is_program", lambda: program)
    monkeypatch.setattr(command, "_verdicts", lambda _: verdicts)
    monkeypatch.setattr(dr, "set_thread_count", changed.append)
    cli.main(["validate", "mixture", "--effort", "quick"])
    capsys.readouterr()
    assert changed == changes


@pytest.mark.usefixtures("polarised")
def test_files_of_textures_are_read_beside_one_thread(tmp_path):
    """EXR files are read in other threads: where there is none, without end.

    The variants are those of before.
    """
    path = str(tmp_path / "texture.exr")
    mi.Bitmap(np.full((2, 2, 1), 0.5, np.float32)).write(path)
    code = f"""
import gonio_mi as gonio, drjit as dr, mitsuba as mi
dr.set_thread_count(1)
for variant in "llvm_ad_mono", "llvm_ad_mono_polarized":
    mi.set_variant(variant)
    texture = {{"type": "bitmap", "filename": {path!r}, "raw": True}}
    bsdf = {{"type": "diffuse", "reflectance": texture}}
    print(gonio.validate(bsdf, effort="quick").passed, end=" ")
    print(mi.variant() == variant, dr.thread_count())
"""
    words = [sys.executable, "-c", code]
    done = subprocess.run(words, capture_output=True, text=True, timeout=300)
    assert done.stdout == 2 * "True True 1\n", done.stderr


@pytest.mark.usefixtures("plugins")
def test_property_may_be_lacking():
    verdict = validate(
        {"type": "eval_gains_one_percent"}, effort="quick", allow=["energy"]
    )
    assert verdict.passed
    assert verdict["energy"].status == "lacks"
    assert "1.01" in verdict["energy"].statistic


def test_declared_asymmetry_is_reported_and_no_failure():
    verdict = validate({"type": "cosinelobe"}, effort="quick")
    assert verdict["reciprocity"].status == "lacks"
    assert verdict.passed


@pytest.mark.usefixtures("plugins")
@pytest.mark.parametrize(
    ("specimen", "reason"),
    [
        ({"type": "diffuse", "reflectance": 0.0}, "no light was scattered"),
        ({"type": "noise"}, "did not converge"),
    ],
)
def test_nothing_lit_and_nothing_decided_are_no_pass(specimen, reason, capsys):
    """The twins are all right plugins, which pass."""
    verdict = validate(specimen, effort="quick")
    assert reason in verdict.undecided
    assert not verdict.failures
    assert not verdict.passed
    assert f"UNDECIDED: {verdict.undecided}" in verdict.headline
    with pytest.raises(AssertionError, match="UNDECIDED"):
        assert_bsdf_valid(specimen, effort="quick")
    if specimen["type"] == "diffuse":
        words = ["validate", "diffuse:reflectance=0", "--effort", "quick"]
        assert cli.main(words) == 4
        assert "UNDECIDED" in capsys.readouterr().out


class Below:
    """Lambertian that is lit from below, as where a sign of wi.z is wrong."""

    def above(self, si, wo):
        return (si.wi.z < 0) & (wo.z < 0)

    def direction(self, ctx, si, sample1, sample2):
        return -super().direction(ctx, si, sample1, sample2)

    def value(self, ctx, si, wo):
        return -super().value(ctx, si, wo)

    def density(self, ctx, si, wo):
        return -super().density(ctx, si, wo)


@pytest.mark.usefixtures("mono")
@pytest.mark.parametrize("side", ["FrontSide", "BackSide"])
def test_light_on_the_side_that_scatters_none_is_told(side):
    """The twin is the side that scatters."""
    own = {"components": lobes(f"DiffuseReflection {side}")}
    mi.register_bsdf("below", over(type("Sided", (Below,), own), plain()))
    verdict = validate({"type": "below"}, effort="quick")
    if side == "BackSide":
        assert verdict.passed, str(verdict)
    else:
        assert "all light met the front of the surface, the only" in verdict.headline
        assert "; light from the back is scattered: " in verdict.undecided


@pytest.mark.parametrize(
    ("changes", "error", "text"),
    [
        ({"effort": "huge"}, ValueError, "effort must be one of"),
        ({"seed": -1}, ValueError, "seed must be at least 0"),
        ({"alpha": 0}, ValueError, "alpha must be a probability"),
        ({"allow": ["energy", "magic"]}, ValueError, "allow must name some of"),
        ({"specimen": {"type": "no_such"}}, SpecimenError, "cannot be loaded"),
        (
            {"specimen": {"type": "scene", "a": {"type": "sphere"}}},
            None,
            None,
        ),
        (
            {
                "specimen": {
                    "type": "scene",
                    "a": {"type": "sphere"},
                    "b": {"type": "cube"},
                }
            },
            SpecimenError,
            "must have one shape",
        ),
        (
            {"specimen": {"type": "scene", "a": {"type": "diffuse"}}},
            SpecimenError,
            "must be the root of its file",
        ),
    ],
    ids=lambda v: next(iter(v)) if isinstance(v, dict) else None,
)
def test_arguments(changes, error, text):
    arguments = {"specimen": {"type": "diffuse"}, "effort": "quick"} | changes
    specimen = arguments.pop("specimen")
    if error is None:
        assert validate(specimen, **arguments).passed
    else:
        with pytest.raises(error, match=text):
            validate(specimen, **arguments)


class OfColour:
    """Lambertian of a colour, `kept` of which `eval` has."""

    kept = 1.0

    def load(self, props):
        self.reflectance = mi.Color3f(props.get("reflectance", 0.5))

    def traverse(self, callback):
        callback.put("reflectance", self.reflectance, mi.ParamFlags.Differentiable)

    def eval(self, ctx, si, wo, active=True):
        return self.kept * super().eval(ctx, si, wo, active)


@pytest.mark.usefixtures("rgb")
@pytest.mark.parametrize("kept", [1.0, 0.9])
def test_colours_of_a_failure_are_told(kept):
    """The twin is right, and nobody has to know."""
    mi.register_bsdf("tinted", over(type("Own", (OfColour,), {"kept": kept}), plain()))
    verdict = validate({"type": "tinted", "reflectance": 0.5}, effort="quick")
    assert verdict.passed == (kept == 1), str(verdict)
    assert ("given colours: reflectance [0.5, 0.4, 0.3]" in str(verdict)) == (kept < 1)


@pytest.mark.usefixtures("rgb")
def test_colours():
    specimen = {"type": "roughconductor", "alpha": 0.3, "distribution": "ggx"}
    verdict = validate(specimen | {"material": "Cu"}, effort="quick", alpha=ALPHA)
    assert verdict.passed, str(verdict)


@pytest.mark.usefixtures("plugins")
def test_report_is_one_file(tmp_path):
    verdict = judged("phi_with_wrong_sign", "quick")
    verdict = replace(verdict, maps=verdict.maps[:2])  # a second each
    path = tmp_path / "report.html"
    save_report(verdict, path)
    text = path.read_text()
    assert text.count("data:image/png;base64,") == 2 * len(verdict.maps)
    assert "mirrored in phi" in text
    assert "the circle is the direction to the source" in text
    # what fails comes first, with all its places
    assert text.index('class="fails"') < text.index('class="holds"')
    path.unlink()
    wrong = judged("weight_with_cosine", "quick")
    save_report(replace(wrong, maps=()), path)
    # colours reach as far as scores do; twin: 6 where nothing is wrong
    drawn = {axes.get_title(): axes for axes in draw(wrong.maps[-1]).axes}
    ends = [
        axes.collections[0].norm.vmax
        for name in ("z: counted - pdf", "z: weights - due")
        for title, axes in drawn.items()
        if title.startswith(f"{name}\nworst ")
    ]
    scores = wrong.maps[-1].weight_scores
    assert ends == [6, min(1000, np.nanmax(np.abs(scores.z)))]
    assert ends[1] > 6
    assert path.read_text().count("weight times pdf over") > 3
    assert 'src="http' not in text
    with pytest.raises(ValueError, match="html"):
        save_report(verdict, tmp_path / "report.pdf")


@pytest.mark.usefixtures("plugins")
def test_for_ci():
    assert assert_bsdf_valid({"type": "lambert"}, effort="quick").passed
    with pytest.raises(AssertionError, match="`eval` lacks the factor cos"):
        assert_bsdf_valid({"type": "eval_without_cosine"}, effort="quick")


@pytest.mark.usefixtures("plugins")
@pytest.mark.parametrize(
    ("name", "effect", "passed"),
    [
        ("pdf_half_a_percent_off", "biases images", False),
        ("flags_smooth_missing", "biases images", False),
        ("importance_with_eta2", "breaks some integrators", False),
        ("fresnel_not_reciprocal", "a property of the model", True),
        ("eval_gains_one_percent", "a property of the model", True),
        ("sample_ignores_active", "interface only (no effect on images)", True),
        ("flags_of_another_lobe", "interface only (no effect on images)", True),
        ("pdf_below_the_horizon", "interface only (no effect on images)", True),
        ("pdf_lit_from_behind", "interface only (no effect on images)", True),
        ("gradient_detached", "breaks some integrators", False),
        ("traverse_raises", "interface only (no effect on images)", True),
        ("eta_of_a_reflection", "adds noise", True),
        ("roulette", "adds noise", True),
    ],
)
def test_effect_decides(name, effect, passed):
    """What biases images or breaks integrators fails; the rest if one is strict."""
    verdict = judged(name, "quick")
    assert verdict.failures[0].effect == effect, str(verdict)
    if name in ("gradient_detached", "traverse_raises", "eta_of_a_reflection"):
        assert len(verdict.failures) == 1, str(verdict)
    assert verdict.passed == passed
    assert effect in verdict.headline
    assert not strictly(verdict).passed


@pytest.mark.usefixtures("plugins")
def test_causes_come_before_consequences_and_places_are_named():
    zero = judged("eval_and_pdf_are_zero", "quick")
    assert zero.mistake == "`eval` and `pdf` are 0 where `sample` scatters light"
    assert "e+2" not in str(zero)  # a ratio to 1e-30
    half = judged("eval_half_below_a_line", "quick")
    assert "everywhere" not in half.mistake
    assert "phi_i 2" in half.mistake or "phi_i 3" in half.mistake
    constant = judged("pdf_half_a_percent_off", "quick")
    assert "everywhere" in constant.mistake
    rare = judged("eval_nan_rarely", "quick")
    assert rare.mistake == "the value of `eval` is nan in places"
    assert [one.name for one in rare.failures][:2] == ["answers", "weights"]
    gain = judged("cats_eye_gains_light", "quick")
    assert "not energy conserving" in gain.mistake


@pytest.mark.usefixtures("plugins")
def test_kernels_that_are_compiled_anew_are_told():
    """Its twin, the same with a constant, is `lambert`."""
    verdict = strictly(judged("compiles_anew", "quick"))
    assert verdict.passed
    assert verdict["cost"].effect == "adds cost"
    assert "compiled anew" in verdict["cost"].statistic
    assert verdict.headline.endswith("but it adds cost")
    lambert = judged("lambert", "quick")
    assert lambert["cost"].effect is None


@pytest.mark.usefixtures("plugins")
@pytest.mark.parametrize(("ns", "told"), [(5_000, False), (80_000, True)])
def test_time_of_a_ray_is_a_ratio_in_turns(ns, told, monkeypatch):
    """By a clock of its own, on a machine that now and then does something else."""
    now = [0]

    def call(own):
        def advance():
            other_work = 10**6 if len(now) % 5 == 0 else 0
            now.append(now[-1] + own + other_work)

        return advance

    def ratio(first, second):
        del first, second
        return compared(call(ns), call(1_000), lambda: now[-1])

    compared = cost.compared
    monkeypatch.setattr(cost, "compared", ratio)
    cost.check_time(evidence := Evidence(mi.load_dict({"type": "lambert"})), OBLIQUE)
    assert (
        f"{ns / 1_000:.2g} times as long as those of `diffuse`"
        in evidence.remarks["cost"][0]
    )
    assert ("cost" in evidence.downgraded) == told


@pytest.mark.usefixtures("plugins")
def test_not_reciprocal_is_one_fact():
    """Both modes are the same, so that adjointness has nothing to add."""
    verdict = judged("fresnel_not_reciprocal", "quick")
    assert [one.name for one in verdict.failures] == ["reciprocity"]


def test_answers_as_wide_as_the_rays():
    """Nested maps turn single incident directions into as many as there are rays."""
    heights = np.linspace(0, 0.3, 16, dtype=np.float32).reshape(4, 4, 1)
    heights = {"type": "bitmap", "bitmap": mi.Bitmap(heights), "raw": True}
    bumps = {"type": "bumpmap", "arbitrary": heights, "nested": {"type": "diffuse"}}
    blend = {"type": "blendbsdf", "weight": 0.5, "a": bumps, "b": bumps}
    verdict = validate(blend, effort="quick")
    assert verdict.answered, str(verdict)


@pytest.mark.parametrize("side", ["front", "back"])
def test_rare_discrete_lobes_are_counted(side):
    """Of an index of 1.01 a few reflect; a probability of 1 would allow none."""
    bsdf = mi.load_dict({"type": "dielectric", "int_ior": 1.01, "ext_ior": 1.0})
    samples = samples_of(bsdf, Condition(40.0, 140.0, side), 2**18, (0, 1))
    delta.lobes_of(evidence := Evidence(bsdf), samples)
    assert min(test.p for test in evidence.tests) > ALPHA
    # the twin: a probability of 1, but for rounding, allows none of them
    samples.sampled_pdf[~samples.reflected] = 1.0
    delta.lobes_of(twin := Evidence(bsdf), samples)
    assert min(test.p for test in twin.tests) < ALPHA


ONE_VARIANT = """
import mitsuba as mi
from own_part import Lambertian
mi.register_bsdf("knows_rgb", Lambertian)
"""
OWN_PART = """
import drjit as dr
import mitsuba as mi

class Lambertian(mi.BSDF):
    def __init__(self, props):
        super().__init__(props)
        self.m_flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide
        self.m_components = [self.m_flags]

    def sample(self, ctx, si, sample1, sample2, active=True):
        bs = dr.zeros(mi.BSDFSample3f)
        bs.wo = mi.warp.square_to_cosine_hemisphere(sample2)
        bs.pdf, bs.eta = dr.inv_pi * bs.wo.z, 1.0
        bs.sampled_type = mi.UInt32(+mi.BSDFFlags.DiffuseReflection)
        return bs, mi.Color3f(0.2, 0.5, 0.8) & (active & (si.wi.z > 0) & (bs.pdf > 0))

    def eval(self, ctx, si, wo, active=True):
        ok = active & (si.wi.z > 0) & (wo.z > 0)
        return mi.Color3f(0.2, 0.5, 0.8) * (dr.inv_pi * wo.z) & ok

    def pdf(self, ctx, si, wo, active=True):
        return dr.select(active & (si.wi.z > 0) & (wo.z > 0), dr.inv_pi * wo.z, 0)

    def to_string(self):
        return "Lambertian[]"
"""


def test_command_judges_where_a_plugin_answers(tmp_path, capsys, monkeypatch):
    """In rgb and in mono; its own modules are found beside it, in either."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    plugin = tmp_path / "one_variant.py"
    plugin.write_text(ONE_VARIANT)
    (tmp_path / "own_part.py").write_text(OWN_PART)
    arguments = ["validate", "knows_rgb", "--plugin", str(plugin), "--effort", "quick"]
    assert cli.main([*arguments, "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["settings"]["variant"] == "llvm_ad_rgb"
    assert "got Color3f" in answer["skipped"]["llvm_ad_mono"]
    assert answer["others"] == []
    both = (tmp_path / "own_part.py").read_text().replace("Color3f", "Spectrum")
    both = both.replace("0.2, 0.5, 0.8", "0.5")
    (tmp_path / "own_part.py").write_text(both)
    assert cli.main([*arguments, "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert [one["settings"]["variant"] for one in answer["others"]] == ["llvm_ad_mono"]
    assert answer["skipped"] == {}


def verdict_of(*p_values, effort="quick", variant="llvm_ad_rgb"):
    """Verdict of ten tests of a probability of 0.1 %: a level of 0.01 % for each."""
    evidence = Evidence(questions=OF_SURFACES)
    for p in (*p_values, *[0.5] * (10 - len(p_values))):
        evidence.test(SAMPLING, p, "z")
    settings = {"effort": effort, "seed": 0, "alpha": 1e-3, "strict": False}
    settings |= {"variant": variant, "n_tests": 10, "n_samples": 1, "tints": {}}
    found = tuple(properties_of(evidence, 1e-3))
    return Verdict("paint", found, "pdf", "a mistake", settings)


def test_what_is_near_its_limit_is_told_without_an_alarm():
    """Within a factor of ten; twins: further, and beyond the limit."""
    near = verdict_of(0.3, 0.00023)
    told = "sampling (p = 0.00023, fails below 0.0001)"
    assert near.headline.endswith(
        f"; near the limit: {told}, effort normal looks closer"
    )
    assert near.passed
    assert not near.failures
    assert "effort thorough" in verdict_of(0.00099, effort="normal").headline
    assert "another seed" in verdict_of(0.00099, effort="thorough").headline
    assert "near" not in verdict_of(0.00101).headline
    failed = verdict_of(0.00009)
    assert not failed.passed
    assert "near" not in failed.headline


def test_other_variants_are_told_of_after_the_verdict():
    other = verdict_of(0.00023, variant="llvm_ad_mono")
    *_, headline, last = told(verdict_of(), [other], {}).splitlines()
    assert headline.startswith("paint: nothing wrong was found")
    assert last.startswith("in llvm_ad_mono: nothing wrong was found either")
    assert "near the limit: sampling" in last
    for p, said in (
        (0.00023, "nothing wrong was found; near the limit"),
        (0.00001, "no further failures"),
    ):
        others = [verdict_of(p, variant="llvm_ad_mono")]
        last = told(verdict_of(0.00001), others, {}).splitlines()[-1]
        assert last.startswith(f"in llvm_ad_mono: {said}")


@pytest.mark.parametrize("order", [1, -1])
def test_what_fails_in_any_variant_decides(order, monkeypatch):
    """Before what is undecided in another, in either order."""
    failed, passed = verdict_of(0.00001), verdict_of()
    undecided = replace(
        passed,
        properties=tuple(
            replace(one, status="undecided") if one.name == "sampling" else one
            for one in passed.properties
        ),
    )
    for verdicts, code in (([undecided, failed], 3), ([undecided, passed], 4)):
        found = verdicts[::order]
        monkeypatch.setattr(command, "_verdicts", lambda _, found=found: (found, {}))
        assert cli.main(["validate", "diffuse"]) == code


@pytest.mark.usefixtures("rgb")
def test_grey_parameters_get_a_colour():
    """So that channels that are mixed up show."""
    grey = {"type": "roughplastic", "diffuse_reflectance": 0.5, "alpha": 0.1}
    params = mi.traverse(coloured(mi.load_dict(grey), grey)[0])
    tinted = np.ravel(params["diffuse_reflectance.value"])
    assert tinted.max() == 0.5
    assert len(set(tinted.tolist())) == 3
    assert params["alpha"] == np.float32(0.1)


@pytest.mark.usefixtures("rgb")
def test_what_a_plugin_keeps_as_one_number_stays_one():
    """A tint would give it three, which are no reflectances of so many rays."""
    broken_bsdfs.register()
    verdict = validate({"type": "grey"}, effort="quick", alpha=ALPHA)
    assert verdict.answered, str(verdict)
    assert verdict.passed, str(verdict)


PLUGIN = """
import sys
sys.path.insert(0, {folder!r})
import broken_bsdfs
broken_bsdfs.register()
"""


def test_command(tmp_path, capsys):
    plugin = tmp_path / "mine.py"
    plugin.write_text(
        PLUGIN.format(folder=str(Path(__file__).parents[1] / "references"))
    )
    common = ["--effort", "quick", "--plugin", str(plugin)]
    assert cli.main(["validate", "lambert", *common]) == 0
    assert "nothing wrong was found" in capsys.readouterr().out
    report = tmp_path / "r.html"
    arguments = ["validate", "pdf_raises", *common, "--json", "--report", str(report)]
    assert cli.main(arguments) == 3
    answer = json.loads(capsys.readouterr().out)
    assert answer["function"] == "pdf"
    assert "(broken_bsdfs.py, line " in answer["mistake"]
    assert [p["name"] for p in answer["properties"]] == list(PROPERTIES)
    assert report.is_file()
    assert cli.main(["validate", "diffuse", "--allow", "magic"]) == 1
    assert "allow must name some of" in capsys.readouterr().err


@pytest.mark.usefixtures("plugins")
@pytest.mark.parametrize(
    ("specimen", "name", "note"),
    [
        ({"type": "dusty"}, "answers", "`eval` depends on where the surface is"),
        ({"type": "fading_above"}, "answers", "`eval` depends on where the surface is"),
        (
            {"type": "thindielectric", "int_ior": 1.0, "ext_ior": 1.0},
            "flags",
            "declared and never sampled",
        ),
        (
            {"type": "diffuse", "reflectance": {"type": "checkerboard"}},
            "flags",
            "without SpatiallyVarying",
        ),
        ({"type": "grey"}, "parameters", "smallest p of 1 tests"),
        ({"type": "diffuse"}, "masks", "`pdf` gives inactive rays a value"),
        ({"type": "conductor"}, "masks", None),
    ],
)
def test_what_does_no_harm_is_noted(specimen, name, note):
    """Mitsuba's own BSDFs do it."""
    found = validate(specimen, effort="quick")[name]
    assert found.status == "holds"
    assert found.statistic == "" if note is None else note in found.statistic

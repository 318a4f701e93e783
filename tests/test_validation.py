"""Verdicts on right and on broken BSDFs: the power of `validate`, and its answers.

GONIO_EFFORT=normal (or thorough) examines the broken ones harder than quick.
"""

import json
import os
from pathlib import Path

import broken_bsdfs
import budget
import pytest
from broken_bsdfs import MISTAKES, RIGHT

from gonio_mi import SpecimenError, cli
from gonio_mi.testing import assert_bsdf_valid
from gonio_mi.validation import PROPERTIES, save_report, validate

ALPHA = budget.ALPHA
EFFORT = os.environ.get("GONIO_EFFORT", "quick")


@pytest.fixture
def plugins(mono):
    broken_bsdfs.register()
    return mono


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
    verdict = validate({"type": name}, effort=EFFORT, strict=True)
    assert not verdict.passed, str(verdict)
    assert verdict.function == MISTAKES[name], str(verdict)
    assert f"`{MISTAKES[name]}`" in verdict.mistake or "pdf" in verdict.mistake


@pytest.mark.usefixtures("plugins")
def test_verdict_is_deterministic():
    first, second = (validate({"type": "mixture"}, effort="quick") for _ in range(2))
    assert first.to_dict() == second.to_dict()
    other = validate({"type": "mixture"}, effort="quick", seed=1)
    assert other["sampling"].statistic != first["sampling"].statistic


@pytest.mark.usefixtures("plugins")
def test_property_may_be_lacking():
    verdict = validate(
        {"type": "eval_gains_one_percent"}, effort="quick", allow=["energy"]
    )
    assert verdict.passed
    assert verdict["energy"].status == "lacks"
    assert "1.01" in verdict["energy"].statistic


@pytest.mark.usefixtures("mono")
def test_declared_asymmetry_is_reported_and_no_failure():
    verdict = validate({"type": "cosinelobe"}, effort="quick")
    assert verdict["reciprocity"].status == "lacks"
    assert verdict.passed


@pytest.mark.usefixtures("mono")
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


@pytest.mark.usefixtures("rgb")
def test_colours():
    specimen = {"type": "roughconductor", "alpha": 0.3, "distribution": "ggx"}
    verdict = validate(specimen | {"material": "Cu"}, effort="quick", alpha=ALPHA)
    assert verdict.passed, str(verdict)


@pytest.mark.usefixtures("plugins")
def test_report_is_one_file(tmp_path):
    verdict = validate({"type": "phi_with_wrong_sign"}, effort="quick")
    path = tmp_path / "report.html"
    save_report(verdict, path)
    text = path.read_text()
    assert text.count("data:image/png;base64,") == len(verdict.maps)
    assert "mirrored in phi" in text
    assert 'src="http' not in text
    with pytest.raises(ValueError, match="html"):
        save_report(verdict, tmp_path / "report.pdf")


@pytest.mark.usefixtures("plugins")
def test_for_ci():
    assert assert_bsdf_valid({"type": "lambert"}, effort="quick").passed
    with pytest.raises(AssertionError, match="`eval` lacks the cosine of wo"):
        assert_bsdf_valid({"type": "eval_without_cosine"}, effort="quick")


PLUGIN = """
import sys
sys.path.insert(0, {folder!r})
import broken_bsdfs
broken_bsdfs.register()
"""


@pytest.mark.usefixtures("mono")
def test_command(tmp_path, capsys):
    plugin = tmp_path / "mine.py"
    plugin.write_text(PLUGIN.format(folder=str(Path(__file__).parent)))
    common = ["--effort", "quick", "--plugin", str(plugin)]
    assert cli.main(["validate", "lambert", *common]) == 0
    assert "nothing wrong was found" in capsys.readouterr().out
    report = tmp_path / "r.html"
    arguments = ["validate", "pdf_raises", *common, "--json", "--report", str(report)]
    assert cli.main(arguments) == 3
    answer = json.loads(capsys.readouterr().out)
    assert answer["function"] == "pdf"
    assert [p["name"] for p in answer["properties"]] == list(PROPERTIES)
    assert report.is_file()
    assert cli.main(["validate", "diffuse", "--allow", "magic"]) == 1
    assert "allow must name some of" in capsys.readouterr().err


@pytest.mark.usefixtures("mono")
@pytest.mark.parametrize(
    ("specimen", "name", "note"),
    [
        ({"type": "principledthin"}, "flags", "declared and never sampled"),
        (
            {"type": "diffuse", "reflectance": {"type": "checkerboard"}},
            "flags",
            "without SpatiallyVarying",
        ),
        ({"type": "diffuse"}, "masks", "`pdf` gives inactive rays a value"),
        ({"type": "conductor"}, "masks", None),
    ],
)
def test_what_does_no_harm_is_noted(specimen, name, note):
    """Mitsuba's own BSDFs do it."""
    found = validate(specimen, effort="quick")[name]
    assert found.status == "holds"
    assert found.statistic == "" if note is None else note in found.statistic

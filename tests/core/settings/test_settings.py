"""Settings are declared once: what reads a declaration says the same. All is exact."""

import inspect
from dataclasses import fields

import mitsuba as mi
import numpy as np
import pytest

import gonio_mi as gonio
from gonio_mi import cli
from gonio_mi.collector import subdivision
from gonio_mi.settings import (
    COLLECTOR,
    FILM,
    INTEGRATOR,
    MeasurementSettings,
    Order,
    declarations,
)

DECLARED = declarations(MeasurementSettings)
KINDS = {INTEGRATOR: "integrator", COLLECTOR: "sensor", FILM: "film"}

# Another value than the default, as a user writes it, and what it becomes.
OTHERS = {
    "rays": (1e4, 10_000),
    "rel_err": (0.01, 0.01),
    "noise": (0.02, 0.02),
    "max_rays": (1e6, 10**6),
    "floor": (0.2, 0.2),
    "batches": (8, 8),
    "estimator": ("analog", "analog"),
    "points": (3, 3),
    "gradients": ("a.value,b", ("a.value", "b")),
    "sampler": ("independent", {"type": "independent"}),
    "seed": (7, 7),
    "side": ("back", "back"),
    "footprint": (0.25, 0.25),
    "divergence": (5, 5.0),
    "incident": ("klems", subdivision("klems")),
    "emission": ("equal_power", "equal_power"),
    "wavelengths": ([450, 600.5], (450.0, 600.5)),
    "collector": ("angle:5x7", gonio.EqualAngle(5, 7)),
    "collector_radius": (9, 9.0),
    "hemispheres": ("both", "both"),
    "max_depth": (3, 3),
    "max_scatterings": (5, 5),
    "rr_depth": (2, 2),
    "period": ((2, 3.5), (2.0, 3.5)),
    "order": ("3+", Order(3)),
    "trace": (True, True),
}


def test_others_are_all_settings():
    assert OTHERS.keys() == DECLARED.keys()


@pytest.mark.parametrize("name", DECLARED)
def test_values_are_parsed_once(name):
    """What was parsed is its own parsed value, and so is its text."""
    given, parsed = OTHERS[name]
    settings = MeasurementSettings(**{name: given})
    assert getattr(settings, name) == parsed != DECLARED[name].default
    assert MeasurementSettings(**{name: parsed}) == settings
    text = DECLARED[name].text(parsed)
    assert MeasurementSettings(**{name: text}) == settings


@pytest.mark.parametrize("name", [n for n, d in DECLARED.items() if d.plugin])
def test_plugins_have_the_declared_properties(name):
    """As in a scene file; their manual page has a row for each."""
    declared = DECLARED[name]
    parsed = OTHERS[name][1]
    plugin = {"type": declared.plugin, declared.key: declared.text(parsed)}
    if declared.plugin == COLLECTOR:
        plugin["film"] = {"type": FILM}
    made = mi.load_dict(plugin)
    assert getattr(made.settings, name) == parsed
    page = inspect.getdoc(type(made))
    assert f"* - {declared.key}\n" in page
    assert f"(Default: ``{declared.shown_default}``)" in " ".join(page.split())


def test_options_and_arguments_are_the_declared(capsys):
    """The command line has them where a group is declared, the function all."""
    with pytest.raises(SystemExit):
        cli.main(["measure", "--help-all"])
    shown = capsys.readouterr().out
    for name, declared in DECLARED.items():
        assert (declared.option in shown) == (declared.group is not None)
        assert name in inspect.signature(gonio.measure).parameters
        assert f"{name} : {declared.form}" in gonio.measure.__doc__


def test_defaults_are_their_own_parsed_values():
    """They are not checked when they are used, so they are here."""
    for name, declared in DECLARED.items():
        if declared.default is not None:
            assert declared.check(name, declared.default) == declared.default


def test_an_unknown_setting_is_named():
    with pytest.raises(TypeError, match=r"no setting 'ray': take one .* mean rays"):
        gonio.measure({"type": "diffuse"}, 30, ray=10)


def test_a_scene_brings_its_own():
    """What is given to `measure` goes before what the scene's plugins say."""
    scene = {
        "type": "scene",
        "integrator": {"type": INTEGRATOR, "rays": 640, "batches": 4},
        "sensor": {
            "type": COLLECTOR,
            "film": {"type": FILM, "subdivision": "angle:3x4"},
            "sampler": {"type": "independent"},
        },
        "plate": {"type": "rectangle"},
    }
    record = gonio.measure(scene, 30, batches=8)
    assert record.ledger.emitted == 640
    assert record.n_batches == 8
    assert str(record.subdivision) == "angle:3x4"
    assert record.settings["sampler"] == "independent"


def test_settings_are_frozen_values():
    settings = MeasurementSettings(wavelengths=np.array([450, 550]))
    assert settings == MeasurementSettings(wavelengths="450,550")
    assert len(fields(settings)) == len(DECLARED)
    with pytest.raises(AttributeError):
        settings.rays = 1

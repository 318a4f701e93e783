"""The estimator `auto`: what it takes where, and that no clock takes part."""

import time
from itertools import count

import mitsuba as mi
import numpy as np
import plain_bsdf
import pytest

import gonio_mi as gonio
from gonio_mi.campaigns.execution import ExecutionContext
from gonio_mi.estimators import auto
from gonio_mi.estimators.next_event import POINT_COST
from gonio_mi.results.summary import summarize
from gonio_mi.results.summary_text import summary_text

DIFFUSE = {"type": "diffuse", "reflectance": 0.8}
GLOSSY = {"type": "roughconductor", "alpha": 0.1, "distribution": "ggx"}
MIRROR = {"type": "conductor"}
DARK = {"reflectance": 0.001}
SMALL = {"collector": "projected:8x12", "estimator": "auto"}


def groove(bsdf=DIFFUSE):
    """V-groove, one cell of endless ones."""
    return {
        "type": "heightfield",
        "heights": mi.TensorXf(np.tile(np.array([0, -0.8], np.float32), (4, 1))),
        "size": 2.0,
        "bsdf": {"type": "twosided", "bsdf": bsdf},
    }


def spots():
    """White texels, one of a hundred, on grey ones."""
    texels = np.full((100, 100, 1), 0.05, np.float32)
    texels[::10, ::10] = 1
    bitmap = {"type": "bitmap", "raw": True, "filter_type": "nearest"}
    return {"type": "diffuse", "reflectance": bitmap | {"bitmap": mi.Bitmap(texels)}}


def measured(specimen, theta_i=30, **settings):
    """Record by the estimator `auto`."""
    period = "box" if specimen["type"] == "heightfield" else None
    return gonio.measure(specimen, theta_i, period=period, **{**SMALL, **settings})


CASES = {
    "flat, precise": (DIFFUSE, {"rel_err": 0.01}, "quadrature"),
    "flat, coarse": (DIFFUSE, {"rel_err": 0.05}, "weighted"),
    "flat, rays": (DIFFUSE, {"rays": 1000}, "weighted"),
    "flat, nothing said": (DIFFUSE, {}, "weighted"),
    "flat, a cone of light": (DIFFUSE, {"rel_err": 0.01, "divergence": 1}, "weighted"),
    "delta and smooth": ({"type": "plastic"}, {"rel_err": 0.01}, "weighted"),
    "delta": ({"type": "dielectric"}, {"rel_err": 0.01}, "weighted"),
    "traced, few rays": (groove, {"rays": 10_000}, "weighted"),
    "traced, rays": (groove, {"rays": 60_000}, "next_event"),
    "traced, dark": (lambda: groove(DIFFUSE | DARK), {"rays": 60_000}, "weighted"),
    "traced, spotted": (lambda: groove(spots()), {"rays": 60_000}, "weighted"),
    "traced, noise": (groove, {"noise": 0.05}, "next_event"),
    "traced, precise": (groove, {"rel_err": 0.1}, "weighted"),
    "glossy": (lambda: groove(GLOSSY), {"rays": 60_000}, "weighted"),
    "mirrors": (lambda: groove(MIRROR), {"rays": 60_000}, "next_event"),
    "mirrors, one order": (
        *(lambda: groove(MIRROR), {"rays": 60_000, "order": 2}, "weighted"),
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_takes(case):
    """Each rule, and both answers of short runs; the record names them."""
    specimen, settings, wanted = CASES[case]
    record = measured(specimen() if callable(specimen) else specimen, **settings)
    assert record.settings["estimator"] == wanted
    assert record.provenance.choice.startswith(wanted)
    assert wanted in summary_text(summarize(record)).partition("chosen")[2]


def test_eval_of_others_is_not_trusted():
    """A BSDF in Python is sampled; nobody knows whether its functions agree."""

    plain_bsdf.register([plain_bsdf.plain()])
    record = measured({"type": "plain"}, rel_err=0.01)
    assert record.settings["estimator"] == "weighted"
    assert "in Python" in record.provenance.choice


def test_media_and_orders_take_rays():
    """The estimators that deposit do not apply, or not to all orders at once."""
    glass = gonio.measure("scenes/milk_glass.xml", 30, rays=500, **SMALL)
    assert "medium" in glass.provenance.choice
    orders = gonio.measure_orders(
        groove(), 30, orders=(1, "2+"), period="box", rays=60_000, **SMALL
    )
    for record in orders.values():
        assert record.provenance.choice == "weighted, for orders share their rays"


def test_what_is_chosen_has_the_bits_of_what_is_asked_for():
    """Exact: beside other directions too, and with any seed; the short runs are gone.

    Of each estimator the settings in the record measure it again.
    """
    for specimen, asked in ((groove(), {"rays": 60_000}), (DIFFUSE, {"rel_err": 0.01})):
        stack = measured(specimen, [10, 60], seed=7, **asked)
        alone = measured(specimen, 60, seed=7, **asked)
        assert stack[1].tallies == alone.tallies
        assert measured(specimen, 60, **asked).provenance.choice == (
            alone.provenance.choice
        )
        known = {name: alone.settings.get(name) for name in ("points", "rel_err")}
        known |= {"estimator": alone.settings["estimator"], "seed": 7}
        rays = alone.provenance.rays or None
        assert measured(specimen, 60, rays=rays, **known).tallies == alone.tallies


def test_the_clock_takes_no_part(monkeypatch):
    """Exact: as if each look at the clock came a minute after the last, or none."""
    found = [measured(groove(), rays=60_000)]
    for step in (60.0, 1e-9):
        clock = count(0, step)
        monkeypatch.setattr(time, "perf_counter", lambda clock=clock: next(clock))
        found.append(measured(groove(), rays=60_000))
    assert len({record.provenance.choice for record in found}) == 1
    assert all(record.tallies == found[0].tallies for record in found)


def test_short_runs_decide(monkeypatch):
    """The twin: where deposits must cost next to nothing, rays are taken."""
    monkeypatch.setattr(auto, "MAX_RATIO", 1e-6)
    assert measured(groove(), rays=60_000).settings["estimator"] == "weighted"


def test_rare_bright_places_decide(monkeypatch):
    """The twin: without a look at them deposits seem to cost less."""
    monkeypatch.setattr(auto, "_hides_bright_places", lambda *_: False)
    specimen, settings, _ = CASES["traced, spotted"]
    assert measured(specimen(), **settings).asked.sends_points


def test_rays_cost_what_was_asked_for(monkeypatch):
    """Exact, by the table of costs; points that are asked for stay."""
    record = measured(groove(), rays=60_000)
    assert record.asked.points == 96
    assert record.provenance.rays == round(60_000 / (1 + POINT_COST * 96))
    monkeypatch.setattr(auto, "MAX_RATIO", np.inf)  # fewer of them save less
    assert measured(groove(), rays=60_000, points=40).asked.points == 40


@pytest.mark.needs("analysis")
def test_records_are_merged_rendered_and_measured_again(tmp_path):
    """As those of any estimator: the record says which one it is."""
    from gonio_mi.analysis.comparison.measure_like import measure_like

    one, other = (measured(groove(), rays=60_000, seed=seed) for seed in (1, 2))
    assert one.merge(other).provenance.batches == 32
    one.save(tmp_path / "one.exr")
    assert gonio.load(tmp_path / "one.exr").provenance.choice == one.provenance.choice
    (again,) = measure_like(groove(), one)
    assert again.asked.points == one.asked.points
    assert again.provenance.rays == one.provenance.rays
    campaign = gonio.campaign(
        {"groove": groove()}, [10, 30], rays=60_000, period="box", seed=1, **SMALL
    )
    assert campaign["groove"][1].tallies == one.tallies


@pytest.mark.needs("materials")
def test_chosen_directions_choose_as_ever():
    """A whole material tries integrals, then rays; it is not told an estimator."""
    from gonio_mi.materials.measured_directions import MeasuredDirections

    where = ExecutionContext()
    auto, default = (
        MeasuredDirections("plate", DIFFUSE, 0.1, where, settings)
        for settings in ({"estimator": "auto"}, {})
    )
    assert auto.estimators == default.estimators


def test_scene_files_say_it_too():
    """The integrator behind `mi.render` makes the same choice."""
    how = {"estimator": "auto", "rel_err": 0.01}
    parts = {
        "integrator": {"type": "goniophotometer"} | how,
        "sensor": {"type": "collector", "film": {"type": "patches"}},
        "light": {"type": "directional", "direction": [0, 0.6, -0.8]},
        "plate": {"type": "rectangle", "bsdf": DIFFUSE},
    }
    scene = mi.load_dict({"type": "scene", **parts})
    mi.render(scene)
    record = scene.sensors()[0].film().record
    assert record.settings["estimator"] == "quadrature"
    assert record.provenance.choice.startswith("quadrature")

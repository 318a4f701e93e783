"""Media in closed shapes: grids, channels, nested and adjacent ones, and bad ones."""

from pathlib import Path

import iadpython
import mitsuba as mi
import numpy as np
import pytest
from benchmark.discrete_ordinates import henyey_greenstein, theory
from budget import (
    agree,
    difference_scores,
    disagree,
    of_total,
    scores,
    single,
    verdict,
)
from slabs import NULL, medium, rectangle, stack

import gonio_mi as gonio
from gonio_mi.instrument import recording
from gonio_mi.instrument.launcher import LaunchSize
from gonio_mi.results.summary import summarize
from gonio_mi.results.summary_text import summary_text
from gonio_mi.transport import sampling

SCENES = Path(__file__).parents[3] / "scenes"
PATCHES = "projected:5x6"
# Midpoints of eight rings of equal projected solid angle.
RING_ANGLES = np.degrees(np.arcsin(np.sqrt((np.arange(8) + 0.5) / 8))).tolist()
RAYS = 50_000
GLASS = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}


def measured(scene, theta_i=30.0, **settings):
    settings = {"rays": RAYS, "sampler": "independent"} | settings
    return gonio.measure(scene, theta_i=theta_i, **{"collector": PATCHES} | settings)


def ball(one, bsdf=NULL, radius=1.0, **more):
    return {"type": "sphere", "radius": radius, "bsdf": bsdf, "interior": one, **more}


def cube(one, half=1.0, height=0.5, bsdf=NULL):
    to_world = (
        mi.ScalarTransform4f().translate([0, 0, -height]).scale([half] * 2 + [height])
    )
    return {"type": "cube", "to_world": to_world, "bsdf": bsdf, "interior": one}


def both(a, b):
    """Verdict on both hemispheres of two records."""
    return verdict(
        np.concatenate([difference_scores(a, b, hemisphere) for hemisphere in (0, 1)])
    )


@pytest.mark.parametrize("bsdf", [NULL, GLASS])
def test_wide_plate_is_a_layer(bsdf):
    """A cube so wide that no light leaves by a side, lit at a point."""
    one = medium(2.0, 0.95, 0.5)
    plate = measured(cube(one, half=500.0, bsdf=bsdf), footprint="point")
    scene = stack(one, bsdf=bsdf)
    if bsdf is GLASS:
        scene["interface_1"]["bsdf"] = GLASS | {"int_ior": 1.0, "ext_ior": 1.5}
    layer = measured(scene, period="box", seed=1)
    assert (plate.settings["transport"], layer.settings["transport"]) == (
        "traced",
        "layers",
    )
    agree(both(plate, layer))
    narrow = measured(cube(one, half=1.0, bsdf=bsdf), footprint="point")
    disagree(both(narrow, layer))
    assert narrow.ledger.over_the_edge > 0 == plate.ledger.over_the_edge


@pytest.mark.parametrize("estimator", ["weighted", "analog"])
def test_nested_and_adjacent_media(estimator):
    """A ball of the same medium in a medium is none, and its ledger adds up."""
    inner, outer = medium(2.0, 0.9, 0.4), medium(2.0, 0.9, 0.4)
    whole = measured(ball(outer), estimator=estimator)
    core = ball(inner, radius=0.6, exterior=outer)
    nested = {"type": "scene", "outer": ball(outer), "core": core}
    record = measured(nested, estimator=estimator, seed=1)
    assert record.ledger.astray == 0
    assert record.ledger.emitted == RAYS
    agree(both(record, whole))
    core = ball(medium(9.0, 0.2), radius=0.6, exterior=outer)
    other = measured({**nested, "core": core}, estimator=estimator)
    disagree(both(other, whole))


def grid(values):
    """Heterogeneous medium in the slab from z = -2 to 0, one value for each layer."""
    values = np.float32(values)[::-1].reshape(-1, 1, 1, 1)
    to_world = mi.ScalarTransform4f().translate([-1, -1, -2]).scale(2)
    volume = {"type": "gridvolume", "grid": mi.VolumeGrid(values), "raw": True}
    volume |= {"filter_type": "nearest", "to_world": to_world}
    coefficients = {"sigma_t": volume, "albedo": 0.9}
    phase = {"type": "hg", "g": 0.5}
    return mi.load_dict({"type": "heterogeneous", **coefficients, "phase": phase})


@pytest.mark.parametrize("estimator", ["weighted", "analog"])
def test_grid(estimator):
    """Delta tracking through a grid of two layers, one of which is thin."""
    one = grid([0.3, 3.0])
    scene = {"type": "scene", "top": rectangle(0, None, one), "end": rectangle(-2, one)}
    record = measured(scene, period="box", estimator=estimator, rays=20_000)
    assert record.settings["transport"] == "traced"
    assert record.ledger.astray == 0
    layers = [(tau, 0.9, henyey_greenstein(0.5)) for tau in (0.3, 3.0)]
    patches, _, direct = theory(layers, 30.0, PATCHES)
    agree(verdict(scores(record, patches[0])))
    thinner, *_ = theory(layers[:1], 30.0, PATCHES)
    disagree(verdict(scores(record, thinner[0])))
    low, high = record.interval(1 - 1e-6, "direct")
    assert low < direct < high


def coloured(sigma_t, albedo, **more):
    """Homogeneous medium of three channels."""
    values = {"sigma_t": sigma_t, "albedo": albedo}
    volumes = {
        key: {"type": "constvolume", "value": {"type": "rgb", "value": value}}
        for key, value in values.items()
    }
    phase = {"type": "hg", "g": 0.5}
    return mi.load_dict({"type": "homogeneous", **volumes, "phase": phase, **more})


@pytest.mark.usefixtures("rgb")
@pytest.mark.parametrize("estimator", ["weighted", "analog"])
def test_channels_that_differ(estimator):
    """Each is what exact theory says of it, though they share their paths."""
    taus, albedos = np.array([0.2, 1.0, 4.0]), [0.6, 0.9, 0.99]
    one = coloured((taus / 5).tolist(), albedos, scale=5.0)
    record = measured(stack(one), period="box", rays=100_000, estimator=estimator)
    for channel, (tau, albedo) in enumerate(zip(taus, albedos)):
        layer = (tau, albedo, henyey_greenstein(0.5))
        patches, totals, _ = theory([layer], 30.0, PATCHES)
        agree(verdict(scores(record, patches[0], 0, channel)))
        disagree(verdict(scores(record, 1.25 * patches[0], 0, channel)))
        agree(of_total(record, totals[0], channel=channel))


@pytest.mark.usefixtures("rgb")
@pytest.mark.parametrize("estimator", ["weighted", "analog"])
def test_bits_however_launches_are_cut(estimator, monkeypatch):
    """As rays of one launch or of several, each in a lane or one after the other.

    On the channels' own powers too.
    """
    one = coloured([0.2, 1.0, 4.0], [0.6, 0.9, 0.99])

    def record(longest, relayed):
        monkeypatch.setattr(
            LaunchSize,
            "next_part",
            lambda _, begin, end, most: min(longest, most, end - begin),
        )
        monkeypatch.setattr(sampling, "MAX_RELAY_TURNS", relayed)
        settings = {"period": "box", "rays": 6000, "batches": 2}
        return measured(stack(one), sampler="sobol", estimator=estimator, **settings)

    whole, parts, alone = record(2**20, 64), record(1501, 64), record(2**20, 1)
    assert whole.tallies == parts.tallies == alone.tallies
    assert not np.array_equal(*np.moveaxis(whole.tallies[0].sums, -1, 0)[:2])


@pytest.mark.usefixtures("spectral")
def test_wavelengths_that_differ():
    """As channels of colour: the extinction falls over the spectrum."""
    nm = (400.0, 500.0, 600.0, 700.0, 750.0)
    spectrum = {"type": "irregular", "wavelengths": "400, 750", "values": "3, 0.5"}
    sigma_t = {"type": "constvolume", "value": spectrum}
    one = mi.load_dict({"type": "homogeneous", "sigma_t": sigma_t, "albedo": 0.9})
    record = measured(stack(one), period="box", wavelengths=nm)
    for channel, x in enumerate(nm):
        tau = 3 - 2.5 * (x - 400) / 350
        patches, *_ = theory([(tau, 0.9, henyey_greenstein(0.0))], 30.0, PATCHES)
        agree(verdict(scores(record, patches[0], 0, channel)))
        other, *_ = theory([(tau / 4, 0.9, henyey_greenstein(0.0))], 30.0, PATCHES)
        disagree(verdict(scores(record, other[0], 0, channel)))
    with pytest.raises(gonio.SpecimenError, match="covers the wavelengths from 400"):
        measured(stack(one), period="box", wavelengths=800)


def test_almost_white_media_end():
    """The roulette is unbiased; `rr_depth` and none of it give the same."""
    scene = stack(medium(50.0, 0.999))
    usual = measured(scene, period="box", rays=20_000)
    early = measured(scene, period="box", rays=20_000, rr_depth=3, seed=1)
    total = theory([(50.0, 0.999, henyey_greenstein(0.0))], 30.0, PATCHES)[1][0]
    for record in (usual, early):
        agree(of_total(record, total))
    disagree(of_total(usual, total - 0.05))


def test_scatterings_may_be_limited():
    """What is cut off is in the ledger."""
    record = measured(stack(medium(5.0, 1.0)), period="box", max_scatterings=3)
    assert record.ledger.truncated > 0
    assert record.settings["max_scatterings"] == 3
    told = "HomogeneousMedium with IsotropicPhaseFunction: scale 1, albedo 1, sigma_t 5"
    assert record.settings["media"] == [told]
    assert told in " ".join(summary_text(summarize(record)).split())
    (sentence,) = summarize(record).warnings  # none of the direct light
    assert "truncated by max_depth or max_scatterings" in sentence
    assert "max_scatterings" not in measured({"type": "diffuse"}, rays=100).settings


def test_what_is_no_number_costs_no_record(monkeypatch):
    odd = [("name", object()), ("words", "grey"), ("sigma_t", 5.0)]
    monkeypatch.setattr(mi, "traverse", lambda _: odd)
    told = recording._medium_text(mi.load_dict({"type": "homogeneous"}))
    assert told == "HomogeneousMedium with IsotropicPhaseFunction: sigma_t 5"


BAD = {
    "an albedo of at most 1, got 1.2": {"albedo": 1.2},
    "a albedo that is finite and not negative, got -0.1": {"albedo": -0.1},
    "sigma_t that is finite and not negative, got -1": {"sigma_t": -1.0},
    "sigma_t that is finite and not negative, got nan": {"sigma_t": float("nan")},
    "sigma_t that is finite and not negative, got inf": {"sigma_t": float("inf")},
    "a sigma_t above 0 somewhere": {"sigma_t": 0.0},
}


@pytest.mark.parametrize("words", BAD)
def test_no_medium(words):
    one = mi.load_dict({"type": "homogeneous", **BAD[words]})
    with pytest.raises(gonio.SpecimenError, match=words):
        measured(ball(one))


def test_no_grid():
    for value in (-0.5, np.nan):
        with pytest.raises(gonio.SpecimenError, match="sigma_t that is finite"):
            measured(ball(grid([1.0, value])))


def test_what_media_do_not_have():
    """Estimators that look at surfaces, and emitters inside."""
    for estimator in ("next_event", "quadrature"):
        with pytest.raises(gonio.SpecimenError, match="weighted or analog"):
            measured(ball(medium()), estimator=estimator)
    opaque = ball(medium(), bsdf={"type": "diffuse"})
    with pytest.raises(gonio.SpecimenError, match="a BSDF that transmits, such as"):
        measured(opaque)
    emitter = {"type": "point", "position": [0, 0, 5.0], "medium": medium()}
    with pytest.raises(gonio.SpecimenError, match="emitter must stand in air"):
        measured(ball(medium()), emitter=emitter, theta_i=None)


@pytest.mark.needs("validation")
def test_validate_judges_boundaries_alone():
    with pytest.raises(gonio.SpecimenError, match="validate judges BSDFs, got a shape"):
        gonio.validate(SCENES / "milk_glass.xml")


def test_milk_glass():
    """Behind smooth faces, against adding and doubling (Prahl's iadpython).

    The reference is converged to 3e-4, a fifth of the standard error.
    """
    scene = SCENES / "milk_glass.xml"
    record = measured(scene, 0.0, parameters={"albedo": 0.99}, rays=100_000)
    plate = iadpython.Sample(a=0.99, b=10, g=0.7, n=1.5, quad_pts=32)
    total, passed, _, _ = plate.rt()
    agree(of_total(record, total))
    disagree(of_total(record, total + 0.02))
    agree(of_total(record, passed, "dht"))


def test_paint_hides_its_base():
    """The contrast of black and white falls with the thickness of the film."""
    contrasts = []
    for thickness in (0.02, 0.1, 0.5):
        film = {"thickness": thickness}
        pair = [
            measured(SCENES / "paint_film.xml", parameters=film | base, rays=10_000)
            for base in ({"base": 0.0}, {"base": 0.8})
        ]
        black, white = (record.dhr[0] for record in pair)
        assert black < white
        contrasts.append(white - black)
        if thickness == 0.1:
            assert pair[0].ledger.absorbed > 0 < pair[0].ledger.absorbed_inside
    assert contrasts[0] > 3 * contrasts[1] > 9 * contrasts[2] > 0


@pytest.mark.usefixtures("rgb")
def test_skin_is_red_and_leaf_is_green():
    skin = measured(SCENES / "skin.xml", rays=4000)
    assert skin.dhr[0] > skin.dhr[1] > skin.dhr[2]
    sides = [
        measured(SCENES / "leaf.xml", side=side, rays=4000)
        for side in ("front", "back")
    ]
    for side in sides:
        assert side.dhr.argmax() == side.dht.argmax() == 1
    front, back = sides
    # the spongy side is the paler one where the leaf absorbs
    assert np.all((back.dhr > front.dhr)[[0, 2]])


def test_leaf_transmits_alike_both_ways():
    """Reciprocity of a plate: lit all over, as much passes up as down (Lambertian)."""
    sky = {"type": "constant"}
    down = measured(SCENES / "leaf.xml", None, emitter=sky, rays=20_000)
    # of each direction alone it is another share
    up = measured(SCENES / "leaf.xml", RING_ANGLES, side="back", rays=3000)
    error = np.hypot(np.linalg.norm(up.dht_std_err) / len(up), down.dht_std_err[0])
    agree(single((down.dht[0] - up.dht.mean()) / error))
    disagree(single((down.dht[0] - 1.2 * up.dht.mean()) / error))


def test_rays_that_are_all_astray_are_no_measurement():
    """Layers whose medium is another one for each of its faces; twin: one for both."""
    one, other = medium(1.0, 1.0), medium(1.0, 1.0)
    faces = {"top": rectangle(0.0, None, one), "bottom": rectangle(-1.0, other, None)}
    with pytest.raises(gonio.SpecimenError, match=f"closed.*but all {RAYS} rays"):
        measured({"type": "scene", **faces}, period="box")
    assert measured(stack(one), period="box").ledger.astray == 0


def test_walls_of_a_medium_in_the_sides_of_a_cell_are_refused():
    """Light would pass into the next cell's medium untold; twin: a larger cell."""
    for bsdf in (NULL, GLASS):
        with pytest.raises(gonio.SpecimenError, match="no walls in the sides"):
            measured(cube(medium(1.0), bsdf=bsdf), period="box")
    assert measured(cube(medium(1.0)), period=(2.5, 2.5)).ledger.astray == 0


def test_rays_astray_are_told():
    """An open shape, and two that overlap: counted, and said."""
    one = medium(1.0, 1.0)
    shifted = ball(medium(2.0), radius=0.8, center=[0.7, 0, 0])
    overlapping = {"type": "scene", "a": ball(one), "b": shifted}
    without_sides = stack(one)
    for scene in (without_sides, overlapping):
        words = "a shape with a medium must be closed.*with --period box"
        with pytest.warns(RuntimeWarning, match=words):
            record = measured(scene)
        ledger = record.ledger
        assert 0 < ledger.astray < ledger.emitted == RAYS
        assert any("went astray" in text for text in summarize(record).warnings)

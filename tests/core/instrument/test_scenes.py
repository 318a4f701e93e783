"""Each file of `scenes` is a complete measurement, in every variant."""

from dataclasses import replace
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from budget import (
    agree,
    count_verdict,
    difference_scores,
    disagree,
    single,
    verdict,
)
from closed_forms import fresnel, slab

import gonio_mi as gonio
from gonio_mi.collector.directions import direction
from gonio_mi.threads import two_threads

SCENES = Path(__file__).parents[3] / "scenes"
NAMES = sorted(path.stem for path in SCENES.glob("*.xml"))


def render(name, **parameters):
    """Map and record of a scene file."""
    path = str(SCENES / f"{name}.xml")
    with two_threads():
        scene = mi.load_file(path, **{k: str(v) for k, v in parameters.items()})
    image = mi.render(scene)
    return np.array(image), scene.sensors()[0].film().record


COLOURS = ("llvm_ad_rgb", "llvm_ad_spectral")


@pytest.mark.usefixtures("variant")
@pytest.mark.parametrize("variant", COLOURS, indirect=True)
def test_loads_in_every_variant(variant):
    """And renders in one of the two; in llvm_ad_mono: see below."""
    with two_threads():
        for name in NAMES:
            mi.load_file(str(SCENES / f"{name}.xml"))
    for name in NAMES[COLOURS.index(variant) :: 2]:
        is_the_record(*render(name, rays=2000))


def is_the_record(image, record):
    assert record.ledger.emitted == 2000
    assert np.isfinite(image).all()
    rows = 30 * (1 + record.has_lower)
    assert image.shape == (rows, 30, len(record.channels))
    # exact: the map is the record, in single precision
    np.testing.assert_array_equal(image[:30], record.brdf.astype(np.float32))
    if record.has_lower:
        np.testing.assert_array_equal(image[30:][::-1], record.btdf.astype(np.float32))


@pytest.mark.parametrize("name", NAMES)
def test_render_and_measure_are_the_same(name):
    """Exact: same scene, same seed, same bits; twin: another seed."""
    image, record = render(name, rays=2000)
    is_the_record(image, record)
    same = gonio.measure(SCENES / f"{name}.xml", rays=2000)
    assert same.tallies == record.tallies
    if name == NAMES[0]:
        other = gonio.measure(SCENES / f"{name}.xml", rays=2000, seed=1)
        assert other.tallies != record.tallies


def test_lambertian():
    _, record = render("lambertian")
    share = record.subdivision.projected_solid_angles
    agree(count_verdict(record.counts[0], share))
    disagree(count_verdict(record.counts[0], share * record.subdivision.theta[:, None]))


@pytest.mark.promise("a scene file alone")
def test_glass_slab():
    _, record = render("glass_slab")
    n = record.ledger.emitted
    r = slab(np.cos(np.pi / 4), 1.5)
    spread = np.sqrt(n * r * (1 - r))
    agree(single((record.ledger.reflected - n * r) / spread))
    single_surface = fresnel(np.cos(np.pi / 4), 1.5)
    disagree(single((record.ledger.reflected - n * single_surface) / spread))


@pytest.mark.parametrize("theta_i", [0, 20])
def test_v_grooves(theta_i):
    """Grooves of 90 degrees are retro-reflectors across and mirrors along.

    A ray that meets both walls returns to where it came from, with the reflectance
    squared. Tilted by theta across the grooves, a share tan(theta) of the rays, those
    on the far wall from which the mirrored ray misses the other wall, leaves after one
    bounce, at 90 degrees - theta on the side of the source.
    """
    rho = 0.5
    _, record = render("micro_geometry", theta_i=theta_i, reflectance=rho)
    ledger = record.ledger
    n = ledger.emitted - ledger.missed
    twice = record.counts[0]
    back = record.subdivision.patch(direction(np.radians(theta_i), 0.0))
    if theta_i == 0:
        # rounding: between the walls rays fly level, and start off them by 2^-18 of the
        # largest coordinate, 50; those within that of a ridge pass over the next one
        lost = n - int(twice[0].sum())
        assert lost <= n * 2 * 51 * 2.0**-18
        # every other ray met both walls; a lost one weighs between 0 and 1
        assert abs(record.dhr[0] - rho**2 * (1 - lost / n)) <= lost / n + 4 * 2.0**-23
        return
    once = np.tan(np.radians(theta_i))
    at_back = int(twice.ravel()[back])
    spread = np.sqrt(n * once * (1 - once))
    agree(single((n - at_back - n * once) / spread))
    disagree(single((n - at_back - n * once * 1.05) / spread))


def test_anisotropic_lobe_follows_phi_i():
    """Half a turn of the specimen about z changes nothing, a quarter turn does."""
    scene = SCENES / "anisotropic_conductor.xml"
    how = {"collector": "projected:20x20", "sampler": "independent", "rays": 2 * 10**6}

    def at(phi_i, seed):
        return gonio.measure(scene, 45, phi_i, seed=seed, **how)

    def turned(record, sectors):
        """Reads the map from the azimuth of the beam."""
        (tally,) = record.tallies
        hits = np.roll(tally.hits, -sectors, axis=2)
        sums = np.roll(tally.sums, -sectors, axis=3)
        return replace(record, tallies=(replace(tally, hits=hits, sums=sums),))

    first = at(0, 1)
    agree(verdict(difference_scores(first, turned(at(180, 2), 10))))
    disagree(verdict(difference_scores(first, turned(at(90, 3), 5))))


def test_area_emitter_far_away_is_collimated():
    """Convergence: the maps come nearer as the emitter's angular size falls."""
    metal = {"type": "roughconductor", "alpha": 0.1}
    collimated = gonio.measure(metal, 45, rays=10**6, footprint=0.5)
    distances = []
    for radius in (4, 2, 0.01):
        _, record = render("area_emitter", radius=radius, rays=10**6)
        distances.append(np.abs(record.brdf - collimated.brdf).sum())
    assert distances[0] > distances[1] > distances[2]

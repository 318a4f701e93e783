"""Smooth glass against Fresnel's formulas, from both sides, as surface and as slab."""

import mitsuba as mi
import numpy as np
import pytest
from budget import agree, disagree, of_total, single
from closed_forms import fresnel, slab
from specimens import heightfield

import gonio_mi as gonio
from gonio_mi.collector.directions import direction
from gonio_mi.specimen.specimen import Specimen
from gonio_mi.transport.surface_events import flux_context

ETA = 1.5
RAYS = 2**18
ULP = 2.0**-23
GLASS = {"type": "dielectric", "int_ior": ETA, "ext_ior": 1.0}


def wide_slab():
    """Slab of thickness 1 whose sides no ray reaches."""
    transform = mi.ScalarTransform4f().scale([1000, 1000, 0.5])
    return {"type": "cube", "to_world": transform, "bsdf": GLASS}


def measure(specimen, theta_i, **settings):
    settings = {"rays": RAYS, "sampler": "independent"} | settings
    return gonio.measure(specimen, theta_i, **settings)


def counted(count, rays, p):
    """Verdict on a binomial count."""
    return single((count - rays * p) / np.sqrt(rays * p * (1 - p)))


def test_flux_context_is_importance():
    """In radiance mode transmitted weights carry 1 / eta^2: R + T is 0.47 or 2.2."""
    assert flux_context().mode == mi.TransportMode.Importance


@pytest.mark.parametrize(
    ("theta_i", "side", "trace"),
    [
        *((0, "front", True), (60, "front", False), (89.9, "front", True)),
        *((30, "back", True), (60, "back", False)),
    ],
)
def test_surface_keeps_all_light(theta_i, side, trace):
    record = measure(GLASS, theta_i, side=side, trace=trace, rays=2**19)
    ledger = record.ledger
    # exact: nothing else can happen to a ray
    assert ledger.reflected + ledger.transmitted + ledger.missed == ledger.emitted
    # rounding: each ray carries 1, to an ulp at each event
    assert abs(record.dhr[0] + record.dht[0] - 1) <= ULP
    met = ledger.emitted - ledger.missed
    eta = ETA if side == "front" else 1 / ETA
    r = fresnel(np.cos(np.radians(theta_i)), eta)
    if r == 1:
        assert ledger.reflected == met  # total internal reflection
        return
    agree(counted(ledger.reflected, met, r))
    disagree(counted(ledger.reflected, met, r - 0.1 * min(r, 1 - r)))


@pytest.mark.parametrize("theta_i", [41.7, 41.9])
def test_critical_angle(theta_i):
    """arcsin(1 / 1.5) = 41.81 degrees: just inside some light passes, beyond none."""
    record = measure(GLASS, theta_i, side="back")
    r = fresnel(np.cos(np.radians(theta_i)), 1 / ETA)
    if theta_i > np.degrees(np.arcsin(1 / ETA)):
        assert abs(record.dhr[0] - 1) <= ULP
        assert record.dht[0] == 0
    else:
        agree(counted(record.ledger.reflected, record.ledger.emitted, r))
        disagree(counted(record.ledger.reflected, record.ledger.emitted, 1 - r))


def test_refracted_beam_is_in_its_patch():
    """Snell's law, for two borders: the beam leaves in one patch of the lower map."""
    for side, eta in (("front", ETA), ("back", 1 / ETA)):
        record = measure(GLASS, 20, phi_i=33, side=side, rays=10**5)
        theta_t = np.arcsin(np.sin(np.radians(20)) / eta)
        v = direction(theta_t, np.radians(33 + 180))
        expected = record.subdivision.patch(v)
        np.testing.assert_array_equal(np.flatnonzero(record.counts[1]), [expected])


@pytest.mark.parametrize(
    ("theta_i", "side", "estimator", "footprint"),
    [
        *((0, "front", "analog", 400.0), (75, "back", "analog", 400.0)),
        *((0, "back", "weighted", 400.0), (45, "front", "weighted", 1.0)),
    ],
)
def test_slab(theta_i, side, estimator, footprint):
    """All internal reflections: R = 2 r / (1 + r) and T = 1 - R."""
    # clear of the sides, which would reflect as well
    how = {"side": side, "estimator": estimator, "footprint": footprint}
    record = measure(wide_slab(), theta_i, **how)
    ledger = record.ledger
    assert footprint > 1 or ledger.truncated == 0  # small, on large triangles
    r = slab(np.cos(np.radians(theta_i)), ETA)
    # rounding: an ulp at each of the few events
    lost = ledger.sideways + ledger.truncated
    assert ledger.reflected + ledger.transmitted + lost == ledger.emitted
    assert abs(record.dhr[0] + record.dht[0] - 1 + lost / ledger.emitted) <= 8 * ULP
    met = ledger.emitted
    agree(counted(ledger.reflected, met, r))
    # twin: one internal reflection less
    single_surface = fresnel(np.cos(np.radians(theta_i)), ETA)
    disagree(counted(ledger.reflected, met, single_surface))
    # what passes goes straight on, what does not is mirrored: one patch each
    v = direction(np.radians(theta_i), np.pi)
    if theta_i:
        expected = record.subdivision.patch(v)
        for hemisphere in (0, 1):
            hit = np.flatnonzero(record.counts[hemisphere])
            np.testing.assert_array_equal(hit, [expected])


def slab_times(scale):
    """The wide slab, so many times as large."""
    size = [1000 * scale, 1000 * scale, 0.5 * scale]
    return wide_slab() | {"to_world": mi.ScalarTransform4f().scale(size)}


def test_slab_of_any_size():
    """The same bits for a slab 1e-6 to 2e6 times as large: nothing has a length."""
    small, *others = (
        measure(slab_times(scale), 45, rays=10**5)
        for scale in (2.0**-20, 1.0, 2.0**20, 2.0**21)
    )
    assert all(small.tallies == other.tallies for other in others)


def test_slab_too_large():
    """Measured all the same, it does not end within a minute."""
    with pytest.raises(gonio.SpecimenError, match=r"within 2\.14748e\+09 of the orig"):
        measure(slab_times(2.0**22), 45, rays=1)


def test_russian_roulette_is_unbiased():
    """A mirror-walled path of many bounces, cut short by chance or not at all."""
    dim = {"type": "dielectric", "int_ior": 4.0, "ext_ior": 1.0}
    specimen = wide_slab() | {"bsdf": dim}
    r = slab(np.cos(np.radians(30)), 4.0)
    for estimator in ("analog", "weighted"):
        record = measure(specimen, 30, rr_depth=0, estimator=estimator)
        agree(of_total(record, r))
        disagree(of_total(record, r / 0.95))


def varnished(gap, scale=1.0):
    """Glass a gap above an opaque white base, of a square cell of 2 x 2 times `scale`.

    Returns
    -------
    scene : dict
    """
    size = mi.ScalarTransform4f().scale(scale)
    raised = size @ mi.ScalarTransform4f().translate([0, 0, gap])
    base = {"type": "diffuse", "reflectance": 0.8}
    return {
        "type": "scene",
        "base": {"type": "rectangle", "to_world": size, "bsdf": base},
        "glass": {"type": "rectangle", "to_world": raised, "bsdf": GLASS},
    }


def spheres(gap):
    """A white sphere in a shell of glass, whose offsets are those of curved shapes."""
    base = {"type": "sphere", "bsdf": {"type": "diffuse"}}
    shell = {"type": "sphere", "radius": 1 + gap, "bsdf": GLASS}
    return {"type": "scene", "base": base, "shell": shell}


def sentences(scene, period="none"):
    return Specimen(mi.load_dict(scene), period).thin_gaps()


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_thin_gap(scale):
    """Saunderson's formula holds, whatever the gap; where rays cannot, it is said."""
    cosines, weights = np.polynomial.legendre.leggauss(100)
    cosines = (cosines + 1) / 2
    out, into = fresnel(1.0, ETA), [fresnel(one, 1 / ETA) for one in cosines]
    back = weights @ (into * cosines)
    right = out + (1 - out) * (1 - back) * 0.8 / (1 - 0.8 * back)
    period = (2 * scale, 2 * scale)
    record = gonio.measure(varnished(1e-5, scale), 0, period=period, rays=2**14)
    assert record.dht == 0
    agree(of_total(record, right))
    disagree(of_total(record, right / 0.95))
    for gap in (1e-6, 1e-7, 0.0):
        with pytest.warns(RuntimeWarning, match="light may pass one of them unseen"):
            found = gonio.measure(varnished(gap, scale), 0, period=period, rays=2**8)
        (told,) = found.provenance.defects
        assert "one of them unseen" in told


def test_thin_gaps_of_curved_shapes():
    """Without offsets of its own a shell goes unseen from a gap of 1e-5 on."""
    assert not sentences(spheres(3e-5))
    for gap in (1e-5, 1e-6, 1e-7):
        assert "2 scene units" not in sentences(spheres(gap))[0]
        assert "less than 1.1e-05" in sentences(spheres(gap))[0]
    opaque = spheres(1e-6)
    opaque["shell"] |= {"bsdf": {"type": "conductor"}}
    assert not sentences(opaque), "no light gets in"


def test_a_film_on_rough_ground():
    """Glass that follows heights: what lies between is thin all over, or nowhere."""
    heights = np.random.default_rng(5).uniform(0, 3, (32, 32))

    def film(lift):
        above = mi.ScalarTransform4f().translate([0, 0, lift])
        return heightfield(heights, size=32.0, bsdf=GLASS, transform=above)

    ground = heightfield(heights, size=32.0, bsdf={"type": "diffuse"})
    for lift, is_thin in ((1e-5, True), (1e-2, False)):
        both = {"type": "scene", "ground": ground, "film": film(lift)}
        assert bool(sentences(both, "box")) is is_thin
    assert not sentences({"type": "scene", "film": film(0.0)}, "box"), "glass alone"

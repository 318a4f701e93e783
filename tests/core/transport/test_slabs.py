"""Media between planes, held against the exact theory of radiative transfer."""

import mitsuba as mi
import numpy as np
import pytest
from benchmark.discrete_ordinates import henyey_greenstein, theory
from budget import agree, difference_scores, disagree, normal_scores, scores, verdict
from plates import plate, rings
from slabs import chandrasekhar, medium, rectangle, stack

import gonio_mi as gonio
from gonio_mi.collector.directions import direction
from gonio_mi.single_precision import ROUNDING

PATCHES = "projected:5x6"
RAYS = 100_000


def measured(scene, theta_i=0.0, **settings):
    settings = {"period": "box", "rays": RAYS, "sampler": "independent"} | settings
    return gonio.measure(scene, theta_i=theta_i, **{"collector": PATCHES} | settings)


def of_totals(record, totals):
    """Verdict on reflectance and transmittance; the direct light is in that."""
    measured = np.array([record.dhr, record.dht])[:, 0]
    errors = np.array([record.dhr_std_err, record.dht_std_err])[:, 0]
    # nothing passes a thick layer
    known = errors > 0
    scores = (measured - totals)[known] / errors[known]
    return verdict(normal_scores(scores, record.n_batches - 1))


def of_rings(record, brdf):
    """Flux fractions of patches of which `brdf` is a function of the cosine."""
    x, weights = np.polynomial.legendre.leggauss(8)
    edges = np.cos(record.subdivision.theta_edges)[::-1]
    half = np.diff(edges)[:, None] / 2
    mu = edges[:-1, None] + half * (1 + x)
    rings = np.sum(brdf(mu) * mu * half * weights, axis=1)[::-1]
    n_theta, n_phi = record.subdivision.shape
    return np.broadcast_to(rings[:, None] * 2 * np.pi / n_phi, (n_theta, n_phi))


def with_direct(patches, record, direct):
    """Flux fractions of theory, with the direct light in its patch."""
    patches = patches.copy()
    theta_i, phi_i = np.radians([record.theta_i[0], record.phi_i[0] + 180])
    number = record.subdivision.patch(direction(theta_i, phi_i)[None])[0]
    patches[1].ravel()[number] += direct
    return patches


# thickness, albedo, g, angle of incidence; the whole grid is a study of the handbook
CASES = [
    (2.0, 0.9, 0.75, 0.0),
    (0.1, 0.5, 0.9, 85.0),
    (1.0, 0.99, -0.5, 60.0),
    (10.0, 1.0, 0.0, 60.0),
]


@pytest.mark.parametrize(
    ("tau", "albedo", "g", "theta_i", "estimator"),
    [(*case, ("weighted", "analog")[i % 2]) for i, case in enumerate(CASES)],
)
def test_one_layer(tau, albedo, g, theta_i, estimator):
    """Each patch with its azimuth, both totals, and the direct light."""
    layer = (tau, albedo, henyey_greenstein(g))
    patches, totals, direct = theory([layer], theta_i, PATCHES)
    record = measured(stack(medium(tau, albedo, g)), theta_i, estimator=estimator)
    assert record.settings["transport"] == "layers"
    patches = with_direct(patches, record, direct)
    for hemisphere in (0, 1):
        agree(verdict(scores(record, patches[hemisphere], hemisphere)))
    disagree(verdict(scores(record, 1.1 * patches[1], 1)))
    agree(of_totals(record, totals + [0, direct]))
    disagree(of_totals(record, totals + [0.02, direct - 0.02]))
    assert record.ledger.direct == round(RAYS * record.direct[0])  # of weight 1


def test_van_de_hulst():
    """His table, as Wang, Jacques and Zheng (1995) quote it to five digits."""
    record = measured(stack(medium(2.0, 0.9, 0.75)), sampler="sobol", rays=2**20)
    table = np.array([0.09739, 0.66096])
    agree(of_totals(record, table))
    disagree(of_totals(record, table * 1.01))


@pytest.mark.parametrize("theta_i", [0.0, 60.0])
@pytest.mark.promise("a medium inside")
def test_half_space(theta_i):
    """Isotropic scattering without a lower end, by Chandrasekhar's H functions."""
    albedo, mu0 = 0.9, np.cos(np.radians(theta_i))
    record = measured(stack(medium(40.0, albedo)), theta_i, rays=2 * RAYS)

    def brdf(mu):
        h = chandrasekhar(mu, albedo) * chandrasekhar(mu0, albedo)
        return albedo / (4 * np.pi) / (mu + mu0) * h

    patches = of_rings(record, brdf)
    agree(verdict(scores(record, patches)))
    disagree(verdict(scores(record, 1.03 * patches)))


@pytest.mark.parametrize(
    ("tau", "albedo", "g", "index", "theta_i"),
    [(0.1, 0.5, -0.5, 1.5, 85), (1, 0.99, 0.9, 1.4, 60), (10, 1, 0, 1.5, 0)],
)
def test_behind_smooth_faces(tau, albedo, g, index, theta_i):
    """Ring by ring against adding and doubling, whose error is below a tenth of ours.

    What reflects and passes unscattered is in the rings, after any number of inner
    reflections.
    """
    patches = "projected:8x1"
    edges = gonio.subdivision(patches).theta_edges
    theta_i, exact = rings(tau, albedo, g, index, edges, theta_i)
    _, other = rings(tau, albedo, g, 0.9 * index, edges, theta_i)
    scene = plate(tau, albedo, g, index)
    record = measured(scene, theta_i, collector=patches, rays=2 * RAYS)
    assert record.settings["transport"] == "layers"
    for hemisphere in (0, 1):
        agree(verdict(scores(record, exact[hemisphere][:, None], hemisphere)))
        disagree(verdict(scores(record, other[hemisphere][:, None], hemisphere)))
    agree(of_totals(record, exact.sum(axis=1)))


@pytest.mark.parametrize("trace", [False, True])
def test_conservative_media_lose_no_ray(trace):
    """Whole rays leave, however thick the layer and whatever its boundary."""
    for bsdf in ({"type": "null"}, {"type": "dielectric", "int_ior": 1.5}):
        scene = stack(medium(8.0, 1.0, 0.5), bsdf=bsdf)
        record = measured(scene, 60.0, trace=trace, rays=20_000)
        ledger = record.ledger
        left = ledger.reflected + ledger.transmitted + ledger.direct
        assert left == ledger.emitted == 20_000
        # with all their light, but for the rounding of some 64 events
        assert abs(record.dhr + record.dht - 1) < 64 * ROUNDING


def test_both_ways_agree():
    """By depth alone and traced: the same patches, for rough boundaries too."""
    bsdf = {"type": "roughdielectric", "alpha": 0.3, "int_ior": 1.4}
    scene = stack(medium(3.0, 0.95, 0.6), medium(1.0, 0.6), bsdf=bsdf)
    layers = measured(scene, 40.0)
    traced = measured(scene, 40.0, trace=True, seed=1)
    assert layers.settings["transport"] == "layers"
    assert traced.settings["transport"] == "traced"
    for hemisphere in (0, 1):
        agree(verdict(difference_scores(layers, traced, hemisphere)))
    other = measured(stack(medium(3.0, 0.9, 0.6), medium(1.0), bsdf=bsdf), 40.0)
    disagree(verdict(difference_scores(other, traced)))


def test_layers_over_a_base():
    """Two media over a Lambertian base, as a skin is."""
    base = {"type": "diffuse", "reflectance": 0.6}
    scene = stack(medium(0.5, 0.7, 0.8), medium(1.5, 0.98, 0.3), base=base)
    record = measured(scene, 30.0)
    layers = [(0.5, 0.7, henyey_greenstein(0.8)), (1.5, 0.98, henyey_greenstein(0.3))]
    patches, *_ = theory(layers, 30.0, PATCHES, base=0.6)
    agree(verdict(scores(record, patches[0])))
    assert record.ledger.absorbed > 0
    assert record.ledger.absorbed_inside > 0
    black, *_ = theory(layers, 30.0, PATCHES, base=0.55)
    disagree(verdict(scores(record, black[0])))


def rayleigh(order):
    return {0: 1.0, 2: 0.1}.get(order, 0.0)


def mixed(order):
    return 0.3 * henyey_greenstein(-0.4)(order) + 0.7 * henyey_greenstein(0.7)(order)


def table_of(g, n=2001):
    """The Henyey-Greenstein phase function as a table over the cosine."""
    cosine = np.linspace(-1, 1, n)
    values = (1 - g**2) / (4 * np.pi * (1 + g**2 - 2 * g * cosine) ** 1.5)
    return {"type": "tabphase", "values": ",".join(f"{v:.9g}" for v in values)}


def flakes():
    """Flakes that look alike from all sides: the matrix 1, in Mitsuba's order."""
    grid = mi.VolumeGrid(np.float32([1, 1, 1, 0, 0, 0]).reshape(1, 1, 1, 6))
    return {"type": "sggx", "S": {"type": "gridvolume", "grid": grid, "raw": True}}


LOBES = {"a": {"type": "hg", "g": -0.4}, "b": {"type": "hg", "g": 0.7}}
PHASES = {
    "rayleigh": ({"type": "rayleigh"}, rayleigh),
    "table": (table_of(0.5), henyey_greenstein(0.5)),
    "blend": ({"type": "blendphase", "weight": 0.7} | LOBES, mixed),
    "flakes": (flakes, lambda order: float(order == 0)),
}


@pytest.mark.parametrize("name", PHASES)
def test_phase_functions(name):
    phase, legendre = PHASES[name]
    phase = phase() if callable(phase) else phase
    patches, _, direct = theory([(1.0, 0.9, legendre)], 50.0, PATCHES)
    record = measured(stack(medium(1.0, 0.9, phase)), 50.0)
    patches = with_direct(patches, record, direct)
    z = [scores(record, one, number) for number, one in enumerate(patches)]
    agree(verdict(np.concatenate(z)))
    other, *_ = theory([(1.0, 0.9, henyey_greenstein(0.3))], 50.0, PATCHES)
    disagree(verdict(scores(record, other[0])))


def test_orders_tell_single_from_multiple_scattering():
    """They add up to the bit; the single one has a closed form."""
    tau, albedo, theta_i = 1.0, 0.8, 50.0
    scene = stack(medium(tau, albedo))
    given = {"theta_i": theta_i, "rays": 3 * RAYS}
    whole = measured(scene, **given)
    parts = {o: measured(scene, **given, order=o) for o in ("0", "1", "2+")}
    sums = [part.tallies[0].sums for part in parts.values()]
    assert np.array_equal(sum(sums), whole.tallies[0].sums)
    assert parts["0"].dht == whole.direct
    assert parts["0"].dhr == 0
    mu0 = np.cos(np.radians(theta_i))

    def brdf(mu):
        """Chandrasekhar (1950), of an isotropic layer."""
        scattered = -np.expm1(-tau * (1 / mu + 1 / mu0))
        return albedo / (4 * np.pi) / (mu + mu0) * scattered

    patches = of_rings(whole, brdf)
    agree(verdict(scores(parts["1"], patches)))
    disagree(verdict(scores(parts["1"], 1.03 * patches)))


def test_what_is_no_layer_is_traced():
    """A smaller plate below, or one that is tilted."""
    one = medium(1.0)
    scene = stack(one)
    bead = {"type": "sphere", "radius": 0.2, "center": [0, 0, -0.5]}
    bead["bsdf"] = {"type": "conductor"}
    for other in (rectangle(-2.0, bsdf={"type": "diffuse"}, size=0.5), bead):
        record = measured({**scene, "other": other}, 30.0, rays=1000)
        assert record.settings["transport"] == "traced"
        assert record.ledger.astray == 0

"""Estimator `next_event`: `eval` is deposited from geometry towards patches."""

from functools import cache

import drjit as dr
import mitsuba as mi
import numpy as np
import plain_bsdf
import pytest
from benchmark import groove
from budget import (
    Verdict,
    agree,
    difference_scores,
    disagree,
    normal_scores,
    of_total,
    often_enough,
    scores,
    single,
    verdict,
)
from scipy import stats
from specimens import (
    GREY,
    MIRROR,
    as_it_is,
    both_sided,
    grooves,
    heightfield,
    specimen_of,
    spheres_on_a_plane,
)

import gonio_mi as gonio
from gonio_mi.collector.directions import direction
from gonio_mi.errors import SpecimenError
from gonio_mi.estimators import next_event
from gonio_mi.results.statistics import batch_std_err, student_score
from gonio_mi.settings.measurement_settings import PILOT_RAYS
from gonio_mi.single_precision import FEW_ROUNDINGS
from gonio_mi.specimen.loading import load_specimen
from gonio_mi.specimen.rays import escapes
from gonio_mi.specimen.specimen import Specimen

GRID = "projected:8x12"
RAYS = 2**16


ROUGH_MIRROR = both_sided({"type": "roughconductor", "alpha": 0.3})
SHELL = {"type": "mask", "opacity": 0.6, "bsdf": GREY}


def field(bsdf, **settings):
    return heightfield(bsdf=bsdf, alpha=0.5, resolution=32, **settings)


CLOSED = {"period": "box", "hemispheres": "both"}
# Specimen, and settings of the measurement.
CASES = {
    "rough mirror": lambda: (field(ROUGH_MIRROR), CLOSED),
    "grooves": lambda: (grooves(30, 1, bsdf=GREY), CLOSED),
    "spheres": lambda: (spheres_on_a_plane(), CLOSED | {"period": "2,2"}),
    "edges": lambda: (field(GREY), {"theta_i": 70}),
    "smooth normals": lambda: (
        field(GREY, face_normals=False),
        CLOSED | {"theta_i": 60},
    ),
    "delta and smooth": lambda: (
        field(both_sided({"type": "plastic", "diffuse_reflectance": 0.8})),
        {"period": "box"},
    ),
    "rough glass": lambda: (
        field({"type": "roughdielectric", "alpha": 0.5}),
        {"period": "box", "collector": "projected:4x6"},
    ),
    "shell": lambda: (field(SHELL), {"period": "box", "collector": "projected:4x6"}),
    "second order": lambda: (field(GREY), {"period": "box", "order": 2}),
    "near collector, back": lambda: (
        field({"type": "roughdielectric", "alpha": 0.5}),
        {"collector_radius": 2.0, "side": "back", "collector": "projected:4x6"},
    ),
    "apertures": lambda: (
        field(GREY),
        {"period": "box", "collector": "apertures:10@30/180,60/90,0/0"},
    ),
    "klems": lambda: (field(GREY), {"period": "box", "collector": "klems"}),
}


def measured(name, estimator, **settings):
    specimen, own = CASES[name]()
    settings = {"theta_i": 30, "collector": GRID, "rays": RAYS, **own, **settings}
    return gonio.measure(specimen, estimator=estimator, **settings)


@pytest.mark.parametrize("name", CASES)
def test_deposits_are_unbiased(name):
    """All patches of both hemispheres against `weighted`; twin: 10 % off."""
    deposited = measured(name, "next_event", seed=1, points=2)
    weighted = measured(name, "weighted", seed=2)
    assert deposited.ledger.emitted == RAYS
    for hemisphere in (0, 1):
        z = difference_scores(weighted, deposited, hemisphere)
        if not z.size:
            assert not deposited.counts[hemisphere].any()
            continue
        agree(verdict(z))
    shares = weighted.flux_fraction[0, ..., 0]
    disagree(verdict(scores(deposited, 1.1 * shares)))


def test_a_lower_hemisphere_that_appears_dark(monkeypatch):
    """Exact: through gaps it does not; and where that is wrong, there is no bias.

    Twin: nearly a third off, since few points went there.
    """
    for name, dark in (("grooves", True), ("spheres", True), ("rough glass", False)):
        shapes, settings = CASES[name]()
        assert specimen_of(shapes, settings["period"]).appears_opaque == dark
    ball = spheres_on_a_plane()["sphere"]
    assert not specimen_of(ball, "box").appears_opaque
    monkeypatch.setattr(Specimen, "appears_opaque", True)
    deposited = measured("rough glass", "next_event", seed=1, points=4)
    weighted = measured("rough glass", "weighted", seed=2)
    for hemisphere in (0, 1):
        agree(verdict(difference_scores(weighted, deposited, hemisphere)))
    lower = 1.3 * weighted.flux_fraction[1, ..., 0]
    disagree(verdict(scores(deposited, lower, hemisphere=1)))


def test_lambertian_plane():
    """Each deposit is cos / pi per solid angle: the patches' mean is 1 / pi."""
    plane = {"type": "diffuse", "reflectance": 1.0}
    settings = {"estimator": "next_event", "collector": "angle:6x8", "rays": RAYS}
    for sampler in ("sobol", "independent"):
        record = gonio.measure(plane, 45, sampler=sampler, trace=True, **settings)
        truth = record.subdivision.projected_solid_angles / np.pi
        agree(verdict(scores(record, truth)))
        disagree(verdict(scores(record, 1.03 * truth)))
        assert record.ledger.reflected + record.ledger.rejected == RAYS


@pytest.mark.parametrize("margin", [FEW_ROUNDINGS, 0])
def test_the_narrowest_window_loses_no_points(margin, monkeypatch):
    """Of a Lambertian; twin: points of the window alone, which rounding takes out."""
    monkeypatch.setattr(next_event, "FEW_ROUNDINGS", margin)
    half = {"type": "diffuse", "reflectance": 0.5}
    settings = {"estimator": "next_event", "trace": True, "points": 64}
    window = "receptors:45/180/0.02"
    record = gonio.measure(half, 20, rays=2**17, collector=window, **settings)
    error = record.brdf[0, 0, 0] - 0.5 / np.pi
    z = student_score(error / record.brdf_std_err[0, 0, 0], record.n_batches - 1)
    (agree if margin else disagree)(single(z))


def test_delta_specimens_are_those_of_weighted():
    """Exact: after delta components rays are counted, from the same numbers.

    Mirror facets in light that diverges: else their first order is known.
    """
    settings = {"period": "box", "divergence": 1.0, "rays": 5000}
    for bsdf in (MIRROR, {"type": "dielectric"}):
        a, b = (
            gonio.measure(field(bsdf), 50, estimator=estimator, **settings)
            for estimator in ("weighted", "next_event")
        )
        assert a.tallies == b.tallies
        assert a.counts.sum() == 5000


@pytest.mark.parametrize(
    ("name", "theta_i"),
    [
        *(("rough mirror", 89.9), ("grooves", 30)),
        *(("spheres", 89.9), ("smooth normals", 30), ("balls", 30)),
    ],
)
def test_nothing_is_deposited_below_a_closed_surface(name, theta_i):
    """Twin: light passes between balls, and deposits say so."""
    specimen, settings = CASES["spheres" if name == "balls" else name]()
    how = {"theta_i": theta_i, "collector": GRID, "rays": RAYS, "points": 2}
    specimen = specimen["sphere"] if name == "balls" else specimen
    record = gonio.measure(specimen, estimator="next_event", **settings | how)
    assert record.counts[0].any()
    assert record.counts[1].any() == (name == "balls")


@pytest.mark.parametrize("mended", [True, False])
def test_light_that_starts_beside_the_cell(mended, monkeypatch):
    """Exact: off a wall at its side it goes inside; twin: taken as it is, it escapes.

    Rays that start up to 1e-5 beyond the side y = 1, between two balls, and go down to
    the plane between them, which ends there.
    """
    specimen = specimen_of(spheres_on_a_plane(), "2,2")
    low, high = [-0.1, 1 + 1e-6, -0.99], [0.1, 1 + 1e-5, -0.9]
    start = np.random.default_rng(0).uniform(low, high, (1000, 3)).T
    ray = mi.Ray3f(mi.Point3f(start), dr.normalize(mi.Vector3f(0.1, -1e-4, -1)))
    if not mended:
        monkeypatch.setattr("gonio_mi.specimen.rays.into_cell", as_it_is)
    free = escapes(specimen, 1, ray, mi.Normal3f(0), mi.Float(0), mi.Bool(True))
    assert np.array(free).any() != mended


def test_ledger_counts_rays_and_patches_count_deposits():
    """Exact: rows add up to the rays; each deposits at most once per point and exit."""
    record = measured("edges", "next_event", points=3)
    ledger = record.ledger
    assert ledger.emitted == RAYS
    assert min(ledger.reflected, ledger.missed, ledger.over_the_edge) > 0
    assert ledger.sideways == ledger.absorbed == 0
    first = measured("edges", "next_event", points=3, order=1)
    assert ledger.reflected < first.counts.sum() <= 4 * (RAYS - ledger.missed)
    assert first.counts.sum() < record.counts.sum()


def test_few_deposits_have_an_interval_by_students_t():
    """Exact: however few, as wide as the batches say, above 0; none without any."""
    record = measured("rough mirror", "next_event", rays=128, batches=8)
    few = (record.counts[0] > 0) & (record.counts[0] < 10)
    assert few.any()
    low, high = (limit[few, 0] for limit in record.interval(0.95))
    value = record.brdf[few, 0]
    tally, solid = record.tallies[0], record.subdivision.projected_solid_angles
    own = batch_std_err(tally.sums[:, 0], tally.incident[:, None, None])[..., 0] / solid
    half = 2.36 * own[few]
    assert (high - value >= half).all()
    assert (low <= np.maximum(value - half, 0)).all()
    low, high = record.interval(0.95)
    empty = record.without_hit[0]
    assert empty.any()
    assert (low[empty] == 0).all()
    assert (high[empty] > 0).all()


def test_channels(rgb):  # noqa: ARG001
    """Each channel carries its own colour."""
    colour = {"type": "rgb", "value": [0.1, 0.5, 0.9]}
    paint = both_sided({"type": "diffuse", "reflectance": colour})
    settings = {"period": "box", "order": 1, "collector": "projected:3x4"}
    records = [
        gonio.measure(
            field(paint), 30, estimator=estimator, rays=RAYS, seed=seed, **settings
        )
        for seed, estimator in enumerate(("weighted", "next_event"))
    ]
    for channel in range(3):
        agree(verdict(difference_scores(*records, channel=channel)))
    disagree(verdict(scores(records[1], records[0].flux_fraction[0, ..., 1])))


def test_an_invalid_eval_is_in_the_ledger():
    """A NaN reaches no patch; rows still add up."""

    class NanEval(plain_bsdf.plain()):
        def eval(self, ctx, si, wo, active=True):  # noqa: ARG002
            return mi.Spectrum(float("nan"))

    plain_bsdf.register([NanEval])
    with pytest.warns(RuntimeWarning, match=r"sample\(\) or eval\(\) returned"):
        record = gonio.measure(
            {"type": "nan_eval"}, 30, estimator="next_event", trace=True, rays=1000
        )
    assert record.ledger.invalid == record.ledger.emitted == 1000
    assert not record.counts.any()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"estimator": "next_event"}, "needs geometry, got a flat rectangle"),
        ({"points": 0}, "points must be"),
        ({"points": 10**6}, "points must be"),
    ],
)
def test_bad_settings_are_one_sentence(settings, message):
    with pytest.raises((SpecimenError, ValueError), match=message) as caught:
        gonio.measure({"type": "diffuse"}, 30, rays=1000, **settings)
    assert "\n" not in str(caught.value)


@pytest.mark.needs("analysis")
def test_a_chart_compares_it_on_geometry_only():
    names = ["weighted", "next_event"]
    settings = {"estimators": names, "samplers": ["sobol"], "collector": GRID}
    settings |= {"seconds": 0.01, "repeats": 2}
    chart = gonio.chart(field(GREY), 30, period="box", **settings)
    assert [curve.estimator for curve in chart.curves] == names
    flat = gonio.chart({"type": "diffuse"}, 30, **settings)
    assert [curve.estimator for curve in flat.curves] == ["weighted"]


# ----------------------------------------------------------- many points for each event


@cache
def diffuse_grooves():
    """Cell of endless grooves of 90 degrees, whose BRDF is known, and its patches'."""
    wall = both_sided({"type": "diffuse", "reflectance": groove.REFLECTANCE})
    patches = gonio.EqualProjectedSolidAngle(8, 12)
    fine, coarse = (
        groove.patch_means(direction(np.radians([45.0]), np.zeros(1)), points)
        for points in (patches.points(24), patches.points(16))
    )
    # far below what the tests can see
    assert np.abs(fine - coarse).max() < 1e-3 * fine.mean()
    return grooves(45, 1, bsdf=wall), fine.reshape(patches.shape)


def many_points(specimen, **settings):
    settings |= {"period": "box", "collector": GRID, "estimator": "next_event"}
    return gonio.measure(specimen, 45, **settings)


def together(record, truth):
    """Verdict on patches that share their rays: their sum, and the worst of them."""
    omega = record.subdivision.projected_solid_angles
    z = (record.brdf - truth[..., None]) / record.brdf_std_err
    z = normal_scores(z, record.n_batches - 1)
    # of any patches, however alike, one is so bad at most as often as all together
    worst = min(1.0, z.size * 2 * stats.norm.sf(np.abs(z).max()))
    total = of_total(record, (truth * omega).sum()).p["value"]
    return Verdict({"total": total, "worst": worst}, z.size)


@pytest.mark.parametrize(
    ("points", "sampler"),
    [(7, "independent"), (96, "sobol"), (200, "sobol")],
)
def test_many_points_against_radiosity(points, sampler):
    """A few rays that light many patches each; twin: 5 % off."""
    specimen, truth = diffuse_grooves()
    settings = {"rays": 2**20 // points, "points": points, "sampler": sampler}
    record = many_points(specimen, **settings)
    agree(together(record, truth))
    disagree(together(record, 1.05 * truth))


def test_many_points_cover():
    """The intervals of few rays, each of which lights all patches."""
    specimen, truth = diffuse_grooves()
    loaded, parts, twins = load_specimen(specimen), [], []
    for seed in range(24):
        record = many_points(loaded, rays=2**10, points=96, seed=seed)
        low, high = (limit[..., 0] for limit in record.interval(0.95))
        parts.append(((low <= truth) & (truth <= high)).mean())
        near = np.abs((low + high) / 2 - truth) <= (high - low) / 4
        twins.append(near.mean())
    agree(often_enough(parts))
    disagree(often_enough(twins))


def test_many_points_begin_with_few_rays():
    """Exact: the first look at the precision is at as many points as rays otherwise."""
    record = many_points(diffuse_grooves()[0], points=96, rel_err=0.9)
    assert record.ledger.emitted == 16 * (PILOT_RAYS // (16 * 96))

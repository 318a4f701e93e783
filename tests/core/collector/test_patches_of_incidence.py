"""Light that fills a patch: which directions it has, and what a patch of glass does."""

import mitsuba as mi
import numpy as np
import pytest
from budget import agree, disagree, single, verdict
from scipy import stats

import gonio_mi as gonio
from gonio_mi.collector import subdivision
from gonio_mi.collector.directions import direction
from gonio_mi.collector.klems import Klems
from gonio_mi.collector.shirley_chiu import ShirleyChiu
from gonio_mi.transport.collector_sphere import CollectorSphere

EPS = np.finfo(float).eps

# A mask that is open everywhere: light goes straight on.
OPEN = {"type": "null"}


# ------------------------------------------------------------------ Shirley and Chiu


def test_solid_angles_of_cells_are_integrals():
    """Second order: of 1 / cos(theta) at more and more points of each cell."""
    cells = ShirleyChiu(8)
    errors = []
    for n in (8, 16, 32):
        z = cells.points(n)[..., 2]
        found = (1 / z).mean(axis=1) * np.pi / cells.n_patches
        # at the horizon 1 / cos(theta) is infinite
        inner = cells.middles[0].ravel() < np.radians(55)
        errors.append(np.abs(found / cells.solid_angles.ravel() - 1)[inner].max())
    assert errors[0] > 3 * errors[1] > 9 * errors[2]


def test_cells_in_the_instrument_are_those_of_numpy():
    cells = ShirleyChiu(16)
    assert (cells.patch(cells.points(4)) == np.arange(256)[:, None]).all()
    wo = direction(*np.random.default_rng(3).uniform(0, 1.57, (2, 10_000)))
    index = CollectorSphere(cells).patch_index(mi.Vector3f(wo.T.astype(np.float32)))
    assert (index.numpy() != cells.patch(wo)).sum() <= 1


@pytest.mark.parametrize("text", ["shirley-chiu:3", "shirley-chiu:0", "shirley-chiu:x"])
def test_bad_cells_are_refused(text):
    with pytest.raises(ValueError, match=r"(size|collector) must"):
        subdivision(text)


# ------------------------------------------------------------------- the beam fills it


def shares(incident, theta_i, phi_i, finer, side="front"):
    """Counts of a beam that goes straight on, and the shares of its patch's parts."""
    record = gonio.measure(
        OPEN,
        theta_i,
        phi_i,
        incident=incident,
        collector=finer,
        side=side,
        rays=2**17,
        estimator="analog",
        sampler="independent",
    )
    coarse, fine = subdivision(incident), subdivision(finer)
    points = fine.points(1)[:, 0]
    patch = coarse.patch(direction(*np.radians([theta_i, phi_i])))
    opposite = points * [-1, -1, 1]
    inside = coarse.patch(opposite) == patch
    projected = fine.projected_solid_angles.ravel()
    return record.counts[1].ravel(), np.where(inside, projected, 0)


@pytest.mark.parametrize(
    ("incident", "theta_i", "phi_i", "finer"),
    [
        ("projected:2x4", 20, 50, "projected:8x16"),
        ("solid:3x4", 80, 200, "solid:12x16"),
        ("shirley-chiu:4", 40, 100, "shirley-chiu:16"),
    ],
)
@pytest.mark.parametrize("side", ["front", "back"])
def test_directions_are_uniform_in_projected_solid_angle(
    incident, theta_i, phi_i, finer, side
):
    counts, weights = shares(incident, theta_i, phi_i, finer, side)
    inside = weights > 0
    assert counts[~inside].sum() == 0
    for power, judge in ((1, agree), (0, disagree)):
        expected = weights[inside] ** power
        if power == 0:
            expected = expected * (1 + 0.05 * np.arange(inside.sum()))
        expected = counts.sum() * expected / expected.sum()
        p = stats.chisquare(counts[inside], expected).pvalue
        judge(single(stats.norm.isf(p / 2)))


# ------------------------------------------------------------------------------- glass


def thin_glass(theta, n=1.5046):
    """Transmittance of a pane: all orders between two interfaces (Fresnel)."""
    inside = np.arcsin(np.sin(theta) / n)
    s = (np.cos(theta) - n * np.cos(inside)) / (np.cos(theta) + n * np.cos(inside))
    p = (n * np.cos(theta) - np.cos(inside)) / (n * np.cos(theta) + np.cos(inside))
    r = (s**2 + p**2) / 2
    return (1 - r) / (1 + r)


def test_glass_sends_a_patch_to_one_patch():
    """All of them: the light of each is in the opposite one, as Fresnel has it."""
    klems = Klems("quarter")
    record = gonio.measure(
        {"type": "thindielectric", "int_ior": 1.5046, "ext_ior": 1.0},
        incident="klems-quarter",
        collector="klems-quarter",
        rays=2**12,
        sampler="independent",
    )
    there = direction(np.radians(record.theta_i), np.radians(record.phi_i + 180))
    lit = record.flux_fraction[:, 1, :, 0, 0] > 0
    assert (lit.sum(axis=1) == 1).all()
    assert (lit.argmax(axis=1) == klems.patch(there)).all()
    points = klems.points(64)  # of the mean over a patch, to 1e-4
    mean = thin_glass(np.arccos(points[..., 2])).mean(axis=1)
    z = (record.dht[:, 0] - mean) / np.sqrt(mean * (1 - mean) / 2**12)
    agree(verdict(z))
    centre = thin_glass(np.radians(record.theta_i))
    outer = record.theta_i > 70
    disagree(verdict((record.dht[:, 0] - centre)[outer] * 2**6 / 0.5))


# --------------------------------------------------------------------- what is refused


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"incident": "clems"}, "incident must look like"),
        ({"incident": "apertures:5@0/0"}, "incident must be patches about one pole"),
        ({"incident": "klems", "phi_i": 30}, "phi_i requires theta_i"),
        (
            {"incident": "klems", "divergence": 1},
            "incident and divergence are mutually exclusive",
        ),
        (
            {"incident": "klems", "theta_i": 0, "estimator": "quadrature"},
            "needs a collimated beam",
        ),
        (
            {"incident": "klems", "emitter": {"type": "constant"}},
            "incident and emitter are mutually exclusive",
        ),
    ],
)
def test_settings_that_exclude_each_other(settings, message):
    with pytest.raises(ValueError, match=message):
        gonio.measure({"type": "diffuse"}, **settings)


def test_a_campaign_measures_all_patches(tmp_path):
    settings = {"incident": "klems-quarter", "collector": "klems-quarter", "rays": 64}
    here = gonio.measure({"type": "diffuse"}, **settings)
    kept = gonio.measure({"type": "diffuse"}, **settings, folder=tmp_path / "kept")
    assert len(here) == 41
    assert np.array_equal(here.flux_fraction, kept.flux_fraction)
    assert np.array_equal([here.theta_i, here.phi_i], [kept.theta_i, kept.phi_i])
    assert here.settings["incident"] == "klems-quarter"

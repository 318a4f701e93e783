"""Directions of a stack share launches, and each has the bits that it has alone."""

from itertools import islice, pairwise

import mitsuba as mi
import numpy as np
import plain_bsdf
import pytest

import gonio_mi as gonio
from gonio_mi.collector.directions import direction
from gonio_mi.instrument import launcher, schedule
from gonio_mi.instrument.setup import set_up
from gonio_mi.results.tally import batch_sizes
from gonio_mi.settings import MeasurementSettings
from gonio_mi.specimen.loading import specimen_of

GLASS = {"type": "roughdielectric", "alpha": 0.3}
MATT = {"type": "twosided", "bsdf": {"type": "diffuse"}}
ANGLES = {"theta_i": [0, 10, 45, 80], "phi_i": [0, 33, 200]}
SMALL = {"rays": 1003, "batches": 4, "collector": "projected:3x4"}

# Slots for batches of five directions, of 2 x 12 patches and 14 fates.
FIVE = 2 * (2 * 12 + 14) * 4 * 5


@pytest.fixture
def launches(monkeypatch):
    """Numbers of batches of all launches; of five directions at most."""
    found, send = [], launcher.launch

    def noted(one):
        found.append(len(one.sizes))
        return send(one)

    monkeypatch.setattr(launcher, "launch", noted)
    monkeypatch.setattr(launcher, "FUSED_SUMS", FIVE)
    return found


def interrupted_after(n, launches):
    """Launches as before, until `n` of them are noted."""
    send = launcher.launch

    def launch(one):
        if len(launches) == n:
            raise KeyboardInterrupt
        return send(one)

    return launch


def check_alone(stack, specimen, which, **settings):
    """Exact: some directions of a stack have the bits and settings that each has."""
    for i in which:
        angles = float(stack.theta_i[i]), float(stack.phi_i[i])
        alone = gonio.measure(specimen, *angles, **settings)
        assert stack[i].tallies == alone.tallies
        one, other = dict(stack[i].settings), dict(alone.settings)
        del one["created"], other["created"]
        assert one == other


@pytest.mark.parametrize("side", ["front", "back"])
def test_directions_are_the_nearest_of_single_precision(side):
    """Exact, of the first and of those turned from it."""
    incidents = [(7.0 * i, 31.0 * i) for i in range(13)]
    settings = MeasurementSettings(side=side)
    setups = set_up(specimen_of(MATT), settings, incidents)
    wanted = direction(*np.radians(incidents).T)
    wanted[:, 2] *= 1 if side == "front" else -1
    found = [np.ravel(np.array(setup.beam.wi)) for setup in setups]
    assert np.array_equal(found, wanted.astype(np.float32))


@pytest.mark.parametrize(
    "settings",
    [{"footprint": 0.4}, {"divergence": 2.0, "estimator": "analog"}, {"side": "back"}],
)
def test_directions_share_launches(launches, settings):
    """Twelve in groups of four, with batches that differ by one ray."""
    stack = gonio.measure(GLASS, **ANGLES, **SMALL, **settings)
    assert launches == [16] * 3
    check_alone(stack, GLASS, (0, 5, 11), **SMALL, **settings)
    assert stack[0].tallies != stack[11].tallies


@pytest.mark.parametrize(
    ("wish", "trace"),
    [({"rel_err": 0.05}, False), ({"noise": 0.005}, False), ({"rel_err": 0.05}, True)],
)
def test_directions_share_launches_until_they_are_precise(
    launches, monkeypatch, wish, trace
):
    """Those that are not go on alone, or with others that need as many rays."""
    monkeypatch.setattr(schedule, "PILOT_RAYS", 2**8)
    settings = SMALL | wish | {"rays": None, "trace": trace}
    stack = gonio.measure(GLASS, **ANGLES, **settings)
    assert max(launches) == 16 > min(launches) == 4
    rays = {tally.ledger.emitted for tally in stack.tallies}
    assert 1 < len(rays) < len(stack)
    for number in (0, 5, 11):
        angles = float(stack.theta_i[number]), float(stack.phi_i[number])
        alone = gonio.measure(GLASS, *angles, **settings)
        assert alone.tallies[0] == stack.tallies[number]


def test_patches_of_incidence_share_launches(launches):
    settings = SMALL | {"incident": "projected:2x4"}
    stack = gonio.measure(GLASS, **settings)
    assert launches == [16] * 2
    check_alone(stack, GLASS, (0, 7), **settings)


def test_launches_are_cut_where_they_are_long(launches, monkeypatch):
    """Of two batches of each direction, and of half of their rays."""
    monkeypatch.setattr(launcher, "FIRST_PLANE", 2 * 4 * 251)
    monkeypatch.setattr(launcher, "LAUNCH_SECONDS", 1e-9)  # from then on 1024 rays
    stack = gonio.measure(GLASS, **ANGLES, **SMALL)
    assert launches[0] == 8
    assert len(launches) > 6
    check_alone(stack, GLASS, (1, 6), **SMALL)


def test_few_directions_and_plugins_in_python_go_one_by_one(launches, monkeypatch):
    """A plugin in Python may take the first ray's direction for that of all."""
    gonio.measure(GLASS, [0, 40], **SMALL)
    assert launches == [4] * 2

    class FirstRay(plain_bsdf.plain()):
        def value(self, _, si, wo):
            return mi.Spectrum(float(si.wi.z.numpy()[0]) * wo.z / np.pi)

    plain_bsdf.register([FirstRay])
    del launches[:]
    polar = list(range(0, 80, 8))
    stack = gonio.measure({"type": "first_ray"}, polar, **SMALL)
    assert launches == [4] * 10
    cosines = np.cos(np.radians(polar))
    np.testing.assert_allclose(stack.dhr[:, 0], cosines, rtol=2.0**-20)
    monkeypatch.setattr(launcher, "_may_share", lambda _: True)
    wrong = gonio.measure({"type": "first_ray"}, polar, **SMALL)
    assert abs(wrong.dhr[4, 0] - stack.dhr[4, 0]) > 0.1


def test_ctrl_c_in_a_stack_that_shares_launches(launches, monkeypatch):
    """What is kept is whole directions, and what carries it on has the same bits."""
    whole = gonio.measure(GLASS, **ANGLES, **SMALL)
    send = launcher.launch
    monkeypatch.setattr(launcher, "launch", interrupted_after(5, launches))
    with pytest.warns(RuntimeWarning, match="8024 of 12036 rays"):
        part = gonio.measure(GLASS, **ANGLES, **SMALL)
    monkeypatch.setattr(launcher, "launch", send)
    assert part.tallies == whole.tallies[:8]
    resumed = gonio.measure(GLASS, **ANGLES, **SMALL, resume=part)
    assert resumed.tallies == whole.tallies


def test_ctrl_c_before_directions_are_precise(launches, monkeypatch):
    """All are kept as they are after the rounds that were shared."""
    monkeypatch.setattr(schedule, "PILOT_RAYS", 2**8)
    monkeypatch.setattr(launcher, "launch", interrupted_after(3, launches))
    monkeypatch.setattr(launcher, "FUSED_SUMS", 3 * FIVE)
    wish = SMALL | {"rays": None, "rel_err": 0.05}
    with pytest.warns(RuntimeWarning, match="12 of 12 .*, some of them less precise"):
        part = gonio.measure(GLASS, **ANGLES, **wish)
    assert [tally.n_batches for tally in part.tallies] == [4] * 12
    assert part.provenance.reached > 0.05


@pytest.mark.parametrize(
    "settings", [{"footprint": "full"}, {"estimator": "next_event"}]
)
def test_traced_directions_share_launches(launches, monkeypatch, settings):
    """Exact: each walks along a curve of its own, in whole packets of rays.

    Also where a launch ends in the midst of the curves.
    """
    monkeypatch.setattr(launcher, "FUSED_SUMS", 2 * FIVE)
    monkeypatch.setattr(launcher, "FIRST_TRACED", 4 * 2**10)
    hills = {"type": "heightfield", "alpha": 0.5, "resolution": 16, "bsdf": MATT}
    settings = SMALL | settings | {"rays": 5001}
    stack = gonio.measure(hills, **ANGLES, **settings)
    assert launches[0] == 24
    assert len(launches) < 12
    check_alone(stack, hills, (0, 5, 11), **settings)


@pytest.mark.parametrize("sampler", ["sobol", "independent"])
@pytest.mark.parametrize("points", [5, 1024])
def test_launches_send_no_more_points_than_sums_hold(points, sampler):
    """Exact, however fast the machine. Twin: as many rays, of one point each.

    Patches hold 2**24 of the largest deposits, as `test_dark_light` shows.
    """

    def sent(points):
        settings = {"estimator": "next_event", "points": points, "sampler": sampler}
        sphere = specimen_of({"type": "sphere"})
        setups = set_up(sphere, MeasurementSettings(**settings), [(0.0, 0.0)])
        sends = launcher.Launcher(setups)
        sends.size.rays = 2**40
        ((one,), *_) = sends.plan(setups, schedule.Round((2**25,) * 16))
        return max(piece.rays for piece in islice(sends.pieces(one), 4))

    assert sent(points) * points <= 2**24
    assert sent(1) * points > 2**24


@pytest.mark.parametrize(("n", "rays"), [(1, 1003), (9, 1003), (9, 2**20)])
@pytest.mark.parametrize("shape", ["rectangle", "sphere"])
def test_plan_sends_each_ray_of_each_batch_once(shape, n, rays, launches):
    """Exact, and nothing is launched for it."""
    settings = MeasurementSettings(rays=rays, batches=7, collector="projected:3x4")
    specimen = specimen_of({"type": shape})
    setups = set_up(specimen, settings, [(5.0 * i, 0.0) for i in range(n)])
    sends = launcher.Launcher(setups)
    sends.size.rays = 2**10
    part = schedule.Round(tuple(batch_sizes(rays, 7)))
    planned = [one for (one,) in sends.plan(setups, part)]
    keys = [key for one in planned for key in one.keys]
    expected = [(*one.key, batch, 0) for batch in range(7) for one in setups]
    assert keys == expected
    for one in planned:
        pieces = list(sends.pieces(one))
        assert len(one.sizes) <= one.capacity
        if shape == "rectangle":
            sent = np.sum([piece.sizes for piece in pieces], axis=0)
            assert sent.tolist() == list(one.sizes)
            assert [piece.begin for piece in pieces] == [
                sum(piece.sizes[0] for piece in pieces[:i]) for i in range(len(pieces))
            ]
            continue
        # along a curve, whose stretches follow each other without a gap
        for piece, after in pairwise(pieces):
            first, end = after.curve.part[0], piece.curve.part[1]
            assert first in (end, 0)
            assert first or after.begin == piece.begin + piece.sizes[0]
    sizes = [size for one in planned for size in one.sizes]
    assert sizes == [size for size in part.sizes for _ in setups]
    assert launches == []

"""Every direction has one patch; the patches' solid angles are exact."""

import mitsuba as mi
import numpy as np
import pytest
from budget import agree, count_verdict, disagree

from gonio_mi import Borders, Subdivision, adapted, subdivision
from gonio_mi.collector import Receptors, RingsAndSectors
from gonio_mi.collector.directions import angles, direction
from gonio_mi.collector.equal_steps import (
    EqualAngle,
    EqualProjectedSolidAngle,
    EqualSine,
    EqualSolidAngle,
)
from gonio_mi.collector.hemisphere import EDGE
from gonio_mi.transport.collector_sphere import CollectorSphere


def uneven(n_theta, n_phi):
    """Borders that are narrow at the pole and at the azimuth 0."""
    theta = 90 * (np.arange(n_theta + 1) / n_theta) ** 1.5
    phi = 360 * (np.arange(n_phi + 1) / n_phi) ** 1.5
    return Borders(theta, phi)


KINDS = (EqualAngle, EqualSolidAngle, EqualProjectedSolidAngle, EqualSine)
SIZES = ((1, 1), (2, 3), (10, 10), (30, 30), (100, 100), (1000, 1000))
EPS = np.finfo(float).eps

kinds = pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
all_kinds = pytest.mark.parametrize(
    "kind", [*KINDS, uneven], ids=lambda kind: kind.__name__
)
sizes = pytest.mark.parametrize("size", SIZES, ids=lambda size: f"{size[0]}x{size[1]}")


# Of every kind, and those whose patches are more than a few and not too fine to count.
EVERY = [f"{kind.name}:{n}x{m}" for kind in KINDS for n, m in SIZES]
EVERY += [str(uneven(n, m)) for n, m in SIZES]
EVERY += ["borders:0.0,30.0,90.0x0.0,180.0,360.0", "klems", "klems-half"]
EVERY += ["klems-quarter", *(f"shirley-chiu:{n}" for n in (2, 6, 16, 256))]
EVERY += ["apertures:5.0@30.0/0.0,20.0/90.0"]
EVERY += [
    "receptors:20.0/180.0/1.8/3.6,21.9/180.0/1.8/3.6,20.0/40.0/70.0,85.0/10.0/4.0"
]


@pytest.mark.parametrize("text", EVERY, ids=lambda text: text[:24])
def test_every_subdivision(text):
    """All that an instrument asks of it: a name, areas, a patch for each direction.

    Twin: the counts of directions tell the two areas apart.
    """
    patches = subdivision(text)
    assert str(patches) == text
    assert subdivision(str(patches)) == patches
    n, shape, n_detectors = patches.n_patches, patches.shape, patches.n_detectors
    asked = {x for x, y in vars(Subdivision).items() if isinstance(y, property)}
    if text.startswith("shirley"):  # squares mapped to a disc
        asked.remove("cells")
    answers = {name: getattr(patches, name) for name in asked}
    assert np.prod(shape) == n
    assert 0 < n_detectors <= n
    assert answers.get("cells", np.empty((n, 4))).shape == (n, 4)
    # rounding: each ring's borders, two sines and three products, then the sum; of
    # squares two arc sines and square roots in each cell
    bound = (10 + np.log2(n)) * EPS * (1 if "cells" in asked else shape[0])
    for name, whole in (("solid_angles", 2 * np.pi), ("projected_solid_angles", np.pi)):
        assert answers[name].shape == shape
        assert abs(answers[name].sum() / whole - 1) <= bound
    # each middle is in its patch, and the lower hemisphere mirrors
    assert [angle.shape for angle in patches.middles] == [shape, shape]
    middles = direction(*(angle.ravel()[:n_detectors] for angle in patches.middles))
    numbers = np.arange(n_detectors)
    assert np.array_equal(patches.patch(middles), numbers)
    assert np.array_equal(patches.patch(middles * [1, 1, -1]), numbers)
    found, held = patches.detectors(middles)
    assert np.array_equal(found, numbers)
    assert held.all()
    if 20 < n <= 300 or patches.axes is not None:
        sin2, phi = np.random.default_rng(2).random((2, 100_000))
        v = direction(np.arcsin(np.sqrt(sin2)), 2 * np.pi * phi)
        counts = np.bincount(patches.patch(v), minlength=n)
        agree(count_verdict(counts, answers["projected_solid_angles"]))
        disagree(count_verdict(counts, answers["solid_angles"]))


@kinds
@sizes
def test_what_is_said_to_be_equal_is_equal(kind, size):
    patches = kind(*size)
    measure = {
        EqualAngle: np.diff(patches.theta_edges),
        EqualSolidAngle: patches.solid_angles,
        EqualProjectedSolidAngle: patches.projected_solid_angles,
        EqualSine: np.diff(np.sin(patches.theta_edges)),
    }[kind]
    # rounding: a ring is the difference of borders, exact to a few eps of pi / 2
    bound = 8 * EPS * size[0]
    np.testing.assert_allclose(measure, measure.mean(), rtol=bound)


@all_kinds
def test_projected_solid_angles_are_the_integral_of_the_cosine(kind):
    # rounding: a 20-point Gauss rule is exact far below eps on one ring
    patches = kind(30, 7)
    x, w = np.polynomial.legendre.leggauss(20)
    low, high = patches.theta_edges[:-1, None], patches.theta_edges[1:, None]
    theta = (low + high) / 2 + (high - low) / 2 * x
    half = (high - low)[:, 0] / 2 * patches.phi_edges[1]
    np.testing.assert_allclose(
        patches.projected_solid_angles[:, 0],
        half * (np.sin(theta) * np.cos(theta) @ w),
        rtol=100 * EPS,
    )
    np.testing.assert_allclose(
        patches.solid_angles[:, 0], half * (np.sin(theta) @ w), rtol=100 * EPS
    )


@kinds
def test_mean_of_cosines_is_exact_and_mean_of_angles_is_not(kind):
    """The paper's two theta_r (eq. 2, section 3.1 and Figure 2)."""
    patches = kind(30, 30)
    exact = patches.projected_solid_angles
    # rounding: cosines near the horizon are exact to eps of 1, in steps of 1 / n_theta
    np.testing.assert_allclose(
        patches.adjusted_solid_angles("cosine"), exact, rtol=4 * 30 * EPS
    )
    assert np.abs(patches.adjusted_solid_angles("theta") / exact - 1).max() > 3e-4


@pytest.mark.parametrize(
    ("n_theta", "printed"), [(9, 3.8e-3), (18, 9.5e-4), (45, 1.5e-4)]
)
def test_figure_2(n_theta, printed):
    """Mean of angles over mean of cosines is 1 / cos(half a ring), in every ring."""
    patches = EqualAngle(n_theta, 1)
    ratio = patches.adjusted_solid_angles("theta") / patches.projected_solid_angles
    half = np.pi / (4 * n_theta)
    np.testing.assert_allclose(ratio, 1 / np.cos(half), rtol=64 * EPS)
    # and that is what Figure 2 shows, to the two digits of the reading
    assert abs(ratio[0, 0] - 1 - printed) < 0.05 * 10 ** np.floor(np.log10(printed))


def test_mean_of_angles_converges_quadratically():
    errors = [
        np.abs(
            EqualAngle(n, 1).adjusted_solid_angles("theta")
            / EqualAngle(n, 1).projected_solid_angles
            - 1
        ).max()
        for n in (8, 16, 32, 64)
    ]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    # convergence: the next term of 1 / cos is smaller by (pi / 32)^2 < 1 %
    np.testing.assert_allclose(orders, 2, atol=0.01)


@all_kinds
@sizes
def test_borders_are_half_open(kind, size):
    """A direction on a border is in the patch that begins there."""
    patches = kind(*size)
    theta, phi = patches.theta_edges[:-1], patches.phi_edges[:-1]
    middle_theta = patches.theta[size[0] // 2]
    on_ring = patches.patch(direction(theta[1:], patches.phi[0]))
    np.testing.assert_array_equal(on_ring // size[1], np.arange(1, size[0]))
    on_sector = patches.patch(direction(middle_theta, phi))
    np.testing.assert_array_equal(on_sector % size[1], np.arange(size[1]))


@all_kinds
def test_points_of_a_patch_share_its_projected_solid_angle(kind):
    patches = kind(6, 5)
    points = patches.points(4)
    assert points.shape == (30, 16, 3)
    np.testing.assert_array_equal(
        patches.patch(points), np.arange(30)[:, None] * np.ones(16, int)
    )
    chosen = np.array([7, 3, 29])
    np.testing.assert_array_equal(patches.points(4, chosen), points[chosen])
    # as many in each cell of a grid of sin^2 and azimuth inside of the patch
    low, high, left, right = patches.cells.T[:, :, None]
    theta, phi = angles(points)
    rank = (np.sin(theta) ** 2 - np.sin(low) ** 2) / (
        np.sin(high) ** 2 - np.sin(low) ** 2
    )
    turn = (phi - left) / (right - left)
    cell = 4 * np.floor(4 * rank) + np.floor(4 * turn)
    np.testing.assert_array_equal(
        np.sort(cell, axis=1), np.tile(np.arange(16), (30, 1))
    )


@pytest.mark.parametrize(
    "text", ["projected:3x4", "borders:0,30,90x0,180,360", "klems"]
)
def test_values_in_rings_are_those_of_the_patches(text):
    patches = subdivision(text)
    numbers = np.arange(patches.n_patches).reshape(*patches.shape, 1)
    rings, seen = patches.in_rings(numbers)
    assert isinstance(rings, RingsAndSectors)
    assert seen.shape == (*rings.shape, 1)
    assert (patches.patch(rings.points(3)) == seen.reshape(-1, 1)).all()
    # rounding: a sum of up to 4320 differences of sines, each exact to a few eps of 1
    solid = np.bincount(seen.ravel(), rings.projected_solid_angles.ravel())
    bound = 4320 * 4 * EPS
    np.testing.assert_allclose(
        solid, patches.projected_solid_angles.ravel(), rtol=0, atol=bound
    )


def test_apertures_have_no_common_points():
    with pytest.raises(ValueError, match="must have a common pole"):
        subdivision("apertures:5.0@30.0/0.0").points(2)


def test_apertures_are_receptors_of_one_width():
    """The same areas, cells and patches; but an aperture measures its axis only.

    Twin: windows of another width are other patches.
    """
    cones = subdivision("apertures:5@30/0,20/90,60/200")
    windows, wider = Receptors(cones.windows), subdivision("receptors:30/0/11")
    v = float32_directions(5000, seed=4).astype(float)
    v = np.concatenate([v, cones.axes[:3] + [0, 0, 1e-3]])
    for name in ("solid_angles", "projected_solid_angles", "cells", "axes", "middles"):
        ours, theirs = getattr(cones, name), getattr(windows, name)
        # rounding: the rest is 2 pi or pi less three cones, in another order
        np.testing.assert_allclose(ours, theirs, rtol=3 * EPS)
    np.testing.assert_array_equal(cones.patch(v), windows.patch(v))
    assert not np.array_equal(cones.patch(v) == 0, wider.patch(v) == 0)
    assert cones.within([(20.0, 90.0, 10.0)]).tolist() == [False, True, False, False]
    assert cones.within(wider.windows) is EqualAngle(2, 3).within(wider.windows) is None
    assert cones.fills_cells
    assert windows.detectors(v[-3:])[1].all()
    assert not cones.detectors(v[-3:])[1].any()


@pytest.mark.parametrize(
    ("windows", "fill"),
    [
        ("30/0/5,60/0/5", True),
        ("30/0/5,30/0/9", False),
        ("30/0/5/5", False),
    ],
)
def test_receptors_that_fill_their_cells(windows, fill):
    """Round ones, of which none lies in another."""
    assert subdivision(f"receptors:{windows}").fills_cells == fill


@kinds
def test_pole_and_signs_of_zero(kind):
    patches = kind(5, 8)
    for x in (0.0, -0.0):
        for y in (0.0, -0.0):
            assert patches.patch([x, y, 1.0]) == 0
            assert patches.patch([x, y, -1.0]) == 0
    for zero in (0.0, -0.0):
        s = np.sqrt(0.5)
        assert patches.patch([s, zero, s]) % 8 == 0
        assert patches.patch([-s, zero, s]) % 8 == 4
        assert patches.patch([zero, s, s]) % 8 == 2
        assert patches.patch([zero, -s, s]) % 8 == 6


@all_kinds
@pytest.mark.parametrize("n", [1, 30, 1000])
def test_the_last_ring_reaches_the_horizon(kind, n):
    patches = kind(n, 4)
    for z in (1e-3 / n, 1e-12, 1e-30):
        v = np.array([np.sqrt(1 - z * z), 0, z])
        assert patches.patch(v) // 4 == n - 1


def float32_directions(n, seed):
    """Unit vectors in single precision: everywhere, near the pole, near the horizon."""
    rng = np.random.default_rng(seed)
    u = rng.uniform(size=n)
    small = 10.0 ** rng.uniform(-9, 0, n)
    theta = np.concatenate(
        [np.arccos(u), small * np.pi / 2, np.pi / 2 - small * np.pi / 2]
    )
    return direction(theta, rng.uniform(0, 2 * np.pi, 3 * n)).astype(np.float32)


@all_kinds
@sizes
def test_numpy_and_drjit_agree_on_the_patch(kind, size):
    """Where they do not, the direction is within single precision of a border."""
    v = float32_directions(100_000, seed=size[0])
    v = v[v[:, 2] > 0]
    patches = kind(*size)
    collector = CollectorSphere(patches)
    index = collector.patch_index(mi.Vector3f(np.ascontiguousarray(v.T))).numpy()
    assert index.max() < patches.n_patches
    expected = patches.patch(v)
    assert expected.min() >= 0
    assert expected.max() < patches.n_patches
    off = np.flatnonzero(index != expected)
    # never more than to a neighbour, and only next to a border: twice EDGE, relative
    # in the ring coordinate (from the nearer of pole and horizon), absolute in azimuth
    ring, sector = np.divmod(index[off].astype(int), size[1])
    e_ring, e_sector = np.divmod(expected[off], size[1])
    step = np.abs(sector - e_sector)
    assert np.all(np.abs(ring - e_ring) <= 1)
    assert np.all(np.minimum(step, size[1] - step) <= 1)
    theta, phi = angles(v[off])
    border = patches.theta_edges[np.maximum(ring, e_ring)]
    near = np.minimum(border, np.pi / 2 - border)
    moved = ring != e_ring
    assert np.all(np.abs(theta - border)[moved] <= 2 * EDGE * near[moved])
    # the border at phi = 0 lies between the last sector and the first
    last = np.where(step > 1, 0, np.maximum(sector, e_sector))
    gap = np.abs(phi - patches.phi_edges[last])
    gap = np.minimum(gap, 2 * np.pi - gap)
    assert np.all(gap[step > 0] <= 2 * EDGE)


@all_kinds
def test_every_direction_has_exactly_one_patch(kind):
    """Counting by index and counting by borders agree, cell by cell."""
    patches = kind(12, 16)
    v = float32_directions(50_000, seed=1).astype(float)
    v = v[v[:, 2] > 0]
    theta, phi = angles(v)
    ring = np.searchsorted(patches.theta_edges, theta, side="right") - 1
    sector = np.searchsorted(patches.phi_edges, phi, side="right") - 1
    clear = np.ones(len(v), bool)
    for edges, value in ((patches.theta_edges[1:-1], theta), (patches.phi_edges, phi)):
        gap = np.abs(value[:, None] - edges).min(axis=1)
        clear &= gap > 2 * EDGE * np.pi
    assert clear.mean() > 0.5
    np.testing.assert_array_equal(patches.patch(v)[clear], (ring * 16 + sector)[clear])


def test_name_of_borders():
    found = subdivision("borders:0,30.5,90x0,120,180,360")
    assert found == Borders((0, 30.5, 90), (0, 120, 180, 360))
    assert found.shape == (2, 3)


@pytest.mark.parametrize(
    ("theta", "phi", "name"),
    [
        ((0, 90, 30), (0, 360), "theta_deg must ascend from 0 to 90"),
        ((0, 0, 90), (0, 360), "theta_deg must ascend from 0 to 90"),
        ((1, 90), (0, 360), "theta_deg must ascend from 0 to 90"),
        ((0, 90), (0, 180), "phi_deg must ascend from 0 to 360"),
        ((0, 90), (), "phi_deg must ascend from 0 to 360"),
    ],
)
def test_borders_ascend_from_end_to_end(theta, phi, name):
    with pytest.raises(ValueError, match=name):
        Borders(theta, phi)


def test_adapted_borders_are_quantiles():
    """Of a pilot that saw three quarters of the light in the first of two rings."""
    grid = Borders((0, 45, 90), (0, 90, 360))
    flux = np.array([[0.5, 0.25], [0.0, 0.25]])
    found = adapted(flux / grid.projected_solid_angles, grid, 4, 2, uniform=0.25)
    # the rings have half of all projected solid angle each: with a quarter of that the
    # flux is 11/16 and 5/16, and the quarters of all of it are at these sin^2
    sin2 = np.array([0, 2 / 11, 4 / 11, 0.5 + 0.5 / 5, 1])
    # the first quadrant has half of the flux, and so 3/8 + 1/16 of the mixture: the
    # rest of a half, 1/16, is a ninth of what the other three have
    phi = np.array([0, 90 + 270 / 9, 360])
    # rounding: a few products and sums, and the arcsine near its steep end
    np.testing.assert_allclose(np.sin(found.theta_edges) ** 2, sin2, atol=16 * EPS)
    np.testing.assert_allclose(found.phi_deg, phi, rtol=16 * EPS)


@pytest.mark.parametrize(
    ("brdf", "uniform", "message"),
    [
        (np.zeros((2, 3)), 0.5, "carry light"),
        (np.ones((3, 2)), 0.5, "brdf must have the shape"),
        (np.ones((2, 3)), 0.0, "uniform must be a number in"),
    ],
)
def test_pilots_that_adapt_nothing(brdf, uniform, message):
    with pytest.raises(ValueError, match=message):
        adapted(brdf, EqualAngle(2, 3), 4, 4, uniform)


@pytest.mark.parametrize(
    "text",
    ["projected", "projected:30", "x:3x3", "angle:3x-3", "angle:0x3", "angle:axb"]
    + ["apertures:2@10/0,2@20/90", "apertures:5@10", "borders:0,a"],
)
def test_bad_names_are_refused(text):
    with pytest.raises(ValueError, match=r"collector must look like|at least 1"):
        subdivision(text)


@pytest.mark.parametrize("text", ["klems:3", "klem"])
def test_all_kinds_are_told(text):
    with pytest.raises(ValueError, match=r"borders:.*, apertures:.*, or klems, got"):
        subdivision(text)


def test_too_many_patches_are_refused():
    """Beyond 2**24 patches single precision would merge neighbours."""
    assert EqualAngle(4096, 4096).n_patches == 2**24
    with pytest.raises(
        ValueError, match="at most 16777216 patches, got angle:4096x4097"
    ):
        EqualAngle(4096, 4097)

"""Derivatives of the first-order BRDF for heights and vertices.

Closed forms in double precision come first: a Lambertian V-groove with its shadows, and
a solid without any. Differences with common random numbers follow.
"""

from itertools import pairwise

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from budget import agree, disagree, normal_scores, verdict
from specimens import both_sided, grooves, heightfield, mesh

import gonio_mi as gonio
from gonio_mi.collector.directions import direction
from gonio_mi.errors import (
    SettingError,
    SettingTypeError,
    SpecimenError,
    VariantError,
)
from gonio_mi.estimators.moving_surface import MovingSurface, _where
from gonio_mi.instrument import differentiable_surface
from gonio_mi.surfaces.mesh_edges import mesh_edges, welded

WHITE = {"type": "diffuse", "reflectance": 1.0}
GLOSSY = {"type": "roughconductor", "alpha": 0.3, "distribution": "ggx"}
ROUGH_GLASS = {"type": "roughdielectric"}
BATCHES = 8
DIRECTIONS = [(0, 0), (20, 120), (40, 0), (60, 60), (60, 180)]


class NoEdges(MovingSurface):
    """Twin: visibility does not change."""

    def _lights(self, *settings):
        yield next(super()._lights(*settings))


def twin_of(kind, monkeypatch, *args, **settings):
    """A differentiable surface whose derivatives lack something."""
    monkeypatch.setattr(differentiable_surface, "MovingSurface", kind)
    return gonio.DifferentiableSurface(*args, **settings)


def field(slope, n=32, seed=3):
    """Periodic heights of the rms slope over a period of 1."""
    k = np.fft.fftfreq(n)[:, None] ** 2 + np.fft.fftfreq(n) ** 2
    noise = np.random.default_rng(seed).normal(size=(n, n))
    heights = np.real(np.fft.ifft2(np.fft.fft2(noise) * np.exp(-120 * k)))
    return heights * slope / np.std(np.diff(heights, axis=1) * n)


def rough(slope, bsdf=GLOSSY, **settings):
    return heightfield(field(slope), size=1.0, bsdf=both_sided(bsdf), **settings)


def of_errors(derivative, exact):
    """Verdict on a derivative, direction by direction."""
    found = np.isfinite(derivative.std_err)
    assert np.all(exact[~found] == 0)
    t = ((derivative.value - exact) / derivative.std_err)[found]
    return verdict(normal_scores(t, derivative.n_batches - 1))


# -------------------------------------------------------------------- closed forms


def slope_in(function, x, step=1e-6):
    """Derivative in double precision."""
    return (function(x + step) - function(x - step)) / (2 * step)


def groove_brdf(depth, wi):
    """BRDF of one event of a white Lambertian V-groove along y, at `DIRECTIONS`.

    It is 1 wide, its crests at x = -1/2 and 1/2. From a direction a wall is seen from
    its own crest down to the shadow of the other one, at 1 / (1 + slope tan).
    """
    slope, found = 2 * depth, []
    for wo in direction(*np.radians(DIRECTIONS).T):
        total = 0.0
        for side in (slope, -slope):
            n = np.array([side, 0.0, 1.0])
            tilts = [1 + side * w[0] / w[2] for w in (wi, wo)]
            if min(tilts) > 0:
                seen = min(1 / 2, 1 / max(tilts))
                total += seen * (n @ wi) * (n @ wo) / np.linalg.norm(n)
        found.append(total / (np.pi * wi[2] * wo[2]))
    return np.array(found)[:, None]


@pytest.mark.parametrize("theta", [0, 50])
def test_depth_of_a_groove(theta, monkeypatch):
    """Statistics, against a closed form with shadows and masks.

    Twin: without edges. At normal incidence only masks have any.
    """
    depth, wi = 0.6, direction(np.radians(theta), 0.0)
    exact = slope_in(lambda x: groove_brdf(x, wi), depth)
    groove = grooves(np.degrees(np.arctan(0.5 / depth)), 2, bsdf=both_sided(WHITE))
    settings = {"directions": DIRECTIONS, "period": "box", "points": 2**14}
    surface = gonio.DifferentiableSurface(groove, theta, **settings)
    deeper = surface.geometry.numpy() / depth
    agree(of_errors(surface.derivative(deeper, batches=BATCHES), exact))
    still = twin_of(NoEdges, monkeypatch, groove, theta, **settings)
    disagree(of_errors(still.derivative(deeper, batches=BATCHES), exact))


class NoFootprint(MovingSurface):
    """Twin: the border of the lit part of the surface stays."""

    def _footprint(self, sampler):
        receiver, light, lit = super()._footprint(sampler)
        return receiver, 0 * light, 0 * lit


def test_border_of_the_footprint(monkeypatch):
    """Statistics, of a ramp beside a plane, which the light leaves dark at its end.

    The ramp falls from the height h at x = -1 to 0 at x = 0. Light from +x enters
    through the square at the height h: it gets to the plane up to x = 1 - h tan(theta).
    Twin: that border stays.
    """
    h, theta = 0.4, 50
    tan, wo = np.tan(np.radians(theta)), direction(*np.radians(DIRECTIONS).T)

    def brdf(h):
        n = np.array([h, 0.0, 1.0])
        ramp = (1 + h * tan) * (wo @ n) / (np.linalg.norm(n) * wo[:, 2])
        return (ramp + 1 - h * tan)[:, None] / (2 * np.pi)

    high = np.tile([1.0, 0.0, 0.0], (2, 1))
    ramp = heightfield(h * high, bsdf=both_sided(WHITE), periodic=False)
    settings = {"directions": DIRECTIONS, "points": 2**12}
    surface = gonio.DifferentiableSurface(ramp, theta, **settings)
    exact = slope_in(brdf, h)
    agree(of_errors(surface.derivative(high, batches=BATCHES), exact))
    fixed = twin_of(NoFootprint, monkeypatch, ramp, theta, **settings)
    disagree(of_errors(fixed.derivative(high, batches=BATCHES), exact))


def polyhedron():
    """Corners and triangles of an octahedron, squeezed and turned."""
    corners = np.array(
        [[0.1, 0, 0.6], [1, 0.1, 0], [0, 0.8, 0.1], [-0.9, 0, -0.1], [0.1, -1, 0]]
    )
    points = np.vstack([corners, [[0, 0.1, -0.5]]])
    sides = list(pairwise([1, 2, 3, 4, 1]))
    faces = [*([0, a, b] for a, b in sides), *([5, b, a] for a, b in sides)]
    return points, np.array(faces)


def polyhedron_brdf(points, faces, wi):
    """The same of a white Lambertian solid that is convex: of what faces both."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    area = np.cross(b - a, c - a) / 2
    lit = np.maximum(area @ wi, 0)
    n = area / np.linalg.norm(area, axis=1, keepdims=True)
    wo = direction(*np.radians(DIRECTIONS).T)
    found = lit @ np.maximum(n @ wo.T, 0) / (lit.sum() * np.pi * wo[:, 2])
    return found[:, None]


@pytest.mark.parametrize("period", ["none", (3.0, 2.5)])
def test_vertices_of_a_solid(period):
    """Statistics, against a closed form: alone, and one of many that are far apart.

    In a cell light that misses the solid counts as incident too; the light that gets
    there is in no shadow of others at 30 degrees. Twin: 1 % of the change is missing.
    """
    (points, faces), wi = polyhedron(), direction(np.radians(30), np.radians(20))
    change = np.random.default_rng(0).normal(size=points.shape)

    def brdf(x):
        moved = points + x * change
        found = polyhedron_brdf(moved, faces, wi)
        if period == "none":
            return found
        a, b, c = (moved[faces[:, k]] for k in range(3))
        lit = np.maximum(np.cross(b - a, c - a) @ wi / 2, 0).sum()
        return found * lit / (np.prod(period) * wi[2])

    # as files of triangles are: each has vertices of its own
    shape = mesh(points[faces], np.arange(faces.size), mi.load_dict(WHITE))
    specimen = {"type": "scene", "solid": shape}
    surface = gonio.DifferentiableSurface(
        specimen, 30, 20, directions=DIRECTIONS, period=period, points=2**14
    )
    found = surface.derivative(change[faces.ravel()], batches=BATCHES)
    exact = slope_in(brdf, 0.0)
    agree(of_errors(found, exact))
    disagree(of_errors(found, 1.01 * exact))


# ---------------------------------------------------------------- values, differences


def in_batches(surface, geometry=None, n=BATCHES):
    """BRDF of seeds 0 to n, one batch each."""
    return np.stack([surface.brdf(geometry, seed).numpy() for seed in range(n)])


@pytest.mark.parametrize("periodic", [True, False])
def test_the_value_is_that_of_measure(periodic):
    """Statistics: rays of one event find the same. Twin: 2 % off."""
    specimen, period = rough(0.5, periodic=periodic), "box" if periodic else "none"
    common = {"collector": "projected:3x4", "period": period}
    record = gonio.measure(specimen, 60, 20, order=1, rays=2**17, **common)
    surface = gonio.DifferentiableSurface(specimen, 60, 20, **common, points=2**16)
    assert surface.shape == record.brdf.shape
    found = in_batches(surface)
    std_err = np.hypot(
        found.std(axis=0, ddof=1) / np.sqrt(BATCHES), record.brdf_std_err
    )

    def scores(factor):
        t = (factor * found.mean(axis=0) - record.brdf) / std_err
        return verdict(normal_scores(t, BATCHES + record.n_batches - 2))

    agree(scores(1))
    disagree(scores(1.02))


def differences(surface, change, step=0.01):
    """Differences with common random numbers, of each seed."""
    ends = (surface.geometry.numpy() + sign * step * change for sign in (1, -1))
    above, below = (in_batches(surface, mi.TensorXf(end)) for end in ends)
    return (above.astype(float) - below) / (2 * step)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("periodic", "bsdf", "theta"),
    [(True, WHITE, 45), (True, GLOSSY, 70), (False, WHITE, 45)],
)
def test_all_heights_against_differences(periodic, bsdf, theta, monkeypatch):
    """Statistics. Twin: without edges."""
    specimen = rough(0.5, bsdf, periodic=periodic)
    common = {"period": "box" if periodic else "none", "points": 2**16}
    common["directions"] = [(20, 120), (40, 0), (60, 60), (60, 180)]
    surface = gonio.DifferentiableSurface(specimen, theta, 20, **common)
    change = surface.geometry.numpy()
    each = differences(surface, change)
    mean, spread = each.mean(axis=0), each.std(axis=0, ddof=1) / np.sqrt(BATCHES)

    def scores(surface):
        found = surface.derivative(change, batches=BATCHES)
        t = (found.value - mean) / np.hypot(found.std_err, spread)
        return verdict(normal_scores(t, BATCHES - 1))

    agree(scores(surface))
    disagree(scores(twin_of(NoEdges, monkeypatch, specimen, theta, 20, **common)))


def test_reverse_mode_is_forward_mode():
    """Rounding, of sums of 1e4 points: both draw the same ones."""
    specimen = rough(0.5)
    surface = gonio.DifferentiableSurface(
        specimen, 45, collector="projected:2x3", period="box", points=2**14
    )
    rng = np.random.default_rng(0)
    heights, change = surface.geometry, rng.normal(size=(32, 32)).astype(np.float32)
    adjoint = mi.TensorXf(rng.normal(size=surface.shape).astype(np.float32))
    dr.enable_grad(heights)
    dr.backward(dr.sum(surface.brdf(heights) * adjoint))
    reverse = np.sum(heights.grad.numpy().astype(float) * change)
    heights = mi.TensorXf(surface.geometry)
    dr.enable_grad(heights)
    dr.set_grad(heights, mi.TensorXf(change))
    found = dr.forward_to(dr.sum(surface.brdf(heights) * adjoint))
    assert reverse == pytest.approx(found.numpy().item(), rel=1e-4)
    assert not dr.grad_enabled(surface.brdf(dr.detach(heights)))
    # other kernels meet all meshes that there are
    meshes = surface._moving._meshes
    assert not any(dr.grad_enabled(mi.traverse(m)["vertex_positions"]) for m in meshes)


def test_optimisers_move_heights():
    """Exact: the loss becomes smaller, and the specimen is the one that moved."""
    surface = gonio.DifferentiableSurface(
        rough(0.15), 0, directions=[(0, 0)], period="box", points=2**12
    )
    optimiser = mi.ad.Adam(lr=1e-3, params={"heights": surface.geometry})
    before = surface.brdf(seed=99).numpy().item()
    for step in range(4):
        dr.backward(dr.sum(surface.brdf(optimiser["heights"], step)))
        optimiser.step()
    heights = dr.detach(optimiser["heights"])
    assert surface.brdf(heights, seed=99).numpy().item() < before
    shape = surface.specimen(heights)["surface"]
    z = np.array(mi.traverse(shape)["vertex_positions"]).reshape(33, 33, 3)[..., 2]
    assert np.array_equal(z[:-1, :-1], heights.numpy())
    assert np.array_equal(z[-1], z[0])


def test_what_two_events_add():
    """Statistics: how large the part is that is left out, at two slopes.

    Differences with common rays of the light of two and more events, in parts of the
    root mean square of those of all light: a tenth at the slope .15, a third at .5.
    """
    parts = []
    for slope in (0.15, 0.5):
        maps = []
        for factor in (1.05, 0.95):
            heights = heightfield(
                factor * field(slope), size=1.0, bsdf=both_sided(GLOSSY)
            )
            found = gonio.measure_orders(
                heights, 45, collector="projected:3x4", period="box", rays=2**17,
                orders=[1, "2+"],
            )  # fmt: skip
            maps.append([found["1"].brdf, found["2+"].brdf])
        first, more = np.subtract(*maps)
        parts.append(np.sqrt(np.mean(more**2) / np.mean((first + more) ** 2)))
    print("part of two and more events:", parts)
    assert parts[0] < 0.2 < parts[1]


def test_a_single_point_at_an_edge():
    """Exact, of the lanes of a loop: one of them is two of half the weight."""
    lanes = mi.UInt32(5, 6, 7), mi.Float(1.0, 2.0, 3.0)
    number, weight = _where(mi.Bool(False, True, False), lanes)
    assert np.array_equal(number, [6, 6])
    assert np.array_equal(weight, [1, 1])
    number, weight = _where(mi.Bool(True, True, False), lanes)
    assert np.array_equal(weight, [1, 2])


# ------------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"specimen": lambda: GLOSSY}, "must be one mesh, got 1 shape: Rectangle"),
        (
            {"specimen": lambda: rough(0.15, {"type": "conductor"})},
            "must not have a component without a density",
        ),
        (
            {"specimen": lambda: heightfield(field(0.15), bsdf=ROUGH_GLASS)},
            "must not have a component that lets light pass",
        ),
        (
            {"specimen": lambda: rough(0.15, face_normals=False)},
            "must have flat facets, got interpolated normals",
        ),
        ({"period": 0.7}, "must not have geometry wider than its period"),
        ({"collector": None}, "either collector or directions must be given"),
        ({"directions": [(95, 0)], "collector": None}, r"polar angle in \[0, 90\)"),
        ({"directions": "up", "collector": None}, "pairs of a polar angle"),
        ({"theta_i": [10, 20]}, "must be one angle each"),
        ({"theta_i": None}, "must be one angle each"),
        ({"points": 10}, "points must be at least 256"),
        ({"collector": "apertures:5@10/0"}, "parts of rings about the normal"),
        ({"theta_i": 95}, "theta_i must be an angle"),
    ],
)
def test_refusals(change, message):
    given = {"specimen": lambda: rough(0.15), "theta_i": 30, "period": "box"}
    given |= {"collector": "projected:2x2"} | change
    given["specimen"] = given["specimen"]()
    with pytest.raises((SpecimenError, SettingError), match=message):
        gonio.DifferentiableSurface(**given)


def test_refused_variants():
    """Without derivatives, or with wavelengths."""
    mi.set_variant("llvm_ad_spectral")
    try:
        with pytest.raises(VariantError, match="not spectral"):
            gonio.DifferentiableSurface(rough(0.15), 0, directions=[(0, 0)])
    finally:
        mi.set_variant("llvm_ad_mono")


def test_refused_geometry():
    surface = gonio.DifferentiableSurface(
        rough(0.15), 0, directions=[(0, 0)], period="box"
    )
    with pytest.raises(SettingError, match=r"shape \(32, 32\), got \(33, 33\)"):
        surface.brdf(mi.TensorXf(np.zeros((33, 33), np.float32)))
    with pytest.raises(SettingTypeError, match="change must be a tensor or an array"):
        surface.derivative("up")


def test_colour():
    """Rounding: each channel is that of its own reflectance."""
    mi.set_variant("llvm_ad_rgb")
    try:
        red = {"type": "rgb", "value": [0.8, 0.4, 0.2]}
        specimen = rough(0.5, {"type": "diffuse", "reflectance": red})
        surface = gonio.DifferentiableSurface(
            specimen, 45, collector="projected:2x3", period="box", points=2**12
        )
        found = surface.derivative(surface.geometry, batches=2).value
        assert surface.shape == found.shape == (2, 3, 3)
        parts = np.array([0.8, 0.4, 0.2])
        assert found == pytest.approx(found[..., :1] / 0.8 * parts, rel=1e-4)
    finally:
        mi.set_variant("llvm_ad_mono")


# ---------------------------------------------------------------------------- edges


def test_edges_of_a_cell():
    """Exact: of n x n squares 3 n^2 edges, each with two triangles, across its sides.

    Without a period the border has triangles on one side.
    """
    n = 3
    x, y = np.meshgrid(np.arange(n + 1.0), np.arange(n + 1.0))
    points = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3)
    index = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    faces = np.stack([a, b, d, a, d, c], axis=-1).reshape(-1, 3)
    period = np.array([n, n])
    edges = mesh_edges(points, faces, welded(points, period))
    assert len(edges.start) == 3 * n**2
    third = points[edges.far] + edges.shift
    middle = (points[edges.start] + points[edges.end]) / 2
    # parallelograms: both third corners are opposite each other
    assert np.allclose(points[edges.near] + third, 2 * middle)
    alone = mesh_edges(points, faces, welded(points, None))
    assert len(alone.start) == 3 * n**2 + 2 * n
    assert np.sum(alone.near == alone.far) == 4 * n
    assert not alone.shift.any()
    with pytest.raises(SpecimenError, match="at most two triangles at each edge"):
        mesh_edges(points, np.vstack([faces, faces[:1]]), welded(points, None))

"""Micro-normals of a surface, its masking and shadowing: measured, and in a figure."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Floats, Integers
from ..collector.directions import direction
from ..errors import SpecimenError, checked_count, checked_number
from ..kernels import launches_kernels
from ..mitsuba_compat import SURFACE, triangles_of
from ..plots.figure import finished, new_figure
from ..single_precision import FEW_ROUNDINGS
from ..specimen.loading import specimen_of
from ..specimen.rays import departure, escapes, intersect
from ..specimen.specimen import Specimen
from ..specimen.specimen_text import SpecimenLike
from .smith import (
    DISTRIBUTIONS,
    MIN_ALPHA,
    fitted_alphas,
    masking,
    ring_means,
    ring_shares,
    smith_lambda,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# How far above its surface a point is looked for, relative to its coordinates.
APPROACH = 2.0**-16


@dataclass(frozen=True, eq=False)
class Facets:
    """Random points of the surfaces, each of the area that it stands for.

    Attributes
    ----------
    si : mi.SurfaceInteraction3f
        The points, as rays find them.
    n : ndarray, shape (n, 3)
        Their normals.
    area : ndarray, shape (n,)
    block : ndarray of int, shape (n,)
        Of the surface, row by row, in which a point is.
    """

    si: mi.SurfaceInteraction3f
    n: Floats
    area: Floats
    block: Integers


def found_facets(specimen: Specimen, points: int, blocks: int, seed: int) -> Facets:
    """Points of all surfaces, in proportion to their areas, ``blocks**2`` blocks.

    Raises
    ------
    SpecimenError
        If there are instances, or rays do not find one point of a hundred.
    """
    if specimen.groups:
        raise SpecimenError("micro_normals needs a specimen without instances")
    generator = np.random.default_rng(seed)
    areas = np.array([float(dr.sum(s.surface_area())[0]) for s in specimen.surfaces])
    numbers = np.maximum(1, np.round(points * areas / areas.sum()).astype(int))
    each = zip(specimen.surfaces, numbers.tolist())
    parts = [_points(shape, n, generator) for shape, n in each]
    p, normal = (np.concatenate(columns) for columns in zip(*parts))
    # as rays find what they fall on from just above: only so are they known to the bit
    # by what tells a surface from itself
    above = np.abs(p).max(axis=1, keepdims=True) + specimen.detail
    origin = mi.Point3f((p + normal * above * APPROACH).astype(np.float32).T)
    ray = mi.Ray3f(origin, -mi.Vector3f(normal.T))
    si = intersect(specimen.scene, ray, SURFACE, mi.Bool(True))
    dr.eval(si)
    there = si.is_valid().numpy()
    if np.count_nonzero(there) < 0.99 * len(there):
        raise SpecimenError(
            "micro_normals needs a surface that rays meet at all of its points, but "
            f"they missed {np.count_nonzero(~there)} of {len(there)}"
        )
    area = np.repeat(areas / numbers, numbers) * there
    low, extent = specimen.low[:2], (specimen.high - specimen.low)[:2]
    place = (p[:, :2] - low) / extent
    if len(specimen.shifts) > 1:
        place %= 1
    cell = np.clip(place * blocks, 0, blocks - 1).astype(int)
    n = np.array(si.n, dtype=float).T
    return Facets(si, n, area, cell[:, 0] * blocks + cell[:, 1])


def _points(
    shape: mi.Shape, n: int, generator: np.random.Generator
) -> tuple[Floats, Floats]:
    """Uniform points of a shape and their normals; of a mesh in double precision.

    What Mitsuba draws of a mesh of many triangles lies beside them: one number in
    single precision chooses the triangle and the place in it.
    """
    # a rectangle is a mesh, and shows no triangles
    triangles = triangles_of(mi.traverse(shape)) if shape.is_mesh() else None
    if triangles is None:
        found = shape.sample_position(0.0, mi.Point2f(generator.random((2, n))))
        # of a flat one there is one normal for all
        both = (np.array(v, dtype=float).T for v in (found.p, found.n))
        p, normal = (np.broadcast_to(v, (n, 3)) for v in both)
        return p, normal
    vertices, faces = triangles
    a, b, c = (vertices[faces[:, i]].astype(float) for i in range(3))
    normal = np.cross(b - a, c - a)
    size = np.cumsum(np.linalg.norm(normal, axis=1))
    chosen = np.searchsorted(size, generator.random(n) * size[-1], side="right")
    chosen = np.minimum(chosen, len(faces) - 1)
    u, v = generator.random((2, n))
    root = np.sqrt(u)
    shares = np.stack([1 - root, root * (1 - v), root * v])[..., None]
    a, b, c, normal = (one[chosen] for one in (a, b, c, normal))
    unit = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    return shares[0] * a + shares[1] * b + shares[2] * c, unit


# Rings of the hemisphere in which micro-normals are counted, to 90 degrees; those that
# are drawn at least.
N_RINGS, MIN_DRAWN_RINGS = 45, 5
THETA = (15.0, 30.0, 45.0, 60.0, 70.0, 80.0)
PHI = (0.0, 90.0)

# Of the models in pictures, and their common colour where it is of no azimuth.
GREY = "0.4"
LINE_STYLES = {"beckmann": "-", "ggx": "--"}


@dataclass(frozen=True, eq=False)
class MicroNormals:
    """Micro-normals, masking and shadowing of a surface, beside two models of them.

    Standard errors are those of a mean over blocks of the surface: how well it stands
    for a larger one like it.

    Attributes
    ----------
    theta_edges : ndarray, shape (n + 1,)
        Rings of micro-normals, in degrees from +z.
    density, density_std_err : ndarray, shape (n,)
        Area of facets over area of the mean plane and solid angle, in 1/sr.
    alphas, alpha_std_errs : dict of ndarray, shape (2,)
        For ``"beckmann"`` and ``"ggx"``: alpha along x and y of largest likelihood.
    elsewhere : dict of float
        Part of the projected area of the facets that the model has in other rings.
    theta, phi : ndarray, shape (m,)
        Directions in degrees to which masking and shadowing belong.
    masking, masking_std_err : ndarray, shape (m,)
        Visible part of the facets that look there, each by its projected area.
    shadowing, shadowing_std_err : ndarray, shape (m,)
        Part that is visible from there and from the mirror direction at once, of the
        facets that look at both, each by the product of both cosines.
    """

    theta_edges: Floats
    density: Floats
    density_std_err: Floats
    alphas: dict[str, Floats]
    alpha_std_errs: dict[str, Floats]
    elsewhere: dict[str, float]
    theta: Floats
    phi: Floats
    masking: Floats
    masking_std_err: Floats
    shadowing: Floats
    shadowing_std_err: Floats

    def model_density(self, distribution: str) -> Floats:
        """Density that the fitted model has in the rings."""
        return ring_means(distribution, self.theta_edges, *self.alphas[distribution])

    def model_masking(self, distribution: str) -> Floats:
        """Smith's masking of the fitted model."""
        angles = np.radians(self.theta), np.radians(self.phi)
        return masking(distribution, *angles, *self.alphas[distribution])

    def model_shadowing(self, distribution: str) -> Floats:
        """Smith's masking and shadowing, correlated by height, in mirror directions."""
        angles = np.radians(self.theta), np.radians(self.phi)
        one_side = smith_lambda(distribution, *angles, *self.alphas[distribution])
        return 1 / (1 + 2 * one_side)

    def plot(self, path: str | PathLike[str] | None = None) -> Figure:
        """Figure of densities and masking, written if `path` is given.

        Left, the density over the polar angle, mean over azimuth; right, the visible
        fraction of the facets over the direction that looks at them: colours are
        azimuths. Bars are standard errors, lines the models of largest likelihood.
        """
        figure = new_figure(path, figsize=(11, 4.4))
        left, right = figure.subplots(1, 2)
        edges = self.theta_edges
        middles = (edges[:-1] + edges[1:]) / 2
        bars = middles, self.density, self.density_std_err
        left.errorbar(*bars, fmt="ok", ms=3, label="facets +- std_err")
        for name, style in LINE_STYLES.items():
            u, v = self.alphas[name]
            label = f"{name}, alpha {u:.3g} x {v:.3g}"
            curve = self.model_density(name)
            left.plot(middles, curve, style, c=GREY, label=label)
        (held,) = np.nonzero(self.density)
        positive = self.density[held]
        left.set(
            xlabel="polar angle of the facet's normal (degrees)", ylabel="D (1/sr)"
        )
        if positive.size:
            # to one ring beyond the last one with facets
            last = min(max(held[-1] + 2, MIN_DRAWN_RINGS), len(edges) - 1)
            left.set_xlim(0, edges[last])
            left.set_yscale("log")
            left.set_ylim(positive.min() / 3, positive.max() * 3)
        left.legend(frameon=False)
        for number, phi in enumerate(np.unique(self.phi)):
            own = self.phi == phi
            colour, label = f"C{number}", f"φ = {phi:g}°, facets +- std_err"
            bars = self.theta[own], self.masking[own], self.masking_std_err[own]
            right.errorbar(*bars, fmt="o", c=colour, label=label)
            for name, style in LINE_STYLES.items():
                curve = self.model_masking(name)[own]
                right.plot(self.theta[own], curve, style, c=colour, lw=1)
        for name, style in LINE_STYLES.items():
            right.plot([], [], style, c=GREY, lw=1, label=f"{name}, Smith")
        right.set(xlabel="θ (degrees)", ylabel="visible part G1")
        right.set_ylim(0, 1.05)
        right.legend(frameon=False)
        return finished(figure, path)

    def __repr__(self) -> str:
        alphas = [
            f"{name} alpha {u:.3g} x {v:.3g}" for name, (u, v) in self.alphas.items()
        ]
        return f"<MicroNormals: {', '.join(alphas)}>"

    def __str__(self) -> str:
        lines = ["facets          alpha_x +- std_err    alpha_y +- std_err   elsewhere"]
        for name in DISTRIBUTIONS:
            u, v = (
                f"{_pair(alpha, error) if alpha > MIN_ALPHA else 'flat':<21}"
                for alpha, error in zip(self.alphas[name], self.alpha_std_errs[name])
            )
            lines.append(f"as {name:<11}  {u} {v}{100 * self.elsewhere[name]:.2f} %")
        header = "G1 +- std_err       Beckmann  GGX       "
        lines += ["", f"theta  phi    {header}{header.replace('G1', 'G2')}".rstrip()]
        of_models = [self.model_masking(name) for name in DISTRIBUTIONS]
        of_models += [self.model_shadowing(name) for name in DISTRIBUTIONS]
        for i, (theta, phi) in enumerate(zip(self.theta, self.phi)):
            beckmann, ggx, beckmann_2, ggx_2 = (f"{one[i]:<8.4f}" for one in of_models)
            one = _pair(self.masking[i], self.masking_std_err[i])
            both = _pair(self.shadowing[i], self.shadowing_std_err[i])
            lines.append(
                f"{theta:<5.4g}  {phi:<5.4g}  {one:<17}  {beckmann}  {ggx}  "
                f"{both:<17}  {beckmann_2}  {ggx_2}".rstrip()
            )
        lines.append(
            "G1: visible part of the facets that look there; G2: also from the mirror "
            "direction"
        )
        if np.isnan([self.masking, self.shadowing]).any():
            lines.append("-: there is no such facet")
        return "\n".join(lines)


def _pair(value: float, error: float) -> str:
    if np.isnan(value):
        return "-"
    return f"{value:.4g} +- {error:.2g}"


@launches_kernels()
def micro_normals(
    specimen: SpecimenLike,
    *,
    parameters: dict[str, Any] | None = None,
    period: Any = "box",
    points: int = 2**18,
    blocks: int = 4,
    theta: Sequence[float] = THETA,
    phi: Sequence[float] = PHI,
    seed: int = 0,
) -> MicroNormals:
    """Measure the micro-normals of a surface, and how it hides itself.

    Random points all over its shapes have normals; straight rays from them tell whether
    a direction sees them. No light is scattered, and what the surface is made of does
    not matter.

    Parameters
    ----------
    specimen : dict, mi.Shape, mi.Scene, str or path
        As :func:`measure` takes it, but no BSDF; without instances.
    parameters : dict, optional
        Values for the ``$name`` parameters of an XML file.
    period : {"box", "none"} or (float, float)
        As of :func:`measure`. What leaves through a side of a surface that is not
        repeated meets nothing more, so that facets near its edges are seen too well.
    points : int
        Random points of the surface.
    blocks : int
        Rows and columns of blocks over which errors are estimated. Each must be large
        against the surface's structure; of a single groove, the errors mean nothing.
    theta, phi : sequence of float
        Directions of masking and shadowing, in degrees: all pairs.
    seed : int

    Returns
    -------
    MicroNormals

    Raises
    ------
    SpecimenError
        If the specimen has no points to be found, as instances do not, or stands
        upright.
    """
    points = checked_count("points", points, 1000, 2**26)
    blocks = checked_count("blocks", blocks, 2, 64)
    seed = checked_count("seed", seed, 0)
    limits = (0.0, 90.0, "an angle in degrees in [0, 90)")
    thetas = [checked_number("theta", one, *limits) for one in theta]
    limits = (-1e6, 1e6, "an angle in degrees")
    phis = [checked_number("phi", one, *limits) for one in phi]
    angles = list(itertools.product(thetas, phis))
    measured = specimen_of(specimen, parameters, period)
    extent = (measured.high - measured.low)[:2]
    if not extent.min() > FEW_ROUNDINGS * np.max(measured.high - measured.low):
        raise SpecimenError(
            "micro_normals needs a specimen that is extended along x and y, got one of "
            f"{extent[0]:g} x {extent[1]:g}"
        )
    facets = found_facets(measured, points, blocks, seed)
    plane = float(extent[0] * extent[1]) / blocks**2
    edges = np.linspace(0, 90, N_RINGS + 1)
    found, error = _density(facets, edges, plane, blocks**2)
    upper = facets.n[:, 2] > 0
    slope_u, slope_v = -facets.n[upper, :2].T / facets.n[upper, 2]
    projected = (facets.area * facets.n[:, 2])[upper]
    of_facets = slope_u, slope_v, projected, facets.block[upper]
    alphas, alpha_errors, elsewhere = {}, {}, {}
    ring = np.diff(np.sin(np.radians(edges)) ** 2) * np.pi
    for name in DISTRIBUTIONS:
        alphas[name], alpha_errors[name] = _jackknife(name, *of_facets, blocks**2)
        off = found * ring - ring_shares(name, edges, *alphas[name])
        elsewhere[name] = float(np.abs(off).sum() / 2)
    seen = [_visible(measured, facets, *angle, blocks**2) for angle in angles]
    columns = np.array(seen).reshape(len(angles), 4).T
    towards = np.array(angles, dtype=float).reshape(-1, 2).T
    distributions = alphas, alpha_errors, elsewhere
    return MicroNormals(edges, found, error, *distributions, *towards, *columns)


def _density(
    facets: Facets, edges: Floats, plane: float, n_blocks: int
) -> tuple[Floats, Floats]:
    """Density of micro-normals in rings, and its standard error over the blocks."""
    cosine = np.clip(facets.n[:, 2], -1, 1)
    ring = np.searchsorted(edges, np.degrees(np.arccos(cosine)), side="right") - 1
    upper = ring < len(edges) - 1
    index = facets.block[upper] * (len(edges) - 1) + ring[upper]
    size = n_blocks * (len(edges) - 1)
    area = np.bincount(index, facets.area[upper], minlength=size)
    solid = -2 * np.pi * np.diff(np.cos(np.radians(edges)))
    each = area.reshape(n_blocks, -1) / solid / plane
    return each.mean(axis=0), each.std(axis=0, ddof=1) / np.sqrt(n_blocks)


def _jackknife(
    name: str, u: Floats, v: Floats, weight: Floats, block: Integers, n_blocks: int
) -> tuple[Floats, Floats]:
    """Alphas, and their standard errors from leaving out one block after another."""
    whole = fitted_alphas(name, u, v, weight)
    each = []
    for left_out in range(n_blocks):
        kept = block != left_out
        each.append(fitted_alphas(name, u[kept], v[kept], weight[kept]))
    scatter = np.var(each, axis=0) * (n_blocks - 1)
    return whole, np.sqrt(scatter)


def _visible(
    specimen: Specimen, facets: Facets, theta: float, phi: float, n_blocks: int
) -> tuple[float, float, float, float]:
    """Masking and its error, shadowing with the mirror direction and its error."""
    towards = direction(np.radians(theta), np.radians(phi))
    mirror = towards * [-1, -1, 1]
    one, other = (np.maximum(facets.n @ d, 0) * facets.area for d in (towards, mirror))
    free = _escape(specimen, facets, towards)
    both = free & _escape(specimen, facets, mirror)
    product = one * other
    return (
        *_ratio(one * free, one, facets.block, n_blocks),
        *_ratio(product * both, product, facets.block, n_blocks),
    )


def _escape(specimen: Specimen, facets: Facets, towards: Floats) -> Any:
    """Whether each point sees a direction."""
    si, d = facets.si, mi.Vector3f(towards.tolist())
    active = dr.dot(si.n, d) > 0
    origin, offset = departure(specimen, si, -si.n, d)
    ray = mi.Ray3f(origin + offset * si.n, d)
    return escapes(specimen, 1, ray, si.n, offset, active).numpy()


def _ratio(
    above: Floats, below: Floats, block: Integers, n_blocks: int
) -> tuple[float, float]:
    """Ratio of two sums, and its standard error over the blocks."""
    a, b = (np.bincount(block, x, minlength=n_blocks) for x in (above, below))
    if not b.sum() > 0:
        return np.nan, np.nan
    ratio = a.sum() / b.sum()
    left = (a - ratio * b) / b.mean()
    return float(ratio), float(left.std(ddof=1) / np.sqrt(n_blocks))

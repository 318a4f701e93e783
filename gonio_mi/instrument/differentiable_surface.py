"""The BRDF of a mesh as a differentiable function of its heights: light of one event.

Points keep their place in their triangles, so that they move with the vertices. What
hides them moves too, without them: silhouette edges, as seen from the source and from
the detector, carry that part of the derivative.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike

from ..array_types import Floats, Singles
from ..collector import Subdivision, subdivision
from ..collector.directions import direction
from ..errors import (
    SettingError,
    SpecimenError,
    VariantError,
    checked_count,
    number_of,
    shown,
)
from ..estimators.surface_points import sees
from ..kernels import in_memory, launches_kernels
from ..mitsuba_compat import SURFACE, floats, has_normals, mesh_of, triangles_of
from ..results.statistics import student_interval
from ..settings.values import checked_period
from ..specimen.loading import load_specimen
from ..specimen.rays import NEARBY, escapes, first_met, with_normal
from ..specimen.scene_objects import traversed
from ..specimen.specimen import Specimen
from ..specimen.specimen_text import SpecimenLike
from ..surfaces.mesh_edges import mesh_edges, welded
from ..transport.sampling import seeded
from ..transport.surface_events import flux_context
from .incidence import incident_angles, towards

# Points at silhouettes, in parts of the points of the surface.
EDGE_POINTS = 1 / 8

# Points of a map at least: of fewer, none may be lit.
MIN_POINTS = 2**8

# Triangles whose shares of the surface single precision tells apart.
MAX_TRIANGLES = 2**20

# Part of the mean share of triangles, and of edges, that each of them gets at least.
MIN_SHARE = 1 / 64

# What follows the seed: values and derivatives are multiplied with each other.
VALUE, DERIVATIVE, BATCHES = range(3)

# Flags of BSDFs that are not differentiated, with the reason.
REFUSED = {
    mi.BSDFFlags.Delta: "a component without a density, whose direction would move",
    mi.BSDFFlags.Delta1D: "a component without a density, whose direction would move",
    mi.BSDFFlags.Null: "a component that lets light pass",
    mi.BSDFFlags.Transmission: "a component that lets light pass",
}


@dataclass(frozen=True)
class BRDFDerivative:
    """Derivative of a first-order BRDF for a change of the heights.

    Attributes
    ----------
    value : ndarray
        Of the shape of the BRDF, in 1/sr for the whole change.
    std_err : ndarray
        Standard errors, from independent batches; NaN where none found any light.
    n_batches : int
    order : str
        ``"1"``: light of two or more surface events is left out.
    """

    value: Floats
    std_err: Floats
    n_batches: int
    order: str = "1"

    def interval(self, level: float = 0.95) -> tuple[Floats, Floats]:
        """Limits between which each value lies, by Student's t."""
        return student_interval(self.value, self.std_err, self.n_batches, level)


class DifferentiableSurface:
    r"""A surface whose first-order BRDF is a differentiable function of its heights.

    Light of one surface event, with shadowing and masking: what
    ``measure(order=1).brdf`` estimates. Mitsuba's optimisers take :attr:`geometry` as a
    parameter. Light of more events is left out of value and derivative: measure the
    result with all orders.

    Parameters
    ----------
    specimen : dict, mi.Scene, str or path
        As of :func:`~gonio_mi.measure`: one mesh with flat facets, such as the plugin
        `heightfield`. Its BSDF reflects, without delta components.
    theta_i, phi_i : float
        Incident direction in degrees.
    collector : str or Subdivision, optional
        Patches whose mean BRDF is wanted, in rings and sectors.
    directions : sequence of (float, float), optional
        Instead: polar angles and azimuths in degrees, at which the BRDF is wanted.
    period : {"none", "box"} or (float, float)
        As of :func:`~gonio_mi.measure`, and at least as large as the mesh.
    points : int
        Points of the surface for each map, each of which is joined to one patch.

    Attributes
    ----------
    shape : tuple of int
        Of a BRDF: of the collector's map, or the number of directions; and channels.

    Raises
    ------
    SpecimenError
        If the specimen is no such mesh.
    VariantError
        In a variant without automatic differentiation, or a spectral one.
    """

    @launches_kernels()
    def __init__(
        self,
        specimen: SpecimenLike,
        theta_i: float,
        phi_i: float = 0.0,
        *,
        collector: str | Subdivision | None = None,
        directions: Sequence[tuple[float, float]] | None = None,
        period: Any = "none",
        points: int = 2**17,
    ) -> None:
        if "_ad_" not in mi.variant() or mi.is_spectral:
            raise VariantError(
                "a differentiable surface needs a variant with automatic "
                "differentiation that is not spectral, such as llvm_ad_mono, "
                f"got {mi.variant()}"
            )
        self.points = checked_count("points", points, MIN_POINTS)
        (incident,), _ = incident_angles(float(theta_i), float(phi_i))
        self._wi = mi.Vector3f(in_memory(towards(incident, "front")))
        self._set_receivers(collector, directions)
        scene = load_specimen(specimen, None, period)
        first = Specimen(scene, checked_period("period", period))
        mesh = _checked_mesh(first)
        self._is_bounded = first.edges == "open"
        self._set_mesh(mesh, first)
        self._sampler = mi.load_dict({"type": "sobol"})

    def _set_receivers(self, collector: Any, directions: Any) -> None:
        """Cells of the receivers: lower edges, spans, and 1 over the mean cosine."""
        if (collector is None) == (directions is None):
            raise SettingError(
                "either collector or directions must be given, got "
                f"{shown(collector)} and {shown(directions)}"
            )
        if collector is None:
            theta, phi = np.radians(np.reshape(directions, (-1, 2)).astype(float)).T
            if not len(theta) or np.any((theta < 0) | (theta >= np.pi / 2)):
                raise SettingError(
                    "directions must be pairs of a polar angle in [0, 90) and an "
                    f"azimuth in degrees, got {shown(directions)}"
                )
            cells = np.array([theta, theta, phi, phi]).T
            shape: Any = (len(theta),)
            ratio = 1 / direction(theta, phi)[:, 2]
        else:
            patches = subdivision(collector)
            if patches.axes is not None:
                raise SettingError(
                    "collector must have patches that are parts of rings about the "
                    f"normal, got {patches!s:.40}"
                )
            cells, shape = patches.cells, patches.shape
            ratio = (patches.solid_angles / patches.projected_solid_angles).ravel()
        self.shape = (*shape, len(mi.UnpolarizedSpectrum()))
        low, high = np.sin(cells[:, :2].T / 2) ** 2
        columns = (low, high - low, cells[:, 2], cells[:, 3] - cells[:, 2], ratio)
        # two at least: what is gathered from a single one is another kernel
        self._table = [mi.Float([*column, column[-1]]) for column in columns]
        self._n_receivers = dr.opaque(mi.UInt32, len(cells))

    def _set_mesh(self, mesh: mi.Mesh, specimen: Specimen) -> None:
        """Copies of the mesh, to be traced and to be moved; its geometry and edges."""
        parameters: Any = traversed(mesh)
        found: Any = triangles_of(parameters)
        points, faces = (np.array(one) for one in found)
        points = points.astype(np.float32)
        cell = (specimen.high - specimen.low)[:2]
        self._period: Any = "none"
        if specimen.periodic:
            self._period = tuple(cell.tolist())
        same = welded(points.astype(float), cell if specimen.periodic else None)
        uv = parameters.get("vertex_texcoords", parameters.get("texcoords", ()))
        uv = np.array(uv, np.float32).reshape(-1, 2)
        others = {"texcoords": uv} if len(uv) else {}
        faces = faces.astype(np.uint32)
        self._bsdf, self._mesh = mesh.bsdf(), (points, faces, others)
        self._meshes = self._copy(), self._copy()
        self._faces = mi.Vector3u(faces.T)
        edges = mesh_edges(points.astype(float), faces, same)
        ends = edges.start, edges.end, edges.near, edges.far
        self._edges = [mi.UInt32(end.astype(np.uint32)) for end in ends]
        self._shift = mi.Vector3f(edges.shift.T.astype(np.float32))
        self._fixed = mi.Point3f(points.T)
        if grid := _grid(points, same):
            base, take = grid
        else:
            base, take = points, same
            self._fixed -= mi.Point3f(points[same].T)
        self._start = mi.TensorXf(base)
        self._take = mi.UInt32(take.astype(np.uint32))
        self._is_grid = grid is not None
        dr.make_opaque(self._faces, self._edges, self._shift, self._take, self._fixed)
        # of the geometry as it was given: what is drawn is the same for another one
        one, other, third = (points[corner].astype(float) for corner in faces.T)
        areas = np.linalg.norm(np.cross(other - one, third - one), axis=1)
        lengths = np.linalg.norm(points[edges.end] - points[edges.start], axis=1)
        self._by_area, self._by_length = _shares(areas), _shares(lengths)

    @property
    def geometry(self) -> mi.TensorXf:
        """Heights or vertices, as they were given: the parameter to differentiate for.

        Of vertices in rows and columns the heights, of shape ``(n_y, n_x)``, each once
        in a period; of other meshes all vertices, ``(n, 3)``. Of several vertices at
        one place the first moves them all.
        """
        return mi.TensorXf(self._start)

    def _copy(self) -> mi.Mesh:
        """A mesh like that of the specimen."""
        props = mi.Properties("ply")
        props["bsdf"], props["face_normals"] = self._bsdf, True
        points, faces, others = self._mesh
        return mesh_of(props, "a differentiable surface", points, faces, **others)

    @launches_kernels()
    def specimen(self, geometry: mi.TensorXf | None = None) -> dict[str, Any]:
        """Scene with the mesh of a geometry, to be measured: as of :meth:`brdf`."""
        mesh, geometry = self._copy(), self._checked(geometry)
        _put(mesh, dr.detach(self._vertices_of(geometry)))
        return {"type": "scene", "surface": mesh}

    @launches_kernels()
    def brdf(self, geometry: mi.TensorXf | None = None, seed: int = 0) -> mi.TensorXf:
        """BRDF in 1/sr of light of one event, of shape :attr:`shape`, differentiable.

        Value and derivative draw different random numbers: neither is biased where both
        are multiplied, as in the gradient of a squared difference.

        Parameters
        ----------
        geometry : mi.TensorXf, optional
            Heights or vertices, of the shape of :attr:`geometry`, its default. Lengths
            are those of the scene.
        seed : int
            Other points for each seed.
        """
        geometry = self.geometry if geometry is None else mi.TensorXf(geometry)
        if geometry.shape != self.geometry.shape:
            raise SettingError(
                f"geometry must be of shape {self.geometry.shape}, got {geometry.shape}"
            )
        seed = checked_count("seed", seed, 0)
        return dr.custom(_BRDF, self, geometry, seed)

    def derivative(
        self,
        change: ArrayLike,
        geometry: mi.TensorXf | None = None,
        seed: int = 0,
        batches: int = 16,
    ) -> BRDFDerivative:
        """Derivative of the BRDF for a change of the geometry, with error bars.

        Parameters
        ----------
        change : array_like
            Of each height or vertex, of the shape of :attr:`geometry`.
        geometry, seed : optional
            As of :meth:`brdf`.
        batches : int
            Each has the points of one map.
        """
        geometry, change = self._checked(geometry), self._checked(change, "change")
        seed = checked_count("seed", seed, 0)
        n = checked_count("batches", batches, 2)
        keys = [(seed, BATCHES, batch) for batch in range(n)]
        each = np.stack([self._forward(geometry, change, key) for key in keys])
        std_err = each.std(axis=0, ddof=1) / np.sqrt(n)
        std_err[~each.any(axis=0)] = np.nan
        return BRDFDerivative(each.mean(axis=0), std_err, n)

    def _checked(self, given: Any, name: str = "geometry") -> mi.TensorXf:
        """The tensor, of the shape of the geometry, which is that of None."""
        shape = self._start.shape
        given = mi.TensorXf(self._start if given is None else given)
        if given.shape != shape:
            raise SettingError(f"{name} must be of shape {shape}, got {given.shape}")
        return given

    @launches_kernels()
    def _value(self, geometry: mi.TensorXf, key: tuple[int, ...]) -> mi.Float:
        """BRDF without derivatives."""
        self._pose(geometry)
        found = self._map(key, False)
        dr.eval(found)
        return found

    @launches_kernels()
    def _forward(
        self, geometry: mi.TensorXf, change: mi.TensorXf, key: tuple[int, ...]
    ) -> Floats:
        """Derivative for a change of all heights or vertices."""
        moved = mi.TensorXf(dr.detach(geometry))
        dr.enable_grad(moved)
        dr.set_grad(moved, change)
        self._pose(moved)
        found = dr.forward_to(self._map(key, True))
        dr.eval(found)
        return found.numpy().astype(float).reshape(self.shape)

    @launches_kernels()
    def _backward(
        self, geometry: mi.TensorXf, adjoint: mi.TensorXf, key: tuple[int, ...]
    ) -> mi.TensorXf:
        """Derivative of the sum of the BRDF times `adjoint` for each height."""
        moved = mi.TensorXf(dr.detach(geometry))
        dr.enable_grad(moved)
        self._pose(moved)
        dr.backward(dr.sum(self._map(key, True) * adjoint.array))
        return dr.grad(moved)

    def _vertices_of(self, geometry: mi.TensorXf) -> mi.Point3f:
        """All vertices of the mesh, which move with the geometry."""
        at = mi.Point3f(self._fixed)
        if self._is_grid:
            at.z = dr.gather(mi.Float, geometry.array, self._take)
        else:
            at += dr.gather(mi.Point3f, geometry.array, self._take)
        return at

    def _pose(self, geometry: mi.TensorXf) -> None:
        """Put the vertices where they belong: once to be traced, once to be moved."""
        traced, moved = self._meshes
        self._vertices = self._vertices_of(geometry)
        _put(traced, dr.detach(self._vertices))
        _put(moved, self._vertices)
        scene = mi.load_dict({"type": "scene", "mesh": traced})
        self._specimen = Specimen(scene, self._period)

    def _map(self, key: tuple[int, ...], moves: bool) -> mi.Float:
        """BRDF of the points of a seed; with derivatives if the surface `moves`."""
        n_channels = self.shape[-1]
        flux = dr.zeros(mi.Float, int(np.prod(self.shape)))
        box, bounded = self._specimen.box, not self._specimen.periodic
        incident = box.period[0] * box.period[1] * self._wi.z
        incident = mi.Float(0) if bounded else incident
        for receiver, light, lit in self._lights(key, moves):
            for channel, power in enumerate(light):
                dr.scatter_add(flux, power, receiver * n_channels + channel)
            if bounded and lit is not None:
                incident += dr.sum(lit)
        return flux / incident

    def _lights(self, key: tuple[int, ...], moves: bool) -> Iterator[Any]:
        """Receivers, light that points send there, and light that they get, or None."""
        yield self._of_points(self._seeded(key, 0, self.points), moves)
        if not moves:
            return
        n = int(EDGE_POINTS * self.points)
        at_source = self._silhouettes(self._wi)
        if dr.width(at_source):
            yield self._shadows(self._seeded(key, 1, n), n, at_source)
        if self._is_bounded:
            yield self._footprint(self._seeded(key, 2, n), n)
        yield from self._masks(self._seeded(key, 3, self.points))

    def _seeded(self, key: tuple[int, ...], part: int, n: int) -> mi.Sampler:
        return seeded(self._sampler, [(*key, part)], 0, n)

    def _receivers(
        self, sampler: mi.Sampler
    ) -> tuple[mi.UInt32, mi.Vector3f, mi.Float]:
        """One for each lane, a direction to it, and the weight of what arrives."""
        n = self._n_receivers
        number = dr.minimum(mi.UInt32(sampler.next_1d() * mi.Float(n)), n - 1)
        low, span, phi_low, phi_span, ratio = (
            dr.gather(mi.Float, column, number) for column in self._table
        )
        at = mi.Point2f(sampler.next_2d())
        s = low + span * at.x
        radius = 2 * dr.sqrt(s * (1 - s))
        sin_phi, cos_phi = dr.sincos(phi_low + phi_span * at.y)
        wo = mi.Vector3f(radius * cos_phi, radius * sin_phi, 1 - 2 * s)
        return number, wo, ratio * mi.Float(n)

    def _interaction(self, face: mi.UInt32, place: mi.Point2f) -> Any:
        """Interaction with a place in a triangle, which moves with it."""
        met = dr.zeros(mi.PreliminaryIntersection3f, dr.width(face))
        met.t, met.prim_index, met.prim_uv = mi.Float(1), face, place
        met.valid, met.shape = mi.Bool(True), mi.ShapePtr(self._meshes[1])
        flags = SURFACE | int(mi.RayFlags.FollowShape)
        ray = mi.Ray3f(mi.Point3f(0), mi.Vector3f(0, 0, 1))
        return with_normal(met.compute_surface_interaction(ray, flags, True))

    def _sees(self, si: Any, w: mi.Vector3f, active: mi.Bool) -> mi.Bool:
        """Whether nothing stands in the way from points of the surface."""
        with dr.suspend_grad():  # calls of any shape are those of the one that moves
            return sees(self._specimen, 1, si, w, active)

    def _scattered(self, si: Any, wo: mi.Vector3f, active: mi.Bool) -> Any:
        """Value of the BSDF with the cosine to the detector, one for each channel."""
        si.wi = si.to_local(self._wi)
        found = si.bsdf().eval(flux_context(), si, si.to_local(wo), active)
        return dr.select(active, found, 0.0)

    def _is_lit(self, si: Any, active: mi.Bool) -> mi.Bool:
        """Whether light gets to points: it is in no shadow, and of the footprint."""
        active = active & self._sees(si, self._wi, active)
        if self._is_bounded:
            box, wi = self._specimen.box, self._wi
            entry = si.p + wi * ((box.high[2] - si.p.z) / wi.z)
            for axis in (0, 1):
                active &= (entry[axis] > box.low[axis]) & (entry[axis] < box.high[axis])
        return active

    def _of_points(self, sampler: mi.Sampler, moves: bool) -> Any:
        """Light of points all over the surface; these are hidden as the surface is."""
        receiver, wo, weight = self._receivers(sampler)
        face, share = _drawn(self._by_area, sampler.next_1d())
        place = mi.warp.square_to_uniform_triangle(sampler.next_2d())
        power = 1 / (share * self.points)
        with dr.suspend_grad():
            si = self._interaction(face, place)
            lit = self._is_lit(si, mi.Bool(True))
            seen = self._sees(si, wo, lit)
        if moves:
            lanes = receiver, wo, weight, face, place, seen, power
            receiver, wo, weight, face, place, seen, power = _where(lit, lanes)
            lit, si = mi.Bool(True), self._interaction(face, place)
        a, b, c = self._corners(face)
        power *= dr.abs(dr.dot(dr.cross(b - a, c - a), self._wi)) / 2
        light = self._scattered(si, wo, seen) * (power * weight)
        return receiver, light, dr.select(lit, power, 0.0)

    def _corners(self, face: mi.UInt32) -> list[mi.Point3f]:
        """Vertices of triangles, which move."""
        corners = dr.gather(mi.Vector3u, self._faces, face)
        return [dr.gather(mi.Point3f, self._vertices, one) for one in corners]

    def _outline(self, edge: mi.UInt32, d: mi.Vector3f) -> tuple[mi.Vector3f, mi.Float]:
        """Normal of edges across `d`, away from both triangles, and length across it.

        The length is 0 where the edge is no silhouette as seen from `d`.
        """
        still = dr.detach(self._vertices)
        a, b, near, far = (
            dr.gather(mi.Point3f, still, dr.gather(mi.UInt32, end, edge))
            for end in self._edges
        )
        far += dr.gather(mi.Vector3f, self._shift, edge)
        m = dr.cross(d, b - a)
        length = dr.norm(m)
        m /= length
        one, other = dr.dot(m, near - a), dr.dot(m, far - a)
        return m * -dr.sign(one), dr.select(one * other > 0, length, 0.0)

    def _silhouettes(self, d: mi.Vector3f) -> mi.UInt32:
        """Edges that are silhouettes from `d`."""
        edges = dr.arange(mi.UInt32, dr.width(self._shift))
        return dr.compress(self._outline(edges, d)[1] > 0)

    def _on_edge(self, edge: mi.UInt32, t: mi.Float) -> mi.Point3f:
        """Point of an edge, which moves with it."""
        a, b = (
            dr.gather(mi.Point3f, self._vertices, dr.gather(mi.UInt32, end, edge))
            for end in self._edges[:2]
        )
        return dr.lerp(a, b, t)

    def _behind(
        self, p: Any, m: mi.Vector3f, d: mi.Vector3f
    ) -> tuple[mi.Bool, Any, mi.Float]:
        """What is seen just beside points `p` that hide it from `d`, on their side `m`.

        Returns
        -------
        met : mi.Bool
        si : mi.SurfaceInteraction3f
            Without derivatives.
        hidden : mi.Float
            0, with the derivative of how far `p` moves over it, along `m`.
        """
        specimen = self._specimen
        start = dr.detach(p) + m * (specimen.box.reach * NEARBY)
        none = mi.Normal3f(0), mi.Float(0)
        with dr.suspend_grad():
            free = escapes(specimen, 1, mi.Ray3f(start, d), *none, mi.Bool(True))
            met, face, q = first_met(specimen, 1, mi.Ray3f(start, -d), free)
            a, b, c = self._corners(face)
            place = _barycentric(q, a, b, c)
            dr.eval(met, face, place, m)
            si = self._interaction(face, place)
        a, b, c = self._corners(face)
        hidden = dr.dot(m, p - (a + place.x * (b - a) + place.y * (c - a)))
        return met, si, dr.select(met, hidden - dr.detach(hidden), 0.0)

    def _shadows(self, sampler: mi.Sampler, n: int, edges: mi.UInt32) -> Any:
        """Light that is lost where the shadows of `edges` grow."""
        lengths = dr.gather(mi.Float, self._by_length[1], edges)
        number, share = _drawn(_shares(lengths.numpy()), sampler.next_1d())
        edge = dr.gather(mi.UInt32, edges, number)
        m, length = self._outline(edge, self._wi)
        p = self._on_edge(edge, sampler.next_1d())
        return self._beside(sampler, p, m, length / (share * n))

    def _footprint(self, sampler: mi.Sampler, n: int) -> Any:
        """The same at the border of the footprint, whose outside is as a shadow."""
        box = self._specimen.box
        side = dr.minimum(mi.UInt32(sampler.next_1d() * 4), 3)
        along_x, upper, t = side < 2, side % 2 == 1, sampler.next_1d()
        x = dr.select(upper, box.high[0], box.low[0])
        y = dr.select(upper, box.high[1], box.low[1])
        x = dr.select(along_x, dr.lerp(box.low[0], box.high[0], t), x)
        y = dr.select(along_x, y, dr.lerp(box.low[1], box.high[1], t))
        z = self._vertices.z
        top = mi.UInt32(int(np.argmax(z.numpy())))
        p = mi.Point3f(x, y, dr.gather(mi.Float, z, top))
        edge = mi.Vector3f(
            dr.select(along_x, box.period[0], 0),
            dr.select(along_x, 0, box.period[1]),
            0,
        )
        m = dr.cross(self._wi, edge)
        length = dr.norm(m)
        inwards = mi.Vector3f(dr.select(along_x, 0, 1), dr.select(along_x, 1, 0), 0)
        inwards = dr.select(upper, -inwards, inwards)
        m *= dr.sign(dr.dot(m, inwards)) / length
        return self._beside(sampler, p, m, length * 4 / n)

    def _beside(
        self, sampler: mi.Sampler, p: Any, m: mi.Vector3f, weight: mi.Float
    ) -> Any:
        """Light that points lose as `p`, beside which they are lit, moves over them."""
        receiver, wo, ratio = self._receivers(sampler)
        met, si, hidden = self._behind(p, m, self._wi)
        with dr.suspend_grad():
            if self._is_bounded:
                met &= self._is_lit(si, met)
            seen = self._sees(si, wo, met)
            light = self._scattered(si, wo, seen) * (weight * ratio)
            weight = dr.select(met, weight, 0.0)
            dr.eval(receiver, light, weight)
        return receiver, -hidden * light, -hidden * weight

    def _masks(self, sampler: mi.Sampler) -> Iterator[Any]:
        """Light of points that detectors no longer see as edges move before them."""
        receiver, wo, ratio = self._receivers(sampler)
        edge, share = _drawn(self._by_length, sampler.next_1d())
        t = sampler.next_1d()
        m, length = self._outline(edge, wo)
        weight = length * ratio / (share * self.points)
        lanes = receiver, wo, edge, t, m, weight
        receiver, wo, edge, t, m, weight = _where(length > 0, lanes)
        if not dr.width(edge):
            return
        met, si, hidden = self._behind(self._on_edge(edge, t), m, wo)
        with dr.suspend_grad():
            lit = self._is_lit(si, met)
            weight *= dr.abs(dr.dot(si.n, self._wi) / dr.dot(si.n, wo))
            light = self._scattered(si, wo, lit) * dr.select(lit, weight, 0.0)
            dr.eval(light)
        yield receiver, light * -hidden, None


class _BRDF(dr.CustomOp):
    """The map as an operation of Dr.Jit, whose derivative has points of its own."""

    def eval(
        self, surface: DifferentiableSurface, geometry: mi.TensorXf, seed: int
    ) -> mi.TensorXf:
        self._surface, self._geometry, self._seed = surface, geometry, seed
        found = surface._value(geometry, (seed, VALUE))
        return mi.TensorXf(found, surface.shape)

    def forward(self) -> None:
        change = mi.TensorXf(self.grad_in("geometry"))
        key = self._seed, DERIVATIVE
        found = self._surface._forward(self._geometry, change, key)
        self.set_grad_out(mi.TensorXf(found))

    def backward(self) -> None:
        adjoint, key = mi.TensorXf(self.grad_out()), (self._seed, DERIVATIVE)
        found = self._surface._backward(self._geometry, adjoint, key)
        self.set_grad_in("geometry", found)

    def name(self) -> str:
        return "first-order BRDF"


def _checked_mesh(specimen: Specimen) -> mi.Mesh:
    """The one mesh of a specimen; SpecimenError if it has more, or something else."""
    (surface, *more), what = specimen.surfaces, "a differentiable surface"
    # a rectangle is a mesh in Mitsuba's class tree, but has no vertices
    if more or specimen.groups or triangles_of(traversed(surface)) is None:
        kinds = sorted({shape.class_name() for shape in specimen.surfaces})
        raise SpecimenError(
            f"{what} must be one mesh, got "
            f"{number_of(1 + len(more), 'shape')}: {', '.join(kinds)}"
        )
    if has_normals(surface):
        raise SpecimenError(
            f"{what} must have flat facets, got interpolated normals, which would not "
            "move with its vertices: set face_normals=true"
        )
    if surface.face_count() > MAX_TRIANGLES:
        raise SpecimenError(
            f"{what} must have at most {MAX_TRIANGLES} triangles, got "
            f"{surface.face_count()}"
        )
    if specimen.media or len(specimen.shifts) > 1:
        part = "a medium" if specimen.media else "geometry wider than its period"
        raise SpecimenError(f"{what} must not have {part}")
    flags = surface.bsdf().flags()
    for flag, reason in REFUSED.items():
        if mi.has_flag(flags, flag):
            raise SpecimenError(f"the BSDF of {what} must not have {reason}")
    return surface


def _put(mesh: mi.Mesh, points: mi.Point3f) -> None:
    """Move the vertices of a mesh."""
    parameters = mi.traverse(mesh)
    name = "positions" if "positions" in parameters else "vertex_positions"
    parameters[name] = dr.ravel(points)
    parameters.update()


def _grid(points: Singles, same: Any) -> Any:
    """Heights of vertices in rows and columns, each once, and the one of each vertex.

    None of other meshes.
    """
    n_x = int(np.argmax(np.append(points[:, 1] != points[0, 1], True)))
    if n_x < 2 or len(points) % n_x or len(points) == n_x:
        return None
    x, y, z = np.moveaxis(points.reshape(-1, n_x, 3), -1, 0)
    if np.any(x != x[0]) or np.any(y != y[:, :1]):
        return None
    same = same.reshape(z.shape)
    rows = len(z) - int(np.array_equal(same[0], same[-1]))
    columns = n_x - int(np.array_equal(same[:, 0], same[:, -1]))
    i, j = np.indices(z.shape)
    return z[:rows, :columns].copy(), (i % rows * columns + j % columns).ravel()


def _shares(sizes: Floats) -> tuple[mi.Float, mi.Float]:
    """Of parts of a whole: sums up to each of them, and the shares that these give.

    Shares are in proportion to the sizes, but none is 0, for parts may grow.
    """
    below = np.cumsum(sizes + MIN_SHARE * np.mean(sizes), dtype=float)
    below = (below / below[-1]).astype(np.float32)
    return floats(below), floats(np.diff(below, prepend=np.float32(0)))


def _drawn(shares: tuple[mi.Float, mi.Float], u: mi.Float) -> tuple[Any, mi.Float]:
    """Number of a part, and its share."""
    below, share = shares
    end = dr.width(below) - 1
    found = dr.binary_search(0, end, lambda i: dr.gather(mi.Float, below, i) <= u)
    number = mi.UInt32(found)
    return number, dr.gather(mi.Float, share, number)


def _where(active: mi.Bool, lanes: Sequence[Any]) -> list[Any]:
    """The lanes that are active; if that is one, twice with half the last of `lanes`.

    Dr.Jit 1.5 records no loops of a single lane.
    """
    dr.eval(active, *lanes)
    some = dr.compress(active)
    if dr.width(some) == 1:
        some, lanes = mi.UInt32(some[0], some[0]), [*lanes[:-1], lanes[-1] / 2]
    return [dr.gather(type(lane), lane, some) for lane in lanes]


def _barycentric(q: mi.Point3f, a: Any, b: Any, c: Any) -> mi.Point2f:
    """Weights of the corners `b` and `c` for points of a triangle's plane."""
    u, v, w = b - a, c - a, q - a
    uu, uv, vv, wu, wv = (
        dr.dot(*pair) for pair in ((u, u), (u, v), (v, v), (w, u), (w, v))
    )
    scale = dr.rcp(uu * vv - uv * uv)
    return mi.Point2f((vv * wu - uv * wv) * scale, (uu * wv - uv * wu) * scale)

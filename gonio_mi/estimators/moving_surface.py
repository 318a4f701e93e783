"""Light of one event from a mesh whose vertices move, with its derivatives.

Points keep their place in their triangles, so that they move with the vertices. What
hides them moves too, without them: silhouette edges, as seen from the source and from
the detector, carry that part of the derivative.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Floats, Singles
from ..kernels import in_memory
from ..mitsuba_compat import SURFACE, floats, mesh_of, triangles_of
from ..specimen.rays import NEARBY, escapes, first_met, with_normal
from ..specimen.scene_objects import traversed
from ..specimen.specimen import Specimen
from ..surfaces.mesh_edges import mesh_edges, welded
from ..transport.sampling import seeded
from ..transport.surface_events import flux_context
from .surface_points import sees

# Points at silhouettes, in parts of the points of the surface.
EDGE_POINTS = 1 / 8

# Part of the mean share of triangles, and of edges, that each of them gets at least.
MIN_SHARE = 1 / 64


class MovingSurface:
    """A mesh that is lit from one direction, and what it sends to receivers.

    Parameters
    ----------
    specimen : Specimen
        With one mesh of flat facets.
    wi : ndarray, shape (3,)
        Towards the source, above.
    receivers : sequence of ndarray, shape (n,)
        Of each the lower edge, and the span, in the square of the sine of half the
        polar angle; the same in azimuth; and 1 over the mean cosine.

    Attributes
    ----------
    start : mi.TensorXf
        Geometry as it was given: heights of a grid, or vertices.
    """

    def __init__(
        self, specimen: Specimen, wi: Floats, receivers: Sequence[Floats]
    ) -> None:
        self._wi = mi.Vector3f(in_memory(wi))
        # two at least: what is gathered from a single one is another kernel
        self._table = [mi.Float([*column, column[-1]]) for column in receivers]
        self._n_receivers = len(receivers[0])
        self._is_bounded = specimen.edges == "open"
        self._sampler = mi.load_dict({"type": "sobol"})
        self._set_mesh(specimen)

    def _set_mesh(self, specimen: Specimen) -> None:
        """Copies of the mesh, to be traced and to be moved; its geometry and edges."""
        (mesh,) = specimen.surfaces
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
        self.start = mi.TensorXf(base)
        self._take = mi.UInt32(take.astype(np.uint32))
        self._is_grid = grid is not None
        dr.make_opaque(self._faces, self._edges, self._shift, self._take, self._fixed)
        # of the geometry as it was given: what is drawn is the same for another one
        one, other, third = (points[corner].astype(float) for corner in faces.T)
        areas = np.linalg.norm(np.cross(other - one, third - one), axis=1)
        lengths = np.linalg.norm(points[edges.end] - points[edges.start], axis=1)
        self._by_area, self._by_length = _shares(areas), _shares(lengths)

    def mesh(self, geometry: mi.TensorXf) -> mi.Mesh:
        """A mesh like that of the specimen, of that geometry."""
        mesh = self._copy()
        _put(mesh, dr.detach(self._vertices_of(geometry)))
        return mesh

    def _copy(self) -> mi.Mesh:
        """A mesh like that of the specimen."""
        props = mi.Properties("ply")
        props["bsdf"], props["face_normals"] = self._bsdf, True
        points, faces, others = self._mesh
        return mesh_of(props, "a differentiable surface", points, faces, **others)

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

    def brdf(
        self, geometry: mi.TensorXf, key: tuple[int, ...], points: int
    ) -> mi.Float:
        """BRDF of light of one event, by receiver and channel.

        Parameters
        ----------
        geometry : mi.TensorXf
        key : tuple of int
            What tells the points from others.
        points : int
            Their number.
        """
        moves = dr.grad_enabled(geometry)
        self._pose(geometry)
        n_channels = len(mi.UnpolarizedSpectrum())
        flux = dr.zeros(mi.Float, self._n_receivers * n_channels)
        cell = self._specimen.box.period if self._specimen.periodic else None
        incident = cell[0] * cell[1] * self._wi.z if cell else mi.Float(0)
        for receiver, light, lit in self._lights(key, points, moves):
            for channel, power in enumerate(light):
                dr.scatter_add(flux, power, receiver * n_channels + channel)
            if cell is None and lit is not None:
                incident += dr.sum(lit)
        return flux / incident

    @contextmanager
    def brdf_in_motion(self, *given: Any) -> Iterator[mi.Float]:
        """:meth:`brdf` of a geometry with derivatives, which no other kernel meets."""
        try:
            yield self.brdf(*given)
        finally:
            self._vertices = dr.detach(self._vertices)
            _put(self._meshes[1], self._vertices)

    def _lights(self, key: tuple[int, ...], points: int, moves: bool) -> Iterator[Any]:
        """Receivers, light that points send there, and light that they get, or None."""
        n = int(EDGE_POINTS * points)

        def sampler(part: int, n: int) -> mi.Sampler:
            return seeded(self._sampler, [(*key, part)], 0, n)

        yield self._of_points(sampler(0, points), moves)
        if not moves:
            return
        at_source = self._silhouettes(self._wi)
        if dr.width(at_source):
            yield self._shadows(sampler(1, n), at_source)
        if self._is_bounded:
            yield self._footprint(sampler(2, n))
        yield from self._masks(sampler(3, points))

    def _receivers(
        self, sampler: mi.Sampler
    ) -> tuple[mi.UInt32, mi.Vector3f, mi.Float]:
        """One for each lane, a direction to it, and the weight of what arrives."""
        n = dr.opaque(mi.UInt32, self._n_receivers)
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
        face, power = _drawn(self._by_area, sampler.next_1d())
        place = mi.warp.square_to_uniform_triangle(sampler.next_2d())
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

    def _shadows(self, sampler: mi.Sampler, edges: mi.UInt32) -> Any:
        """Light that is lost where the shadows of `edges` grow."""
        lengths = dr.gather(mi.Float, self._by_length[1], edges)
        number, weight = _drawn(_shares(lengths.numpy()), sampler.next_1d())
        edge = dr.gather(mi.UInt32, edges, number)
        m, length = self._outline(edge, self._wi)
        p = self._on_edge(edge, sampler.next_1d())
        return self._beside(sampler, p, m, length * weight)

    def _footprint(self, sampler: mi.Sampler) -> Any:
        """The same at the border of the footprint, whose outside is as a shadow."""
        box = self._specimen.box
        side, weight = _drawn(_shares(np.ones(4)), sampler.next_1d())
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
        return self._beside(sampler, p, m, length * weight)

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
        edge, weight = _drawn(self._by_length, sampler.next_1d())
        t = sampler.next_1d()
        m, length = self._outline(edge, wo)
        weight *= length * ratio
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
    """Number of a part, and 1 over its share and over the number of draws."""
    below, share = shares
    end = dr.width(below) - 1
    found = dr.binary_search(0, end, lambda i: dr.gather(mi.Float, below, i) <= u)
    number, n = mi.UInt32(found), dr.opaque(mi.Float, dr.width(u))
    return number, 1 / (n * dr.gather(mi.Float, share, number))


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

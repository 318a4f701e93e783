"""Light at a point of a surface; ``eval`` at points of rules over cells, and sums."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Flags, Floats, Singles
from ..collector import Subdivision
from ..collector.directions import angles, direction
from ..errors import SpecimenError
from ..specimen.plane import repeated
from ..specimen.scene_objects import holds_foreign_plugins
from ..transport.derivative import Derivative
from ..transport.surface_events import flux_context
from .cells import (
    BLIND,
    CONFIRMING,
    GAUSS,
    NOISE,
    PROBING,
    Cells,
    Guides,
    Points,
    noise,
    off_polynomial,
)


@dataclass(frozen=True)
class IncidentLight:
    """Light that meets one point of a surface from one direction after the other.

    Attributes
    ----------
    interaction : mi.SurfaceInteraction3f
        The point and its frame.
    wi : mi.Vector3f
        The directions, in its frame.
    side : int
        1 if the front is lit, -1 if the back is.
    rounding : ndarray, shape (n_directions,)
        By how much single precision moves each of them, in radians.
    """

    interaction: mi.SurfaceInteraction3f
    wi: mi.Vector3f
    side: int
    rounding: Floats

    @classmethod
    def of(
        cls,
        incidents: Sequence[tuple[float, float]],
        side: str,
        interaction: mi.SurfaceInteraction3f | None = None,
    ) -> IncidentLight:
        """Light from angles in degrees, the polar one from the lit face's normal.

        Without an `interaction` in the middle of a square with its normal along +z.
        """
        sign = 1 if side == "front" else -1
        theta, phi = np.radians(np.asarray(incidents, dtype=float)).T
        towards = direction(theta, phi) * [1, 1, sign]
        si = square() if interaction is None else mi.SurfaceInteraction3f(interaction)
        wi = si.to_local(mi.Vector3f(np.ascontiguousarray(towards.T)))
        dr.make_opaque(wi)
        rounding = np.linalg.norm(towards - towards.astype(np.float32), axis=1)
        return cls(si, wi, sign, rounding)

    def from_number(self, number: mi.UInt32) -> mi.SurfaceInteraction3f:
        """Interaction with the light of that number in each lane."""
        si = mi.SurfaceInteraction3f(self.interaction)
        si.wi = dr.gather(mi.Vector3f, self.wi, number)
        return si

    @property
    def first(self) -> mi.SurfaceInteraction3f:
        """Interaction with the first of the lights."""
        return self.from_number(mi.UInt32(0))

    def towards(
        self, theta: Floats | mi.Float64, phi: Floats | mi.Float64, lower: Any
    ) -> mi.Vector3f:
        """Directions in the frame of the surface, from angles seen from the lit face.

        They are rounded to single precision once.
        """
        of_theta, of_phi = (dr.sincos(mi.Float64(angle)) for angle in (theta, phi))
        return self.towards_sines(of_theta, of_phi, lower)

    def towards_sines(
        self,
        theta: tuple[Any, Any],
        phi: tuple[Any, Any],
        lower: Any,
        frame: Sequence[Sequence[mi.Float64]] | None = None,
    ) -> mi.Vector3f:
        """The same from the sine and cosine of each angle, in double precision.

        The rows of a `frame` take angles about another axis to those about the pole.
        """
        (sin_theta, cos_theta), (sin_phi, cos_phi) = theta, phi
        of_axis = sin_theta * cos_phi, sin_theta * sin_phi, cos_theta
        if frame is not None:
            of_axis = tuple(
                sum(one * component for one, component in zip(row, of_axis))
                for row in frame
            )
        x, y, z = map(mi.Float, of_axis)
        side = dr.select(mi.Bool(lower), -self.side, self.side)
        world = mi.Vector3f(x, y, z * side)
        return self.interaction.to_local(world)

    def evaluate(
        self, bsdf: mi.BSDF, theta: Floats, phi: Floats, lower: Flags
    ) -> list[mi.Float]:
        """``eval`` of all channels for the first of the lights."""
        first = dr.zeros(mi.UInt32, len(theta))
        wo = self.towards(theta, phi, lower)
        si = self.from_number(first)
        if holds_foreign_plugins(bsdf):
            si = repeated(si, len(theta))
        return channels_of(bsdf.eval(flux_context(), si, wo, mi.Bool(True)))


def channels_of(value: Any) -> list[mi.Float]:
    """Channels of what a BSDF gives, be it one number for all of them, or a list."""
    if isinstance(value, list):
        return value
    return list(mi.Spectrum(value) if dr.depth_v(value) < 2 else value)


def square() -> mi.SurfaceInteraction3f:
    """Point in the middle of a square in z = 0, as Mitsuba's `rectangle` gives it."""
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.t = 1.0
    si.uv = mi.Point2f(0.5)
    si.n = mi.Normal3f(0, 0, 1)
    si.sh_frame = mi.Frame3f(
        mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0), mi.Vector3f(0, 0, 1)
    )
    si.dp_du, si.dp_dv = mi.Vector3f(2, 0, 0), mi.Vector3f(0, 2, 0)
    return si


# Sampled directions that show where narrow lobes are, of each incident direction.
N_GUIDES = 2**14

# What single precision leaves of an integral's digits, at best.
INTEGRAL_ROUNDING = 2.0**-22

# Cells whose values are summed at a time, so that they stay in the processor's cache.
IN_CACHE = 2**10

# Times the noise of the values, by which they may be off the polynomial through them.
MAX_NOISE_RATIO = 256


class Evaluator:
    """Evaluates a BSDF for light from several directions, all in one kernel.

    Parameters
    ----------
    bsdf : mi.BSDF
    light : IncidentLight
    axes : ndarray, shape (n_patches, 3), optional
        Poles of the patches' cells, if these have their own.

    Attributes
    ----------
    n_evaluations : ndarray of int, shape (n_directions,)
        What was asked for so far.
    by_ray : bool
        As of :class:`~gonio_mi.specimen.plane.Plane`.
    """

    def __init__(
        self, bsdf: mi.BSDF, light: IncidentLight, axes: Floats | None = None
    ) -> None:
        self.bsdf, self.light = bsdf, light
        self.frames: Any = None
        if axes is not None:
            # columns of polar angle, azimuth and axis: of +z the identity
            theta, phi = angles(axes)
            across = direction(theta + np.pi / 2, phi)
            along = direction(np.full_like(phi, np.pi / 2), phi + np.pi / 2)
            self.frames = np.stack([across, along, axes], axis=-1)
        self.by_ray = holds_foreign_plugins(bsdf)
        self.n_evaluations = np.zeros(dr.width(light.wi), dtype=np.int64)

    def _interactions(self, number: mi.UInt32) -> mi.SurfaceInteraction3f:
        """Interaction with the light of that number in each lane."""
        si = self.light.from_number(number)
        return repeated(si, dr.width(number)) if self.by_ray else si

    def guides(self, cells: Cells, subdivision: Subdivision) -> Guides:
        """Sampled directions, without those of delta components."""
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(0, N_GUIDES)
        samples = sampler.next_1d(), sampler.next_2d()
        dr.eval(samples)
        n = len(self.n_evaluations)
        lane = dr.arange(mi.UInt32, n * N_GUIDES)
        number = lane // N_GUIDES
        si = self._interactions(number)
        same = lane - number * N_GUIDES
        one, two = (dr.gather(type(sample), sample, same) for sample in samples)
        bs, weight = self.bsdf.sample(flux_context(), si, one, two, mi.Bool(True))
        delta = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
        lit = (~delta & dr.any(mi.Spectrum(weight) > 0)).numpy()
        wo = np.broadcast_to(si.to_world(bs.wo).numpy(), (3, len(lane))).T
        wo = wo * [1, 1, self.light.side]
        of = np.repeat(np.arange(n), N_GUIDES)
        lower = wo[:, 2] < 0
        n_hemispheres = len(cells.patch) // (n * subdivision.n_patches)
        wanted = np.broadcast_to(lit, len(lane)) & (lower < n_hemispheres)
        wo, of, lower = wo[wanted], of[wanted], lower[wanted]
        patch = subdivision.patch(wo)
        before = subdivision.n_patches * (lower + n_hemispheres * of)
        if self.frames is None:
            patch += before
        else:
            # what is not in a cone is the hemisphere less the cones, which it holds
            rest = subdivision.n_patches - 1
            own = np.flatnonzero(patch < rest)
            twice = np.append(np.arange(len(wo)), own)
            patch = np.append(np.full(len(wo), rest), patch[own])
            upper = wo[twice] * np.where(lower, [[1], [1], [-1]], 1).T[twice]
            wo = np.einsum("nji,nj->ni", self.frames[patch], upper)
            patch += before[twice]
        theta, phi = angles(wo)
        # a cell may begin below the azimuth 0
        phi[(cells.phi[patch, 0] < 0) & (phi > np.pi)] -= 2 * np.pi
        return Guides(patch, np.minimum(theta, np.pi - theta), phi)

    def integrals(self, cells: Cells) -> tuple[Floats, Singles]:
        """Integrals over cells, and the values that they are made of.

        Returns
        -------
        integrals : ndarray, shape (n, channels)
        values : ndarray, shape (n, NODES_PER_CELL, channels)
            In single precision, as they were found.
        """
        values = self._values(cells, GAUSS)
        found = np.empty((len(values), values.shape[-1]))
        for some in _pieces(len(values)):
            weights = cells[some].weights()[:, :, None]
            found[some] = np.multiply(values[some], weights).sum(axis=1)
        return found, values

    def unconfirmed(self, cells: Cells, integrals: Floats) -> Floats:
        """How far a rule of other points is from the `integrals` over cells.

        Its points are many, and only their sums leave the kernel.
        """
        if not len(integrals):
            return integrals
        values, sines = self._evaluated(cells, CONFIRMING)
        lane = dr.arange(mi.UInt32, len(cells.patch) * len(CONFIRMING))
        number = lane // len(CONFIRMING)
        weights = mi.Float64(CONFIRMING.areas)
        weight = dr.gather(mi.Float64, weights, lane - number * len(CONFIRMING))
        area = np.diff(cells.theta)[:, 0] * np.diff(cells.phi)[:, 0] / 4
        weight *= dr.gather(mi.Float64, mi.Float64(area), number) * sines
        products = [value * weight for value in values]
        dr.eval(values, products)  # at once, so that each point is evaluated once
        sums = [dr.block_sum(product, len(CONFIRMING)) for product in products]
        least = [dr.min(value) for value in values]
        dr.eval(sums, least)
        found = np.stack([one.numpy() for one in sums], axis=-1)
        if not (np.isfinite(found).all() and all(one[0] >= 0 for one in least)):
            self._values(cells, CONFIRMING)  # which says what is wrong
        return np.abs(found - integrals)

    def hidden(self, cells: Cells, values: Singles) -> Floats:
        """What a step between the nodes of the quarters of each cell can change.

        There, BSDF and the polynomial through its `values` differ.
        """
        if not len(values):
            return values[:, 0].astype(float)
        found = self._values(cells, PROBING)
        pieces = _pieces(len(values))
        off = np.concatenate([off_polynomial(found[p], values[p]) for p in pieces])
        # some of the values are enough to see most of the cells that are smooth
        least = NOISE * np.abs(values[:, ::8]).max(axis=1).astype(float)
        doubtful = np.any(off > MAX_NOISE_RATIO * least, axis=1)
        off[doubtful] -= MAX_NOISE_RATIO * noise(values[doubtful])
        off[~doubtful] = 0
        return BLIND * np.maximum(off, 0) * cells.area[:, None]

    def _values(self, cells: Cells, points: Points) -> Singles:
        """Values at the `points` of each cell, shape ``(n, n_points, channels)``."""
        shape = len(cells.patch), len(points)
        several, _ = self._evaluated(cells, points)
        dr.eval(several)
        columns = [
            np.broadcast_to(one.numpy(), shape[0] * shape[1]).reshape(shape)
            for one in several
        ]
        # a single one is not copied
        values = columns[0][..., None] if len(columns) == 1 else np.stack(columns, -1)
        self._check(values, cells, points)
        return values

    def _evaluated(
        self, cells: Cells, points: Points
    ) -> tuple[list[mi.Float], mi.Float64]:
        """Values at the `points` of each cell, by channel, and sines of polar angles.

        Angles and their sines are of double precision, and rounded once.
        """
        n, each = len(cells.patch), len(points)
        self.n_evaluations += each * np.bincount(
            cells.direction, minlength=len(self.n_evaluations)
        )
        lane = dr.arange(mi.UInt32, n * each)
        number = lane // each
        theta, phi = _sines(cells, points, number, lane - number * each)
        lower = dr.gather(mi.Bool, mi.Bool(cells.lower), number)
        wo = self.light.towards_sines(theta, phi, lower, self._frame(cells, number))
        direction = mi.UInt32(cells.direction.astype(np.uint32))
        si = self._interactions(dr.gather(mi.UInt32, direction, number))
        return channels_of(self._eval(si, wo)), theta[0]

    def _eval(self, si: mi.SurfaceInteraction3f, wo: mi.Vector3f) -> Any:
        return self.bsdf.eval(flux_context(), si, wo, mi.Bool(True))

    def _frame(self, cells: Cells, number: mi.UInt32) -> list[list[mi.Float64]] | None:
        """Frame of the cell `number` in each lane, if cells have poles of their own."""
        if self.frames is None:
            return None
        axis = mi.UInt32((cells.patch % len(self.frames)).astype(np.uint32))
        at = dr.gather(mi.UInt32, axis, number)
        return [
            [
                dr.gather(mi.Float64, mi.Float64(self.frames[:, i, j]), at)
                for j in range(3)
            ]
            for i in range(3)
        ]

    def _check(self, values: Singles, cells: Cells, points: Points) -> None:
        """Raise SpecimenError for a value that is negative or not finite."""
        top = values.max(initial=0)
        if values.min(initial=0) >= 0 and np.isfinite(top):
            return
        tops = np.zeros(len(self.n_evaluations))
        np.maximum.at(tops, cells.direction, values.max(axis=(1, 2)))
        least = -INTEGRAL_ROUNDING * tops[cells.direction][:, None, None]
        wrong = ~np.all((values >= least) & np.isfinite(values), axis=2)
        if not wrong.any():
            return
        cell, place = np.argwhere(wrong)[0]
        theta, phi = (
            middle[cell] + np.clip(half[cell] * at[place], -inside[cell], inside[cell])
            for middle, half, inside, at in points.placed(cells)
        )
        if self.frames is not None:
            own = self.frames[cells.patch[cell] % len(self.frames)]
            theta, phi = angles(own @ direction(theta, phi))
        raise SpecimenError(
            f"eval of {self.bsdf.class_name()} must be "
            f"finite and not negative, got {values[cell, place].min():.3g} towards "
            f"theta {np.degrees(theta):.3f}, phi {np.degrees(phi):.3f} degrees"
            f"{' in transmission' if cells.lower[cell] else ''}"
        )


class SlopeEvaluator(Evaluator):
    """Evaluates the derivative of a BSDF by the parameter that is attached."""

    def __init__(
        self,
        bsdf: mi.BSDF,
        derivative: Derivative,
        light: IncidentLight,
        axes: Floats | None,
    ) -> None:
        super().__init__(bsdf, light, axes)
        self.derivative = derivative

    def _eval(self, si: mi.SurfaceInteraction3f, wo: mi.Vector3f) -> Any:
        return self.derivative.of_eval(self.bsdf, si, wo, mi.Bool(True))[0]

    def _check(self, values: Singles, cells: Cells, points: Points) -> None:
        """Raise SpecimenError for a value that is not finite."""
        super()._check(np.abs(values), cells, points)


def _pieces(n: int) -> list[slice]:
    """Pieces of `n` cells whose values stay in the cache while they are worked on."""
    return [slice(first, first + IN_CACHE) for first in range(0, n, IN_CACHE)]


def _sines(
    cells: Cells, points: Points, number: mi.UInt32, place: mi.UInt32
) -> list[tuple[mi.Float64, mi.Float64]]:
    """Sines and cosines of both angles at the point `place` of each cell `number`.

    What points of a tensor rule share is found once.
    """
    m = points.n_side
    if not m:
        return [dr.sincos(angle) for angle in _angles(cells, points, number, place)]
    lane = dr.arange(mi.UInt32, len(cells.patch) * m)
    cell = lane // m
    of_side = lane - cell * m
    # the azimuth runs fastest
    of_theta = _angles(cells, points, cell, of_side * m)[0]
    of_phi = _angles(cells, points, cell, of_side)[1]
    shared = [dr.sincos(angle) for angle in (of_theta, of_phi)]
    dr.eval(shared)
    row = place // m
    places = number * m + row, number * m + (place - row * m)
    return [
        tuple(dr.gather(mi.Float64, one, at) for one in both)
        for both, at in zip(shared, places)
    ]


def _angles(
    cells: Cells, points: Points, cell: mi.UInt32, point: mi.UInt32
) -> list[mi.Float64]:
    """Polar angle and azimuth of the `point` of each `cell`, by their numbers."""
    found = []
    for middle, half, inside, at in points.placed(cells):
        node = dr.gather(mi.Float64, mi.Float64(at), point)
        limit, halves, middles = (
            dr.gather(mi.Float64, mi.Float64(array), cell)
            for array in (inside, half, middle)
        )
        found.append(middles + dr.clip(halves * node, -limit, limit))
    return found

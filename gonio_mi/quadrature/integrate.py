"""Converged patch integrals of a flat specimen's BSDF: no rays, no random numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Flags, Floats, Integers, Numbers, Singles
from ..collector import Subdivision
from ..errors import SpecimenError
from ..transport.derivative import Derivative
from .cells import NODES_PER_CELL, QUARTERS, Cells, way_to_split
from .evaluator import (
    INTEGRAL_ROUNDING,
    Evaluator,
    IncidentLight,
    SlopeEvaluator,
)

# Guides that a cell may hold before it is split unseen.
MAX_GUIDES = 8

# Part of the tolerated error that the cells of a patch share, since later levels may
# find the patch darker.
CELL_TOLERANCE = 1 / 4

# Evaluations of one level of refinement, and levels, after which we give up.
MAX_EVALUATIONS = 2**25
MAX_LEVELS = 24

# Patches below this fraction of the mean, or that of the tolerated relative error, need
# no relative precision: single precision of ``eval`` would not give it, for instance
# where glass lights but a corner of a patch.
NEGLIGIBLE = 1e-6

# What single precision leaves of a direction, in radians: a step is not looked for in
# narrower cells.
MIN_CELL_WIDTH = 2.0**-21

# Points of the first rule of all directions that share kernels: more of them would
# save no time any more, and need memory.
MAX_SHARED_NODES = 2**21


@dataclass(frozen=True, eq=False)
class Rule:
    """Directions and weights whose sums are patch integrals.

    Attributes
    ----------
    subdivision : Subdivision
    patch : ndarray of int, shape (n,)
        Patch of each direction; ``n_patches`` more in the lower hemisphere.
    theta, phi : ndarray, shape (n,)
        Direction in radians, from the pole of its own hemisphere.
    lower : ndarray of bool, shape (n,)
    weight : ndarray, shape (n,)
        Area of the direction in ``(theta, phi)``.
    light : IncidentLight
        Of the one direction.
    """

    subdivision: Subdivision
    patch: Integers
    theta: Floats
    phi: Floats
    lower: Flags
    weight: Floats
    light: IncidentLight

    def __post_init__(self) -> None:
        self.subdivision.cells_about_pole()  # or ValueError: angles are about +z

    def values(self, bsdf: mi.BSDF) -> mi.TensorXf:
        """Patch means of BRDF and BTDF that follow the gradients of the BSDF.

        Returns
        -------
        mi.TensorXf, shape (2, n_theta, n_phi, channels)
            In 1/sr, in single precision.
        """
        values = self.light.evaluate(bsdf, self.theta, self.phi, self.lower)
        n = 2 * self.subdivision.n_patches
        solid = np.tile(self.subdivision.projected_solid_angles.ravel(), 2)
        weight = mi.Float(self.weight * np.sin(self.theta) / solid[self.patch])
        patch = mi.UInt32(self.patch)
        channels = len(values)
        sums = dr.zeros(mi.Float, n * channels)
        for number, value in enumerate(values):
            dr.scatter_add(sums, value * weight, patch * channels + number)
        return mi.TensorXf(sums, (2, *self.subdivision.shape, channels))


@dataclass(frozen=True, eq=False)
class PatchIntegrals:
    """Flux fractions that a BSDF sends into each patch, without delta components.

    Attributes
    ----------
    subdivision : Subdivision
    flux : ndarray of float64, shape (n_hemispheres, n_theta, n_phi, channels)
    error : ndarray, same shape
        Estimated absolute error of `flux`: the differences of all cells added up, as if
        none cancelled, from coarser cells and from a rule of other points, and what
        single precision leaves of values and directions.
    n_evaluations : int
    together : sequence of (Cells, ndarray of bool)
        Cells of each level, of all directions that shared kernels, and which of them
        have converged. This direction has the `number`.
    rule : Rule
        The converged rule, to integrate a similar BSDF, or to differentiate it.
    """

    subdivision: Subdivision
    flux: Floats
    error: Floats
    n_evaluations: int
    together: Sequence[tuple[Cells, Flags]]
    number: int
    light: IncidentLight

    @property
    def values(self) -> Floats:
        """Patch means of BRDF and BTDF in 1/sr, shaped like `flux`."""
        return self.flux / self.subdivision.projected_solid_angles[..., None]

    @cached_property
    def cells(self) -> Cells:
        """The converged cells of this direction."""
        n_patches = len(self.flux) * self.subdivision.n_patches
        levels = (level[converged] for level, converged in self.together)
        return Cells.join(one.of_direction(self.number, n_patches) for one in levels)

    @cached_property
    def rule(self) -> Rule:
        """The converged :class:`Rule`."""
        theta, phi, lower, weight = self.cells.nodes()
        patch = np.repeat(self.cells.patch, NODES_PER_CELL)
        return Rule(self.subdivision, patch, theta, phi, lower, weight, self.light)

    def slopes(self, bsdf: mi.BSDF, derivative: Derivative) -> tuple[Floats, Floats]:
        """Derivatives of the flux by the parameter that is attached, on the same cells.

        Returns
        -------
        slopes, errors : ndarray, shaped like `flux`
            The errors are the differences from cells cut in four, added up as if none
            cancelled.
        """
        axes = self.subdivision.axes
        evaluator = SlopeEvaluator(bsdf, derivative, self.light, axes)
        cells, shape = self.cells, self.flux.shape
        coarse, _ = evaluator.integrals(cells)
        fine, _ = evaluator.integrals(cells.split(np.full(len(coarse), QUARTERS)))
        fine = fine.reshape(len(coarse), 4, -1).sum(axis=1)
        wrong = np.abs(fine - coarse) + INTEGRAL_ROUNDING * np.abs(fine)
        slopes, errors = np.zeros((2, *shape))
        for number in range(shape[-1]):
            for array, of_cells in ((slopes, fine), (errors, wrong)):
                flat = np.bincount(
                    cells.patch, of_cells[:, number], slopes[..., 0].size
                )
                array[..., number] = flat.reshape(shape[:-1])
        if axes is not None:  # the last patch as of `flux`
            slopes[:, -1] -= slopes[:, :-1].sum(axis=1)
            errors[:, -1] += errors[:, :-1].sum(axis=1)
        return slopes, errors


def integrate(
    bsdf: mi.BSDF,
    theta_i: float,
    phi_i: float,
    subdivision: Subdivision,
    *,
    integral_err: float = 1e-6,
    side: str = "front",
    interaction: mi.SurfaceInteraction3f | None = None,
) -> PatchIntegrals:
    """Integrate ``eval`` of a BSDF over every patch of both hemispheres.

    Adaptive tensor Gauss-Legendre rule in polar angle and azimuth: cells whose value
    differs from the sum of their quarters are split, down to the lobe's scale, or to
    where the single precision of ``eval`` shows. Steps of ``eval`` no node sees are
    looked for next to the edges and in the middle of each cell, and a Gauss-Lobatto
    rule over the whole cell, of other points and on its edges, has to confirm the
    quarters; cells with a step along one angle are split across it, and count as wrong
    by the step.

    Parameters
    ----------
    bsdf : mi.BSDF
        Its delta components are not seen by ``eval``.
    theta_i, phi_i : float
        Incident direction in degrees, `theta_i` from the normal of the lit face.
    subdivision : Subdivision
    integral_err : float
        Tolerated error of each patch, relative to the patch, or, where that is more,
        to the same part of the mean over all patches, at least a millionth of it.
        Single precision of ``eval`` limits it to about 1e-6 for smooth BSDFs, and more
        for sharp lobes.
    side : {"front", "back"}
    interaction : mi.SurfaceInteraction3f, optional
        Point and frame of the surface. Default: the middle of a square with its normal
        along +z.

    Returns
    -------
    PatchIntegrals

    Raises
    ------
    SpecimenError
        If it does not converge, or a value is negative or not finite.
    """
    (found,) = integrate_each(
        bsdf,
        [(theta_i, phi_i)],
        subdivision,
        integral_err=integral_err,
        side=side,
        interaction=interaction,
    )
    return found


def integrate_each(
    bsdf: mi.BSDF,
    incidents: Sequence[tuple[float, float]],
    subdivision: Subdivision,
    *,
    integral_err: float = 1e-6,
    side: str = "front",
    interaction: mi.SurfaceInteraction3f | None = None,
    n_hemispheres: int = 2,
) -> list[PatchIntegrals]:
    """Integrate like :func:`integrate` for each of several incident directions.

    Their cells share kernels, in which each has the bits that it has alone.

    Parameters
    ----------
    incidents : sequence of (float, float)
        ``(theta_i, phi_i)`` in degrees.
    n_hemispheres : int
        1 for the hemisphere of the light only.
    **others
        As of :func:`integrate`.

    Returns
    -------
    list of PatchIntegrals
    """
    each = NODES_PER_CELL * 4 * n_hemispheres * subdivision.n_patches
    several = max(1, MAX_SHARED_NODES // each)
    found: list[PatchIntegrals] = []
    for first in range(0, len(incidents), several):
        some = incidents[first : first + several]
        lights = [IncidentLight.of([one], side, interaction) for one in some]
        together = IncidentLight.of(some, side, interaction)
        evaluator = Evaluator(bsdf, together, subdivision.axes)
        cells = Cells.of(subdivision, n_hemispheres, len(some))
        found += _integrated(evaluator, cells, subdivision, integral_err, lights)
    if subdivision.axes is not None:
        for one in found:
            # the last patch, a hemisphere, is left what the cones before do not hold
            held = one.flux[:, :-1].sum(axis=1)
            one.flux[:, -1] = np.maximum(one.flux[:, -1] - held, 0)
            one.error[:, -1] += one.error[:, :-1].sum(axis=1)
    return found


def _integrated(
    evaluator: Evaluator,
    cells: Cells,
    subdivision: Subdivision,
    integral_err: float,
    lights: Sequence[IncidentLight],
) -> list[PatchIntegrals]:
    """Integrals over the patches that begin as `cells`, for each of the lights."""
    guides = evaluator.guides(cells, subdivision)
    coarse, values_at = evaluator.integrals(cells)
    way = way_to_split(values_at)
    sums = _PatchSums(cells, len(lights), coarse.shape[-1], subdivision)
    finished: list[tuple[Cells, Flags]] = []
    for level in range(MAX_LEVELS):
        held = np.bincount(guides.cell, minlength=len(cells.patch))
        full = held > MAX_GUIDES
        way[full] = QUARTERS
        parts = cells.split(way)
        fine, of_parts = evaluator.integrals(parts)
        values_at = of_parts.reshape(len(cells.patch), 4 * NODES_PER_CELL, -1)
        values = fine.reshape(len(cells.patch), 4, -1).sum(axis=1)
        allowed = sums.allowed(cells, values, integral_err)
        tolerance = CELL_TOLERANCE * allowed[cells.patch]
        tolerance *= cells.tolerated(way)[:, None]
        difference = np.abs(values - coarse)
        smooth = way == QUARTERS
        # what a step anywhere in one of four parts can change
        swing = np.ptp(values_at[~smooth].astype(float), axis=1)
        difference[~smooth] = swing * cells.area[~smooth, None] / 4
        # what the points of smooth cells cannot see
        difference[smooth] += evaluator.hidden(cells[smooth], values_at[smooth])
        settled = smooth & np.all(difference <= tolerance, axis=1)
        difference[settled] += evaluator.unconfirmed(cells[settled], values[settled])
        open_cells = full | ~np.all(difference <= tolerance, axis=1)
        sharp = cells.narrow(way, MIN_CELL_WIDTH)
        open_cells &= ~sharp
        n_next = np.bincount(cells.direction[open_cells], minlength=len(lights))
        too_many = 4 * NODES_PER_CELL * 4 * n_next > MAX_EVALUATIONS
        open_cells &= ~(too_many | (level == MAX_LEVELS - 1))[cells.direction]
        children = np.repeat(open_cells, 4)
        done = ~open_cells
        # others count as wrong by all of their step
        shift = evaluator.light.rounding[cells.direction[done]] * smooth[done]
        moved = shift[:, None] * _moved(cells[done], values[done], values_at[done])
        sums.add(cells.patch[done], values[done], difference[done], moved, ~sharp[done])
        finished.append((parts, ~children))
        if not open_cells.any():
            break
        guides = guides.descend(cells, open_cells, way, full)
        cells, coarse = parts[children], fine[children]
        way = way_to_split(of_parts[children])
    _check_converged(evaluator, np.sqrt(sums.square), allowed, integral_err)
    shape = (len(lights), -1, *subdivision.shape, coarse.shape[-1])
    flux = sums.flux.reshape(shape)
    error = (sums.error + INTEGRAL_ROUNDING * sums.flux).reshape(shape)
    counts = evaluator.n_evaluations.tolist()
    return [
        PatchIntegrals(subdivision, flux[n], error[n], counts[n], finished, n, light)
        for n, light in enumerate(lights)
    ]


def _check_converged(
    evaluator: Evaluator, error: Floats, allowed: Floats, integral_err: float
) -> None:
    """Raise SpecimenError for the first direction of which a patch is too wrong."""
    n = len(evaluator.n_evaluations)
    each = zip(error.reshape(n, -1), allowed.reshape(n, -1), evaluator.n_evaluations)
    for wrong, right, n_evaluations in each:
        if not np.all(wrong <= right):
            # where nothing is allowed and nothing wrong, none
            ratio = np.where(wrong > 0, np.inf, 0)
            np.divide(wrong, right, where=right > 0, out=ratio)
            raise SpecimenError(
                f"the integral of {evaluator.bsdf.class_name()} over the patches must "
                f"converge to {integral_err:g}, but {n_evaluations:.3g} evaluations "
                f"gave {ratio.max() * integral_err:.2g} for the worst patch"
            )


def _moved(cells: Cells, values: Floats, values_at: Singles) -> Floats:
    """What a lobe that moves brings into quartered cells, for each radian.

    It moves with an incident direction that is rounded; the rounding of the points'
    directions evens out, and what changes with the cosine of the polar angle stays.
    """
    n, channels = values.shape
    side = NODES_PER_CELL // 4
    # half, half, node, node: of polar angle and azimuth
    at = values_at.reshape(n, 2, 2, side, side, channels)
    theta, phi = (
        (at.max(axis=along) - at.min(axis=along)).mean(axis=(1, 2), dtype=float)
        for along in ((1, 3), (2, 4))
    )
    middle = cells.theta.mean(axis=1, keepdims=True)
    change = -np.diff(np.cos(cells.theta)) / np.cos(middle)
    theta -= change * values / cells.area[:, None]
    # lengths along polar angle and azimuth, in radians, about
    across, along = np.diff(cells.theta), np.diff(cells.phi) * np.sin(middle)
    return np.maximum(theta, 0) * along + phi * across


class _PatchSums:
    """Sums over the finished cells of each patch.

    Of all incident directions, one after the other.

    Arrays of shape ``(n_patches, channels)``: the integral, its error as if nothing
    cancelled, and the sum of the squares of the cells' errors.
    """

    def __init__(
        self, cells: Cells, n_directions: int, channels: int, subdivision: Subdivision
    ) -> None:
        n = len(cells.patch)
        self.flux, self.error, self.square = np.zeros((3, n, channels))
        self.n_directions = n_directions
        each = np.arange(n // n_directions) % subdivision.n_patches
        self.detectors = np.flatnonzero(each < subdivision.n_detectors)
        self.lit = 1.0 if cells.lower.any() else 0.5  # part of both hemispheres

    def allowed(self, cells: Cells, values: Floats, integral_err: float) -> Floats:
        """Tolerated error of each patch, if the open `cells` have these `values`."""
        estimate = self.flux + self._by_patch(cells.patch, values)
        of_each = estimate.reshape(self.n_directions, -1, estimate.shape[-1])
        # over both hemispheres, also where one is known to be dark
        mean = of_each.take(self.detectors, 1).mean(axis=(1, 2), keepdims=True)
        mean *= self.lit
        least = max(NEGLIGIBLE, integral_err) * mean
        return integral_err * np.maximum(of_each, least).reshape(estimate.shape)

    def add(
        self,
        patch: Integers,
        values: Floats,
        difference: Floats,
        moved: Floats,
        counted: Flags,
    ) -> None:
        """Add the integrals over finished cells, and what they may be wrong by.

        Of that no convergence is asked where single precision ends, which is not
        `counted`, nor of what rounded directions have `moved`.
        """
        self.flux += self._by_patch(patch, values)
        self.error += self._by_patch(patch, difference + moved)
        self.square += self._by_patch(patch, counted[:, None] * difference**2)

    def _by_patch(self, patch: Integers, values: Numbers) -> Numbers:
        """Sum of the cells' values in each patch."""
        columns = [np.bincount(patch, x, minlength=len(self.flux)) for x in values.T]
        return np.stack(columns, axis=-1)

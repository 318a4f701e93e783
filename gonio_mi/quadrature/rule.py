"""Converged patch integrals of a flat specimen's BSDF: no rays, no random numbers."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Flags, Floats, Integers, Numbers
from ..collector import Subdivision
from ..collector.directions import angles, direction
from ..errors import SpecimenError
from ..transport.loop import flux_context
from .cells import (
    BLIND,
    NODES_PER_CELL,
    QUARTERS,
    Cells,
    Guides,
    noise,
    off_polynomial,
    way_to_split,
)

__all__ = ["PatchIntegrals", "Rule", "integrate"]

# Sampled directions that show where narrow lobes are, and how many of them a cell may
# hold before it is split unseen.
N_GUIDES = 2**14
MOST_GUIDES = 8

# Part of the tolerated error that the cells of a patch share, since later levels may
# find the patch darker.
CAUTION = 1 / 4

# Evaluations of one level of refinement, and levels, after which we give up.
MAX_EVALUATIONS = 2**25
MAX_LEVELS = 24

# Patches below this fraction of the mean need no relative precision.
NEGLIGIBLE = 1e-6

# What single precision leaves of an integral's digits, at best; and of a direction, in
# radians: a step is not looked for in narrower cells.
INTEGRAL_ROUNDING = 2.0**-22
NARROWEST = 2.0**-21

# Times the noise of the values, by which they may be off the polynomial through them.
UNSURE = 256


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
    beam : _Beam
    """

    subdivision: Subdivision
    patch: Integers
    theta: Floats
    phi: Floats
    lower: Flags
    weight: Floats
    beam: _Beam

    def values(self, bsdf: mi.BSDF) -> mi.TensorXf:
        """Patch means of BRDF and BTDF that follow the gradients of the BSDF.

        Returns
        -------
        mi.TensorXf, shape (2, n_theta, n_phi, channels)
            In 1/sr, in single precision.
        """
        values = self.beam.evaluate(bsdf, self.theta, self.phi, self.lower)
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
        none cancelled, from coarser cells and from a rule of other points.
    n_evaluations : int
    rule : Rule
        The converged rule, to integrate a similar BSDF, or to differentiate it.
    """

    subdivision: Subdivision
    flux: Floats
    error: Floats
    n_evaluations: int
    cells: Cells
    beam: _Beam

    @property
    def values(self) -> Floats:
        """Patch means of BRDF and BTDF in 1/sr, shaped like `flux`."""
        return self.flux / self.subdivision.projected_solid_angles[..., None]

    @cached_property
    def rule(self) -> Rule:
        """The converged :class:`Rule`."""
        theta, phi, lower, weight = self.cells.nodes()
        patch = np.repeat(self.cells.patch, NODES_PER_CELL)
        return Rule(self.subdivision, patch, theta, phi, lower, weight, self.beam)


def integrate(
    bsdf: mi.BSDF,
    theta_i: float,
    phi_i: float,
    subdivision: Subdivision,
    *,
    rel_err: float = 1e-6,
    side: str = "front",
    pdf: bool = False,
    interaction: mi.SurfaceInteraction3f | None = None,
) -> PatchIntegrals:
    """Integrate ``eval`` (or ``pdf``) of a BSDF over every patch of both hemispheres.

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
    rel_err : float
        Tolerated error of each patch, relative to the patch, or to a millionth of the
        mean over all patches where that is more. Single precision of ``eval`` limits
        it to about 1e-6 for smooth BSDFs, and more for sharp lobes.
    side : {"front", "back"}
    pdf : bool
        Integrate the sampling density over solid angle instead.
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
    beam = _Beam.of(theta_i, phi_i, side, interaction)
    evaluator = _Evaluator(bsdf, beam, pdf)
    cells = Cells.of(subdivision)
    guides = evaluator.guides(cells, subdivision)
    coarse, way, _ = evaluator.integrals(cells)
    sums, finished = _PatchSums(2 * subdivision.n_patches, coarse.shape[-1]), []
    for level in range(MAX_LEVELS):
        full = guides.held(len(cells.patch)) > MOST_GUIDES
        way[full] = QUARTERS
        parts = cells.split(way)
        fine, ways, values_at = evaluator.integrals(parts)
        values_at = values_at.reshape(len(cells.patch), 4 * NODES_PER_CELL, -1)
        values = fine.reshape(len(cells.patch), 4, -1).sum(axis=1)
        allowed = sums.allowed(cells, values, rel_err)
        tolerance = CAUTION * allowed[cells.patch] * cells.tolerated(way)[:, None]
        difference = np.abs(values - coarse)
        smooth = way == QUARTERS
        difference[~smooth] = _swing(values_at, cells, ~smooth)
        _add_unseen(difference, tolerance, evaluator, cells, values, values_at, smooth)
        open_cells = full | ~np.all(difference <= tolerance, axis=1)
        sharp = cells.narrow(way, NARROWEST)
        open_cells &= ~sharp
        n_next = 4 * NODES_PER_CELL * 4 * np.count_nonzero(open_cells)
        if level == MAX_LEVELS - 1 or n_next > MAX_EVALUATIONS:
            open_cells[:] = False
        children = np.repeat(open_cells, 4)
        for chosen in (sharp, ~sharp & ~open_cells):
            sums.add(cells[chosen], values[chosen], difference[chosen], ~sharp[chosen])
        finished.append(parts[~children])
        if not open_cells.any():
            break
        guides = guides.descend(cells, open_cells, way)
        cells, coarse, way = parts[children], fine[children], ways[children]
    error = np.sqrt(sums.square)
    if not np.all(error <= allowed):
        raise SpecimenError(
            f"the integral of {bsdf.class_name()} over the patches must converge to "
            f"{rel_err:g}, but {evaluator.n_evaluations:.3g} evaluations gave "
            f"{_worst(error, allowed) * rel_err:.2g} for the worst patch"
        )
    shape = (2, *subdivision.shape, -1)
    return PatchIntegrals(
        subdivision,
        sums.flux.reshape(shape),
        np.hypot(sums.error, INTEGRAL_ROUNDING * sums.flux).reshape(shape),
        evaluator.n_evaluations,
        Cells.join(finished),
        beam,
    )


def _add_unseen(
    difference: Floats,
    tolerance: Floats,
    evaluator: _Evaluator,
    cells: Cells,
    values: Floats,
    values_at: Floats,
    smooth: Flags,
) -> None:
    """Add to the differences of smooth cells what their own points cannot see."""
    difference[smooth] += evaluator.hidden(cells[smooth], values_at[smooth])
    settled = np.all(difference <= tolerance, axis=1) & smooth
    difference[settled] += evaluator.unconfirmed(cells[settled], values[settled])


def _swing(values_at: Floats, cells: Cells, chosen: Flags) -> Floats:
    """What a step anywhere in the chosen cells, in one of four parts, can change."""
    values = values_at[chosen]
    swing = values.max(axis=1) - values.min(axis=1)
    return swing * cells.area[chosen, None] / 4


class _PatchSums:
    """Sums over the finished cells of each patch.

    Arrays of shape ``(n_patches, channels)``: the integral, its error as if nothing
    cancelled, and the sum of the squares of the cells' errors.
    """

    def __init__(self, n_patches: int, channels: int) -> None:
        self.flux, self.error, self.square = np.zeros((3, n_patches, channels))

    def allowed(self, cells: Cells, values: Floats, rel_err: float) -> Floats:
        """Tolerated error of each patch, if the open `cells` have these `values`."""
        estimate = self.flux + self._by_patch(cells, values)
        return rel_err * np.maximum(estimate, NEGLIGIBLE * estimate.mean())

    def add(
        self, cells: Cells, values: Floats, difference: Floats, counted: Flags
    ) -> None:
        """Add the integrals over finished cells, and what they may be wrong by.

        Where single precision ends, no convergence is asked: it is not `counted`.
        """
        self.flux += self._by_patch(cells, values)
        self.error += self._by_patch(cells, difference)
        self.square += self._by_patch(cells, counted[:, None] * difference**2)

    def _by_patch(self, cells: Cells, values: Numbers) -> Numbers:
        """Sum of the cells' values in each patch."""
        n = len(self.flux)
        columns = [np.bincount(cells.patch, one, minlength=n) for one in values.T]
        return np.stack(columns, axis=-1)


@dataclass(frozen=True)
class _Beam:
    """Light from one direction at one point of a surface."""

    interaction: mi.SurfaceInteraction3f
    side: int

    @classmethod
    def of(
        cls,
        theta_i: float,
        phi_i: float,
        side: str,
        interaction: mi.SurfaceInteraction3f | None,
    ) -> _Beam:
        """Beam of an incident direction in degrees, from the normal of the lit face."""
        sign = 1 if side == "front" else -1
        towards = direction(np.radians(theta_i), np.radians(phi_i)) * [1, 1, sign]
        wi = mi.Vector3f(towards.tolist())
        dr.make_opaque(wi)
        si = _square() if interaction is None else mi.SurfaceInteraction3f(interaction)
        si.wi = si.to_local(wi)
        return cls(si, sign)

    def evaluate(
        self, bsdf: mi.BSDF, theta: Floats, phi: Floats, lower: Flags, pdf: bool = False
    ) -> list[mi.Float]:
        """``eval`` of all channels, or ``pdf``, towards `theta` and `phi`."""
        wo = self.towards(theta, phi, lower)
        function = bsdf.pdf if pdf else bsdf.eval
        value = function(flux_context(), self.interaction, wo)
        return [value] if pdf else list(value)

    def towards(self, theta: Floats, phi: Floats, lower: Flags) -> mi.Vector3f:
        """Directions `theta` and `phi` in the frame of the surface."""
        wo = direction(theta, phi)
        wo[:, 2] *= np.where(lower, -self.side, self.side)
        return self.interaction.to_local(mi.Vector3f(np.ascontiguousarray(wo.T)))


def _square() -> mi.SurfaceInteraction3f:
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


class _Evaluator:
    """Evaluates the BSDF for light from one direction."""

    def __init__(self, bsdf: mi.BSDF, beam: _Beam, pdf: bool) -> None:
        self.bsdf = bsdf
        self.beam = beam
        self.pdf = pdf
        self.n_evaluations = 0

    def guides(self, cells: Cells, subdivision: Subdivision) -> Guides:
        """Sampled directions, without those of delta components."""
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(0, N_GUIDES)
        si = self.beam.interaction
        bs, weight = self.bsdf.sample(
            flux_context(), si, sampler.next_1d(), sampler.next_2d()
        )
        delta = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
        wanted = np.broadcast_to((~delta & dr.any(weight > 0)).numpy(), N_GUIDES)
        wo = np.broadcast_to(si.to_world(bs.wo).numpy(), (3, N_GUIDES)).T[wanted]
        wo = wo * [1, 1, self.beam.side]
        patch = subdivision.patch(wo) + subdivision.n_patches * (wo[:, 2] < 0)
        theta, phi = angles(wo)
        # a cell may begin below the azimuth 0
        phi[(cells.phi[patch, 0] < 0) & (phi > np.pi)] -= 2 * np.pi
        return Guides(patch, np.minimum(theta, np.pi - theta), phi)

    def integrals(self, cells: Cells) -> tuple[Floats, Integers, Floats]:
        """Integrals over cells, how to split each, and the values that say so.

        Returns
        -------
        integrals : ndarray, shape (n, channels)
        way : ndarray of int, shape (n,)
        values : ndarray, shape (n, NODES_PER_CELL, channels)
        """
        integrals, values = self._rule(cells, cells.nodes())
        return integrals, way_to_split(values), values

    def unconfirmed(self, cells: Cells, integrals: Floats) -> Floats:
        """How far a rule of other points is from the `integrals` over cells."""
        if not len(integrals):
            return integrals
        return np.abs(self._rule(cells, cells.other_nodes())[0] - integrals)

    def _rule(self, cells: Cells, nodes: Any) -> tuple[Floats, Floats]:
        """Integrals over cells by a rule of `nodes`, as many in each, and values."""
        theta, phi, lower, weight = nodes
        values = self._values(theta, phi, lower)
        weight = weight * np.sin(theta)
        shape = len(cells.patch), -1, values.shape[-1]
        integrals = (values * weight[:, None]).reshape(shape).sum(axis=1)
        return integrals, values.reshape(shape)

    def hidden(self, cells: Cells, values: Floats) -> Floats:
        """What a step between the nodes of the quarters of each cell can change.

        There, BSDF and the polynomial through its `values` differ.
        """
        if not len(values):
            return values[:, 0]
        found = self._values(*cells.probes()).reshape(len(values), -1, values.shape[-1])
        off = off_polynomial(found, values) - UNSURE * noise(values)
        return BLIND * np.maximum(off, 0) * cells.area[:, None]

    def _values(self, theta: Floats, phi: Floats, lower: Flags) -> Floats:
        """Values towards directions, shape ``(n, channels)``."""
        self.n_evaluations += len(theta)
        evaluated = self.beam.evaluate(self.bsdf, theta, phi, lower, self.pdf)
        columns = [np.broadcast_to(value.numpy(), len(theta)) for value in evaluated]
        values = np.stack(columns, axis=-1).astype(float)
        least = -INTEGRAL_ROUNDING * values.max(initial=0)
        if not (values.min(initial=0) >= least and np.isfinite(least)):
            wrong = ~np.all((values >= least) & np.isfinite(values), axis=1)
            first = np.argmax(wrong)
            raise SpecimenError(
                f"{'pdf' if self.pdf else 'eval'} of {self.bsdf.class_name()} must be "
                f"finite and not negative, got {values[first].min():.3g} towards theta "
                f"{np.degrees(theta[first]):.3f}, phi {np.degrees(phi[first]):.3f} "
                f"degrees{' in transmission' if lower[first] else ''}"
            )
        return values


def _worst(error: Floats, allowed: Floats) -> float:
    """The largest ratio; where nothing is allowed and nothing wrong, none."""
    ratio = np.where(error > 0, np.inf, 0)
    return np.max(np.divide(error, allowed, where=allowed > 0, out=ratio))

"""Converged patch integrals of a flat specimen's BSDF: no rays, no random numbers."""

from dataclasses import dataclass
from functools import cached_property

import drjit as dr
import mitsuba as mi
import numpy as np

from .cells import NODES_PER_CELL, Cells, Guides
from .directions import angles, direction
from .errors import SpecimenError
from .plugins.transport import flux_context
from .subdivision import Subdivision

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
FLOOR = 1e-6

# What single precision leaves of an integral's digits, at best.
ROUNDING = 2.0**-22


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
    patch: np.ndarray
    theta: np.ndarray
    phi: np.ndarray
    lower: np.ndarray
    weight: np.ndarray
    beam: object

    def values(self, bsdf):
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
        none cancelled. A BSDF with kinks (tables inside) may be off by twice as much.
    n_evaluations : int
    rule : Rule
        The converged rule, to integrate a similar BSDF, or to differentiate it.
    """

    subdivision: Subdivision
    flux: np.ndarray
    error: np.ndarray
    n_evaluations: int
    cells: object
    beam: object

    @property
    def values(self):
        """Patch means of BRDF and BTDF in 1/sr, shaped like `flux`."""
        return self.flux / self.subdivision.projected_solid_angles[..., None]

    @cached_property
    def rule(self):
        """The converged :class:`Rule`."""
        theta, phi, lower, weight = self.cells.nodes()
        patch = np.repeat(self.cells.patch, NODES_PER_CELL)
        return Rule(self.subdivision, patch, theta, phi, lower, weight, self.beam)


def integrate(
    bsdf,
    theta_i,
    phi_i,
    subdivision,
    *,
    rel_err=1e-6,
    side="front",
    pdf=False,
    interaction=None,
):
    """Integrate ``eval`` (or ``pdf``) of a BSDF over every patch of both hemispheres.

    Adaptive tensor Gauss-Legendre rule in polar angle and azimuth: cells whose value
    differs from the sum of their quarters are split, down to the lobe's scale, or to
    where the single precision of ``eval`` shows.

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
        If it does not converge, or is not finite.
    """
    beam = _Beam.of(theta_i, phi_i, side, interaction)
    evaluator = _Evaluator(bsdf, beam, pdf)
    cells = Cells.of(subdivision)
    guides = evaluator.guides(subdivision)
    coarse = evaluator.integrals(cells)
    sums, finished = _PatchSums(2 * subdivision.n_patches, coarse.shape[-1]), []
    for level in range(MAX_LEVELS):
        quarters = cells.quarters()
        fine = evaluator.integrals(quarters)
        values = fine.reshape(len(cells.patch), 4, -1).sum(axis=1)
        difference = np.abs(values - coarse)
        allowed = sums.allowed(cells, values, rel_err)
        open_cells = _unfinished(cells, guides, difference, allowed)
        n_next = 4 * NODES_PER_CELL * 4 * np.count_nonzero(open_cells)
        if level == MAX_LEVELS - 1 or n_next > MAX_EVALUATIONS:
            open_cells[:] = False
        children = np.repeat(open_cells, 4)
        sums.add(cells[~open_cells], values[~open_cells], difference[~open_cells])
        finished.append(quarters[~children])
        if not open_cells.any():
            break
        guides = guides.descend(cells, open_cells)
        cells, coarse = quarters[children], fine[children]
    error = np.sqrt(sums.square)
    if not np.all(error <= allowed):
        raise SpecimenError(
            f"the integral of {bsdf.class_name()} over the patches must converge to "
            f"{rel_err:g}, but {evaluator.n_evaluations:.3g} evaluations gave "
            f"{np.max(error / allowed) * rel_err:.2g} for the worst patch"
        )
    shape = (2, *subdivision.shape, -1)
    return PatchIntegrals(
        subdivision,
        sums.flux.reshape(shape),
        np.hypot(sums.error, ROUNDING * sums.flux).reshape(shape),
        evaluator.n_evaluations,
        Cells.join(finished),
        beam,
    )


def _unfinished(cells, guides, difference, allowed):
    """Whether each cell must be quartered: its own part of the error is too large.

    That of a patch is shared by its cells by area: the squares of their errors add up.
    Or the cell holds so many sampled directions that its points may miss a lobe.
    """
    tolerance = CAUTION * allowed[cells.patch] * cells.share[:, None] ** 0.5
    held = np.bincount(guides.cell, minlength=len(cells.patch))
    return ~np.all(difference <= tolerance, axis=1) | (held > MOST_GUIDES)


class _PatchSums:
    """Sums over the finished cells of each patch.

    Arrays of shape ``(n_patches, channels)``: the integral, its error as if nothing
    cancelled, and the sum of the squares of the cells' errors.
    """

    def __init__(self, n_patches, channels):
        self.flux, self.error, self.square = np.zeros((3, n_patches, channels))

    def allowed(self, cells, values, rel_err):
        """Tolerated error of each patch, if the open `cells` have these `values`."""
        estimate = self.flux + self._by_patch(cells, values)
        return rel_err * np.maximum(estimate, FLOOR * estimate.mean())

    def add(self, cells, values, difference):
        """Add the integrals over finished cells, and what they may be wrong by."""
        self.flux += self._by_patch(cells, values)
        self.error += self._by_patch(cells, difference)
        self.square += self._by_patch(cells, difference**2)

    def _by_patch(self, cells, values):
        """Sum of the cells' values in each patch."""
        n = len(self.flux)
        columns = [np.bincount(cells.patch, one, minlength=n) for one in values.T]
        return np.stack(columns, axis=-1)


@dataclass(frozen=True)
class _Beam:
    """Light from one direction at one point of a surface."""

    interaction: object
    side: int

    @classmethod
    def of(cls, theta_i, phi_i, side, interaction):
        """Beam of an incident direction in degrees, from the normal of the lit face."""
        side = 1 if side == "front" else -1
        wi = direction(np.radians(theta_i), np.radians(phi_i)) * [1, 1, side]
        wi = mi.Vector3f(wi.tolist())
        dr.make_opaque(wi)
        si = _square() if interaction is None else mi.SurfaceInteraction3f(interaction)
        si.wi = si.to_local(wi)
        return cls(si, side)

    def evaluate(self, bsdf, theta, phi, lower, pdf=False):
        """``eval`` of all channels, or ``pdf``, towards `theta` and `phi`."""
        wo = direction(theta, phi)
        wo[:, 2] *= np.where(lower, -self.side, self.side)
        wo = self.interaction.to_local(mi.Vector3f(np.ascontiguousarray(wo.T)))
        function = bsdf.pdf if pdf else bsdf.eval
        value = function(flux_context(), self.interaction, wo)
        return [value] if pdf else list(value)


def _square():
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

    def __init__(self, bsdf, beam, pdf):
        self.bsdf = bsdf
        self.beam = beam
        self.pdf = pdf
        self.n_evaluations = 0

    def guides(self, grid):
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
        patch = grid.patch(wo) + grid.n_patches * (wo[:, 2] < 0)
        theta, phi = angles(wo)
        return Guides(patch, np.minimum(theta, np.pi - theta), phi)

    def integrals(self, cells):
        """Integral over each cell, shape ``(n, channels)``."""
        theta, phi, lower, weight = cells.nodes()
        self.n_evaluations += len(theta)
        values = self.beam.evaluate(self.bsdf, theta, phi, lower, self.pdf)
        weight = weight * np.sin(theta)
        columns = [np.broadcast_to(v.numpy(), len(theta)) * weight for v in values]
        shape = len(cells.patch), NODES_PER_CELL, -1
        return np.stack(columns, axis=-1).reshape(shape).sum(axis=1)

"""Converged patch integrals of a flat specimen's BSDF: no rays, no random numbers."""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from .directions import angles, direction
from .errors import SpecimenError
from .plugins.transport import flux_context
from .subdivision import Subdivision

__all__ = ["PatchIntegrals", "integrate"]

# Points per axis and cell; a cell is compared with the sum of its four quarters.
ORDER = 4
NODES, WEIGHTS = np.polynomial.legendre.leggauss(ORDER)

# Sampled directions that show where narrow lobes are, and how many of them a cell may
# hold before it is split unseen.
N_GUIDES = 2**14
MOST_GUIDES = 8

# Evaluations of one level of refinement, and levels, after which we give up.
MAX_EVALUATIONS = 2**25
MAX_LEVELS = 24


@dataclass(frozen=True, eq=False)
class PatchIntegrals:
    """Flux fractions that a BSDF sends into each patch, without delta components.

    Attributes
    ----------
    subdivision : Subdivision
    flux : ndarray of float64, shape (n_hemispheres, n_theta, n_phi, channels)
    error : ndarray, same shape
        Estimated absolute error of `flux`.
    n_evaluations : int
    """

    subdivision: Subdivision
    flux: np.ndarray
    error: np.ndarray
    n_evaluations: int

    @property
    def values(self):
        """Patch means of BRDF and BTDF in 1/sr, shaped like `flux`."""
        return self.flux / self.subdivision.projected_solid_angles[..., None]


def integrate(
    bsdf, theta_i, phi_i, subdivision, *, rel_err=1e-6, side="front", pdf=False
):
    """Integrate ``eval`` (or ``pdf``) of a BSDF over every patch of both hemispheres.

    Adaptive tensor Gauss-Legendre rule in polar angle and azimuth: cells whose value
    differs from the sum of their quarters are split, down to the lobe's scale.

    Parameters
    ----------
    bsdf : mi.BSDF
        Its delta components are not seen by ``eval``.
    theta_i, phi_i : float
        Incident direction in degrees, `theta_i` from the normal of the lit face.
    subdivision : Subdivision
    rel_err : float
        Tolerated error of each patch, relative to the patch, or to a millionth of the
        whole where that is more. Single precision of ``eval`` limits it to about 1e-6.
    side : {"front", "back"}
    pdf : bool
        Integrate the sampling density over solid angle instead.

    Returns
    -------
    PatchIntegrals

    Raises
    ------
    SpecimenError
        If it does not converge.
    """
    evaluator = _Evaluator(bsdf, theta_i, phi_i, side, pdf)
    shape = (2, *subdivision.shape)
    n_patches = 2 * subdivision.n_patches
    cells = _Cells.of(subdivision)
    guides = evaluator.guides(subdivision)
    coarse = evaluator.integrals(cells)
    flux = np.zeros((n_patches, coarse.shape[-1]))
    error = np.zeros_like(flux)
    for _ in range(MAX_LEVELS):
        quarters = cells.quarters()
        if len(quarters.patch) * ORDER**2 > MAX_EVALUATIONS:
            break
        fine = evaluator.integrals(quarters)
        sums = fine.reshape(len(cells.patch), 4, -1).sum(axis=1)
        difference = np.abs(sums - coarse)
        estimate = flux + _add_up(cells.patch, sums, n_patches)
        # what a patch tolerates is shared by its cells, by area
        floor = 1e-6 * estimate.sum() / estimate.size
        tolerance = rel_err * np.maximum(estimate[cells.patch], floor)
        open_cells = np.any(
            difference > tolerance * cells.share[:, None] ** 0.5, axis=1
        )
        open_cells |= np.bincount(guides.cell, minlength=len(open_cells)) > MOST_GUIDES
        done = ~open_cells
        flux += _add_up(cells.patch[done], sums[done], n_patches)
        error += _add_up(cells.patch[done], difference[done], n_patches)
        if not open_cells.any():
            return PatchIntegrals(
                subdivision,
                flux.reshape(*shape, -1),
                error.reshape(*shape, -1),
                evaluator.n_evaluations,
            )
        children = np.repeat(open_cells, 4)
        guides = guides.descend(cells, open_cells)
        cells, coarse = quarters[children], fine[children]
    raise SpecimenError(
        f"the integral of {bsdf.class_name()} over the patches did not converge to "
        f"{rel_err:g} after {evaluator.n_evaluations:.3g} evaluations"
    )


@dataclass(frozen=True)
class _Cells:
    """Rectangles in ``(theta, phi)``, each a part of one patch."""

    patch: np.ndarray  # n_patches more for the lower hemisphere
    lower: np.ndarray  # whether in the lower hemisphere
    theta: np.ndarray  # borders in polar angle, shape (n, 2)
    phi: np.ndarray  # borders in azimuth, shape (n, 2)
    share: np.ndarray  # part of the patch's area

    @classmethod
    def of(cls, grid):
        """One cell per patch of both hemispheres."""
        theta = np.stack([grid.theta_edges[:-1], grid.theta_edges[1:]], axis=-1)
        phi = np.stack([grid.phi_edges[:-1], grid.phi_edges[1:]], axis=-1)
        n = grid.n_patches
        return cls(
            np.arange(2 * n),
            np.arange(2 * n) >= n,
            np.tile(np.repeat(theta, grid.n_phi, axis=0), (2, 1)),
            np.tile(phi, (2 * grid.n_theta, 1)),
            np.ones(2 * n),
        )

    def quarters(self):
        """Four cells for each one, in its place."""
        halves = [(i, j) for i in (0, 1) for j in (0, 1)]

        def split(borders, k):
            middle = borders.mean(axis=1)
            parts = [(borders[:, 0], middle), (middle, borders[:, 1])]
            return np.stack(
                [np.column_stack(parts[half[k]]) for half in halves], axis=1
            ).reshape(-1, 2)

        return _Cells(
            np.repeat(self.patch, 4),
            np.repeat(self.lower, 4),
            split(self.theta, 0),
            split(self.phi, 1),
            np.repeat(self.share / 4, 4),
        )

    def __getitem__(self, chosen):
        return _Cells(
            self.patch[chosen],
            self.lower[chosen],
            self.theta[chosen],
            self.phi[chosen],
            self.share[chosen],
        )


@dataclass(frozen=True)
class _Guides:
    """Directions that ``sample`` gave, and the cell that each is in."""

    cell: np.ndarray
    theta: np.ndarray
    phi: np.ndarray

    def descend(self, cells, chosen):
        """Guides of the chosen cells, in their quarters."""
        kept = chosen[self.cell]
        cell, theta, phi = self.cell[kept], self.theta[kept], self.phi[kept]
        beyond = theta >= cells.theta.mean(axis=1)[cell]
        onwards = phi >= cells.phi.mean(axis=1)[cell]
        rank = np.cumsum(chosen) - 1
        return _Guides(4 * rank[cell] + 2 * beyond + onwards, theta, phi)


class _Evaluator:
    """Evaluates the BSDF for light from one direction."""

    def __init__(self, bsdf, theta_i, phi_i, side, pdf):
        self.bsdf = bsdf
        self.pdf = pdf
        self.side = 1 if side == "front" else -1
        wi = direction(np.radians(theta_i), np.radians(phi_i)) * [1, 1, self.side]
        self.wi = mi.Vector3f(wi.tolist())
        dr.make_opaque(self.wi)
        self.n_evaluations = 0

    def guides(self, grid):
        """Sampled directions, without those of delta components."""
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(0, N_GUIDES)
        bs, weight = self.bsdf.sample(
            flux_context(), self._interaction(), sampler.next_1d(), sampler.next_2d()
        )
        delta = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
        wanted = np.broadcast_to((~delta & dr.any(weight > 0)).numpy(), N_GUIDES)
        wo = np.broadcast_to(bs.wo.numpy(), (3, N_GUIDES)).T[wanted]
        wo = wo * [1, 1, self.side]
        patch = grid.patch(wo) + grid.n_patches * (wo[:, 2] < 0)
        theta, phi = angles(wo)
        return _Guides(patch, np.minimum(theta, np.pi - theta), phi)

    def integrals(self, cells):
        """Integral over each cell, shape ``(n, channels)``."""
        half_theta = np.diff(cells.theta) / 2
        half_phi = np.diff(cells.phi) / 2
        theta = cells.theta.mean(axis=1, keepdims=True) + half_theta * NODES
        phi = cells.phi.mean(axis=1, keepdims=True) + half_phi * NODES
        theta, phi, lower = np.broadcast_arrays(
            theta[:, :, None], phi[:, None, :], cells.lower[:, None, None]
        )
        values = self._values(theta.ravel(), phi.ravel(), lower.ravel())
        values = values.reshape(*theta.shape, -1)
        weights = (half_theta * half_phi)[:, :, None] * WEIGHTS[:, None] * WEIGHTS
        return np.einsum("nij,nijc->nc", weights, values)

    def _interaction(self):
        """Point in the middle of a square specimen, lit from `wi`."""
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.t = 1.0
        si.uv = mi.Point2f(0.5)
        si.n = mi.Normal3f(0, 0, 1)
        si.sh_frame = mi.Frame3f(
            mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0), mi.Vector3f(0, 0, 1)
        )
        si.dp_du, si.dp_dv = mi.Vector3f(2, 0, 0), mi.Vector3f(0, 2, 0)
        si.wi = self.wi
        return si

    def _values(self, theta, phi, lower):
        """``eval`` or ``pdf`` per dtheta dphi, shape ``(n, channels)``."""
        self.n_evaluations += len(theta)
        wo = direction(theta, phi)
        wo[:, 2] *= np.where(lower, -self.side, self.side)
        wo = mi.Vector3f(np.ascontiguousarray(wo.T))
        si = self._interaction()
        if self.pdf:
            values = self.bsdf.pdf(flux_context(), si, wo).numpy()[None]
        else:
            values = self.bsdf.eval(flux_context(), si, wo).numpy()
        values = np.broadcast_to(
            np.asarray(values, dtype=float), (len(values), len(theta))
        )
        return (values * np.sin(theta)).T


def _add_up(index, values, n):
    """Sum of `values`, shape ``(m, channels)``, by `index` below `n`."""
    columns = [np.bincount(index, column, minlength=n) for column in values.T]
    return np.stack(columns, axis=-1)

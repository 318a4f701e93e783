"""Rectangles of polar angle and azimuth that are quartered, and a rule for each."""

from dataclasses import dataclass

import numpy as np

__all__ = ["NODES_PER_CELL", "Cells", "Guides"]

# Points per axis of the tensor Gauss-Legendre rule.
ORDER = 4
NODES, WEIGHTS = np.polynomial.legendre.leggauss(ORDER)

NODES_PER_CELL = ORDER**2


@dataclass(frozen=True)
class Cells:
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

        def _split(borders, k):
            middle = borders.mean(axis=1)
            parts = [(borders[:, 0], middle), (middle, borders[:, 1])]
            return np.stack(
                [np.column_stack(parts[half[k]]) for half in halves], axis=1
            ).reshape(-1, 2)

        return Cells(
            np.repeat(self.patch, 4),
            np.repeat(self.lower, 4),
            _split(self.theta, 0),
            _split(self.phi, 1),
            np.repeat(self.share / 4, 4),
        )

    def nodes(self):
        """Polar angle, azimuth, hemisphere and weight of the points of the rule."""
        half_theta, half_phi = (np.diff(b) / 2 for b in (self.theta, self.phi))
        theta = self.theta.mean(axis=1, keepdims=True) + half_theta * NODES
        phi = self.phi.mean(axis=1, keepdims=True) + half_phi * NODES
        weight = (half_theta * half_phi)[:, :, None] * WEIGHTS[:, None] * WEIGHTS
        arrays = np.broadcast_arrays(
            theta[:, :, None], phi[:, None, :], self.lower[:, None, None], weight
        )
        return [array.ravel() for array in arrays]

    @classmethod
    def join(cls, several):
        """All cells of `several`."""
        return cls(*map(np.concatenate, zip(*map(Cells._columns, several))))

    def _columns(self):
        return self.patch, self.lower, self.theta, self.phi, self.share

    def __getitem__(self, chosen):
        return Cells(*(column[chosen] for column in self._columns()))


@dataclass(frozen=True)
class Guides:
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
        return Guides(4 * rank[cell] + 2 * beyond + onwards, theta, phi)

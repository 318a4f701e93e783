"""Rectangles of polar angle and azimuth that are quartered, and a rule for each."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..array_types import Flags, Floats, Integers, Singles
from ..collector import Subdivision

# Points per axis of the tensor Gauss-Legendre rule.
ORDER = 4
NODES, WEIGHTS = np.polynomial.legendre.leggauss(ORDER)

NODES_PER_CELL = ORDER**2

# A rule of other points, for a whole cell, that confirms what its quarters gave: of
# Gauss and Lobatto (Abramowitz and Stegun 1964, 25.4.32), with points on the edges.
LOBATTO_ORDER = 8
_TOP = np.polynomial.Legendre.basis(LOBATTO_ORDER - 1)
LOBATTO_NODES = np.concatenate([[-1], _TOP.deriv().roots().real, [1]])
LOBATTO_WEIGHTS = 2 / (LOBATTO_ORDER * (LOBATTO_ORDER - 1) * _TOP(LOBATTO_NODES) ** 2)

# Ways to split a cell into four: halves of both sides, or fourths of one.
QUARTERS, ACROSS_THETA, ACROSS_PHI = range(3)

# What part of a cell each of the four takes, of its polar angles and its azimuths.
_HALVES, _FOURTHS = np.linspace(0, 1, 3), np.linspace(0, 1, 5)
_FOURTHS = np.stack([_FOURTHS[:-1], _FOURTHS[1:]], axis=-1)
_HALVES = np.stack([_HALVES[:-1], _HALVES[1:]], axis=-1)
_WHOLE = np.tile([0.0, 1.0], (4, 1))
PARTS = np.stack(
    [
        [np.repeat(_HALVES, 2, axis=0), np.tile(_HALVES, (2, 1))],
        [_FOURTHS, _WHOLE],
        [_WHOLE, _FOURTHS],
    ]
)

# Nodes of both halves of a side of [-1, 1]. Then points that are beyond the outermost,
# one near each corner, and between the innermost: a step there is hidden from nodes.
_HALF_NODES = np.concatenate([(NODES - 1) / 2, (NODES + 1) / 2])
_END = _HALF_NODES[-1]
PROBES = np.array([[-1, -_END], [-_END, 1], [1, _END], [_END, -1], [0, 0]])

# The part of a cell, along one side, that is beyond its outermost nodes.
BLIND = 1 + _HALF_NODES[0]

# How far inside its cell a probe is, in radians: single precision leaves a step that
# lies on an edge where it is.
INSIDE = 2.0**-21


@dataclass(frozen=True)
class Cells:
    """Rectangles in ``(theta, phi)``, each a part of one patch."""

    # n_patches more for the lower hemisphere; all that more for each direction before
    patch: Integers
    lower: Flags  # whether in the lower hemisphere
    direction: Integers  # number of the incident direction
    theta: Floats  # edges in polar angle, shape (n, 2)
    phi: Floats  # edges in azimuth, shape (n, 2)
    # part of the patch's polar angles and azimuths, shape (n, 2)
    share: Floats

    @classmethod
    def of(
        cls, subdivision: Subdivision, n_hemispheres: int = 2, n_directions: int = 1
    ) -> "Cells":
        """One cell per patch of the hemispheres, for each incident direction.

        Angles of patches that have poles of their own are about these.
        """
        n = subdivision.n_patches
        each = n_hemispheres * n
        cells = np.tile(subdivision.cells, (n_hemispheres * n_directions, 1))
        patch = np.arange(n_directions * each)
        return cls(
            patch,
            patch % each >= n,
            patch // each,
            cells[:, :2],
            cells[:, 2:],
            np.ones((len(patch), 2)),
        )

    @property
    def area(self) -> Floats:
        """Solid angle, about."""
        theta = self.theta.mean(axis=1)
        return np.diff(self.theta)[:, 0] * np.diff(self.phi)[:, 0] * np.sin(theta)

    def split(self, way: Integers) -> "Cells":
        """Four cells for each one, in its place, in the `way` of each."""
        parts = PARTS[way]

        def _borders(edges: Floats, part: Floats) -> Floats:
            low, high = edges[:, 0, None, None], edges[:, 1, None, None]
            return (low * (1 - part) + high * part).reshape(-1, 2)

        share = self.share[:, :, None] * np.diff(parts)[..., 0]
        return Cells(
            np.repeat(self.patch, 4),
            np.repeat(self.lower, 4),
            np.repeat(self.direction, 4),
            _borders(self.theta, parts[:, 0]),
            _borders(self.phi, parts[:, 1]),
            np.swapaxes(share, 1, 2).reshape(-1, 2),
        )

    def tolerated(self, way: Integers) -> Floats:
        """Part of a patch's tolerated error: random ones add up by their squares."""
        across = np.column_stack([self.share.prod(axis=1) ** 0.5, self.share[:, ::-1]])
        return across[np.arange(len(way)), way]

    def narrow(self, way: Integers, least: float) -> Flags:
        """Whether cells are split across a side that is below `least` radians."""
        widths = np.hstack([np.diff(self.theta), np.diff(self.phi)])
        across = widths[np.arange(len(way)), np.maximum(way, 1) - 1]
        return (way != QUARTERS) & (across < least)

    def nodes(self) -> list[NDArray[Any]]:
        """Polar angle, azimuth, hemisphere and weight of the points of the rule."""
        each = GAUSS.placed(self)
        angles = (middle[:, None] + half[:, None] * at for middle, half, _, at in each)
        lower = np.repeat(self.lower, NODES_PER_CELL)
        return [*map(np.ravel, angles), lower, self._areas().ravel()]

    def weights(self) -> Floats:
        """Solid angles that the points of the rule stand for, shape (n, n_points)."""
        theta = self.theta.mean(axis=1, keepdims=True) + np.diff(self.theta) / 2 * NODES
        weights = self._areas()
        weights *= np.sin(theta)[:, :, None]
        return weights.reshape(len(theta), -1)

    def _areas(self) -> Floats:
        """Areas in polar angle and azimuth that the points of the rule stand for."""
        area = np.diff(self.theta) / 2 * (np.diff(self.phi) / 2)
        return (area * WEIGHTS)[:, :, None] * WEIGHTS

    def of_direction(self, number: int, n_patches: int) -> "Cells":
        """Cells of one incident direction, as if there were no other.

        `n_patches` are those of all its hemispheres.
        """
        own = self[self.direction == number]
        return replace(
            own,
            patch=own.patch - number * n_patches,
            direction=np.zeros_like(own.direction),
        )

    @classmethod
    def join(cls, several: Iterable["Cells"]) -> "Cells":
        """All cells of `several`."""
        columns = zip(*(vars(one).values() for one in several))
        return cls(*map(np.concatenate, columns))

    def __getitem__(self, chosen: Any) -> "Cells":
        if np.asarray(chosen).dtype.kind == "b" and np.all(chosen):
            return self
        return Cells(*(column[chosen] for column in vars(self).values()))


@dataclass(frozen=True, eq=False)
class Points:
    """Points of a rule in a cell, whose sides are [-1, 1].

    Attributes
    ----------
    theta, phi : ndarray, shape (n_points,)
        Where they are along both sides.
    inside : float
        How far inside its cell a point is at least, in radians.
    areas : ndarray, shape (n_points,)
        What they stand for of the area, which is 4; nothing where it is no rule.
    n_side : int
        Points on a side, where each of one side goes with each of the other; else 0.
    """

    theta: Floats
    phi: Floats
    inside: float
    areas: Floats
    n_side: int = 0

    @classmethod
    def tensor(cls, nodes: Floats, weights: Floats, inside: float = 0.0) -> "Points":
        """Points of a tensor rule, the azimuth running fastest."""
        n = len(nodes)
        areas = np.outer(weights, weights).ravel()
        return cls(np.repeat(nodes, n), np.tile(nodes, n), inside, areas, n)

    def __len__(self) -> int:
        return len(self.theta)

    def placed(self, cells: Cells) -> list[tuple[Floats, ...]]:
        """Middle, half and largest offset of each cell, and the points: per angle."""
        found: list[tuple[Floats, ...]] = []
        for edges, at in ((cells.theta, self.theta), (cells.phi, self.phi)):
            half = (edges[:, 1] - edges[:, 0]) / 2
            most = np.maximum(half - self.inside, half / 2)
            found.append(((edges[:, 0] + edges[:, 1]) / 2, half, most, at))
        return found


GAUSS = Points.tensor(NODES, WEIGHTS)
CONFIRMING = Points.tensor(LOBATTO_NODES, LOBATTO_WEIGHTS, INSIDE)
PROBING = Points(PROBES[:, 0], PROBES[:, 1], INSIDE, np.empty(0))


@dataclass(frozen=True)
class Guides:
    """Directions that ``sample`` gave, and the cell that each is in."""

    cell: Integers
    theta: Floats
    phi: Floats

    def descend(
        self, cells: Cells, chosen: Flags, way: Integers, full: Flags
    ) -> "Guides":
        """Guides of the chosen cells, in the parts of the `way` of each.

        Those in cells that are not `full` will fill none, and are left behind.
        """
        kept = (chosen & full)[self.cell]
        cell, theta, phi = self.cell[kept], self.theta[kept], self.phi[kept]
        fourth = []
        for angle, edges in ((theta, cells.theta), (phi, cells.phi)):
            steps = 4 / np.diff(edges)[:, 0]
            place = (angle - edges[cell, 0]) * steps[cell]
            fourth.append(np.clip(place, 0, 3).astype(np.int8))
        part = 2 * (fourth[0] // 2) + fourth[1] // 2
        for axis, across in enumerate((ACROSS_THETA, ACROSS_PHI)):
            own = way[cell] == across
            part[own] = fourth[axis][own]
        rank = np.cumsum(chosen) - 1
        return Guides(4 * rank[cell] + part, theta, phi)


def _lagrange(nodes: Floats, x: float) -> Floats:
    """What each node's value contributes at `x` to the polynomial through all."""
    others = ~np.eye(len(nodes), dtype=bool)
    return np.array(
        [np.prod((x - nodes[o]) / (node - nodes[o])) for node, o in zip(nodes, others)]
    )


def _continuation() -> Floats:
    """Values at the probes as sums over the nodes of the quarters: their polynomial."""
    rows = []
    for theta, phi in PROBES:
        basis = np.outer(_lagrange(_HALF_NODES, theta), _lagrange(_HALF_NODES, phi))
        nodes = basis.reshape(2, ORDER, 2, ORDER)  # half, node, half, node
        rows.append(np.swapaxes(nodes, 1, 2).ravel())
    return np.array(rows)


CONTINUATION = _continuation()


def _difference(nodes: Floats) -> Floats:
    """Weights of the highest difference that as many values have, at most 1."""
    weights = [1 / np.prod(x - np.delete(nodes, i)) for i, x in enumerate(nodes)]
    return np.array(weights) / np.abs(weights).max()


# Third differences, as part of the largest value, that are taken for a step; and how
# many times less they are along it.
STEP = 0.1
ALONG = 1 / 32

# What single precision leaves of the largest value, at best.
NOISE = 2.0**-22

# Of the nodes of a cell along one side, and of those of both its halves.
ROUGH, FINE_ROUGH = _difference(NODES), _difference(_HALF_NODES)


def off_polynomial(found: Singles, values: Singles) -> Floats:
    """How far values at the probes are from the polynomial through those at nodes."""
    expected = np.einsum("pk,nkc->npc", CONTINUATION, values.astype(float))
    return np.abs(found - expected).max(axis=1)


def noise(values: Singles) -> Floats:
    """How far the values at the nodes of quarters are from smooth, by cell."""
    n, _, channels = values.shape
    at = values.astype(float).reshape(n, 2, 2, ORDER, ORDER, channels).swapaxes(2, 3)
    at = at.reshape(n, 2 * ORDER, 2 * ORDER, channels)
    theta = np.abs(np.einsum("ntpc,t->npc", at, FINE_ROUGH)).max(axis=1)
    phi = np.abs(np.einsum("ntpc,p->ntc", at, FINE_ROUGH)).max(axis=1)
    return np.maximum(theta, phi) + NOISE * np.abs(at).max(axis=(1, 2))


def way_to_split(values: Singles) -> Integers:
    """How to split cells: across a step that keeps to one angle, or into quarters."""
    at = values.astype(float).reshape(len(values), ORDER, ORDER, -1)
    theta = np.abs(np.einsum("ntpc,t->npc", at, ROUGH)).max(axis=(1, 2))
    phi = np.abs(np.einsum("ntpc,p->ntc", at, ROUGH)).max(axis=(1, 2))
    step = STEP * at.max(axis=(1, 2, 3))
    across_theta = (theta > step) & (phi < ALONG * theta)
    across_phi = (phi > step) & (theta < ALONG * phi)
    return np.select([across_theta, across_phi], [ACROSS_THETA, ACROSS_PHI], QUARTERS)

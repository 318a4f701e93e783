"""A collector of circular apertures: detectors that stand in measured directions."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from ..array_types import Flags, Floats, Integers, Singles
from ..errors import SettingError, checked_number
from .directions import direction
from .hemisphere import EDGE, Subdivision

# The search grid has at most this many cells per side.
MAX_CELLS = 1024


@dataclass(frozen=True)
class Apertures(Subdivision):
    r"""Cones of one half-angle around given directions, and all that is between them.

    Patch ``i`` is the cone around direction ``i``; the last patch is what no cone
    holds, so that rays are never lost from the ledger. As a map it has as many rows as
    patches and one column. The rim of a cone belongs to what is between the cones. Two
    cones may touch: what rounding lets overlap belongs to the later one.

    Parameters
    ----------
    half_angle : float
        In degrees, in [0.01, 90]: below that, single precision would show.
    directions : sequence of (float, float)
        Polar angle from the pole of the hemisphere and azimuth in degrees.

    Raises
    ------
    TypeError, ValueError
        If a cone reaches below the horizon, two overlap, or there is none.
    """

    half_angle: float
    directions: tuple[tuple[float, float], ...]

    name: ClassVar[str] = "apertures"

    def __post_init__(self) -> None:
        condition = "an angle in degrees in [0.01, 90], 0.01 for values at points"
        half_angle = checked_number(
            "half_angle", self.half_angle, 0.01, 90.01, condition
        )
        object.__setattr__(self, "half_angle", half_angle)
        cones = tuple((float(theta), float(phi)) for theta, phi in self.directions)
        object.__setattr__(self, "directions", cones)
        if not cones:
            raise SettingError("directions must hold at least one direction, got none")
        for theta, phi in cones:
            if not (is_above(theta, half_angle) and np.isfinite(phi)):
                raise SettingError(
                    f"the cone of half-angle {half_angle:g} degrees about (theta, phi) "
                    f"= ({theta:g}, {phi:g}) must lie above the horizon"
                )
        pair = _nearest(cones, half_angle)
        if pair is not None:
            first, second = (cones[i] for i in pair)
            raise SettingError(
                f"apertures of half-angle {half_angle:g} degrees must not overlap, got "
                f"them around (theta, phi) = {first} and {second}"
            )

    def __str__(self) -> str:
        cones = ",".join(f"{theta!r}/{phi!r}" for theta, phi in self.directions)
        return f"{self.name}:{self.half_angle!r}@{cones}"

    @classmethod
    def parse(cls, size: str) -> "Apertures":
        """Build from what follows the colon of a name, ``0.5@45.0/180.0,30.0/0.0``."""
        half_angle, _, cones = size.partition("@")
        pairs = [cone.split("/") for cone in cones.split(",")]
        return cls(
            float(half_angle), tuple((float(theta), float(phi)) for theta, phi in pairs)
        )

    @property
    def shape(self) -> tuple[int, int]:
        """The cones and the gap between them, in one column."""
        return self.n_detectors + 1, 1

    @property
    def n_detectors(self) -> int:
        """Number of cones."""
        return len(self.directions)

    @property
    def aperture_half_angle(self) -> float:
        """In degrees."""
        return self.half_angle

    @property
    def middles(self) -> tuple[Floats, Floats]:
        """Polar angles and azimuths of the cones' axes in radians.

        Two arrays of the shape `shape`; NaN for what is between the cones.
        """
        axes = np.radians([*self.directions, (np.nan, np.nan)])
        return axes[:, :1], axes[:, 1:]

    @property
    def axes(self) -> Floats:
        """Axes of the cones as unit vectors, shape ``(n_patches, 3)``; last +z."""
        return np.vstack([_axes(self.directions), [0, 0, 1]])

    @property
    def cells(self) -> Floats:
        """Each cone about its own axis; for the rest the hemisphere, which holds it.

        Shape ``(n_patches, 4)``, in radians.
        """
        half = np.radians(self.half_angle)
        cones = [(0, half, 0, 2 * np.pi)] * self.n_detectors
        return np.array([*cones, (0, np.pi / 2, 0, 2 * np.pi)])

    @property
    def solid_angles(self) -> Floats:
        """Exact solid angle of each cone and of the rest in sr, sum 2 pi.

        ``4 pi sin^2(a / 2)`` for a half-angle ``a``; of the shape `shape`.
        """
        cone = 4 * np.pi * np.sin(np.radians(self.half_angle) / 2) ** 2
        cones = np.full(self.n_detectors, cone)
        return np.append(cones, 2 * np.pi - cones.sum())[:, None]

    @property
    def projected_solid_angles(self) -> Floats:
        """Exact integral of cos(theta) over each cone and the rest in sr, sum pi.

        ``pi sin^2(a) cos(theta)`` for a half-angle ``a`` around ``theta``; of the
        shape `shape`.
        """
        sin2 = np.sin(np.radians(self.half_angle)) ** 2
        cones = np.pi * sin2 * np.cos(self.middles[0][:-1, 0])
        return np.append(cones, np.pi - cones.sum())[:, None]

    def patch_index(self, xp: Any, x: Any, y: Any, z: Any) -> Any:
        """Index of the cone that holds each direction, or the number of cones.

        A cell of a square grid, on the disk onto which Lambert's map takes the
        hemisphere, lists the few cones that reach into it.

        Parameters
        ----------
        xp : namespace
            Has ``sqrt``, ``floor``, ``minimum``, ``where`` and ``take(table, index)``,
            the entries of a float table at whole floating-point numbers.
        x, y, z : array
            Components of unit vectors, z > 0.
        """
        n_cells, lists, axes = self._search
        to_disk = 1 / xp.sqrt(1 + z)
        half = n_cells / 2
        column = xp.floor(xp.minimum((x * to_disk + 1) * half, n_cells - 1.0))
        row = xp.floor(xp.minimum((y * to_disk + 1) * half, n_cells - 1.0))
        cell = row * n_cells + column
        # chords keep their precision for narrow cones, where cosines would not
        limit = 4 * np.sin(np.radians(self.half_angle) / 2) ** 2
        index = x * 0 + float(self.n_detectors)
        for candidates in lists:
            cone = xp.take(candidates, cell)
            chord = (x - xp.take(axes[0], cone), y - xp.take(axes[1], cone))
            chord2 = chord[0] ** 2 + chord[1] ** 2 + (z - xp.take(axes[2], cone)) ** 2
            index = xp.where(chord2 < limit, cone, index)
        return index

    def detectors(self, v: Floats) -> tuple[Integers, Flags]:
        """Nearest cone to each direction, and whether the direction is its axis."""
        from scipy.spatial import cKDTree  # slow to import

        distance, nearest = cKDTree(_axes(self.directions)).query(v)
        return nearest, distance <= EDGE

    @cached_property
    def _search(self) -> tuple[int, Singles, Singles]:
        """Cells per side; the k-th cone of each cell, for each k; the cones' axes.

        An empty place in a list names a cone below the horizon, which holds nothing.
        """
        axes = _axes(self.directions)
        reach = np.radians(self.half_angle)
        n_cells = int(np.clip(np.ceil(4 / reach), 8, MAX_CELLS))
        # the map of the hemisphere onto the unit disk lengthens nothing
        middle = axes[:, :2] / np.sqrt(1 + axes[:, 2:])
        margin = reach + 4 / n_cells * 1e-3
        first = np.floor((middle - margin + 1) * n_cells / 2).astype(int)
        last = np.floor((middle + margin + 1) * n_cells / 2).astype(int)
        cells = [
            (row * n_cells + np.arange(max(x0, 0), min(x1, n_cells - 1) + 1), cone)
            for cone, ((x0, y0), (x1, y1)) in enumerate(zip(first, last))
            for row in range(max(y0, 0), min(y1, n_cells - 1) + 1)
        ]
        cell = np.concatenate([columns for columns, _ in cells])
        cone = np.repeat([cone for _, cone in cells], [len(c) for c, _ in cells])
        order = np.argsort(cell, kind="stable")
        cell, cone = cell[order], cone[order]
        place = np.arange(len(cell)) - np.searchsorted(cell, cell)
        lists = np.full((place.max() + 1, n_cells**2), len(axes), np.float32)
        lists[place, cell] = cone
        return n_cells, lists, np.vstack([axes, [0, 0, -3]]).astype(np.float32).T.copy()


def is_above(theta: Any, half_angle: float) -> Any:
    """Whether cones about polar angles in degrees lie above the horizon."""
    return (theta >= 0) & (theta + half_angle <= 90 * (1 + EDGE))


def disjoint_groups(
    directions: Sequence[tuple[float, float]], half_angle: float
) -> list[list[tuple[float, float]]]:
    """Split `directions` into groups whose cones do not overlap.

    Parameters
    ----------
    directions : sequence of (float, float)
        Polar angle and azimuth in degrees.
    half_angle : float
        In degrees.

    Returns
    -------
    list of list of (float, float)
        Few, but not the fewest; a direction goes to the first group with room for it.
    """
    from scipy.spatial import cKDTree  # slow to import

    neighbours: list[list[int]] = [[] for _ in directions]
    tree = cKDTree(_axes(directions))
    for i, j in tree.query_pairs(_reach(half_angle), output_type="ndarray"):
        neighbours[max(i, j)].append(min(i, j))
    groups: list[list[tuple[float, float]]] = []
    group_of: list[int] = []
    for i, cone in enumerate(directions):
        taken = {group_of[j] for j in neighbours[i]}
        group = next(k for k in range(len(groups) + 1) if k not in taken)
        if group == len(groups):
            groups.append([])
        groups[group].append(cone)
        group_of.append(group)
    return groups


def _nearest(
    directions: Sequence[tuple[float, float]], half_angle: float
) -> tuple[int, int] | None:
    """One pair of indices whose cones overlap, or None; in little memory."""
    from scipy.spatial import cKDTree  # slow to import

    axes = _axes(directions)
    order = np.lexsort(axes.T)
    same = np.flatnonzero((axes[order[1:]] == axes[order[:-1]]).all(axis=1))
    if same.size:
        return int(order[same[0]]), int(order[same[0] + 1])
    distances, indices = cKDTree(axes).query(axes, k=2)
    close = np.flatnonzero(distances[:, 1] <= _reach(half_angle))
    if not close.size:
        return None
    first, second = indices[close[0]].tolist()
    return first, second


def _reach(half_angle: float) -> float:
    """Chord between the axes of two cones that touch."""
    return float(2 * np.sin(np.radians(half_angle)) * (1 - EDGE))


def _axes(directions: Sequence[tuple[float, float]]) -> Floats:
    theta, phi = np.radians(np.array(directions, dtype=float)).T
    return direction(theta, phi)

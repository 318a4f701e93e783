"""A collector of circular apertures: receptors of one width that do not overlap."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from ..array_types import Flags, Floats, Integers, Singles
from ..errors import SettingError, checked_number
from .directions import direction
from .hemisphere import EDGE
from .receptors import Receptors, Window

# The search grid has at most this many cells per side.
MAX_CELLS = 1024


@dataclass(frozen=True)
class Apertures(Receptors):
    r"""Cones of one half-angle around given directions, and the gap between them.

    Patch ``i`` is the cone around direction ``i``; the last patch is the rest of the
    hemisphere, so that the ledger loses no rays. A map has one row per patch and one
    column. The rim of a cone belongs to the gap. Cones may touch; where rounding makes
    them overlap, the direction belongs to the later cone.

    Parameters
    ----------
    half_angle : float
        In degrees, in [0.01, 90]; single precision does not resolve narrower cones.
    directions : sequence of (float, float)
        Polar angle from the pole of the hemisphere and azimuth in degrees.

    Raises
    ------
    TypeError, ValueError
        If a cone reaches below the horizon, two overlap, or there is none.
    """

    half_angle: float
    directions: tuple[tuple[float, float], ...]
    windows: tuple[Window, ...] = field(init=False, repr=False, compare=False)

    name: ClassVar[str] = "apertures"

    def __post_init__(self) -> None:
        condition = "an angle in degrees in [0.01, 90], 0.01 for values at points"
        half_angle = checked_number(
            "half_angle", self.half_angle, 0.01, 90.01, condition
        )
        object.__setattr__(self, "half_angle", half_angle)
        cones = tuple((float(theta), float(phi)) for theta, phi in self.directions)
        object.__setattr__(self, "directions", cones)
        windows = tuple((*cone, 2 * half_angle) for cone in cones)
        object.__setattr__(self, "windows", windows)
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
        """Build from the text after the colon, such as ``0.5@45.0/180.0,30.0/0.0``."""
        half_angle, _, cones = size.partition("@")
        pairs = [cone.split("/") for cone in cones.split(",")]
        return cls(
            float(half_angle), tuple((float(theta), float(phi)) for theta, phi in pairs)
        )

    @property
    def aperture_half_angle(self) -> float:
        """In degrees."""
        return self.half_angle

    def detectors(self, v: Floats) -> tuple[Integers, Flags]:
        """Nearest cone to each direction, and whether the direction is its axis."""
        from scipy.spatial import cKDTree  # slow to import

        distance, nearest = cKDTree(_axes(self.directions)).query(v)
        return nearest, distance <= EDGE

    def _candidates(self, xp: Any, x: Any, y: Any, z: Any) -> list[tuple[Any, bool]]:
        """Numbers of the few cones that overlap the grid cell of each direction.

        Scans have thousands of cones. The square grid covers the disk onto which
        Lambert's equal-area map projects the hemisphere.
        """
        n_cells, lists = self._search
        to_disk = 1 / xp.sqrt(1 + z)
        half = n_cells / 2
        column = xp.floor(xp.minimum((x * to_disk + 1) * half, n_cells - 1.0))
        row = xp.floor(xp.minimum((y * to_disk + 1) * half, n_cells - 1.0))
        cell = row * n_cells + column
        return [(xp.take(cones, cell), True) for cones in lists]

    def _of_patches(self, whole: Floats, hemisphere: float) -> Floats:
        """Integrals over patches; cones do not overlap, so no pairs are compared."""
        return np.append(whole, hemisphere - whole.sum())

    @cached_property
    def _search(self) -> tuple[int, Singles]:
        """Grid cells per side, and lists of the cones that overlap each cell.

        Shape of the lists: ``(longest, n_cells ** 2)``. Short lists begin with cone 0.
        """
        axes = _axes(self.directions)
        reach = np.radians(self.half_angle)
        n_cells = int(np.clip(np.ceil(4 / reach), 8, MAX_CELLS))
        # the projection onto the unit disk lengthens no distance
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
        later = np.searchsorted(cell, cell, side="right") - 1 - np.arange(len(cell))
        lists = np.zeros((later.max() + 1, n_cells**2), np.float32)
        lists[-1 - later, cell] = cone
        return n_cells, lists


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
        Each direction joins the first group with room for it: a greedy choice, not
        always the smallest number of groups.
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
    """Indices of one pair of overlapping cones, or None; never lists all pairs."""
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

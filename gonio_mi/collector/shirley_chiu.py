"""Patches of Shirley and Chiu's map between a square and the unit disk, as Radiance's.

Equal areas stay equal: seen from the disk onto which the hemisphere projects, cells of
the square have equal projected solid angles. Source: P. Shirley and K. Chiu, *A low
distortion map between disk and square*, Journal of Graphics Tools 2(3), 1997.
"""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ..array_types import Floats, Integers
from ..errors import SettingError, checked_count
from .hemisphere import EDGE, Subdivision

# Finer ones are no use to anybody, and indices are whole numbers in single precision.
MAX_SIZE = 1024


@dataclass(frozen=True)
class ShirleyChiu(Subdivision):
    """Cells of a square that is mapped to the hemisphere: those of tensor trees.

    Cell ``(i, j)`` is the ``i``-th step of the first coordinate of the square, about
    +x, and the ``j``-th of the second, about +y. All have the same projected solid
    angle. The pole is a corner of four of them, and in the last of these.

    Attributes
    ----------
    size : int
        Cells along a side of the square, an even number.
    """

    size: int

    name: ClassVar[str] = "shirley-chiu"

    def __post_init__(self) -> None:
        size = checked_count("size", self.size, 2, MAX_SIZE)
        if size % 2:
            raise SettingError(f"size must be an even number of cells, got {size}")
        object.__setattr__(self, "size", size)

    def __str__(self) -> str:
        return f"{self.name}:{self.size}"

    @property
    def shape(self) -> tuple[int, int]:
        """``(size, size)``."""
        return self.size, self.size

    @property
    def projected_solid_angles(self) -> Floats:
        """Exact integral of cos(theta) over each cell in sr: all the same; sum pi."""
        return np.full(self.shape, np.pi / self.size**2)

    @property
    def solid_angles(self) -> Floats:
        """Exact solid angle of each cell in sr, shape ``(size, size)``; sum 2 pi.

        Where the first coordinate ``a`` of [-1, 1] is the larger, it is the radius,
        and the azimuth is ``pi / 4 * b / a``: the integral of ``r / sqrt(1 - r^2)``
        over radius and azimuth.
        """
        half = self.size // 2
        edges = np.arange(half + 1) / half
        low, high = edges[:-1], edges[1:]
        arcs = np.diff(np.arcsin(edges))
        cosines = np.sqrt(1 - low**2) - np.sqrt((1 - high) * (1 + high))
        ring = np.pi / 4 / half * arcs
        # a cell on the diagonal is in two of the triangles
        diagonal = np.pi / 2 * (cosines - low * arcs)
        k = np.arange(half)
        quarter = ring[np.maximum.outer(k, k)]
        quarter[k, k] = diagonal
        upper = np.concatenate([quarter[::-1], quarter])
        return np.concatenate([upper[:, ::-1], upper], axis=1)

    @property
    def middles(self) -> tuple[Floats, Floats]:
        """Polar angles and azimuths of the cells' middles in radians."""
        x, y, z = np.moveaxis(self.points(1)[:, 0].reshape(*self.shape, 3), -1, 0)
        return np.arctan2(np.hypot(x, y), z), np.arctan2(y, x) % (2 * np.pi)

    def points(self, n: int, chosen: Integers | None = None) -> Floats:
        """Directions of ``n x n`` points in each cell; see `Subdivision.points`."""
        steps = ((np.arange(self.size * n) + 0.5) / (self.size * n)).reshape(-1, n)
        a, b = steps[:, None, :, None], steps[None, :, None, :]
        square = np.stack(np.broadcast_arrays(a, b), axis=-1)
        square = square.reshape(self.n_patches, n * n, 2)
        return directions_of(square if chosen is None else square[chosen])

    def patch_index(self, xp: Any, x: Any, y: Any, z: Any) -> Any:
        """Index of the cell of each direction; see `Subdivision.patch_index`."""
        del z
        away_x, away_y = xp.where(x < 0, -x, x), xp.where(y < 0, -y, y)
        along_x = away_x > away_y
        main = xp.where(along_x, away_x, away_y)
        other = xp.where(along_x, away_y, away_x)
        radius = xp.sqrt(x * x + y * y)
        second = radius * xp.atan2(other, main) * (4 / np.pi)
        a, b = xp.where(along_x, radius, second), xp.where(along_x, second, radius)
        a, b = xp.where(x < 0, -a, a), xp.where(y < 0, -b, b)
        row, column = self._step(xp, a), self._step(xp, b)
        return row * self.size + column

    def _step(self, xp: Any, coordinate: Any) -> Any:
        """Number of the cell of a coordinate in [-1, 1]."""
        step = xp.floor((coordinate + 1) * (self.size / 2) + EDGE)
        return xp.minimum(step, self.size - 1.0)

    def frame_of(self, number: int) -> tuple[float, ...]:
        """Corner of a cell in the square from -1 to 1, and its side."""
        side = 2 / self.size
        row, column = divmod(int(number), self.size)
        return row * side - 1, column * side - 1, side

    def drawn(self, xp: Any, frame: Any, u: Any, v: Any) -> tuple[Any, Any, Any]:
        """Directions that fill a cell; see `Subdivision.drawn`."""
        a, b = frame[0] + u * frame[2], frame[1] + v * frame[2]
        away_a, away_b = xp.where(a < 0, -a, a), xp.where(b < 0, -b, b)
        along_x = away_a > away_b
        radius = xp.where(along_x, away_a, away_b)
        turn = (np.pi / 4) * xp.where(along_x, away_b, away_a) / radius
        main, other = radius * xp.cos(turn), radius * xp.sin(turn)
        x, y = xp.where(along_x, main, other), xp.where(along_x, other, main)
        x, y = xp.where(a < 0, -x, x), xp.where(b < 0, -y, y)
        return x, y, xp.sqrt((1 - radius) * (1 + radius))


def directions_of(square: ArrayLike) -> Floats:
    """Unit vectors above points of the square, shape ``(..., 3)``; z is not negative.

    Parameters
    ----------
    square : array_like, shape (..., 2)
        In [0, 1]; the middle is the pole, the edges are the horizon.
    """
    a, b = np.moveaxis(2 * np.asarray(square, dtype=float) - 1, -1, 0)
    along_x = np.abs(a) > np.abs(b)
    radius = np.where(along_x, a, b)
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = np.where(along_x, b / a, a / b) * (np.pi / 4)
    turn = np.nan_to_num(turn)
    cos, sin = radius * np.cos(turn), radius * np.sin(turn)
    x, y = np.where(along_x, cos, sin), np.where(along_x, sin, cos)
    z = np.sqrt(np.maximum(1 - radius * radius, 0))
    return np.stack([x, y, z], axis=-1)


def square_of(x: ArrayLike, y: ArrayLike) -> Floats:
    """Point of the square for each point of the unit disk, shape ``(..., 2)``."""
    x, y = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
    radius = np.hypot(x, y)
    along_x = np.abs(x) > np.abs(y)
    main, other = np.where(along_x, x, y), np.where(along_x, y, x)
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = np.nan_to_num(np.arctan(other / main)) * (4 / np.pi)
    first = np.copysign(radius, main)
    second = first * turn
    a, b = np.where(along_x, first, second), np.where(along_x, second, first)
    return np.stack([a, b], axis=-1) / 2 + 0.5

"""Shirley and Chiu's map between a square and the unit disk, as Radiance uses it.

Equal areas stay equal: seen from the disk onto which the hemisphere projects, cells of
the square have equal projected solid angles. Source: P. Shirley and K. Chiu, *A low
distortion map between disk and square*, Journal of Graphics Tools 2(3), 1997.
"""

import numpy as np
from numpy.typing import ArrayLike

from ..array_types import Floats

__all__ = ["directions_of", "square_of"]


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

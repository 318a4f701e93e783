"""Tensor trees: the BSDF of Radiance with a resolution that varies.

A node is a grid with 2^k values on each axis, the last axis fastest, or has a child
for each of its orthants, the first axis fastest. Axes are in [0, 1]. Of rank 3, for
isotropic materials: ``(1 - sin(theta_i)) / 2``, which leaves the upper half unused, and
the exit direction in Shirley and Chiu's square, turned so that light flies to +x. Of
rank 4: the direction of flight, and the exit direction, in that square.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...array_types import Floats
from ...collector.shirley_chiu import square_of
from ...errors import FileFormatError
from ...files.checks import require
from ...files.numbers import decimal

# Cells whose values differ by less, relative to their mean, become one.
MERGE_TOLERANCE = 0.01

# A grid, or nodes of the orthants.
Node = Floats | list["Node"]

# Levels of the deepest tree read: cells of a millionth.
MAX_DEPTH = 20


@dataclass(frozen=True, eq=False)
class TensorTree:
    """Piecewise constant function on a cube of `rank` dimensions.

    Attributes
    ----------
    rank : {3, 4}
    root : ndarray or list
        Grid of shape ``(n,) * rank``, or ``2**rank`` nodes like this one.
    """

    rank: int
    root: Node

    @classmethod
    def of(cls, values: Floats, flat: float = MERGE_TOLERANCE) -> TensorTree:
        """Tree of a grid, in which cells of almost one value are merged.

        Parameters
        ----------
        values : ndarray, shape ``(n,) * rank``
            n is a power of two.
        flat : float
            Cells become one if their spread is at most this part of their mean.
        """
        return cls(values.ndim, _merged(np.asarray(values, dtype=float), flat))

    @classmethod
    def parsed(cls, text: str, rank: int) -> TensorTree:
        """Tree from the text that Radiance reads.

        Raises
        ------
        FileFormatError
            If braces or numbers of values do not make a tree. No more is allocated
            than the text is long.
        """
        before, *_ = text.partition("{")
        require(not before.strip(), "its tensor tree does not begin with a brace")
        stack: list[Any] = [[]]
        for brace, run in re.findall("([{}])([^{}]*)", text):
            words = run.replace(",", " ").split()
            if brace == "{":
                require(len(stack) <= MAX_DEPTH, "its tensor tree is too deep")
                stack.append(_grid(words, rank) if words else [])
                continue
            node = stack.pop()
            reason = "its tensor tree has values or braces out of place"
            require(not words and bool(stack) and isinstance(stack[-1], list), reason)
            reason = f"a branch of its tensor tree must have {2**rank} children"
            require(not isinstance(node, list) or len(node) == 2**rank, reason)
            stack[-1].append(node)
        require(len(stack) == 1 and len(stack[0]) == 1, "its tensor tree is not closed")
        return cls(rank, stack[0][0])

    @property
    def size(self) -> int:
        """Cells per axis of its finest parts, a power of two."""
        return _size(self.root)

    def text(self) -> str:
        """Text that Radiance reads, with six digits."""
        return _text(self.root)

    def at(self, points: Floats) -> Floats:
        """Values at points of the cube, shape ``(n,)``.

        Parameters
        ----------
        points : ndarray, shape (n, rank)
            In [0, 1].
        """
        below_one = np.nextafter(1.0, 0.0)
        return _looked_up(self.root, np.clip(points, 0.0, below_one))

    def diffuse_total(self) -> float:
        """Fraction of diffuse light, from all of a hemisphere, that leaves."""
        return float(np.pi * _weighted(self.root, self.rank, 0.0, 1.0))


def coordinates(rank: int, theta_i: ArrayLike, phi_i: ArrayLike, wo: Floats) -> Floats:
    """Points of the cube for pairs of directions, shape ``(n, rank)``.

    Parameters
    ----------
    rank : {3, 4}
    theta_i, phi_i : float or array_like, shape (n,)
        Incident directions in degrees, towards the emitter, from the lit normal.
    wo : ndarray, shape (n, 3)
        Unit vectors of exit, on either side.
    """
    theta, flight = np.radians(theta_i), np.radians(phi_i) + np.pi
    sine, x, y = np.sin(theta), wo[:, 0], wo[:, 1]
    cos, sin = np.cos(flight), np.sin(flight)
    if rank == 3:
        first = np.broadcast_to(isotropic_coordinate(theta_i), x.shape)[:, None]
        x, y = x * cos + y * sin, y * cos - x * sin
    else:
        first = square_of(sine * cos, sine * sin)
        first = np.broadcast_to(first, (len(x), 2))
    return np.concatenate([first, square_of(x, y)], axis=1)


def isotropic_coordinate(theta_i: ArrayLike) -> Floats:
    """First coordinate of rank 3: normal incidence ends the half that is used."""
    return np.minimum((1 - np.sin(np.radians(theta_i))) / 2, np.nextafter(0.5, 0.0))


def isotropic_incidence(size: int, n: int) -> Floats:
    """Angles of incidence in degrees of `n` points in each cell of a tree of rank 3.

    Shape ``(size / 2, n)``: without the half of the `size` cells that is not used.
    """
    points = (np.arange(size * n).reshape(size, n) + 0.5) / (size * n)
    return np.degrees(np.arcsin(1 - 2 * points[: size // 2]))


def _merged(values: Floats, flat: float) -> Node:
    """Node of a grid, as few values as `flat` allows."""
    mean = values.mean()
    if np.ptp(values) <= flat * mean:
        return mean.reshape((1,) * values.ndim)
    size = len(values)
    if size == 2:
        return values
    half, children = size // 2, []
    halves = slice(None, half), slice(half, None)
    for number in range(2**values.ndim):  # orthants, the first axis fastest
        part = tuple(halves[number >> k & 1] for k in range(values.ndim))
        children.append(_merged(values[part], flat))
    if all(isinstance(c, np.ndarray) and len(c) == half for c in children):
        return values
    return children


def _size(node: Node) -> int:
    return 2 * max(map(_size, node)) if isinstance(node, list) else len(node)


def _weighted(node: Node, rank: int, start: float, size: float) -> float:
    """Integral over a cube, of side `size` from `start` on, by incident light.

    The squares are even in projected solid angle; the first axis of rank 3, which is
    ``(1 - sin(theta_i)) / 2``, has the light ``sin(theta_i)`` and ends in its middle.
    """
    if isinstance(node, list):
        half = size / 2
        starts = (start + half * (number & 1) for number in range(len(node)))
        return sum(_weighted(one, rank, low, half) for one, low in zip(node, starts))
    n = len(node)
    sums = node.reshape(n, -1).sum(axis=1) * (size / n) ** (rank - 1)
    edges = start + size * np.arange(n + 1) / n
    light = edges if rank == 4 else -np.square(np.maximum(1 - 2 * edges, 0))
    return float(np.diff(light) @ sums)


def _text(node: Node) -> str:
    if isinstance(node, list):
        return "{\n" + "".join(map(_text, node)) + "}\n"
    return "{ " + " ".join(f"{value:.6g}" for value in node.ravel()) + " }\n"


def _grid(words: Sequence[str], rank: int) -> Floats:
    """Grid of the values of a leaf."""
    size = round(len(words) ** (1 / rank))
    reason = f"a grid of its tensor tree must have 2^{rank}k values, got {len(words)}"
    require(size**rank == len(words) and size & (size - 1) == 0, reason)
    try:
        values = np.array([decimal(word) for word in words])
    except ValueError as error:
        raise FileFormatError(f"its tensor tree: {error}") from None
    require(bool(np.isfinite(values).all()), "its tensor tree has a value not finite")
    # as Radiance does
    return np.maximum(values, 0.0).reshape((size,) * rank)


def _looked_up(node: Node, points: Floats) -> Floats:
    """Values at points in [0, 1)."""
    if isinstance(node, np.ndarray):
        return node[tuple((points * len(node)).astype(int).T)]
    values = np.empty(len(points))
    upper = points >= 0.5
    number = upper @ (1 << np.arange(points.shape[1]))
    for child in np.unique(number):
        here = number == child
        values[here] = _looked_up(node[child], 2 * points[here] - upper[here])
    return values

"""What samples are, and the density that they should have, over all directions.

Properties of `sampling`, `weights` and `energy`, which maps of samples decide; scripts
show them by the source of these functions.
"""

from collections.abc import Callable
from typing import Any, TypeAlias

import drjit as dr
import mitsuba as mi
import numpy as np

from .arrays import density, drawn, lattices, moments, rows, smooth, sphere, value

# Directions, what each of them counts, and the density of that.
Counted: TypeAlias = tuple[Any, Any, Callable[[Any], Any]]

# Two means that should be equal, and the standard error of their difference.
Means: TypeAlias = tuple[Any, Any, Any]


def directions(bsdf: Any, ctx: Any, si: Any, u: Any) -> Counted:
    """Directions that are drawn, with the density of `pdf`."""
    bs, weight = drawn(bsdf, ctx, si, u)
    return bs.wo, smooth(bs, weight), lambda wo: rows(bsdf.pdf(ctx, si, wo, True))[0]


def lit_directions(bsdf: Any, ctx: Any, si: Any, u: Any) -> Counted:
    """The same where `eval` is not 0."""
    bs, _ = drawn(bsdf, ctx, si, u)

    def is_lit(wo: Any) -> Any:
        return np.any(value(bsdf, ctx, si, wo) > 0, axis=0)

    return bs.wo, is_lit(bs.wo), lambda wo: density(bsdf, ctx, si, wo)[0] * is_lit(wo)


def weights(bsdf: Any, ctx: Any, si: Any, u: Any) -> Counted:
    """Weights that are drawn, with the density of `eval`."""
    bs, weight = drawn(bsdf, ctx, si, u)
    light = np.where(smooth(bs, weight), rows(weight).mean(axis=0), 0)
    return bs.wo, light, lambda wo: rows(bsdf.eval(ctx, si, wo, True)).mean(axis=0)


def in_box(bsdf: Any, ctx: Any, si: Any, u: Any, of: Any, low: Any, high: Any) -> Means:
    """What is drawn in a box of directions is the integral of its density there.

    Both, of the box as a part of the unit square that Mitsuba warps to the sphere.
    """
    wo, counted, due = of(bsdf, ctx, si, u)
    low, high = np.array([low, high])[:, :, None]
    square, n = np.array(mi.warp.uniform_sphere_to_square(wo)), dr.width(u)
    x = counted * np.all((low <= square) & (square < high), axis=0) + np.zeros(n)
    means = [np.mean(due(sphere(*(low + (high - low) * p)))) for p in lattices(n)]
    y = 4 * np.pi * np.prod(high - low) * np.array(means)
    return np.mean(x), np.mean(y), np.hypot(np.std(x) / n**0.5, np.std(y) / 4)


def all_around(bsdf: Any, ctx: Any, si: Any, u: Any, of: Any) -> Means:
    """The same over all directions, and times their coordinates."""
    wo, counted, due = of(bsdf, ctx, si, u)
    x, n = counted * np.nan_to_num(moments(wo)), dr.width(u)
    even = [sphere(*points) for points in lattices(n)]
    y = [4 * np.pi * np.mean(due(wo) * moments(wo), axis=1) for wo in even]
    error = np.hypot(np.std(x, axis=1) / n**0.5, np.std(y, axis=0) / 4)
    return np.mean(x, axis=1), np.mean(y, axis=0), error


def by_lattices(bsdf: Any, ctx: Any, si: Any, u: Any, of: Any) -> Means:
    """The same by lattices of samples, far sharper than independent ones."""
    both, n = [], dr.width(u)
    shifts = np.random.default_rng(0).random((16, 3, 1))
    steps = [[1 / n], [0.618034], [0.754878]]
    for p in (np.arange(n) * steps + shifts) % 1 * (1 - 2**-24):
        (at, counted, due), wo = of(bsdf, ctx, si, mi.Point3f(p)), sphere(p[0], p[1])
        x, y = counted * np.nan_to_num(moments(at)), due(wo) * moments(wo)
        both.append([np.mean(x, axis=1), 4 * np.pi * np.mean(y, axis=1)])
    off = np.std(np.diff(both, axis=1)[:, 0], axis=0) / 15**0.5
    # of an error of 2^-17, 8 are a thousand roundings
    return *np.mean(both, axis=0), np.hypot(off, 2**-17)


def total(bsdf: Any, ctx: Any, si: Any, u: Any, what: Any, due: float) -> Means:
    """The integral of an answer over all directions."""
    even = (sphere(*points) for points in lattices(dr.width(u)))
    means = [np.mean(rows(what(bsdf, ctx, si, wo, u)).max(axis=0)) for wo in even]
    return 4 * np.pi * np.mean(means), due, np.pi * np.std(means)

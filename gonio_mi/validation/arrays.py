"""Answers of a BSDF as arrays, which properties hold against each other.

Properties call these functions, and so do scripts, which have their source. Arrays have
the shape ``(channels, n)``; `u` are three random numbers of each sample.
"""

from collections.abc import Callable
from typing import Any, TypeAlias

import drjit as dr
import mitsuba as mi
import numpy as np

from .mistakes import EVAL, EVAL_PDF, PDF, SAMPLE, Function

# What should be equal, and which lanes count.
Sides: TypeAlias = tuple[Any, Any, Any]


def rows(answer: Any) -> Any:
    """Channels in double precision; of Mueller matrices the first element."""
    answer = answer[0, 0] if dr.is_matrix_v(answer) else answer
    each = [answer] if dr.depth_v(answer) < 2 else answer
    return np.array(np.broadcast_arrays(*(np.array(x, float) for x in each)))


def full(answer: Any) -> Any:
    """The same, of Mueller matrices all elements, (4, 4, channels, n)."""
    m = [answer[i // 4, i % 4] for i in range(16)] if dr.is_matrix_v(answer) else []
    each = np.broadcast_arrays(*map(rows, m or [answer]))
    return np.reshape(each, (4, 4, *each[0].shape)) if m else each[0]


def drawn(bsdf: Any, ctx: Any, si: Any, u: Any, active: Any = True) -> Any:
    """Samples and their weights."""
    return bsdf.sample(ctx, si, u.x, mi.Point2f(u.y, u.z), active)


def value(bsdf: Any, ctx: Any, si: Any, wo: Any) -> Any:
    """Channels of `eval`."""
    return rows(bsdf.eval(ctx, si, wo, True))


def density(bsdf: Any, ctx: Any, si: Any, wo: Any) -> Any:
    """Answers of `pdf`, one row."""
    return rows(bsdf.pdf(ctx, si, wo, True))


def lit(weight: Any) -> Any:
    """Whether samples did not fail."""
    return np.any(rows(weight) != 0, axis=0)


def discrete(bs: Any) -> Any:
    """Whether samples are of a lobe of one direction."""
    return np.array(bs.sampled_type) & int(mi.BSDFFlags.Delta) != 0


def smooth(bs: Any, weight: Any) -> Any:
    """Whether samples did not fail and have a density."""
    is_discrete = np.array(bs.sampled_type) & int(mi.BSDFFlags.Delta) != 0
    return np.any(rows(weight) != 0, axis=0) & ~is_discrete


def lit_from(si: Any, wi: Any) -> Any:
    """The same place, lit from other directions."""
    there = type(si)(si)
    there.wi = wi
    return there


def sphere(x: Any, y: Any) -> Any:
    """Directions all around, of numbers in the unit square."""
    return mi.warp.square_to_uniform_sphere(mi.Point2f(x, y))


def parameters(bsdf: Any) -> Any:
    """Parameters of a BSDF, or of the phase function that it asks."""
    return mi.traverse(getattr(bsdf, "phase", bsdf))


def opposite(ctx: Any) -> Any:
    """Context of the other transport mode."""
    modes = mi.TransportMode.Radiance, mi.TransportMode.Importance
    return mi.BSDFContext(modes[ctx.mode == modes[0]], ctx.type_mask, ctx.component)


def lattices(n: int) -> Any:
    """16 lattices of points in the unit square, randomly shifted."""
    shifts = np.random.default_rng(1).random((16, 2, 1))
    return (np.arange(n) * [[1 / n], [0.618034]] + shifts) % 1


def moments(wo: Any) -> Any:
    """1 and the coordinates of directions."""
    return np.array([1 + 0 * np.array(wo.x), *np.array(wo)])


# ------------------------------------------ answers of functions, of one signature


def of_eval(b: Any, ctx: Any, si: Any, wo: Any, _: Any = None, on: Any = True) -> Any:
    """Answer of `eval`."""
    return b.eval(ctx, si, wo, on)


def of_pdf(b: Any, ctx: Any, si: Any, wo: Any, _: Any = None, on: Any = True) -> Any:
    """Answer of `pdf`."""
    return b.pdf(ctx, si, wo, on)


def of_eval_pdf(
    b: Any, ctx: Any, si: Any, wo: Any, _: Any = None, on: Any = True
) -> Any:
    """Value that `eval_pdf` answers."""
    return b.eval_pdf(ctx, si, wo, on)[0]


def of_joint_pdf(
    b: Any, ctx: Any, si: Any, wo: Any, _: Any = None, on: Any = True
) -> Any:
    """Density that `eval_pdf` answers."""
    return b.eval_pdf(ctx, si, wo, on)[1]


def of_weight(b: Any, ctx: Any, si: Any, _: Any, u: Any, on: Any = True) -> Any:
    """Weight of samples."""
    return drawn(b, ctx, si, u, on)[1]


def of_sampled_pdf(b: Any, ctx: Any, si: Any, _: Any, u: Any, on: Any = True) -> Any:
    """Density that `sample` answers."""
    return drawn(b, ctx, si, u, on)[0].pdf


def of_direction(b: Any, ctx: Any, si: Any, _: Any, u: Any, on: Any = True) -> Any:
    """Size of the coordinates of sampled directions."""
    return dr.abs(drawn(b, ctx, si, u, on)[0].wo)


def of_flux(b: Any, ctx: Any, si: Any, _: Any, u: Any, on: Any = True) -> Any:
    """Weight times the density of samples."""
    bs, weight = drawn(b, ctx, si, u, on)
    return weight * bs.pdf


# What is asked of a function, but for others of `eval`.
ANSWERS: dict[Function, Callable[..., Any]] = {
    EVAL: of_eval,
    PDF: of_pdf,
    SAMPLE: of_weight,
    EVAL_PDF: of_eval_pdf,
}


def answer_of(function: Function) -> Callable[..., Any]:
    """What properties ask of a function."""
    return ANSWERS.get(function, of_eval)


# ------------------------------------------- Mueller matrices, (4, 4, channels, n)


def per_first(m: Any) -> Any:
    """Elements over the first one."""
    return m / np.fmax(m[0, 0], 1e-30)


def unsigned(m: Any) -> Any:
    """Elements without signs but for the first; numbers as they are."""
    if m.ndim < 4:
        return m
    sizes = np.abs(m)
    sizes[0, 0] = m[0, 0]
    return sizes


def in_plane(
    what: Any, bsdf: Any, ctx: Any, si: Any, wi: Any, wo: Any, u: Any, normal: Any
) -> Any:
    """The same in frames of k x normal of both beams k; light arrives along -wi."""
    answer, own = what(bsdf, ctx, lit_from(si, wi), wo, u), mi.mueller.stokes_basis
    s, t = (dr.normalize(dr.cross(k, mi.Vector3f(normal))) for k in (-wi, wo))
    turn = mi.mueller.rotate_mueller_basis
    return per_first(np.array(turn(answer, -wi, own(-wi), s, wo, own(wo), t)))

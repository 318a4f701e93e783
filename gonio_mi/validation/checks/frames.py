"""Matrices turn with the directions, without jumps."""

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...array_types import Flags, Floats, Integers, Numbers
from ...collector.directions import angles, direction
from ...collector.stokes import plane_axis, reframed, turn
from ..arrays import Sides, answer_of, drawn, in_plane, lit_from, per_first
from ..conditions import PLACES, TURN
from ..evidence import BIAS, POLARISING, SAME, Evidence, Question
from ..judgements import by_sample
from ..mistakes import EVAL, Claim, Mistake
from ..mueller import (
    Matrices,
    Reading,
    eval_at,
    eval_with_slack,
    flux_of,
    is_identity,
    lobe_slack,
    off,
    per_light,
    readings,
    relative_slack,
    samples_at,
)
from ..samples import ELEMENT_ROUNDING, Samples, beyond_rounding
from .matrices import SAME_DIRECTION


def turned(bsdf: Any, ctx: Any, si: Any, u: Any, what: Any, normal: Any) -> Sides:
    """Matrices are the same where both directions turn about the normal."""
    bs, _ = drawn(bsdf, ctx, si, u)
    rotation = mi.Transform4f().rotate(normal, 37)
    here, there = (
        in_plane(what, bsdf, ctx, si, wi, wo, u, normal)
        for wi, wo in ((si.wi, bs.wo), (rotation @ si.wi, rotation @ bs.wo))
    )
    return here, there, True


def in_the_world(bsdf: Any, ctx: Any, si: Any, u: Any, what: Any) -> Sides:
    """Matrices are the same where the surface is turned in the world."""
    (bs, _), found = drawn(bsdf, ctx, si, u), []
    for normal in ([0, 0, 1], [0.6, 0, 0.8]):
        there = type(si)(si)
        there.sh_frame = mi.Frame3f(normal)
        found.append(per_first(np.array(what(bsdf, ctx, there, bs.wo, u))))
    return found[0], found[1], True


def next_to(bsdf: Any, ctx: Any, si: Any, u: Any, what: Any, *pairs: Any) -> Sides:
    """Matrices do not jump between two pairs of directions next to each other."""
    found = []
    for wi, wo in pairs:
        there = lit_from(si, mi.Vector3f(wi) + dr.zeros(mi.Vector3f, dr.width(u)))
        m = np.array(what(bsdf, ctx, there, mi.Vector3f(wo), u))
        found.append(per_first(m))
    return found[0], found[1], True


FRAMES = Question(
    "frames", __doc__, BIAS, POLARISING, rank=0, alone=True, matrices=SAME
)


class Frames(Mistake):
    """Mistakes in frames."""

    OF_AZIMUTH = """{who} depends on the azimuth of an isotropic surface: its frames are
        turned wrongly"""
    IN_THE_WORLD = "{who} is another matrix where the surface is turned in the world"
    BASES_OF_WORLD = """{who} takes Stokes bases of directions in the world instead of
        those of local directions"""
    JUMP = """{who} jumps{where}: its frames are turned by an angle whose sign or axis
        changes there, as that to an axis which is not perpendicular to the beam"""
    JUMP_OF_PLANE = """{who} jumps{where}: its elements depend on a plane of incidence,
        of which there is none, as where r_p or t_p has the wrong sign"""


# Pairs of directions that are turned, for each thousand samples, and their angles.
N_PAIRS, N_ANGLES = 12, 16

# Polar angle, in degrees, from which paths go through the pole.
STEEP = 80.0

# Kinds of paths, and the length in degrees of the two legs of one through wo = wi.
N_KINDS, LEG = 6, 5.0

# Relative change of the first element up to which it does not depend on the azimuth.
SAME_LIGHT = 0.01

# Fraction of the misfit that a reading leaves which explains it.
EXPLAINED = 0.1

# A change of elements over the first one that is a jump if it stays between directions
# as near to each other as `N_SECTIONS` and `N_ROUNDS` make them.
JUMP = 0.02
N_SECTIONS, N_ROUNDS = 24, 5

# Steps of paths over the sphere that meet the pole.
N_STEPS = 48

# Distance to a pole, or of wo to wi, that only paths through there reach: frames may be
# replaced at some distance.
CLOSE = 0.01

# Where else a jump may lie: what is 0 there.
BORDERS: dict[str, Callable[[Floats], Floats]] = {
    "x = 0": lambda d: np.abs(d[..., 0]),
    "y = 0": lambda d: np.abs(d[..., 1]),
    "|x| = |y|": lambda d: np.abs(np.abs(d[..., 0]) - np.abs(d[..., 1])),
}


def _some(samples: Samples, chosen: Flags) -> Integers:
    """Numbers of a few samples of each type and side, evenly chosen."""
    found = np.flatnonzero(chosen)
    if not len(found):
        return found
    sides = np.sign([samples.wi[found, 2], samples.wo[found, 2]])
    kinds = np.array([*sides, samples.type[found]]).T
    _, group = np.unique(kinds, axis=0, return_inverse=True)
    group = group.ravel()  # in NumPy 2.0.0 it has as many axes as `kinds`
    n = int(group.max()) + 1
    each = max(2, N_PAIRS * samples.n // 1024 // n)
    own = (np.array_split(found[group == k], each) for k in range(n))
    return np.array([x[len(x) // 2] for parts in own for x in parts if len(x)])


def check_turned(
    evidence: Evidence, samples: Samples, normal: Floats, nested: Floats | None
) -> None:
    """Check pairs of directions that are turned together about a surface's normal.

    A tilted surface is that of the first place, where `nested` are its axes, (3, 3).
    """
    from scipy.spatial.transform import Rotation  # slow to import, rarely needed

    step = 2 * np.pi / N_ANGLES
    jitter = np.random.default_rng((evidence.seed, 77)).random(N_ANGLES)
    angle = step * (np.arange(N_ANGLES) + jitter)
    turns = Rotation.from_rotvec(angle[:, None] * normal).as_matrix()
    places = samples.condition.uvs
    for smooth in (True, False):
        asked = samples.smooth if smooth else samples.discrete & ~samples.null
        if nested is not None:
            asked = asked & (places == PLACES[0]).all(axis=-1)
        pairs = _some(samples, asked)
        if not len(pairs):
            continue
        uv = places[pairs, None]
        wi = np.einsum("aij,pj->pai", turns, samples.wi[pairs])
        wo = np.einsum("aij,pj->pai", turns, samples.wo[pairs])
        if smooth:
            matrices, slack = eval_with_slack(evidence.bsdf, wi, wo, uv)
            usable = matrices.lit & matrices.finite
        else:
            random = np.broadcast_to(samples.u[pairs, None], wi.shape)
            turned = samples_at(evidence.bsdf, wi, random, uv)
            matrices = flux_of(turned, *wi.shape[:2])
            slack = lobe_slack(evidence.bsdf, turned).reshape(wi.shape[:2])
            kind = (turned.type * turned.discrete).reshape(slack.shape)
            usable = (kind > 0) & (kind == kind[:, :1])
            # a discrete lobe turns with its source
            usable &= np.abs(matrices.wo - wo).max(-1) < SAME_DIRECTION
        same = np.asarray(usable.all(axis=1))
        if same.any():
            found = matrices.take(same), slack[same]
            _check_azimuth(evidence, *found, normal, nested)


def _check_azimuth(
    evidence: Evidence,
    matrices: Matrices,
    slack: Floats,
    normal: Floats,
    nested: Floats | None,
) -> None:
    """Check that matrices, (pairs, angles), do not depend on a common azimuth.

    For an anisotropic surface, it is a mistake only if another reading of the matrices
    makes them independent of the azimuth.
    """
    misfit = _misfit(matrices.in_plane(normal))
    wrong = misfit > 2 * slack.max(axis=1)
    if not wrong.any():
        return
    worst = int(np.argmax(np.where(wrong, misfit, 0)))
    mistake = _explained(matrices.take(wrong), misfit[wrong], normal, nested)
    declared = int(evidence.bsdf.flags()) & int(mi.BSDFFlags.Anisotropic)
    light = matrices.light
    same_light = (np.ptp(light, axis=1) <= SAME_LIGHT * light.max(axis=1)).all()
    if mistake is None and (declared or not same_light):
        text = "anisotropic, so that only jumps of its frames are seen"
        evidence.remark("frames", text)
        return
    guess = (mistake or Frames.OF_AZIMUTH)(matrices.function, mode="")
    text = f"elements over the first change by up to {misfit[worst]:.3g} where both "
    text += "directions turn about the normal,"
    how: dict[str, Any] = {"size": float(misfit[worst]), "off": float(wrong.mean())}
    given = answer_of(matrices.function), normal.round(9).tolist()
    how |= {"found": text, "shown": Claim(turned, by_sample, given)}
    evidence.breach(FRAMES, guess, matrices.condition((worst, 0)), **how)


def _misfit(in_plane: Floats) -> Floats:
    """Largest change of elements over the first one with the angle, by pair."""
    m = per_light(in_plane)
    return off(m, m.mean(axis=1, keepdims=True)).max(axis=1)


def _explained(
    matrices: Matrices, misfit: Floats, normal: Numbers, nested: Numbers | None
) -> Reading | None:
    """Mistake that explains why the matrices depend on the angle, or None."""
    if is_identity(per_light(matrices.raw)):
        return Reading.IDENTITY
    found = {
        mistake: _handedness(in_plane, normal, *matrices.beams)
        for mistake, in_plane in readings(matrices, normal, nested)
        if np.max(_misfit(in_plane) / misfit) < EXPLAINED
    }
    # of several the one by which facets would mirror light as they do
    return min(found, key=lambda mistake: round(found[mistake], 3), default=None)


def _handedness(
    in_plane: Floats, normal: Numbers, k_in: Floats, k_out: Floats
) -> float:
    """Size of elements that mirror symmetry about the plane of both beams forbids."""
    s = np.cross(k_in, k_out)
    length = np.linalg.norm(s, axis=-1, keepdims=True)
    s = np.where(length > 0, s, 0) / np.where(length > 0, length, 1)
    turns = (turn(k, plane_axis(k, normal), s)[..., None, :, :] for k in (k_in, k_out))
    m = per_light(reframed(in_plane, *turns))
    return float(np.abs(m[..., :2, 2:]).mean() + np.abs(m[..., 2:, :2]).mean())


def check_world(evidence: Evidence, samples: Samples) -> None:
    """Check the same pairs of directions on a surface that is turned in the world."""
    bsdf, uv = evidence.bsdf, samples.condition.uvs
    here = Matrices.of(samples, EVAL, samples.full("eval"))
    there = eval_at(bsdf, here.wi, here.wo, uv, turned=True)
    slack = relative_slack(samples.eval_slack, samples.eval)
    _compare(evidence, here, there, samples.usable, slack)
    lobes = samples_at(bsdf, samples.wi, samples.u, uv, turned=True)
    same = samples.given & lobes.given & (lobes.type == samples.type)
    same &= np.abs(lobes.wo - samples.wo).max(-1) < SAME_DIRECTION
    slack = lobe_slack(bsdf, samples)
    _compare(evidence, flux_of(samples), flux_of(lobes), same, slack)


def _compare(
    evidence: Evidence, here: Matrices, there: Matrices, asked: Flags, slack: Floats
) -> None:
    """Check that matrices do not change where the surface is turned in the world.

    Where light changes as well, the model depends on its place in the world.
    """
    m, turned = per_light(here.raw), per_light(there.raw)
    size = np.where(asked, np.nan_to_num(off(m, turned)), 0.0)
    change = np.abs(there.light - here.light)
    same_light = (change <= SAME_LIGHT * here.light).all(axis=-1)
    wrong = same_light & (size > ELEMENT_ROUNDING + slack)
    if not beyond_rounding(wrong):
        return
    worst = int(np.argmax(np.where(wrong, size, 0)))
    due = per_light(here.in_plane()[wrong])
    world = reframed(there.raw, *there.turns(axes=TURN.T))[wrong]
    mistake = Frames.IN_THE_WORLD
    if off(per_light(world), due).mean() < EXPLAINED * size[wrong].mean():
        mistake = Frames.BASES_OF_WORLD
    text = f"elements over the first change by up to {size[worst]:.3g} where the "
    text += "surface is turned in the world,"
    how: dict[str, Any] = {"size": float(size[worst]), "off": float(wrong.mean())}
    what = answer_of(here.function)
    how |= {"found": text, "shown": Claim(in_the_world, by_sample, (what,))}
    evidence.breach(FRAMES, mistake(here.function), here.condition((worst,)), **how)


# ------------------------------------------------------------------------------- jumps


def check_jumps(evidence: Evidence, samples: Samples) -> None:
    """Check paths of one or both directions over the sphere."""
    bsdf, places = evidence.bsdf, samples.condition.uvs
    pairs = _some(samples, samples.smooth)
    if len(pairs):
        wi, wo, uv = samples.wi[pairs], samples.wo[pairs], places[pairs]

        def _eval_along(paths: Numbers, at: Floats) -> tuple[Matrices, Numbers]:
            pair, kind = paths // N_KINDS, paths % N_KINDS
            at_wi, at_wo = wi[pair], wo[pair]
            straight = _through(at_wi, at_wo, at)
            at_wo = np.where((kind == 5)[..., None], straight, at_wo)
            # both around, wi around, wo around, wi over the pole, wo over it
            at_wi = _moved(at_wi, at, kind <= 1, kind == 3)
            at_wo = _moved(at_wo, at, (kind == 0) | (kind == 2), kind == 4)
            return eval_at(bsdf, at_wi, at_wo, uv[pair]), np.zeros(at.shape)

        _check_paths(evidence, _eval_along, N_KINDS * len(pairs))
    lobes = _some(samples, samples.discrete)
    if len(lobes):
        lit, random, uv = samples.wi[lobes], samples.u[lobes], places[lobes]

        def _sample_along(paths: Numbers, at: Floats) -> tuple[Matrices, Numbers]:
            which, kind = paths // 2, paths % 2
            moved = _moved(lit[which], at, kind == 0, kind == 1)
            found = samples_at(bsdf, moved, random[which], uv[which])
            kinds = found.type * found.discrete * np.sign(found.wo[:, 2])
            return flux_of(found, *at.shape), kinds.reshape(at.shape)

        _check_paths(evidence, _sample_along, 2 * len(lobes))


def _moved(d: Floats, places: Floats, around: Flags, over: Flags) -> Floats:
    """Directions turned about the normal or moved over the pole, or unchanged."""
    theta, phi = angles(d)
    z = np.sign(d[..., 2])
    turned = direction(theta, phi + 2 * np.pi * places)
    steep = np.radians(STEEP) * (2 * places - 1)
    led = direction(np.abs(steep), np.where(steep < 0, phi + np.pi, phi))
    led[..., 2] *= z
    d = np.broadcast_to(d, turned.shape)
    return np.where(around[..., None], turned, np.where(over[..., None], led, d))


def _through(wi: Floats, wo: Floats, places: Floats) -> Floats:
    """Directions wo of paths through wi, or through -wi of light that is transmitted.

    The path turns there by 45 degrees, between whose sides all errors of signs differ.
    """
    middle = wi * np.sign(wi[..., 2:] * wo[..., 2:])
    s = plane_axis(middle)
    other = (s + np.cross(middle, s)) / np.sqrt(2)
    leg = np.where(places[..., None] < 0.5, s, other)
    angle = np.radians(LEG) * np.abs(2 * places - 1)[..., None]
    return np.asarray(np.cos(angle) * middle + np.sin(angle) * leg)


def _check_paths(
    evidence: Evidence,
    path: Callable[[Numbers, Floats], tuple[Matrices, Numbers]],
    n_paths: int,
) -> None:
    """Check that elements over the first do not jump along closed paths of directions.

    Parameters
    ----------
    evidence : Evidence
    path : callable
        Takes numbers of paths and places on them in [0, 1), of shape (n, m); returns
        matrices, and labels that two of them must share to be compared.
    n_paths : int
    """
    paths = np.repeat(np.arange(n_paths), N_STEPS)
    start = np.tile(np.arange(N_STEPS) / N_STEPS, n_paths)
    length = 1 / N_STEPS
    for i in range(N_ROUNDS):
        sections = 1 if i == 0 else N_SECTIONS
        places = start[:, None] + length * np.arange(sections + 1) / sections
        matrices, kind = path(np.broadcast_to(paths[:, None], places.shape), places)
        change = _changes(matrices, kind)
        row, column = np.nonzero(change > JUMP)
        if not len(row):
            return
        # the largest of each path
        order = np.argsort(-change[row, column], kind="stable")
        _, first = np.unique(paths[row[order]], return_index=True)
        row, column = row[order[first]], column[order[first]]
        length /= sections
        paths, start = paths[row], places[row, column]
    size = change[row, column]
    worst = int(np.argmax(size))
    at = (row[worst], column[worst])
    where, condition = _border(matrices, at), matrices.condition(at)
    mistake = Frames.JUMP_OF_PLANE if _straight(matrices, at) else Frames.JUMP
    place = where and f" {where}"
    both = (row[worst], slice(at[1], at[1] + 2))
    # single precision is a number of nine digits
    wi, wo = (
        [[float(f"{x:.9g}") for x in d] for d in directions[both].astype(np.float32)]
        for directions in (matrices.wi, matrices.wo)
    )
    guess = mistake(matrices.function, where=place)
    text = f"elements over the first jump by {size[worst]:.3g} {where or 'at'} "
    text += f"({condition}), on {len(size)} of {n_paths} paths over the sphere"
    how: dict[str, Any] = {"size": float(size[worst]) / 2, "off": len(size) / n_paths}
    given = answer_of(matrices.function), *zip(wi, wo)
    how["shown"] = Claim(next_to, by_sample, given)
    evidence.breach(FRAMES, guess, condition, statistic=text, **how)


def _changes(matrices: Matrices, kind: Numbers) -> Floats:
    """Change of elements over the first one between places; 0 without light."""
    m, lit = per_light(matrices.raw), matrices.lit & matrices.finite
    both = lit[:, 1:] & lit[:, :-1] & (kind[:, 1:] == kind[:, :-1])
    # light that jumps as well is another matter
    light = matrices.light
    steady = np.abs(light[:, 1:] - light[:, :-1]).max(-1) <= (
        0.5 * np.maximum(light[:, 1:], light[:, :-1]).max(-1)
    )
    change = off(m[:, 1:], m[:, :-1])
    return np.where(both & steady, np.nan_to_num(change), 0.0)


def _border(matrices: Matrices, at: tuple[int, int]) -> str:
    """Name of the place where the jump after a pair lies; empty if it has none."""
    wi, wo = matrices.wi[at], matrices.wo[at]
    if any(np.hypot(d[0], d[1]) < CLOSE for d in (wi, wo)):
        return "at the pole"
    if straight := _straight(matrices, at):
        return f"where {straight}"
    for name, distance in BORDERS.items():
        for which, d in (("wi", wi), ("wo", wo)):
            if distance(d) < 1e-5:
                text = name.replace("x", f"{which}.x").replace("y", f"{which}.y")
                return f"over {text}"
    return ""


def _straight(matrices: Matrices, at: tuple[int, int]) -> str:
    """Where light goes on or back the same way, nearly; empty if it does not.

    A discrete lobe may go straight on from everywhere.
    """
    wi, wo = matrices.wi[at], matrices.wo[at]
    if np.linalg.norm(wo - wi) < 2 * CLOSE:
        return "wo = wi"
    on = matrices.function is EVAL and np.linalg.norm(wo + wi) < 2 * CLOSE
    return "wo = -wi" if on else ""

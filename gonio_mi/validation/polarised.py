"""The examination of a BSDF in a polarised variant: of Mueller matrices.

What the first elements do by themselves, such as the density of samples, the
unpolarised variant judges.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import mitsuba as mi
import numpy as np

from ..array_types import Flags, Floats, Integers, Numbers
from ..collector.directions import angles, direction
from ..collector.stokes import UPRIGHT, plane_axis
from ..specimen.loading import loaded
from .checks import answers, energy, frames
from .checks.consistency import check_sweep
from .checks.matrices import SAME_DIRECTION
from .conditions import PLACES, Condition, Effort, Given, Sweep, sides_of
from .evidence import Evidence
from .mistakes import EVAL
from .mueller import (
    Matrices,
    eval_at,
    eval_with_slack,
    flux_of,
    is_depolarised,
    lobe_slack,
    per_light,
    relative_slack,
    samples_at,
)
from .probe import Probe, uniform
from .samples import Samples, drawn_samples, samples_of

# Pairs of directions that are turned, for each thousand samples, and their angles.
N_PAIRS, N_ANGLES = 12, 16

# Polar angle, in degrees, from which paths go through the pole.
STEEP = 80.0

# Kinds of paths, and the length in degrees of the two legs of one through wo = wi.
N_KINDS, LEG = 6, 5.0

# Plugins that tilt the frame of a nested BSDF.
TILTING = ("normalmap", "bumpmap")


def examine_polarised(evidence: Evidence, plan: Effort, specimen: Any) -> None:
    """Run all checks of matrices.

    Parameters
    ----------
    evidence : Evidence
    plan : Effort
    specimen : object
        As of :func:`gonio_mi.validate`.
    """
    bsdf, sides, key = evidence.bsdf, sides_of(evidence.bsdf), (evidence.seed, 77)
    sweep = Sweep(side=sides[0], both=len(sides) > 1, n=plan.lanes)
    for asked in (sweep, replace(sweep, mode="radiance")):
        samples = samples_of(bsdf, asked, sweep.n, key)
        evidence.samples.append(samples)
        # where importance mode contradicts itself, nothing is due in radiance mode
        if not any(map(evidence.of, answers.AGREEMENTS)):
            evidence.ask("samples", samples)
        evidence.ask("matrices", samples)
    evidence.ask("bsdf")
    samples = evidence.samples[0]
    _check_straight(evidence, samples)
    _remark_on_light(evidence, samples)
    pairs = _Pairs(evidence, samples, np.random.default_rng(key))
    normal, nested = _axes(specimen)
    pairs.check_turned(normal, nested)
    pairs.check_jumps()
    if not evidence.of("frames"):
        pairs.check_world()
    if not any(map(evidence.of, answers.AGREEMENTS)):
        check_sweep(evidence, plan, sides)
    _check_energy(evidence, list(plan.checks(sides, ())), sweep.n // 2, key)


def _check_energy(
    evidence: Evidence, conditions: Sequence[Condition], n: int, key: tuple[int, ...]
) -> None:
    """Check the flux of `n` samples of each incident direction, drawn together."""
    wi, uv = (
        np.repeat([getattr(one, name) for one in conditions], n, axis=0)
        for name in ("wi", "uv")
    )
    probe = Probe(evidence.bsdf, Given(lit_by=wi, at=uv))
    samples = drawn_samples(probe, *uniform(len(wi), key))
    for i, condition in enumerate(conditions):
        own = samples.select(np.s_[i * n : (i + 1) * n])
        energy.check_gain(evidence, replace(own, condition=condition))


def _check_straight(evidence: Evidence, samples: Samples) -> None:
    """Check that matrices are finite where wo is wi or -wi.

    There the three directions of a plane of incidence are one line.
    """
    for straight in (samples.wi, -samples.wi):
        found = eval_at(evidence.bsdf, samples.wi, straight, samples.condition.uvs)
        wrong = answers.improper(found.raw)
        if wrong.any():
            fields = {"what": "value", "value": answers.example(found.raw[wrong])}
            guess = answers.Answers.IMPROPER_IN_PLACES(EVAL, **fields)
            how = {"found": "where wo is wi or -wi,", "off": None}
            evidence.breach(answers.ANSWERS, guess, samples, wrong, **how)


def _remark_on_light(evidence: Evidence, samples: Samples) -> None:
    """Note where no light is scattered, or none keeps its polarisation."""
    usable = ("eval", samples.usable), ("weight", samples.given)
    answered = [samples.full(name)[mask] for name, mask in usable]
    if sum(map(len, answered)) == 0:
        text = "no light was scattered, so that nothing was compared"
        names = (question.name for question in evidence.questions[1:])
        evidence.undecided |= dict.fromkeys(names, text)
    elif all(is_depolarised(per_light(raw)) for raw in answered):
        evidence.note = (
            "but it depolarises all light: there is no polarisation to be judged"
        )
        text = "all matrices have the first element only: light leaves unpolarised"
        if (samples.discrete & ~samples.null).any():
            text += ", by discrete lobes too, where a smooth surface polarises it"
        evidence.remark("realisable", text)


class _Pairs:
    """Checks of pairs of directions beside samples, whose answers are known."""

    def __init__(
        self, evidence: Evidence, samples: Samples, rng: np.random.Generator
    ) -> None:
        self.evidence, self.bsdf = evidence, evidence.bsdf
        self.samples, self.rng = samples, rng
        self.uv = samples.condition.uvs

    def check_turned(self, normal: Floats, nested: Floats | None) -> None:
        """Check pairs of directions that are turned together.

        A tilted surface is that of the first place, where `nested` are its axes.
        """
        from scipy.spatial.transform import Rotation  # slow to import, rarely needed

        angle = 2 * np.pi * (np.arange(N_ANGLES) + self.rng.random(N_ANGLES)) / N_ANGLES
        turns = Rotation.from_rotvec(angle[:, None] * normal).as_matrix()
        samples = self.samples
        for smooth in (True, False):
            asked = samples.smooth if smooth else samples.discrete & ~samples.null
            if nested is not None:
                asked = asked & (self.uv == PLACES[0]).all(axis=-1)
            pairs = self._some(asked)
            if not len(pairs):
                continue
            uv = self.uv[pairs, None]
            wi = np.einsum("aij,pj->pai", turns, samples.wi[pairs])
            wo = np.einsum("aij,pj->pai", turns, samples.wo[pairs])
            if smooth:
                matrices, slack = eval_with_slack(self.bsdf, wi, wo, uv)
                usable = matrices.lit & matrices.finite
            else:
                random = np.broadcast_to(samples.u[pairs, None], wi.shape)
                turned = samples_at(self.bsdf, wi, random, uv)
                matrices = flux_of(turned, *wi.shape[:2])
                slack = lobe_slack(self.bsdf, turned).reshape(wi.shape[:2])
                kind = (turned.type * turned.discrete).reshape(slack.shape)
                usable = (kind > 0) & (kind == kind[:, :1])
                # a discrete lobe turns with its source
                usable &= np.abs(matrices.wo - wo).max(-1) < SAME_DIRECTION
            same = np.asarray(usable.all(axis=1))
            found = matrices.take(same), slack[same]
            frames.check_turned(self.evidence, *found, normal, nested)

    def _some(self, chosen: Flags) -> Integers:
        """Indices of a few samples of each type and side, evenly chosen."""
        found = np.flatnonzero(chosen)
        if not len(found):
            return found
        samples = self.samples
        sides = np.sign([samples.wi[found, 2], samples.wo[found, 2]])
        kinds = np.array([*sides, samples.type[found]]).T
        _, group = np.unique(kinds, axis=0, return_inverse=True)
        group = group.ravel()  # in NumPy 2.0.0 it has as many axes as `kinds`
        n = int(group.max()) + 1
        each = max(2, N_PAIRS * samples.n // 1024 // n)
        own = (np.array_split(found[group == k], each) for k in range(n))
        return np.array([x[len(x) // 2] for parts in own for x in parts if len(x)])

    def check_jumps(self) -> None:
        """Check paths of one or both directions over the sphere."""
        lobes = self.samples
        pairs = self._some(lobes.smooth)
        if len(pairs):
            wi, wo, uv = lobes.wi[pairs], lobes.wo[pairs], self.uv[pairs]

            def _eval_along(paths: Numbers, places: Floats) -> tuple[Matrices, Numbers]:
                pair, kind = paths // N_KINDS, paths % N_KINDS
                at_wi, at_wo = wi[pair], wo[pair]
                straight = _through(at_wi, at_wo, places)
                at_wo = np.where((kind == 5)[..., None], straight, at_wo)
                # both around, wi around, wo around, wi over the pole, wo over it
                at_wi = _moved(at_wi, places, kind <= 1, kind == 3)
                at_wo = _moved(at_wo, places, (kind == 0) | (kind == 2), kind == 4)
                found = eval_at(self.bsdf, at_wi, at_wo, uv[pair])
                return found, np.zeros(places.shape)

            frames.check_jumps(self.evidence, _eval_along, N_KINDS * len(pairs))
        pairs = self._some(lobes.discrete)
        if len(pairs):
            lit, random, at = (x[pairs] for x in (lobes.wi, lobes.u, self.uv))

            def _sample_along(
                paths: Numbers, places: Floats
            ) -> tuple[Matrices, Numbers]:
                which, kind = paths // 2, paths % 2
                moved = _moved(lit[which], places, kind == 0, kind == 1)
                found = samples_at(self.bsdf, moved, random[which], at[which])
                kinds = found.type * found.discrete * np.sign(found.wo[:, 2])
                return flux_of(found, *places.shape), kinds.reshape(places.shape)

            frames.check_jumps(self.evidence, _sample_along, 2 * len(pairs))

    def check_world(self) -> None:
        """Check the same pairs of directions on a surface that is turned."""
        samples, turned = self.samples, {"turned": True}
        here = Matrices.of(samples, EVAL, samples.full("eval"))
        there = eval_at(self.bsdf, here.wi, here.wo, self.uv, **turned)
        slack = relative_slack(samples.eval_slack, samples.eval)
        frames.check_world(self.evidence, here, there, samples.usable, slack)
        lobes = samples_at(self.bsdf, samples.wi, samples.u, self.uv, **turned)
        same = samples.given & lobes.given & (lobes.type == samples.type)
        same &= np.abs(lobes.wo - samples.wo).max(-1) < SAME_DIRECTION
        slack = lobe_slack(self.bsdf, samples)
        frames.check_world(self.evidence, flux_of(samples), flux_of(lobes), same, slack)


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


def _axes(specimen: Any) -> tuple[Floats, Floats | None]:
    """Normal of the scattering surface, and axes of a nested BSDF that is tilted.

    At the first place. A mirror instead of the nested BSDF shows where its normal is.
    """
    if not (isinstance(specimen, dict) and specimen.get("type") in TILTING):
        return UPRIGHT, None
    mirrored = dict(specimen)
    for key, value in specimen.items():
        part = value
        if isinstance(value, dict):
            part = loaded("the nested BSDF", mi.load_dict, value)
        if isinstance(part, mi.BSDF):
            mirrored[key] = {"type": "conductor"}
    tilted = loaded("the specimen", mi.load_dict, mirrored)
    lobes = samples_at(tilted, UPRIGHT[None], np.full((1, 3), 0.5), np.array(PLACES[0]))
    if not lobes.given.any():
        return UPRIGHT, None
    normal = UPRIGHT + lobes.wo[0]
    normal /= np.linalg.norm(normal)
    s = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    s /= np.linalg.norm(s)
    return normal, np.column_stack([s, np.cross(normal, s), normal])

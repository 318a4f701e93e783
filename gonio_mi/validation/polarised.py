"""The examination of a BSDF in a polarised variant: of Mueller matrices.

What the first elements do by themselves, such as the density of samples, the
unpolarised variant judges.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mitsuba as mi
import numpy as np

from ..array_types import Flags, Floats, Integers, Numbers
from ..collector.directions import angles, direction
from ..collector.stokes import UPRIGHT, plane_axis
from ..specimen.loading import loaded
from .checks import energy, first_element, frames, matrices, realisable
from .conditions import FIELDS, N_SPOTS, PLACES, sides_of, surroundings
from .evidence import Evidence
from .mueller import (
    Lobes,
    Matrices,
    MuellerProbe,
    is_depolarised,
    lit_directions,
    per_light,
    slack_of,
)
from .samples import ULPS

# Directions and samples by effort, and their number of pairs that are turned.
SIZES = {"quick": 1, "normal": 4, "thorough": 16}
N_SAMPLES, N_PAIRS, N_ANGLES = 1024, 12, 16

# Samples for the flux of each of some incident directions.
N_LIT, N_FLUX = 6, 512

# Numbers that choose a lobe on the way back.
CHOICES = (0.01, 0.05, 0.15, 0.35, 0.65, 0.85, 0.95, 0.99)

# Of cosines between two directions that are the same.
SAME_DIRECTION = 1e-3

# Polar angle, in degrees, from which paths go through the pole.
STEEP = 80.0

# Kinds of paths, and the length in degrees of the two legs of one through wo = wi.
N_KINDS, LEG = 6, 5.0

# Plugins that tilt the frame of a nested BSDF.
TILTING = ("normalmap", "bumpmap")


def examine_polarised(
    evidence: Evidence, effort: str, specimen: Any, load: Callable[[], mi.BSDF] | None
) -> int:
    """Run all checks and return the number of answers that they asked for.

    Parameters
    ----------
    evidence : Evidence
    effort : str
    specimen : object
        As of :func:`gonio_mi.validate`.
    load : callable or None
        Loads the same BSDF in the variant that is set.
    """
    examination = _Examination(evidence, SIZES[effort])
    examination.check_pairs(load)
    normal, nested = _axes(specimen)
    examination.check_turned(normal, nested)
    examination.check_jumps()
    if not evidence.of("frames"):
        examination.check_world()
    if not any(map(evidence.of, matrices.AGREEMENTS)):
        examination.check_fields()
    examination.check_energy()
    probes = (examination.importance, examination.radiance, examination.turned)
    return sum(probe.n_asked for probe in probes)


class _Examination:
    """Directions, the BSDF's answers about them, and checks of both."""

    def __init__(self, evidence: Evidence, size: int) -> None:
        self.evidence, self.size = evidence, size
        self.rng = np.random.default_rng((evidence.seed, 77))
        bsdf = evidence.bsdf
        self.importance = MuellerProbe(bsdf)
        self.radiance = MuellerProbe(bsdf, "radiance")
        self.turned = MuellerProbe(bsdf, turned=True)
        # +1 the front
        self.sides = [1 if side == "front" else -1 for side in sides_of(bsdf)]
        n = N_SAMPLES * size
        self.wi = lit_directions(self.rng, n, self.sides)
        self.random = self.rng.random((n, 3))
        self.uv = np.resize(PLACES, (n, 2))
        # where samples are discrete any other direction does
        self.other = lit_directions(self.rng, n, self.sides[::-1])
        self.lobes, self.values, self.slack = self._asked(self.importance, self.uv)

    def _asked(self, probe: MuellerProbe, uv: Floats) -> tuple[Lobes, Matrices, Floats]:
        """Samples, and matrices of their directions or of others, with slack."""
        lobes = probe.sample(self.wi, self.random, uv)
        wo = np.where(lobes.smooth[:, None], lobes.weights.wo, self.other)
        return lobes, *probe.eval_with_slack(self.wi, wo, uv)

    def check_pairs(self, load: Callable[[], mi.BSDF] | None) -> None:
        """Check single pairs of directions."""
        evidence, lobes, wi, uv = self.evidence, self.lobes, self.wi, self.uv
        matrices.check_finite(evidence, lobes.weights)
        values, slack, wo = self.values, self.slack, self.values.wo
        matrices.check_finite(evidence, values)
        # where the three directions of a plane of incidence are one line
        for straight in (wi, -wi):
            found = self.importance.eval(wi, straight, uv)
            matrices.check_finite(evidence, found, " where wo is wi or -wi,")
        smooth = values.lit & values.finite
        realisable.check_matrices(evidence, values, smooth)
        # what is wrong with `eval` is with the weights that are made of it
        smooth_too = not evidence.of("realisable")
        asked = lobes.given if smooth_too else lobes.delta
        realisable.check_matrices(evidence, lobes.weights, asked)
        self._check_agreement(self.importance, lobes, values, slack)
        if smooth.any():
            back, back_slack = self.importance.eval_with_slack(wo, wi, uv)
            both = slack + back_slack
            matrices.check_reciprocity(evidence, values, back, both)
            other_mode = self.radiance.eval(wi, wo, uv)
            matrices.check_finite(evidence, other_mode)
            matrices.check_adjoint(evidence, other_mode, back, both)
        if lobes.delta.any():
            self._check_returns()
        seen, radiance, slack = self._asked(self.radiance, uv)
        matrices.check_finite(evidence, seen.weights)
        # where importance mode contradicts itself, nothing is due in radiance mode
        if not any(map(evidence.of, matrices.AGREEMENTS)):
            self._check_agreement(self.radiance, seen, radiance, slack)
        first_element.check_first_element(
            evidence, load, [(values, lobes), (radiance, seen)], self.random
        )
        answered = (values.raw[smooth], lobes.weights.raw[lobes.given])
        if sum(map(len, answered)) == 0:
            text = "no light was scattered, so that nothing was compared"
            names = (question.name for question in evidence.questions[1:])
            evidence.undecided |= dict.fromkeys(names, text)
        elif all(is_depolarised(per_light(raw)) for raw in answered):
            evidence.note = (
                "but it depolarises all light: there is no polarisation to be judged"
            )
            text = "all matrices have the first element only: light leaves unpolarised"
            if (lobes.delta & ~lobes.null).any():
                text += ", by discrete lobes too, where a smooth surface polarises it"
            evidence.remark("realisable", text)

    def _check_agreement(
        self, probe: MuellerProbe, lobes: Lobes, values: Matrices, slack: Floats
    ) -> None:
        """Check that the functions agree about pairs of directions in one mode."""
        smooth = values.lit & values.finite
        if smooth.any():
            pairs = values.wi, values.wo, values.uv
            pdf = probe.pdf(*pairs)
            matrices.check_sampled(self.evidence, lobes, values, pdf, slack)
            joint = probe.eval_pdf(*pairs)
            matrices.check_eval_pdf(self.evidence, values, pdf, *joint, smooth)

    def check_fields(self) -> None:
        """Check agreement where each pair has other fields of its interaction.

        What fails is told of one field, if that alone fails.
        """
        breaches = self.evidence.breaches
        n, of_all = len(breaches), breaches[:0]
        for fields in (FIELDS, *((one,) for one in FIELDS)):
            probe = MuellerProbe(self.evidence.bsdf, fields=fields)
            uv = surroundings()["uv"][np.arange(len(self.wi)) % N_SPOTS]
            uv = uv if "uv" in fields else self.uv
            self._check_agreement(probe, *self._asked(probe, uv))
            found = breaches[n:]
            if bool(found) != (fields is FIELDS):
                break  # nothing, or one field
            of_all, breaches[n:] = of_all or found, []
        breaches.extend(of_all * (len(breaches) == n))

    def _check_returns(self) -> None:
        """Check discrete lobes on the way back, and in radiance mode."""
        lobes = self.lobes
        chosen = np.flatnonzero(lobes.delta)[: 256 * self.size]
        there, random = lobes.weights.take(chosen), self.random[chosen]
        # the same lobe, for any of some choices, in both directions
        choices = np.repeat(random[:, None], len(CHOICES), axis=1)
        choices[..., 0] = CHOICES
        wi = np.broadcast_to(there.wo[:, None], choices.shape)
        returned = self.importance.sample(wi, choices, there.uv[:, None])
        same = returned.delta & (returned.type == lobes.type[chosen, None])
        same &= np.abs(returned.weights.wo - there.wi[:, None]).max(-1) < SAME_DIRECTION
        which = same.argmax(axis=1)
        back = returned.weights.take((np.arange(len(chosen)), which))
        slack = self._slack_of_lobes(there.wi, random, there.uv)
        slack = np.where(same.any(axis=1), slack, np.inf)
        matrices.check_reciprocity(self.evidence, there, back, slack)
        radiance = self.radiance.sample(there.wi, random, there.uv)
        matrices.check_finite(self.evidence, radiance.weights)
        known = radiance.delta & (radiance.type == lobes.type[chosen])
        slack = np.where(known, slack, np.inf)
        matrices.check_adjoint(self.evidence, radiance.weights, back, slack)

    def _slack_of_lobes(self, wi: Floats, random: Floats, uv: Floats) -> Floats:
        """Slack for rounding of elements of weights over the first one."""
        steps = ULPS * (2 * self.rng.random((2, *wi.shape)) - 1)
        moved = wi + np.concatenate([np.zeros((1, *wi.shape)), steps])
        lobes = self.importance.sample(moved, np.broadcast_to(random, moved.shape), uv)
        return slack_of(per_light(lobes.weights.raw))

    def check_turned(self, normal: Floats, nested: Floats | None) -> None:
        """Check pairs of directions that are turned together.

        A tilted surface is that of the first place, where `nested` are its axes.
        """
        from scipy.spatial.transform import Rotation  # slow to import, rarely needed

        angle = 2 * np.pi * (np.arange(N_ANGLES) + self.rng.random(N_ANGLES)) / N_ANGLES
        turns = Rotation.from_rotvec(angle[:, None] * normal).as_matrix()
        lobes = self.lobes
        for smooth in (True, False):
            asked = lobes.smooth if smooth else lobes.delta & ~lobes.null
            if nested is not None:
                asked = asked & (self.uv == PLACES[0]).all(axis=-1)
            pairs = self._some(asked)
            if not len(pairs):
                continue
            uv = self.uv[pairs, None]
            wi = np.einsum("aij,pj->pai", turns, self.wi[pairs])
            wo = np.einsum("aij,pj->pai", turns, lobes.weights.wo[pairs])
            if smooth:
                matrices, slack = self.importance.eval_with_slack(wi, wo, uv)
                usable = matrices.lit & matrices.finite
            else:
                random = np.broadcast_to(self.random[pairs, None], wi.shape)
                turned = self.importance.sample(wi, random, uv)
                matrices = turned.flux
                slack = self._slack_of_lobes(wi, random, uv)
                usable = turned.delta & (turned.type == turned.type[:, :1])
                # a discrete lobe turns with its source
                usable &= np.abs(matrices.wo - wo).max(-1) < SAME_DIRECTION
            same = np.asarray(usable.all(axis=1))
            found = matrices.take(same), slack[same]
            frames.check_turned(self.evidence, *found, normal, nested)

    def _some(self, chosen: Flags) -> Integers:
        """Indices of a few samples of each type and side."""
        found = np.flatnonzero(chosen)
        if not len(found):
            return found
        sides = np.sign([self.wi[found, 2], self.lobes.weights.wo[found, 2]])
        kinds = np.array([*sides, self.lobes.type[found]]).T
        _, group = np.unique(kinds, axis=0, return_inverse=True)
        group = group.ravel()  # in NumPy 2.0.0 it has as many axes as `kinds`
        n = int(group.max()) + 1
        each = max(2, N_PAIRS * self.size // n)
        return np.concatenate([found[group == k][:each] for k in range(n)])

    def check_jumps(self) -> None:
        """Check paths of one or both directions over the sphere."""
        lobes = self.lobes
        pairs = self._some(lobes.smooth)
        if len(pairs):
            wi, wo, uv = self.wi[pairs], lobes.weights.wo[pairs], self.uv[pairs]

            def _eval_along(paths: Numbers, places: Floats) -> tuple[Matrices, Numbers]:
                pair, kind = paths // N_KINDS, paths % N_KINDS
                at_wi, at_wo = wi[pair], wo[pair]
                straight = _through(at_wi, at_wo, places)
                at_wo = np.where((kind == 5)[..., None], straight, at_wo)
                # both around, wi around, wo around, wi over the pole, wo over it
                at_wi = _moved(at_wi, places, kind <= 1, kind == 3)
                at_wo = _moved(at_wo, places, (kind == 0) | (kind == 2), kind == 4)
                found = self.importance.eval(at_wi, at_wo, uv[pair])
                return found, np.zeros(places.shape)

            frames.check_jumps(self.evidence, _eval_along, N_KINDS * len(pairs))
        samples = self._some(lobes.delta)
        if len(samples):
            lit, random, at = (x[samples] for x in (self.wi, self.random, self.uv))

            def _sample_along(
                paths: Numbers, places: Floats
            ) -> tuple[Matrices, Numbers]:
                which, kind = paths // 2, paths % 2
                moved = _moved(lit[which], places, kind == 0, kind == 1)
                found = self.importance.sample(moved, random[which], at[which])
                kinds = found.type * found.delta * np.sign(found.weights.wo[..., 2])
                return found.flux, kinds

            frames.check_jumps(self.evidence, _sample_along, 2 * len(samples))

    def check_world(self) -> None:
        """Check the same pairs of directions on a surface that is turned."""
        evidence, lobes, values = self.evidence, self.lobes, self.values
        turned = self.turned.eval(values.wi, values.wo, self.uv)
        lit = values.lit & values.finite
        frames.check_world(evidence, values, turned, lit, self.slack)
        there = self.turned.sample(self.wi, self.random, self.uv)
        same = lobes.given & there.given & (there.type == lobes.type)
        same &= np.abs(there.weights.wo - lobes.weights.wo).max(-1) < SAME_DIRECTION
        slack = self._slack_of_lobes(self.wi, self.random, self.uv)
        frames.check_world(evidence, lobes.flux, there.flux, same, slack)

    def check_energy(self) -> None:
        """Check the flux of some incident directions."""
        n = N_FLUX * self.size
        wi = lit_directions(self.rng, N_LIT, self.sides)[:, None]
        shape = (N_LIT, n, 3)
        lobes = self.importance.sample(
            np.broadcast_to(wi, shape),
            self.rng.random(shape),
            np.resize(PLACES, (N_LIT, 1, 2)),
        )
        energy.check_gain(self.evidence, lobes)


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
    probe = MuellerProbe(loaded("the specimen", mi.load_dict, mirrored))
    wi = UPRIGHT[None]
    lobes = probe.sample(wi, np.full((1, 3), 0.5), np.array(PLACES[0]))
    if not lobes.given.any():
        return UPRIGHT, None
    normal = wi[0] + lobes.weights.wo[0]
    normal /= np.linalg.norm(normal)
    s = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    s /= np.linalg.norm(s)
    return normal, np.column_stack([s, np.cross(normal, s), normal])

"""Answers of a BSDF as Mueller matrices, and their frames.

In polarised variants the answers of ``eval`` and the weights of ``sample`` are Mueller
matrices in Mitsuba's frames of the beams, :func:`~gonio_mi.collector.stokes.
implicit_axis`. In importance mode light arrives along -wi and leaves along wo; in
radiance mode it arrives along -wo and leaves along wi.

If a plugin uses the wrong frames, its matrices are read in other ways: each reading
assumes one mistake, and the reading in which the matrices make sense names it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import mitsuba as mi
import numpy as np

from ..array_types import Flags, Floats, Numbers
from ..collector.directions import angles
from ..collector.stokes import (
    EXCHANGE,
    UPRIGHT,
    implicit_axis,
    plane_axis,
    reframed,
    turn,
)
from ..single_precision import BSDF_ROUNDING
from .conditions import Condition, Given
from .mistakes import EVAL, SAMPLE, Function, Mistake
from .probe import Probe, full, random_numbers, vectors
from .samples import SLACK, ULPS, Samples, drawn_samples

# Texture coordinates.
MIDDLE = np.array([0.5, 0.5])

# First elements below which nothing is said of the others, of the largest.
MIN_LIGHT = 1e-12


@dataclass(frozen=True)
class Matrices:
    """Mueller matrices for pairs of directions.

    Attributes
    ----------
    function : Function
        Which answered them.
    asked : Condition
        Of all of them, but for directions and places.
    wi, wo : ndarray, shape (..., 3)
    uv : ndarray, shape (..., 2)
        Texture coordinates.
    raw : ndarray, shape (..., channels, 4, 4)
        In Mitsuba's frames.
    """

    function: Function
    asked: Condition
    wi: Floats
    wo: Floats
    uv: Floats
    raw: Floats

    @property
    def beams(self) -> tuple[Floats, Floats]:
        """Directions in which light arrives and leaves."""
        if self.asked.mode == "importance":
            return -self.wi, self.wo
        return -self.wo, self.wi

    @property
    def light(self) -> Floats:
        """First elements, shape (..., channels)."""
        return self.raw[..., 0, 0]

    @property
    def lit(self) -> Flags:
        """Mask of pairs with enough light to be judged, shape (...)."""
        light = np.nan_to_num(self.light)
        least = MIN_LIGHT * max(light.max(initial=0), 1e-12)
        return np.asarray((light > least).all(axis=-1))

    @cached_property
    def finite(self) -> Flags:
        """Mask of pairs whose direction and elements are finite, shape (...)."""
        directions = np.isfinite(self.wo).all(axis=-1)
        return np.asarray(directions & np.isfinite(self.raw).all(axis=(-1, -2, -3)))

    def turns(
        self,
        normal: Numbers = UPRIGHT,
        axes: Numbers | None = None,
        share: float = 1.0,
        sign: int = 1,
    ) -> tuple[Floats, Floats]:
        """Matrices that turn both frames from Mitsuba's to s = k x normal.

        Mitsuba's are those of local directions; `axes`, as columns, replace the local
        ones. `share` is the part of the angle, and a `sign` of -1 turns to -s.
        """
        found = []
        for k in self.beams:
            old = implicit_axis(k)
            if axes is not None:
                old = implicit_axis(k @ axes) @ np.transpose(axes)
            found.append(turn(k, old, sign * plane_axis(k, normal), share))
        turn_in, turn_out = found
        return turn_in[..., None, :, :], turn_out[..., None, :, :]

    def in_plane(self, normal: Numbers = UPRIGHT) -> Floats:
        """Matrices in frames of s = k x normal, shape (..., channels, 4, 4)."""
        return reframed(self.raw, *self.turns(normal))

    def condition(self, at: Sequence[Any]) -> Condition:
        """Condition of one pair."""
        at = tuple(at)
        wi = self.wi[at]
        theta, phi = (float(np.round(np.degrees(x), 1)) % 360 for x in angles(wi))
        side = "front" if wi[2] > 0 else "back"
        theta_i = theta if wi[2] > 0 else float(np.round(180 - theta, 1))
        u, v = self.uv[at].tolist()
        return Condition(theta_i, phi, side, (u, v), self.asked.mode)

    def take(self, chosen: Any) -> Matrices:
        """Return the chosen pairs."""
        parts = (self.wi, self.wo, self.uv, self.raw)
        wi, wo, uv, raw = (x[chosen] for x in parts)
        return replace(self, wi=wi, wo=wo, uv=uv, raw=raw)

    def reshaped(self, *shape: int) -> Matrices:
        """The same pairs, in another shape."""
        parts = (self.wi, self.wo, self.uv, self.raw)
        ends = ((3,), (3,), (2,), self.raw.shape[-3:])
        wi, wo, uv, raw = (x.reshape(*shape, *y) for x, y in zip(parts, ends))
        return replace(self, wi=wi, wo=wo, uv=uv, raw=raw)

    @classmethod
    def of(cls, samples: Samples, function: Function, raw: Floats) -> Matrices:
        """Answers about samples."""
        asked = samples.condition
        uv = np.broadcast_to(asked.uvs, (samples.n, 2))
        return cls(function, asked, samples.wi, samples.wo, uv, raw)

    def exchanged(self) -> Matrices:
        """The same numbers, of incident and outgoing directions exchanged."""
        return replace(self, wi=self.wo, wo=self.wi)

    def in_radiance(self) -> Matrices:
        """The same numbers, of radiance mode."""
        return replace(self, asked=replace(self.asked, mode="radiance"))


def eval_at(
    bsdf: mi.BSDF, wi: Floats, wo: Floats, uv: Numbers = MIDDLE, **asked: Any
) -> Matrices:
    """Matrices of ``eval`` for directions of shape (..., 3) and places of (..., 2).

    What else is `asked` is of a condition.
    """
    condition = condition_of(wi, uv, **asked)
    answer, n = Probe(bsdf, condition).eval(vectors(wo)), len(condition.wi)
    raw = full(answer, n).reshape(*wi.shape[:-1], -1, 4, 4)
    uv = np.broadcast_to(uv, (*wi.shape[:-1], 2))
    return Matrices(EVAL, condition, wi, wo, uv, raw)


def eval_with_slack(
    bsdf: mi.BSDF, wi: Floats, wo: Floats, uv: Numbers
) -> tuple[Matrices, Floats]:
    """Matrices of ``eval``, and what rounding may leave in their elements, (...).

    The slack is relative to the first element.
    """
    rng = np.random.default_rng(wi[..., 0].size)
    steps = [ULPS * (2 * rng.random((2, *wi.shape)) - 1) for _ in range(2)]
    moves = np.stack([np.zeros_like(steps[0]), *steps])
    answers = eval_at(bsdf, wi + moves[:, 0], wo + moves[:, 1], uv)
    return answers.take(0), slack_of(per_light(answers.raw))


def samples_at(
    bsdf: mi.BSDF, wi: Floats, random: Floats, uv: Numbers = MIDDLE, **asked: Any
) -> Samples:
    """Samples for incident directions and random numbers of (..., 3), in one row."""
    return drawn_samples(
        Probe(bsdf, condition_of(wi, uv, **asked)), *random_numbers(random)
    )


def lobe_slack(bsdf: mi.BSDF, samples: Samples) -> Floats:
    """Slack of weights over their first elements, by displaced incident directions."""
    n, wi = samples.n, samples.wi
    steps = ULPS * (2 * np.random.default_rng(n).random((2, n, 3)) - 1)
    moved = np.concatenate([wi[None], wi + steps])
    u, uv = (
        np.broadcast_to(x, (3, *x.shape)) for x in (samples.u, samples.condition.uvs)
    )
    found = samples_at(bsdf, moved, u, uv)
    return slack_of(per_light(found.full("weight").reshape(3, n, -1, 4, 4)))


def condition_of(wi: Floats, uv: Numbers, **asked: Any) -> Given:
    """Condition of directions of (..., 3), and of places, in one row."""
    at = np.broadcast_to(uv, (*wi.shape[:-1], 2)).reshape(-1, 2)
    return Given(lit_by=wi.reshape(-1, 3), at=at, **asked)


def flux_of(samples: Samples, *shape: int) -> Matrices:
    """Weight times pdf of samples, of that shape if they are no row."""
    pdf = samples.sampled_pdf[:, None, None, None]
    flux = Matrices.of(samples, SAMPLE, samples.full("weight") * pdf)
    return flux.reshaped(*shape) if shape else flux


def in_mode(asked: Condition) -> str:
    """Text that names the mode and fields in which alone something is wrong."""
    if asked.fields:
        return f", with other si.{', si.'.join(asked.fields)}"
    return ", in radiance mode (ctx.mode)" if asked.mode == "radiance" else ""


def per_light(matrices: Floats) -> Floats:
    """Matrices over their first element; NaN where that is not positive."""
    light = matrices[..., :1, :1]
    return np.where(light > 0, matrices, np.nan) / np.where(light > 0, light, 1)


def slack_of(displaced: Floats) -> Floats:
    """Slack for rounding, from matrices whose first axis displaces the directions."""
    change = np.abs(displaced[1:] - displaced[0]).max(axis=(0, -1, -2, -3))
    return 8 * BSDF_ROUNDING + SLACK * np.nan_to_num(change, nan=1.0)


def relative_slack(*answers: Floats) -> Floats:
    """The same from slacks of samples and the first elements that these are of."""
    slacks = zip(answers[::2], answers[1::2])
    parts = (np.max(x / np.maximum(light, 1e-30), axis=1) for x, light in slacks)
    return sum(8 * BSDF_ROUNDING + SLACK * np.nan_to_num(x, nan=1.0) for x in parts)


def off(a: Floats, b: Floats) -> Floats:
    """Largest difference of elements of two arrays (..., channels, 4, 4): (...)."""
    return np.abs(a - b).max(axis=(-1, -2, -3))


# ----------------------------------------------------------------------------- readings

# Elements over the first one that count as 0.
NOTHING = 1e-4

# Mirroring at the surface, and what it does to a Stokes vector.
FLIP = np.array([1.0, 1.0, -1.0])
MIRRORED = np.diag([1.0, 1.0, -1.0, -1.0])


class Reading(Mistake):
    """Mistakes by which matrices are to be read otherwise, in one `mode` or in both."""

    IDENTITY = """{who} returns one number, which Mitsuba takes as that multiple of the
        identity: light keeps its polarisation in frames that do not turn with the plane
        of incidence; mi.mueller.depolarizer makes it unpolarised{mode}"""
    OF_FRONT = """{who} returns for the back the matrix of the front, whose frames are
        not mirrored with the directions{mode}"""
    NESTED = """{who} does not turn the frames of the nested BSDF to those of its own
        directions{mode}"""
    NOT_TURNED = """{who} does not turn its frames from the plane of incidence to
        Mitsuba's (mi.mueller.rotate_mueller_basis){mode}"""
    INCIDENT = "{who} does not turn the frame of the incident beam to Mitsuba's{mode}"
    OUTGOING = "{who} does not turn the frame of the outgoing beam to Mitsuba's{mode}"
    WRONG_WAY = "{who} turns its frames the wrong way round{mode}"
    HALF = """{who} turns Stokes vectors by the angle of their frames instead of twice
        that{mode}"""
    TRANSPOSED = "{who} returns the transposed matrix{mode}"
    EXCHANGED = """{who} takes the frames of incident and outgoing beam for each other:
        light arrives along -wi in importance mode, along -wo in radiance mode
        (ctx.mode){mode}"""
    OTHER_MODE = "{who} answers as importance mode does{mode}"


def is_identity(m: Floats) -> bool:
    """Whether matrices over their first element are the identity."""
    return bool((np.abs(m - np.eye(4)) < NOTHING).all())


def is_depolarised(m: Floats) -> bool:
    """Whether matrices over their first element have no other element."""
    return bool((np.abs(m).sum(axis=(-1, -2)) - 1 < NOTHING).all())


def readings(
    matrices: Matrices, normal: Numbers, nested: Numbers | None = None
) -> Iterator[tuple[Reading, Floats]]:
    """Mistakes, each with the matrices that it implies in frames of s = k x normal.

    Parameters
    ----------
    matrices : Matrices
    normal : array_like, shape (3,)
        Of the surface that scatters.
    nested : ndarray, shape (3, 3), optional
        Axes of a nested BSDF, as columns.

    Yields
    ------
    Reading
    ndarray, shape (..., channels, 4, 4)
    """
    raw, (turn_in, turn_out) = matrices.raw, matrices.turns(normal)
    one, back = np.eye(4), np.swapaxes(turn_in, -1, -2)
    out_back = np.swapaxes(turn_out, -1, -2)
    if (matrices.wi[..., 2] < 0).all():
        mirrored = matrices.turns(normal, np.diag(FLIP))
        yield Reading.OF_FRONT, reframed(MIRRORED @ raw @ MIRRORED, *mirrored)
    if nested is not None:
        yield Reading.NESTED, reframed(raw, *matrices.turns(normal, nested))
    yield Reading.NOT_TURNED, raw
    for mistake, of_in, of_out in (
        (Reading.INCIDENT, one, turn_out),
        (Reading.OUTGOING, turn_in, one),
        (Reading.WRONG_WAY, back, out_back),
        (Reading.HALF, *matrices.turns(normal, share=0.5)),
        (Reading.HALF, *matrices.turns(normal, share=0.5, sign=-1)),
    ):
        yield mistake, reframed(raw, of_in, of_out)
    transposed = np.swapaxes(raw, -1, -2)
    yield Reading.TRANSPOSED, reframed(transposed, turn_in, turn_out)
    yield Reading.EXCHANGED, reframed(raw, out_back, back)


def other_mode(matrices: Matrices) -> Iterator[tuple[Reading, Floats]]:
    """Yield, of radiance mode, that it is answered as importance mode.

    As :func:`readings`; the matrix is that of light which goes back the same way.
    """
    if matrices.asked.mode == "radiance":
        asked = replace(matrices.asked, mode="importance")
        there = replace(matrices, asked=asked).in_plane()
        back = EXCHANGE @ np.swapaxes(there, -1, -2) @ EXCHANGE
        yield Reading.OTHER_MODE, back

"""Answers of a BSDF as Mueller matrices, and their frames.

In polarised variants the answers of ``eval`` and the weights of ``sample`` are Mueller
matrices in Mitsuba's frames of the beams, :func:`~gonio_mi.collector.stokes.
implicit_axis`. In importance mode light arrives along -wi and leaves along wo; in
radiance mode it arrives along -wo and leaves along wi.

If a plugin uses the wrong frames, its matrices are read in other ways: each reading
assumes one mistake, and the reading in which the matrices make sense names it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import mitsuba as mi
import numpy as np

from ..array_types import Flags, Floats, Integers, Numbers
from ..collector.directions import angles, direction
from ..collector.stokes import (
    EXCHANGE,
    UPRIGHT,
    implicit_axis,
    plane_axis,
    reframed,
    turn,
)
from ..mitsuba_compat import floats
from ..single_precision import BSDF_ROUNDING
from .conditions import N_SPOTS, Condition
from .mistakes import EVAL, SAMPLE, Function, Mistake
from .probe import Probe, numbers, random_numbers, spectral, vectors
from .samples import SLACK, ULPS

# Texture coordinates.
MIDDLE = np.array([0.5, 0.5])

# First elements below which nothing is said of the others, of the largest.
MIN_LIGHT = 1e-12


class MuellerProbe:
    """The functions of a BSDF in one transport mode, for pairs of directions.

    Texture coordinates `uv` are of shape (..., 2), and are broadcast to the directions.

    Parameters
    ----------
    bsdf : mi.BSDF
    mode : {"importance", "radiance"}
    **others
        Of the condition, such as `turned` or `fields`, which each direction has others
        of.
    """

    def __init__(self, bsdf: mi.BSDF, mode: str = "importance", **others: Any) -> None:
        self.asked, self.n_asked = Condition(0.0, mode=mode, **others), 0
        self._probe = Probe(bsdf, self.asked)

    def eval(self, wi: Floats, wo: Floats, uv: Numbers = MIDDLE) -> Matrices:
        """Matrices of ``eval`` for directions of shape (..., 3)."""
        answer = self._placed(wi, uv).eval(vectors(wo))
        return self._matrices(EVAL, wi, wo, uv, answer)

    def pdf(self, wi: Floats, wo: Floats, uv: Numbers = MIDDLE) -> Floats:
        """Densities for directions of shape (n, 3); shape (n,)."""
        return self._placed(wi, uv).densities(wo)

    def eval_with_slack(
        self, wi: Floats, wo: Floats, uv: Numbers = MIDDLE
    ) -> tuple[Matrices, Floats]:
        """Matrices of ``eval``, and what rounding may leave in their elements, (...).

        The slack is relative to the first element: what displacing both directions by
        rounding errors changes, as of unpolarised answers.
        """
        rng = np.random.default_rng(wi[..., 0].size)
        steps = [ULPS * (2 * rng.random((2, *wi.shape)) - 1) for _ in range(2)]
        moves = np.stack([np.zeros_like(steps[0]), *steps])
        answers = self.eval(wi + moves[:, 0], wo + moves[:, 1], uv)
        return answers.take(0), slack_of(per_light(answers.raw))

    def eval_pdf(
        self, wi: Floats, wo: Floats, uv: Numbers = MIDDLE
    ) -> tuple[Matrices, Floats]:
        """Both answers of ``eval_pdf`` for directions of shape (n, 3)."""
        value, pdf = self._placed(wi, uv).eval_pdf(vectors(wo))
        values = self._matrices(Function.EVAL_PDF, wi, wo, uv, value)
        return values, numbers(pdf, len(wi)).astype(float)

    def sample(self, wi: Floats, random: Floats, uv: Numbers = MIDDLE) -> Lobes:
        """Answers of ``sample`` for directions and random numbers of (..., 3)."""
        shape, n = wi.shape[:-1], wi[..., 0].size
        bs, weight = self._placed(wi, uv).sample(*random_numbers(random))
        wo = spectral(bs.wo, n).reshape(wi.shape)
        return Lobes(
            self._matrices(SAMPLE, wi, wo, uv, weight),
            numbers(bs.pdf, n).astype(float).reshape(shape),
            numbers(bs.sampled_type, n).astype(np.int64).reshape(shape),
        )

    def _placed(self, wi: Floats, uv: Numbers) -> Probe:
        """Probe that asks from each direction, at its texture coordinates."""
        n, probe = wi[..., 0].size, self._probe
        self.n_asked += n
        uv = np.broadcast_to(uv, (*wi.shape[:-1], 2)).reshape(-1, 2)
        probe.wi, probe.uv = vectors(wi), mi.Point2f(*map(floats, uv.T))
        probe.spots = mi.UInt32(np.arange(n) % wi.shape[-2] % N_SPOTS)
        return probe

    def _matrices(
        self, function: Function, wi: Floats, wo: Floats, uv: Numbers, answer: Any
    ) -> Matrices:
        shape = wi.shape[:-1]
        uv, raw = np.broadcast_to(uv, (*shape, 2)), elements(answer, shape)
        return Matrices(function, self.asked, wi, wo, uv, raw)


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
    size : ndarray, shape (...), optional
        By how much they are wrong; the worst is told of.
    """

    function: Function
    asked: Condition
    wi: Floats
    wo: Floats
    uv: Floats
    raw: Floats
    size: Floats | None = None

    @property
    def beams(self) -> tuple[Floats, Floats]:
        """Directions in which light arrives and leaves."""
        if self.asked.mode == "importance":
            return -self.wi, self.wo
        return -self.wo, self.wi

    @property
    def in_mode(self) -> str:
        """Text that names the mode and fields in which alone something is wrong."""
        if self.asked.fields:
            return f", with other si.{', si.'.join(self.asked.fields)}"
        return ", in radiance mode (ctx.mode)" if self.asked.mode == "radiance" else ""

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

    def place(self, wrong: Flags) -> str:
        """Text that names the place of those that are `wrong`, if they share one."""
        uv = np.unique(self.uv[wrong], axis=0)
        return ", uv ({:g}, {:g})".format(*uv[0]) if len(uv) == 1 else ""

    def fraction(self, wrong: Flags) -> str:
        """Text on the percentage of pairs that are `wrong`, and where one is."""
        where = f"{self.middle(wrong)}{self.place(wrong)}"
        return f"{100 * wrong.mean():.3g} % of the directions, as at {where}"

    def middle(self, wrong: Flags) -> Condition:
        """Condition of the worst of those that are `wrong`, or of the first."""
        size = 1.0 if self.size is None else self.size
        worst = np.argmax(np.where(wrong, size, -np.inf))
        return self.condition(np.unravel_index(worst, wrong.shape))

    def condition(self, at: Sequence[Any]) -> Condition:
        """Condition of one pair."""
        at = tuple(at)
        wi = self.wi[at]
        theta, phi = (float(np.round(np.degrees(x), 1)) % 360 for x in angles(wi))
        side = "front" if wi[2] > 0 else "back"
        theta_i = theta if wi[2] > 0 else float(np.round(180 - theta, 1))
        spot = int(at[-1]) % N_SPOTS if self.asked.fields else 0
        u, v = self.uv[at].tolist()
        lit = replace(self.asked, theta_i=theta_i, phi_i=phi, side=side, turned=False)
        return replace(lit, uv=(u, v), spot=spot)

    def by(self, size: Floats) -> Matrices:
        """The same, with how wrong each is."""
        return replace(self, size=size)

    def take(self, chosen: Any) -> Matrices:
        """Return the chosen pairs."""
        parts = (self.wi, self.wo, self.uv, self.raw)
        wi, wo, uv, raw = (x[chosen] for x in parts)
        return replace(self, wi=wi, wo=wo, uv=uv, raw=raw, size=None)


@dataclass(frozen=True)
class Lobes:
    """Answers of ``sample``.

    Attributes
    ----------
    weights : Matrices
    pdf : ndarray, shape (...)
    type : ndarray, shape (...)
    """

    weights: Matrices
    pdf: Floats
    type: Integers

    @property
    def given(self) -> Flags:
        """Mask of samples that did not fail."""
        return self.weights.lit & (self.pdf > 0) & self.weights.finite

    @property
    def delta(self) -> Flags:
        """Mask of those with a discrete direction."""
        return self.given & ((self.type & int(mi.BSDFFlags.Delta)) != 0)

    @property
    def null(self) -> Flags:
        """Mask of those that go straight on, by a lobe of the type Null."""
        return self.given & ((self.type & int(mi.BSDFFlags.Null)) != 0)

    @property
    def smooth(self) -> Flags:
        """Mask of those with a density."""
        return self.given & ((self.type & int(mi.BSDFFlags.Delta)) == 0)

    @property
    def flux(self) -> Matrices:
        """Weight times pdf: ``eval`` of a density, the share of a discrete lobe."""
        raw = self.weights.raw * self.pdf[..., None, None, None]
        return replace(self.weights, raw=raw)


def elements(value: mi.Spectrum, shape: tuple[int, ...]) -> Floats:
    """Mueller-valued spectra for directions of a shape: (*shape, channels, 4, 4).

    In unpolarised variants of their first element: (*shape, channels, 1, 1).
    """
    array, size = np.array(value, dtype=float), 4 if mi.is_polarized else 1
    array = array.reshape(size, size, array.shape[-2], -1)
    array = np.moveaxis(array, (3, 2), (0, 1))
    array = np.broadcast_to(array, (math.prod(shape), *array.shape[1:]))
    return array.reshape(*shape, *array.shape[1:])


def per_light(matrices: Floats) -> Floats:
    """Matrices over their first element; NaN where that is not positive."""
    light = matrices[..., :1, :1]
    return np.where(light > 0, matrices, np.nan) / np.where(light > 0, light, 1)


def slack_of(displaced: Floats) -> Floats:
    """Slack for rounding, from matrices whose first axis displaces the directions."""
    change = np.abs(displaced[1:] - displaced[0]).max(axis=(0, -1, -2, -3))
    return 8 * BSDF_ROUNDING + SLACK * np.nan_to_num(change, nan=1.0)


def off(a: Floats, b: Floats) -> Floats:
    """Largest difference of elements of two arrays (..., channels, 4, 4): (...)."""
    return np.abs(a - b).max(axis=(-1, -2, -3))


def lit_directions(rng: np.random.Generator, n: int, sides: Sequence[int]) -> Floats:
    """Directions to the source, half of them grazing, on the sides +1 and -1.

    The sides alternate, so that each has grazing ones.
    """
    grazing = np.arange(n) // len(sides) % 2
    theta = np.radians(np.where(grazing, 85, 50) * np.sqrt(rng.random(n)))
    found = direction(np.maximum(theta, 0.05), 2 * np.pi * rng.random(n))
    found[:, 2] *= np.resize(sides, n)
    # as single precision has it
    return found.astype(np.float32).astype(float)


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

"""Derivatives of a BSDF by a parameter, beside differences: whether they are right."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Floats
from ..errors import SpecimenError
from ..specimen.scene_objects import class_of
from .derivative import Derivative, Lobes
from .surface_events import flux_context, is_delta

# Incident directions, random numbers of each, a shift from limits of a parameter, and a
# step, both relative to its size.
N_DIRECTIONS, N_EACH = 32, 2**11
SHIFT, STEP = 2.0**-4, 2.0**-5

# Part by which derivatives may be off the differences; of delta lobes, that random
# numbers choose; and off one-sided ones. Relative rounding of single precision.
MAX_OFF, MAX_OFF_OF_LOBES, MAX_OFF_AT_LIMIT = 0.05, 0.15, 0.5
ROUNDINGS = 2.0**-17


class Trial:
    """Derivatives of one BSDF along numbers of a parameter, beside differences.

    Parameters
    ----------
    name : str
        Of the parameter.
    size : float
        Of its numbers.
    bsdf : mi.BSDF
    attached : callable
        ``attached(by=0.0, follow="forward")``: a context in which the numbers are moved
        and followed.
    wavelengths : mi.Spectrum or mi.Color0f

    Attributes
    ----------
    depends : bool
        Whether there is any.
    lobes : Lobes
        What the delta lobes follow.
    """

    def __init__(
        self,
        name: str,
        size: float,
        bsdf: mi.BSDF,
        attached: Callable[..., AbstractContextManager[Any]],
        wavelengths: Any,
    ) -> None:
        self._name, self._bsdf, self._attached = name, bsdf, attached
        self._shift, self._step = SHIFT * size, STEP * size
        self._si, self._u1, self._u2 = _questions(wavelengths)
        n = N_DIRECTIONS * N_EACH
        with dr.suspend_grad():
            bs, _ = self._sample()
            sampler = mi.load_dict({"type": "independent"})
            sampler.seed(1, n)
            other = mi.warp.square_to_uniform_sphere(sampler.next_2d())
            usual = (dr.arange(mi.UInt32, n) % 2 == 0) & ~is_delta(bs)
            self._wo = dr.select(usual, bs.wo, other)
            dr.eval(self._si, self._u1, self._u2, self._wo)
            self.depends = self._check_eval()
            self.lobes = Lobes.STILL
            if mi.has_flag(bsdf.flags(), mi.BSDFFlags.Delta) or mi.has_flag(
                bsdf.flags(), mi.BSDFFlags.Delta1D
            ):
                self._check_lobes()

    def _sample(self) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
        context, active = flux_context(), mi.Bool(True)
        bs, weight = self._bsdf.sample(context, self._si, self._u1, self._u2, active)
        return bs, mi.Spectrum(weight)

    def _differences(self, function: Any) -> tuple[Floats, Floats]:
        """Derivatives of a function's values, and what they may be off."""
        found = []
        for step in (self._step, self._step / 2):
            ends = []
            for sign in (1, -1):
                with self._attached(self._shift + sign * step, ""):
                    ends.append(function())
            found.append((ends[0] - ends[1]) / (2 * step))
        return (4 * found[1] - found[0]) / 3, np.abs(found[1] - found[0])

    def _values(self) -> Floats:
        value = self._bsdf.eval(flux_context(), self._si, self._wo, mi.Bool(True))
        return _numbers(mi.Spectrum(value))

    def _check_eval(self) -> bool:
        """Whether `eval` depends on the parameter; SpecimenError if not as it says."""
        name, kind = self._name, class_of(self._bsdf)
        told = Derivative()
        asked = self._bsdf, self._si, self._wo, mi.Bool(True)
        with self._attached(self._shift):
            change, value = map(_numbers, told.of_eval(*asked))
        expected, slack = self._differences(self._values)
        lit = value > 0
        off = np.abs(change - expected)[lit] / value[lit]
        allowed = 3 * slack[lit] / value[lit] + ROUNDINGS / self._step
        expected = np.abs(expected[lit]) / value[lit]
        wrong = ~(off <= allowed + MAX_OFF * expected)
        if not np.sum(off[wrong]) <= MAX_OFF * np.sum(expected):
            raise SpecimenError(
                f"the derivative of `eval` of {kind} by {name} is wrong: differences "
                f"give {np.mean(expected):.3g} of the value on average, and Dr.Jit is "
                f"off by {np.mean(off):.3g}"
            )
        self._check_off_limit(told, asked)
        return bool(np.any(expected > allowed))

    def _check_off_limit(self, told: Derivative, asked: tuple[Any, ...]) -> None:
        """Raise SpecimenError where `eval` changes otherwise than its derivative."""
        with self._attached():
            change, value = map(_numbers, told.of_eval(*asked))
        with self._attached(self._shift, ""):
            step = self._values() - value
        off = np.abs(change - step / self._shift)
        beyond = np.sum(np.abs(step[value == 0])) > MAX_OFF * np.sum(np.abs(step))
        # where it is nearly linear
        lit = (value > 0) & (np.abs(step) < value / 2)
        off, step = off[lit] / value[lit], np.abs(step[lit]) / value[lit]
        allowed = MAX_OFF_AT_LIMIT * step + 2 * ROUNDINGS
        wrong = off * self._shift > allowed
        if beyond or np.sum(wrong) > MAX_OFF_AT_LIMIT * wrong.size:
            self._raise_at_limit("eval")

    def _flux(self) -> Floats:
        """What delta lobes send up and down, on average for each direction."""
        bs, weight = self._sample()
        return _by_direction(bs, weight)

    def _check_lobes(self) -> None:
        """Find what follows delta lobes; SpecimenError if nothing does."""
        name, kind = self._name, class_of(self._bsdf)
        expected, _ = self._differences(self._flux)
        # random numbers choose lobes in steps
        with self._attached(self._shift, ""):
            bs, weight = self._sample()
            shifted = _by_direction(bs, weight)
            largest = _by_direction(bs, weight, np.max)
        least = np.linalg.norm(largest) / (N_EACH * self._step)
        one_sided = (shifted - self._flux()) / self._shift
        where = []
        for step in (self._step, -self._step):
            with self._attached(self._shift + step, ""):
                bs, weight = self._sample()
                lit = is_delta(bs) & dr.any(weight > 0)
                where.append((bs.wo.numpy(), lit.numpy(), bs.sampled_type.numpy()))
        (one, lit, kinds), (other, also, others) = where
        same = lit & also & (kinds == others)
        if np.any(np.abs(one - other)[..., same] > ROUNDINGS):
            raise SpecimenError(
                f"the direction of a delta lobe of {kind} moves with {name}, and no "
                "derivative of a patch follows it"
            )
        norm = np.linalg.norm(expected)
        for rule in Lobes:
            off = np.linalg.norm(self._found(rule, self._shift) - expected)
            if off <= MAX_OFF_OF_LOBES * norm + least:
                off = np.linalg.norm(self._found(rule, 0.0) - one_sided)
                if off > MAX_OFF_AT_LIMIT * np.linalg.norm(one_sided) + least:
                    self._raise_at_limit("sample")
                self.depends |= bool(norm > least)
                self.lobes = rule
                return
        raise SpecimenError(
            f"the derivative of the delta lobes of {kind} by {name} is wrong: "
            "differences disagree with the weight of `sample`, with and without `pdf`"
        )

    def _found(self, rule: Lobes, shift: float) -> Floats:
        """Derivatives of what delta lobes send, by a rule."""
        if rule is Lobes.STILL:
            return np.zeros(1)
        asked = self._bsdf, self._si, self._u1, self._u2, mi.Bool(True)
        with self._attached(shift):
            change, light = Derivative(rule).of_lobe(*asked)
            bs, weight = self._sample()
            change = dr.select(light > 0, change / light * weight, 0)
            return _by_direction(bs, change)

    def _raise_at_limit(self, function: str) -> None:
        raise SpecimenError(
            f"{self._name} is at a limit: rays do not go where a change of it "
            f"would send light, or `{function}` of {class_of(self._bsdf)} has no "
            "derivative there; take a value a little off"
        )


def _questions(wavelengths: Any) -> tuple[Any, Any, Any]:
    """Interactions at random places of a square, and numbers to sample there."""
    n = N_DIRECTIONS * N_EACH
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, N_DIRECTIONS)
    wi = mi.warp.square_to_cosine_hemisphere(sampler.next_2d())
    uv, below = sampler.next_2d(), sampler.next_1d() < 0.5
    wi.z = dr.select(below, -wi.z, wi.z)
    lane = dr.arange(mi.UInt32, n)
    si = dr.zeros(mi.SurfaceInteraction3f, n)
    si.wi = dr.gather(mi.Vector3f, wi, lane // N_EACH)
    si.uv = dr.gather(mi.Point2f, uv, lane // N_EACH)
    si.t, si.n = mi.Float(1), mi.Normal3f(0, 0, 1)
    si.sh_frame = mi.Frame3f(si.n)
    si.dp_du, si.dp_dv = mi.Vector3f(2, 0, 0), mi.Vector3f(0, 2, 0)
    si.wavelengths = wavelengths
    sampler.seed(2, n)
    u1 = (mi.Float(lane % N_EACH) + 0.5) * (1 / N_EACH)
    return si, u1, sampler.next_2d()


def _by_direction(
    bs: mi.BSDFSample3f, light: mi.Spectrum, of: Callable[..., Floats] = np.mean
) -> Floats:
    """Means of the light of delta lobes up and down, for each incident direction."""
    delta, up = is_delta(bs).numpy(), bs.wo.z.numpy() > 0
    values = _numbers(light)
    sides = [np.where(delta & side, values, 0) for side in (up, ~up)]
    return of(np.stack(sides).reshape(-1, N_DIRECTIONS, N_EACH), axis=-1)


def _numbers(value: mi.Spectrum) -> Floats:
    """Values of all channels, shape ``(channels, n)``."""
    n = N_DIRECTIONS * N_EACH
    return np.stack([np.broadcast_to(one.numpy(), n).astype(float) for one in value])

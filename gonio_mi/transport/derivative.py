"""How light changes with parameters of BSDFs, event by event: likelihood ratios.

Rays go where `sample` sends them. What they carry changes with a parameter as `eval`
does at the directions that were drawn (Glynn 1990, *Likelihood ratio gradient
estimation for stochastic systems*): each event adds the logarithmic derivative of
`eval`, and a ray that leaves brings its weight times their sum. The patch that it
reaches stays the same, so that no edge of a patch is missed. Delta lobes have no
`eval`: of these the weight of `sample` tells, by a rule that is tried for each
parameter.
"""

from __future__ import annotations

from enum import Enum
from typing import Any

import drjit as dr
import mitsuba as mi

from ..loops import syntax
from .surface_events import flux_context, is_delta

# Derivatives of a value follow the graph of its function, which stays.
FLAGS = dr.ADFlag.ClearInterior | dr.ADFlag.AllowNoGrad


class Lobes(Enum):
    """Quantity that a delta lobe follows: none, weight times pdf, or weight."""

    STILL = 0
    WEIGHT_AND_PDF = 1
    WEIGHT = 2


class Derivative:
    """How light changes, at each event, with the parameter that is attached.

    No dataclass, whose fields Dr.Jit takes for variables of a loop.
    """

    def __init__(self, lobes: Lobes = Lobes.STILL) -> None:
        self.lobes = lobes

    def of_event(
        self,
        bsdf: mi.BSDFPtr,
        si: mi.SurfaceInteraction3f,
        u1: mi.Float,
        u2: mi.Point2f,
        sampled: tuple[mi.BSDFSample3f, mi.Spectrum],
        active: mi.Bool,
    ) -> mi.Spectrum:
        """Logarithmic derivative of what goes on in the direction that was `sampled`.

        NaN where there is light and `eval` is 0.
        """
        bs, weight = sampled
        change, value = self.of_eval(bsdf, si, bs.wo, active)
        change /= value
        if self.lobes is Lobes.STILL:
            delta = mi.Spectrum(0)
        else:
            delta, light = self.of_lobe(bsdf, si, u1, u2, active)
            delta /= light
        change = dr.select(is_delta(bs), delta, change)
        return dr.select(active & (weight > 0), change, 0)

    def of_eval(
        self, bsdf: mi.BSDFPtr, si: mi.SurfaceInteraction3f, wo: Any, active: mi.Bool
    ) -> tuple[mi.Spectrum, mi.Spectrum]:
        """Derivative of `eval`, and its value."""
        with dr.resume_grad():
            return _derived(bsdf.eval(flux_context(), si, wo, active))

    def of_lobe(
        self,
        bsdf: mi.BSDFPtr,
        si: mi.SurfaceInteraction3f,
        u1: mi.Float,
        u2: mi.Point2f,
        active: mi.Bool,
    ) -> tuple[mi.Spectrum, mi.Spectrum]:
        """Derivative of what a delta lobe sends, and its value, up to a factor."""
        with dr.resume_grad():
            return _derived(self._lobe(bsdf, si, u1, u2, active))

    def _lobe(
        self, bsdf: mi.BSDFPtr, si: Any, u1: mi.Float, u2: mi.Point2f, active: mi.Bool
    ) -> mi.Spectrum:
        """What a delta lobe sends, up to a factor."""
        bs, weight = bsdf.sample(flux_context(), si, u1, u2, active)
        weight = mi.Spectrum(weight)
        return weight * bs.pdf if self.lobes is Lobes.WEIGHT_AND_PDF else weight


def _derived(value: Any) -> tuple[mi.Spectrum, mi.Spectrum]:
    """Derivative of a value by what is attached, and the value without it."""
    value = mi.Spectrum(value)
    change = mi.Spectrum(dr.forward_to(value, flags=FLAGS))
    return change, mi.Spectrum(dr.detach(value))


class Noted(Derivative):
    """Notes of the one event that rays meet on a plane, to be asked again."""

    def of_event(self, *event: Any) -> mi.Spectrum:
        """Note the event; nothing goes on."""
        self.event = event
        return mi.Spectrum(0)


class Adjoint(Derivative):
    """What a loss makes of the light of rays goes back to the parameters, by events.

    Parameters
    ----------
    lobes : Lobes
    weights : mi.Spectrum
        Derivative of the loss by the logarithm of what each lane brings.
    """

    def __init__(self, lobes: Lobes, weights: mi.Spectrum) -> None:
        super().__init__(lobes)
        self.weights = weights

    def of_event(
        self,
        bsdf: mi.BSDFPtr,
        si: mi.SurfaceInteraction3f,
        u1: mi.Float,
        u2: mi.Point2f,
        sampled: tuple[mi.BSDFSample3f, mi.Spectrum],
        active: mi.Bool,
    ) -> mi.Spectrum:
        """Send back what an event has of the loss; nothing goes on."""
        bs, weight = sampled
        delta, lit = is_delta(bs), active & (weight > 0)
        with dr.resume_grad():
            value = mi.Spectrum(bsdf.eval(flux_context(), si, bs.wo, active & ~delta))
            if self.lobes is not Lobes.STILL:
                own = self._lobe(bsdf, si, u1, u2, active & delta)
                value = dr.select(delta, own, value)
            if dr.grad_enabled(value):
                known = mi.Spectrum(dr.detach(value))
                slope = dr.select(lit & (known > 0), self.weights / known, 0)
                dr.backward_from(dr.sum(value * slope))
        return mi.Spectrum(0)


@syntax
def sent_back(adjoint: Adjoint, event: tuple[Any, ...], lanes: int) -> mi.UInt32:
    """Send back what an event of each lane has of the loss; to be evaluated.

    In a loop: outside of one, Dr.Jit 1.5 would compute all again for each number that
    lanes share.
    """
    turn, turns = dr.zeros(mi.UInt32, lanes), dr.opaque(mi.UInt32, 1)
    while turn < turns:
        adjoint.of_event(*event)
        turn += 1
    return turn

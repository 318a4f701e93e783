"""Incident light from several directions at one point of a surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Flags, Floats
from ..collector.directions import direction
from ..transport.plane import repeated
from ..transport.scene_objects import holds_foreign_plugins
from ..transport.surface_events import flux_context


@dataclass(frozen=True)
class IncidentLight:
    """Light that meets one point of a surface from one direction after the other.

    Attributes
    ----------
    interaction : mi.SurfaceInteraction3f
        The point and its frame.
    wi : mi.Vector3f
        The directions, in its frame.
    side : int
        1 if the front is lit, -1 if the back is.
    """

    interaction: mi.SurfaceInteraction3f
    wi: mi.Vector3f
    side: int

    @classmethod
    def of(
        cls,
        incidents: Sequence[tuple[float, float]],
        side: str,
        interaction: mi.SurfaceInteraction3f | None = None,
    ) -> IncidentLight:
        """Light from angles in degrees, the polar one from the lit face's normal.

        Without an `interaction` in the middle of a square with its normal along +z.
        """
        sign = 1 if side == "front" else -1
        theta, phi = np.radians(np.asarray(incidents, dtype=float)).T
        towards = direction(theta, phi) * [1, 1, sign]
        si = _square() if interaction is None else mi.SurfaceInteraction3f(interaction)
        wi = si.to_local(mi.Vector3f(np.ascontiguousarray(towards.T)))
        dr.make_opaque(wi)
        return cls(si, wi, sign)

    def from_number(self, number: mi.UInt32) -> mi.SurfaceInteraction3f:
        """Interaction with the light of that number in each lane."""
        si = mi.SurfaceInteraction3f(self.interaction)
        si.wi = dr.gather(mi.Vector3f, self.wi, number)
        return si

    @property
    def first(self) -> mi.SurfaceInteraction3f:
        """Interaction with the first of the lights."""
        si = mi.SurfaceInteraction3f(self.interaction)
        si.wi = dr.gather(mi.Vector3f, self.wi, mi.UInt32(0))
        return si

    def towards(
        self, theta: Floats | mi.Float64, phi: Floats | mi.Float64, lower: Any
    ) -> mi.Vector3f:
        """Directions in the frame of the surface, from angles seen from the lit face.

        They are rounded to single precision once.
        """
        of_theta, of_phi = (dr.sincos(mi.Float64(angle)) for angle in (theta, phi))
        return self.towards_sines(of_theta, of_phi, lower)

    def towards_sines(
        self, theta: tuple[Any, Any], phi: tuple[Any, Any], lower: Any
    ) -> mi.Vector3f:
        """The same from the sine and cosine of each angle, in double precision."""
        (sin_theta, cos_theta), (sin_phi, cos_phi) = theta, phi
        world = mi.Vector3f(
            mi.Float(sin_theta * cos_phi),
            mi.Float(sin_theta * sin_phi),
            mi.Float(cos_theta) * dr.select(mi.Bool(lower), -self.side, self.side),
        )
        return self.interaction.to_local(world)

    def evaluate(
        self, bsdf: mi.BSDF, theta: Floats, phi: Floats, lower: Flags
    ) -> list[mi.Float]:
        """``eval`` of all channels for the first of the lights."""
        first = dr.zeros(mi.UInt32, len(theta))
        wo = self.towards(theta, phi, lower)
        si = self.from_number(first)
        if holds_foreign_plugins(bsdf):
            si = repeated(si, len(theta))
        return channels_of(bsdf.eval(flux_context(), si, wo, mi.Bool(True)))


def channels_of(value: Any) -> list[mi.Float]:
    """Channels of what a BSDF gives, be it one number for all of them, or a list."""
    if isinstance(value, list):
        return value
    return list(mi.Spectrum(value) if dr.depth_v(value) < 2 else value)


def _square() -> mi.SurfaceInteraction3f:
    """Point in the middle of a square in z = 0, as Mitsuba's `rectangle` gives it."""
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.t = 1.0
    si.uv = mi.Point2f(0.5)
    si.n = mi.Normal3f(0, 0, 1)
    si.sh_frame = mi.Frame3f(
        mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0), mi.Vector3f(0, 0, 1)
    )
    si.dp_du, si.dp_dv = mi.Vector3f(2, 0, 0), mi.Vector3f(0, 2, 0)
    return si

"""What a BSDF sends into patches, for one incident direction of a measurement."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Floats, Integers
from ..collector import Subdivision
from ..errors import SettingError
from ..files.channels import wavelengths_nm
from ..quadrature import integrate
from ..quadrature.cells import NODES_PER_CELL, Cells
from ..quadrature.incident_light import IncidentLight
from ..quadrature.rule import Rule
from ..transport.surface_events import flux_context
from ..transport.wavelengths import passes, wavelength_lanes

__all__ = ["Nodes", "PatchPredictions", "Predictions", "REL_ERR"]

# Relative error of each patch to which the nodes of the integrals are refined.
REL_ERR = 1e-4


class Predictions:
    """Predictions for one incident direction of a measurement.

    The nodes of the integrals are those that one BSDF needs, and stay until `adapt` is
    called with another one: so predictions are smooth functions of the parameters.

    Parameters
    ----------
    incident : (float, float)
        ``theta_i`` and ``phi_i`` in degrees.
    side : {"front", "back"}
    channels : sequence of str
    """

    def __init__(
        self, incident: tuple[float, float], side: str, channels: Sequence[str]
    ) -> None:
        self.incident, self.side, self.channels = incident, side, len(channels)
        nm = wavelengths_nm(channels)
        self.passes = passes([] if nm is None else nm.tolist())
        self._nodes: list[Nodes] = []

    def of(self, bsdf: mi.BSDF) -> Floats:
        """Values of all places and channels, shape (n * channels,).

        Raises
        ------
        ValueError
            If the BSDF is coloured and the measurement, of an rgb variant, is not.
        """
        parts = [
            nodes.sums(bsdf)[:, : nm and len(nm)]
            for nodes, nm in zip(self._nodes, self.passes)
        ]
        return self._of_channels(np.concatenate(parts, axis=-1))

    def _of_channels(self, values: Floats) -> Floats:
        """Values ``(..., n)`` of the channels that were measured, in one row."""
        own = values[..., : self.channels]
        if self.channels == 1 and not np.allclose(values, own, rtol=REL_ERR, atol=0):
            raise SettingError(
                "the record has one channel, as of a grey specimen, and the model is "
                "coloured: fit it to a record of R, G and B, or say a grey model"
            )
        return own.ravel()

    def _light(self, nm: Any) -> IncidentLight:
        """Light of the incident direction, of these wavelengths."""
        return IncidentLight.of([self.incident], self.side, self._interaction(nm))

    @staticmethod
    def _interaction(nm: Any) -> mi.SurfaceInteraction3f | None:
        """Point of a square in the middle of which light of these wavelengths lands."""
        if nm is None:
            return None
        scene = mi.load_dict({"type": "scene", "shape": {"type": "rectangle"}})
        si = scene.ray_intersect(mi.Ray3f([0, 0, 1], [0, 0, -1]))
        si.wavelengths = wavelength_lanes(tuple(nm))
        dr.make_opaque(si)
        return si


class PatchPredictions(Predictions):
    """Flux fractions of the patches of one incident direction.

    Parameters
    ----------
    incident, side, channels
        As of :class:`Predictions`.
    patches : Subdivision
    hemispheres : {1, 2}
        Reflection alone, or transmission too.
    """

    def __init__(
        self,
        incident: tuple[float, float],
        side: str,
        channels: Sequence[str],
        patches: Subdivision,
        hemispheres: int,
    ) -> None:
        super().__init__(incident, side, channels)
        self.subdivision, self.hemispheres = patches, hemispheres

    def begin(self) -> None:
        """Take the same few nodes in each patch, which will do for a first search."""
        cells = Cells.of(self.subdivision)
        patch = np.repeat(cells.patch, NODES_PER_CELL)
        theta, phi, lower, weight = cells.nodes()
        self._nodes = []
        for nm in self.passes:
            light = self._light(nm)
            rule = Rule(self.subdivision, patch, theta, phi, lower, weight, light)
            self._nodes.append(Nodes.of(rule, self.n_patches))

    @property
    def n_patches(self) -> int:
        """Patches of all hemispheres of the record."""
        return self.hemispheres * self.subdivision.n_patches

    def adapt(self, bsdf: mi.BSDF) -> Floats:
        """:meth:`of` a BSDF, with the nodes that it needs from now on."""
        self._nodes, parts = [], []
        for nm in self.passes:
            found = integrate(
                bsdf,
                *self.incident,
                self.subdivision,
                rel_err=REL_ERR,
                side=self.side,
                interaction=self._interaction(nm),
            )
            self._nodes.append(Nodes.of(found.rule, self.n_patches))
            parts.append(found.flux[: self.hemispheres, ..., : nm and len(nm)])
        return self._of_channels(np.concatenate(parts, axis=-1))


class Nodes:
    """Nodes of sums over places.

    Parameters
    ----------
    light : IncidentLight
    place : ndarray of int, shape (n,)
        To which each node belongs.
    angles : (ndarray, ndarray, ndarray)
        Polar angle from the pole of its hemisphere, azimuth, and whether that is the
        lower one; shapes (n,).
    weight : ndarray, shape (n,)
        In sr.
    n_places : int
    """

    def __init__(
        self,
        light: IncidentLight,
        place: Integers,
        angles: tuple[Any, Any, Any],
        weight: Floats,
        n_places: int,
    ) -> None:
        self.n_places, self.place, self.weight = n_places, place, weight
        self.si, self.wo = light.first, light.towards(*angles)
        dr.eval(self.wo)

    @classmethod
    def of(cls, rule: Rule, n_patches: int) -> Nodes:
        """The nodes of a rule in the first `n_patches` patches."""
        kept = rule.patch < n_patches
        angles = rule.theta[kept], rule.phi[kept], rule.lower[kept]
        weight = (rule.weight * np.sin(rule.theta))[kept]
        return cls(rule.light, rule.patch[kept], angles, weight, n_patches)

    def sums(self, bsdf: mi.BSDF) -> Floats:
        """Sums over the places, shape (n_places, channels)."""
        columns = [
            np.bincount(
                self.place,
                self.weight * np.broadcast_to(value.numpy(), len(self.weight)),
                minlength=self.n_places,
            )
            for value in bsdf.eval(flux_context(), self.si, self.wo, mi.Bool(True))
        ]
        return np.stack(columns, axis=-1)

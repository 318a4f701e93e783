"""What a BSDF sends into the patches of one incident direction of a record."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Floats
from ..errors import SettingError
from ..files.channels import wavelengths_nm
from ..quadrature import integrate
from ..quadrature.cells import NODES_PER_CELL, Cells
from ..quadrature.incident_light import IncidentLight
from ..quadrature.rule import Rule
from ..results.record import Record
from ..transport.loop import flux_context
from ..transport.wavelengths import passes, wavelength_lanes

__all__ = ["PatchPredictions"]

# Relative error of each patch to which the nodes of the integrals are refined.
REL_ERR = 1e-4


class PatchPredictions:
    """Predictions for the patches of one incident direction.

    The nodes of the integrals are those that one BSDF needs, and stay until
    :meth:`adapt` is called with another one: so predictions are smooth functions of
    the parameters.

    Parameters
    ----------
    single : Record
        Of one incident direction.
    """

    def __init__(self, single: Record) -> None:
        self.theta_i, self.phi_i = float(single.theta_i[0]), float(single.phi_i[0])
        self.subdivision = single.subdivision
        self.side = single.settings.get("side", "front")
        self.hemispheres = 1 + single.has_lower
        self.channels = len(single.channels)
        nm = wavelengths_nm(single.channels)
        self.passes = passes([] if nm is None else nm.tolist())
        self._nodes: list[_Nodes] = []

    def begin(self) -> None:
        """Take the same few nodes in each patch, which will do for a first search."""
        cells = Cells.of(self.subdivision)
        patch = np.repeat(cells.patch, NODES_PER_CELL)
        theta, phi, lower, weight = cells.nodes()
        self._nodes = []
        for nm in self.passes:
            angles = [(self.theta_i, self.phi_i)]
            light = IncidentLight.of(angles, self.side, self._interaction(nm))
            rule = Rule(self.subdivision, patch, theta, phi, lower, weight, light)
            self._nodes.append(_Nodes(rule, self.n_patches))

    @property
    def n_patches(self) -> int:
        """Patches of all hemispheres of the record."""
        return self.hemispheres * self.subdivision.n_patches

    def adapt(self, bsdf: mi.BSDF) -> Floats:
        """:meth:`of` a BSDF, with the nodes that it needs from now on.

        Raises
        ------
        ValueError
            If it is coloured and the record, of an rgb variant, has one channel.
        """
        self._nodes, parts = [], []
        for nm in self.passes:
            found = integrate(
                bsdf,
                self.theta_i,
                self.phi_i,
                self.subdivision,
                rel_err=REL_ERR,
                side=self.side,
                interaction=self._interaction(nm),
            )
            self._nodes.append(_Nodes(found.rule, self.n_patches))
            parts.append(found.flux[: self.hemispheres, ..., : nm and len(nm)])
        flux = np.concatenate(parts, axis=-1)
        one = flux[..., : self.channels]
        if self.channels == 1 and not np.allclose(flux, one, rtol=REL_ERR, atol=0):
            raise SettingError(
                "the record has one channel, as of a grey specimen, and the model is "
                "coloured: fit it to a record of R, G and B, or say a grey model"
            )
        return one.ravel()

    def of(self, bsdf: mi.BSDF) -> Floats:
        """Flux fractions, shape (n_hemispheres * n_patches * channels,)."""
        parts = [
            nodes.sums(bsdf)[:, : nm and len(nm)]
            for nodes, nm in zip(self._nodes, self.passes)
        ]
        return np.concatenate(parts, axis=-1)[:, : self.channels].ravel()

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


class _Nodes:
    """The nodes of a rule in the first `n_patches` patches."""

    def __init__(self, rule: Rule, n_patches: int) -> None:
        kept = rule.patch < n_patches
        self.n_patches = n_patches
        self.patch = rule.patch[kept]
        self.weight = (rule.weight * np.sin(rule.theta))[kept]
        self.si = rule.light.first
        self.wo = rule.light.towards(rule.theta[kept], rule.phi[kept], rule.lower[kept])
        dr.eval(self.wo)

    def sums(self, bsdf: mi.BSDF) -> Floats:
        """Integrals over the patches, shape (n_patches, channels)."""
        columns = [
            np.bincount(
                self.patch,
                self.weight * np.broadcast_to(value.numpy(), len(self.weight)),
                minlength=self.n_patches,
            )
            for value in bsdf.eval(flux_context(), self.si, self.wo)
        ]
        return np.stack(columns, axis=-1)

"""Fluxes and means that a BSDF predicts for patches, cones and directions."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...array_types import Floats, Integers
from ...collector import Subdivision
from ...collector.directions import angles, direction
from ...errors import SettingError
from ...files.measured_table import MeasuredTable
from ...quadrature import integrate
from ...quadrature.cells import NODES_PER_CELL, Cells
from ...quadrature.evaluator import IncidentLight, square
from ...quadrature.integrate import Rule
from ...results.record import Record, wavelengths_nm
from ...specimen.wavelengths import passes, wavelength_lanes
from ...transport.surface_events import flux_context

# Relative error of each patch to which the nodes of the integrals are refined, where
# observations do not ask for less; the least that single precision of `eval` allows.
INTEGRAL_ERR, MIN_INTEGRAL_ERR = 1e-4, 1e-6


@dataclass(eq=False)
class Predictions(ABC):
    """Predictions for one incident direction of a measurement.

    The nodes of the integrals are those that one BSDF needs, and stay until `adapt` is
    called with another one: so predictions are smooth functions of the parameters.

    Parameters
    ----------
    incident : (float, float)
        ``theta_i`` and ``phi_i`` in degrees.
    side : {"front", "back"}
    channels : sequence of str

    Attributes
    ----------
    integral_err : float
        Error of each value, relative to it or to the mean of all, to which `adapt`
        refines the nodes; 0 for values without an integral.
    """

    incident: tuple[float, float]
    side: str
    channels: Sequence[str]
    integral_err: float = field(default=INTEGRAL_ERR, init=False)

    def __post_init__(self) -> None:
        nm = wavelengths_nm(self.channels)
        self.passes = passes([] if nm is None else nm.tolist())
        self._nodes: list[Nodes] = []

    def refine_to(self, integral_err: float) -> None:
        """Refine the nodes to this error from now on."""
        self.integral_err = integral_err

    @abstractmethod
    def begin(self) -> None:
        """Take a few nodes, which will do for a first search."""

    @abstractmethod
    def adapt(self, bsdf: mi.BSDF) -> Floats:
        """:meth:`of` a BSDF, with the nodes that it needs from now on."""

    def of(self, bsdf: mi.BSDF) -> Floats:
        """Values of all places and channels, shape (n * channels,).

        Raises
        ------
        ValueError
            If the BSDF is coloured and the measurement, of an rgb variant, is not.
        """
        each = zip(self._nodes, self.passes)
        parts = [nodes.sums(bsdf)[:, : nm and len(nm)] for nodes, nm in each]
        return self._measured_channels(np.concatenate(parts, axis=-1))

    def _measured_channels(self, values: Floats) -> Floats:
        """Values ``(..., n)`` of the channels that were measured, in one row."""
        n = len(self.channels)
        own = values[..., :n]
        if n == 1 and not np.allclose(values, own, rtol=INTEGRAL_ERR, atol=0):
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
        si = square()
        si.wavelengths = wavelength_lanes(tuple(nm))
        return si


@dataclass(eq=False)
class PatchPredictions(Predictions):
    """Flux fractions of the patches of one incident direction.

    Parameters
    ----------
    incident, side, channels
        As of :class:`Predictions`.
    subdivision : Subdivision
    hemispheres : {1, 2}
        Reflection alone, or transmission too.
    means_of : ndarray of int, optional
        Patches whose means in 1/sr are predicted instead; ``n_patches`` more in the
        lower hemisphere.
    """

    subdivision: Subdivision
    hemispheres: int
    means_of: Integers | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        self.n_patches = self.hemispheres * self.subdivision.n_patches

    def begin(self) -> None:
        """See :class:`Predictions`: the same few in each patch."""
        cells = Cells.of(self.subdivision)
        patch = np.repeat(cells.patch, NODES_PER_CELL)
        theta, phi, lower, weight = cells.nodes()
        self._nodes = []
        for nm in self.passes:
            light = self._light(nm)
            rule = Rule(self.subdivision, patch, theta, phi, lower, weight, light)
            self._nodes.append(Nodes.of(rule, self.n_patches))

    def _measured_channels(self, values: Floats) -> Floats:
        """See :class:`Predictions`; means have one channel."""
        flux = super()._measured_channels(values)
        if self.means_of is None:
            return flux
        solid = self.subdivision.projected_solid_angles.ravel()
        return flux[self.means_of] / solid[self.means_of % len(solid)]

    def adapt(self, bsdf: mi.BSDF) -> Floats:
        """See :class:`Predictions`."""
        self._nodes, parts = [], []
        for nm in self.passes:
            found = integrate(
                bsdf,
                *self.incident,
                self.subdivision,
                integral_err=self.integral_err,
                side=self.side,
                interaction=self._interaction(nm),
            )
            self._nodes.append(Nodes.of(found.rule, self.n_patches))
            flux = found.flux.reshape(-1, found.flux.shape[-1])
            parts.append(flux[: self.n_patches, : nm and len(nm)])
        return self._measured_channels(np.concatenate(parts, axis=-1))


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


# Nodes along the radius of a cone, to begin with and at most; four times as many about
# its axis.
MIN_NODES, MAX_NODES = 2, 16


@dataclass(eq=False)
class ConePredictions(Predictions):
    """Values of cones for one incident direction of a table, or of apertures.

    Parameters
    ----------
    incident, side, channels
        As of :class:`Predictions`.
    axes : ndarray, shape (n, 2)
        Polar angles from the pole of their hemisphere, and azimuths, in degrees.
    lower : bool
        Whether the cones are in the lower hemisphere.
    half_angle : float
        Of the cones in degrees; 0 for their axes alone, and means.
    means : bool
        Whether values are means of the BSDF in 1/sr, weighted with the cosine, and not
        flux fractions. What would lie below the horizon is left out.
    """

    axes: Floats
    lower: bool
    half_angle: float
    means: bool

    def refine_to(self, integral_err: float) -> None:
        """Refine the nodes to this error from now on, if there are integrals."""
        super().refine_to(integral_err if self.half_angle else 0.0)

    def begin(self) -> None:
        """See :class:`Predictions`."""
        self._take(MIN_NODES)

    def adapt(self, bsdf: mi.BSDF) -> Floats:
        """See :class:`Predictions`."""
        n, settled = MIN_NODES, not self.half_angle
        self._take(n)
        found = self.of(bsdf)
        while n < MAX_NODES and not settled:
            n *= 2
            self._take(n)
            before, found = found, self.of(bsdf)
            change, size = np.abs(found - before), np.abs(found)
            allowed = self.integral_err * (size + size.mean())
            settled = bool(np.all(change <= allowed))
        return found

    def _take(self, n: int) -> None:
        """Take `n` nodes along the radius of each cone."""
        wo, weight = self._about(n)
        place = np.repeat(np.arange(len(wo)), wo.shape[1])
        if self.means:
            solid = np.bincount(place, (weight * wo[..., 2]).ravel())
            weight = weight / solid[:, None]
        kept = weight.ravel() > 0
        theta, phi = angles(wo.reshape(-1, 3)[kept])
        towards = theta, phi, np.full(len(theta), self.lower)
        self._nodes = [
            Nodes(self._light(nm), place[kept], towards, weight.ravel()[kept], len(wo))
            for nm in self.passes
        ]

    def _about(self, n: int) -> tuple[Floats, Floats]:
        """Directions about each axis, shape (n_axes, m, 3), and weights in sr."""
        theta, phi = np.radians(self.axes).T
        axis = direction(theta, phi)
        if not self.half_angle:
            return axis[:, None], np.ones((len(axis), 1))
        down = direction(theta + np.pi / 2, phi)
        across = np.cross(axis, down)
        x, w = np.polynomial.legendre.leggauss(n)
        low = np.cos(np.radians(self.half_angle))
        cosine = np.repeat(low + (1 - low) * (x + 1) / 2, 4 * n)
        weight = np.repeat(w * (1 - low) / 2, 4 * n) * (2 * np.pi / (4 * n))
        turn = np.tile((np.arange(4 * n) + 0.5) * (2 * np.pi / (4 * n)), n)
        sine = np.sqrt(1 - cosine**2)
        local = np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine])
        wo = np.einsum("kij,km->imj", np.stack([down, across, axis]), local)
        return wo, np.where(wo[..., 2] > 0, weight, 0.0)


def predictions_of_record(
    single: Record,
) -> list[PatchPredictions] | list[ConePredictions]:
    """What predicts the detectors of a record, hemisphere by hemisphere if cones."""
    patches = single.subdivision
    half_angle = patches.aperture_half_angle
    incident = float(single.theta_i[0]), float(single.phi_i[0])
    light = incident, single.asked.side, single.channels
    if half_angle is None:
        return [PatchPredictions(*light, patches, single.n_hemispheres)]
    axes = np.degrees(np.concatenate(patches.middles, axis=1))[: patches.n_detectors]
    return [
        ConePredictions(*light, axes, lower, half_angle, means=False)
        for lower in (False, True)[: single.n_hemispheres]
    ]


def predictions_of_table(
    table: MeasuredTable,
) -> tuple[list[PatchPredictions | ConePredictions], Integers]:
    """What predicts the rows of a table, by incident direction, and their order.

    Means over its aperture or else its patches, or the BSDF in its directions.
    """
    rows = [
        np.flatnonzero((table.theta_i == theta_i) & (table.phi_i == phi_i))
        for theta_i, phi_i in table.incident
    ]
    each = [_means(table, *pair) for pair in zip(table.incident, rows)]
    return each, np.argsort(np.concatenate(rows))


def _means(
    table: MeasuredTable, incident: tuple[float, float], rows: Integers
) -> PatchPredictions | ConePredictions:
    """What predicts some rows of a table, of one incident direction."""
    lower = table.quantity == "btdf"
    theta = table.theta_o[rows]
    theta, phi = 180 - theta if lower else theta, table.phi_o[rows]
    light = incident, "front", [table.channel or "Y"]
    patches = table.patches
    if patches is not None:
        number = patches.patch(direction(np.radians(theta), np.radians(phi)))
        means_of = number + lower * patches.n_patches
        return PatchPredictions(*light, patches, 1 + lower, means_of)
    axes, half_angle = np.stack([theta, phi], axis=-1), table.aperture_half_angle or 0.0
    return ConePredictions(*light, axes, lower, half_angle, means=True)


def check_table(table: MeasuredTable) -> None:
    """Raise ValueError for a table that no BSDF can be fitted to."""
    if table.emitter_half_angle:
        raise SettingError(
            f"a fit needs a collimated beam, but {table.name} has an "
            f"emitter_half_angle of {table.emitter_half_angle:g} degrees"
        )
    if mi.is_rgb or (mi.is_spectral and wavelengths_nm([table.channel or ""]) is None):
        raise SettingError(
            "a fit to a table needs the variant llvm_ad_mono, or llvm_ad_spectral if "
            f"its channel is a wavelength such as 550nm, got {mi.variant()}"
        )
    if not table.bsdf.any():
        raise SettingError(f"a fit needs light, but all values of {table.name} are 0")
    if table.bsdf.sum() <= 0:
        raise SettingError(
            f"a fit needs light, but the values of {table.name} are negative on average"
        )


def near_field(record: Record) -> list[str]:
    """Note on a near-field collector, whose directions differ from a model's."""
    asked = record.asked
    if not asked.collector_radius or asked.footprint == "point":
        return []
    return [
        f"the collector is {asked.collector_radius:g} away from a footprint "
        f"({asked.footprint}), and the model's light is that far away from it"
    ]


def check_record(record: Record) -> None:
    """Raise ValueError for a record that no BSDF can be fitted to."""
    spectral = wavelengths_nm(record.channels) is not None
    colours = len(record.channels) > 1 and not spectral
    if spectral != mi.is_spectral or (colours and not mi.is_rgb):
        raise SettingError(
            f"the variant must be the record's, {record.provenance.variant}, got "
            f"{mi.variant()}"
        )
    filled = record.asked.divergence or record.asked.incident is not None
    if filled or not np.isfinite(record.theta_i).all():
        raise SettingError("a fit needs a record of a collimated beam")
    if not record.flux_fraction.any():
        raise SettingError(f"a fit needs light, got none (order: {record.asked.order})")
    if np.isnan(record.brdf_std_err[record.brdf > 0]).any():
        raise SettingError("a fit needs a record with error bars, of several batches")

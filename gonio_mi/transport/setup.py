"""The setup of a measurement: one specimen, one beam and one collector."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Floats
from ..results.tally import Fate
from ..settings.measurement_settings import MeasurementSettings
from ..settings.values import Order
from ..specimen.digest import emitter_digest, plugins_digest
from ..specimen.specimen import Specimen
from ..specimen.wavelengths import passes
from .beam import Beam
from .collector_sphere import CollectorSphere
from .exits import Exits, OrderClasses
from .layers import layers_of
from .method import Method

# Bins of sums that have room for rare powers before any is met, at most.
MAX_ROOMY_BINS = 2**16


def incident_key(incident: tuple[float, float] | None) -> tuple[int, ...]:
    """Whole numbers that tell a direction from others; they seed its random numbers.

    A direction has the same bits alone and in any stack.
    """
    if incident is None:
        return (0,)
    # no minus zero
    return tuple((np.array(incident, dtype=float) + 0.0).view(np.uint64).tolist())


class Setup:
    """One specimen, one beam and one collector, ready to be launched at.

    Parameters
    ----------
    settings : MeasurementSettings
    method : Method
        Of their estimator.
    specimen : Specimen
    beam : Beam
    collector : CollectorSphere
    sampler : mi.Sampler
    incident : (float, float), optional
        Angles in degrees that the beam was made for.
    described : str, optional
        Digest of the beam's emitter before it was turned, if it was; None remains for a
        collimated beam, whose direction is all there is.
    """

    def __init__(
        self,
        settings: MeasurementSettings,
        method: Method,
        specimen: Specimen,
        beam: Beam,
        collector: CollectorSphere,
        sampler: mi.Sampler,
        incident: tuple[float, float] | None = None,
        described: str | None = None,
    ) -> None:
        self.settings = settings
        self.method = method
        self.specimen = specimen
        self._aim(beam, incident)
        # set if all that rays meet are infinite layers
        self.layers = layers_of(specimen, beam.side)
        if beam.collimated:
            self.emitter_digest = None
        else:
            self.emitter_digest = described or emitter_digest([beam.emitter])
        self.collector = collector
        self.sampler = sampler
        self.choice: str | None = None  # why this estimator, if it was left to `auto`
        self.source: Any = None  # what has to live as long as the beam's emitter
        subdivision = collector.subdivision
        both = collector.hemispheres == "both" or (
            collector.hemispheres == "auto" and specimen.transmits
        )
        self.shape = (1 + both, *subdivision.shape)
        self.n_patches = subdivision.n_patches
        self.n_collected = self.shape[0] * self.n_patches
        self.n_bins = self.n_collected + len(Fate)
        self._radii: Any = None
        self.orders: tuple[Order, ...] = ()
        self.classes = OrderClasses()
        # of powers beyond the ordinary that sums have room for: what was met so far
        self.levels = method.levels if self.n_bins <= MAX_ROOMY_BINS else range(0)

    def turned(self, beam: Beam, incident: tuple[float, float]) -> Setup:
        """The same setup for another direction of its collimated beam."""
        other = copy(self)
        other._aim(beam, incident)
        return other

    def _aim(self, beam: Beam, incident: tuple[float, float] | None) -> None:
        """Set the beam and what follows from its direction."""
        self.beam = beam
        # tells its rays from others of the same seed
        self.key = (self.settings.seed, *incident_key(incident))
        # as asked for, or what single precision leaves of the emitter's direction
        self.theta_i, self.phi_i = incident or (beam.theta_i, beam.phi_i)

    @property
    def passes(self) -> list[Any]:
        """Wavelengths of each time that the rays are sent: four at most."""
        return passes(self.settings.wavelengths)

    @property
    def samples(self) -> bool:
        """Whether rays are needed."""
        return self.method.samples(self)

    @property
    def order(self) -> Order:
        """Which rays are collected."""
        return self.method.order(self.settings)

    def collect_by_distance(self, radii: Floats) -> None:
        """Let ring `i` collect what leaves between ``radii[i - 1]`` and ``radii[i]``.

        From the middle of the footprint, whatever the direction; the first ring what is
        nearer than the first of `radii`, the last one what is beyond the last.
        """
        self._radii = mi.Float(radii.tolist())
        dr.make_opaque(self._radii)

    def collect_orders(self, orders: Sequence[Order]) -> None:
        """Let each of the scattering orders have patches and fates of its own."""
        self.orders = tuple(orders)
        self.classes = OrderClasses(self.method.kept_apart(orders))

    def _patch(self, exits: Exits, d: mi.Vector3f) -> mi.UInt32:
        """Number of the patch of light that arrives in the direction `d`."""
        if self._radii is None:
            return self.collector.patch_index(d)
        x, y, _ = self.beam.middle.tolist()
        distance = dr.norm(mi.Vector2f(exits.p.x - x, exits.p.y - y))
        return dr.binary_search(
            0,
            self.n_patches - 1,
            lambda i: dr.gather(mi.Float, self._radii, i) <= distance,
        )

    @property
    def digests(self) -> dict[str, str | None]:
        """What tells the specimen and the emitter from others, for the settings."""
        things = [*self.specimen.scene.shapes(), self.beam.emitter]
        return {
            "digest": self.specimen.digest,
            "emitter_digest": self.emitter_digest,
            "plugin_digest": plugins_digest(things),
        }

    def bins(self, exits: Exits) -> mi.UInt32:
        """Index of the patch that each ray reached, or of its fate's bin behind."""
        d = self.collector.arrival(exits.p, exits.d)
        up = self.beam.side * d.z
        direct = exits.fate == mi.UInt32(Fate.DIRECT)
        # comparisons with NaN are false
        left = (exits.fate == mi.UInt32(Fate.REFLECTED)) & (dr.abs(up) > 0)
        lower = up < 0
        left |= direct & lower
        patch = dr.minimum(self._patch(exits, d), self.n_patches - 1)
        fate = dr.select(
            (exits.fate == mi.UInt32(Fate.REFLECTED)) | (direct & ~lower),
            mi.UInt32(Fate.SIDEWAYS),
            exits.fate,
        )
        if self.shape[0] == 2:
            patch += dr.select(lower, mi.UInt32(self.n_patches), mi.UInt32(0))
        else:
            passed = left & lower & ~direct
            fate = dr.select(passed, mi.UInt32(Fate.TRANSMITTED), fate)
            left &= ~lower
        return dr.select(left, patch, self.n_collected + fate)

    def fate_bins(self, bins: mi.UInt32, direct: mi.Bool) -> mi.UInt32:
        """Bins of the fates of rays whose `bins` may be those of patches."""
        reflected = mi.UInt32(self.n_collected + Fate.REFLECTED)
        transmitted = mi.UInt32(self.n_collected + Fate.TRANSMITTED)
        transmitted += dr.select(direct, Fate.DIRECT - Fate.TRANSMITTED, mi.UInt32(0))
        fate = dr.select(bins < self.n_patches, reflected, transmitted)
        return dr.select(bins < self.n_collected, fate, bins)

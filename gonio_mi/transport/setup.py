"""The setup of a measurement: one specimen, one beam and one collector."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from ..results.tally import Fate
from ..settings.measurement_settings import MeasurementSettings
from ..settings.values import Order
from ..specimen.digest import kinds_of, plugins_digest
from ..specimen.specimen import Specimen
from ..specimen.wavelengths import passes
from .beam import Beam
from .collector_sphere import CollectorSphere
from .exits import Exits, OrderClasses
from .layers import Layers
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


class Sizes(NamedTuple):
    """Numbers that kernels read, so that those of another collector compile nothing.

    Attributes
    ----------
    patches, collected, bins : mi.UInt32
        Patches of a hemisphere, of all hemispheres, and these and the fates.
    """

    patches: Any
    collected: Any
    bins: Any


@dataclass(frozen=True, eq=False)
class Setup:
    """One specimen, one beam and one collector, ready to be launched at.

    Attributes
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
    emitter_digest : str, optional
        None for a collimated beam, whose direction is all there is.
    source : object, optional
        What has to live as long as the beam's emitter.
    orders : tuple of Order
        To be collected apart: each has patches and fates of its own.
    defects : tuple of str
        Sentences on what is measured of the specimen, but is not right.
    choice : str, optional
        Why this estimator, if it was left to `auto`.
    layers : Layers, optional
        Where all that rays meet are infinite layers.
    gradients : Gradients, optional
        Parameters by which light is differentiated.
    radii : mi.Float, optional
        Ring `i` collects what leaves between ``radii[i - 1]`` and ``radii[i]`` from the
        middle of the footprint, whatever the direction; the first ring what is nearer
        than the first of them, the last one what is beyond the last.
    """

    settings: MeasurementSettings
    method: Method
    specimen: Specimen
    beam: Beam
    collector: CollectorSphere
    sampler: mi.Sampler
    incident: tuple[float, float] | None = None
    emitter_digest: str | None = None
    source: Any = None
    orders: tuple[Order, ...] = ()
    defects: tuple[str, ...] = ()
    choice: str | None = None
    layers: Layers | None = None
    radii: Any = None
    gradients: Any = None

    def turned(self, beam: Beam, incident: tuple[float, float]) -> Setup:
        """The same setup for another direction of its collimated beam."""
        return replace(self, beam=beam, incident=incident)

    @property
    def theta_i(self) -> float:
        """Polar angle as asked for, or that of the emitter in single precision."""
        return self.incident[0] if self.incident else self.beam.theta_i

    @property
    def phi_i(self) -> float:
        """Azimuth, likewise."""
        return self.incident[1] if self.incident else self.beam.phi_i

    @cached_property
    def key(self) -> tuple[int, ...]:
        """What tells its rays from others of the same seed."""
        return (self.settings.seed, *incident_key(self.incident))

    @cached_property
    def shape(self) -> tuple[int, int, int]:
        """Hemispheres, rings and sectors of the patches."""
        both = self.collector.hemispheres == "both" or (
            self.collector.hemispheres == "auto" and self.specimen.transmits
        )
        return (1 + both, *self.collector.subdivision.shape)

    @property
    def n_patches(self) -> int:
        """Patches of a hemisphere."""
        return self.collector.subdivision.n_patches

    @property
    def n_collected(self) -> int:
        """Patches of all hemispheres."""
        return self.shape[0] * self.n_patches

    @property
    def n_bins(self) -> int:
        """Patches and fates."""
        return self.n_collected + len(Fate)

    @cached_property
    def sizes(self) -> Sizes:
        """Numbers of patches and bins, for kernels."""
        sizes = self.n_patches, self.n_collected, self.n_bins
        return Sizes(*(dr.opaque(mi.UInt32, n) for n in sizes))

    @property
    def levels(self) -> range:
        """Levels of rare powers that sums have room for before any is met."""
        return self.method.levels if self.n_bins <= MAX_ROOMY_BINS else range(0)

    @cached_property
    def classes(self) -> OrderClasses:
        """Classes of rays that have sums of their own."""
        return OrderClasses(self.method.kept_apart(self.orders))

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

    def _patch(self, exits: Exits, d: mi.Vector3f) -> mi.UInt32:
        """Number of the patch of light that arrives in the direction `d`."""
        radii = self.radii
        if radii is None:
            return self.collector.patch_index(d)
        x, y, _ = self.beam.middle.tolist()
        distance = dr.norm(mi.Vector2f(exits.p.x - x, exits.p.y - y))
        return dr.binary_search(
            0, self.n_patches - 1, lambda i: dr.gather(mi.Float, radii, i) <= distance
        )

    @property
    def digests(self) -> dict[str, str | None]:
        """What tells the specimen and the emitter from others, for the settings."""
        emitter = self.beam.emitter
        # without a source it is a collimated one of ours, which holds nothing
        lit = {type(emitter)} if self.source is None else kinds_of([emitter])
        return {
            "digest": self.specimen.digest,
            "emitter_digest": self.emitter_digest,
            "plugin_digest": plugins_digest(self.specimen.kinds | lit),
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
        patch = dr.minimum(self._patch(exits, d), self.sizes.patches - 1)
        fate = dr.select(
            (exits.fate == mi.UInt32(Fate.REFLECTED)) | (direct & ~lower),
            mi.UInt32(Fate.SIDEWAYS),
            exits.fate,
        )
        if self.shape[0] == 2:
            patch += dr.select(lower, self.sizes.patches, mi.UInt32(0))
        else:
            passed = left & lower & ~direct
            fate = dr.select(passed, mi.UInt32(Fate.TRANSMITTED), fate)
            left &= ~lower
        return dr.select(left, patch, self.fate_bin(fate))

    def fate_bin(self, fate: Fate | mi.UInt32) -> mi.UInt32:
        """Bin of a :class:`Fate`."""
        return self.sizes.collected + mi.UInt32(fate)

    def fate_bins(self, bins: mi.UInt32, direct: mi.Bool) -> mi.UInt32:
        """Bins of the fates of rays whose `bins` may be those of patches."""
        reflected = self.fate_bin(Fate.REFLECTED)
        transmitted = self.fate_bin(Fate.TRANSMITTED)
        transmitted += dr.select(direct, Fate.DIRECT - Fate.TRANSMITTED, mi.UInt32(0))
        fate = dr.select(bins < self.sizes.patches, reflected, transmitted)
        return dr.select(bins < self.sizes.collected, fate, bins)

"""Exits: what became of rays, and which are collected by their scattering order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Flags, Integers
from ..results.tally import Fate
from ..settings.values import ALL_ORDERS, UNLIMITED, Order
from ..specimen.rays import exit_distance


@dataclass
class Exits:
    """What became of each ray.

    Attributes
    ----------
    p, d : mi.Point3f, mi.Vector3f
        Last point on the specimen and direction of flight, where `fate` is REFLECTED.
    throughput : mi.Spectrum
        Power left, a whole number for the analog estimator; in polarised variants a
        Mueller matrix in frames of s = k x z.
    fate : mi.UInt32
        :class:`Fate`; REFLECTED stands for having left in any direction after an event,
        DIRECT for having left without any.
    incident : mi.UnpolarizedSpectrum
        Power that met the specimen.
    depth : mi.UInt32
        Surface events, the one among them that ended the ray.
    left, density : mi.Point3f, mi.Float
        Where the last of them was, and the density in 1/sr of the direction that it
        chose: infinite for delta components, and without any event. None for all
        estimators but `next_event`.
    flight : Flight
        Of rays that were cut off: towards what they met.
    change : mi.Spectrum
        Derivative of the throughput by a parameter; None where none is asked for.
    over_the_edge : mi.Bool
        Whether they passed a side of a free-standing specimen's bounding box; None
        where there is none.
    """

    p: Any
    d: Any
    throughput: Any
    fate: Any
    incident: Any
    depth: Any
    left: Any = None
    density: Any = None
    flight: Any = None
    over_the_edge: Any = None
    change: Any = None


def exits_of(
    specimen: Any,
    flight: Any,
    throughput: mi.Spectrum,
    fate: mi.UInt32,
    incident: mi.UnpolarizedSpectrum,
    depth: mi.UInt32,
) -> Exits:
    """Exits of rays at the end of their flight."""
    ray = flight.ray
    incident = dr.select(fate == mi.UInt32(Fate.MISSED), 0.0, incident)
    leaves = ray.o + flight.shift, ray.d, throughput, fate, incident, depth
    by_a_side = leaves_by_a_side(specimen, ray.o, ray.d)
    return Exits(*leaves, flight=flight, over_the_edge=by_a_side)


def leaves_by_a_side(specimen: Any, o: mi.Point3f, d: mi.Vector3f) -> mi.Bool:
    """Whether a ray from inside the bounding box crosses one of its four sides.

    A periodic specimen has none.
    """
    if specimen.periodic:
        return mi.Bool(False)
    low, high = specimen.box.low, specimen.box.high
    # a ray that starts just outside of a face has passed it
    t_x, t_y, t_z = (
        dr.maximum(exit_distance(low[i], high[i], o[i], d[i]), 0) for i in range(3)
    )
    # the horizon is at an infinite distance in z
    return ~(dr.minimum(t_x, t_y) >= t_z)


def of_order(exits: Exits, order: Order) -> Exits:
    """Exits whose rays of another :class:`Order` have the fate OTHER_ORDER.

    Those that were cut off or ended after its most events are among them.
    """
    if order == ALL_ORDERS:
        return exits
    fate = exits.fate
    left = (fate == mi.UInt32(Fate.REFLECTED)) | (fate == mi.UInt32(Fate.SIDEWAYS))
    left |= fate == mi.UInt32(Fate.DIRECT)
    # one kernel for all of them
    least, most = (dr.opaque(mi.UInt32, n) for n in (order.least, order.most))
    other = (left & (exits.depth < least)) | (exits.depth > most)
    other |= (fate == mi.UInt32(Fate.TRUNCATED)) & (exits.depth >= most)
    return replace(exits, fate=dr.select(other, mi.UInt32(Fate.OTHER_ORDER), fate))


class OrderClasses:
    """Ray classes, by number of events, from which the orders are summed.

    Parameters
    ----------
    orders : sequence of Order
        Those of one class of all rays if there is none.
    """

    def __init__(self, orders: Sequence[Order] = ()) -> None:
        edges = {0, *(one.least for one in orders), *(one.most + 1 for one in orders)}
        self._first = np.array(sorted(edges - {UNLIMITED + 1}))
        self._last = np.append(self._first[1:] - 1, UNLIMITED)

    def __len__(self) -> int:
        return len(self._first)

    def number(self, depth: mi.UInt32) -> mi.UInt32:
        """Number of the class of rays that met so many events."""
        number = mi.UInt32(0)
        for first in self._first[1:].tolist():
            number += dr.select(depth >= first, mi.UInt32(1), 0)
        return number

    def within(self, order: Order) -> Flags:
        """Which of the classes the order is made of."""
        within: Flags = (self._first >= order.least) & (self._last <= order.most)
        return within

    def rays(self, order: Order, rays: Integers, shape: tuple[int, ...]) -> Integers:
        """Rays in the bins as if only `order` had been traced, as `of_order` does.

        Parameters
        ----------
        order : Order
        rays : ndarray of int64, shape (n_classes, n_batches, n_bins)
            In the patches of a collector of that `shape`, and behind them the fates.

        Returns
        -------
        ndarray of int64, shape (n_batches, n_bins)
        """
        n_collected = int(np.prod(shape))
        rays, over_the_edge = np.split(rays, [n_collected + Fate.OVER_THE_EDGE], axis=2)
        within, before = self.within(order), self._last < order.least
        kept = rays[within].sum(axis=0)
        other = rays[self._first > order.most].sum(axis=(0, 2))
        patches, fates = np.split(rays[before].sum(axis=0), [n_collected], axis=1)
        other += patches.sum(axis=1)
        # direct light is in its patch too, if that is there
        left = [Fate.SIDEWAYS, Fate.TRANSMITTED, Fate.DIRECT][: 4 - shape[0]]
        other += fates[:, left].sum(axis=1)
        fates[:, [*left, Fate.DIRECT]] = 0
        if order.most < UNLIMITED:  # then one class holds `most` events alone
            other += kept[:, n_collected + Fate.TRUNCATED]
            kept[:, n_collected + Fate.TRUNCATED] = 0
        kept[:, n_collected:] += fates
        kept[:, n_collected + Fate.OTHER_ORDER] += other
        return np.append(kept, over_the_edge[within].sum(axis=0), axis=1)

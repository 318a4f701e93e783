"""Scattering orders: which rays are collected, by their number of surface events."""

from dataclasses import replace

import drjit as dr
import mitsuba as mi

from ..results.tally import Fate
from ..settings.orders import ALL_ORDERS, Order
from .loop import Exits

__all__ = ["of_order"]


def of_order(exits: Exits, order: Order) -> Exits:
    """Exits whose rays of another :class:`Order` have the fate OTHER_ORDER.

    Those that were cut off after its most events are among them.
    """
    if order == ALL_ORDERS:
        return exits
    fate = exits.fate
    left = (fate == mi.UInt32(Fate.REFLECTED)) | (fate == mi.UInt32(Fate.SIDEWAYS))
    left |= fate == mi.UInt32(Fate.DIRECT)
    other = left & ((exits.depth < order.least) | (exits.depth > order.most))
    other |= (fate == mi.UInt32(Fate.TRUNCATED)) & (exits.depth >= order.most)
    return replace(exits, fate=dr.select(other, mi.UInt32(Fate.OTHER_ORDER), fate))

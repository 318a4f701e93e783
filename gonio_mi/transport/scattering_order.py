"""Scattering orders: which rays are collected, by their number of surface events."""

import re
from dataclasses import replace

import drjit as dr
import mitsuba as mi

from ..errors import shown
from ..results.tally import Fate

__all__ = ["checked_order", "of_order", "orders"]

# More events than any `max_depth` admits.
UNLIMITED = 2**31


def checked_order(order):
    """Return `order` as a text: ``"all"``, ``"0"``, ``"2"`` or ``"3+"``."""
    text = str(order)
    if text != "all" and not re.fullmatch(r"0|[1-9]\d{0,8}\+?", text):
        raise ValueError(
            "order must be 'all', a number of surface events such as 2 (0 for direct "
            f"light), or '3+' for three or more, got {shown(order)}"
        )
    return text


def orders(text):
    """Least and largest number of surface events of a checked `order`."""
    if text == "all":
        return 0, UNLIMITED
    least = int(text.rstrip("+"))
    return least, UNLIMITED if text.endswith("+") else least


def of_order(exits, low, high):
    """Exits whose rays of other orders than `low` to `high` have the fate OTHER_ORDER.

    Those that were cut off after `high` events are among them.
    """
    if (low, high) == (0, UNLIMITED):
        return exits
    fate = exits.fate
    left = (fate == mi.UInt32(Fate.REFLECTED)) | (fate == mi.UInt32(Fate.SIDEWAYS))
    left |= fate == mi.UInt32(Fate.DIRECT)
    other = left & ((exits.depth < low) | (exits.depth > high))
    other |= (fate == mi.UInt32(Fate.TRUNCATED)) & (exits.depth >= high)
    return replace(exits, fate=dr.select(other, mi.UInt32(Fate.OTHER_ORDER), fate))

"""Powers in single precision as whole numbers, so that sums of them are exact.

A power is a mantissa of 24 bits times a power of two. Those that rays ordinarily carry,
from 2**-13 to 2**3, are whole multiples of 2**-36, and 2**24 of them, as many as a
launch has rays, stay below 2**63. All others are sorted by eight exponents at a time
into levels, each with a unit of its own.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Flags, Floats, Integers

__all__ = ["LEVELS", "ONE", "UNIT", "Digits", "Exact", "unit_of"]

# An ordinary power of 1, and the biased exponents of ordinary powers.
UNIT = -36
ONE = 2**-UNIT
LOWEST, N_ORDINARY = 114, 16

# Levels of all numbers but infinity and those below 2**-126.
LEVELS = 32


class Digits:
    """Mantissa and exponent of a power.

    Attributes
    ----------
    exponent : mi.UInt32
        Biased by 127; with the sign above it.
    ordinary : mi.Bool
        Whether the power is in the ordinary range.
    rare : mi.Bool
        Whether it is a positive number outside of that.
    """

    def __init__(self, power: mi.Float) -> None:
        bits = dr.reinterpret_array(mi.UInt32, power)
        self.exponent = bits >> 23
        self._mantissa = (bits & 0x7FFFFF) | 0x800000
        self.ordinary = self.exponent - LOWEST < N_ORDINARY
        self.rare = (self.exponent - 1 < 254) & ~self.ordinary

    def number(self) -> mi.Int64:
        """Whole number of 1 / ONE; 0 unless the power is ordinary."""
        shift = mi.Int64(self.exponent - LOWEST)
        return dr.select(self.ordinary, mi.Int64(self._mantissa) << shift, 0)

    def level(self) -> mi.UInt32:
        """Level of a power, below LEVELS if it is a positive number."""
        return self.exponent >> 3

    def number_in_level(self) -> mi.Int64:
        """Whole number, below 2**32, in the unit of the level."""
        return mi.Int64(self._mantissa) << mi.Int64(self.exponent & 7)


def unit_of(level: int) -> int:
    """Exponent of two of the unit of a level."""
    return 8 * level - 150


class Exact:
    """Sums of whole numbers in several units; however they are added, the same.

    Parameters
    ----------
    numbers : dict of ndarray of int64
        Arrays of one shape, by the exponents of two of their units.
    """

    def __init__(self, numbers: dict[int, Integers]) -> None:
        # halves of 32 bits leave room for 2**21 of such sums
        self._halves = {
            unit: np.stack([array >> 32, array & 0xFFFFFFFF])
            for unit, array in numbers.items()
        }

    def __add__(self, other: Exact) -> Exact:
        total = Exact({})
        total._halves = dict(self._halves)
        for unit, halves in other._halves.items():
            total._halves[unit] = total._halves.get(unit, 0) + halves
        return total

    def total(self, among: Flags) -> Exact:
        """Sum over those along the first axis that are `among` them."""
        total = Exact({})
        total._halves = {
            unit: halves[:, among].sum(axis=1) for unit, halves in self._halves.items()
        }
        return total

    def powers(self) -> Floats:
        """Powers in float64, each unit rounded once and added from the smallest on."""
        total: Any = 0.0
        for unit, (high, low) in sorted(self._halves.items(), key=lambda item: item[0]):
            total = total + (high * 2.0**32 + low) * 2.0**unit
        return total

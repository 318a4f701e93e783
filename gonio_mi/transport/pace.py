"""How many rays a launch takes, and in which pieces the rays of batches are sent."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

from .launch import launch
from .sums import Totals

__all__ = ["Pace", "segments"]

# What a launch is to take, so that Ctrl-C is heard within seconds.
SECONDS = 1.0

# Rays of a launch, at least.
FEWEST = 2**10

# How much longer a launch is than the one before, at most.
GROWTH = 128


class Pace:
    """Rays of the next launch: many for its overhead, few for Ctrl-C.

    Only for samplers whose bits do not depend on how rays are shared among launches.

    Parameters
    ----------
    rays : int
        Of the first launch, of whose speed nothing is known.
    """

    def __init__(self, rays: int) -> None:
        self.rays = rays
        self.known = False

    def launch(self, rays: int, *arguments: Any) -> Totals:
        """:func:`launch` so many `rays`, and learn from the time that the kernel takes.

        How long it takes to be compiled says nothing of the next one.
        """
        totals = launch(*arguments)
        elapsed = time.perf_counter() - totals.started
        growth = min(max(SECONDS / elapsed, 0.25), GROWTH)
        self.rays = max(int(rays * growth), FEWEST)
        self.known = True
        return totals

    def next_part(self, begin: int, end: int, most: int) -> int:
        """Rays to send next of those from `begin` to `end`, about alike in size."""
        # the generator is seeded anew for every 2**32 rays
        left = min(end, (begin // 2**32 + 1) * 2**32) - begin
        return -(-left // -(-left // min(self.rays, most)))


def segments(begin: int, end: int, most: int) -> Iterator[tuple[int, int]]:
    """Cut a range of points where aligned blocks of powers of two end.

    Each of the ranges, of `most` points at most, a power of two, fills the smallest
    block about it by more than a half.
    """
    while begin < end:
        block = min(1 << (end - begin - 1).bit_length(), most)
        if begin % block:
            block = begin & -begin
        yield begin, min(end, begin + block)
        begin += block

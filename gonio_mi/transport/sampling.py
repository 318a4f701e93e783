"""The samplers as the instrument uses them: one sequence of points over many rays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Numbers
from ..errors import SpecimenError
from ..loops import syntax
from .sobol_points import BESIDE_BITS

# Plugin names of the class names, which is all that a sampler knows.
NAMES = {
    "IndependentSampler": "independent",
    "StratifiedSampler": "stratified",
    "MultijitterSampler": "multijitter",
    "OrthogonalSampler": "orthogonal",
    "LowDiscrepancySampler": "ldsampler",
    "Sobol": "sobol",
}

# Mitsuba's samplers that distribute a fixed number of points. With their default of one
# short sequence for each ray, the numbers that a ray draws are correlated.
OF_FIXED_SIZE = ("stratified", "multijitter", "orthogonal")


def sampler_name(sampler: mi.Sampler) -> str:
    """Plugin name of Mitsuba's samplers and ours, class name of others."""
    name = sampler.class_name()
    # a sampler in Python has the class name of its base
    name = type(sampler).__name__ if name == "Sampler" else name
    return NAMES.get(name, name)


# Rays of a lane, and lanes that keep all threads busy. They take part in the seeding.
MAX_TURNS = 16
MIN_LANES = 2**16

# Lanes of rays that share words, at least: enough for all threads, and for them to
# take turns.
MIN_SHARING_LANES = 2**14

# The same of a relay, whose rays may be a thousand times as long as others; and of
# samplers whose numbers are the same in any lane, lanes of each thread, or as if a GPU
# had so many: the largest hold 2**18 lanes at once.
MAX_RELAY_TURNS = 2**10
MIN_RELAY_LANES = 2**10
MIN_LANES_PER_THREAD, GPU_THREADS = 2**7, 2**10


def is_joint(sampler: mi.Sampler) -> bool:
    """Whether all rays of a batch draw from one sequence, as the sampler declares.

    Then their numbers are the same however launches share them. Such a sampler has
    `start`, the point of the next wavefront's first ray; `points` and `go_to`, by which
    a lane draws for another ray, or one beside it; `follow`, by which rays start along
    a :class:`.Curve`; and `skip`, which leaves dimensions out.
    """
    return bool(getattr(sampler, "is_joint", False))


def check_sampler(label: str, sampler: mi.Sampler) -> None:
    """Raise ValueError for a sampler that would measure wrongly."""
    name = sampler_name(sampler)
    if name == "ldsampler":
        raise SpecimenError(
            f"{label} must not be ldsampler: it repeats one pattern for all numbers "
            "that a ray draws, so that they stay correlated, and a BSDF of several "
            "lobes is measured wrongly however many rays are sent; take sobol"
        )
    if name in OF_FIXED_SIZE and "jitter = 0" in str(sampler):
        raise SpecimenError(
            f"{label} {name} must have jitter on: without it all batches draw the same "
            "grid of numbers, whose error no error bar shows"
        )


def seeded(
    sampler: mi.Sampler, keys: Sequence[tuple[int, ...]], begin: int, n: int
) -> mi.Sampler:
    """Copy of `sampler` for batches of `n` rays that have sent `begin` rays each.

    Parameters
    ----------
    sampler : mi.Sampler
        If it :func:`is_joint`, it continues one sequence through all of each batch.
        Samplers of fixed size get one sequence for these `n` rays, others a seed.
    keys : list of tuple of int
        What tells each batch from all others; several only for a joint one.
    """
    sampler = sampler.clone()
    if is_joint(sampler):
        # the index of a point has 32 bits
        begin, sampler.start = divmod(begin, 2**32)
    elif sampler_name(sampler) in OF_FIXED_SIZE:
        _set_size(sampler, n)
    # of a list: kernels know how arrays of NumPy are aligned in memory
    seeds = mi.UInt32(_seeds([(*key, begin) for key in keys]).tolist())
    dr.make_opaque(seeds)
    sampler.seed(seeds, len(keys) * n)
    return sampler


def continues(sampler: mi.Sampler) -> bool:
    """Whether a lane may draw ray after ray: its generator has no end and no order."""
    return sampler_name(sampler) == "independent"


def turns_of(sampler: mi.Sampler, n: int) -> int:
    """Rays that a lane sends one after the other, of `n` in all."""
    return max(1, min(MAX_TURNS, n // MIN_LANES)) if continues(sampler) else 1


@syntax
def in_turns(
    add: Callable[[mi.Sampler, mi.UInt32], None],
    sampler: mi.Sampler,
    ray: mi.UInt32,
    lanes: int,
    turns: int,
) -> None:
    """Send a ray in each lane, then the next ones: a generator is costly to seed."""
    lanes, turns = dr.opaque(mi.UInt32, lanes), dr.opaque(mi.UInt32, turns)
    turn = mi.UInt32(0)
    while turn < turns:
        add(sampler, ray + turn * lanes)
        turn += 1


def points_per_lane(rays: int) -> int:
    """Points beside each other that a lane draws for, of so many: a power of two."""
    several = max(1, min(2**BESIDE_BITS, rays // MIN_SHARING_LANES))
    return 1 << several.bit_length() - 1


def in_points_beside(
    add: Callable[[mi.Sampler, mi.UInt32], None],
    sampler: mi.Sampler,
    lane: mi.UInt32,
    n: int,
) -> None:
    """Send rays of `n` points, a power of two, in each lane: they share their words.

    The sampler :func:`is_joint`. Its `start` may be any of the first `n` points, of
    which those before it have numbers that no ray has. The loop is there for any `n`,
    so that all numbers of rays have one kernel.
    """
    before = sampler.start % n
    base, before, n = (
        dr.opaque(mi.UInt32, x) for x in (sampler.start - before, before, n)
    )
    first, key = lane * n, sampler.key
    index = first + base

    def send(beside: mi.UInt32) -> tuple[mi.UInt32]:
        sampler.go_to(index, key, beside)
        add(sampler, first + beside - before)
        return (beside + 1,)

    # of a sampler that were a state of the loop, the kernel would not know the draw
    dr.while_loop((mi.UInt32(0),), lambda beside: beside < n, send)


class Relay:
    """Rays that lanes send one after the other, each when its last one has ended.

    Else all lanes of a vector would wait for the longest of their paths. Through air
    that is rarely long, and rays that start side by side are worth more.

    Parameters
    ----------
    sampler : mi.Sampler
        Seeded for all rays, or if it `continues`, for one of each lane. It becomes that
        of the lanes.
    rays : int
    arrive : callable
        ``arrive(number, exits)`` is told what has become of rays, by their numbers.
    """

    def __init__(
        self, sampler: mi.Sampler, rays: int, arrive: Callable[[mi.UInt32, Any], None]
    ) -> None:
        self.arrive = arrive
        # in a single lane Dr.Jit 1.5 takes a loop's variables for constants
        self._n = max(2, -(-rays // rays_per_lane(sampler, rays)))
        self._lane = dr.arange(mi.UInt32, self._n)
        self._points: Any = None
        if is_joint(sampler):
            self._points = sampler.points()
            dr.eval(self._points)
            sampler.go_to(*(dr.zeros(mi.UInt32, self._n) for _ in self._points))
        self._step, self._end = (dr.opaque(mi.UInt32, n) for n in (self._n, rays))

    def first(self) -> mi.UInt32:
        """Numbers of the first ray of each lane."""
        return mi.UInt32(self._lane)

    def has(self, number: mi.UInt32) -> mi.Bool:
        """Whether there are such rays."""
        return number < self._end

    def begin(self, sampler: mi.Sampler, number: mi.UInt32) -> mi.UInt32:
        """Seek the sampler to these ray indices; return the next indices."""
        if self._points is not None:
            sampler.go_to(*(dr.gather(mi.UInt32, x, number) for x in self._points))
        return number + self._step


def rays_per_lane(sampler: mi.Sampler, rays: int) -> int:
    """Rays that a lane of a relay sends one after the other, of so many in all."""
    fewest = MIN_RELAY_LANES
    if is_joint(sampler):
        on_cpu = mi.variant().startswith("llvm")
        fewest = MIN_LANES_PER_THREAD * (dr.thread_count() if on_cpu else GPU_THREADS)
    elif not continues(sampler):
        return 1
    return max(1, min(MAX_RELAY_TURNS, rays // fewest))


def split_lanes(lane: mi.UInt32, n: int) -> tuple[mi.UInt32, mi.UInt32]:
    """Quotient and remainder of lanes by `n`: group of `n` lanes, and lane in it.

    For up to 2**32 lanes.

    A division in double precision, exact because no quotient is nearer to a whole
    number than ``1 / (2 n)``, and much faster than one of integers. The reciprocal is
    Python's: that of a GPU has single precision.
    """
    per_group = dr.opaque(mi.Float64, 1 / n)
    group = mi.UInt32((mi.Float64(lane) + 0.5) * per_group)
    return group, lane - group * dr.opaque(mi.UInt32, n)


def _set_size(sampler: mi.Sampler, n: int) -> None:
    """Make the next `n` lanes one sequence, of `n` points or a few more."""
    level = mi.log_level()
    # Mitsuba warns of rounding up to a size that the sampler can distribute
    mi.set_log_level(mi.LogLevel.Error)
    try:
        sampler.set_sample_count(n)
    finally:
        mi.set_log_level(level)
    sampler.set_samples_per_wavefront(sampler.sample_count())


def _seeds(keys: Sequence[tuple[int, ...]]) -> Numbers:
    """32-bit seed of each tuple, well mixed; all have the same length.

    Each is that of NumPy's `SeedSequence`, which takes ten times as long one by one.
    """
    n_words = max(1, -(-max(map(max, keys)).bit_length() // 32))
    numbers = np.array(keys, np.uint64 if n_words <= 2 else object)
    left = np.stack([numbers >> 32 * i for i in range(n_words)], axis=-1)
    words, kept = left & 0xFFFFFFFF, left > 0
    kept[..., 0] = True  # of zero one word
    counts, seeds = kept.sum(axis=(1, 2)), np.empty(len(keys), np.uint32)
    for n in set(counts.tolist()):
        some = counts == n
        seeds[some] = _mixed(words[some][kept[some]].reshape(-1, n).T)
    return seeds


def _mixed(words: Numbers) -> Numbers:
    """Seeds from so many words each, by the function `seed_seq_fe` of O'Neill 2015."""
    factor = 0x43B0D7E5

    def hashed(x: Numbers, n: int) -> Numbers:
        """Each of `n` words, or one `n` times, with the next `n` factors."""
        nonlocal factor
        factors = [factor]
        for _ in range(n):
            factors.append(factors[-1] * 0x931E8875 % 2**32)
        factor = factors[-1]
        column = np.array(factors, np.uint32)[:, None]
        x = (x ^ column[:-1]) * column[1:]
        return x ^ (x >> 16)

    def mixed(x: Numbers, y: Numbers) -> Numbers:
        """Words of which each bit depends on both."""
        z: Numbers = x * np.uint32(0xCA01F9DD) - y * np.uint32(0x4973F715)
        return z ^ (z >> 16)

    words = words.astype(np.uint32)
    n_first = min(len(words), 4)
    pool = np.zeros((4, words.shape[1]), np.uint32)
    pool[:n_first] = words[:n_first]
    pool = hashed(pool, 4)
    for i in range(4):
        others = [j for j in range(4) if j != i]
        pool[others] = mixed(pool[others], hashed(pool[i], 3))
    for word in words[4:]:
        pool = mixed(pool, hashed(word, 4))
    seed: Numbers = (pool[0] ^ 0x8B51F9DD) * np.uint32(0x8B51F9DD * 0x58F38DED % 2**32)
    return seed ^ (seed >> 16)

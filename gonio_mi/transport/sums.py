"""Exact sums over the patches and fates of a setup, that a kernel adds to.

Powers of single precision are added up as whole numbers, so that no order of threads
changes a sum. A power is a mantissa of 24 bits times a power of two. Those that rays
ordinarily carry, from 2**-13 to 2**3, are whole multiples of 2**-36, and 2**24 of them,
as many as a launch has rays, points or branches, stay below 2**63. All others are
sorted by eight exponents at a time into levels, each with a unit of its own.
"""

from __future__ import annotations

import math
import mmap
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..array_types import Flags, Floats, Integers
from ..results.tally import (
    WEIGHT_SCALE,
    DifferentiatedTally,
    Fate,
    PolarisedTally,
    Tally,
)
from .exits import Exits
from .polarisation import n_channels, n_elements, other_elements, power_of
from .setup import Setup
from .surface_events import MAX_POWER

# An ordinary power of 1, and the biased exponents of ordinary powers.
UNIT = -36
ONE = 2**-UNIT
LOWEST, N_ORDINARY = 114, 16

# Levels of all numbers but infinity and those below 2**-126.
LEVELS = 32

# Fixed-point units of signed columns, as exponents of two, for faint, ordinary and
# bright light; and the sizes of the largest column from which the next unit holds.
# 2**24 of them stay below 2**63.
COLUMN_UNITS = (-60, -36, -9)
COLUMN_STEPS = (2.0**-21, 2.0**3)

# Numbers that each bin has for the columns of a channel, a power of two: for the 15
# elements of a matrix, and for a gain and a loss.
ELEMENT_WIDTH, CHANGE_WIDTH = 16, 2


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
        # as words, from the highest on: one of 64 bits, or two of 32
        self._words: dict[int, tuple[Integers, ...]]
        self._words = {unit: (array,) for unit, array in numbers.items()}

    def __add__(self, other: Exact) -> Exact:
        total = Exact({})
        total._words = dict(self._words)
        for unit, words in other._words.items():
            if unit in total._words:
                pairs = zip(_halves(total._words[unit]), _halves(words))
                words = tuple(a + b for a, b in pairs)
            total._words[unit] = words
        return total

    @classmethod
    def beside(cls, several: Sequence[Exact], axis: int) -> Exact:
        """Those of one set of units, one after the other along an axis."""
        joined = cls({})
        for unit in several[0]._words:
            each = zip(*(_halves(one._words[unit]) for one in several))
            joined._words[unit] = tuple(np.concatenate(word, axis) for word in each)
        return joined

    def total(self, among: Flags) -> Exact:
        """Sum over those along the first axis that are `among` them."""
        total, (some,) = Exact({}), np.nonzero(among)
        for unit, words in self._words.items():
            if len(some) == 1:
                total._words[unit] = tuple(word[some[0]] for word in words)
            else:
                halves = (word[some].sum(axis=0) for word in _halves(words))
                total._words[unit] = tuple(halves)
        return total

    def powers(self, scale: int = 1) -> Floats:
        """Powers times a power of two, in float64.

        Each unit is rounded once; they are added from the smallest on.
        """
        usual = {UNIT: self._words[UNIT]} if UNIT in self._words else self._words
        powers = _powers(usual, scale)
        rare = self._words.keys() - usual.keys()
        met = [np.flatnonzero(word != 0) for unit in rare for word in self._words[unit]]
        if any(map(len, met)):  # few of them
            some, every = np.unique(np.concatenate(met)), self._words.items()
            few = {u: tuple(x.reshape(-1)[some] for x in words) for u, words in every}
            powers.reshape(-1)[some] = _powers(few, scale)
        return powers


def _powers(units: dict[int, tuple[Integers, ...]], scale: int) -> Floats:
    """Powers, in float64, of words by the exponents of two of their units."""
    total: Any = None
    for unit, (*high, low) in sorted(units.items()):
        number = low.astype(float)
        for word in high:
            number += word * 2.0**32
        number *= 2.0**unit * scale
        if total is not None:
            number += total
        total = number
    return total


def _halves(words: tuple[Integers, ...]) -> tuple[Integers, ...]:
    """Words of 32 bits, which leave room for 2**21 of such sums."""
    if len(words) == 2:
        return words
    return words[0] >> 32, words[0] & 0xFFFFFFFF


class Sums:
    """Sums over the bins of a setup that a kernel scatters to.

    A bin holds hits, their power, and for each further channel the excess over the
    first: side by side, since Dr.Jit adds such a packet in one go, three times as fast
    as one number alone. Where that is not so, in large collectors, zeros are skipped,
    and the power is the excess over 1: counted rays cost one addition.

    A patch's bin holds the rays that arrived there. With `deposits` it holds what
    `deposit` adds, and the rays are in the bins of their fates. Direct light is in the
    bin of its fate as well, with its power.

    Signed columns have bins of their own: the other elements of Mueller matrices in
    polarised variants, or the gains and losses of light with a parameter.

    Powers beyond the ordinary are added up by themselves, in the levels that there is
    room for. What other levels there were is known once the kernel has run.

    Each of the setup's classes of orders has such sums of its own, as if its rays were
    further batches.

    Parameters
    ----------
    setup : Setup
    levels : range
        Of rare powers that there is room for.
    n_batches : int
    known : ndarray of float64, shape (n_collected, channels), optional
        Flux fractions of light that is known without rays, which take it off.
    """

    def __init__(
        self,
        setup: Setup,
        levels: range,
        n_batches: int = 1,
        known: Floats | None = None,
    ) -> None:
        self.setup = setup
        self.known = known
        # all powers are whole numbers
        self.counted = setup.method.counted
        self.capacity = n_batches
        n_batches = len(setup.classes) * n_batches
        # no constants of the kernel: another number of batches compiles nothing
        self._capacity, self._n_batches = (
            dr.opaque(mi.UInt32, n) for n in (self.capacity, n_batches)
        )
        self.deposits = setup.method.deposits
        self.channels = n_channels()
        self.width = packet_width()
        self.levels = levels
        self.bins = _room(n_batches * setup.n_bins * self.width)
        plain = dr.width(self.bins) <= dr.expand_threshold()
        plain &= mi.variant().startswith("llvm")
        self.one = 0 if plain else 1 if self.counted else ONE
        n_rare = self.channels * n_batches * setup.n_bins
        self.rare = _spare_room(len(self.levels) * n_rare)
        # whether there was such a power, for each level
        self.met = dr.zeros(mi.UInt32, LEVELS)
        n_incident = 0 if setup.beam.uniform else self.channels * n_batches
        self.incident = _room(LEVELS * n_incident)
        # rays whose derivative is no number
        self.unsound = dr.zeros(mi.UInt32, 1)
        self.columns: Any = None
        # of gains and losses none is negative
        self.n_columns = n_elements() if setup.gradients is None else CHANGE_WIDTH
        self.column_width = ELEMENT_WIDTH if n_elements() else self.n_columns
        if self.n_columns:
            n_units = len(COLUMN_UNITS) * self.channels * n_batches
            size = n_units * setup.n_collected * self.column_width
            self.columns = _spare_room(size)

    def add(
        self, bins: mi.UInt32, exits: Exits, active: mi.Bool, batch: mi.UInt32
    ) -> None:
        """Scatter one ray per lane, each for its `batch`."""
        batch = batch + self._capacity * self.setup.classes.number(exits.depth)
        direct = exits.fate == mi.UInt32(Fate.DIRECT)
        if self.deposits:
            bins = self.setup.fate_bins(bins, direct)
        self.deposit(bins, exits.throughput, active, batch, change=exits.change)
        if self.setup.specimen.periodic and not self.deposits:
            twice = active & direct & (bins < self.setup.sizes.collected)
            bins = self.setup.fate_bin(Fate.DIRECT)
            self.deposit(bins, exits.throughput, twice, batch)
        elif exits.over_the_edge is not None and not self.setup.specimen.periodic:
            left = exits.over_the_edge & (exits.fate == mi.UInt32(Fate.REFLECTED))
            left &= active & (bins != self.setup.fate_bin(Fate.SIDEWAYS))
            index = (batch + 1) * self.setup.sizes.bins - 1
            packet = [1] + [0] * (self.width - 1)
            _scatter_add(self.bins, mi.ArrayXi64(packet), index, left)
        if not self.setup.beam.uniform:
            for channel, power in enumerate(exits.incident):
                digits = Digits(power)
                place = digits.level() * self.channels + channel
                shines = active & (digits.ordinary | digits.rare)
                number = digits.number_in_level()
                index = place * self._n_batches + batch
                _scatter_add(self.incident, number, index, shines)

    def deposit(
        self,
        bins: mi.UInt32,
        light: mi.Spectrum,
        active: mi.Bool,
        batch: mi.UInt32,
        sign: int = 1,
        change: mi.Spectrum | None = None,
    ) -> None:
        """Scatter light per lane to a patch or to DIRECT, or one lane to its fate.

        By a `sign` of -1 it is taken off. `change` is its derivative by a parameter.
        """
        power = power_of(light)
        if self.columns is not None and change is not None:
            sound = dr.max(dr.abs(change)) <= MAX_POWER  # false for NaN
            wrong = active & (bins < self.setup.sizes.collected) & ~sound
            _scatter_add(self.unsound, mi.UInt32(1), mi.UInt32(0), wrong)
            parts = [dr.maximum(change, 0), dr.maximum(-change, 0)]
            self._add_columns(bins, parts, active & sound, batch)
        elif self.columns is not None and n_elements():
            columns, size = other_elements(light), dr.abs(power)
            self._add_columns(bins, columns, active, batch, size)
        collected = bins < self.setup.sizes.collected
        collected |= bins == self.setup.fate_bin(Fate.DIRECT)
        if self.counted:
            # by 32-bit integers, to which vector units convert much faster
            numbers = [mi.Int64(mi.Int32(dr.round(p))) for p in power]
        else:
            digits = [Digits(p) for p in power]
            numbers = [sign * d.number() for d in digits]
            for channel, d in enumerate(digits):
                rare = active & collected & d.rare
                self._add_rare(bins, channel, d, rare, batch, sign)
        excesses = [numbers[0] - self.one, *(n - numbers[0] for n in numbers[1:])]
        packet = [1, *(dr.select(collected, e, 0) for e in excesses)]
        packet += [0] * (self.width - len(packet))
        bins = bins + batch * self.setup.sizes.bins
        _scatter_add(self.bins, mi.ArrayXi64(packet), bins, active)

    def _add_columns(
        self,
        bins: mi.UInt32,
        columns: Sequence[mi.UnpolarizedSpectrum],
        active: mi.Bool,
        batch: mi.UInt32,
        least: mi.UnpolarizedSpectrum | None = None,
    ) -> None:
        """Scatter signed columns to patches, in a unit for sizes of at `least` that."""
        active = active & (bins < self.setup.sizes.collected)
        for channel in range(self.channels):
            several = [one[channel] for one in columns]
            sizes = [
                *map(dr.abs, several),
                *([] if least is None else [least[channel]]),
            ]
            size = reduce(dr.maximum, sizes)
            level, unit = mi.UInt32(0), mi.Float(2.0 ** -COLUMN_UNITS[0])
            for number, step in enumerate(COLUMN_STEPS, 1):
                level = dr.select(size >= step, mi.UInt32(number), level)
                unit = dr.select(size >= step, 2.0 ** -COLUMN_UNITS[number], unit)
            place = (level * self.channels + channel) * self._n_batches + batch
            place = place * self.setup.sizes.collected + bins
            packet = [mi.Int64(dr.round(one * unit)) for one in several]
            packet += [mi.Int64(0)] * (self.column_width - len(packet))
            _scatter_add(self.columns, mi.ArrayXi64(packet), place, active & (size > 0))

    def _add_rare(
        self,
        bins: mi.UInt32,
        channel: int,
        digits: Digits,
        active: mi.Bool,
        batch: mi.UInt32,
        sign: int,
    ) -> None:
        """Scatter powers to their levels, where there is room."""
        level = digits.level()
        # added up: a plain `dr.scatter` first lets all run that was scattered before
        _scatter_add(self.met, mi.UInt32(1), level, active)
        if self.levels:
            step = mi.UInt32(level - self.levels.start)
            place = (step * self.channels + channel) * self._n_batches + batch
            place = place * self.setup.sizes.bins + bins
            active = active & (step < len(self.levels))
            _scatter_add(self.rare, sign * digits.number_in_level(), place, active)

    def evaluate(self) -> None:
        """Compile the kernel and let it run."""
        sums = self.bins, self.incident, self.rare, self.met
        dr.eval(*sums, self.columns, self.unsound)
        self.started = time.perf_counter()

    @property
    def lacking(self) -> range:
        """Levels needed if there was no room for one that was met; else empty."""
        needed = {*np.flatnonzero(self.met).tolist(), *self.levels}
        if needed == {*self.levels}:
            return range(0)
        return range(min(needed), max(needed) + 1)

    def totals(self, n_batches: int) -> Totals:
        """Return the :class:`Totals` of the first `n_batches`, once the kernel ran."""
        by_class = len(self.setup.classes), self.capacity
        shape: tuple[int, ...] = (*by_class, self.setup.n_bins, self.width)
        bins = _first(self.bins, shape)[:, :n_batches, :, : 1 + self.channels]
        rays, flux = bins[..., 0], bins[..., 1:]
        # beyond 64 bits in between, but not in the end
        if self.one or self.channels > 1:
            flux = flux + (rays * self.one)[..., None]
            flux[..., 1:] += bins[..., 1:2]
        numbers = {0 if self.counted else UNIT: flux}
        shape = len(self.levels), self.channels, *shape[:3]
        rare = np.moveaxis(_first(self.rare, shape), 1, -1)
        for level, sums in zip(self.levels, rare):
            if self.met[level]:
                numbers[unit_of(level)] = sums[:, :n_batches]
        incident = None
        if not self.setup.beam.uniform:
            shape = LEVELS, self.channels, *by_class
            levels = np.moveaxis(_first(self.incident, shape), 1, -1)
            incident = Exact(
                {unit_of(i): sums[:, :n_batches] for i, sums in enumerate(levels)}
            )
        columns = None
        if self.columns is not None:
            shape = len(COLUMN_UNITS), self.channels, *by_class
            shape = *shape, self.setup.n_collected, self.column_width
            units = _first(self.columns, shape)
            # channels last
            units = units[:, :, :, :n_batches, :, : self.n_columns]
            columns = Exact(dict(zip(COLUMN_UNITS, np.moveaxis(units, 1, -1))))
        return Totals(self, rays, Exact(numbers), incident, columns)


@dataclass(frozen=True, eq=False)
class Totals:
    """What one or more launches have summed up, exactly; totals of launches add.

    Parameters
    ----------
    sums : Sums
        Of one of the launches.
    rays : ndarray of int64, shape (n_classes, n_batches, n_bins)
    flux : Exact, shape (n_classes, n_batches, n_bins, channels)
    incident : Exact, shape (n_classes, n_batches, channels), or None
        None for a beam of uniform power, which needs no sum of it: every ray that met
        the specimen carried the power 1.
    columns : Exact, shape (n_classes, n_batches, n_collected, n, channels), or None
        Signed ones: elements of Mueller matrices but the first, in polarised variants;
        or gains and losses with each parameter in turn.
    """

    sums: Sums
    rays: Integers
    flux: Exact
    incident: Exact | None
    columns: Exact | None

    @property
    def started(self) -> float:
        """When the kernel of that launch began to run, by ``time.perf_counter``."""
        return self.sums.started

    def __add__(self, other: Totals) -> Totals:
        names = ("rays", "flux", "incident", "columns")
        pairs = {name: (getattr(self, name), getattr(other, name)) for name in names}
        return replace(
            self, **{name: a + b for name, (a, b) in pairs.items() if a is not None}
        )

    def beside(self, others: Sequence[Totals]) -> Totals:
        """With the columns of `others`, of the same rays, behind its own."""
        if not others:
            return self
        each = [one.columns for one in (self, *others) if one.columns is not None]
        return replace(self, columns=Exact.beside(each, axis=-2))

    @cached_property
    def emitted(self) -> int:
        """Rays that were counted: each once, whatever became of it."""
        setup = self.sums.setup
        rays = self.rays[..., : setup.n_collected + Fate.OVER_THE_EDGE]
        fates = rays[..., setup.n_collected :]
        if self.sums.deposits:
            return int(fates.sum())
        twice = fates[..., Fate.DIRECT].sum() if setup.shape[0] == 2 else 0
        return int(rays.sum() - twice)

    def tallies(self, n: int) -> list[Tally]:
        """:class:`Tally` of each of `n` beams, whose batches take turns.

        Of several orders side by side.
        """
        setup = self.sums.setup
        if not setup.orders:
            return self._tallies(n, self.rays[0], np.array([True]))
        each = (
            self._tallies(
                n,
                setup.classes.rays(order, self.rays, setup.shape),
                setup.classes.within(order),
            )
            for order in setup.orders
        )
        return [Tally.of_orders(tallies) for tallies in zip(*each)]

    def tallies_by_class(self, n: int) -> list[Tally]:
        """Those of rays of all classes, with the light of each class side by side."""
        n_collected = self.sums.setup.n_collected
        patches = self.rays[..., :n_collected]
        fates = self.rays[..., n_collected:].sum(axis=0)
        each = (
            self._tallies(n, np.concatenate([hits, fates], axis=-1), within)
            for hits, within in zip(patches, np.eye(len(patches), dtype=bool))
        )
        return [Tally.of_orders(tallies) for tallies in zip(*each)]

    def _tallies(self, n: int, rays: Integers, within: Flags) -> list[Tally]:
        """Tallies of the rays that are kept, and of the flux of some classes."""
        sums, setup = self.sums, self.sums.setup
        kind = np.uint64 if sums.counted else float
        scale = 1 if sums.counted else WEIGHT_SCALE
        power = self.flux.total(within).powers(scale).astype(kind, copy=False)
        direct = power[:, setup.n_collected + Fate.DIRECT]
        power = power[:, : setup.n_collected].reshape(len(rays), *setup.shape, -1)
        hits = rays[:, : setup.n_collected].reshape(len(rays), *setup.shape)
        fates = rays[:, setup.n_collected :].astype(np.uint64)
        if not sums.deposits:
            fates[:, Fate.REFLECTED] = hits[:, 0].sum(axis=(1, 2))
        if setup.shape[0] == 2 and not sums.deposits:
            fates[:, Fate.TRANSMITTED] = hits[:, 1].sum(axis=(1, 2))
            fates[:, Fate.TRANSMITTED] -= fates[:, Fate.DIRECT]
        if self.incident is None:
            sent = fates[:, : Fate.OVER_THE_EDGE].sum(axis=1)
            met = sent - fates[:, Fate.MISSED] - fates[:, Fate.UNLIT]
            incident = np.repeat(met[:, None], sums.channels, axis=1)
            incident = (scale * incident).astype(kind)
        else:
            every = np.ones(len(self.rays), bool)
            incident = self.incident.total(every).powers(scale).astype(kind)
        if sums.known is not None:
            known = sums.known.reshape(*setup.shape, -1)
            power += known * incident[:, None, None, None]
        hits = hits.reshape(-1, n, *setup.shape).sum(axis=0).astype(np.uint64)
        found = [
            {
                "hits": hits[i],
                "sums": power[i::n],
                "incident": incident[i::n],
                "fates": fates[i::n],
                "scale": scale,
                "direct": direct[i::n],
            }
            for i in range(n)
        ]
        if self.columns is None:
            return [Tally(**one) for one in found]
        columns = self.columns.total(within).powers(scale)
        columns = columns.reshape(*power.shape[:-1], *columns.shape[-2:])
        each = enumerate(found)
        if setup.gradients is None:
            return [PolarisedTally(**one, elements=columns[i::n]) for i, one in each]
        return [DifferentiatedTally(**one, changes=columns[i::n]) for i, one in each]


def packet_width() -> int:
    """Numbers of a bin, a power of two: hits and all channels."""
    return 1 << n_channels().bit_length()


def n_numbers() -> int:
    """Numbers of a bin in all, those of Mueller matrices among them.

    Not those of gradients, with which batches share launches as they do without.
    """
    of_elements = len(COLUMN_UNITS) * ELEMENT_WIDTH * n_channels()
    return packet_width() + (of_elements if n_elements() else 0)


def _room(n: int) -> mi.Int64:
    """Zeros for `n` sums, or a few more.

    Dr.Jit adds to copies of small arrays, one for each thread. Their size is a constant
    of the kernel: rounded up to a power of two, few other sizes compile anything.
    """
    few = 0 < n <= dr.expand_threshold()
    return dr.zeros(mi.Int64, 1 << (n - 1).bit_length() if few else n)


def _spare_room(n: int) -> mi.Int64:
    """Zeros for `n` sums, few of which are used.

    Anonymous memory: the system only allocates the pages that are written to.
    """
    if n <= dr.expand_threshold() or not mi.variant().startswith("llvm"):
        return _room(n)
    # always private on Windows
    posix = (
        {"flags": mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS} if os.name == "posix" else {}
    )
    return mi.Int64(np.frombuffer(mmap.mmap(-1, 8 * n, **posix), np.int64))


def _first(sums: mi.Int64, shape: tuple[int, ...]) -> Integers:
    """Sums of a shape, of an array that may have room for more."""
    found: Integers = sums.numpy()[: math.prod(shape)].reshape(shape)
    return found


def _scatter_add(
    target: mi.Int64, value: mi.Int64, index: mi.UInt32, active: mi.Bool
) -> None:
    """Add to the sums, in the kernel that is being traced."""
    # the debug mode of Dr.Jit 1.5 takes the copies of other threads for out of bounds
    direct = dr.flag(dr.JitFlag.Debug)
    mode = dr.ReduceMode.Direct if direct else dr.ReduceMode.Auto
    dr.scatter_reduce(dr.ReduceOp.Add, target, value, index, active, mode)

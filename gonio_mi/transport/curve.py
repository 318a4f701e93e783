"""The order in which traced rays start: along a Morton curve over the specimen."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, reduce
from math import lcm
from operator import xor

import drjit as dr
import mitsuba as mi

from .morton import deciding_bits, leading_digits, sorting_tables
from .sampling import split_lanes
from .sobol_points import FOOTPRINT, GROUPS, MIRRORED, key, owen, owen_inverse

# Sequences that may follow a curve side by side: it has up to four points of each at a
# place, together less than 2**16, which `sorted_within` can count.
MAX_SEQUENCES = 2**14 - 1

# Lanes of the widest packets of Embree, and at least between cuts of launches.
PACKET, CHUNK = 2**4, 2**10

# Of a word of :func:`curve_tables`, the bits of the index. The others tell what flips
# the next digits.
INDEX_BITS = 29


@dataclass(frozen=True)
class Curve:
    """Points of several Sobol' sequences, ordered so that rays in a row are close by.

    What is traced from such points meets the same parts of memory. The curve sorts them
    by their first two numbers, the place on the specimen, and passes through the
    smallest aligned block of points about theirs.

    Wherever the curve is cut:

    * its stretches together have each point of each sequence once;
    * a point has the numbers that it has in any other order;
    * a point shares a packet of Embree with the same points. What Embree says of a ray
      within rounding of an edge depends on its packet.

    So the clock may decide how launches share the rays: no bit changes. A stretch also
    has lanes without a ray, which only fill packets: see :meth:`points`.

    Parameters
    ----------
    begin, end : int
        Points of each sequence, within one multiple of 2**32.
    sequences : int
        How many follow the curve.
    groups : int
        Groups of sequences, which are of the same size and take turns: sequence ``i``
        is of group ``i % groups``. Each group follows the curve as it would alone, its
        sequences side by side.
    part : (int, int), optional
        First and last step of each group, if the curve is a stretch of another one.
    """

    begin: int
    end: int
    sequences: int = 1
    groups: int = 1
    part: tuple[int, int] | None = None

    @property
    def rays(self) -> int:
        """Number of rays in all, lanes of other points of the block included."""
        first, last = self.part or (0, self._length)
        return self.groups * (last - first)

    def stretch(self, first: int, last: int) -> Curve:
        """The part of the curve between two steps of each group, of `rays / groups`."""
        return replace(self, part=(first, last))

    def cut(self, n_next: Callable[[int, int], int]) -> Iterator[Curve]:
        """Stretches one after the other, each of about ``n_next(at, rays)`` rays.

        `n_next` is called when a stretch is asked for: with the number of rays before
        it, and that of all.
        """
        at, chunk = 0, self._chunk
        while at < self._length:
            n = n_next(self.groups * at, self.rays) // self.groups
            end = min(at + -(-max(1, n) // chunk) * chunk, self._length)
            yield self.stretch(at, end)
            at = end

    def points(self, keys: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32, mi.UInt32]:
        """Points in the order of the curve, one per lane.

        Parameters
        ----------
        keys : mi.UInt32
            The scrambling of each sequence.

        Returns
        -------
        sequence, key, index : mi.UInt32
            Number of the sequence, its scrambling, and index of the point. Lanes that
            only fill packets have indices outside of `begin` to `end`.
        """
        bits, together, chunk = self._bits, self._together, self._chunk
        first, last = self.part or (0, self._length)
        start, n = self.begin % 2**32, last - first
        shift, length = dr.opaque(mi.UInt32, first), -(-n // chunk) * chunk
        own = self.end - self.begin
        # a few lanes without a ray cost less than to leave them out
        leaves_out = own < 7 << bits >> 3 or (together << bits) % chunk
        lane = dr.arange(mi.UInt32, self.groups * length)
        group, step = mi.UInt32(0), lane
        if self.groups > 1:
            # in turns, for what the others have met there is still at hand
            several = chunk if leaves_out else self._least
            turn, step = split_lanes(lane, self.groups * several)
            group, step = split_lanes(step, several)
            step += turn * dr.opaque(mi.UInt32, several)
        place, sequence = split_lanes(step + shift, together)
        sequence = sequence * self.groups + group
        size = dr.opaque(mi.UInt32, 1 << bits)
        # from the middle of the unit square on, and around
        place = (place + dr.opaque(mi.UInt32, 3 << bits >> 2)) & (size - 1)
        if self.sequences == 1:
            # at least two keys: what is gathered from a single one is another kernel
            keys = dr.concat([keys, keys])
        base = start >> bits << bits
        tables = curve_tables(base, bits, keys, self.sequences)
        index, eighth = on_curve(tables, place, sequence, base, bits)
        start, outside = (dr.opaque(mi.UInt32, x) for x in (start, own))
        index = dr.select(step < dr.opaque(mi.UInt32, n), index, start + outside)
        joined = together << bits - _leading_digits(bits)
        if joined > 1:
            index, sequence = sorted_within(joined, eighth, index, sequence)
        dr.eval(index, sequence)
        if leaves_out:
            idle = mi.UInt32(index - start >= outside)
            kept = _whole_packets(idle, lane, chunk)
            index, sequence = (dr.gather(mi.UInt32, x, kept) for x in (index, sequence))
            dr.eval(index, sequence)
        return sequence, dr.gather(mi.UInt32, keys, sequence), index

    @property
    def _bits(self) -> int:
        """Binary digits of the size of the smallest aligned block about the points."""
        return (self.begin ^ (self.end - 1)).bit_length()

    @property
    def _together(self) -> int:
        """Sequences of each group."""
        return self.sequences // self.groups

    @property
    def _length(self) -> int:
        """Steps of each group along the whole curve."""
        return self._together << self._bits

    @property
    def _chunk(self) -> int:
        """Steps between which the curve may be cut.

        Whole packets, and up to four places in a row, which :func:`leading_digits` may
        not tell apart. Each chunk is filled up to whole packets.
        """
        return -(-CHUNK // self._least) * self._least

    @property
    def _least(self) -> int:
        """Steps of whole packets that nothing moves out of."""
        return lcm(PACKET, 4 * self._together)


def curves(begin: int, end: int, sequences: int, groups: int) -> Iterator[Curve]:
    """Curves through points of sequences, cut where blocks of powers of two end.

    The points of each fill the smallest aligned block about them by more than a half.
    """
    most = 2**INDEX_BITS >> (sequences // groups - 1).bit_length()
    while begin < end:
        block = min(1 << (end - begin - 1).bit_length(), most)
        if begin % block:
            block = begin & -begin
        yield Curve(begin, min(end, begin + block), sequences, groups)
        begin += block


def _whole_packets(idle: mi.UInt32, lane: mi.UInt32, chunk: int) -> mi.UInt32:
    """Lanes with a ray, and as many idle ones of each chunk as fill its last packet."""
    missing = dr.block_sum(idle, chunk) & (PACKET - 1)  # chunks are whole packets
    filling = dr.block_prefix_sum(idle, chunk)
    filling = filling < dr.gather(mi.UInt32, missing, split_lanes(lane, chunk)[0])
    kept = dr.compress((idle == 0) | filling)
    return kept if len(kept) else dr.arange(mi.UInt32, PACKET)


@cache
def _leading_digits(bits: int) -> int:
    """:func:`leading_digits` of the first two draws."""
    return leading_digits(*FOOTPRINT, bits)


@cache
def _deciding_bits(number: int) -> int:
    """:func:`deciding_bits` of the first two draws."""
    return deciding_bits(*FOOTPRINT, number)


@cache
def _curve_table(kind: type[mi.UInt32]) -> mi.UInt32:
    """Tables of :func:`sorting_tables` for the first two draws, of a variant's type."""
    return kind(sorting_tables(*FOOTPRINT).ravel())


def curve_tables(base: int, bits: int, keys: mi.UInt32, n: int) -> mi.UInt32:
    """Contribution of each coordinate of a place to the index of a sequence's point.

    A place on the curve is a square or half of one, named by `bits` digits of the first
    two numbers. All but their scrambling, which here is undone, is linear over GF(2):
    the index is the exclusive or of one word for the digits of x, one for those of y,
    and `base`. Its three highest bits tell whether the scrambling flips the next digit
    of the coordinate, and the one after it where the next one is 0, or 1, before.

    Parameters
    ----------
    base, bits : int
        Of the aligned block of ``2**bits`` points that the curve visits.
    keys : mi.UInt32
        The scrambling of each sequence.
    n : int
        Number of sequences.

    Returns
    -------
    mi.UInt32
        By sequence, draw (0 or 1) and mirrored digits, for which each row has
        :func:`_n_digits` bits.
    """
    whole, room = dr.opaque(mi.UInt32, bits), dr.opaque(mi.UInt32, _n_digits(bits))
    entry = dr.arange(mi.UInt32, 2 * n << _n_digits(bits))
    digits = entry & ((mi.UInt32(1) << room) - 1)
    draw = (entry >> room) & 1
    word = key(dr.gather(mi.UInt32, keys, entry >> room >> 1), draw)
    coordinates = [dr.opaque(mi.UInt32, _coordinate(base, d)) for d in (0, 1)]
    plain = owen_inverse(digits, word)
    offset = dr.select(draw == 0, *coordinates)
    wanted = (_spread(plain ^ offset) << draw) & ((mi.UInt32(1) << whole) - 1)
    place = _mirrored(wanted, whole)
    index = mi.UInt32(0)
    for byte in range(4):
        at = (4 * whole + byte) * 256 + ((place >> 8 * byte) & 255)
        index = index ^ dr.gather(mi.UInt32, _curve_table(mi.UInt32), at)
    known = dr.opaque(mi.UInt32, _leading_digits(bits)) + 1 - draw >> 1
    one = mi.UInt32(1) << known
    plain = plain & (one - 1)
    # a digit is flipped or not by those before it in its own coordinate
    after_0, after_1 = (owen(x, word) >> known for x in (plain, plain | one))
    return index | (after_0 & 3) << INDEX_BITS | (after_1 >> 1) << (INDEX_BITS + 2)


def _n_digits(bits: int) -> int:
    """Digits of each coordinate of a place that has `bits` digits, rounded up."""
    return (bits + 1) // 2


def on_curve(
    tables: mi.UInt32, place: mi.UInt32, sequence: mi.UInt32, base: int, bits: int
) -> tuple[mi.UInt32, mi.UInt32]:
    """Permutation of ``2**bits`` points from `base` on, that follows a Morton curve.

    It sorts by the first two scrambled numbers, so that points of any sequences at one
    place are neighbours.

    Parameters
    ----------
    tables : mi.UInt32
        Those of :func:`curve_tables`.
    place, sequence : mi.UInt32
        The former below ``2**bits``.
    base, bits : int
        The former a multiple of ``2**bits``, and that at most ``2**INDEX_BITS``.

    Returns
    -------
    index, eighth : mi.UInt32
        Index of the point, and the eighth of the place that it is in, numbered along
        one half of the place and back along the other. Unlike on a Morton curve,
        consecutive eighths touch, so that any points in a row are close by.
    """
    whole, room = dr.opaque(mi.UInt32, bits), dr.opaque(mi.UInt32, _n_digits(bits))
    digits = _mirrored(place, whole)
    row = sequence << (room + 1)
    x = dr.gather(mi.UInt32, tables, row + _every_other(digits))
    row += mi.UInt32(1) << room
    y = dr.gather(mi.UInt32, tables, row + _every_other(digits >> 1))
    index = (x ^ y) & ((mi.UInt32(1) << whole) - 1)
    index = index ^ dr.opaque(mi.UInt32, base)
    leading = _leading_digits(bits)
    # a place is longer along y if x has one more digit
    taller = dr.opaque(mi.Bool, leading % 2 == 1)
    flips = x >> INDEX_BITS, y >> INDEX_BITS
    across, along = dr.select(taller, *flips), dr.select(taller, *flips[::-1])
    first, half, second = (_digit(index, leading + i) for i in range(3))
    second ^= dr.select(first == 1, along >> 2, along >> 1)
    quarter = 2 * (first ^ (along & 1)) + (second & 1)
    half = (half ^ across) & 1
    return index, (half << 2) + (quarter ^ 3 * half)


def _digit(index: mi.UInt32, number: int) -> mi.UInt32:
    """Unscrambled digit of the place of points, by the digit's number."""
    mask = dr.opaque(mi.UInt32, _deciding_bits(number))
    return dr.popcnt(index & mask) & 1


def sorted_within(n: int, eighth: mi.UInt32, *arrays: mi.UInt32) -> list[mi.UInt32]:
    """Arrays, sorted by `eighth` (0 to 7) within each `n` lanes; stable.

    From 256 lanes on by half of `eighth`: one integer counts how often each value
    occurs, which is less than 2**16 times.
    """
    digit, width = (eighth, 8) if n < 2**8 else (eighth >> 1, 16)
    below = sum(1 << place for place in range(width, 64, width))
    one = mi.UInt64(1) << mi.UInt64(digit * width)
    dr.eval(one, digit, *arrays)
    group, _ = split_lanes(dr.arange(mi.UInt32, dr.width(one)), n)
    smaller = dr.gather(mi.UInt64, dr.block_sum(one, n) * below, group)
    rank = (smaller + dr.block_prefix_sum(one, n)) >> mi.UInt64(digit * width)
    target = group * dr.opaque(mi.UInt32, n) + (mi.UInt32(rank) & (2**width - 1))
    found = [dr.empty(mi.UInt32, dr.width(one)) for _ in arrays]
    for array, where in zip(arrays, found):
        dr.scatter(where, array, target, mode=dr.ReduceMode.Permute)
    return found


def _coordinate(index: int, draw: int) -> int:
    """Mirrored coordinate of one point, for a `draw` of the first block."""
    chosen = (v for bit, v in enumerate(MIRRORED[draw]) if index >> bit & 1)
    return reduce(xor, chosen, 0)


def _mirrored(x: mi.UInt32, bits: mi.UInt32) -> mi.UInt32:
    """The lowest `bits` bits in reverse order, at most 31; all others must be 0."""
    return dr.brev(x) >> (31 - bits) >> 1


def _every_other(x: mi.UInt32) -> mi.UInt32:
    """Every second bit, from the lowest, as 16 bits."""
    masks = [mask for _, mask in GROUPS]
    x = x & masks[-1]
    for (shift, _), mask in zip(GROUPS[:0:-1], masks[-2::-1]):
        x = (x | (x >> shift)) & mask
    return x


def _spread(x: mi.UInt32) -> mi.UInt32:
    """The lowest 16 bits, as every second one from the lowest."""
    x = x & GROUPS[0][1]
    for shift, mask in GROUPS[1:]:
        x = (x | (x << shift)) & mask
    return x

"""Sampler `sobol`: Owen-scrambled Sobol' points, distributed in all dimensions."""

from __future__ import annotations

from functools import cache, reduce
from operator import xor
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gonio_mi.errors import VariantError
from gonio_mi.transport.morton import (
    PACKET,
    block_bits,
    chunk_lanes,
    deciding_bits,
    leading_digits,
    sorting_tables,
)
from gonio_mi.transport.sampling import apart

# Primitive polynomial (its coefficients as bits) and initial direction numbers of each
# Sobol' dimension after the first: Joe and Kuo 2008, table new-joe-kuo-6.21201.
POLYNOMIALS = (
    (0b11, (1,)),
    (0b111, (1, 3)),
    (0b1011, (1, 3, 1)),
    (0b1101, (1, 1, 1)),
    (0b10011, (1, 1, 3, 3)),
    (0b11001, (1, 3, 5, 13)),
    (0b100101, (1, 1, 5, 5, 17)),
    (0b101001, (1, 1, 5, 5, 5)),
    (0b101111, (1, 1, 7, 11, 19)),
    (0b110111, (1, 1, 5, 1, 1)),
    (0b111011, (1, 1, 1, 3, 11)),
    (0b111101, (1, 3, 5, 5, 31)),
    (0b1000011, (1, 3, 3, 9, 7, 49)),
    (0b1011011, (1, 1, 1, 15, 21, 21)),
    (0b1100001, (1, 3, 1, 13, 27, 49)),
)

# Shifts, and every other group of as many bits.
GROUPS = (
    (16, 0x0000FFFF),
    (8, 0x00FF00FF),
    (4, 0x0F0F0F0F),
    (2, 0x33333333),
    (1, 0x55555555),
)

# Factors of the scrambling.
FACTORS = (0x3D20ADEA, 0x05526C56, 0x53A22864)

# Sobol' dimension of each draw of a block. The first two are the best distributed and
# the cheapest; they go to the direction of scattering in the usual order of draws:
# footprint (2), lobe (1), direction (2). Sixteen cover the beam and the first event.
ORDER = (3, 4, 2, 0, 1, *range(5, 16))


def direction_numbers(dimension: int) -> list[int]:
    """Direction numbers of a Sobol' dimension from 0 (Joe and Kuo 2008, eqs. 2 and 3).

    Returns
    -------
    list of int
        What each of the 32 bits of a point's index, from the lowest, adds by exclusive
        or to the coordinate, a fraction of 2**32.
    """
    if dimension == 0:
        return [1 << (31 - k) for k in range(32)]
    polynomial, initial = POLYNOMIALS[dimension - 1]
    degree = len(initial)
    v = [m << (31 - k) for k, m in enumerate(initial)]
    for k in range(degree, 32):
        number = v[k - degree] ^ (v[k - degree] >> degree)
        for j in range(1, degree):
            if polynomial >> (degree - j) & 1:
                number ^= v[k - j]
        v.append(number)
    return v


# All that follows is mirrored, for that is what the scrambling works on: bit 0 is the
# first binary digit of a coordinate.
MIRRORED = [[dr.brev(v) for v in direction_numbers(d)] for d in ORDER]
BLOCK = len(ORDER)

# Direction numbers of the first two draws, which a curve follows.
FOOTPRINT = direction_numbers(ORDER[0]), direction_numbers(ORDER[1])


@cache
def _byte_table() -> mi.UInt32:
    """Contribution of each byte of an index to each draw of a block, flattened."""
    table = np.zeros((BLOCK, 4, 256), np.uint32)
    for bit in range(32):
        set_in = np.arange(256) >> (bit % 8) & 1
        numbers = np.array([row[bit] for row in MIRRORED], np.uint32)
        table[:, bit // 8] ^= numbers[:, None] * set_in.astype(np.uint32)
    return mi.UInt32(table.ravel())


@cache
def _curve_table() -> mi.UInt32:
    """Tables of :func:`sorting_tables` for the first two draws of a block."""
    return mi.UInt32(sorting_tables(*FOOTPRINT).ravel())


# Of a word of :func:`curve_tables`, the bits that are no index: what flips the next
# digits.
NEXT_DIGITS = 29


def curve_tables(base: int, bits: int, keys: mi.UInt32, n: int) -> mi.UInt32:
    """What either coordinate of a place adds to the index of a sequence's point there.

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
        What sequences are scrambled with.
    n : int
        How many of them there are.

    Returns
    -------
    mi.UInt32
        By sequence, draw (0 or 1) and mirrored digits, of which there is room for
        :func:`_room` of them.
    """
    whole, room = dr.opaque(mi.UInt32, bits), dr.opaque(mi.UInt32, _room(bits))
    entry = dr.arange(mi.UInt32, 2 * n << _room(bits))
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
        index = index ^ dr.gather(mi.UInt32, _curve_table(), at)
    known = dr.opaque(mi.UInt32, leading_digits(*FOOTPRINT, bits)) + 1 - draw >> 1
    one = mi.UInt32(1) << known
    plain = plain & (one - 1)
    # a digit is flipped or not by those before it in its own coordinate
    after_0, after_1 = (owen(x, word) >> known for x in (plain, plain | one))
    return index | (after_0 & 3) << NEXT_DIGITS | (after_1 >> 1) << (NEXT_DIGITS + 2)


def _room(bits: int) -> int:
    """Digits of a coordinate among those of a place, rounded up."""
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
        The former a multiple of ``2**bits``, and that at most ``2**NEXT_DIGITS``.

    Returns
    -------
    index, eighth : mi.UInt32
        Of points, and in which part of their place they are, by its number along one
        half of the place and back along the other: unlike on a Morton curve, parts that
        follow each other touch, so that any points in a row are close.
    """
    whole, room = dr.opaque(mi.UInt32, bits), dr.opaque(mi.UInt32, _room(bits))
    digits = _mirrored(place, whole)
    row = sequence << (room + 1)
    x = dr.gather(mi.UInt32, tables, row + _every_other(digits))
    row += mi.UInt32(1) << room
    y = dr.gather(mi.UInt32, tables, row + _every_other(digits >> 1))
    index = (x ^ y) & ((mi.UInt32(1) << whole) - 1)
    index = index ^ dr.opaque(mi.UInt32, base)
    leading = leading_digits(*FOOTPRINT, bits)
    # a place is longer along y if x has one more digit
    taller = dr.opaque(mi.Bool, leading % 2 == 1)
    flips = x >> NEXT_DIGITS, y >> NEXT_DIGITS
    across, along = dr.select(taller, *flips), dr.select(taller, *flips[::-1])
    first, half, second = (_digit(index, leading + i) for i in range(3))
    second ^= dr.select(first == 1, along >> 2, along >> 1)
    quarter = 2 * (first ^ (along & 1)) + (second & 1)
    half = (half ^ across) & 1
    return index, (half << 2) + (quarter ^ 3 * half)


def _digit(index: mi.UInt32, number: int) -> mi.UInt32:
    """A digit of the place, before it is scrambled, of points of the sequence."""
    mask = dr.opaque(mi.UInt32, deciding_bits(*FOOTPRINT, number))
    return dr.popcnt(index & mask) & 1


def sorted_within(n: int, eighth: mi.UInt32, *arrays: mi.UInt32) -> list[mi.UInt32]:
    """Arrays, each `n` lanes of which are sorted by a number from 0 to 7; stable.

    Or for 256 lanes and more by half of it: how often each occurs, less than 2**16
    times, is counted in one number.
    """
    digit, width = (eighth, 8) if n < 2**8 else (eighth >> 1, 16)
    below = sum(1 << place for place in range(width, 64, width))
    one = mi.UInt64(1) << mi.UInt64(digit * width)
    dr.eval(one, digit, *arrays)
    group, _ = apart(dr.arange(mi.UInt32, dr.width(one)), n)
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


def sobol_known(index: mi.UInt32, draw: Any) -> mi.UInt32:
    """Mirrored coordinate of a point, for the `draw` of a block known when tracing."""
    if ORDER[draw] == 0:
        return index
    if ORDER[draw] == 1:
        # binomial coefficients modulo 2, as a product of five matrices (Ahmed 2024)
        for shift, mask in GROUPS:
            index = index ^ ((index >> shift) & mask)
        return index
    coordinate = mi.UInt32(0)
    for bit, number in enumerate(MIRRORED[draw]):
        chosen = dr.select(index & (1 << bit) != 0, mi.UInt32(number), 0)
        coordinate = coordinate ^ chosen
    return coordinate


def sobol_any(index: mi.UInt32, draw: Any) -> mi.UInt32:
    """Mirrored coordinate of a point, for any `draw` of a block."""
    return _product(_byte_table(), draw, index)


def _product(tables: mi.UInt32, row: Any, x: mi.UInt32) -> mi.UInt32:
    """Exclusive or of what each byte of `x` has in a row of tables."""
    entries = ((4 * row + byte) * 256 + ((x >> 8 * byte) & 255) for byte in range(4))
    return reduce(xor, (dr.gather(mi.UInt32, tables, entry) for entry in entries))


def owen(x: mi.UInt32, key: mi.UInt32) -> mi.UInt32:
    """Nested uniform (Owen) scrambling of mirrored coordinates.

    Each binary digit is flipped or not depending on those before it: here, on lower
    bits. Sums and products with odd numbers do just that (Laine and Karras 2011); the
    factors are those of Vegdahl 2021, as in PBRT.
    """
    x = x ^ (x * FACTORS[0])
    x = x + key
    x = x * (key >> 16 | 1)
    x = x ^ (x * FACTORS[1])
    return x ^ (x * FACTORS[2])


def owen_inverse(x: mi.UInt32, key: mi.UInt32) -> mi.UInt32:
    """What :func:`owen` scrambles to `x`, in the lowest 16 bits."""
    x = _before(_before(x, FACTORS[2]), FACTORS[1])
    factor = key >> 16 | 1
    # each step of Newton's method doubles the bits of the inverse, from five
    inverse = factor * 3 ^ 2
    for _ in range(2):
        inverse = inverse * (2 - factor * inverse)
    return _before(x * inverse - key, FACTORS[0])


def _before(y: mi.UInt32, factor: int) -> mi.UInt32:
    """Solution `x` of ``x ^ (x * factor) == y``, in the lowest 16 bits.

    The product shifts by as many bits as the even `factor` has zeros at its end: that
    many are right at first, and each step makes as many more so.
    """
    zeros = (factor & -factor).bit_length() - 1
    x = y
    for _ in range(-(-16 // zeros) - 1):
        x = y ^ (x * factor)
    return x


def key(seed: Any, number: Any) -> mi.UInt32:
    """Word to scramble with, unrelated for other seeds and other numbers."""
    return _hash(seed + number * 0x9E3779B9)


def _hash(x: mi.UInt32) -> mi.UInt32:
    """Triple32 of Wellons 2018, a bijection of 32 bits without measurable bias."""
    x = x ^ (x >> 17)
    x = x * 0xED5AD4BB
    x = x ^ (x >> 11)
    x = x * 0xAC4C1B51
    x = x ^ (x >> 15)
    x = x * 0x31848BAB
    return x ^ (x >> 14)


def sobol_number(index: mi.UInt32, seed: Any, draw: Any) -> mi.UInt32:
    """Scrambled coordinate of points, as 32 bits: number `draw` of each.

    Draws of the first block are coordinates of one point. Each further block takes the
    points in an order of its own: nested uniform shuffling (Burley 2020), that is Owen
    scrambling of the mirrored index.
    """
    if draw.state == dr.VarState.Literal and draw[0] < BLOCK:
        coordinate = sobol_known(index, draw[0])
    else:
        block = draw // BLOCK
        shuffled = dr.brev(owen(dr.brev(index), key(~seed, block)))
        index = dr.select(block == 0, index, shuffled)
        coordinate = sobol_any(index, draw - block * BLOCK)
    return dr.brev(owen(coordinate, key(seed, draw)))


def fraction(bits: mi.UInt32) -> mi.Float:
    """Number in [0, 1) from the leading 24 of 32 bits, as many as fit below 1."""
    return mi.Float(bits >> 8) * 2.0**-24


class Sobol(mi.Sampler):
    r"""Owen-scrambled Sobol' points (:monosp:`sobol`).

    Ray ``i`` of a wavefront draws its numbers from point ``start + i`` of one scrambled
    Sobol' sequence. The first sixteen, more than the beam and the first event need, are
    coordinates of the same 16-dimensional point, so that they are well distributed
    *jointly*. The next sixteen come from the same sequence in a shuffled order, and so
    on without an end: independent between blocks of sixteen, well distributed within.

    Every seed is an independent scrambling of the sequence. Each number is uniform on
    the multiples of 2**-24 in [0, 1), for any number of rays; a power of two of them
    has the least error. The sequence has 2**32 points and then begins again.

    .. pluginparameters::

     * - sample_count
       - |int|
       - Number of samples per pixel, for Mitsuba's own integrators. (Default: 4)

     * - seed
       - |int|
       - Added to the seed of each rendering or batch. (Default: 0)

    .. tabs::
        .. code-tab:: xml

            <sampler type="sobol"/>

        .. code-tab:: python

            'type': 'sobol'
    """

    is_joint = True

    def __init__(self, props: mi.Properties) -> None:
        if not dr.is_jit_v(mi.Float):
            raise VariantError(
                f"the sampler sobol needs an llvm or cuda variant, got {mi.variant()}"
            )
        super().__init__(props)
        self.base_seed = props.get("seed", 0)
        # Index in the sequence of the first point of the next wavefront to be seeded
        self.start = 0
        # Points of each sequence in the wavefront
        self.per_sequence = 0
        self.index = mi.UInt32(0)
        self.key = mi.UInt32(0)
        self.draw = mi.UInt32(0)
        # Number of sequences, and what each of them is scrambled with
        self.sequences, self.keys = 1, mi.UInt32(0)
        _byte_table()

    def seed(self, seed: Any, wavefront_size: int = 0xFFFFFFFF) -> None:
        """Choose the scrambling and go to the point `start`; nothing recompiles.

        Several seeds share the wavefront evenly: that many sequences, one after the
        other.
        """
        super().seed(seed, wavefront_size)
        self.keys = self.key = mi.UInt32(seed) + self.base_seed
        dr.make_opaque(self.keys)
        lane = dr.arange(mi.UInt32, self.wavefront_size())
        self.sequences = dr.width(self.keys)
        self.per_sequence = self.wavefront_size() // self.sequences
        if self.sequences > 1:
            sequence, lane = apart(lane, self.per_sequence)
            self.key = dr.gather(mi.UInt32, self.key, sequence)
        self.index = lane + dr.opaque(mi.UInt32, self.start)
        self.draw = mi.UInt32(0)

    def follow_curve(
        self, first: int = 0, last: int | None = None, walks: int = 1
    ) -> tuple[mi.UInt32, mi.UInt32]:
        """Reorder the points along a Morton curve, for coherent rays.

        All sequences walk along one curve together, side by side, through the smallest
        aligned block of points about theirs. They are the same points: only their order
        changes, and what is traced from them meets the same parts of memory.

        What Embree says of a ray within rounding of an edge depends on the rays that
        share its packet. Each chunk of :func:`chunk_lanes` therefore fills whole
        packets, with points of nobody: wherever stretches are cut between such chunks,
        packets hold the same points.

        Parameters
        ----------
        first, last : int
            The stretch of the curve to walk along, counted from the middle of the unit
            square on and around. Points before `start` or after the last one are
            nobody's.
        walks : int
            Groups of sequences, which take turns and are of the same size: each goes
            that way by itself, one after the other, as it would alone.

        Returns
        -------
        sequence, number : mi.UInt32
            Of each lane, and number of its point in that sequence, from 0; at least as
            many as it has for points of nobody.
        """
        bits = block_bits(self.start, self.per_sequence)
        together = self.sequences // walks
        last = together << bits if last is None else last
        n, chunk = last - first, chunk_lanes(together)
        shift, length = dr.opaque(mi.UInt32, first), -(-n // chunk) * chunk
        lane = dr.arange(mi.UInt32, walks * length)
        walk, step = apart(lane, length) if walks > 1 else (mi.UInt32(0), lane)
        place, sequence = apart(step + shift, together)
        sequence = sequence * walks + walk
        size = dr.opaque(mi.UInt32, 1 << bits)
        place = (place + dr.opaque(mi.UInt32, 3 << bits >> 2)) & (size - 1)
        # at least two keys: what is gathered from a single one is another kernel
        keys = dr.concat([self.keys, self.keys])
        base = self.start >> bits << bits
        tables = curve_tables(base, bits, keys, self.sequences)
        index, eighth = on_curve(tables, place, sequence, base, bits)
        start, own = (dr.opaque(mi.UInt32, x) for x in (self.start, self.per_sequence))
        index = dr.select(step < dr.opaque(mi.UInt32, n), index, start + own)
        joined = together << bits - leading_digits(*FOOTPRINT, bits)
        if joined > 1:
            index, sequence = sorted_within(joined, eighth, index, sequence)
        dr.eval(index, sequence)
        # few of nobody cost less than to leave them out
        if self.per_sequence < 7 << bits >> 3 or (together << bits) % chunk:
            nobody = mi.UInt32(index - start >= own)
            # of each chunk; the number of points is what is missing to whole packets
            missing = (dr.block_sum(nobody, chunk) - chunk) & (PACKET - 1)
            filling = dr.block_prefix_sum(nobody, chunk)
            filling = filling < dr.gather(mi.UInt32, missing, apart(lane, chunk)[0])
            kept = dr.compress((nobody == 0) | filling)
            kept = kept if len(kept) else dr.arange(mi.UInt32, PACKET)
            index, sequence = (dr.gather(mi.UInt32, x, kept) for x in (index, sequence))
            dr.eval(index, sequence)
        self.index = index
        self.key = dr.gather(mi.UInt32, keys, sequence)
        return sequence, index - start

    def points(self) -> tuple[mi.UInt32, mi.UInt32]:
        """Index and key of the point of each lane, for :meth:`go_to`."""
        every = dr.zeros(mi.UInt32, dr.width(self.index))
        return self.index + every, self.key + every

    def go_to(self, index: mi.UInt32, key: mi.UInt32) -> None:
        """Draw the numbers of other points, from their first."""
        self.index, self.key, self.draw = index, key, mi.UInt32(0)

    def advance(self) -> None:
        """Go on by one wavefront."""
        self.index = self.index + self.wavefront_size()
        self.draw = mi.UInt32(0)

    def next_1d(self, active: mi.Bool | bool = True) -> mi.Float:
        """Next number of each point."""
        del active
        bits = sobol_number(self.index, self.key, self.draw)
        self.draw = self.draw + 1
        return fraction(bits)

    def next_2d(self, active: mi.Bool | bool = True) -> mi.Point2f:
        """Next two numbers of each point."""
        x = self.next_1d(active)
        return mi.Point2f(x, self.next_1d(active))

    def skip(self, n: Any) -> None:
        """Leave out the next `n` numbers of each point."""
        self.draw = self.draw + n

    def fork(self) -> Sobol:
        """Return a sampler of the same settings, to be seeded."""
        copy = type(self)(mi.Properties("sobol"))
        copy.set_sample_count(self.sample_count())
        copy.base_seed, copy.start = self.base_seed, self.start
        return copy

    def clone(self) -> Sobol:
        """Return a sampler that draws the same numbers."""
        copy = self.fork()
        if self.wavefront_size():
            mi.Sampler.seed(copy, 0, self.wavefront_size())
        copy.__dict__.update(vars(self))
        return copy

    def schedule_state(self) -> None:
        """Schedule the state for evaluation."""
        dr.schedule(self.index, self.key, self.draw)

    def to_string(self) -> str:
        """Return a readable description."""
        return f"Sobol[sample_count={self.sample_count()}]"


mi.register_sampler("sobol", Sobol)

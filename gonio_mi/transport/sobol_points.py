"""Points of the sampler `sobol`: coordinates of Sobol' points and their scrambling."""

from __future__ import annotations

from functools import cache, reduce
from operator import xor
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

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


# Lowest bits of an index by which points beside each other differ.
BESIDE_BITS = 4

# All that follows is mirrored, for that is what the scrambling works on: bit 0 is the
# first binary digit of a coordinate.
MIRRORED = [[dr.brev(v) for v in direction_numbers(d)] for d in ORDER]
BLOCK = len(ORDER)

# Direction numbers of the first two draws, which a curve follows.
FOOTPRINT = direction_numbers(ORDER[0]), direction_numbers(ORDER[1])


@cache
def byte_table(kind: type[mi.UInt32]) -> mi.UInt32:
    """Contribution of each byte of an index to each draw of a block, flattened.

    Of a variant's type, and made before a kernel that needs it is recorded.
    """
    table = np.zeros((BLOCK, 4, 256), np.uint32)
    for bit in range(32):
        set_in = np.arange(256) >> (bit % 8) & 1
        numbers = np.array([row[bit] for row in MIRRORED], np.uint32)
        table[:, bit // 8] ^= numbers[:, None] * set_in.astype(np.uint32)
    return kind(table.ravel())


def sobol_known(index: mi.UInt32, draw: Any, bits: int = 32) -> mi.UInt32:
    """Mirrored coordinate of a point, for the `draw` of a block known when tracing.

    Of an index of so many `bits`.
    """
    if ORDER[draw] == 0:
        return index
    if ORDER[draw] == 1:
        # binomial coefficients modulo 2, as a product of five matrices (Ahmed 2024)
        for shift, mask in GROUPS:
            if shift < bits:
                index = index ^ ((index >> shift) & mask)
        return index
    coordinate = mi.UInt32(0)
    for bit, number in enumerate(MIRRORED[draw][:bits]):
        chosen = dr.select(index & (1 << bit) != 0, mi.UInt32(number), 0)
        coordinate = coordinate ^ chosen
    return coordinate


def sobol_any(index: mi.UInt32, draw: Any) -> mi.UInt32:
    """Mirrored coordinate of a point, for any `draw` of a block."""
    return _product(byte_table(mi.UInt32), draw, index)


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


def sobol_number(
    index: mi.UInt32, seed: Any, draw: Any, beside: mi.UInt32 | None = None
) -> mi.UInt32:
    """Scrambled coordinate of points, as 32 bits: number `draw` of each.

    Draws of the first block are coordinates of one point. Each further block takes the
    points in an order of its own: nested uniform shuffling (Burley 2020), that is Owen
    scrambling of the mirrored index.

    The index is ``index ^ beside`` where `beside`, of :data:`BESIDE_BITS` bits, is
    given. Coordinates are linear over GF(2), so that a loop over points beside one
    `index` computes the coordinate of that once, and so its key.
    """
    if draw.state == dr.VarState.Literal and draw[0] < BLOCK:
        coordinate = sobol_known(index, draw[0])
        if beside is not None:
            coordinate = coordinate ^ sobol_known(beside, draw[0], BESIDE_BITS)
    else:
        index = index if beside is None else index ^ beside
        block = draw // BLOCK
        shuffled = dr.brev(owen(dr.brev(index), key(~seed, block)))
        index = dr.select(block == 0, index, shuffled)
        coordinate = sobol_any(index, draw - block * BLOCK)
    return dr.brev(owen(coordinate, key(seed, draw)))


def fraction(bits: mi.UInt32) -> mi.Float:
    """Number in [0, 1) from the leading 24 of 32 bits, as many as fit below 1."""
    return mi.Float(bits >> 8) * 2.0**-24

"""Sobol' points in the order of a Morton curve, whatever is their scrambling.

The digits that a Morton curve sorts by, the first of x, the first of y, the second of x
and so on, are a matrix over GF(2) times the bits of the index; its inverse enumerates
the points along the curve. Nested (Owen) scrambling moves whole elementary intervals
and so keeps neighbours together.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray


def sorting_tables(
    x_columns: Sequence[int], y_columns: Sequence[int]
) -> NDArray[np.uint32]:
    """Tables that turn a place along the curve into the index of a point.

    Parameters
    ----------
    x_columns, y_columns : sequence of 32 int
        What each bit of the index, from the lowest, adds by exclusive or to either
        coordinate, a fraction of 2**32.

    Returns
    -------
    ndarray of uint32, shape (33, 4, 256)
        Among the first ``2**h`` points, number ``i`` along the curve has the index that
        is the exclusive or of ``table[h, b, byte b of i]`` over all four bytes.
    """
    digits = [deciding_bits(x_columns, y_columns, number) for number in range(64)]
    tables = np.zeros((33, 4, 256), np.uint32)
    byte = np.arange(256)
    for h in range(1, 33):
        columns = _inverse_columns(digits, h)
        for bit, column in enumerate(columns):
            chosen = (byte >> bit % 8 & 1).astype(np.uint32)
            tables[h, bit // 8] ^= chosen * np.uint32(column)
    return tables


def leading_digits(x_columns: Sequence[int], y_columns: Sequence[int], h: int) -> int:
    """How many digits, from the first, are different in all of the first 2**h points.

    All `h` of them, or one or two less: then any other digits tell points apart.
    """
    low = (1 << h) - 1
    independent: list[int] = []
    for place in range(h):
        digit = deciding_bits(x_columns, y_columns, place) & low
        for other in independent:
            digit = min(digit, digit ^ other)
        if not digit:
            return place
        independent.append(digit)
    return h


def deciding_bits(
    x_columns: Sequence[int], y_columns: Sequence[int], number: int
) -> int:
    """Which bits of the index decide about a digit, of a `number` from 0, as a mask."""
    columns, bit = (x_columns, y_columns)[number % 2], 31 - number // 2
    return sum((column >> bit & 1) << k for k, column in enumerate(columns))


def _inverse_columns(digits: Sequence[int], h: int) -> list[int]:
    """Index bits that each bit, from the lowest, of a place among 2**h stands for.

    Digits that depend on those before them sort nothing, and are left out.
    """
    low = (1 << h) - 1
    # rows of [digit | number of the digit], in reduced echelon form
    rows: list[tuple[int, int, int]] = []
    chosen = 0
    for digit in digits:
        row = [digit & low, 1 << chosen]
        for mask, pivot, combination in rows:
            if row[0] >> pivot & 1:
                row = [row[0] ^ mask, row[1] ^ combination]
        if not row[0]:
            continue
        pivot = row[0].bit_length() - 1
        rows = [
            (mask ^ row[0], p, c ^ row[1]) if mask >> pivot & 1 else (mask, p, c)
            for mask, p, c in rows
        ]
        rows.append((row[0], pivot, row[1]))
        chosen += 1
        if chosen == h:
            break
    # bit `pivot` of the index is the sum of the chosen digits in `combination`, of
    # which number j is bit h - 1 - j of the place
    columns = [0] * h
    for _, pivot, combination in rows:
        for j in range(h):
            if combination >> j & 1:
                columns[h - 1 - j] |= 1 << pivot
    return columns

"""Judgements of scripts: two numbers that should be equal, and how far apart they are.

In standard errors; where chance takes no part in roundings, which of counts must be
none. The source of one stands at the end of a script.
"""

from typing import Any

import numpy as np

from ..single_precision import BSDF_ROUNDING as ROUNDING


def same(a: Any, b: Any) -> None:
    """Two counts."""
    print(f"{a} and {b}, which must be equal: {a == b}")


def improper(values: Any) -> None:
    """Values, of which none may be negative or not finite."""
    wrong = values[~(values >= 0) | ~np.isfinite(values)]
    print(f"{wrong[:3]}: {wrong.size} and 0, which must be equal: {wrong.size == 0}")


def equal(a: Any, b: Any) -> None:
    """Two numbers."""
    off = abs(a - b) / max(abs(a), abs(b), 1e-30)
    print(f"{a:.6g} and {b:.6g}: {off / ROUNDING:.3g} roundings")


def apart(a: Any, b: Any, error: Any) -> None:
    """Two means."""
    print(f"{a:.6g} and {b:.6g}: {abs(a - b) / (error + 1e-7):.3g} standard errors")


def most_apart(a: Any, b: Any, error: Any) -> None:
    """Of several means those that are most apart."""
    k = np.argmax(np.abs(a - b) / error)
    far = abs(a[k] - b[k]) / (error[k] + 1e-7)
    print(f"{a[k]:.6g} and {b[k]:.6g}: {far:.3g} standard errors")


def by_sample(a: Any, b: Any, counts: Any) -> None:
    """Of samples that count the most unequal one, but for a thousandth of them."""
    a, b, counts = np.broadcast_arrays(a, b, counts)
    size = np.fmax(abs(a), abs(b))[(0, 0) if a.ndim == 4 else ...]
    off = np.abs(np.nan_to_num(np.where(counts, a - b, 0))) / np.fmax(size, 1e-30)
    k = np.unravel_index(np.argsort(off, axis=None)[-1 - a.shape[-1] // 1000], a.shape)
    print(f"{a[k]:.6g} and {b[k]:.6g}: {off[k] / ROUNDING:.3g} roundings")


# Those of chance, which need many samples.
OF_CHANCE = (apart, most_apart)

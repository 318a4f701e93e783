"""Normal scores: the number of standard deviations that is as improbable as a finding.

A probability below 1e-300 counts as that, so that no score is infinite.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

__all__ = ["student_score", "two_sided_score"]

LEAST = 1e-300


def student_score(t: ArrayLike, dof: ArrayLike) -> NDArray[np.float64]:
    """Normal score of the same probability as Student's t, with its sign."""
    tail = special.stdtr(np.minimum(dof, 1e9), -np.abs(t))
    return 0.0 - np.sign(t) * special.ndtri(np.maximum(tail, LEAST))


def two_sided_score(below: ArrayLike, above: ArrayLike) -> NDArray[np.float64]:
    """Normal score from the probabilities of at most and at least what was seen."""
    p = np.minimum(2 * np.minimum(below, above), 1.0)
    size = -special.ndtri(np.maximum(p / 2, LEAST))
    return np.where(np.less(below, above), -size, size)

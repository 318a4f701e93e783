"""Variances of the patches of a record, each learnt from patches that are alike."""

from __future__ import annotations

import numpy as np

from ..array_types import Floats, Integers

__all__ = ["pooled"]

# Patches that share a variance, and the hits that they must have together.
LEAST_PATCHES, LEAST_HITS = 16, 100


def pooled(variances: Floats, hits: Integers, brightness: Floats) -> Floats:
    """Mean variance of the patches that are about as bright.

    A variance from 16 batches is itself off by a third, and a patch that has by chance
    received too little has too small a one as well: weights from single variances
    would bias a fit, and make it look better than it is. Here they are shared by
    patches of similar `brightness`, which is a model's and not the record's.

    Parameters
    ----------
    variances, hits, brightness : ndarray, shape (n,)

    Returns
    -------
    ndarray, shape (n,)
        Positive, if any patch has a variance.
    """
    order = np.argsort(brightness, kind="stable")
    starts, patches, total = [0], 0, 0
    for i, n in enumerate(hits[order].tolist()):
        if patches >= LEAST_PATCHES and total >= LEAST_HITS:
            starts.append(i)
            patches = total = 0
        patches, total = patches + 1, total + n
    if len(starts) > 1 and (patches < LEAST_PATCHES or total < LEAST_HITS):
        starts.pop()
    sizes = np.diff([*starts, len(order)])
    means = np.add.reduceat(variances[order], starts) / sizes
    found = np.empty_like(variances)
    found[order] = np.repeat(means, sizes)
    return found

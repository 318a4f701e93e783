"""Whether answers agree, but for what single precision may leave."""

from __future__ import annotations

import numpy as np

from ..array_types import Flags, Numbers

__all__ = ["BSDF_ROUNDING", "FEW", "SLACK", "is_many", "unequal"]

# Relative difference that single precision may leave: twice what right BSDFs, Mitsuba's
# too, were seen to need (facets of `sample_visible=false` 1e-5 to 3e-5; all others less
# than 1e-6). And, where they are badly conditioned, how many times the change under a
# displacement of both directions by 4 ulp.
BSDF_ROUNDING = 2.0**-14
SLACK = 16

# Share of samples that may differ by more, for rounding is not bounded by its sample.
FEW = 5e-5


def unequal(a: Numbers, b: Numbers, slack: Numbers | float) -> Flags:
    """Mask of samples whose values differ by more than rounding, shape ``(n,)``."""
    tolerance = BSDF_ROUNDING * np.maximum(np.abs(a), np.abs(b)) + SLACK * slack
    differs = np.abs(a - b) > tolerance
    return differs if differs.ndim == 1 else differs.any(axis=1)


def is_many(mask: Flags, n: int) -> bool:
    """Whether more samples than rounding may spoil."""
    return mask.sum() > max(2, FEW * n)

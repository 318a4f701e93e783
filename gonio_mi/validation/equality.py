"""Whether answers agree, but for what single precision may leave."""

from __future__ import annotations

import numpy as np

from ..array_types import Flags, Numbers

__all__ = ["BSDF_ROUNDING", "FEW", "SLACK", "ULPS", "is_many", "unequal"]

# Relative difference that single precision may leave between two ways to compute a
# value: 1024 operations, each off by half an ulp. Of Mitsuba's own functions those of
# `hair` have most, 962; those of `principled` up to 376.
BSDF_ROUNDING = 1024 * 2.0**-24

# Where operations are badly conditioned more is left: so many times the change under a
# displacement of both directions by 4 ulp of 1. Beyond that, of 77 right BSDFs one was
# seen to need more than 2^-18, GGX of roughness 0.05 with all normals: 1 sample in 2^16
# needs more than `BSDF_ROUNDING`.
SLACK = 16
ULPS = 2.0**-21

# Share of samples that may differ by any amount, for they are as near to a jump, where
# two functions may take different sides: six jumps of a BSDF, at its horizons, along
# each of which there is at most one sample a radian.
FEW = 6 * SLACK * ULPS


def unequal(a: Numbers, b: Numbers, slack: Numbers | float) -> Flags:
    """Mask of samples whose values differ by more than rounding, shape ``(n,)``."""
    tolerance = BSDF_ROUNDING * np.maximum(np.abs(a), np.abs(b)) + SLACK * slack
    differs = np.abs(a - b) > tolerance
    return differs if differs.ndim == 1 else differs.any(axis=1)


def is_many(mask: Flags, n: int) -> bool:
    """Whether more samples than rounding may spoil."""
    return mask.sum() > max(2, FEW * n)

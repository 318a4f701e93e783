"""For the test suites of those who write Mitsuba plugins: of the annex `validation`."""

from .validation.testing import (
    BSDFAdapter,
    ChiSquareTest,
    PhaseFunctionAdapter,
    SphericalDomain,
    assert_bsdf_valid,
)

__all__ = [
    "BSDFAdapter",
    "ChiSquareTest",
    "PhaseFunctionAdapter",
    "SphericalDomain",
    "assert_bsdf_valid",
]

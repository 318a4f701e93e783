"""The estimator `analog`: a ray survives or is absorbed, and hits are counted.

The method of the paper (eq. 5).
"""

from ..transport.method import Method


class Analog(Method):
    """Each ray stays whole: all sums are numbers of rays."""

    counted = True
    differentiable = False  # a ray lives or ends

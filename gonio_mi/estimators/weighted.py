"""The estimator `weighted`: rays take the weights of `sample` to where they leave.

It applies to whatever can be measured: the interface itself.
"""

from ..transport.method import Method


class Weighted(Method):
    """The throughput of each ray is added up in the patch that it reaches."""

"""The estimator `weighted`: rays take the weights of `sample` to where they leave.

It applies to every specimen and is the interface's own behaviour.
"""

from ..transport.method import Method


class Weighted(Method):
    """The throughput of each ray is added up in the patch that it reaches."""

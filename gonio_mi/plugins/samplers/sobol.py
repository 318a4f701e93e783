"""Sampler `sobol`: Owen-scrambled Sobol' points, distributed in all dimensions."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from gonio_mi.errors import VariantError
from gonio_mi.transport.curve import Curve
from gonio_mi.transport.sampling import split_lanes
from gonio_mi.transport.sobol_points import byte_table, fraction, sobol_number


class Sobol(mi.Sampler):
    r"""Owen-scrambled Sobol' points (:monosp:`sobol`).

    Ray ``i`` of a wavefront draws its numbers from point ``start + i`` of one scrambled
    Sobol' sequence. The first sixteen, more than the beam and the first event need, are
    coordinates of the same 16-dimensional point, so that they are well distributed
    *jointly*. The next sixteen come from the same sequence in a shuffled order, and so
    on without an end: independent between blocks of sixteen, well distributed within.

    Every seed is an independent scrambling of the sequence. Each number is uniform on
    the multiples of 2**-24 in [0, 1), for any number of rays; a power of two of them
    has the least error. The sequence has 2**32 points and then begins again.

    .. pluginparameters::

     * - sample_count
       - |int|
       - Number of samples per pixel, for Mitsuba's own integrators. (Default: 4)

     * - seed
       - |int|
       - Added to the seed of each rendering or batch. (Default: 0)

    .. tabs::
        .. code-tab:: xml

            <sampler type="sobol"/>

        .. code-tab:: python

            'type': 'sobol'
    """

    is_joint = True

    def __init__(self, props: mi.Properties) -> None:
        if not dr.is_jit_v(mi.Float):
            raise VariantError(
                f"the sampler sobol needs an llvm or cuda variant, got {mi.variant()}"
            )
        super().__init__(props)
        self.base_seed = props.get("seed", 0)
        # Index in the sequence of the first point of the next wavefront to be seeded
        self.start = 0
        self.index = mi.UInt32(0)
        # What is added to the index by exclusive or
        self.beside: mi.UInt32 | None = None
        self.key = mi.UInt32(0)
        self.draw = mi.UInt32(0)
        # Scrambling of each sequence
        self.keys = mi.UInt32(0)
        byte_table(mi.UInt32)

    def seed(self, seed: Any, wavefront_size: int = 0xFFFFFFFF) -> None:
        """Choose the scrambling and go to the point `start`; nothing recompiles.

        Several seeds share the wavefront evenly: that many sequences, one after the
        other.
        """
        super().seed(seed, wavefront_size)
        self.keys = self.key = mi.UInt32(seed) + self.base_seed
        dr.make_opaque(self.keys)
        lane = dr.arange(mi.UInt32, self.wavefront_size())
        sequences = dr.width(self.keys)
        if sequences > 1:
            sequence, lane = split_lanes(lane, self.wavefront_size() // sequences)
            self.key = dr.gather(mi.UInt32, self.key, sequence)
        self.index = lane + dr.opaque(mi.UInt32, self.start)
        self.draw = mi.UInt32(0)

    def follow(self, curve: Curve) -> tuple[mi.UInt32, mi.UInt32]:
        """Take the points in the order of a curve, so that rays in a row are close by.

        Those of the sequences that were seeded: their first point is `start`.

        Returns
        -------
        sequence, number : mi.UInt32
            Of each lane, and number of its point in that sequence, from 0. A lane that
            only fills packets has a number that no point of the curve has.
        """
        sequence, self.key, self.index = curve.points(self.keys)
        return sequence, self.index - dr.opaque(mi.UInt32, self.start)

    def points(self) -> tuple[mi.UInt32, mi.UInt32]:
        """Index and key of the point of each lane, for :meth:`go_to`."""
        every = dr.zeros(mi.UInt32, dr.width(self.index))
        return self.index + every, self.key + every

    def go_to(
        self, index: mi.UInt32, key: mi.UInt32, beside: mi.UInt32 | None = None
    ) -> None:
        """Draw the numbers of other points, from their first.

        If `beside`, a number below 16, is given, their indices are ``index ^ beside``.
        """
        self.index, self.key, self.draw = index, key, mi.UInt32(0)
        self.beside = beside

    def advance(self) -> None:
        """Go on by one wavefront."""
        self.index = self.index + self.wavefront_size()
        self.draw = mi.UInt32(0)

    def next_1d(self, active: mi.Bool | bool = True) -> mi.Float:
        """Next number of each point."""
        del active
        bits = sobol_number(self.index, self.key, self.draw, self.beside)
        self.draw = self.draw + 1
        return fraction(bits)

    def next_2d(self, active: mi.Bool | bool = True) -> mi.Point2f:
        """Next two numbers of each point."""
        x = self.next_1d(active)
        return mi.Point2f(x, self.next_1d(active))

    def skip(self, n: Any) -> None:
        """Leave out the next `n` numbers of each point."""
        self.draw = self.draw + n

    def fork(self) -> Sobol:
        """Return a sampler of the same settings, to be seeded."""
        copy = type(self)(mi.Properties("sobol"))
        copy.set_sample_count(self.sample_count())
        copy.base_seed, copy.start = self.base_seed, self.start
        return copy

    def clone(self) -> Sobol:
        """Return a sampler that draws the same numbers."""
        copy = self.fork()
        if self.wavefront_size():
            mi.Sampler.seed(copy, 0, self.wavefront_size())
        copy.__dict__.update(vars(self))
        return copy

    def schedule_state(self) -> None:
        """Schedule the state for evaluation."""
        dr.schedule(self.index, self.key, self.draw)

    def to_string(self) -> str:
        """Return a readable description."""
        return f"Sobol[sample_count={self.sample_count()}]"


PLUGIN = Sobol

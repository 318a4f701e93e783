"""From batches to launches: which of them share one, and how many rays it has."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import mitsuba as mi

from ..results.tally import Tally
from ..settings import MeasurementSettings
from ..transport.bench import Bench
from ..transport.kernels import check_all_counted
from ..transport.launch import traces
from ..transport.morton import block_bits
from ..transport.pace import Pace, segments
from ..transport.sums import Totals, packet_width

__all__ = ["Launches"]

# Rays per kernel launch, at most. For samplers other than `sobol` it takes part in the
# seeding: a change of it changes the random numbers.
LAUNCH = 2**24

# Rays of the batches that share a launch on a plane, and of any launch along a curve:
# many for its overhead, few for the progress bar and Ctrl-C; and the numbers that they
# add up to, kept apart for each thread and in its cache.
FUSED_RAYS = 2**22
FUSED_SUMS = 2**19

# Rays of the first launch: of more than can be sent along a curve in one, of others
# that are traced, and on a plane; and points that traced ones send light to. Then as
# many as take a second.
FIRST_OF_CURVE, FIRST_TRACED, FIRST_PLANE = 2**16, 2**18, 2**20
FIRST_POINTS = 2**22

# Seconds in which batches that share launches are to be finished, for Ctrl-C keeps no
# part of them in the first round.
GROUP_SECONDS = 4

# Rays of each batch in a round: traced and on a plane. Of samplers whose numbers
# depend on the launch, rounds are whole launches.
ROUND_TRACED, ROUND_PLANE = 2**17, 2**24


class Launches:
    """How the rays of batches at a bench are shared among launches.

    Parameters
    ----------
    bench : Bench
    settings : MeasurementSettings
    points : int
        Directions that a ray looks into at each event.
    pace : Pace, optional
        Of the launches before, perhaps at other benches.
    """

    def __init__(
        self,
        bench: Bench,
        settings: MeasurementSettings,
        points: int = 1,
        pace: Pace | None = None,
    ) -> None:
        self.bench, self.settings = bench, settings
        self.traced = traces(bench, settings)
        self.first_rays = min(FIRST_TRACED, FIRST_POINTS // points)
        self.pace = pace or Pace(self.first_rays if self.traced else FIRST_PLANE)
        # whether numbers are the same however launches share them, and whether rays
        # start side by side on the specimen
        self.divisible = hasattr(bench.sampler, "start")
        self.curved = self.traced and hasattr(bench.sampler, "follow_curve")
        # by which the pace was found out: of so many batches, to there on the curve
        self._begun: tuple[Totals, int, int] | None = None

    @property
    def capacity(self) -> int:
        """Batches that may share a launch: the same for all launches at a bench."""
        if not self.divisible:
            return 1
        sums = len(self.bench.classes) * self.bench.n_bins * packet_width()
        fitting = FUSED_SUMS // sums
        return max(1, min(fitting, self.settings.batches))

    @property
    def round_rays(self) -> int:
        """Rays of each batch after which all of them are even for the first time."""
        if not self.divisible:
            return LAUNCH
        return ROUND_TRACED if self.traced else ROUND_PLANE

    def several(
        self,
        keys: Sequence[tuple[int, ...]],
        sizes: Sequence[int],
        start: int,
        wavelengths: mi.Spectrum,
    ) -> int:
        """How many of the batches, which are about to be sent, share their launches."""
        most = min(len(sizes), self.capacity)
        if not self.curved:
            fitting = min(FUSED_RAYS, self.pace.rays) // sizes[0]
        elif start:
            fitting = most  # Ctrl-C keeps none before all have finished the round
        else:
            if sum(sizes) > self.first_rays and not self.pace.known:
                self._begin(keys[:most], sizes[:most], wavelengths)
            fitting = GROUP_SECONDS * self.pace.rays // sizes[0]
        return max(1, min(most, fitting))

    def tally(
        self,
        keys: Sequence[tuple[int, ...]],
        sizes: Sequence[int],
        start: int,
        wavelengths: mi.Spectrum,
        progress: Callable[[float], Any] | None,
    ) -> Tally:
        """Tally of batches that share their launches; see `Instrument.tallies`."""
        send = partial(self._launched, keys, wavelengths)
        parts = self._along_curve if self.curved else self._in_order
        total: Any = None
        for totals in parts(send, sizes, start):
            total = totals if total is None else total + totals
            if progress is not None:
                progress(totals.emitted)
        check_all_counted(sum(sizes), total.emitted)
        tally: Tally = total.tally()
        return tally

    def _launched(
        self,
        keys: Sequence[tuple[int, ...]],
        wavelengths: mi.Spectrum,
        sizes: Sequence[int],
        begin: int,
        stretch: tuple[int, int] | None = None,
    ) -> Totals:
        """Totals of one launch."""
        rays = stretch[1] - stretch[0] if stretch else sum(sizes)
        arguments = self.bench, self.settings, keys, sizes, begin, wavelengths
        return self.pace.launch(rays, *arguments, self.capacity, stretch)

    def _in_order(
        self, send: Callable[..., Totals], sizes: Sequence[int], start: int
    ) -> Iterator[Totals]:
        """Totals of launches that each send the next rays of all batches."""
        begin, end = start, start + sizes[0]
        while begin < end:
            n = min(LAUNCH, end - begin)
            if self.divisible:
                n = self.pace.next_part(begin, end, LAUNCH)
            yield send([min(n, start + size - begin) for size in sizes], begin)
            begin += n

    def _along_curve(
        self, send: Callable[..., Totals], sizes: Sequence[int], start: int
    ) -> Iterator[Totals]:
        """Totals of launches that each go on where the one before ended."""
        for begin, end in segments(start, start + sizes[0], self._longest(sizes)):
            parts = [min(end, start + size) - begin for size in sizes]
            at, length = 0, len(sizes) << block_bits(begin, end - begin)
            if self._begun is not None:
                (totals, batches, there), self._begun = self._begun, None
                if batches == len(sizes):  # of fewer it does not tell
                    yield totals
                    at = there
            while at < length:
                n = self.pace.next_part(at, length, FUSED_RAYS)
                yield send(parts, begin, (at, at + n))
                at += n

    def _longest(self, sizes: Sequence[int]) -> int:
        """Points of each batch along a curve, at most: places have 32 bits."""
        return 2**31 >> (len(sizes) - 1).bit_length()

    def _begin(
        self,
        keys: Sequence[tuple[int, ...]],
        sizes: Sequence[int],
        wavelengths: mi.Spectrum,
    ) -> None:
        """Send the first rays of batches along their curve, and find out the pace."""
        _, end = next(segments(0, sizes[0], self._longest(sizes)))
        parts = [min(end, size) for size in sizes]
        first = min(FIRST_OF_CURVE, self.first_rays)
        there = min(first, len(sizes) << block_bits(0, end))
        totals = self._launched(keys, wavelengths, parts, 0, (0, there))
        self._begun = totals, len(sizes), there

"""From rounds to launches: which batches share one, and how many rays it has."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import drjit as dr

from ..kernels import check_all_counted
from ..results.tally import Tally
from ..specimen.wavelengths import lanes_of
from ..transport.curve import MAX_SEQUENCES, curves
from ..transport.launch import Launch, launch, traces
from ..transport.sampling import is_joint
from ..transport.setup import Setup
from ..transport.sums import Totals, n_numbers
from .schedule import Round, Target

# Rays per kernel launch, at most, and points or branches. For samplers other than
# `sobol` it takes part in the seeding: a change of it changes the random numbers.
MAX_LAUNCH = 2**24

# Rays of the batches that share a launch on a plane, and of any launch along a curve:
# many for its overhead, few for the progress bar and Ctrl-C; the numbers that they add
# up to, as many as Dr.Jit keeps apart for each thread (`drjit.expand_threshold`): also
# those of several incident directions.
FUSED_RAYS = 2**22
FUSED_SUMS = 2**20

# Rays of the first launch: traced and on a plane; and points that traced ones send
# light to. Then as many as take a second.
FIRST_TRACED, FIRST_PLANE = 3 * 2**17, 2**20
FIRST_POINTS = 2**22

# Rays of each batch in a round: traced and on a plane. Of samplers whose numbers
# depend on the launch, rounds are whole launches.
ROUND_TRACED, ROUND_PLANE = 2**17, 2**24

# Rays of all batches in a round through surfaces, at least: each walks along the whole
# curve, where neighbours traverse the same part of the specimen.
ROUND_SHARED = 2**23

# Incident directions that may share a launch, at least: it is another kernel, and to
# compile it takes as long as some dozens of launches.
FEWEST_TOGETHER = 8

# What a launch is to take, so that Ctrl-C is heard within seconds.
LAUNCH_SECONDS = 1.0

# Rays of a launch, at least.
MIN_RAYS = 2**10

# How much longer a launch is than the one before, at most.
MAX_GROWTH = 128


def rays_per_round(setup: Setup) -> int:
    """Rays of each batch in the first rounds."""
    if not is_joint(setup.sampler):
        return MAX_LAUNCH
    if not traces(setup):
        return ROUND_PLANE
    if setup.specimen.media or setup.settings.n_looks > 1:  # rays that take long
        return ROUND_TRACED
    return max(ROUND_TRACED, ROUND_SHARED >> (setup.settings.batches - 1).bit_length())


class Launcher:
    """How the rays of batches are shared among launches.

    Small batches share a launch if the sampler keeps them apart.

    Parameters
    ----------
    setups : sequence of Setup
        They differ in their incident direction only.

    Attributes
    ----------
    together : int
        Incident directions that share launches.
    """

    def __init__(self, setups: Sequence[Setup]) -> None:
        setup, settings = setups[0], setups[0].settings
        traced = traces(setup)
        first = min(FIRST_TRACED, FIRST_POINTS // settings.n_looks)
        self.size = LaunchSize(first if traced else FIRST_PLANE)
        # else what all points or branches of a launch add to a patch may overflow
        self.most = MAX_LAUNCH // settings.n_looks
        # whether numbers are the same however launches share them, and whether rays
        # start along a curve over the specimen
        self.divisible = is_joint(setup.sampler)
        self.on_curve = traced and self.divisible
        # batches of a direction that may share a launch: the same for all launches
        self.capacity = 1
        if self.divisible:
            # along a curve orders have the same bits together and one by one
            sums = setup.n_bins * (1 if self.on_curve else len(setup.classes))
            fitting = FUSED_SUMS // (sums * n_numbers())
            self.capacity = max(1, min(fitting, settings.batches, MAX_SEQUENCES))
        # of rare powers that sums have room for: what was met so far
        self.levels = setup.levels
        self.known: tuple[Setup, list[Any]] | None = None
        self.together = 1
        # all that a direction sends
        whole = self.divisible and self.capacity == settings.batches
        if len(setups) >= FEWEST_TOGETHER and whole and _may_share(setup):
            fitting = FUSED_SUMS // (sums * n_numbers() * settings.batches)
            if Target.of(settings) is None:
                fitting = min(fitting, FUSED_RAYS // settings.rays)
            self.together = group_size(len(setups), max(1, fitting))

    def n_together(self, part: Round) -> int:
        """How many incident directions share the launches of a round.

        All of their batches do, as those of a single one.
        """
        return max(1, min(self.together, FUSED_RAYS // sum(part.sizes)))

    def tallies(
        self,
        setups: Sequence[Setup],
        part: Round,
        report: Callable[[float], Any] | None = None,
    ) -> Iterator[list[Tally]]:
        """Tallies of the batches of a round in order, of one batch each or of several.

        Each time one for each of the setups, which are `together` or less. `report` is
        called after each launch with the rays it sent.
        """
        passes = setups[0].passes
        for planned in self.plan(setups, part):
            groups = []
            for one, nm in zip(planned, passes):
                total: Any = None
                for piece in self.pieces(one):
                    totals = _launched(replace(piece, levels=self.levels))
                    self.levels = totals.sums.levels
                    self.size.learn(piece.rays, totals.started)
                    total = totals if total is None else total + totals
                    if report is not None:
                        report(totals.emitted)
                check_all_counted(sum(one.sizes), total.emitted)
                tallies = setups[0].method.tallies(total, len(setups))
                groups.append([x if nm is None else x.first(len(nm)) for x in tallies])
            yield [
                each[0] if len(each) == 1 else Tally.join_channels(each)
                for each in zip(*groups)
            ]

    def plan(self, setups: Sequence[Setup], part: Round) -> Iterator[list[Launch]]:
        """Yield what the next batches that share launches send, pass by pass, uncut.

        Those that walk along a curve share packets of rays too, so that their number
        follows from the rays alone: it decides about last bits, and the clock must not.
        """
        setup, n = setups[0], len(setups)
        beams = tuple(one.beam for one in setups) if n > 1 else ()
        capacity = self.capacity * (self.together if n > 1 else 1)
        lanes = lanes_of(setup.settings.wavelengths)
        controls, own = self._controls(setup, lanes), [one.key for one in setups]
        first, sizes = part.first, tuple(size for size in part.sizes for _ in setups)
        while sizes:
            several = min(len(sizes), capacity)
            # else Ctrl-C keeps none before all have finished the round
            if not (self.on_curve and part.start):
                rays = FUSED_RAYS if self.on_curve else min(FUSED_RAYS, self.size.rays)
                # the last batch is always among them
                several = max(1, min(several, rays // sizes[-1]) // n) * n
            batches = range(first, first + several // n)
            keys = [(*key, batch) for batch in batches for key in own]
            yield [
                Launch(
                    setup,
                    beams,
                    wavelengths=nm,
                    capacity=capacity,
                    keys=tuple((*key, number) for key in keys),
                    sizes=sizes[:several],
                    begin=part.start,
                    control=known,
                )
                for number, (nm, known) in enumerate(zip(lanes, controls))
            ]
            first, sizes = first + several // n, sizes[several:]

    def pieces(self, whole: Launch) -> Iterator[Launch]:
        """Cut what batches send into launches, each of the size that was learnt."""
        cut = self._curve_launches if self.on_curve else self._ordered_launches
        return cut(whole)

    def _controls(self, setup: Setup, lanes: Sequence[Any]) -> list[Any]:
        """Light that is known without rays, for each pass: made in the first round."""
        if self.known is None or self.known[0] is not setup:
            self.known = setup, [setup.method.control(setup, nm) for nm in lanes]
        return self.known[1]

    def _ordered_launches(self, whole: Launch) -> Iterator[Launch]:
        """Launches that each send the next rays of all batches."""
        start, sizes = whole.begin, whole.sizes
        begin, end = start, start + sizes[0]
        while begin < end:
            n = min(self.most, end - begin)
            if self.divisible:
                n = self.size.next_part(begin, end, self.most)
            parts = sizes
            if n < end - start:
                parts = tuple(min(n, start + size - begin) for size in sizes)
            yield replace(whole, sizes=parts, begin=begin)
            begin += n

    def _curve_launches(self, whole: Launch) -> Iterator[Launch]:
        """Launches that each go on where the one before ended."""
        start, sizes, groups = whole.begin, whole.sizes, whole.n_directions
        n_next = partial(self.size.next_part, most=min(FUSED_RAYS, self.most))
        for curve in curves(start, start + sizes[0], len(sizes), groups):
            parts = tuple(min(curve.end, start + size) - curve.begin for size in sizes)
            for stretch in curve.cut(n_next):
                yield replace(whole, sizes=parts, begin=curve.begin, curve=stretch)


def _launched(piece: Launch) -> Totals:
    """Totals of a launch; of the same rays again for each further derivative."""
    gradients = piece.setup.gradients
    if gradients is None:
        return launch(piece)
    each = []
    for column, derivative in gradients.derivatives:
        with gradients.attached(column.directions), dr.suspend_grad():
            each.append(launch(replace(piece, derivative=derivative)))
    gradients.unsound += sum(int(one.sums.unsound[0]) for one in each)
    return each[0].beside(each[1:])


def group_size(n: int, most: int) -> int:
    """Size of the groups of `n`: as few as `most` in each allows, about equal."""
    return -(-n // -(-n // most))


def _may_share(setup: Setup) -> bool:
    """Whether rays of several incident directions may share a launch.

    On a plane not those of plugins in Python that look into their arguments, for they
    may take the direction for that of all rays.
    """
    if not setup.beam.collimated:
        return False
    if traces(setup):
        # the first order of each direction is a table of its own
        return not setup.specimen.media and not setup.method.controls(setup)
    return not setup.specimen.plane.by_ray


class LaunchSize:
    """Rays of the next launch: many for its overhead, few for Ctrl-C.

    It follows the clock: only where bits do not depend on how launches share rays.

    Parameters
    ----------
    rays : int
        Of the first launch.
    """

    def __init__(self, rays: int) -> None:
        self.rays = rays

    def learn(self, rays: int, started: float) -> None:
        """Learn from so many rays, whose kernel `started` then and has just ended.

        How long it took to be compiled says nothing of the next one.
        """
        elapsed = time.perf_counter() - started
        growth = min(max(LAUNCH_SECONDS / elapsed, 0.25), MAX_GROWTH)
        self.rays = max(int(rays * growth), MIN_RAYS)

    def next_part(self, begin: int, end: int, most: int) -> int:
        """Rays to send next of those from `begin` to `end`, about alike in size."""
        # the generator is seeded anew for every 2**32 rays
        left = min(end, (begin // 2**32 + 1) * 2**32) - begin
        return -(-left // -(-left // min(self.rays, most)))

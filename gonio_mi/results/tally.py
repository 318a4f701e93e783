"""Sums of what the collector received, batch by batch; integrals; the ledger."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from functools import cached_property
from typing import Any, ClassVar, SupportsInt

import numpy as np

from ..array_types import Counts, Floats, Numbers

# Weights are added up in units of 2**-24 of a ray: exactly, however faint, in a launch;
# and in double precision, which 1e12 rays of unit weight do not exhaust, over launches.
WEIGHT_SCALE = 2**24

# Names of the elements of a Mueller matrix beside the first, row by row; their number.
ELEMENT_NAMES = tuple(f"M{i}{j}" for i in range(4) for j in range(4))[1:]
N_ELEMENTS = len(ELEMENT_NAMES)


def batch_sizes(rays: int, batches: int) -> list[int]:
    """Split `rays` over at most `batches` batches that differ by one ray at most."""
    batches = min(rays, batches)
    return [-(-(rays - i) // batches) for i in range(batches)]


class Fate(IntEnum):
    """What became of a ray. The order is that of the tally's columns."""

    REFLECTED = 0
    TRANSMITTED = 1
    ABSORBED = 2
    MISSED = 3
    SIDEWAYS = 4
    TRUNCATED = 5
    REJECTED = 6
    INVALID = 7
    UNLIT = 8
    INTEGRATED = 9
    OTHER_ORDER = 10
    DIRECT = 11
    ABSORBED_INSIDE = 12
    ASTRAY = 13
    # no fate, and the last column: of those reflected and transmitted
    OVER_THE_EDGE = 14


@dataclass(frozen=True)
class Ledger:
    """Where every ray went, as whole numbers of rays that add up to `emitted`.

    Of rays, not of power: one that left with a weight of 0.8 counts as one reflected,
    and the 0.2 that the specimen kept are in no row.

    Attributes
    ----------
    reflected, transmitted : int
        Left into the hemisphere of the emitter, or into the opposite one, after one
        surface event or more.
    absorbed : int
        Ended in the specimen: no throughput was left.
    missed : int
        Never met the specimen, which is finite. These rays are not part of the
        incident flux.
    sideways : int
        Left along the horizon, after 4096 cells of a periodic specimen, or past a
        collector of finite radius (unscattered, also above its horizon). In records up
        to version 0.1: also through a side of the specimen's bounding box.
    truncated : int
        Still inside after ``max_depth`` surface events.
    rejected : int
        The BSDF's ``sample`` failed: no direction, zero density.
    invalid : int
        ``sample`` gave a weight that is negative, not finite or above 32768 (2**30 for
        the product of all weights of a path), or a direction that is no unit vector;
        or ``eval`` the like, for the estimator `next_event`; in polarised variants also
        a matrix with an element, or a length of the rest of its first row or column,
        that exceeds the first element by more than rounding, 6e-5 of it.
    unlit : int
        The emitter sends nothing along this ray.
    integrated : int
        ``sample`` chose a component that the estimator `quadrature` integrates.
    other_order : int
        Left after another number of surface events than the `order` that is collected.
    direct : int
        Passed a periodic specimen without any event, straight on: transmitted.
    absorbed_inside : int
        Ended inside of a medium: absorbed by it, or by Russian roulette.
    astray : int
        Left the scene inside of a medium, or met a surface from another medium than
        the one it says: the shape is open, or overlaps another.
    over_the_edge : int
        Of those reflected and transmitted: left a free-standing specimen through a side
        of its bounding box. No row, for these rays are in two others.
    """

    reflected: int = 0
    transmitted: int = 0
    absorbed: int = 0
    missed: int = 0
    sideways: int = 0
    truncated: int = 0
    rejected: int = 0
    invalid: int = 0
    unlit: int = 0
    integrated: int = 0
    other_order: int = 0
    direct: int = 0
    absorbed_inside: int = 0
    astray: int = 0
    over_the_edge: int = 0

    def __repr__(self) -> str:
        shown = ", ".join(f"{name}={n}" for name, n in vars(self).items() if n)
        return f"Ledger({shown})"

    @classmethod
    def from_counts(cls, counts: Iterable[SupportsInt]) -> Ledger:
        """Build from counts in the order of :class:`Fate`."""
        return cls(*map(int, counts))

    @property
    def rows(self) -> dict[str, int]:
        """Dictionary of row name to number of rays."""
        return {k: n for k, n in vars(self).items() if k != "over_the_edge"}

    @property
    def emitted(self) -> int:
        """All rays: the sum of the rows."""
        return sum(vars(self).values()) - self.over_the_edge

    def __add__(self, other: Ledger) -> Ledger:
        """Ledger of both sets of rays."""
        return Ledger(**{k: n + vars(other)[k] for k, n in vars(self).items()})


@dataclass(frozen=True, eq=False)
class Tally:
    """Sums of one measurement, batch by batch.

    Attributes
    ----------
    hits : ndarray of uint64, shape (n_hemispheres, n_theta, n_phi)
        Rays that each patch received, or deposits of the estimator `next_event`; of
        `split` branches of rays, and points of the surface.
        Hemisphere 0 is the emitter's side.
    sums : ndarray, shape (n_batches, n_hemispheres, n_theta, n_phi, channels)
        Received flux in units of ``1 / scale`` of a ray: uint64 where rays are counted,
        float64 where weights are summed, so that faint light keeps its digits.
        Negative by chance where rays correct a sum over `facets`.
    incident : ndarray, shape (n_batches, channels)
        Flux that met the specimen, of the same type and in the same unit.
    fates : ndarray of uint64, shape (n_batches, len(Fate))
        Rays by their fate.
    scale : int
        1 when rays are counted, `WEIGHT_SCALE` when weights are summed.
    direct : ndarray, shape (n_batches, channels)
        Flux that passed a periodic specimen without any event, like `incident`: part
        of the sums, where there is a lower hemisphere. None is given for nothing.
    """

    arrays: ClassVar[tuple[str, ...]] = ("hits", "sums", "incident", "fates", "direct")
    # those whose last axis are the channels, and those of batches and hemispheres
    of_channels: ClassVar[tuple[str, ...]] = ("sums", "incident", "direct")
    of_patches: ClassVar[tuple[str, ...]] = ("sums",)
    # whether its batches can be put beside others of the same measurement
    joinable: ClassVar[bool] = True

    hits: Counts
    sums: Numbers
    incident: Numbers
    fates: Counts
    scale: int
    direct: Numbers = field(default=None, kw_only=True)  # type: ignore[arg-type]

    def __post_init__(self) -> None:
        if self.direct is None:
            object.__setattr__(self, "direct", np.zeros_like(self.incident))

    def freeze(self) -> None:
        """Let nobody write into the arrays from now on."""
        for name in self.arrays:
            getattr(self, name).flags.writeable = False

    @classmethod
    def empty(
        cls, n_hemispheres: int, shape: tuple[int, int], channels: int, scale: int
    ) -> Tally:
        """A tally of weights without batches."""
        return cls(
            hits=np.zeros((n_hemispheres, *shape), np.uint64),
            sums=np.zeros((0, n_hemispheres, *shape, channels)),
            incident=np.zeros((0, channels)),
            fates=np.zeros((0, len(Fate)), np.uint64),
            scale=scale,
        )

    @property
    def n_batches(self) -> int:
        """Number of independent batches."""
        return len(self.fates)

    @property
    def channels(self) -> int:
        """Number of channels."""
        return self.sums.shape[-1]

    @property
    def achromatic(self) -> bool:
        """Whether all channels received the same."""
        if self.channels == 1:
            return True
        arrays = (getattr(self, name) for name in self.of_channels)
        return all(bool(np.all(array == array[..., :1])) for array in arrays)

    @cached_property
    def ledger(self) -> Ledger:
        """:class:`Ledger` over all batches."""
        return Ledger.from_counts(self.fates.sum(axis=0))

    def __add__(self, other: Tally) -> Tally:
        """Tally of the batches of both, exactly; see :meth:`join`."""
        return Tally.join([self, other])

    @classmethod
    def join(cls, tallies: Sequence[Tally]) -> Tally:
        """Tally of all batches of `tallies`, exactly.

        A tally of one channel is spread over the channels of the others. A single
        one is what it is.

        Raises
        ------
        ValueError
            If they do not share their patches and their scale.
        """
        first = tallies[0]
        if len(tallies) == 1:
            return first
        for other in tallies:
            if not other.joinable:
                raise ValueError("tallies that hold integrals cannot be joined")
            if first.hits.shape != other.hits.shape or first.scale != other.scale:
                raise ValueError(
                    "tallies must share patches and scale to be joined, got "
                    f"{first.hits.shape} x {first.scale} and "
                    f"{other.hits.shape} x {other.scale}"
                )
        channels = max(tally.channels for tally in tallies)
        tallies = [tally.spread(channels) for tally in tallies]
        return first._with(
            {name: _concatenated(tallies, name, 0) for name in first.arrays}
            | {"hits": sum(tally.hits for tally in tallies[1:]) + first.hits}
        )

    def added_up(self) -> Tally:
        """Tally of one batch, the sum of all in double precision; without matrices.

        Values are as they were, to the bit; what they may be wrong by is lost.
        """
        names = ("sums", "incident", "direct")
        sums = {n: np.sum(getattr(self, n), axis=0, dtype=float)[None] for n in names}
        return self._with(sums | {"fates": self.fates.sum(axis=0, keepdims=True)})

    def accumulate(self, other: Tally) -> Tally:
        """Tally of one batch from two parts of it: the sums add, batch by batch."""
        channels = max(self.channels, other.channels)
        a, b = self.spread(channels), other.spread(channels)
        return a._with({name: getattr(a, name) + getattr(b, name) for name in a.arrays})

    @classmethod
    def join_channels(cls, tallies: Sequence[Tally]) -> Tally:
        """Tally of all channels of `tallies`, for which separate rays were sent."""
        first = tallies[0]
        return first._with(
            {name: _concatenated(tallies, name, -1) for name in first.of_channels}
            | {
                "hits": sum(tally.hits for tally in tallies[1:]) + first.hits,
                "fates": sum(tally.fates for tally in tallies[1:]) + first.fates,
            }
        )

    @classmethod
    def of_orders(cls, tallies: Sequence[Tally]) -> Tally:
        """Tally of the same rays with patches and fates of several orders side by side.

        What passed without any event is direct light of those orders that hold it.
        """
        first = tallies[0]
        beside = ("fates", *first.of_patches)
        return first._with(
            {name: _concatenated(tallies, name, 1) for name in beside}
            | {
                "hits": _concatenated(tallies, "hits", 0),
                "direct": np.max([tally.direct for tally in tallies], axis=0),
            }
        )

    def apart(self) -> list[Tally]:
        """Tallies of the orders that are side by side in this one."""
        n = self.fates.shape[1] // len(Fate)
        axes = {"hits": 0, "fates": 1} | dict.fromkeys(self.of_patches, 1)
        split = {
            name: np.split(getattr(self, name), n, axis) for name, axis in axes.items()
        }
        parts = [{name: split[name][i] for name in split} for i in range(n)]
        for part in parts:
            part["direct"] = self.direct * (part["fates"][:, Fate.DIRECT, None] > 0)
        return [self._with(part) for part in parts]

    def first(self, channels: int) -> Tally:
        """Tally of the first `channels` channels."""
        return self.of_each_channel(lambda array: array[..., :channels])

    def spread(self, channels: int) -> Tally:
        """Tally with the one channel of an achromatic specimen repeated."""
        if self.channels == channels:
            return self
        if self.channels != 1:
            raise ValueError(
                f"a tally of {self.channels} channels cannot become one of {channels}"
            )
        return self.of_each_channel(lambda one: np.repeat(one, channels, axis=-1))

    def of_each_channel(self, change: Callable[[Numbers], Numbers]) -> Tally:
        """Tally with other channels: what `change` makes of each array's last axis."""
        return self._with(
            {name: change(getattr(self, name)) for name in self.of_channels}
        )

    def _with(self, changed: dict[str, Any]) -> Tally:
        """Tally of this kind with other arrays of some names."""
        return replace(self, **changed)

    def __repr__(self) -> str:
        hemispheres, *patches = self.hits.shape
        return (
            f"<{type(self).__name__}: {self.n_batches} batches, {hemispheres} "
            f"hemispheres of {' x '.join(map(str, patches))} patches, "
            f"{self.channels} channels, {self.ledger.emitted} rays>"
        )

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, Tally)
            and self.arrays == other.arrays
            and self.scale == other.scale
            and all(
                np.array_equal(getattr(self, name), getattr(other, name))
                for name in self.arrays
            )
        )


@dataclass(frozen=True, eq=False, repr=False)
class PolarisedTally(Tally):
    """Sums of a polarised variant: of Mueller matrices, the first element in `sums`.

    Attributes
    ----------
    elements : ndarray of float64
        The other elements, row by row, in the unit of the tally, of shape
        ``(n_batches, n_hemispheres, n_theta, n_phi, 15, channels)``: those of a ray
        times its incident power, positive or negative.
    """

    arrays: ClassVar[tuple[str, ...]] = (*Tally.arrays, "elements")
    of_channels: ClassVar[tuple[str, ...]] = (*Tally.of_channels, "elements")
    of_patches: ClassVar[tuple[str, ...]] = (*Tally.of_patches, "elements")

    elements: Floats = field(kw_only=True)

    def matrices(self, hemisphere: int) -> Floats:
        """Sums of all elements, ``(n_batches, n_theta, n_phi, channels, 4, 4)``."""
        first = self.sums[:, hemisphere, :, :, None, :].astype(float)
        return as_matrices(
            np.concatenate([first, self.elements[:, hemisphere]], axis=-2)
        )

    def added_up(self) -> Tally:
        """Of the first element alone."""
        arrays = {name: getattr(self, name) for name in Tally.arrays}
        return Tally(**arrays, scale=self.scale).added_up()

    def halves(self, sign: int = 1) -> Tally:
        """Tally of half the sum, or difference, of the first element and each of all.

        These are fluxes: of light of 16 times the channels, which run fastest.
        """
        unit = WEIGHT_SCALE / self.scale
        first = self.sums[..., None, :] * unit
        each = np.concatenate([first, self.elements * unit], axis=-2)
        flux = np.maximum(first + sign * each, 0) / 2
        incident, direct = (np.tile(x, 16) * unit for x in (self.incident, self.direct))
        return Tally(
            self.hits,
            flux.reshape(*self.sums.shape[:-1], -1),
            incident,
            self.fates,
            WEIGHT_SCALE,
            direct=direct,
        )


@dataclass(frozen=True, eq=False, repr=False)
class DifferentiatedTally(Tally):
    """Sums, and their derivatives by parameters: what rays gain, and what they lose.

    Attributes
    ----------
    changes : ndarray of float64
        Gains and losses by one number of a parameter after the other, none negative, in
        the unit of the tally, of shape
        ``(n_batches, n_hemispheres, n_theta, n_phi, 2 n, channels)``.
    """

    arrays: ClassVar[tuple[str, ...]] = (*Tally.arrays, "changes")
    of_channels: ClassVar[tuple[str, ...]] = (*Tally.of_channels, "changes")
    of_patches: ClassVar[tuple[str, ...]] = (*Tally.of_patches, "changes")

    changes: Floats = field(kw_only=True)

    def added_up(self) -> Tally:
        """Without derivatives."""
        arrays = {name: getattr(self, name) for name in Tally.arrays}
        return Tally(**arrays, scale=self.scale).added_up()

    def parts(self, columns: slice) -> Tally:
        """Tally of gains and losses as fluxes, channels first, of some columns."""
        flux = np.swapaxes(self.changes[..., columns, :], -1, -2)
        flux = flux.reshape(*self.sums.shape[:-1], -1)
        each = flux.shape[-1] // self.channels
        incident, direct = (
            np.repeat(x, each, axis=-1) for x in (self.incident, self.direct)
        )
        return Tally(
            self.hits, flux, incident, self.fates, self.scale, direct=0 * direct
        )


def as_matrices(elements: Floats) -> Floats:
    """Matrices ``(..., channels, 4, 4)`` of elements ``(..., 16, channels)``."""
    swapped = np.swapaxes(elements, -1, -2)
    return swapped.reshape(*swapped.shape[:-1], 4, 4)


def _concatenated(tallies: Sequence[Tally], name: str, axis: int) -> Numbers:
    """Arrays of that name, one after the other along an axis."""
    return np.concatenate([getattr(tally, name) for tally in tallies], axis=axis)


@dataclass(frozen=True, eq=False, repr=False)
class Integrals(Tally):
    """Integrals in the unit of a tally: their part is the same in each of its batches.

    Rays are for delta components only. Where there are none, there is one batch
    without a ray, whose incident flux is `scale`: the unit that the integrals are in.

    Attributes
    ----------
    errors : ndarray of float64, shape (n_hemispheres, n_theta, n_phi, channels)
        What the integrals in the sums of each batch may be wrong by, in their unit.
    """

    arrays: ClassVar[tuple[str, ...]] = (*Tally.arrays, "errors")
    of_channels: ClassVar[tuple[str, ...]] = (*Tally.of_channels, "errors")
    joinable: ClassVar[bool] = False

    errors: Floats = field(kw_only=True)

    @classmethod
    def beside(cls, sampled: Tally, flux: Floats, errors: Floats) -> Integrals:
        """Integrals, with what was sampled of delta components.

        Parameters
        ----------
        sampled : Tally
            Without batches if nothing was.
        flux, errors : ndarray, shape (n_hemispheres, n_theta, n_phi, channels)
            Flux fractions, and what they may be wrong by.
        """
        arrays = {name: getattr(sampled, name) for name in Tally.arrays}
        if not sampled.n_batches:
            arrays["sums"] = np.zeros((1, *sampled.sums.shape[1:]))
            arrays["incident"] = np.full((1, sampled.channels), float(sampled.scale))
            arrays["fates"] = np.zeros((1, len(Fate)), np.uint64)
            arrays["direct"] = np.zeros((1, sampled.channels))
        per_batch = arrays["incident"][:, None, None, None, :]
        arrays["sums"] = arrays["sums"] + flux * per_batch
        errors = errors * per_batch.max(axis=0)
        return cls(**arrays, scale=sampled.scale, errors=errors)


@dataclass(frozen=True, eq=False, repr=False)
class DifferentiatedIntegrals(Integrals):
    """Integrals of one batch, with their derivatives by parameters.

    Attributes
    ----------
    changes : ndarray of float64
        Derivatives of flux fractions by one number of a parameter after the other, each
        followed by what it may be wrong by, of the shape
        ``(1, n_hemispheres, n_theta, n_phi, 2 n, channels)``.
    """

    arrays: ClassVar[tuple[str, ...]] = (*Integrals.arrays, "changes")
    of_channels: ClassVar[tuple[str, ...]] = (*Integrals.of_channels, "changes")

    changes: Floats = field(kw_only=True)


def holds_integrals(tallies: Sequence[Tally]) -> bool:
    """Whether integrals stand for rays, but for those of delta components."""
    return any(isinstance(tally, Integrals) for tally in tallies)


def without_chance(tallies: Sequence[Tally]) -> bool:
    """Whether all values are integrals, beside which no ray was sent.

    Their standard errors are then the largest errors that they are estimated to have,
    and so are the limits of their intervals, at any level.
    """
    return holds_integrals(tallies) and not any(one.ledger.emitted for one in tallies)


def grouped(n: int) -> str:
    """Whole number with its digits in groups of three."""
    return f"{n:,}".replace(",", " ")


def sent_text(tallies: Sequence[Tally]) -> str:
    """How many rays were sent, or what stands for them: ``10 000 rays``."""
    rays = f"{grouped(sum(tally.ledger.emitted for tally in tallies))} rays"
    if not holds_integrals(tallies):
        return rays
    return "integrals" if rays == "0 rays" else f"integrals and {rays}"

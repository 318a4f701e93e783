"""Whether `sample` and `eval` of a phase function agree: rays ask the first alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np

from ..array_types import Floats, Integers
from ..errors import is_ctrl_c
from .scene_objects import class_of

__all__ = ["Answers", "answers", "defect"]

# Where light comes from, off all axes, and rays for each.
ASKED_FROM = ((0.3, -0.5, 0.8), (-0.6, 0.4, -0.7), (0.7, 0.6, 0.3), (-0.2, -0.9, -0.4))
N_ASKED = 2**16

# Probability that a right phase function is said to be wrong, over the random numbers
# that it is asked with. They are the same at each call.
FALSE_ALARM = 1e-6

# Rings about the direction of flight, each cut into four, whose light is compared; and
# that of the octants.
RINGS = np.radians([1, 3, 10, 30, 60, 90, 120, 150, 170, 177, 179])
N_RINGED = 4 * (len(RINGS) + 1)
N_CELLS = N_RINGED + 8

# What `eval` is integrated by: the sphere, with this share of the points, and lobes of
# Henyey and Greenstein about the direction of flight and back.
UNIFORM = 0.4
LOBES = np.array([sign * g for g in (0.8, 0.97, 0.996, 0.9995) for sign in (1, -1)])


@dataclass(frozen=True)
class Answers:
    """How a phase function scatters light from some directions, by either method.

    Attributes
    ----------
    along : ndarray, shape (directions, 3)
        Directions of flight.
    sampled, evaluated : ndarray, shape (directions, cells)
        Share of the light that is scattered into each cell of the sphere: by `sample`,
        and the integral of `eval`.
    tolerance : ndarray, shape (directions, cells)
        By how much they may differ by chance: everywhere, with a probability of at
        least ``1 - FALSE_ALARM``.
    nonsense : float
        Share of the directions for which `eval` is infinite, NaN or negative.
    """

    along: Floats
    sampled: Floats
    evaluated: Floats
    tolerance: Floats
    nonsense: float

    @property
    def misplaced(self) -> Floats:
        """Share of the light of each direction that the methods place in other rings.

        Noise alone makes it 0.01 to 0.02.
        """
        apart = np.abs(self.sampled - self.evaluated)[:, :N_RINGED]
        return apart.sum(axis=1) / 2

    @property
    def excess(self) -> float:
        """Largest difference, in units of its tolerance."""
        return float(np.max(np.abs(self.sampled - self.evaluated) / self.tolerance))


def answers(
    phase: mi.PhaseFunction,
    wavelengths: mi.Spectrum,
    low: Any = (0, 0, 0),
    high: Any = (1, 1, 1),
) -> Answers:
    """Ask a phase function where it scatters light, at points of a box.

    The tolerance is the bound of Maurer and Pontil (2009) for means of any bounded
    numbers; `eval` over the density of the points is taken to be bounded by the largest
    value that was met.

    Parameters
    ----------
    phase : mi.PhaseFunction
    wavelengths : mi.Spectrum or mi.Color0f
        Of the light, whose channels are averaged.
    low, high : sequence of 3 float
        Corners of the box.
    """
    rng = np.random.default_rng(0)
    wi = np.array(ASKED_FROM) / np.linalg.norm(ASKED_FROM, axis=1, keepdims=True)
    across = np.cross(wi, [1.0, 0.0, 0.0])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    frames = np.stack([across, np.cross(wi, across), -wi], axis=1)
    asked = np.repeat(np.arange(len(wi)), N_ASKED)
    u = rng.random((9, len(asked)), dtype=np.float32)
    local, density = _points(u[:3].astype(float))
    towards = np.einsum("in,nij->nj", local, frames[asked])

    mei = _interactions(wi[asked], wavelengths)
    corner, extent = np.array(low, float), np.subtract(high, low, dtype=float)
    mei.p = mi.Point3f(*(corner[:, None] + extent[:, None] * u[3:6]))
    ctx = mi.PhaseFunctionContext(None, mi.TransportMode.Importance)
    u1, u2 = mi.Float(u[6]), mi.Point2f(*u[7:])
    flights, weight, _ = phase.sample(ctx, mei, u1, u2, mi.Bool(True))
    value, _ = phase.eval_pdf(ctx, mei, mi.Vector3f(*towards.T), mi.Bool(True))

    power, ratio = _means(weight, asked), _means(value, asked) / density
    sane = (ratio >= 0) & (ratio < np.inf)
    ratio[~sane] = 0
    met, known = np.array(flights, float).T, asked * N_CELLS
    kinds = zip(_cells(met, frames[asked]), _cells(towards, frames[asked]))
    pairs = [(known + one, known + other) for one, other in kinds]
    sampled, evaluated, squares = (np.zeros(len(wi) * N_CELLS) for _ in range(3))
    for one, other in pairs:
        n, same = len(squares), one == other
        sampled += np.bincount(one, power, n)
        evaluated += np.bincount(other, ratio, n)
        squares += np.bincount(one, power**2, n) + np.bincount(other, ratio**2, n)
        squares -= 2 * np.bincount(one[same], (power * ratio)[same], n)
    sampled, evaluated, squares = (
        x.reshape(-1, N_CELLS) / N_ASKED for x in (sampled, evaluated, squares)
    )
    variance = np.maximum(squares - (sampled - evaluated) ** 2, 0)
    level = np.log(4 * variance.size / FALSE_ALARM)
    span = power.max() + ratio.max()
    tolerance = np.sqrt(2 * variance * level / N_ASKED)
    tolerance += 7 * span * level / (3 * (N_ASKED - 1))
    return Answers(-wi, sampled, evaluated, tolerance, float(1 - sane.mean()))


def defect(
    phase: mi.PhaseFunction, wavelengths: mi.Spectrum, low: Any, high: Any
) -> str | None:
    """Sentence on a phase function whose methods disagree; None if they agree.

    And for one in Python without `eval_pdf`, which no ray has a use for.
    """
    try:
        found = answers(phase, wavelengths, low, high)
    except Exception as error:
        # a plugin may raise anything; of `sample` the measurement will
        if is_ctrl_c(error):
            raise
        return None
    name = f"the phase function {class_of(phase)}"
    if found.nonsense:
        return (
            f"eval() of {name} is infinite, NaN or negative in {found.nonsense:.2g} of "
            "the directions near its peaks; what is measured is sample()"
        )
    if found.excess <= 1:
        return None
    worst = int(np.argmax(found.misplaced))
    flight = ", ".join(f"{x:.2f}" for x in found.along[worst])
    return (
        f"sample() and eval() of {name} disagree on {found.misplaced[worst]:.2f} of "
        f"the light that flies along ({flight}); what is measured is sample()"
    )


def _interactions(wi: Floats, wavelengths: mi.Spectrum) -> mi.MediumInteraction3f:
    """Interactions with a medium of light from `wi`."""
    mei = mi.MediumInteraction3f()
    mei.wi = mi.Vector3f(*wi.T)
    mei.sh_frame = mi.Frame3f(mei.wi)
    mei.wavelengths = wavelengths
    return mei


def _points(u: Floats) -> tuple[Floats, Floats]:
    """Directions about the flight, shape (3, n), and their density."""
    number = np.floor((u[0] - UNIFORM) / (1 - UNIFORM) * len(LOBES)).astype(int)
    g = LOBES[np.maximum(number, 0)]
    term = (1 - g**2) / (1 - g + 2 * g * u[1])
    # 1 - cos, without cancellation
    less = np.where(number < 0, 2 * u[1], (term - 1 + g) * (term + 1 - g) / (2 * g))
    less = np.clip(less, 0, 2)
    density = np.full(len(less), UNIFORM / (4 * np.pi))
    for g in LOBES:
        base = (1 - g) ** 2 + 2 * g * less
        lobe = (1 - g**2) / (4 * np.pi * base * np.sqrt(base))
        density += (1 - UNIFORM) / len(LOBES) * lobe
    sine, phi = np.sqrt(less * (2 - less)), 2 * np.pi * u[2]
    return np.array([sine * np.cos(phi), sine * np.sin(phi), 1 - less]), density


def _cells(directions: Floats, frames: Floats) -> tuple[Integers, Integers]:
    """Ring and quarter, and octant, that each direction is in."""
    x, y, z = np.einsum("nj,nij->in", directions, frames)
    ring = np.searchsorted(RINGS, np.arctan2(np.hypot(x, y), z))
    octant = (directions > 0) @ np.array([1, 2, 4])
    return 4 * ring + 2 * (x > 0) + (y > 0), N_RINGED + octant


def _means(spectrum: Any, like: Integers) -> Floats:
    """Mean over the channels, one for each point."""
    return np.mean([np.zeros(len(like)) + np.array(x) for x in spectrum], axis=0)

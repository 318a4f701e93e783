"""Under which circumstances a BSDF is examined, and how hard."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import mitsuba as mi
import numpy as np

from ..array_types import Floats
from ..collector import Borders
from ..collector.directions import direction
from ..errors import checked_choice

__all__ = ["EFFORTS", "PHI", "POSITION", "TURN", "Condition", "Effort", "LitFrom"]


@dataclass(frozen=True)
class Condition:
    """One incident direction, place, transport mode and choice of components.

    Attributes
    ----------
    theta_i, phi_i : float
        Incident direction in degrees, `theta_i` from the normal of the lit face.
    side : {"front", "back"}
        Lit face.
    uv : tuple of float
        Texture coordinates.
    mode : {"importance", "radiance"}
    component : int or None
        The only component that is enabled; None for all.
    turned : bool
        Whether the surface is turned and moved in the world, as by `TURN`: local
        answers do not change.
    """

    theta_i: float
    phi_i: float = 0.0
    side: str = "front"
    uv: tuple[float, float] = (0.5, 0.5)
    mode: str = "importance"
    component: int | None = None
    turned: bool = False

    @property
    def wi(self) -> Floats:
        """Unit vector to the source, shape (3,), in local coordinates."""
        face = 1 if self.side == "front" else -1
        wi = direction(np.radians(self.theta_i), np.radians(self.phi_i))
        return wi * [1, 1, face]

    @property
    def context(self) -> mi.BSDFContext:
        """Mitsuba's BSDF context."""
        mode = getattr(mi.TransportMode, self.mode.capitalize())
        ctx = mi.BSDFContext(mode)
        if self.component is not None:
            ctx.component = self.component
        return ctx

    def __str__(self) -> str:
        words = [f"theta_i {self.theta_i:g}, phi_i {self.phi_i:g}"]
        if self.side != "front":
            words.append(self.side)
        if self.component is not None:
            words.append(f"component {self.component}")
        if self.mode != "importance":
            words.append(f"{self.mode} mode")
        return ", ".join(words)


class LitFrom:
    """A condition lit from an arbitrary direction."""

    def __init__(self, condition: Condition, wi: Floats) -> None:
        self.wi, self._condition = wi / np.linalg.norm(wi), condition

    def __getattr__(self, name: str) -> Any:
        return getattr(self._condition, name)

    def __str__(self) -> str:
        return str(self._condition)


# Azimuths and places that no symmetry of a model distinguishes.
PHI = (25.0, 140.0, 260.0, 305.0, 0.0)
PLACES = ((0.35, 0.6), (0.15, 0.7), (0.85, 0.35))

# Axes of a turned surface, as columns, in world coordinates, and where it is.
TURN = np.array([[2.0, -2.0, 1.0], [1.0, 2.0, 2.0], [-2.0, -1.0, 2.0]]) / 3
POSITION = np.array([1.3, -0.7, 2.1])


@dataclass(frozen=True)
class Effort:
    """How many samples, patches and incident directions.

    Attributes
    ----------
    samples : int
        Of each map.
    checked : int
        Samples of each incident direction whose identities are checked.
    rings, sectors : int
        Patches of the maps: see :attr:`patches`.
    angles : tuple of float
        Polar angles of incidence, in degrees, of the checked samples.
    map_angles : tuple of float
        Those that get maps, of the front with all components.
    few_angles : tuple of float
        Those of the back, of single components, and of radiance mode.
    """

    samples: int
    checked: int
    rings: int
    sectors: int
    angles: tuple[float, ...]
    map_angles: tuple[float, ...]
    few_angles: tuple[float, ...]

    @property
    def patches(self) -> Borders:
        """Rings of equal projected solid angle, and thin ones at pole and horizon."""
        sines = np.sqrt(np.arange(self.rings + 1) / self.rings)
        theta = np.degrees(np.arcsin(sines))
        thin = np.array([1.0, 2.5, 5.0, 8.0])
        theta = np.sort(np.concatenate([theta, thin, 90 - thin]))
        # no slivers
        kept = np.concatenate([[True], np.diff(theta) > 0.2])
        edges = [*theta[kept][:-1], 90.0] if kept[-1] else [*theta[kept], 90.0]
        return Borders(tuple(edges), tuple(np.linspace(0, 360, self.sectors + 1)))

    @staticmethod
    def named(name: str) -> Effort:
        """Effort of a name; ValueError for any other."""
        return EFFORTS[checked_choice("effort", name, tuple(EFFORTS))]

    def checks(
        self, sides: Sequence[str], components: Sequence[int]
    ) -> Iterator[Condition]:
        """Conditions of the checked samples."""
        yield from self._spread(self.angles, sides)
        for component in components:
            few = self._spread(self.few_angles, sides)
            yield from (replace(one, component=component) for one in few)

    def maps(
        self, sides: Sequence[str], components: Sequence[int]
    ) -> Iterator[Condition]:
        """Conditions of the maps, in importance mode."""
        yield from self._spread(self.map_angles, sides[:1])
        yield from self._spread(self.few_angles, sides[1:])
        for component in components:
            few = self._spread(self.few_angles[:1], sides[:1])
            yield from (replace(one, component=component) for one in few)

    def radiance(self, sides: Sequence[str]) -> Iterator[Condition]:
        """Conditions to be examined in radiance mode."""
        return self._spread(self.few_angles[:1], sides)

    @staticmethod
    def _spread(angles: Sequence[float], sides: Sequence[str]) -> Iterator[Condition]:
        """Angles on both sides, each with an azimuth and a place; half are turned."""
        for side in sides:
            for i, theta_i in enumerate(angles):
                phi_i, uv = PHI[i % len(PHI)], PLACES[i % len(PLACES)]
                yield Condition(theta_i, phi_i, side, uv, turned=i % 2 == 1)


EFFORTS = {
    "quick": Effort(2**17, 2**14, 12, 16, (0, 40, 75, 89.9), (35,), (50,)),
    "normal": Effort(
        2**20,
        2**16,
        20,
        32,
        (0, 15, 30, 45, 60, 75, 85, 89, 89.9),
        (0, 30, 60, 80, 89),
        (20, 70),
    ),
    "thorough": Effort(
        2**23,
        2**18,
        30,
        60,
        (0, 0.5, 5, 15, 30, 45, 60, 70, 75, 80, 85, 87, 89, 89.5, 89.9),
        (0, 15, 30, 45, 60, 75, 85, 89, 89.9),
        (0, 20, 45, 70, 88),
    ),
}

"""Conditions under which a BSDF is examined, and the effort that is spent."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, lru_cache
from typing import Any

import mitsuba as mi
import numpy as np

from ..array_types import Flags, Floats, Integers
from ..collector import Borders
from ..collector.directions import direction
from ..errors import checked_choice

# Channels of a spectral variant, in nm; and the range of those of a sweep.
WAVELENGTHS_NM = (450.0, 520.0, 580.0, 650.0)
SWEPT_NM = (380.0, 780.0)


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
    types : int or None
        The only lobes that are enabled, as flags; None for all.
    turned : bool
        Whether the surface is turned and moved in the world, as by `TURN`: local
        answers do not change.
    nm : tuple of float
        Wavelengths of the channels of a spectral variant.
    differentials : bool
        Whether rays have differentials of their texture coordinates.
    lit : tuple of float or None
        Unit vector to the source, if it is not that of the angles.
    fields : tuple of str
        Of `FIELDS`, those of the surface interaction that are as in `surroundings`.
    spot : int
        Which of these.
    """

    theta_i: float
    phi_i: float = 0.0
    side: str = "front"
    uv: tuple[float, float] = (0.5, 0.5)
    mode: str = "importance"
    component: int | None = None
    types: int | None = None
    turned: bool = False
    nm: tuple[float, ...] = WAVELENGTHS_NM
    differentials: bool = False
    lit: tuple[float, ...] | None = None
    fields: tuple[str, ...] = ()
    spot: int = 0

    @cached_property
    def wi(self) -> Floats:
        """Unit vector to the source, shape (3,), in local coordinates."""
        if self.lit is not None:
            return np.array(self.lit)
        face = 1 if self.side == "front" else -1
        wi = direction(np.radians(self.theta_i), np.radians(self.phi_i))
        return wi * [1, 1, face]

    def lit_from(self, wi: Floats) -> Condition:
        """The same, lit from an arbitrary direction."""
        return replace(self, lit=tuple((wi / np.linalg.norm(wi)).tolist()))

    @property
    def uvs(self) -> Floats:
        """Texture coordinates, shape (2,)."""
        return np.array(self.uv)

    @property
    def wavelengths(self) -> Floats:
        """Wavelengths of the channels in nm, shape (channels,)."""
        return np.array(self.nm)

    @property
    def spots(self) -> Integers:
        """Which of the `surroundings` each sample has."""
        return np.array([self.spot])

    @property
    def context(self) -> mi.BSDFContext:
        """Mitsuba's BSDF context."""
        mode = getattr(mi.TransportMode, self.mode.capitalize())
        ctx = mi.BSDFContext(mode)
        if self.component is not None:
            ctx.component = self.component
        if self.types is not None:
            ctx.type_mask = self.types
        return ctx

    def place(self, wrong: Flags) -> str:  # noqa: ARG002
        """Text on where the samples are that are `wrong`."""
        return str(self)

    def middle(self, wrong: Flags) -> Condition:  # noqa: ARG002
        """Condition with one incident direction of the samples that are `wrong`."""
        return self

    def __str__(self) -> str:
        return f"theta_i {self.theta_i:g}, phi_i {self.phi_i:g}{self._more}"

    @property
    def _more(self) -> str:
        """All but the angles, as text."""
        words = (
            (self.side != "front", self.side),
            (self.component is not None, f"component {self.component}"),
            (self.mode != "importance", f"{self.mode} mode"),
            (self.differentials, "with differentials"),
            (self.nm != WAVELENGTHS_NM, f"{', '.join(f'{x:g}' for x in self.nm)} nm"),
            (self.fields, f"other si.{', si.'.join(self.fields)}"),
        )
        return "".join(f", {text}" for told, text in words if told)


@dataclass(frozen=True)
class Sweep(Condition):
    """A different incident direction for each of `n` samples, evenly over angles.

    Any sector or band of some degrees gets hundreds of them. `theta_i` is the angle of
    their mean cosine. If `both` faces are lit, they alternate; the `PLACES` do, too.
    Each has wavelengths of its own, evenly over `SWEPT_NM`.
    """

    theta_i: float = 50.5
    n: int = 0
    both: bool = False

    @property
    def angles(self) -> Floats:
        """Polar angle and azimuth of each direction in degrees, shape (2, n)."""
        return _swept(self.n, self.side, self.both)[0]

    @property
    def wi(self) -> Floats:
        """Unit vectors to the source, shape (n, 3), in local coordinates."""
        return _swept(self.n, self.side, self.both)[1]

    @cached_property
    def spots(self) -> Integers:
        """Which of the `surroundings` each sample has, shape (n,)."""
        return np.arange(self.n) % N_SPOTS

    @property
    def places(self) -> Integers:
        """Which of the `PLACES` each of them meets, or their number, shape (n,)."""
        odd, half = self.spots % 2, self.spots // 2
        return np.where(odd, len(PLACES), half % len(PLACES))

    @cached_property
    def uvs(self) -> Floats:
        """Texture coordinates of each, in [0, 1) if they are no field; shape (n, 2)."""
        uv = surroundings()["uv"][self.spots]
        return uv if "uv" in self.fields else uv - np.floor(uv)

    @cached_property
    def wavelengths(self) -> Floats:
        """Wavelengths of each in nm, shape (n, channels).

        Of matrices the same for all, since pairs beside samples have those.
        """
        if mi.is_polarized:
            return np.tile(self.nm, (self.n, 1))
        low, high = SWEPT_NM
        channels = np.arange(len(self.nm)) / len(self.nm)
        turns = (np.arange(self.n)[:, None] * 2**0.5 + channels) % 1
        return low + (high - low) * turns

    def place(self, wrong: Flags) -> str:
        """Range of the polar angles, of azimuths unless they go all around; a place.

        The latter if all are in one of them.
        """
        theta, phi = self.angles[:, wrong]
        if not theta.size:
            return str(self)
        text = f"theta_i {theta.min():.0f} to {theta.max():.0f}"
        phi = np.sort(phi)
        gaps = np.diff(phi, append=phi[0] + 360)
        widest = int(gaps.argmax())
        if gaps[widest] > MIN_GAP:
            first, last = phi[(widest + 1) % len(phi)], phi[widest]
            text += f", phi_i {first:.0f} to {last:.0f}"
        low, high = (f(self.uvs[wrong], axis=0) for f in (np.min, np.max))
        if (high - low).max() < MAX_PLACE:
            text += ", uv ({:.3g}, {:.3g})".format(*(low + high) / 2)
        return text + self._more

    def middle(self, wrong: Flags) -> Condition:
        """Condition whose polar angle is the median."""
        own = np.flatnonzero(wrong)
        k = own[np.argsort(self.angles[0, own])[len(own) // 2]] if own.size else 0
        theta, phi = (round(float(angle), 1) for angle in self.angles[:, k])
        side = "front" if self.wi[k, 2] > 0 else "back"
        more: dict[str, Any] = {"fields": self.fields, "spot": int(self.spots[k])}
        if mi.is_spectral:
            more["nm"] = tuple(self.wavelengths[k].round(1).tolist())
        u, v = self.uvs[k].tolist()
        return Condition(theta, phi, side, (u, v), self.mode, **more)

    def __str__(self) -> str:
        return f"all angles of incidence{self._more}"


@dataclass(frozen=True, eq=False)
class Given(Condition):
    """Incident directions and places that are given, one for each sample.

    Attributes
    ----------
    lit_by : ndarray, shape (n, 3)
        Unit vectors to the source.
    at : ndarray, shape (n, 2)
        Texture coordinates.
    """

    theta_i: float = 50.0
    lit_by: Any = None
    at: Any = None

    @property
    def wi(self) -> Floats:
        """Unit vectors to the source, shape (n, 3), in local coordinates."""
        return self.lit_by

    @property
    def uvs(self) -> Floats:
        """Texture coordinates of each, shape (n, 2)."""
        return self.at


@lru_cache(4)
def _swept(n: int, side: str, both: bool) -> tuple[Floats, Floats]:
    """Angles and directions of a sweep, the same for all fields."""
    i = np.arange(n)
    angles = np.array([(i + 0.5) / n * MAX_SWEPT, i * GOLDEN_ANGLE % 360])
    faces = np.full(n, 1 if side == "front" else -1)
    faces[1::2] *= -1 if both else 1
    wi = direction(*np.radians(angles))
    wi[:, 2] *= faces
    angles.flags.writeable = wi.flags.writeable = False  # all sweeps share them
    return angles, wi


def sides_of(bsdf: mi.BSDF) -> tuple[str, ...]:
    """Sides that the flags of a BSDF declare, the front first."""
    flags, both = int(bsdf.flags()), int(mi.BSDFFlags.Transmission)
    faces = {"front": mi.BSDFFlags.FrontSide, "back": mi.BSDFFlags.BackSide}
    found = (side for side, own in faces.items() if flags & (int(own) | both))
    return tuple(found) or ("front",)


# Of a sweep: its largest polar angle and the step of its azimuths in degrees, and the
# gap of azimuths beyond which those of a finding are told.
MAX_SWEPT = 89.5
GOLDEN_ANGLE = 180 * (3 - 5**0.5)
MIN_GAP = 45

# Range of texture coordinates that are one place.
MAX_PLACE = 0.15

# Azimuths and places that no symmetry of a model distinguishes.
PHI = (25.0, 140.0, 260.0, 305.0, 0.0)
PLACES = ((0.35, 0.6), (0.15, 0.7), (0.85, 0.35))

# Axes of a turned surface, as columns, in world coordinates, and where it is.
TURN = np.array([[2.0, -2.0, 1.0], [1.0, 2.0, 2.0], [-2.0, -1.0, 2.0]]) / 3
POSITION = np.array([1.3, -0.7, 2.1])


# Fields of a surface interaction that may be others for each sample, and how many.
FIELDS = ("time", "t", "p", "n", "sh_frame", "dp_du", "prim_index", "uv")
N_SPOTS = 1021


@cache
def surroundings() -> dict[str, Floats]:
    """Fields of surface interactions, rows of `N_SPOTS`; vectors in the local frame.

    Times are up to 4, distances and every third place up to 1e4. Normals are up to 30
    degrees off the local one, frames turned, tangents .5 to 6 long, sheared and
    half of them mirrored. Every other uv is one of `PLACES`; the others are in [-2, 3],
    in steps that single precision knows, some on seams.
    """
    rng, n = np.random.default_rng(0), N_SPOTS

    def turned(theta: Floats) -> Floats:
        return direction(theta, rng.uniform(0, 2 * np.pi, n))

    uv = rng.integers(-2 * 2**10, 3 * 2**10, (n, 2), endpoint=True) / 2**10
    uv[rng.random((n, 2)) < 0.1] //= 1
    uv[::2] = np.resize(PLACES, (len(uv[::2]), 2))
    q, _ = np.linalg.qr(rng.normal(size=(n, 3, 3)))
    q[:, :, 2] = np.cross(q[:, :, 0], q[:, :, 1])
    u = rng.uniform(0, 2 * np.pi, n)
    v = u + rng.choice([-1, 1], n) * np.radians(rng.uniform(50, 130, n))
    u, v = (rng.uniform(0.5, 6, (n, 1)) * direction(np.pi / 2, x) for x in (u, v))
    return {
        "time": 4 * rng.random(n),
        "t": 10 ** rng.uniform(-1, 4, n),
        "p": rng.uniform(-10, 10, (n, 3))
        * np.where(np.arange(n) % 3, 1, 1000)[:, None],
        "n": turned(np.radians(rng.uniform(0, 30, n))),
        "s": q[:, :, 0],
        "sh_frame": q[:, :, 2],
        "dp_du": u,
        "dp_dv": v,
        "prim_index": rng.integers(0, 1000, n) % 2,  # of a table of two faces at least
        "uv": uv,
    }


@dataclass(frozen=True)
class Effort:
    """How many samples, patches and incident directions.

    Attributes
    ----------
    samples : int
        Of each map.
    checked : int
        Samples of each incident direction whose identities are checked.
    swept : int
        Of a sweep over all incident directions.
    grid : (int, int)
        Rings and sectors of the maps: see :attr:`patches`.
    angles : tuple of float
        Polar angles of incidence, in degrees, of the checked samples.
    map_angles : tuple of float
        Those that get maps, of the front with all components.
    few_angles : tuple of float
        Those of the back, of single components, and of radiance mode.
    threads : int, optional
        Of Dr.Jit in the command ``gonio-mi validate``. Default: all. Those that few
        samples leave idle spin for 20 ms after each kernel: half of the CPU time of
        `quick`. Verdicts are the same for any number.
    """

    samples: int
    checked: int
    swept: int
    grid: tuple[int, int]
    angles: tuple[float, ...]
    map_angles: tuple[float, ...]
    few_angles: tuple[float, ...]
    threads: int | None = None

    @property
    def lanes(self) -> int:
        """Samples `checked`; a 16th of Mueller matrices, which have 16 elements."""
        return self.checked // (16 if mi.is_polarized else 1)

    @property
    def patches(self) -> Borders:
        """Rings of equal projected solid angle, and thin ones at pole and horizon."""
        rings, sectors = self.grid
        theta = np.degrees(np.arcsin(np.sqrt(np.arange(rings + 1) / rings)))
        thin = np.array([1.0, 2.5, 5.0, 8.0])
        theta = np.sort(np.concatenate([theta, thin, 90 - thin]))
        edges = theta[np.diff(theta, prepend=-1.0) > 0.2]  # no slivers
        return Borders(tuple(edges), tuple(np.linspace(0, 360, sectors + 1)))

    @staticmethod
    def named(name: str) -> Effort:
        """Effort of that name; raises ValueError for an unknown one."""
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

    def between(self, sides: Sequence[str]) -> Iterator[Condition]:
        """Conditions of maps halfway between those of the front, 0 and 90 degrees."""
        edges = np.unique([0, *self.map_angles, 90])
        return self._spread(tuple((edges[1:] + edges[:-1]) / 2), sides)

    def radiance(self, sides: Sequence[str]) -> Iterator[Condition]:
        """Conditions to be examined in radiance mode."""
        return self._spread(self.few_angles[:1], sides)

    @staticmethod
    def _spread(angles: Sequence[float], sides: Sequence[str]) -> Iterator[Condition]:
        """Conditions of angles on some sides, of varied azimuth, place and rotation."""
        for side in sides:
            for i, theta_i in enumerate(angles):
                phi_i, uv = PHI[i % len(PHI)], PLACES[i % len(PLACES)]
                yield Condition(theta_i, phi_i, side, uv, turned=i % 2 == 1)


EFFORTS = {
    "quick": Effort(
        samples=2**17,
        checked=2**14,
        swept=2**15,
        grid=(12, 16),
        angles=(0, 40, 75, 89.9),
        map_angles=(35,),
        few_angles=(50,),
        threads=1,
    ),
    "normal": Effort(
        samples=2**20,
        checked=2**16,
        swept=2**18,
        grid=(20, 32),
        angles=(0, 30, 60, 80, 85, 89, 89.9),
        map_angles=(0, 30, 60, 80, 89),
        few_angles=(20, 70),
        threads=2,
    ),
    "thorough": Effort(
        samples=2**23,
        checked=2**18,
        swept=2**20,
        grid=(30, 60),
        angles=(0, 0.5, 5, 15, 30, 45, 60, 70, 75, 80, 85, 87, 89, 89.5, 89.9),
        map_angles=(0, 15, 30, 45, 60, 75, 85, 89, 89.9),
        few_angles=(0, 20, 45, 70, 88),
    ),
}

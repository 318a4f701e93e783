"""Scatter data on grids about the normal or the specular direction.

Instruments and lighting programs keep it so: for each incident direction values at
polar angles and azimuths about an axis, from which they interpolate.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ...array_types import Floats
from ...collector import EqualAngle
from ...collector.directions import angles, direction
from ...collector.hemisphere import Subdivision
from ...errors import SettingError
from ...files.checks import require
from ...results.patch_means import PatchMeans
from ...results.record import Record, fractions_of

# Points per side of a patch that is averaged over.
POINTS = 6

# Polar angles below the horizon by no more than this, in degrees, are on it.
HORIZON_TOLERANCE = 1e-6

# Polar angles and azimuths about the specular direction, where lobes are narrow.
RADIAL = np.array(
    [0, 0.1, 0.25, *np.arange(0.5, 10, 0.5), *range(10, 60), *range(60, 180, 3)]
)
AROUND = np.arange(0.0, 361.0, 10.0)

# Points per side of what a value of a grid stands for.
NODE_POINTS = 3

# A direction below the horizon stands for the one at this angle above, in degrees.
MIN_ELEVATION = 0.1

# Rings and sectors of patches, as fine as such data usually are.
PATCHES = 60, 72


@dataclass(frozen=True, eq=False)
class Block:
    """Values for one incident direction and hemisphere.

    Directions are an angle from an axis and an azimuth about it, in degrees.
    The axis is the normal, and azimuths count from the mirror direction; or the axis is
    the specular direction, and azimuths count from the side of the normal. Both turn
    counter-clockwise seen against the axis. Transmission is stored as reflection, by
    mirroring at the plane of the specimen: the axis is the direction straight on.

    Parameters
    ----------
    theta_i, phi_i : float
        Incident direction in degrees; `Scatter` takes none of 90, where no light comes.
    hemisphere : {0, 1}
        Reflection or transmission.
    polar, azimuth : ndarray, shapes (n_polar,), (n_azimuth,)
        Ascending, in degrees. Azimuths span 360 or less, and are closed to a full turn;
        those of a half turn from 0 to 180 are mirrored at the plane of incidence.
    values : ndarray, shape (n_polar, n_azimuth, channels)
        BRDF or BTDF in 1/sr.
    specular : bool
        Whether the axis is the specular direction.
    total : ndarray, shape (channels,), optional
        Reflectance or transmittance that the file states.
    """

    theta_i: float
    phi_i: float
    hemisphere: int
    polar: Floats
    azimuth: Floats
    values: Floats
    specular: bool = False
    total: Floats | None = None

    def __post_init__(self) -> None:
        for name, low, high in (("polar", 0, 180), ("azimuth", -360, 720)):
            angles = getattr(self, name)
            good = len(angles) > 0 and bool((angles[1:] > angles[:-1]).all())
            require(
                good and low <= angles[0] and angles[-1] <= high,  # and so finite
                f"its {name} angles must ascend within [{low}, {high}] degrees",
            )
        turn = np.ptp(self.azimuth)
        require(turn <= 360 * (1 + 1e-9), "its azimuths exceed a full turn")
        reason = "a block of its values has another shape than its angles"
        require(self.values.shape[:2] == (len(self.polar), len(self.azimuth)), reason)
        require(bool(np.isfinite(self.values).all()), "a value is not finite")
        require(float(np.abs(self.values).max()) < 1e30, "a value is absurdly large")
        require(0 <= self.theta_i <= 90, f"its angle of incidence is {self.theta_i:g}")

    @property
    def holds_one_side(self) -> bool:
        """Whether there are values on one side of the plane of incidence only."""
        return self.azimuth[0] == 0 and self.azimuth[-1] == 180

    def channel(self, number: int) -> "Block":
        """The same of one channel."""
        one = slice(number, number + 1)
        total = None if self.total is None else self.total[one]
        return replace(self, values=self.values[..., one], total=total)

    @cached_property
    def _frame(self) -> Floats:
        """Rows: azimuth 0, azimuth 90, axis."""
        forward = np.radians(self.phi_i + 180)
        x = np.array([np.cos(forward), np.sin(forward), 0.0])
        z = np.array([0.0, 0.0, 1.0])
        y = np.cross(z, x)
        if not self.specular:
            return np.stack([x, y, z])
        theta_i = np.radians(self.theta_i)
        sine, cosine = np.sin(theta_i), np.cos(theta_i)
        return np.stack([sine * z - cosine * x, -y, sine * x + cosine * z])

    def at(self, wo: Floats) -> Floats:
        """Values in directions, bilinear; beyond the last polar angle that of it.

        Parameters
        ----------
        wo : ndarray, shape (..., 3)
            Unit vectors; the sign of z does not count.

        Returns
        -------
        ndarray, shape (..., channels)
        """
        local = np.concatenate([wo[..., :2], np.abs(wo[..., 2:])], -1) @ self._frame.T
        sine = np.hypot(local[..., 0], local[..., 1])
        polar = np.degrees(np.arctan2(sine, local[..., 2]))
        azimuth = np.degrees(np.arctan2(local[..., 1], local[..., 0]))
        if self.holds_one_side:
            azimuth = np.abs(azimuth)
        angles, values = self.azimuth, self.values
        if not self.holds_one_side and np.ptp(angles) < 360 * (1 - 1e-9):
            # the first is repeated after a full turn
            angles = np.append(angles, angles[0] + 360)
            values = np.concatenate([values, values[:, :1]], axis=1)
        azimuth = angles[0] + np.mod(azimuth - angles[0], 360)
        row, up = _between(self.polar, polar)
        column, along = _between(angles, azimuth)
        up, along = up[..., None], along[..., None]
        next_row = np.minimum(row + 1, len(self.polar) - 1)
        next_column = np.minimum(column + 1, len(angles) - 1)
        low = values[row, column] * (1 - along) + values[row, next_column] * along
        high = values[next_row, column] * (1 - along)
        high = high + values[next_row, next_column] * along
        return low * (1 - up) + high * up

    def directions(
        self, polar: Floats | None = None, azimuth: Floats | None = None
    ) -> Floats:
        """Unit vectors of the grid or another one, shape ``(n_polar, n_azimuth, 3)``.

        With z > 0 above the horizon, also for transmission.
        """
        polar = self.polar if polar is None else polar
        azimuth = self.azimuth if azimuth is None else azimuth
        polar, around = np.meshgrid(polar, azimuth, indexing="ij")
        return direction(np.radians(polar), np.radians(around)) @ self._frame

    def nodes(self) -> tuple[Floats, Floats, Floats]:
        """Directions of the values, each once, above the horizon.

        Returns
        -------
        theta, phi : ndarray, shape (n,)
            From the normal, on the lit side, and absolute azimuth, in degrees.
        values : ndarray, shape (n, channels)
        """
        azimuth, values = self.azimuth, self.values
        if len(azimuth) > 1 and np.ptp(azimuth) >= 360 * (1 - 1e-9):
            azimuth, values = azimuth[:-1], values[:, :-1]
        polar, around = np.meshgrid(self.polar, azimuth, indexing="ij")
        once = (polar > 0) | (around == azimuth[0])
        wo = direction(np.radians(polar[once]), np.radians(around[once])) @ self._frame
        theta, phi = np.degrees(angles(wo))
        if not self.specular:  # as they are written, to the bit
            theta, phi = polar[once], around[once] + self.phi_i + 180
        above = theta < 90 - HORIZON_TOLERANCE
        return theta[above], np.mod(phi[above], 360), values[once][above]


@dataclass(frozen=True, eq=False)
class Scatter:
    """Blocks of all incident directions and hemispheres of a file.

    Attributes
    ----------
    blocks : list of Block
        Sorted by hemisphere and incident direction.
    channels : tuple of str
    header : dict of str
        What else the file says.
    notes : tuple of str
        Sentences on how it was read.
    """

    blocks: Sequence[Block]
    channels: tuple[str, ...]
    header: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        require(len(self.blocks) > 0, "it has no values")
        reason = "it has an incidence of 90 degrees, where no light comes"
        require(all(block.theta_i < 90 for block in self.blocks), reason)
        keys = [(b.hemisphere, b.phi_i, b.theta_i) for b in self.blocks]
        require(len(set(keys)) == len(keys), "it has an incident direction twice")
        # an azimuth of 360 is that of 0 again
        once: dict[tuple[int, float, float], Block] = {}
        unlike = 0
        for block in sorted(self.blocks, key=lambda b: abs(b.phi_i)):
            key = block.hemisphere, block.phi_i % 360, block.theta_i
            first = once.setdefault(key, block)
            unlike += not np.array_equal(first.values, block.values)
        if len(once) < len(keys):
            note = f"{len(keys) - len(once)} incidences are there a full turn on again"
            if unlike:
                note += f", {unlike} of them with other values: the first ones count"
            object.__setattr__(self, "notes", (*self.notes, note))
        kept = [b for b in self.blocks if any(b is one for one in once.values())]
        blocks = [replace(b, phi_i=b.phi_i % 360) for b in kept]
        object.__setattr__(self, "blocks", blocks)

    def of(self, hemisphere: int) -> list[Block]:
        """Blocks of reflection or transmission."""
        return [block for block in self.blocks if block.hemisphere == hemisphere]

    def points(self, quantity: str) -> "Points":
        """Values at the nodes: brdf or btdf."""
        angles, values = [], []
        hemisphere = int(quantity == "btdf")
        for block in self.of(hemisphere):
            theta, phi, of_block = block.nodes()
            theta = 180 - theta if hemisphere else theta
            incident = np.full((2, len(theta)), [[block.theta_i], [block.phi_i]])
            angles.append(np.stack([*incident, theta, phi]))
            values.append(of_block)
        of_all = np.concatenate(angles, axis=1).T, np.concatenate(values)
        notes = *self.notes, *self._totals(hemisphere)
        return Points(*of_all, self.channels, self.header, notes)

    def _totals(self, hemisphere: int) -> list[str]:
        """Sentence on the totals that the file states beside those of its values."""
        ratios: list[float] = []
        for block in self.of(hemisphere):
            if block.total is not None:
                lit = block.total > 0
                ratios += (total_of(block)[lit] / block.total[lit]).tolist()
        if not ratios:
            return []
        low, high = min(ratios), max(ratios)
        return [f"the values integrate to {low:.4g} to {high:.4g} of the stated totals"]


@dataclass(frozen=True, eq=False)
class Points:
    """Values at pairs of directions.

    Attributes
    ----------
    angles : ndarray, shape (n, 4)
        theta_i, phi_i, theta_o, phi_o in degrees, as `MeasuredTable` has them.
    values : ndarray, shape (n, channels)
        BRDF or BTDF in 1/sr.
    channels : tuple of str
    header : dict of str
    notes : tuple of str
    partial : bool
        Whether NaN marks directions without a value of that channel.
    """

    angles: Floats
    values: Floats
    channels: tuple[str, ...]
    header: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    partial: bool = False


def total_of(block: Block, n: int = 200) -> Floats:
    """Reflectance or transmittance of a block by a midpoint rule, one per channel."""
    step = (np.arange(n) + 0.5) / n
    sine2, phi = np.meshgrid(step, step * 2 * np.pi, indexing="ij")
    wo = direction(np.arcsin(np.sqrt(sine2)), phi)
    return np.pi * block.at(wo).reshape(n * n, -1).mean(axis=0)


def scatter_means(scatter: Scatter, patches: Subdivision | None = None) -> PatchMeans:
    """Scatter data as means over patches, by default a few degrees wide.

    Parameters
    ----------
    scatter : Scatter
        Transmission for the incident directions of reflection, if it has both.
    patches : Subdivision, optional

    Raises
    ------
    FileFormatError
        If the two have different incident directions.
    """
    patches = patches or EqualAngle(*PATCHES)
    held = [h for h in (0, 1) if scatter.of(h)]
    by_angles = {(b.hemisphere, b.theta_i, b.phi_i): b for b in scatter.blocks}
    incident = sorted({key[1:] for key in by_angles}, key=lambda pair: pair[::-1])
    reason = "it tells reflection and transmission for different incident directions"
    require(len(by_angles) == len(held) * len(incident), reason)
    shape = len(incident), max(held) + 1, *patches.shape, len(scatter.channels)
    means, points = np.zeros(shape), patches.points(POINTS)
    for (hemisphere, *pair), block in by_angles.items():
        values = np.maximum(block.at(points).mean(axis=1), 0)
        here = incident.index((pair[0], pair[1])), hemisphere
        means[here] = values.reshape(shape[2:])
    theta_i, phi_i = np.array(incident).T
    return PatchMeans.of(means, patches, (theta_i, phi_i), scatter.channels)


def fractions_of_scatter(scatter: Scatter, record: Record) -> Floats:
    """Flux fractions in the patches and for the incident directions of a record."""
    if len(set(record.phi_i.tolist())) == 1:  # which no file of one azimuth tells
        phi_i = float(record.phi_i[0])
        turned = [replace(block, phi_i=phi_i) for block in scatter.blocks]
        scatter = Scatter(turned, scatter.channels)
    means = scatter_means(scatter, record.subdivision)
    wanted = direction(np.radians(record.theta_i), np.radians(record.phi_i))
    held = direction(np.radians(means.theta_i), np.radians(means.phi_i))
    nearest = np.argmax(wanted @ held.T, axis=1)
    # at normal incidence azimuths are told apart by nothing but themselves
    turn = np.mod(means.phi_i[None] - record.phi_i[:, None] + 180, 360) - 180
    normal = np.abs(record.theta_i) < MIN_ELEVATION
    distance = np.where(means.theta_i[None] < MIN_ELEVATION, np.abs(turn), np.inf)
    return means.flux_fraction[np.where(normal, distance.argmin(axis=1), nearest)]


# ---------------------------------------------------------------------- of a record


def scatter_of(record: Record, specular: bool) -> Scatter:
    """Means of a record around the points of grids, with the light of its maps.

    Parameters
    ----------
    record : Record
    specular : bool
        Whether the grids are about the specular direction.

    Raises
    ------
    ValueError
        If it has apertures, and so no whole hemisphere.
    """
    if record.subdivision.axes is not None:
        raise SettingError(
            "a collector of apertures measures some directions only: the file needs "
            "a whole hemisphere, or write a .csv"
        )
    blocks = []
    fractions = fractions_of(record)
    projected = record.subdivision.projected_solid_angles[..., None]
    n_patches = record.subdivision.n_patches
    for index, hemisphere in np.ndindex(fractions.shape[:2]):
        fraction = fractions[index, hemisphere]
        polar, azimuth = (RADIAL, AROUND) if specular else _grid(record)
        empty = np.zeros((len(polar), len(azimuth), 1))
        theta_i = float(np.clip(record.theta_i[index], 0, None))
        phi_i = float(record.phi_i[index]) % 360
        frame = Block(theta_i, phi_i, hemisphere, polar, azimuth, empty, specular)
        # noise may make a sum negative: it counts as no light
        means = (np.maximum(fraction, 0) / projected).reshape(n_patches, -1)
        block = replace(frame, values=_around_nodes(record, frame, means))
        total, wanted = total_of(block), np.maximum(fraction.sum(axis=(0, 1)), 0)
        factor = np.where(total > 0, wanted / np.where(total > 0, total, 1), 1.0)
        blocks.append(replace(block, values=block.values * factor, total=wanted))
    return Scatter(blocks, record.channels)


def _grid(record: Record) -> tuple[Floats, Floats]:
    """Polar angles and azimuths about the normal, some for each patch."""
    n_theta, n_phi = record.subdivision.shape
    step = 90 / np.clip(3 * n_theta, 18, 90).astype(int)
    turn = 360 / np.clip(4 * n_phi, 36, 180).astype(int)
    return np.arange(0, 90 + step / 2, step), np.arange(0, 360 + turn / 2, turn)


def _around_nodes(record: Record, frame: Block, means: Floats) -> Floats:
    """Means of patch means around the points of a grid, ``(n, m, channels)``."""
    low, high = _cells(frame.polar), _cells(frame.azimuth, periodic=True)
    steps = (np.arange(NODE_POINTS) + 0.5) / NODE_POINTS
    sums = np.zeros((len(frame.polar), len(frame.azimuth), means.shape[-1]))
    for along, around in np.ndindex(NODE_POINTS, NODE_POINTS):
        polar = low[0] + (low[1] - low[0]) * steps[along]
        azimuth = high[0] + (high[1] - high[0]) * steps[around]
        wo = frame.directions(polar, azimuth)
        wo[..., 2] = np.maximum(wo[..., 2], np.sin(np.radians(MIN_ELEVATION)))
        wo /= np.linalg.norm(wo, axis=-1, keepdims=True)
        sums += means[record.subdivision.patch(wo)]
    return sums / NODE_POINTS**2


def _cells(angles: Floats, periodic: bool = False) -> tuple[Floats, Floats]:
    """Where what an angle stands for begins and ends: half-way to its neighbours."""
    middles = (angles[1:] + angles[:-1]) / 2
    low, high = angles[0], angles[-1]
    if periodic:
        low, high = low - (angles[1] - low) / 2, high + (high - angles[-2]) / 2
    return np.append(low, middles), np.append(middles, high)


def _between(edges: Floats, x: Floats) -> tuple[np.ndarray, Floats]:
    """Index of the edge before each x, and the part of the way to the next."""
    if len(edges) == 1:
        return np.zeros(np.shape(x), int), np.zeros(np.shape(x))
    index = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
    way = (x - edges[index]) / (edges[index + 1] - edges[index])
    return index, np.clip(way, 0.0, 1.0)

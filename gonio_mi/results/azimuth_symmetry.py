"""Specimens that look the same when turned about their normal, or mirrored.

And the incident directions of their records that copy others, whose noise they share.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..array_types import Flags, Numbers
from .record import Record
from .tally import Tally

# Along which axis the arrays of a tally have their sectors.
SECTOR_AXES = {"hits": 2, "sums": 3, "errors": 2}


def azimuth_of(sector: float, n_sectors: int) -> float:
    """Azimuth in degrees, the same number for whatever is rounded to one sector."""
    return (round(sector, 9) * 360 / n_sectors) % 360


@dataclass(frozen=True)
class Motion:
    """A turn about the normal by whole sectors, or a mirror that maps them on sectors.

    Attributes
    ----------
    by : int
        Sectors to turn by; of a mirror the edge to which that at azimuth 0 goes, so
        that the mirror stands at half of it.
    mirrored : bool
    n_sectors : int
        Of the whole azimuth, all of one width.
    """

    by: int
    mirrored: bool
    n_sectors: int

    def edge(self, sector: float) -> float:
        """To where an azimuth goes, both in sectors."""
        return (self.by + (-sector if self.mirrored else sector)) % self.n_sectors

    def moved(self, values: Numbers, axis: int) -> Numbers:
        """Array whose sectors, along an axis, are where they go."""
        own = np.flip(values, axis) if self.mirrored else values
        return np.roll(own, self.by, axis)

    def azimuth(self, phi_i: float) -> float:
        """To where an azimuth in degrees goes."""
        return azimuth_of(self.edge(phi_i * self.n_sectors / 360), self.n_sectors)

    def copy(self, record: Record) -> Record:
        """What one incident direction's record is if light comes from its image."""
        (tally,) = record.tallies
        return replace(
            record,
            theta_i=record.theta_i.copy(),
            phi_i=np.array([self.azimuth(float(record.phi_i[0]))]),
            tallies=(self.moved_tally(tally),),
        )

    def moved_tally(self, tally: Tally) -> Tally:
        """Tally whose sectors are where they go."""
        names = [name for name in tally.arrays if name in SECTOR_AXES]
        moved: dict[str, Any] = {
            name: self.moved(getattr(tally, name), SECTOR_AXES[name]) for name in names
        }
        return replace(tally, **moved)


@dataclass(frozen=True)
class AzimuthSymmetry:
    """Turns, and mirrors, after which a specimen is what it was.

    Attributes
    ----------
    n_sectors : int
        Of the whole azimuth.
    turns : int
        Equal parts of a whole turn, by each of which it may be turned; they divide the
        sectors.
    mirror : int, optional
        Twice the azimuth of a mirror plane in sectors. There is another one half a
        part further, and so on.
    """

    n_sectors: int
    turns: int = 1
    mirror: int | None = None

    @property
    def motions(self) -> list[Motion]:
        """All of them, that which moves nothing first."""
        part = self.n_sectors // self.turns
        found = [Motion(n * part, False, self.n_sectors) for n in range(self.turns)]
        if self.mirror is not None:
            found += [
                Motion((self.mirror + one.by) % self.n_sectors, True, self.n_sectors)
                for one in found
            ]
        return found

    @property
    def generators(self) -> list[Motion]:
        """At most one turn and one mirror, of which all others are made."""
        motions = self.motions
        turn = motions[1 : self.turns][:1]
        return turn + motions[self.turns :][:1]

    @property
    def domain(self) -> tuple[int, int]:
        """Azimuths in sectors of which all others are images.

        The last one is the first one's image, unless there are mirrors at both.
        """
        part = self.n_sectors // self.turns
        if self.mirror is None:
            return 0, part
        return -(-self.mirror // 2), (self.mirror + part) // 2

    def spread(self, n_azimuths: int) -> list[float]:
        """Sectors that cut the domain as `n_azimuths` cut the whole; with both ends."""
        first, last = self.domain
        parts = math.ceil(n_azimuths * (last - first) / self.n_sectors)
        steps = first + np.arange(parts + 1) * ((last - first) / parts)
        return sorted({float(sector) for sector in np.round(steps)})

    def home(self, sector: float) -> float:
        """Image of an azimuth that is in the domain, or next to it between mirrors."""
        low, high = self.domain
        half = self.n_sectors / 2

        def off(image: float) -> float:
            return abs((image - (low + high) / 2 + half) % self.n_sectors - half)

        return min((one.edge(sector) for one in self.motions), key=off)

    def whole(
        self,
        known: Mapping[tuple[float, float], Record],
        incidents: Iterable[tuple[float, float]],
    ) -> list[Record]:
        """Records of directions and of all their images, measured or copied.

        Parameters
        ----------
        known : mapping
            What was measured by polar angle and azimuth in degrees.
        incidents : iterable of (float, float)
            Some of these; along the normal there is one image.
        """
        return [
            known.get(image) or motion.copy(known[source])
            for image, (source, motion) in self.sources(known, incidents).items()
        ]

    def sources(
        self,
        known: Mapping[tuple[float, float], Record],
        incidents: Iterable[tuple[float, float]],
    ) -> dict[tuple[float, float], tuple[tuple[float, float], Motion]]:
        """Of all directions of :meth:`whole`, which is moved to there, and how."""
        still = self.motions[0]
        found = {}
        for theta, phi in incidents:
            for motion in self.motions if theta else [still]:
                image = (theta, motion.azimuth(phi)) if theta else (theta, phi)
                if image not in found:
                    own = image in known
                    found[image] = (image, still) if own else ((theta, phi), motion)
        return dict(sorted(found.items()))

    @property
    def mirror_azimuth(self) -> float | None:
        """Azimuth of a mirror plane in degrees."""
        return None if self.mirror is None else self.mirror * 180 / self.n_sectors


# ---------------------------------------------------------------- directions of records


def without_copies(record: Record) -> Record:
    """The record of what was measured; as it is if nothing in it was."""
    campaign = record.provenance.campaign
    own = np.flatnonzero(~_copied(record))
    if campaign is None or len(own) in (0, len(record)):
        return record
    measured = Record.stack(record[number] for number in own.tolist())
    return measured.with_provenance(campaign=replace(campaign, copies=()))


def sources(record: Record) -> list[tuple[int, Motion]]:
    """Of each incident direction the number of that which it copies, and how.

    What was measured, and what is no exact copy, is its own.
    """
    n = record.subdivision.shape[1]
    found = [(number, Motion(0, False, n)) for number in range(len(record))]
    symmetry = symmetry_of(record)
    if symmetry is None:
        return found
    motions, copied = symmetry.motions, _copied(record)
    of_ring = defaultdict(list)
    for number in np.flatnonzero(~copied).tolist():
        of_ring[float(record.theta_i[number])].append(number)
    for number in np.flatnonzero(copied).tolist():
        phi = float(record.phi_i[number])
        for source in of_ring[float(record.theta_i[number])]:
            for motion in motions:
                if motion.azimuth(float(record.phi_i[source])) == phi and (
                    motion.moved_tally(record.tallies[source]) == record.tallies[number]
                ):
                    found[number] = source, motion
    return found


def sharing(record: Record) -> list[int]:
    """Number of directions that share each record's noise, itself included."""
    symmetry = symmetry_of(record)
    if symmetry is None:
        return [1] * len(record)
    shared = np.isin(record.theta_i, record.theta_i[_copied(record)])
    return np.where(shared, len(symmetry.motions), 1).tolist()


def symmetry_of(record: Record) -> AzimuthSymmetry | None:
    """The symmetry by which a campaign copied directions; None if it copied none."""
    campaign, n = record.provenance.campaign, record.subdivision.shape[1]
    if campaign is None or not campaign.copies:
        return None
    mirror = campaign.mirror
    mirror = None if mirror is None else round(mirror * n / 180)
    return AzimuthSymmetry(n, campaign.turns, mirror)


def _copied(record: Record) -> Flags:
    """Which incident directions are copies, shape ``(N,)``."""
    campaign = record.provenance.campaign
    copies = set() if campaign is None else set(campaign.copies)
    directions = zip(record.theta_i.tolist(), record.phi_i.tolist())
    return np.array([one in copies for one in directions])

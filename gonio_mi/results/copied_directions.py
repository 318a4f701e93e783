"""Incident directions of a record that copy others, whose noise they share."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..array_types import Flags
from .azimuth_symmetry import AzimuthSymmetry, Motion
from .record import Record

__all__ = ["sharing", "sources", "symmetry_of", "without_copies"]


def without_copies(record: Record) -> Record:
    """The record of what was measured; as it is if nothing in it was."""
    own = np.flatnonzero(~_copied(record))
    if len(own) in (0, len(record)):
        return record
    campaign = record.provenance.campaign or {}
    symmetry = _symmetry(record) | {"copies": []}
    measured = Record.stack(record[number] for number in own.tolist())
    return measured.with_provenance(campaign={**campaign, "symmetry": symmetry})


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
    """Of each incident direction how many may have one noise, itself included."""
    symmetry, theta_i = _symmetry(record), record.theta_i
    if not symmetry.get("copies"):
        return [1] * len(record)
    images = int(symmetry["turns"]) * (1 if symmetry["mirror"] is None else 2)
    shared = np.isin(theta_i, theta_i[_copied(record)])
    return np.where(shared, images, 1).tolist()


def _copied(record: Record) -> Flags:
    """Which incident directions are copies, shape ``(N,)``."""
    copies = {tuple(one) for one in _symmetry(record).get("copies", ())}
    directions = zip(record.theta_i.tolist(), record.phi_i.tolist())
    return np.array([one in copies for one in directions])


def symmetry_of(record: Record) -> AzimuthSymmetry | None:
    """The symmetry by which a campaign copied directions; None if it copied none."""
    said, n = _symmetry(record), record.subdivision.shape[1]
    if not said.get("copies"):
        return None
    mirror = said.get("mirror")
    mirror = None if mirror is None else round(mirror * n / 180)
    return AzimuthSymmetry(n, int(said.get("turns", 1)), mirror)


def _symmetry(record: Record) -> dict[str, Any]:
    """What a campaign says of the specimen's symmetry; nothing in other records."""
    campaign: Mapping[str, Any] = record.provenance.campaign or {}
    return dict(campaign.get("symmetry") or {})

"""Incident directions of a record that copy others, whose noise they share."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..array_types import Flags
from .record import Record

__all__ = ["sharing", "without_copies"]


def without_copies(record: Record) -> Record:
    """The record of what was measured; as it is if nothing in it was."""
    own = np.flatnonzero(~_copied(record))
    if len(own) in (0, len(record)):
        return record
    campaign = record.settings["campaign"]
    symmetry = _symmetry(record) | {"copies": []}
    measured = Record.stack(record[number] for number in own.tolist())
    return measured.with_settings(campaign={**campaign, "symmetry": symmetry})


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


def _symmetry(record: Record) -> dict[str, Any]:
    """What a campaign says of the specimen's symmetry; nothing in other records."""
    campaign: Mapping[str, Any] = record.settings.get("campaign") or {}
    return dict(campaign.get("symmetry") or {})

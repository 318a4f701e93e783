"""Settings of records that are put together: what must agree, and what becomes of them.

Records of the same rays' conditions are merged; those of one specimen that are lit from
several directions are stacked.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from ..errors import SettingError, shown
from .processors import joined_processors

__all__ = [
    "DIGESTS",
    "MERGED",
    "STACKED",
    "check_alike",
    "merged",
    "seeds_of",
    "stacked",
]

Settings = Mapping[str, Any]

# Settings that tell a specimen and its emitter from others; old records lack them.
DIGESTS = ("digest", "emitter_digest", "plugin_digest")

# Settings that tell the largest number of a stack: what `rel_err` has reached.
OF_THE_WORST = {"reached", "n_lobe"}

# In what records may differ and still be stacked or merged. An emitter that was moved,
# not turned, has another digest.
STACKED = {"created", "processors", "batches", "emitter_digest", "task"} | OF_THE_WORST
MERGED = {"rays", "batches", "seed", "created", "versions", "specimen"}
MERGED |= {"interrupted", "task", "processors"}


def check_alike(a: Settings, b: Settings, free: Collection[str], purpose: str) -> None:
    """Raise ValueError unless all settings agree, but for those that are `free`."""
    for key in sorted((a.keys() | b.keys()) - set(free)):
        if key in DIGESTS and not (key in a and key in b):
            continue
        if key == "surface" and a.get("digest") and b.get("digest"):
            continue  # the digest knows; older records have the text cut short
        if a.get(key) != b.get(key):
            raise SettingError(
                f"records must agree in {key} to be {purpose}, got "
                f"{shown(a.get(key))} and {shown(b.get(key))}"
            )


def stacked(parts: Sequence[Settings]) -> dict[str, Any]:
    """Settings of a stack of records whose settings are `parts`."""
    settings = {key: value for key, value in parts[0].items() if key != "task"}
    settings |= joined_processors(*parts)
    for key in OF_THE_WORST & settings.keys():
        settings[key] = max(part[key] for part in parts)
    return settings


def merged(a: Settings, b: Settings) -> dict[str, Any]:
    """Settings of a record of the rays of two, or ValueError if both had one seed."""
    seeds = [*seeds_of(a), *seeds_of(b)]
    if len(set(seeds)) < len(seeds):
        raise SettingError(
            f"records must have different seeds to be merged, got {seeds}"
        )
    settings = dict(a, seed=seeds) | joined_processors(a, b)
    settings.pop("task", None)
    for key in ("rays", "batches"):
        settings[key] = a[key] + b[key]
    return settings


def seeds_of(settings: Settings) -> list[Any]:
    """Seeds of a record: several of one that was merged."""
    seed = settings.get("seed")
    return seed if isinstance(seed, list) else [seed]

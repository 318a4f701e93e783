"""What tells whether two measurements have the same random rays."""

from collections.abc import Mapping
from typing import Any

from .joined_settings import seeds_of

__all__ = ["ray_keys", "shared_seeds"]


def ray_keys(settings: Mapping[str, Any]) -> dict[str, str]:
    """Texts by which a table names the rays of a record: `seed` and `sampler`.

    A merged record has several seeds, with commas in between. Empty if no seed is
    known, or if nothing was random (the estimator quadrature).
    """
    if settings.get("estimator") == "quadrature" or settings.get("seed") is None:
        return {}
    keys = {"seed": ", ".join(map(str, seeds_of(settings)))}
    if settings.get("sampler") is not None:
        keys["sampler"] = str(settings["sampler"])
    return keys


def shared_seeds(one: Mapping[str, str], other: Mapping[str, str]) -> str:
    """Seeds that both have, of their :func:`ray_keys`, as text; empty if none.

    Different samplers make other rays of the same seed.
    """
    samplers = {keys["sampler"] for keys in (one, other) if "sampler" in keys}
    if len(samplers) > 1:
        return ""
    mine, theirs = (
        [seed.strip() for seed in keys.get("seed", "").split(",")]
        for keys in (one, other)
    )
    return ", ".join(seed for seed in mine if seed and seed in theirs)

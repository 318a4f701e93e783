"""Files of surfaces that are specimens by themselves, and what they are made of."""

from __future__ import annotations

import os
from typing import Any

__all__ = ["MIRROR", "surface_specimen"]

# What a map of heights is made of, unless it is said: every facet reflects all light,
# so that the record tells the shape alone.
MIRROR = {"type": "conductor"}


def surface_specimen(
    path: str | os.PathLike[str],
    bsdf: dict[str, Any] | None = None,
    period: Any = None,
    **settings: Any,
) -> dict[str, Any]:
    """Mitsuba dictionary of the plugin `heightfield` for a file of heights.

    Parameters
    ----------
    path : str or path
    bsdf : dict, optional
        What the surface is made of. Default: a mirror.
    period : {"box", "none"} or (float, float), optional
        As of :func:`gonio_mi.measure`. Without one the surface is finite, whatever its
        file says; in a cell its last row and column are joined to the first, so that
        there is no step.
    settings : optional
        Properties of the plugin; None for its default.
    """
    given = {name: value for name, value in settings.items() if value is not None}
    finite = period is None or (isinstance(period, str) and period == "none")
    shape = {
        "type": "heightfield",
        "filename": os.fspath(path),
        "periodic": not finite,
        "bsdf": MIRROR if bsdf is None else bsdf,
    }
    return shape | given

"""Files of surfaces that are specimens by themselves, and what they are made of."""

from __future__ import annotations

import os
from typing import Any

__all__ = ["MIRROR", "surface_specimen"]

# What a map of heights is made of, unless it is said: every facet reflects all light,
# so that the record tells the shape alone.
MIRROR = {"type": "conductor"}


def surface_specimen(
    path: str | os.PathLike[str], bsdf: dict[str, Any] | None = None, **settings: Any
) -> dict[str, Any]:
    """Mitsuba dictionary of the plugin `heightfield` for a file of heights.

    Parameters
    ----------
    path : str or path
    bsdf : dict, optional
        What the surface is made of. Default: a mirror.
    settings : optional
        Properties of the plugin; None for its default.
    """
    given = {name: value for name, value in settings.items() if value is not None}
    filename = {"type": "heightfield", "filename": os.fspath(path)}
    return filename | given | {"bsdf": MIRROR if bsdf is None else bsdf}

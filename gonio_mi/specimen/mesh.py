"""Meshes of other programs as specimens: what they are made of, and how they lie."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from ..array_types import Floats
from ..errors import (
    SettingError,
    SpecimenError,
    checked_choice,
    checked_number,
    no_file,
    number_of,
    shown,
    warn,
)
from ..surfaces.meshes import MESHES, NORMALS, is_mesh
from ..variants import check_variant, is_parallel
from .loading import loaded
from .shapes import bounds

# A mesh that is so many times thinner along another axis than z may stand upright, and
# be seen edge-on.
MIN_UPRIGHT_RATIO = 1.25


def mesh(
    path: str | os.PathLike[str],
    bsdf: Mapping[str, Any] | None,
    *,
    normal: str | None = None,
    mean_plane: float | None = None,
) -> dict[str, Any]:
    """Specimen from a mesh of another program, for :func:`gonio_mi.measure`.

    Lengths stay those of the file. Facets are flat, and a BSDF that knows one side only
    covers both. The middle of the mesh is put above the origin.

    Parameters
    ----------
    path : str or path
        Ends in ``.obj``, ``.ply`` or ``.stl``.
    bsdf : dict
        What it is made of, as Mitsuba loads it.
    normal : {"z", "-z", "y", "-y", "x", "-x"}, optional
        Axis of the file that becomes +z, the specimen's normal: of a blind that hangs
        upright the horizontal one from it into the room. Its z, or with ``"z"`` and
        ``"-z"`` its y, becomes +y, which is up. Default: z, with a warning if the mesh
        is thinner along another axis by a fourth.
    mean_plane : float, optional
        Where on that axis the mean surface is, which is put at z = 0. Default: the
        middle of the mesh.

    Returns
    -------
    dict
        A Mitsuba scene.

    Raises
    ------
    TypeError, ValueError
        If an argument is none of these.
    SpecimenError
        If the file or the BSDF cannot be loaded.
    """
    check_variant(is_parallel)
    path = Path(path)
    if normal is not None:
        checked_choice("normal", normal, tuple(NORMALS))
    if not is_mesh(path):
        raise SettingError(
            f"path must end in {', '.join(MESHES)}, got {shown(str(path))}"
        )
    if not path.is_file():
        raise SpecimenError(no_file(path))
    if not isinstance(bsdf, Mapping):
        raise SettingError(
            f"bsdf must say what the mesh {path.name} is made of, such as "
            f"diffuse:reflectance=0.7, got {shown(bsdf)}"
        )
    material = loaded("the BSDF of the mesh", mi.load_dict, dict(bsdf))
    if not isinstance(material, mi.BSDF):
        raise SettingError(f"bsdf must be a BSDF, got {bsdf.get('type')!r:.60}")
    flags = material.flags()
    one_sided = not mi.has_flag(flags, mi.BSDFFlags.BackSide)
    if one_sided and not mi.has_flag(flags, mi.BSDFFlags.Transmission):
        bsdf = {"type": "twosided", "bsdf": dict(bsdf)}
    kind = MESHES[path.suffix.lower()]
    shape: dict[str, Any] = {"type": kind, "filename": str(path)}
    shape |= {} if kind == "stl" else {"face_normals": True}
    lying = loaded(f"the mesh {path}", mi.load_dict, dict(shape))
    corners = np.array(bounds([lying]))
    if not (lying.face_count() and np.isfinite(corners).all()):
        raise SpecimenError(
            f"the mesh {path.name} must have triangles and finite vertices, got "
            f"{number_of(lying.face_count(), 'triangle')}"
        )
    if normal is None:
        _warn_if_upright(path.name, corners[1] - corners[0])
    rotation = np.array(NORMALS[normal or "z"], dtype=float)
    shape["to_world"] = _lying(corners, rotation, mean_plane)
    return {"type": "scene", "mesh": shape | {"bsdf": dict(bsdf)}}


def _warn_if_upright(name: str, extents: Floats) -> None:
    """Warn if z, which nobody said is the normal, is none by the mesh's extents."""
    thin = int(extents.argmin())
    if extents[2] > MIN_UPRIGHT_RATIO * extents[thin]:
        warn(
            f"{name} extends {extents[2]:.3g} along z, its normal by default, but only "
            f"{extents[thin]:.3g} along {'xyz'[thin]}, as if it stood upright: name "
            f"its normal, such as --normal {'xyz'[thin]}, or --normal z"
        )


def _lying(corners: Floats, rotation: Floats, mean_plane: float | None) -> Any:
    """Transform of the file's coordinates to the specimen's."""
    middle = rotation @ corners.mean(axis=0)
    if mean_plane is not None:
        condition = "a finite number"
        middle[2] = checked_number("mean_plane", mean_plane, -np.inf, np.inf, condition)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, -middle
    return mi.ScalarTransform4f(matrix)

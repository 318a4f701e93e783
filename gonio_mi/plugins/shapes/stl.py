"""Shape `stl`: a mesh from an STL file, which Mitsuba does not read."""

from __future__ import annotations

from pathlib import Path

import mitsuba as mi
import numpy as np

from gonio_mi.mitsuba_compat import mesh_of
from gonio_mi.surfaces.meshes import read_stl


def stl(props: mi.Properties) -> mi.Mesh:
    r"""Triangles of an STL file (:monosp:`stl`).

    Binary or text; their own flat facets, in the order of the file. The property
    `to_world` and the nested BSDF are those of Mitsuba's own meshes.

    .. pluginparameters::

     * - filename
       - |string|
       - The file.

    .. tabs::
        .. code-tab:: xml

            <shape type="stl">
                <string name="filename" value="slat.stl"/>
                <bsdf type="twosided"><bsdf type="diffuse"/></bsdf>
            </shape>

        .. code-tab:: python

            'type': 'stl',
            'filename': 'slat.stl',
            'bsdf': {'type': 'twosided', 'bsdf': {'type': 'diffuse'}}
    """
    path = Path(str(mi.file_resolver().resolve(props["filename"])))
    triangles = read_stl(path)
    to_world = np.array(props.get("to_world", mi.ScalarTransform4f()).matrix, float)
    points = triangles.reshape(-1, 3) @ to_world[:3, :3].T + to_world[:3, 3]
    props["face_normals"] = True
    faces = np.arange(len(points), dtype=np.uint32).reshape(-1, 3)
    return mesh_of(props, f"stl {path.name}", points.astype(np.float32), faces)


PLUGIN = stl

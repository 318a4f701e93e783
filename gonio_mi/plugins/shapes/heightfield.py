"""Shape `heightfield`: a mesh of heights, from a file, an array or statistics."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio_mi import properties
from gonio_mi.array_types import Floats
from gonio_mi.errors import SpecimenError
from gonio_mi.memory import check_memory
from gonio_mi.surfaces.heights import (
    CORRELATIONS,
    LARGEST,
    MESH_BYTES,
    checked_heights,
    gaussian_heights,
    height_statistics,
)

POSITIVE = f"a positive number from {1 / LARGEST:g} to {LARGEST:g}"
GENERATED = (
    *("resolution", "alpha", "alpha_u", "alpha_v", "correlation"),
    *("correlation_length", "shortest", "seed"),
)


def heightfield(props: mi.Properties) -> mi.Mesh:
    r"""Height field (:monosp:`heightfield`).

    A triangle mesh over a rectangle about the origin, `size` long in x and as long in y
    as its square cells make it. The heights are those of an array, of a file, or of a
    Gaussian random surface, whose facets then are distributed as Beckmann has it. The
    shape's name tells the statistics that were asked for and those that it has.

    .. pluginparameters::

     * - filename
       - |string|
       - Image (its first channel) or ``.npy`` file with the heights; its first row is
         the smallest y.

     * - heights
       - |tensor| or |bitmap|
       - The heights themselves, for Python.

     * - scale
       - |float|
       - Factor on heights from file or array. (Default: 1)

     * - periodic
       - |bool|
       - Close the period: the last row and column of a file or an array are joined to
         the first, which are repeated at the far edges. (Default: true)

     * - size
       - |float|
       - Extent in x. (Default: 2)

     * - resolution
       - |int|
       - Of a random surface: grid points in x, and in y. (Default: 256)

     * - alpha, or alpha_u and alpha_v
       - |float|
       - Of a random surface: roughness of the facets, sqrt(2) times their rms slope,
         along x and y. (Default: 0.2)

     * - correlation
       - |string|
       - Of a random surface: ``gaussian`` or ``exponential``. (Default: ``gaussian``)

     * - correlation_length
       - |float|
       - Of a random surface: where the autocorrelation is 1/e; where alpha_u and
         alpha_v differ, the geometric mean over x and y. (Default: `size` / 32, or four
         grid spacings if that is more)

     * - shortest
       - |float|
       - Of a random surface: its shortest wavelength. (Default: what the grid holds)

     * - seed
       - |int|
       - Of a random surface: another one for each seed. (Default: 0)

     * - face_normals
       - |bool|
       - Flat facets. Otherwise normals are interpolated between those of the grid
         points, and light is weighted with the shading-normal correction. (Default:
         true)

     * - to_world
       - |transform|
       - Object to world. (Default: none)

     * - (Nested plugin)
       - :paramtype:`bsdf`
       - What the facets are made of.

    .. tabs::
        .. code-tab:: xml

            <shape type="heightfield">
                <float name="alpha" value="0.3"/>
                <bsdf type="twosided"><bsdf type="conductor"/></bsdf>
            </shape>

        .. code-tab:: python

            'type': 'heightfield',
            'alpha': 0.3,
            'bsdf': {'type': 'twosided', 'bsdf': {'type': 'conductor'}}
    """
    size = _positive(props, "size", 2.0)
    name, heights, closed = _heights(props, size)
    if "face_normals" not in props:
        props["face_normals"] = True
    smooth = not props["face_normals"]
    n_y, n_x = heights.shape
    spacing = size / (n_x if closed else n_x - 1)
    what = f"the mesh of a height field of {n_x} x {n_y} points"
    check_memory(what, heights.size * MESH_BYTES, "lower its resolution")
    name += f"; has {height_statistics(heights, spacing, closed)}"
    normals: Any = _normals(heights, spacing, closed) if smooth else None
    if closed:
        heights = np.pad(heights, ((0, 1), (0, 1)), mode="wrap")
        if smooth:
            normals = np.pad(normals, ((0, 1), (0, 1), (0, 0)), mode="wrap")
    return _mesh(props, name, heights, spacing, normals)


def _heights(props: mi.Properties, size: float) -> tuple[str, Floats, bool]:
    """Name, heights, and whether the last row is next to the first."""
    sources = [source for source in ("filename", "heights") if source in props]
    if sources:
        given = [key for key in GENERATED if key in props]
        if len(sources) + len(given) > 1:
            raise SpecimenError(
                "heightfield must have heights from one source, filename, heights or "
                f"statistics, got {', '.join(sources + given)}"
            )
        closed = bool(props.get("periodic", True))
        condition = f"a number from -{LARGEST:g} to {LARGEST:g}"
        scale = properties.number(props, "scale", 1.0, -LARGEST, LARGEST, condition)
        if sources == ["filename"]:
            path = Path(str(mi.file_resolver().resolve(props["filename"])))
            return f"heightfield {path.name}", _read(path) * scale, closed
        return "heightfield", _array(props["heights"]) * scale, closed
    resolution = properties.count(props, "resolution", 256, minimum=4)
    alpha = _positive(props, "alpha", 0.2)
    length = size * max(1 / 32, 4 / resolution)
    asked: dict[str, Any] = {
        "alpha_u": _positive(props, "alpha_u", alpha),
        "alpha_v": _positive(props, "alpha_v", alpha),
        "correlation_length": _positive(props, "correlation_length", length),
        "correlation": properties.choice(
            props, "correlation", "gaussian", CORRELATIONS
        ),
        "shortest": properties.number(
            props, "shortest", 0.0, 0, np.inf, "a number of 0 or more"
        ),
        "seed": properties.count(props, "seed", 0, minimum=0),
    }
    heights = gaussian_heights((resolution, resolution), size / resolution, **asked)
    words = ", ".join(f"{key} {value}" for key, value in asked.items())
    return f"heightfield of {resolution} x {resolution}, asked {words}", heights, True


def _positive(props: mi.Properties, name: str, default: float) -> float:
    return properties.number(props, name, default, 1 / LARGEST, LARGEST, POSITIVE)


def _read(path: Path) -> Floats:
    """Heights from an image or a NumPy file."""
    if not path.is_file():
        raise SpecimenError(
            f"heightfield.filename must be an existing file, got {path}"
        )
    try:
        if path.suffix == ".npy":
            array = np.load(path, mmap_mode="r", allow_pickle=False)
        else:
            array = np.array(mi.Bitmap(str(path)))
    except (RuntimeError, ValueError, EOFError) as error:
        raise SpecimenError(
            f"heightfield.filename must be an image or a .npy file, got {path}: {error}"
        ) from None
    return _array(array)


def _array(array: ArrayLike) -> Floats:
    array = np.array(array)
    # of an image, the first channel
    return checked_heights(array[..., 0] if array.ndim == 3 else array)


def _normals(heights: Floats, spacing: float, closed: bool) -> Floats:
    """Unit normals at the grid points, from central differences."""
    if closed:
        padded = np.pad(heights, 1, mode="wrap")
        slopes: Any = np.gradient(padded, spacing)
        slope_v, slope_u = (s[1:-1, 1:-1] for s in slopes)
    else:
        slope_v, slope_u = np.gradient(heights, spacing)
    normals = np.stack([-slope_u, -slope_v, np.ones_like(heights)], axis=-1)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def _mesh(
    props: mi.Properties,
    name: str,
    heights: Floats,
    spacing: float,
    normals: Floats | None,
) -> mi.Mesh:
    """Mesh of two triangles for each cell of the grid."""
    n_y, n_x = heights.shape
    faces = _faces(n_x, n_y)
    mesh = mi.Mesh(
        name,
        heights.size,
        len(faces),
        props=props,
        has_vertex_normals=normals is not None,
        has_vertex_texcoords=True,
    )
    to_world = np.array(props.get("to_world", mi.ScalarTransform4f()).matrix, float)
    # opposite edges at opposite numbers, so that both are exact
    x = (np.arange(n_x) - (n_x - 1) / 2) * spacing
    y = (np.arange(n_y) - (n_y - 1) / 2) * spacing
    points = np.stack([*np.meshgrid(x, y), heights], axis=-1).reshape(-1, 3)
    points = points @ to_world[:3, :3].T + to_world[:3, 3]
    u, v = np.linspace(0, 1, n_x), np.linspace(0, 1, n_y)
    texcoords = np.stack(np.meshgrid(u, v), axis=-1)
    parameters = mi.traverse(mesh)
    parameters["faces"] = mi.UInt32(faces.ravel())
    parameters["vertex_positions"] = mi.Float(points.astype(np.float32).ravel())
    parameters["vertex_texcoords"] = mi.Float(texcoords.astype(np.float32).ravel())
    if normals is not None:
        turned = normals.reshape(-1, 3) @ np.linalg.inv(to_world[:3, :3])
        turned /= np.linalg.norm(turned, axis=1, keepdims=True)
        parameters["vertex_normals"] = mi.Float(turned.astype(np.float32).ravel())
    parameters.update()
    dr.eval()
    return mesh


def _faces(n_x: int, n_y: int) -> NDArray[np.uint32]:
    """Vertex indices of the triangles, counter-clockwise seen from +z."""
    index = np.arange(n_x * n_y, dtype=np.uint32).reshape(n_y, n_x)
    a, b = index[:-1, :-1], index[:-1, 1:]
    c, d = index[1:, :-1], index[1:, 1:]
    return np.stack([a, b, d, a, d, c], axis=-1).reshape(-1, 3)


mi.register_shape("heightfield", heightfield)

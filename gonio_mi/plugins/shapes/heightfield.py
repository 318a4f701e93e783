"""Shape `heightfield`: a mesh of heights, from a file, an array or statistics."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from gonio_mi.array_types import Floats
from gonio_mi.errors import (
    SpecimenError,
    check_memory,
    checked_choice,
    checked_count,
    checked_number,
    warn,
)
from gonio_mi.mitsuba_compat import mesh_of
from gonio_mi.plugins.properties import given
from gonio_mi.surfaces.height_maps import HeightMap, read_height_map
from gonio_mi.surfaces.heights import (
    CORRELATIONS,
    FILLS,
    FORMS,
    MAX_LENGTH,
    MESH_BYTES,
    gaussian_heights,
)
from gonio_mi.surfaces.images import image_heights
from gonio_mi.surfaces.topography import Preparation, Topography, topography

POSITIVE = f"a positive number from {1 / MAX_LENGTH:g} to {MAX_LENGTH:g}"
GENERATED = (
    *("resolution", "alpha", "alpha_u", "alpha_v", "correlation"),
    *("correlation_length", "shortest", "seed"),
)

# Rows of a mesh that are made at once.
ROWS = 64


def heightfield(props: mi.Properties) -> mi.Mesh:
    r"""Height field (:monosp:`heightfield`).

    A triangle mesh over a rectangle about the origin, `size` long in x and as long in y
    as its cells make it, which are square unless a file says otherwise. The heights are
    those of an array, of a file, or of a Gaussian random surface, whose facets then are
    distributed as Beckmann has it. The shape's name tells the statistics that were
    asked for and those that it has.

    Files of profilometers and AFMs (x3p, sur, plu, MetroPro, Wyko OPD, gwy, ...) are
    read by the library SurfaceTopography (``pip install ".[surfaces]"``); their
    own unit is that of the scene. What makes a measurement doubtful is warned of: a
    width that nobody told, absurdly steep or flat facets, heights in steps that are
    coarse for their slopes, and, where the unit is known, heights and facets that are
    small against visible light.

    .. pluginparameters::

     * - filename
       - |string|
       - File of an instrument, image (its first channel) or ``.npy`` file with the
         heights; its first row is the smallest y.

     * - heights
       - |tensor| or |bitmap|
       - The heights themselves, for Python.

     * - scale
       - |float|
       - Factor on heights from file or array; of an image of whole numbers, the height
         of a step of 1. (Default: 1; for such images none)

     * - range
       - |float|
       - Of an image of whole numbers, instead: the height from black to white, which is
         65535 for 16 bits. (Default: none)

     * - unit
       - |string|
       - Unit of size and heights where the file does not state it: ``m``, ``mm``,
         ``um``, ``nm``, ... It scales nothing. (Default: not known)

     * - form
       - |string|
       - What is taken from heights of a file or an array: ``keep`` for nothing,
         ``mean``, ``plane`` (the tilt), ``quadratic`` or ``cubic``, polynomials of
         least squares. (Default: ``keep``)

     * - fill
       - |string|
       - What stands for points that were not measured: ``none`` refuses them,
         ``nearest`` takes the nearest measured one, ``linear`` planes through three of
         those around. (Default: ``none``)

     * - periodic
       - |bool|
       - Close the period: the last row and column of a file or an array are joined to
         the first, which are repeated at the far edges. (Default: what the file of an
         instrument says, for others true)

     * - size
       - |float|
       - Extent in x: of n points in a row n cells where it is periodic, else n - 1.
         (Default: what the file of an instrument says, for others 2, with a warning
         that tells the slopes)

     * - size_y
       - |float|
       - Extent in y. (Default: what the cells make it)

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
       - What the facets are made of. (Default: ``diffuse``, as of every shape of
         Mitsuba's; a file that is itself the specimen, as in ``gonio-mi measure
         scan.x3p``, is measured as a mirror)

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
    name, ready = _topography(props)
    for concern in ready.concerns():
        warn(concern)
    if "face_normals" not in props:
        props["face_normals"] = True
    smooth = not props["face_normals"]
    heights, closed = ready.heights, ready.periodic
    n_y, n_x = heights.shape
    what = f"the mesh of a height field of {n_x} x {n_y} points"
    check_memory(what, heights.size * MESH_BYTES, "lower its resolution")
    name += f"; has {ready.described}"
    normals: Any = _normals(heights, ready.spacing, closed) if smooth else None
    if closed:
        heights = np.pad(heights, ((0, 1), (0, 1)), mode="wrap")
        if smooth:
            normals = np.pad(normals, ((0, 1), (0, 1), (0, 0)), mode="wrap")
    return _mesh(props, name, heights, ready.spacing, normals)


def _topography(props: mi.Properties) -> tuple[str, Topography]:
    """Name and heights of the surface that the properties ask for."""
    sources = [source for source in ("filename", "heights") if source in props]
    if not sources:
        return _random(props)
    statistics = [key for key in GENERATED if key in props]
    if len(sources) + len(statistics) > 1:
        raise SpecimenError(
            "heightfield must have heights from one source, filename, heights or "
            f"statistics, got {', '.join(sources + statistics)}"
        )
    if sources == ["filename"]:
        path = Path(str(mi.file_resolver().resolve(props["filename"])))
        source = read_height_map(path, image_heights)
    else:
        array = np.array(props["heights"])
        source = HeightMap(array[..., 0] if array.ndim == 3 else array, "heights")
    signed = f"a number from -{MAX_LENGTH:g} to {MAX_LENGTH:g}"
    wanted = Preparation(
        size=_positive(props, "size") if "size" in props else None,
        size_y=_positive(props, "size_y") if "size_y" in props else None,
        scale=checked_number(
            *given(props, "scale", 1.0), -MAX_LENGTH, MAX_LENGTH, signed
        )
        if "scale" in props
        else None,
        height_range=_positive(props, "range") if "range" in props else None,
        unit=props.get("unit", None),
        periodic=bool(props["periodic"]) if "periodic" in props else None,
        form=checked_choice(*given(props, "form", "keep"), FORMS),
        fill=checked_choice(*given(props, "fill", "none"), FILLS),
    )
    ready = topography(source, wanted)
    return f"heightfield {ready.source}", ready


def _random(props: mi.Properties) -> tuple[str, Topography]:
    """Gaussian random surface, and the name that tells what was asked for."""
    size = _positive(props, "size", 2.0)
    resolution = checked_count(*given(props, "resolution", 256), 4)
    alpha = _positive(props, "alpha", 0.2)
    length = size * max(1 / 32, 4 / resolution)
    alphas = _positive(props, "alpha_u", alpha), _positive(props, "alpha_v", alpha)
    asked: dict[str, Any] = {
        "correlation_length": _positive(props, "correlation_length", length),
        "correlation": checked_choice(
            *given(props, "correlation", "gaussian"), CORRELATIONS
        ),
        "shortest": checked_number(
            *given(props, "shortest", 0.0), 0, np.inf, "a number of 0 or more"
        ),
        "seed": checked_count(*given(props, "seed", 0), 0),
    }
    spacing = size / resolution
    heights = gaussian_heights((resolution, resolution), spacing, alphas, **asked)
    asked = {"alpha_u": alphas[0], "alpha_v": alphas[1], **asked}
    words = ", ".join(f"{key} {value}" for key, value in asked.items())
    name = f"heightfield of {resolution} x {resolution}, asked {words}"
    return name, Topography(heights, (spacing, spacing), True, name)


def _positive(props: mi.Properties, name: str, default: float = 1.0) -> float:
    limits = 1 / MAX_LENGTH, MAX_LENGTH
    return checked_number(*given(props, name, default), *limits, POSITIVE)


def _normals(heights: Floats, spacing: tuple[float, float], closed: bool) -> Floats:
    """Unit normals at the grid points, from central differences."""
    dx, dy = spacing
    if closed:
        padded = np.pad(heights, 1, mode="wrap")
        slopes: Any = np.gradient(padded, dy, dx)
        slope_v, slope_u = (s[1:-1, 1:-1] for s in slopes)
    else:
        slope_v, slope_u = np.gradient(heights, dy, dx)
    normals = np.stack([-slope_u, -slope_v, np.ones_like(heights)], axis=-1)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def _mesh(
    props: mi.Properties,
    name: str,
    heights: Floats,
    spacing: tuple[float, float],
    normals: Floats | None,
) -> mi.Mesh:
    """Mesh of two triangles for each cell of the grid."""
    n_y, n_x = heights.shape
    faces = _faces(n_x, n_y)
    to_world = np.array(props.get("to_world", mi.ScalarTransform4f()).matrix, float)
    # opposite edges at opposite numbers, so that both are exact
    x = (np.arange(n_x) - (n_x - 1) / 2) * spacing[0]
    y = (np.arange(n_y) - (n_y - 1) / 2) * spacing[1]
    points = np.empty((n_y, n_x, 3), np.float32)
    for rows in np.array_split(np.arange(n_y), n_y // ROWS + 1):
        block = np.stack([*np.meshgrid(x, y[rows]), heights[rows]], axis=-1)
        points[rows] = block @ to_world[:3, :3].T + to_world[:3, 3]
    u, v = (np.linspace(0, 1, n).astype(np.float32) for n in (n_x, n_y))
    others = {"texcoords": np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)}
    if normals is not None:
        turned = normals.reshape(-1, 3) @ np.linalg.inv(to_world[:3, :3])
        turned /= np.linalg.norm(turned, axis=1, keepdims=True)
        others["normals"] = turned.astype(np.float32)
    return mesh_of(props, name, points.reshape(-1, 3), faces, **others)


def _faces(n_x: int, n_y: int) -> NDArray[np.uint32]:
    """Vertex indices of the triangles, counter-clockwise seen from +z."""
    index = np.arange(n_x * n_y, dtype=np.uint32).reshape(n_y, n_x)
    a, b = index[:-1, :-1], index[:-1, 1:]
    c, d = index[1:, :-1], index[1:, 1:]
    return np.stack([a, b, d, a, d, c], axis=-1).reshape(-1, 3)


PLUGIN = heightfield

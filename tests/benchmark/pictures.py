"""A rough field and its materials: ``python -m tests.benchmark pictures``.

`path` renders the field as tiles and each material on a plate, under a light 10 degrees
wide. Printed is the radiance of each material relative to the tiles, with its standard
error. Azimuths are relative to the light.
"""

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from gonio_mi.campaigns.campaign import campaign
from gonio_mi.collector.directions import direction

from .table import print_table

METAL = {"type": "roughconductor", "distribution": "ggx", "alpha": 0.15}
FIELD: dict[str, Any] = {
    "type": "heightfield",
    "alpha": 0.35,
    "resolution": 256,
    "seed": 1,
    "bsdf": {"type": "twosided", "bsdf": METAL},
}
TOLERANCES = 0.05, 0.02

# Half the width of the light in degrees; number of tiles on each side of the visible
# one, and their edge length, which is that of the shape.
HALF_ANGLE, N_BESIDE, SIDE = 5, 5, 2.0

# Polar angle of the light, with those and azimuths of cameras.
VIEWS = {
    25: ((0, 0), (40, 180), (60, 180), (75, 180), (60, 90), (60, 0)),
    55: ((0, 0), (40, 180), (75, 180), (60, 90)),
}
PIXELS, N_SEEDS, RAYS_OF_TILES, RAYS_OF_PLATE = 64, 8, 64, 16


def scene(shapes: dict[str, Any], theta: float) -> Any:
    """Shapes under a disk of radiance 1, far away at azimuth 0."""
    far = 1000 * SIDE
    origin = (far * direction(np.radians(theta), 0.0)).tolist()
    radius = far * float(np.tan(np.radians(HALF_ANGLE)))
    to_world = mi.ScalarTransform4f().look_at(origin, [0, 0, 0], [0, 1, 0])
    light = {
        "type": "disk",
        "to_world": to_world.scale([radius, radius, 1]),
        "emitter": {"type": "area", "radiance": 1.0},
    }
    path = {"type": "path", "max_depth": 12}
    return mi.load_dict({"type": "scene", "integrator": path, "light": light, **shapes})


def tiles() -> dict[str, Any]:
    """Copies of the field, side by side."""
    found: dict[str, Any] = {"field": {"type": "shapegroup", "one": dict(FIELD)}}
    for place in np.ndindex(2 * N_BESIDE + 1, 2 * N_BESIDE + 1):
        x, y = (SIDE * (n - N_BESIDE) for n in place)
        found[f"tile_{place[0]}_{place[1]}"] = {
            "type": "instance",
            "to_world": mi.ScalarTransform4f().translate([x, y, 0]),
            "field": {"type": "ref", "id": "field"},
        }
    return found


def plate(path: str) -> dict[str, Any]:
    """A large square of a material."""
    to_world = mi.ScalarTransform4f().scale([100 * SIDE, 100 * SIDE, 1])
    bsdf = {"type": "goniometric", "filename": path}
    return {"plate": {"type": "rectangle", "to_world": to_world, "bsdf": bsdf}}


def radiance(of: Any, theta: float, phi: float, rays: int) -> tuple[float, float]:
    """Mean radiance over one tile, seen from far away, and its standard error."""
    angles = np.radians(theta), np.radians(phi)
    origin = (50 * SIDE * direction(*angles)).tolist()
    up = (-direction(angles[0] + np.pi / 2, angles[1])).tolist()
    to_world = mi.ScalarTransform4f().look_at(origin, [0, 0, 0], up)
    half = SIDE / 2
    film = {"type": "hdrfilm", "width": PIXELS, "height": PIXELS}
    sensor = mi.load_dict(
        {
            "type": "orthographic",
            "near_clip": 0.01 * SIDE,
            "far_clip": 200 * SIDE,
            "to_world": to_world.scale([half, half * float(np.cos(angles[0])), 1]),
            "film": film | {"rfilter": {"type": "box"}, "pixel_format": "luminance"},
        }
    )
    found = [
        np.array(mi.render(of, sensor=sensor, spp=rays, seed=seed)).mean()
        for seed in range(N_SEEDS)
    ]
    return float(np.mean(found)), float(np.std(found, ddof=1) / N_SEEDS**0.5)


def main(words: Sequence[str]) -> None:
    """Print the table, for tolerances that are named instead of 0.05 and 0.02."""
    mi.set_variant("llvm_ad_mono")
    tolerances = [float(word) for word in words] or TOLERANCES
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        files = [str(Path(folder) / f"{one}.npz") for one in tolerances]
        for tolerance, file in zip(tolerances, files):
            found = campaign({"it": FIELD}, tolerance=tolerance, period="box")
            found["it"].save(file)
        for theta, views in VIEWS.items():
            field = scene(tiles(), theta)
            seen = [radiance(field, *view, RAYS_OF_TILES) for view in views]
            brightest = max(value for value, _ in seen)
            plates = [scene(plate(file), theta) for file in files]
            for view, (value, error) in zip(views, seen):
                row = [f"{theta}", "{}, {}".format(*view), f"{value / brightest:.2f}"]
                for one in plates:
                    other, own = radiance(one, *view, RAYS_OF_PLATE)
                    ratio = other / value
                    error_of_ratio = ratio * np.hypot(error / value, own / other)
                    row.append(f"{ratio:.3f} +- {error_of_ratio:.3f}")
                rows.append(row)
    header = ("light", "camera", "of the brightest", *map(str, tolerances))
    print_table("a rough field: material over tiles, by tolerance", header, rows)

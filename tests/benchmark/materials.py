"""Pictures of materials and of their models: ``python -m tests.benchmark materials``.

A specimen is measured with a tolerance, its file (`goniometric`) and the model itself
are rendered in turns by `path`: a sphere in a white room. Printed are the CPU seconds
of both, their ratio, and the light and the variance of pixels (over the seeds) of the
one over those of the other.
"""

import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from gonio_mi.campaigns.campaign import campaign

from .table import print_table
from .timing import in_turns

GGX = {"distribution": "ggx", "alpha": 0.3}
PRINCIPLED = {"roughness": 0.4, "anisotropic": 0.7, "metallic": 1.0}
MODELS: dict[str, dict[str, Any]] = {
    "rough conductor": {"type": "roughconductor"} | GGX,
    "anisotropic principled": {"type": "principled"} | PRINCIPLED,
    "rough glass": {"type": "roughdielectric"} | GGX,
}
TOLERANCE, SIZE, RAYS, REPEATS = 0.02, 128, 64, 16


def scene(bsdf: dict[str, Any]) -> Any:
    """Sphere in a white room."""
    to_world = mi.ScalarTransform4f().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": SIZE, "height": SIZE}
    camera = {"type": "perspective", "fov": 24, "to_world": to_world, "film": film}
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 8},
            "sensor": camera,
            "light": {"type": "constant"},
            "ball": {"type": "sphere", "bsdf": bsdf},
        }
    )


def compared(
    model: dict[str, Any], tolerance: float
) -> tuple[float, float, float, float]:
    """CPU seconds of pictures of both; the ratios of their light and variance."""
    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder) / "material.npz")
        campaign({"it": model}, tolerance=tolerance)["it"].save(path)
        material = scene({"type": "goniometric", "filename": path})
    seen: dict[str, list[Any]] = {"model": [], "material": []}

    def render(name: str, of: Any) -> None:
        image = mi.render(of, spp=RAYS, seed=len(seen[name]))
        middle = slice(SIZE // 4, -SIZE // 4)
        seen[name].append(np.array(image, dtype=float)[middle, middle])

    scenes = {"model": scene(model), "material": material}
    runs = {name: partial(render, name, of) for name, of in scenes.items()}
    times = in_turns(runs, REPEATS)
    light, variance = (
        float(of(seen["material"]) / of(seen["model"]))
        for of in (np.mean, lambda images: np.var(images, axis=0, ddof=1).mean())
    )
    return times["model"].cpu, times["material"].cpu, light, variance


def main(words: Sequence[str]) -> None:
    """Print the table, of models whose names begin with one of the words."""
    mi.set_variant("llvm_ad_mono")
    rows = []
    for name, model in MODELS.items():
        if not words or name.startswith(tuple(words)):
            own, cpu, light, variance = compared(model, TOLERANCE)
            columns = f"{own:.2f}", f"{cpu:.2f}", f"{cpu / own:.1f}"
            rows.append((name, *columns, f"{light:.4f}", f"{variance:.2f}"))
    header = ("specimen", "model, s", "material, s", "ratio", "light", "variance")
    print_table(f"materials of tolerance {TOLERANCE:g}", header, rows)

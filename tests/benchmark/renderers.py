"""Renderers that a user would set up for a map: Mitsuba and Radiance."""

from __future__ import annotations

import contextlib
import io
import os
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from typing import Any

import mitsuba as mi
import numpy as np

from gonio_mi.array_types import Floats
from gonio_mi.collector.directions import direction
from gonio_mi.collector.klems import Klems

from .baselines import PATCHES, THETA_I, Baseline

KLEMS = Klems()

# No path has as many events.
MAX_DEPTH = 10_000

RADIANCE_PLATE = (
    "m polygon plate 0 0 12  -1 -1 -0.001  1 -1 -0.001  1 1 -0.001  -1 1 -0.001"
)
RADIANCE_GROOVE = (
    "m polygon left 0 0 12  -1 -1000 0  0 -1000 -1  0 1000 -1  -1 1000 0\n"
    "m polygon right 0 0 12  0 -1000 -1  1 -1000 0  1 1000 0  0 1000 -1"
)


# --------------------------------------------------------------------------- Mitsuba


def path_directions(specimen: dict[str, Any]) -> Baseline:
    """Stock Mitsuba towards ``n x n`` points of every patch of a flat specimen.

    Each ray gives the exact value for its direction; the error is that of taking these
    for the mean. The size is n.
    """

    def _plate() -> dict[str, Any]:
        return {"plate": {"type": "rectangle", "bsdf": specimen}}

    def _flux(n: int, seed: int) -> Floats:
        return _path_flux(_path_scene(_plate, n), n, 1, seed)

    name = "Mitsuba path, batch of distant"
    return Baseline(name, _flux, size="x as many per patch", first=1, random=False)


def path_samples(
    shapes: Callable[[], dict[str, Any]],
    n: int = 1,
    sampler: str = "independent",
    integrator: str = "path",
) -> Baseline:
    """Stock Mitsuba towards ``n x n`` points of every patch, by so many paths each.

    `shapes` is a function that gives Mitsuba's dictionaries of them.
    """

    def _flux(paths: int, seed: int) -> Floats:
        return _path_flux(_path_scene(shapes, n, sampler, integrator), n, paths, seed)

    sensors = "1 distant sensor" if n == 1 else f"{n * n} distant sensors"
    name = f"Mitsuba {integrator}, {sampler}, {sensors} a patch"
    return Baseline(name, _flux, size="paths each", first=1)


@lru_cache(maxsize=1)  # all sensors that exist, of any scene, make a rendering slower
def _path_scene(
    shapes: Callable[[], dict[str, Any]],
    n: int,
    sampler: str = "independent",
    integrator: str = "path",
) -> mi.Scene:
    """One `distant` sensor for each direction, in a `batch`, above the lit specimen."""
    points = PATCHES.points(n).reshape(-1, 3)
    film = {"type": "hdrfilm", "height": 1, "rfilter": {"type": "box"}}
    # sensors in a batch do not learn of the scene's size: rays start on the target
    at = mi.ScalarTransform4f().translate([0, 0, 1e-3])
    target = mi.load_dict({"type": "rectangle", "to_world": at})
    batch: dict[str, Any] = {
        "type": "batch",
        "film": film | {"width": len(points)},
        "sampler": {"type": sampler},
    }
    for number, wo in enumerate(points):
        batch[f"towards_{number:07d}"] = {
            "type": "distant",
            "direction": (-wo).tolist(),
            "target": target,
            "film": film | {"width": 1},
        }
    flight = (-direction(np.radians(THETA_I), 0.0)).tolist()
    parts = {
        # as many events as there are
        "integrator": {"type": integrator, "max_depth": MAX_DEPTH},
        "light": {"type": "directional", "direction": flight},
        "sensor": batch,
        **shapes(),
    }
    with _errors_only():  # every film warns of the variant
        return mi.load_dict({"type": "scene", **parts})


@contextlib.contextmanager
def _errors_only() -> Iterator[None]:
    """Mitsuba without its warnings."""
    level = mi.log_level()
    mi.set_log_level(mi.LogLevel.Error)
    try:
        yield
    finally:
        mi.set_log_level(level)


def _path_flux(scene: mi.Scene, n: int, paths: int, seed: int) -> Floats:
    """Flux fraction of each patch, from the radiance towards its points."""
    with _errors_only():  # samplers warn of rounding a number of paths up
        radiance = mi.render(scene, spp=paths, seed=seed).numpy().ravel()
    brdf = radiance.reshape(*PATCHES.shape, n * n).mean(axis=2, dtype=float)
    return brdf / np.cos(np.radians(THETA_I)) * PATCHES.projected_solid_angles


# -------------------------------------------------------------------------- Radiance


def radiance_genbsdf(
    geometry: str, reflectance: float, box: Sequence[float] | None = None
) -> Baseline:
    """Radiance's genBSDF: light from all 145 Klems patches into all of them at once.

    Parameters
    ----------
    geometry : str
        Polygons of the material ``m``, whose top is just below z = 0.
    reflectance : float
        Of that Lambertian material.
    box : sequence of 6 float, optional
        Extents in x, y and z that light falls on; all of the geometry if None.

    Returns
    -------
    Baseline
        Its flux has the shape (145 incident, 145 outgoing, 1); the size is the number
        of samples for each incident patch.

    Raises
    ------
    ImportError
        Without pyradiance, which brings Radiance's programs.
    """
    import pyradiance

    material = f"void plastic m 0 0 5 {reflectance} {reflectance} {reflectance} 0 0\n"
    scene = (material + geometry).encode()
    processes = len(os.sched_getaffinity(0))

    def _flux(samples: int, seed: int) -> Floats:
        del seed  # it has none
        with contextlib.redirect_stdout(io.StringIO()):  # remarks on the bounding box
            result = pyradiance.generate_bsdf(
                # a grid of at least one more, which squares make exact
                scene,
                nsamp=samples - 1,
                nproc=processes,
                front=False,
                dim=box and pyradiance.genbsdf.SamplingBox(*box),
            )
        matrix = np.array(result.back.reflectance.split(), dtype=float)
        return matrix.reshape(145, 145).T[..., None]

    how: dict[str, Any] = {"first": 16, "incident": 145, "random": False}
    return Baseline("Radiance genBSDF, Klems", _flux, KLEMS, size="samples", **how)

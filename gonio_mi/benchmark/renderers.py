"""Renderers that a user would set up for a map: Mitsuba and Radiance."""

import contextlib
import io
import os
from dataclasses import dataclass
from functools import lru_cache

import mitsuba as mi
import numpy as np

from ..directions import direction
from . import groove
from .rivals import GRID, THETA_I, Rival

__all__ = [
    "KLEMS",
    "KlemsPatches",
    "patch_borders",
    "path_directions",
    "path_samples",
    "radiance_genbsdf",
]

RADIANCE_PLATE = (
    "m polygon plate 0 0 12  -1 -1 -0.001  1 -1 -0.001  1 1 -0.001  -1 1 -0.001"
)
RADIANCE_GROOVE = (
    "m polygon left 0 0 12  -1 -1000 0  0 -1000 -1  0 1000 -1  -1 1000 0\n"
    "m polygon right 0 0 12  0 -1000 -1  1 -1000 0  1 1000 0  0 1000 -1"
)


# --------------------------------------------------------------------------- Mitsuba


def path_directions(specimen):
    """Stock Mitsuba towards ``n x n`` points of every patch of a flat specimen.

    Each ray gives the exact value for its direction; the error is that of taking these
    for the mean. The size is n.
    """

    def plate():
        return {"plate": {"type": "rectangle", "bsdf": specimen}}

    def flux(n, seed):
        return _path_flux(_path_scene(plate, n), n, 1, seed)

    name = "Mitsuba path, batch of distant"
    return Rival(name, flux, size="x as many per patch", first=1, random=False)


def path_samples(shapes, n=1):
    """Stock Mitsuba towards ``n x n`` points of every patch, by so many paths each.

    `shapes` is a function that gives Mitsuba's dictionaries of them.
    """

    def flux(paths, seed):
        return _path_flux(_path_scene(shapes, n), n, paths, seed)

    return Rival("Mitsuba path, batch of distant", flux, size="paths each", first=1)


@lru_cache(maxsize=1)  # all sensors that exist, of any scene, make a rendering slower
def _path_scene(shapes, n):
    """One `distant` sensor for each direction, in a `batch`, above the lit specimen."""
    points = groove.patch_points(*patch_borders(GRID), n).reshape(-1, 3)
    film = {"type": "hdrfilm", "height": 1, "rfilter": {"type": "box"}}
    # sensors in a batch do not learn of the scene's size: rays start on the target
    target = mi.load_dict(
        {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().translate([0, 0, 1e-3]),
        }
    )
    batch = {"type": "batch", "film": film | {"width": len(points)}}
    for number, wo in enumerate(points):
        batch[f"towards_{number:07d}"] = {
            "type": "distant",
            "direction": (-wo).tolist(),
            "target": target,
            "film": film | {"width": 1},
        }
    level = mi.log_level()
    mi.set_log_level(mi.LogLevel.Error)  # every film warns of the variant
    try:
        return mi.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "path"},
                "light": {
                    "type": "directional",
                    "direction": (-direction(np.radians(THETA_I), 0.0)).tolist(),
                },
                "sensor": batch,
                **shapes(),
            }
        )
    finally:
        mi.set_log_level(level)


def _path_flux(scene, n, paths, seed):
    """Flux fraction of each patch, from the radiance towards its points."""
    radiance = mi.render(scene, spp=paths, seed=seed).numpy().ravel()
    brdf = radiance.reshape(*GRID.shape, n * n).mean(axis=2, dtype=float)
    return brdf / np.cos(np.radians(THETA_I)) * GRID.projected_solid_angles


def patch_borders(grid):
    """Borders of all patches of a grid in polar angle and azimuth, shapes (n, 2)."""
    theta = np.stack([grid.theta_edges[:-1], grid.theta_edges[1:]], axis=-1)
    phi = np.stack([grid.phi_edges[:-1], grid.phi_edges[1:]], axis=-1)
    return np.repeat(theta, grid.n_phi, axis=0), np.tile(phi, (grid.n_theta, 1))


# -------------------------------------------------------------------------- Radiance


@dataclass(frozen=True)
class KlemsPatches:
    """The full Klems basis: 145 patches, in rings of unlike numbers of sectors.

    The middle of the first sector of each ring is at the azimuth 0.
    """

    n_patches: int = 145

    @property
    def borders(self):
        """Borders of all patches in polar angle and azimuth, shapes (145, 2)."""
        theta_deg = (0, 5, 15, 25, 35, 45, 55, 65, 75, 90)
        theta, phi = [], []
        for i, n in enumerate((1, 8, 16, 20, 24, 24, 24, 16, 12)):
            first = np.arange(n) - 0.5
            theta += [np.radians(theta_deg[i : i + 2])] * n
            phi += list(2 * np.pi / n * np.stack([first, first + 1], axis=-1))
        return np.array(theta), np.array(phi)

    @property
    def projected_solid_angles(self):
        """Projected solid angle of each patch in sr, shape (145,)."""
        theta, phi = self.borders
        return np.diff(np.sin(theta) ** 2)[:, 0] * np.diff(phi)[:, 0] / 2


KLEMS = KlemsPatches()


def radiance_genbsdf(geometry, reflectance):
    """Radiance's genBSDF: light from all 145 Klems patches into all of them at once.

    Parameters
    ----------
    geometry : str
        Polygons of the material ``m``, whose top is just below z = 0.
    reflectance : float
        Of that Lambertian material.

    Returns
    -------
    Rival
        Its flux has the shape (145 incident, 145 outgoing); the size is the number of
        samples for each incident patch.

    Raises
    ------
    ImportError
        Without pyradiance, which brings Radiance's programs.
    """
    import pyradiance

    scene = f"void plastic m 0 0 5 {reflectance} {reflectance} {reflectance} 0 0\n"
    scene = (scene + geometry).encode()
    processes = len(os.sched_getaffinity(0))

    def flux(samples, seed):
        del seed  # it has none
        with contextlib.redirect_stdout(io.StringIO()):  # remarks on the bounding box
            result = pyradiance.generate_bsdf(
                # a grid of at least one more, which squares make exact
                scene,
                nsamp=samples - 1,
                nproc=processes,
                front=False,
            )
        matrix = np.array(result.back.reflectance.split(), dtype=float)
        return matrix.reshape(145, 145).T

    return Rival(
        "Radiance genBSDF, Klems",
        flux,
        KLEMS,
        size="samples",
        first=16,
        incident=145,
        random=False,
    )

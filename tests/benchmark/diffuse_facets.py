"""Equal error on a random height field of diffuse facets, beside other renderers."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import mitsuba as mi
import numpy as np

from gonio_mi.array_types import Floats
from gonio_mi.campaigns.measure import measure
from gonio_mi.collector import Subdivision
from gonio_mi.surfaces.heights import gaussian_heights

from .baselines import PATCHES, THETA_I, Baseline, gonio_rays
from .equal_error import Contests
from .renderers import KLEMS, path_samples, radiance_genbsdf

# Of the height field: cells along either side, and their length.
CELLS = 64
SPACING = 2 / CELLS

ALPHA, REFLECTANCE = 0.5, 0.8

# Copies of the cell, along either side, that make others' surface as good as endless:
# light up to 83 degrees from the normal leaves the middle one by its top.
COPIES = 3

# Rays of the truth, each of which lights every patch; of it as much as 1/7 of 1 %.
TRUTH_RAYS = 2**16
TRUTH_SEED = 2**20

# Half of the angle at which light comes from the first Klems patch, about the normal.
FIRST_KLEMS = 5.0  # degrees


@cache
def _heights() -> Floats:
    """Heights of one periodic cell, the highest 0."""
    heights = gaussian_heights((CELLS, CELLS), SPACING, (ALPHA, ALPHA), 4 * SPACING)
    return heights - heights.max()


def facets(copies: int = 1) -> dict[str, Any]:
    """Mitsuba's dictionary of so many copies of the cell, along either side."""
    tiled = np.tile(_heights(), (copies, copies)).astype(np.float32)
    bsdf = {"type": "diffuse", "reflectance": REFLECTANCE}
    return {
        "type": "heightfield",
        "heights": mi.TensorXf(tiled),
        "size": 2.0 * copies,
        "bsdf": {"type": "twosided", "bsdf": bsdf},
    }


def facets_of_radiance() -> Baseline:
    """Radiance's genBSDF of the same mesh: light from the first Klems patch alone.

    Raises
    ------
    ImportError
        Without pyradiance.
    """
    mesh = mi.traverse(mi.load_dict(facets(COPIES)))
    vertices = mesh["vertex_positions"].numpy().reshape(-1, 3)
    # its polygons and its sampling box must not share a plane
    vertices = vertices.astype(float) - [0, 0, 1e-3]
    corners = vertices[mesh["faces"].numpy().reshape(-1, 3)].reshape(-1, 9)
    geometry = "\n".join(
        f"m polygon f{i} 0 0 9 " + " ".join(f"{x:.7g}" for x in row)
        for i, row in enumerate(corners.tolist())
    )
    box = (-1.0, 1.0, -1.0, 1.0, float(vertices[:, 2].min()), 0.0)
    every = radiance_genbsdf(geometry, REFLECTANCE, box)

    def _flux(samples: int, seed: int) -> Floats:
        return every.flux(samples, seed)[0]

    return replace(every, flux=_flux)


def _ours(patches: Subdivision, **settings: Any) -> list[tuple[Baseline, Floats]]:
    """Our instrument with 16 batches, and a long measurement as the truth."""
    scene = mi.load_dict({"type": "scene", "facets": facets()})
    settings = {"period": "box", "footprint": "full"} | settings
    many: dict[str, Any] = {"points": patches.n_patches}
    long = many | settings | {"estimator": "next_event", "seed": TRUTH_SEED}
    truth: Any = measure(scene, collector=patches, rays=TRUTH_RAYS, **long)
    exact = truth.flux_fraction[0, ..., 0]
    common: dict[str, Any] = {"batches": 16, "subdivision": patches, **settings}
    return [
        (gonio_rays(scene, "weighted", "sobol", **common), exact),
        (gonio_rays(scene, "weighted", "independent", **common), exact),
        (gonio_rays(scene, "next_event", "sobol", **many, **common), exact),
    ]


def facet_contests() -> tuple[Contests, list[str]]:
    """Comparisons as :func:`equal_error.contests` gives them, on this surface.

    The truth is a long measurement of ours: how far the others are from it as their
    error falls says whether it is right.
    """
    absent = []
    directions = _ours(PATCHES, theta_i=THETA_I)
    exact = directions[0][1]
    for sampler in ("independent", "multijitter"):
        path = path_samples(lambda: {"facets": facets(COPIES)}, 1, sampler)
        directions.append((path, exact))
    klems = _ours(KLEMS, theta_i=0, divergence=FIRST_KLEMS)
    try:
        klems.append((facets_of_radiance(), klems[0][1]))
    except ImportError:
        absent.append("Radiance is left out: pip install '.[benchmark]'")
    what = f"diffuse height field of {CELLS}^2 cells, alpha {ALPHA}"
    return {
        f"{what}, at {THETA_I:g} degrees, 900 patches": directions,
        f"{what}, from the first Klems patch, 145 patches": klems,
    }, absent

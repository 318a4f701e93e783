"""Speed on geometry: a random rough mirror, every bounce, beside Mitsuba's `path`."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gonio_mi.campaigns.measure import measure
from gonio_mi.collector.directions import direction
from gonio_mi.specimen.rays import SURFACE_OFFSET
from gonio_mi.specimen.specimen import Specimen
from gonio_mi.transport.beam import Beam
from gonio_mi.transport.curve import Curve

from .table import print_table
from .timing import in_turns, speeds

THETA_I = 30.0  # degrees

# No path on such a surface has as many events.
MAX_DEPTH = 1000

BATCHES = 16, 1, 2, 4, 8, 64


def surface(resolution: int, alpha: float = 0.5) -> dict[str, Any]:
    """Height field of ``resolution x resolution`` cells as a Mitsuba dictionary."""
    mirror = {"type": "twosided", "bsdf": {"type": "conductor"}}
    field = {"type": "heightfield", "alpha": alpha, "resolution": resolution}
    return field | {"bsdf": mirror}


def gonio_paths(
    resolution: int, sampler: str, batches: int, period: str = "none"
) -> Callable[[int, int], float]:
    """Our instrument, as a user calls it again for a scene that is loaded.

    Returns
    -------
    callable
        ``send(rays, seed)`` gives the share of the rays that were reflected; the error
        bars of the record are computed too.
    """
    scene = _scene(resolution)
    how: dict[str, Any] = {"sampler": sampler, "batches": batches, "period": period}

    def _send(rays: int, seed: int) -> float:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of rays that pass its edges
            record = measure(
                scene, THETA_I, rays=rays, seed=seed, max_depth=MAX_DEPTH, **how
            )
        if batches > 1:
            record.interval(0.95)
        return record.ledger.reflected / rays

    return _send


@lru_cache(maxsize=1)
def _scene(resolution: int) -> mi.Scene:
    """Scene of a surface: the same for all ways, for `measure` keeps the last one."""
    return mi.load_dict({"type": "scene", "surface": surface(resolution)})


def bare_paths(resolution: int, rows: bool) -> Callable[[int, int], float]:
    """The same paths with nothing but Embree: hit after hit, no sampling, no sums.

    Rays are as watertight as ours, and the first ones are said to be coherent; a mirror
    turns them. What is faster than that traces less.

    Parameters
    ----------
    resolution : int
    rows : bool
        Rays start on a square grid, row by row, about as many as asked for; else where
        those of a batch of ours do, in the same order.

    Returns
    -------
    callable
        ``send(rays, seed)`` gives the mean number of events.
    """
    specimen = Specimen(mi.load_dict({"type": "scene", "surface": surface(resolution)}))
    towards = direction(np.radians(THETA_I), 0.0)
    emitter = mi.load_dict({"type": "directional", "direction": (-towards).tolist()})
    beam = Beam(specimen, emitter, "full", "radiometric")
    offset = specimen.reach * SURFACE_OFFSET

    def _send(rays: int, seed: int) -> float:
        if rows:
            sampler = _Grid(round(rays**0.5))
        else:
            sampler = mi.load_dict({"type": "sobol"})
            sampler.seed(seed, rays)
            sampler.follow(Curve(0, rays))
        p, wi, *_ = beam.sample(sampler, mi.Color0f())
        ray = mi.Ray3f(p + offset * wi, -wi)
        depth, d = _bounced(specimen.scene, ray, mi.Float(offset))
        # the directions are asked for, so that the last of them are computed too
        return float(np.mean(dr.select(d.z > 0, depth, 0).numpy()))

    return _send


class _Grid:
    """What a beam draws from, as a sampler: the centres of a square grid, in rows."""

    def __init__(self, side: int) -> None:
        self.side = side

    def next_2d(self) -> mi.Point2f:
        """Centres of all cells, in the unit square."""
        number = dr.arange(mi.UInt32, self.side**2)
        side = dr.opaque(mi.UInt32, self.side)
        x, y = number % side, number // side
        return (mi.Point2f(mi.Float(x), mi.Float(y)) + 0.5) / mi.Float(side)


@dr.syntax
def _bounced(
    scene: mi.Scene, ray: mi.Ray3f, offset: mi.Float
) -> tuple[mi.UInt32, mi.Vector3f]:
    """Number of reflections of rays, and where they go in the end."""
    active = mi.Bool(True)
    depth = mi.UInt32(0)
    while active:
        si = scene.ray_intersect(ray, mi.RayFlags.Minimal, depth == 0, active)
        active &= si.is_valid()
        d = ray.d - 2 * dr.dot(ray.d, si.n) * si.n
        ray.d[active] = d
        ray.o[active] = si.p + dr.copysign(offset, dr.dot(si.n, d)) * si.n
        depth[active] += 1
    return depth, ray.d


def film_paths(resolution: int, coherent: bool) -> Callable[[int, int], float]:
    """Mitsuba's `path` along the same directions, from an orthographic film.

    The film is what the specimen's top looks like from the emitter, so that its paths
    begin as our rays do; they end in light of radiance 1 from everywhere. `coherent`:
    one path for each pixel of a square film, in the order of its rows; else all paths
    from random positions on a film of one pixel.

    Returns
    -------
    callable
        ``send(paths, seed)`` gives the mean radiance that the film received.
    """
    depths = {"max_depth": MAX_DEPTH, "rr_depth": MAX_DEPTH}
    parts = {
        "integrator": {"type": "path", **depths},
        "light": {"type": "constant", "radiance": 1.0},
        "surface": surface(resolution),
    }
    scene = mi.load_dict({"type": "scene", **parts})

    def _send(paths: int, seed: int) -> float:
        side = round(paths**0.5) if coherent else 1
        image = mi.render(
            scene, sensor=_film(scene, side), spp=paths // side**2, seed=seed
        )
        return float(np.mean(image.numpy()))

    return _send


@lru_cache(maxsize=2)
def _film(scene: mi.Scene, side: int) -> mi.Sensor:
    """Orthographic sensor of ``side x side`` pixels that shows the specimen's top."""
    top = np.array([0, 0, scene.shapes()[0].bbox().max.z])
    towards = direction(np.radians(THETA_I), 0.0)
    to_world = mi.ScalarTransform4f().look_at(
        (top + 4 * towards).tolist(), top.tolist(), [0, 1, 0]
    )
    to_world = to_world.scale([np.cos(np.radians(THETA_I)), 1, 1])
    film = {"type": "hdrfilm", "width": side, "height": side}
    film |= {"pixel_format": "luminance", "rfilter": {"type": "box"}}
    return mi.load_dict({"type": "orthographic", "to_world": to_world, "film": film})


def print_speeds(
    rays: int, repeats: int, resolutions: Sequence[int] = (256, 512, 1024)
) -> None:
    """Print paths per second, relative to random starts of our own."""
    for resolution in resolutions:
        _print_speeds(rays, repeats, resolution)


def _print_speeds(rays: int, repeats: int, resolution: int) -> None:
    """Print paths per second on one surface."""
    ours = partial(gonio_paths, resolution)
    sixteen, curve = "measure, 16 batches", "along a curve (sobol)"
    ways = {
        (sixteen, "random origins (independent)"): ours("independent", 16),
        **{(f"measure, {n} batches", curve): ours("sobol", n) for n in BATCHES},
        (sixteen, "the same, one periodic cell"): ours("sobol", 16, period="box"),
        ("Embree alone", curve): bare_paths(resolution, rows=False),
        ("Embree alone", "in rows"): bare_paths(resolution, rows=True),
    }
    for way in ("random film positions, one pixel", "one path per pixel, in rows"):
        ways["Mitsuba path", way] = film_paths(resolution, coherent="rows" in way)
    runs = {key: partial(send, rays, 0) for key, send in ways.items()}
    times = in_turns(runs, repeats)
    print_table(
        f"Mirror height field of {resolution}^2 cells, alpha 0.5, at {THETA_I:g} "
        f"degrees, every bounce: {rays:g} paths, medians of {repeats} runs in turns",
        ("method", "paths start", "core-ns per path", "Mpath/s", "speed"),
        speeds(times, rays),
    )

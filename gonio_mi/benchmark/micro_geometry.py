"""Speed on geometry: a random rough mirror, every bounce, beside Mitsuba's `path`."""

from functools import lru_cache

import drjit as dr
import mitsuba as mi
import numpy as np

from ..collector.directions import direction
from ..instrument.instrument import Instrument
from ..instrument.scene_settings import sampler_of
from ..settings import MeasurementSettings
from ..transport.beam import Beam
from ..transport.ray_offsets import SURFACE_OFFSET
from ..transport.specimen import Specimen
from .table import print_table
from .timing import in_turns, speeds

__all__ = ["bare_paths", "film_paths", "gonio_paths", "print_speeds"]

THETA_I = 30.0  # degrees

# No path on such a surface has as many events.
MAX_DEPTH = 1000


def surface(resolution, alpha=0.5):
    """Height field of ``resolution x resolution`` cells as a Mitsuba dictionary."""
    mirror = {"type": "twosided", "bsdf": {"type": "conductor"}}
    return {
        "type": "heightfield",
        "alpha": alpha,
        "resolution": resolution,
        "bsdf": mirror,
    }


def gonio_paths(resolution, sampler, estimator="weighted", period="none"):
    """Our instrument, set up: a function that sends rays in one batch.

    Returns
    -------
    callable
        ``send(rays, seed)`` gives the share of the rays that were reflected.
    """
    settings = MeasurementSettings().changed(
        batches=1,
        estimator=estimator,
        sampler={"type": sampler},
        period=period,
        max_depth=MAX_DEPTH,
    )
    instrument = Instrument(settings, sampler_of(settings))
    incoming = -direction(np.radians(THETA_I), 0.0)
    emitter = mi.load_dict({"type": "directional", "direction": incoming.tolist()})
    scene = mi.load_dict({"type": "scene", "surface": surface(resolution)})
    bench = instrument.bench(Specimen(scene, period), [emitter])

    def _send(rays, seed):
        (tally,) = instrument.tallies(bench, (seed, 0), [rays])
        return tally.ledger.reflected / rays

    return _send


def bare_paths(resolution):
    """The same paths with nothing but Embree: hit after hit, no sampling, no sums.

    Origins are those of our ordered rays, and rays are as watertight as ours; a mirror
    turns them. What is faster than that traces less.

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

    def _send(rays, seed):
        sampler = mi.load_dict({"type": "sobol"})
        sampler.seed(seed, rays)
        sampler.follow_curve()
        p, wi, _, _ = beam.sample(sampler, mi.Color0f())
        ray = mi.Ray3f(p + offset * wi, -wi)
        depth, d = _bounced(specimen.scene, ray, mi.Float(offset))
        # the directions are asked for, so that the last of them are computed too
        return float(np.mean(dr.select(d.z > 0, depth, 0).numpy()))

    return _send


@dr.syntax
def _bounced(scene, ray, offset):
    """Number of reflections of rays, and where they go in the end."""
    active = mi.Bool(True)
    depth = mi.UInt32(0)
    while active:
        si = scene.ray_intersect(ray, mi.RayFlags.Minimal, False, active)
        active &= si.is_valid()
        d = ray.d - 2 * dr.dot(ray.d, si.n) * si.n
        ray.d[active] = d
        ray.o[active] = si.p + dr.copysign(offset, dr.dot(si.n, d)) * si.n
        depth[active] += 1
    return depth, ray.d


def film_paths(resolution, coherent):
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
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {
                "type": "path",
                "max_depth": MAX_DEPTH,
                "rr_depth": MAX_DEPTH,
            },
            "light": {"type": "constant", "radiance": 1.0},
            "surface": surface(resolution),
        }
    )

    def _send(paths, seed):
        side = round(paths**0.5) if coherent else 1
        image = mi.render(
            scene, sensor=_film(scene, side), spp=paths // side**2, seed=seed
        )
        return float(np.mean(image.numpy()))

    return _send


@lru_cache(maxsize=2)
def _film(scene, side):
    """Orthographic sensor of ``side x side`` pixels that shows the specimen's top."""
    top = np.array([0, 0, scene.shapes()[0].bbox().max.z])
    towards = direction(np.radians(THETA_I), 0.0)
    to_world = mi.ScalarTransform4f().look_at(
        (top + 4 * towards).tolist(), top.tolist(), [0, 1, 0]
    )
    film = {
        "type": "hdrfilm",
        "width": side,
        "height": side,
        "pixel_format": "luminance",
    }
    return mi.load_dict(
        {
            "type": "orthographic",
            "to_world": to_world.scale([np.cos(np.radians(THETA_I)), 1, 1]),
            "film": film | {"rfilter": {"type": "box"}},
        }
    )


def print_speeds(rays, repeats, resolutions=(256, 512, 1024)):
    """Print paths per second, relative to random starts of our own."""
    for resolution in resolutions:
        _print_speeds(rays, repeats, resolution)


def _print_speeds(rays, repeats, resolution):
    """Print paths per second on one surface."""
    ways = {
        ("gonio-mi", "random origins (independent)"): gonio_paths(
            resolution, "independent"
        ),
        ("gonio-mi", "origins along a curve (sobol)"): gonio_paths(resolution, "sobol"),
        ("gonio-mi", "the same, one periodic cell"): gonio_paths(
            resolution, "sobol", period="box"
        ),
        ("Embree alone", "origins along a curve (sobol)"): bare_paths(resolution),
        ("Mitsuba path", "random film positions, one pixel"): film_paths(
            resolution, coherent=False
        ),
        ("Mitsuba path", "one path per pixel, in rows"): film_paths(
            resolution, coherent=True
        ),
    }
    times = in_turns(
        {key: lambda send=send: send(rays, 0) for key, send in ways.items()}, repeats
    )
    print_table(
        f"Mirror height field of {resolution}^2 cells, alpha 0.5, at {THETA_I:g} "
        f"degrees, every bounce: {rays:g} paths, medians of {repeats} runs in turns",
        ("method", "paths start", "core-ns per path", "Mpath/s", "speed"),
        speeds(times, rays),
    )

"""A layer of a medium: the speed of our ways, and equal error beside `volpath`."""

from __future__ import annotations

from functools import partial
from typing import Any

import mitsuba as mi

from gonio_mi.campaigns.measure import measure

from .baselines import PATCHES, THETA_I, gonio_rays
from .discrete_ordinates import henyey_greenstein, theory
from .equal_error import Contests
from .renderers import path_samples
from .table import print_table
from .timing import in_turns, speeds

# That of van de Hulst's table, on which MCML was tried: optical thickness, albedo and
# anisotropy.
TAU, ALBEDO, G = 2.0, 0.9, 0.75

# Sides that make the layer of others as good as endless, in its thickness.
WIDE = 1000.0


def layer(side: float = 2.0) -> dict[str, Any]:
    """Mitsuba's dictionaries of the layer's two faces; the same index everywhere."""
    phase = {"type": "hg", "g": G}
    coefficients = {"sigma_t": TAU, "albedo": ALBEDO}
    medium = mi.load_dict({"type": "homogeneous", **coefficients, "phase": phase})
    face = {"type": "rectangle", "bsdf": {"type": "null"}}
    at = mi.ScalarTransform4f().scale([side / 2, side / 2, 1])
    below = mi.ScalarTransform4f().translate([0, 0, -1]) @ at
    return {
        "top": face | {"to_world": at, "interior": medium},
        "end": face | {"to_world": below, "exterior": medium},
    }


def _ways() -> dict[str, dict[str, Any]]:
    """Settings of our instrument, by what they do."""
    return {
        "by depth alone, sobol": {"sampler": "sobol"},
        "by depth alone, independent": {"sampler": "independent"},
        "traced, sobol": {"sampler": "sobol", "trace": True},
        "traced, independent": {"sampler": "independent", "trace": True},
    }


def print_layer_speeds(rays: int, repeats: int) -> None:
    """Print how long a ray takes through the layer, reflected and transmitted."""
    scene = mi.load_dict({"type": "scene", **layer()})

    given: dict[str, Any] = {"theta_i": 0.0, "period": "box", "collector": PATCHES}
    runs = {
        ("gonio-mi", name): partial(measure, scene, rays=rays, **given, **way)
        for name, way in _ways().items()
    }
    print_table(
        f"Layer of thickness {TAU:g}, albedo {ALBEDO:g}, g {G:g}, at 0 degrees: "
        f"{rays:g} rays into 1800 patches, medians of {repeats} runs in turns",
        ("method", "rays", "core-ns per ray", "Mray/s", "speed"),
        speeds(in_turns(runs, repeats), rays),
    )


def layer_contests() -> tuple[Contests, list[str]]:
    """Comparisons as :func:`equal_error.contests` gives them, by discrete ordinates.

    Of what is reflected: others look from one side at a time, our rays at both.
    """
    title = (
        f"layer of thickness {TAU:g}, albedo {ALBEDO:g}, g {G:g}, at {THETA_I:g} "
        "degrees, 900 patches of reflection"
    )
    try:
        fluxes, *_ = theory([(TAU, ALBEDO, henyey_greenstein(G))], THETA_I, PATCHES)
    except ImportError:
        return {}, [f"{title}: pip install '.[benchmark]'"]
    scene = mi.load_dict({"type": "scene", **layer()})
    given: dict[str, Any] = {"period": "box", "footprint": "full", "batches": 16}
    ours = [
        gonio_rays(scene, "weighted", sampler, **given)
        for sampler in ("sobol", "independent")
    ]

    def _wide() -> dict[str, Any]:
        return layer(WIDE)

    others = [
        path_samples(_wide, 1, "independent", integrator)
        for integrator in ("volpath", "prbvolpath")
    ]
    return {title: [(one, fluxes[0]) for one in (*ours, *others)]}, []

"""The estimator `auto` beside each of the three it chooses among, and its coverage."""

import warnings
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import mitsuba as mi
import numpy as np

from gonio_mi.campaigns.measure import measure
from gonio_mi.errors import SpecimenError
from gonio_mi.results.planning import precision
from gonio_mi.results.prediction_error import expected_noise
from gonio_mi.results.record import Record
from gonio_mi.specimen.specimen_text import parse_specimen

from . import groove
from .coverage import CASES, Coverage, truth_of
from .diffuse_facets import facets
from .table import print_table
from .timing import cpu_seconds, in_turns

THETA_I = 45

# By hand. Points: one for each patch, and what is best on glossy facets.
METHODS: dict[str, dict[str, Any]] = {
    "weighted": {"estimator": "weighted"},
    "next_event, 900": {"estimator": "next_event", "points": 900},
    "next_event, 64": {"estimator": "next_event", "points": 64},
    "quadrature": {"estimator": "quadrature"},
    "auto": {"estimator": "auto"},
}

# Errors on the way to the one that is asked for, as multiples of it.
STEPS = (32, 16, 8, 4, 2, 1)


def _field(bsdf: dict[str, Any], alpha: float = 0.3) -> dict[str, Any]:
    twosided = {"type": "twosided", "bsdf": bsdf}
    return {"type": "heightfield", "alpha": alpha, "bsdf": twosided}


def _gloss(alpha: float) -> dict[str, Any]:
    return {"type": "roughconductor", "alpha": alpha, "distribution": "ggx"}


# Those of `notebooks/speed_accuracy.ipynb`, and geometry that is no mirror.
SPECIMENS: dict[str, str | Callable[[], dict[str, Any]]] = {
    "Lambertian": "diffuse",
    "rough conductor": "roughconductor:alpha=0.2,distribution=ggx",
    "two-lobe plastic": "roughplastic:alpha=0.2",
    "principled": "principled:roughness=0.3,specular=0.5",
    "anisotropic conductor": "roughconductor:alpha_u=0.1,alpha_v=0.4,distribution=ggx",
    "rough dielectric": "roughdielectric:alpha=0.3",
    "smooth plastic": "plastic",
    "mirror field": lambda: _field({"type": "conductor", "specular_reflectance": 0.9}),
    "diffuse groove": lambda: {"type": "scene", **groove.walls()},
    "diffuse field": facets,
    "plastic field": lambda: _field({"type": "roughplastic", "alpha": 0.2}),
    "metal field 0.3": lambda: _field(_gloss(0.3)),
    "metal field 0.1": lambda: _field(_gloss(0.1)),
}


def print_auto_costs(
    wish: str, target: float, repeats: int, limit: float, names: Sequence[str] = ()
) -> None:
    """Print what a `rel_err` or `noise` costs by hand and by `auto`, CPU seconds."""
    print(
        f"\nCPU ms to a {wish} of {target:.2%} on 30 x 30 patches, at {THETA_I} "
        f"degrees: medians of {repeats} runs in\nturns; ~ is extrapolated by the "
        f"square of the error from runs of at least {limit:g} s."
    )
    found = expected_noise if wish == "noise" else lambda one: precision(one)[0]
    rows = []
    for name in names or SPECIMENS:
        scene = mi.load_dict(_scene(SPECIMENS[name]), optimize=False)
        runs = {}
        for method, settings in METHODS.items():
            run = partial(_run, scene, settings, wish)
            goal = _goal(run, target, limit)
            if goal is not None:
                runs[method] = partial(run, goal)
        reached = {m: max(found(run()) / target, 1) for m, run in runs.items()}
        times = in_turns(runs, repeats)
        far = {m: runs[m].args[-1] > target for m in runs}
        costs = {m: times[m].cpu * (reached[m] ** 2 if far[m] else 1) for m in runs}
        record = runs["auto"]()
        cells = [
            f"{'~' if far[m] else ''}{1e3 * costs[m]:.3g}" if m in costs else ""
            for m in METHODS
        ]
        best = min(costs[m] for m in costs if m != "auto")
        rows.append(
            (name, str(record.asked.estimator), *cells, f"{costs['auto'] / best:.2f}")
        )
        print(f"{name}: {record.provenance.choice}", flush=True)
    header = ("specimen", "auto takes", *METHODS, "auto / best")
    print_table("Costs", header, rows)


def _scene(specimen: str | Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Scene of a specimen, a flat rectangle of what is a BSDF in one word."""
    if isinstance(specimen, str):
        shape = {"type": "rectangle", "bsdf": parse_specimen(specimen)}
    else:
        shape = specimen()
    return shape if shape["type"] == "scene" else {"type": "scene", "specimen": shape}


def _run(scene: Any, settings: dict[str, Any], wish: str, goal: float) -> Record:
    """Record of a relative error in the worst patch, or of a noise."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # light over the edges is no matter here
        return measure(scene, THETA_I, **(settings | {wish: goal}))


def _goal(run: Callable[[float], Record], target: float, limit: float) -> float | None:
    """The target, or an error on the way whose run takes the limit; None if refused."""
    try:
        run(min(STEPS[0] * target, 0.9))
    except SpecimenError:
        return None
    for step in STEPS:
        before = cpu_seconds()
        goal = min(step * target, 0.9)
        run(goal)
        if cpu_seconds() - before > limit:
            break
    return goal


# ---------------------------------------------------------------------------- coverage

# Cases of the study of coverage whose truth has another estimator or other rays.
ASKED: dict[str, tuple[dict[str, Any], int]] = {
    "flat": ({"rel_err": 0.01}, 1),  # without chance
    "dark": ({"rays": 2 * 10**5}, 60),
    "facets": ({"noise": 0.01}, 60),
    "facets, 30 x 30": ({"noise": 0.1}, 60),  # ends at the first look
    "glossy": ({"rays": 2 * 10**5}, 60),
}


def print_auto_coverage() -> None:
    """Print how often intervals of 95 % hold the truth where `auto` chose."""
    rows = []
    for name, (asked, repeats) in ASKED.items():
        case, found = CASES[name], Coverage()
        specimen, truth = mi.load_dict(case.specimen()), truth_of(name)
        settings = {**case.settings, **asked, "estimator": "auto"}
        for seed in range(repeats):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                record = measure(specimen, seed=seed, **settings)
            found.add(record, truth, warned=False)
        for quantity, covered in found.covered.items():
            std_err = np.std(covered, ddof=1) / repeats**0.5 if repeats > 1 else np.nan
            wish = " ".join(f"{key} {value:g}" for key, value in asked.items())
            cells = (f"{np.mean(covered):.3f}", f"{std_err:.3f}")
            taken = str(record.asked.estimator)
            rows.append((name, taken, wish, quantity, str(repeats), *cells))
    head = ("specimen", "auto takes", "asked for", "of", "seeds", "coverage", "std_err")
    print_table("Coverage of intervals of 95 %", head, rows)

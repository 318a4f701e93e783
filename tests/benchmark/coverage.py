"""How often intervals of nominally 95 % hold the truth, by estimator and rays."""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import product
from typing import Any

import mitsuba as mi
import numpy as np

from gonio_mi.campaigns.measure import measure
from gonio_mi.results.record import Record
from gonio_mi.results.summary import summarize

from .diffuse_facets import facets
from .table import print_table

LEVEL = 0.95

# Rays of one measurement, and how often it is repeated with another seed.
REPEATS = {400: 100, 1_000: 100, 3_000: 60, 10_000: 60}
REPEATS |= {30_000: 30, 100_000: 30, 1_000_000: 12}

# Rays of the truth, which is one long measurement, and its seed: no other one's.
TRUTH_RAYS = 5 * 10**7
TRUTH_SEED = 2**31

# Estimators, each with a sampler.
SAMPLED = (
    ("weighted", "sobol"),
    ("weighted", "independent"),
    ("analog", "sobol"),
    ("analog", "independent"),
)
TRACED = (*SAMPLED, ("next_event", "sobol"), ("next_event", "independent"))


@dataclass(frozen=True)
class Case:
    """A specimen, how it is measured, by which estimators, and in which orders.

    `mean` is a flat one without texture that sends the same light.
    """

    specimen: Callable[[], dict[str, Any]]
    settings: dict[str, Any]
    estimators: Sequence[tuple[str, str]] = TRACED
    orders: Sequence[str] = ("all", "2", "3")
    mean: dict[str, Any] | None = None
    most_rays: int = 10**6


@dataclass
class Coverage:
    """Covered parts of several measurements of one case.

    Attributes
    ----------
    covered : dict of str to list of float
        By quantity (``patches``, ``dhr``, ``dht``) the part that each one covered.
    warned : list of bool
        Whether a measurement came with a warning, in words.
    pooled : list of float
        Part of the patches whose own hits tell too little of their scatter.
    widths : list of float
        Median width of the intervals of patches, over the mean of the truth.
    """

    covered: dict[str, list[float]] = field(default_factory=dict)
    warned: list[bool] = field(default_factory=list)
    pooled: list[float] = field(default_factory=list)
    widths: list[float] = field(default_factory=list)

    def add(self, record: Record, truth: Record, warned: bool) -> None:
        """Count what the intervals of a record cover of the truth."""
        found: dict[str, list[np.ndarray]] = {"patches": []}
        widths, exact_values = [], []
        for values, total in (("brdf", "dhr"), ("btdf", "dht")):
            if total == "dht" and not truth.has_lower:
                continue
            exact = getattr(truth, values)
            low, high = record.interval(LEVEL, of=values)
            lit = exact > 0
            found["patches"].append(((low <= exact) & (exact <= high))[lit])
            widths.append((high - low)[lit])
            exact_values.append(exact[lit])
            low, high = record.interval(LEVEL, of=total)
            exact = getattr(truth, total)
            if np.all(exact > 0):
                found[total] = [(low <= exact) & (exact <= high)]
        for name, parts in found.items():
            self.covered.setdefault(name, []).append(np.concatenate(parts).mean())
        self.warned.append(warned)
        self.pooled.append(float(record.pooled.mean()))
        typical = np.median(np.concatenate(widths))
        self.widths.append(float(typical / np.concatenate(exact_values).mean()))

    def mean(self, quantity: str) -> tuple[float, float]:
        """Covered part and its standard error, from the scatter of measurements.

        That of all or none, which do not scatter, is what one more could change.
        """
        covered = np.array(self.covered[quantity])
        n = len(covered)
        scatter = covered.std(ddof=1) / np.sqrt(n)
        return float(covered.mean()), float(scatter or 1 / (n + 2))


def _two_sided(bsdf: dict[str, Any]) -> dict[str, Any]:
    return {"type": "twosided", "bsdf": bsdf}


def _groove(bsdf: dict[str, Any]) -> dict[str, Any]:
    """V-groove of a half angle of 30 degrees, one cell of endless ones."""
    heights = np.tile(np.array([0, -(0.75**0.5)], np.float32), (4, 1))
    return {
        "type": "heightfield",
        "heights": mi.TensorXf(heights),
        "size": 2.0,
        "bsdf": _two_sided(bsdf),
    }


def _spots(share: float, bright: float, dark: float, bsdf: str = "diffuse") -> Case:
    """Plate of 100 x 100 texels, of which a share is brighter than all others."""
    texels = np.full(10_000, dark, np.float32)
    texels[: round(share * texels.size)] = bright
    np.random.default_rng(1).shuffle(texels)
    name = "reflectance" if bsdf == "diffuse" else "specular_reflectance"
    kind = {"type": bsdf} if bsdf == "diffuse" else {"type": bsdf, "material": "none"}

    def _plate() -> dict[str, Any]:
        texture = {
            "type": "bitmap",
            "data": mi.TensorXf(texels.reshape(100, 100, 1)),
            "filter_type": "nearest",
            "raw": True,
        }
        plate = {"type": "rectangle", "bsdf": kind | {name: texture}}
        return {"type": "scene", "plate": plate}

    return Case(
        _plate,
        {"theta_i": 30, "collector": "projected:30x30", "footprint": "full"},
        (*SAMPLED[:2], SAMPLED[3]),
        ("all",),
        kind | {name: float(texels.mean(dtype=float))},
    )


def _screen() -> dict[str, Any]:
    """Bars of grey with openings between them, of which a third is open."""
    return {
        "type": "scene",
        "bar": {
            "type": "cube",
            "to_world": mi.ScalarTransform4f().scale([1 / 3, 0.5, 0.2]),
            "bsdf": {"type": "diffuse", "reflectance": 0.5},
        },
    }


def _near_emitter() -> dict[str, Any]:
    """Plate of two reflectances, and a small disk near to it, above their border."""
    texels = np.array([[[0.25], [0.75]]], np.float32)
    texture = {"type": "bitmap", "data": mi.TensorXf(texels), "raw": True}
    turned = mi.ScalarTransform4f().translate([0, 0, 0.05]).rotate([1, 0, 0], 180)
    return {
        "type": "scene",
        "plate": {
            "type": "rectangle",
            "bsdf": {
                "type": "diffuse",
                "reflectance": texture | {"filter_type": "nearest"},
            },
        },
        "disk": {
            "type": "disk",
            "to_world": turned.scale(0.02),
            "emitter": {"type": "area"},
        },
    }


METAL = {"type": "roughconductor", "alpha": 0.3, "distribution": "ggx"}
PERIODIC = {"theta_i": 30, "collector": "projected:8x12", "period": "box"}
CASES = {
    "flat": Case(
        lambda: {"type": "glossymixture", "diffuse_reflectance": 0.5},
        {"theta_i": 45, "collector": "projected:8x12"},
        (*SAMPLED, ("quadrature", "sobol")),
        ("all",),
        {"type": "glossymixture", "diffuse_reflectance": 0.5},
    ),
    "plain": Case(
        lambda: {"type": "diffuse", "reflectance": 0.5},
        {"theta_i": 30, "collector": "projected:30x30"},
        (*SAMPLED[:2], SAMPLED[3]),
        ("all",),
        {"type": "diffuse", "reflectance": 0.5},
    ),
    "spots 0.001": _spots(0.001, 1.0, 0.001),
    "spots 0.01": _spots(0.01, 1.0, 0.001),
    "spots 0.05": _spots(0.05, 0.9, 0.001),
    "spots 0.1": _spots(0.1, 1.0, 0.001),
    "bright spots": _spots(0.01, 0.9, 0.05),
    "glossy spots": _spots(0.01, 1.0, 0.001, "roughconductor"),
    "porous": Case(_screen, PERIODIC | {"period": "1,1"}),
    "dark": Case(lambda: _groove({"type": "diffuse", "reflectance": 0.01}), PERIODIC),
    "facets": Case(facets, PERIODIC),
    "glossy": Case(lambda: _groove(METAL | {"alpha": 0.1}), PERIODIC),
}
CASES["mirrors"] = Case(
    lambda: {
        "type": "heightfield",
        "alpha": 0.5,
        "resolution": 64,
        "bsdf": _two_sided({"type": "conductor"}),
    },
    PERIODIC | {"collector": "projected:12x12"},
    (TRACED[0], *TRACED[-2:]),
    ("all",),
)
SPLIT: dict[str, Any] = {"estimators": (("split", "sobol"),), "orders": ("all",)}
CASES["mirrors, 75 degrees"] = replace(
    CASES["mirrors"], settings=CASES["mirrors"].settings | {"theta_i": 75}
)
CASES["split, grey grooves"] = Case(
    lambda: _groove({"type": "diffuse", "reflectance": 0.8}), PERIODIC, **SPLIT
)
CASES["split, grooves"] = Case(lambda: _groove(METAL), PERIODIC, **SPLIT)
CASES["split, hills"] = Case(
    lambda: {
        "type": "heightfield",
        "alpha": 0.5,
        "resolution": 16,
        "bsdf": _two_sided(METAL),
    },
    PERIODIC,
    **SPLIT,
)
for name in ("split, grooves", "split, hills"):
    CASES[f"{name}, 75 degrees"] = replace(
        CASES[name], settings=PERIODIC | {"theta_i": 75, "phi_i": 20}
    )
CASES["facets, 30 x 30"] = replace(
    CASES["facets"], settings=PERIODIC | {"collector": "projected:30x30"}
)
CASES["near emitter"] = Case(
    _near_emitter,
    {"collector": "projected:4x8", "trace": True},
    (*TRACED[:2], *TRACED[-2:]),
    ("all",),
    most_rays=10_000,
)
POINTS: dict[str, Any] = {
    "settings": PERIODIC | {"points": 96},
    "estimators": TRACED[-2:],
    "most_rays": 10_000,
}
CASES["dark, 96 points"] = replace(CASES["dark"], **POINTS)
CASES["lobes, 96 points"] = Case(lambda: _groove(METAL | {"alpha": 0.05}), **POINTS)


@cache
def truth_of(name: str, order: str = "all") -> Record:
    """A long measurement; of what is flat, the integral."""
    case = CASES[name]
    if case.mean:
        settings = case.settings | {"footprint": "point", "estimator": "quadrature"}
        return measure(case.mean, **settings, rel_err=1e-6)
    settings = {k: v for k, v in case.settings.items() if k != "points"}
    settings |= {"rays": TRUTH_RAYS, "seed": TRUTH_SEED, "order": order}
    return measure(case.specimen(), **settings)


def coverage(
    name: str,
    estimator: str,
    sampler: str,
    rays: int,
    order: str = "all",
    repeats: int | None = None,
) -> Coverage:
    """Coverage of one of the `CASES`, over as many seeds as `repeats`.

    The truth is a long measurement, or the integral for the flat one: of the other
    estimators it shares the transport, not the intervals.
    """
    case, found = CASES[name], Coverage()
    specimen = mi.load_dict(case.specimen())
    settings = {"estimator": estimator, "sampler": sampler, **case.settings}
    truth = truth_of(name, order)
    for seed in range(REPEATS[rays] if repeats is None else repeats):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            record = measure(specimen, rays=rays, seed=seed, order=order, **settings)
        warned = bool(caught or summarize(record).warnings)
        found.add(record, truth, warned)
    return found


def print_coverage(most_rays: int, names: Sequence[str] = tuple(CASES)) -> None:
    """Print the coverage of all cases, up to so many rays."""
    quantities = ("quantity", "order", "rays", "coverage", "std_err")
    header = (*quantities, "pooled", "warned", "width")
    for name in names:
        most = min(most_rays, CASES[name].most_rays)
        numbers = [rays for rays in REPEATS if rays <= most]
        for estimator, sampler in CASES[name].estimators:
            rows = []
            for order, rays in product(CASES[name].orders, numbers):
                found = coverage(name, estimator, sampler, rays, order)
                shares = [f"{np.mean(x):.2f}" for x in (found.pooled, found.warned)]
                for quantity in found.covered:
                    values = (f"{x:.3f}" for x in found.mean(quantity))
                    width = f"{np.mean(found.widths):.3g}"
                    row = (quantity, order, f"{rays:.0e}", *values, *shares, width)
                    rows.append(row)
            print_table(f"{name}: {estimator}, {sampler}", header, rows)

"""The validation table of the README: ``python -m tests.benchmark reference_cases``.

Each case compares a measurement with a value from elsewhere, a closed form or a
converged integral, and prints the probability of so large a deviation by chance.
"""

import argparse
from collections.abc import Iterator, Sequence
from typing import Any

import mitsuba as mi
import numpy as np
from scipy import stats

from gonio_mi.campaigns.measure import measure
from gonio_mi.collector import subdivision
from gonio_mi.quadrature import integrate
from gonio_mi.results.planning import rms_expectation
from gonio_mi.results.record import Record
from gonio_mi.results.statistics import student_score

# Its name, reference, measured value, standard error, and p-value.
Row = tuple[str, float, float, float, float]

VARIANT = "llvm_ad_mono"
GLASS = 1.5046
BK7 = {"int_ior": GLASS, "ext_ior": 1.0}


def fresnel(theta_i: float, eta: float = GLASS) -> float:
    """Unpolarised reflectance of a smooth interface for `theta_i` in degrees."""
    cos_i = np.cos(np.radians(theta_i))
    cos_t = np.sqrt(1 - (1 - cos_i**2) / eta**2)
    s = (cos_i - eta * cos_t) / (cos_i + eta * cos_t)
    p = (eta * cos_i - cos_t) / (eta * cos_i + cos_t)
    return (s**2 + p**2) / 2


def cases(rays: int, seed: int) -> Iterator[Row]:
    """Yield ``(case, reference, measured, std_err, p_value)``."""
    settings = {"seed": seed, "sampler": "independent"}
    yield from _counting_cases(rays, settings)
    yield from _glass_cases(rays, settings)
    yield from _rough_cases(rays, settings)


def _counting_cases(rays: int, settings: dict[str, Any]) -> Iterator[Row]:
    """RMS error of a counted Lambertian, which multinomial statistics know."""
    white = {"type": "diffuse", "reflectance": 1.0}
    for name in ("angle:30x30", "solid:30x30", "projected:30x30"):
        patches = subdivision(name)
        record = measure(
            white, 45, rays=rays, collector=patches, estimator="analog", **settings
        )
        square = np.mean((record.brdf[..., 0] - 1 / np.pi) ** 2)
        expected, spread = rms_expectation(
            patches, patches.projected_solid_angles / np.pi, rays
        )
        p = _two_sided((square / expected - 1) / spread)
        rms = np.sqrt(square)
        yield f"Lambertian, {name}: RMS error", expected**0.5, rms, rms * spread / 2, p


def _glass_cases(rays: int, settings: dict[str, Any]) -> Iterator[Row]:
    """Fresnel's reflectance of glass, and of a slab with all inner reflections."""
    settings = settings | {"estimator": "analog"}
    glass = {"type": "dielectric", **BK7}
    wide = mi.ScalarTransform4f().scale([2000.0, 2000.0, 1.0])
    slab = {"type": "cube", "to_world": wide, "bsdf": glass}
    slab = {"type": "scene", "slab": slab}
    for theta_i in (0, 60):
        once = fresnel(theta_i)
        record = measure(glass, theta_i, rays=rays, **settings)
        yield _total(f"glass, {theta_i} degrees: R", once, record)
        record = measure(slab, theta_i, rays=rays // 10, footprint="point", **settings)
        label = f"glass slab, {theta_i} degrees: R, all orders"
        yield _total(label, 2 * once / (1 + once), record)


def _rough_cases(rays: int, settings: dict[str, Any]) -> Iterator[Row]:
    """Rough surfaces against the integral of ``eval``: their totals and patches."""
    for name, specimen, theta_i in (
        ("rough conductor 0.2", {"type": "roughconductor", "alpha": 0.2}, 60),
        ("rough plastic 0.1", {"type": "roughplastic", "alpha": 0.1}, 30),
        ("rough dielectric 0.3", {"type": "roughdielectric", "alpha": 0.3, **BK7}, 30),
    ):
        patches = subdivision("projected:10x10")
        exact = integrate(mi.load_dict(specimen), theta_i, 0, patches)
        record: Any = measure(
            specimen,
            theta_i,
            rays=rays,
            collector=patches,
            hemispheres="both",
            **settings,
        )
        label = f"{name}, {theta_i} degrees"
        yield _total(f"{label}: R", exact.flux[0].sum(), record)
        values = np.stack([record.brdf, record.btdf])
        std_err = np.stack([record.brdf_std_err, record.btdf_std_err])
        lit = np.stack(list(record.counts))[..., None] >= 1000
        t = ((values - exact.values) / std_err)[lit]
        z2 = student_score(t, record.n_batches - 1) ** 2
        p = stats.chi2.sf(z2.sum(), z2.size)
        yield f"{label}: chi-square of {z2.size} patches", z2.size, z2.sum(), np.nan, p


def _total(case: str, expected: float, record: Record) -> Row:
    value, std_err = float(record.dhr[0]), float(record.dhr_std_err[0])
    t = (value - expected) / std_err
    return case, expected, value, std_err, 2 * stats.t.sf(abs(t), record.n_batches - 1)


def _two_sided(z: float | np.floating[Any]) -> float:
    return 2 * stats.norm.sf(abs(z))


def main(argv: Sequence[str]) -> None:
    """Print the table in Markdown."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.benchmark reference_cases",
        description=__doc__.splitlines()[0],
    )
    parser.add_argument("--rays", type=float, default=1e7, help="rays (default 1e7)")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(argv)
    mi.set_variant(VARIANT)
    print("| case | reference | measured | +- std_err | p-value |")
    print("|---|---|---|---|---|")
    for case, expected, value, std_err, p in cases(int(options.rays), options.seed):
        error = "" if np.isnan(std_err) else f"{std_err:.2g}"
        print(f"| {case} | {expected:.6g} | {value:.6g} | {error} | {p:.2f} |")

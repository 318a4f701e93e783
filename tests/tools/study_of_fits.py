"""Pulls of fits: (found - true) / error of many fits, beyond what tests have time for.

``python tests/tools/study_of_fits.py --fits 50`` prints for each parameter the mean and
the standard deviation of the pulls, and what Student's t with the degrees of freedom of
the error lets one expect. Records of 16 batches leave 15; tables state their errors.
"""

import argparse
from collections.abc import Callable
from dataclasses import replace

import numpy as np

import gonio_mi as gonio
from gonio_mi.files.measured_table import MeasuredTable
from gonio_mi.specimen.specimen_text import parse_specimen

# isort: split
import mitsuba as mi

METAL = parse_specimen(
    "roughconductor:material=none,distribution=ggx,alpha=0.3,specular_reflectance=0.8"
)
GLASS = {"type": "roughdielectric", "distribution": "ggx", "alpha": 0.3, "int_ior": 1.5}
PAINT = {
    "type": "principled",
    "base_color": 0.6,
    "roughness": 0.5,
    "metallic": 0.3,
    "specular": 0.4,
}
CONES = tuple(
    (float(theta), float(phi)) for theta in (15, 35, 55) for phi in (0, 90, 180)
)


def of_record(truth: dict, known: str, **settings) -> Callable[[int], gonio.Fit]:
    """Fit of a record of new rays."""
    settings = {"collector": "projected:8x16", "rays": 50_000} | settings
    return lambda seed: gonio.fit(
        gonio.measure(truth, 40, seed=seed, **settings), known
    )


def of_table(seed: int) -> gonio.Fit:
    """Fit of a table with noise of 5 % and a calibration of 2 %."""
    cones = gonio.Apertures(3.0, CONES)
    sharp = gonio.measure(METAL, [10, 50], collector=cones, rays=2**22)
    rng = np.random.default_rng(seed)
    factor = 1 + 0.02 * rng.standard_normal()
    theta_o, phi_o = np.array(CONES).T
    n = len(CONES)
    table = MeasuredTable(
        np.repeat(sharp.theta_i, n),
        np.zeros(2 * n),
        np.tile(theta_o, 2),
        np.tile(phi_o, 2),
        sharp.brdf[:, :n, 0, 0].ravel(),
        uncertainty=0.05,
        scale_uncertainty=0.02,
        aperture_half_angle=3.0,
    )
    noisy = table.value * factor * (1 + 0.05 * rng.standard_normal(2 * n))
    return gonio.fit(replace(table, value=noisy), "roughconductor:distribution=ggx")


METAL_KNOWN, GLASS_KNOWN = (
    "roughconductor:distribution=ggx",
    "roughdielectric:distribution=ggx",
)
RAYS = {"sampler": "independent", "estimator": "analog"}
CASES: dict[str, tuple[dict, int, Callable[[int], gonio.Fit]]] = {
    "conductor, counted rays": (METAL, 15, of_record(METAL, METAL_KNOWN, **RAYS)),
    "conductor, sobol": (METAL, 15, of_record(METAL, METAL_KNOWN)),
    "conductor, apertures": (
        METAL,
        15,
        of_record(METAL, METAL_KNOWN, collector=gonio.Apertures(5.0, CONES)),
    ),
    "dielectric, sobol": (GLASS, 15, of_record(GLASS, GLASS_KNOWN)),
    "principled, sobol": (PAINT, 15, of_record(PAINT, "principled")),
    "conductor, table": (METAL, 0, of_table),
}


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fits", type=int, default=50)
    parser.add_argument("--case", choices=CASES, nargs="+", default=list(CASES))
    options = parser.parse_args()
    mi.set_variant("llvm_ad_mono")
    for name in options.case:
        truth, dof, make = CASES[name]
        found = [make(seed) for seed in range(options.fits)]
        pulls = np.array(
            [
                (one.values - [truth[key] for key in one.names]) / one.std_errs
                for one in found
            ]
        )
        expected = np.sqrt(dof / (dof - 2)) if dof else 1.0
        spread = expected / np.sqrt(2 * options.fits)
        print(f"{name}: {expected:.2f} +- {spread:.2f} expected")
        for key, column in zip(found[0].names, pulls.T):
            print(
                f"  {key:22s} mean {column.mean():+.2f} +- "
                f"{expected / np.sqrt(options.fits):.2f}, std {column.std(ddof=1):.2f}"
            )
        chi2 = np.mean([one.reduced_chi2 for one in found])
        print(f"  chi-square per degree of freedom {chi2:.3f}")


if __name__ == "__main__":
    main()

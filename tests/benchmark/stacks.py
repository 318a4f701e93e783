"""What a direction costs in a stack, by rays and by integrals."""

from functools import partial
from typing import Any

import numpy as np

from gonio_mi.campaigns.measure import measure

from .baselines import PATCHES
from .table import print_table
from .timing import in_turns, peak_memory

SPECIMENS = {
    "rough conductor": {"type": "roughconductor", "alpha": 0.2, "distribution": "ggx"},
    "mirror hills": {
        "type": "heightfield",
        "alpha": 0.3,
        "resolution": 128,
        "bsdf": {"type": "twosided", "bsdf": {"type": "conductor"}},
    },
}
DIRECTIONS = (1, 10, 100, 1000)

# Of integrals.
KINDS = ("roughconductor", "roughplastic", "roughdielectric")
ANGLES = np.linspace(0, 80, 90).tolist()


def print_stacks(rays: int, repeats: int) -> None:
    """Print the cost of a direction of so many rays, beside the same rays at one."""
    rows = []
    for name in SPECIMENS:
        for n in DIRECTIONS:
            angles = np.linspace(0, 80, n).tolist()
            runs = {
                "stack": partial(_send, name, angles, rays),
                "one": partial(_send, name, angles[n // 2], n * rays),
            }
            times = in_turns(runs, repeats if n < 1000 else 1)
            each = [f"{1e3 * time.cpu / n:.3g}" for time in times.values()]
            ratio = times["stack"].cpu / times["one"].cpu
            rows.append(
                (name, f"{n}", *each, f"{ratio:.2f}", f"{peak_memory() / 2**20:.0f}")
            )
    print_table(
        f"Stacks: {rays} rays at each direction, 900 patches; the peak is that of the "
        "process so far",
        ("specimen", "directions", "core-ms each", "all at one", "ratio", "peak MiB"),
        rows,
    )


def _send(name: str, theta_i: list[float] | float, rays: int) -> None:
    measure(SPECIMENS[name], theta_i, collector=PATCHES, rays=rays, footprint="full")


def print_integrals(repeats: int) -> None:
    """Print what the integrals of 90 directions cost, in one stack and alone."""
    rows = []
    for kind in KINDS:
        runs = {"alone": partial(_alone, kind), "stack": partial(_integrals, kind)}
        for how_many, one in in_turns(runs, repeats).items():
            each = f"{1e3 * one.cpu / 90:.3g}", f"{1e3 * one.wall / 90:.3g}"
            rows.append((kind, how_many, *each))
    print_table(
        "Integrals: 90 directions, each over 900 patches",
        ("specimen", "directions", "core-ms each", "ms each"),
        rows,
    )


def _integrals(kind: str, theta_i: Any = ANGLES) -> None:
    specimen = {"type": kind, "alpha": 0.2}
    measure(specimen, theta_i, estimator="quadrature", collector=PATCHES)


def _alone(kind: str) -> None:
    for theta_i in ANGLES:
        _integrals(kind, theta_i)

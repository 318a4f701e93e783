"""Integrals instead of rays: a stack of incident directions, and one by one."""

from functools import partial
from typing import Any

import numpy as np

from gonio_mi.campaigns.measure import measure

from .baselines import PATCHES
from .table import print_table
from .timing import in_turns

__all__ = ["print_integrals"]

SPECIMENS = ("roughconductor", "roughplastic", "roughdielectric")
ANGLES = np.linspace(0, 80, 90).tolist()


def print_integrals(repeats: int) -> None:
    """Print what the integrals of 90 directions cost, in one stack and alone."""
    rows = []
    for kind in SPECIMENS:
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

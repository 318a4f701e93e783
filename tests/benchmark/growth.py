"""How time and memory grow: with rays, incident directions, patches, and cells."""

import argparse
import warnings
from collections.abc import Sequence
from multiprocessing import get_context
from statistics import median

import mitsuba as mi
import numpy as np

from gonio_mi.campaigns.measure import measure

from .baselines import THETA_I
from .micro_geometry import surface
from .stacks import SPECIMENS
from .table import print_table
from .timing import cpu_seconds, peak_memory

# What grows, and through what; all else is as in a row of 900 patches.
SERIES = {
    "rays": [10**n for n in range(3, 10)],
    "directions": [1, 3, 10, 30, 100, 300, 1000],
    "patches": [100, 400, 900, 2500, 10**4, 40_000, 10**5, 250_000, 10**6],
    "cells": [64**2, 128**2, 256**2, 512**2, 1024**2, 2048**2],
}
TITLES = {
    "rays": "rays on a rough conductor",
    "directions": "directions of 16 384 rays each",
    "patches": "patches, 1e6 rays",
    "cells": "cells of a mirror field, 2e6 rays",
}

# Points at the end of a series that a straight line is fitted to.
N_FITTED = 3


def main(argv: Sequence[str]) -> None:
    """Print time and memory over what grows, and draw them."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.benchmark growth", description=__doc__
    )
    parser.add_argument("--only", nargs="+", choices=SERIES, default=[*SERIES])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("-o", "--output", metavar="FIGURE", help="such as growth.png")
    options = parser.parse_args(argv)
    found = {}
    for name in options.only:
        # each in a process of its own, whose peak is that of the one
        with get_context("spawn").Pool(1, maxtasksperchild=1) as pool:
            asked = [(name, value, options.repeats) for value in SERIES[name]]
            found[name] = np.array(pool.starmap(_cost, asked, chunksize=1))
        orders = " ".join(f"{order:.2f}" for order in _orders(name, found[name]))
        print_table(
            f"{TITLES[name]}; orders of the last {N_FITTED}: {orders}",
            (name, "CPU s", "peak MiB"),
            [
                (f"{value:g}", f"{cpu:.3g}", f"{peak:.0f}")
                for value, (cpu, peak) in zip(SERIES[name], found[name])
            ],
        )
    if options.output:
        _draw(found, options.output)


def _cost(name: str, value: int, repeats: int) -> tuple[float, float]:
    """Median CPU seconds, of a kernel that is compiled, and peak memory in MiB."""
    mi.set_variant("llvm_ad_mono")
    specimen, theta_i = SPECIMENS["rough conductor"], THETA_I
    rays, patches = 10**6, 900
    if name == "rays":
        rays = value
    elif name == "directions":
        rays, theta_i = 2**14, np.linspace(0, 80, value).tolist()
    elif name == "patches":
        patches = value
    else:
        rays, specimen = 2 * 10**6, surface(round(value**0.5))
    side = int(patches**0.5)
    collector = f"projected:{side}x{patches // side}"
    times = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of rays that pass the edges of a field
        for _ in range(repeats + 1):
            start = cpu_seconds()
            measure(specimen, theta_i, rays=rays, collector=collector)
            times.append(cpu_seconds() - start)
    return median(times[1:]), peak_memory() / 2**20


def _orders(name: str, found: np.ndarray) -> list[float]:
    """Exponents of time and memory over the last points of a series."""
    x, y = np.log(SERIES[name][-N_FITTED:]), np.log(found[-N_FITTED:])
    return list(np.polyfit(x, y, 1)[0])


def _draw(found: dict[str, np.ndarray], path: str) -> None:
    import matplotlib.pyplot as plt  # which the other tables do not need

    figure, every = plt.subplots(1, len(found), figsize=(3.1 * len(found), 3.4))
    for axes, (name, costs) in zip(np.atleast_1d(every), found.items()):
        labels = ("CPU s", "C0", "o"), ("peak, GiB", "C1", "s")
        both = zip(labels, _orders(name, costs), (costs.T / [[1], [1024]]))
        for (label, colour, marker), order, values in both:
            label = f"{label}: order {order:.2f}"
            axes.loglog(SERIES[name], values, marker, ls="-", color=colour, label=label)
        axes.set(title=TITLES[name], xlabel=name)
        axes.legend(fontsize="small")
        axes.title.set_fontsize("small")
    figure.tight_layout()
    figure.savefig(path, dpi=110)

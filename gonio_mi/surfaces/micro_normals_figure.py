"""Picture of micro-normals and masking, with the curves of both models."""

from __future__ import annotations

from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from ..plots.figure import finished, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["micro_normals_figure"]

# Rings that are drawn at least.
FEWEST_RINGS = 5

MODELS = {"beckmann": "-", "ggx": "--"}


def micro_normals_figure(found: Any, path: str | PathLike[str] | None = None) -> Figure:
    """Draw what :func:`micro_normals` found, and write it if `path` is given.

    Left, the density over the polar angle, mean over azimuth; right, the visible part
    of the facets over the direction that looks at them, for each azimuth. Bars are
    standard errors, lines the models of largest likelihood.
    """
    figure = new_figure(path, figsize=(11, 4.4))
    left, right = figure.subplots(1, 2)
    edges = found.theta_edges
    middles = (edges[:-1] + edges[1:]) / 2
    bars = middles, found.density, found.density_std_err
    left.errorbar(*bars, fmt="ok", ms=3, label="facets +- std_err")
    for number, (name, style) in enumerate(MODELS.items()):
        u, v = found.alphas[name]
        label = f"{name}, alpha {u:.3g} x {v:.3g}"
        curve = found.model_density(name)
        left.plot(middles, curve, style, c=f"C{number}", label=label)
    (held,) = np.nonzero(found.density)
    positive = found.density[held]
    left.set(xlabel="polar angle of the facet's normal (degrees)", ylabel="D (1/sr)")
    if positive.size:
        # to one ring beyond the last one with facets
        left.set_xlim(0, edges[min(max(held[-1] + 2, FEWEST_RINGS), len(edges) - 1)])
        left.set_yscale("log")
        left.set_ylim(positive.min() / 3, positive.max() * 3)
    left.legend(frameon=False)
    for number, phi in enumerate(np.unique(found.phi)):
        own = found.phi == phi
        colour = f"C{number}"
        right.errorbar(
            found.theta[own],
            found.masking[own],
            found.masking_std_err[own],
            fmt="o",
            c=colour,
            label=f"phi {phi:g}° +- std_err",
        )
        for name, style in MODELS.items():
            curve = found.model_masking(name)[own]
            right.plot(found.theta[own], curve, style, c=colour, lw=1)
    right.set(xlabel="theta (degrees)", ylabel="visible part G1, Smith: lines")
    right.set_ylim(0, 1.05)
    right.legend(frameon=False)
    return finished(figure, path)

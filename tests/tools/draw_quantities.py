"""Draw the geometries of quantities: ``python tests/tools/draw_quantities.py OUT.svg``.

Angles are those of the definitions; apertures below 4 degrees are drawn wider.
"""

import sys

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.patches import Wedge

from gonio_mi.analysis.quantities import DEFINITIONS

PANELS = {
    "gloss20": "gloss20",
    "gloss60": "gloss60",
    "gloss85": "gloss85",
    "reflection_haze": "reflection_haze",
    "haze": "haze, transmittance,\ndirect, diffuse, openness",
    "tis": "tis",
    "45/0": "45/0",
    "0/45": "0/45",
    "8/de": "8/di, 8/de",
    "de/8": "di/8, de/8",
    "R_A:": "R_A, R_L",
    "lobe_inner": "lobe",
}
LIGHT, RECEPTOR, TRAP = "#d98e04", "#2b6cb0", "#777777"
MIN_DRAWN = 4.0


def wedge(axes, middle, width, colour, radius=1.0, **how):
    """Sector of directions about an angle from the normal; below 0 to the left."""
    half = max(width, MIN_DRAWN) / 2
    at = 90 - middle
    axes.add_patch(Wedge((0, 0), radius, at - half, at + half, color=colour, **how))


def draw(axes, own, title):
    """One geometry in its plane of incidence; the source on the left."""
    where = 180 if own.lower else 0
    if own.diffuse:
        wedge(axes, 0, 180, LIGHT, 0.9, alpha=0.25, lw=0)
    else:
        wedge(axes, -own.theta_i, own.beam[0] if own.beam else 0, LIGHT, lw=0)
    whole = not own.receptors and not own.patches
    if whole:
        wedge(axes, where, 180, RECEPTOR, 0.8, alpha=0.3, lw=0)
    if own.patches:
        for middle in np.arange(-80, 81, 8):
            wedge(axes, middle, MIN_DRAWN, RECEPTOR, 0.7, alpha=0.4, lw=0)
    for windows, colour in ((own.receptors, RECEPTOR), (own.without, TRAP)):
        for theta, phi, width, *_ in windows:
            angle = theta if phi == 180 else -theta
            angle = 180 - angle if own.lower else angle
            wide = width > 90
            style = {"alpha": 0.3} if wide else {}
            wedge(axes, angle, width, colour, 0.85, lw=0, **style)
    if own.minus:
        wedge(axes, -8, 10, TRAP, 0.9, lw=0)
    axes.plot([-1, 1], [0, 0], c="black", lw=2)
    axes.plot([0, 0], [0, 1], c="black", lw=0.6, ls=":")
    low = -1.0 if own.lower else -0.05
    axes.set(xlim=(-1.05, 1.05), ylim=(low, 1.05), aspect="equal")
    axes.set_title(title, fontsize=9)
    axes.axis("off")


def main(path):
    """Draw all panels."""
    mpl.rcParams["svg.hashsalt"] = "quantities"
    figure, places = plt.subplots(4, 3, figsize=(8, 8), layout="constrained")
    for axes, (name, title) in zip(places.ravel(), PANELS.items()):
        draw(axes, DEFINITIONS[name.rstrip(":")](), title)
    labels = {"light": LIGHT, "receptor": RECEPTOR, "excluded": TRAP}
    for label, colour in labels.items():
        places[0, 0].fill([], [], color=colour, label=label)
    figure.legend(loc="outside lower center", ncols=3, frameon=False)
    figure.savefig(path, metadata={"Date": None})


if __name__ == "__main__":
    main(sys.argv[1])

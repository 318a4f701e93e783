"""Scatter data of one lobe, as files of other programs hold them."""

import numpy as np

from gonio_mi.collector.directions import direction
from gonio_mi.exchange.formats.scatter import Block, Scatter

# A text of an engineered diffuser.
VIAVI = """!!EDX5 10-0     RPC Photonics     10/28/2014
!!BSDF Data
10.000\t0.000
0.0000\t0.0000\t0.6099
15.0000\t0.0000\t26.66
15.0000\t90.0000\t0.5
"""

POLAR, AZIMUTH = np.arange(0, 91, 5.0), np.arange(0, 361, 15.0)


def phong(theta_i, wo, power=8):
    """BRDF in 1/sr of a lobe about the mirror direction of an incidence from +x."""
    mirror = direction(np.radians(theta_i), np.pi)
    return 0.1 + 0.5 * np.maximum(np.asarray(wo) @ mirror, 0) ** power


def lobes(specular=False, hemisphere=0, channels=("Y",), theta_i=(0, 30, 60)):
    """The lobe on grids about the normal or the specular direction."""
    blocks = []
    for theta in theta_i:
        empty = np.zeros((len(POLAR), len(AZIMUTH), 1))
        place = float(theta), 0.0, hemisphere, POLAR, AZIMUTH
        wo = Block(*place, empty, specular).directions()
        tints = np.linspace(1, 0.5, len(channels))
        values = phong(theta, wo)[..., None] * tints
        blocks.append(Block(*place, values, specular))
    return Scatter(blocks, channels)

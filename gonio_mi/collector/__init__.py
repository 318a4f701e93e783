"""The collector hemisphere: directions, and how it is cut into patches."""

from .apertures import Apertures
from .borders import Borders, adapted
from .equal_steps import (
    EqualAngle,
    EqualProjectedSolidAngle,
    EqualSine,
    EqualSolidAngle,
)
from .hemisphere import EDGE, RingsAndSectors, Subdivision
from .klems import Klems
from .parsing import subdivision
from .receptors import Receptors

__all__ = [
    "Apertures",
    "EDGE",
    "Borders",
    "EqualAngle",
    "EqualProjectedSolidAngle",
    "EqualSine",
    "EqualSolidAngle",
    "Klems",
    "Receptors",
    "RingsAndSectors",
    "Subdivision",
    "adapted",
    "subdivision",
]

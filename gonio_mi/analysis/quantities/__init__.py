"""What instruments state: gloss, haze, reflectance factors, retroreflection, lobes."""

from .definitions import DEFINITIONS, Definition
from .quantity import Quantity, quantity

__all__ = ["DEFINITIONS", "Definition", "Quantity", "quantity"]

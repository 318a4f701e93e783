"""A trial of each BSDF before rays are sent: what it raises is said in a sentence.

In the loop that follows rays through geometry, Dr.Jit would hide what it is.
"""

import traceback
from collections.abc import Iterable
from typing import Any

import drjit as dr
import mitsuba as mi

from ..errors import SpecimenError, abridged
from .variants import usable_variants

__all__ = ["check_works", "class_of"]


def check_works(bsdfs: Iterable[Any], wavelengths: Any, estimator: str) -> None:
    """Raise what a BSDF raises in the methods that `estimator` needs.

    One BSDF of each class is tried, with the `wavelengths` of a ray; what it answers is
    not looked at.

    Raises
    ------
    SpecimenError
        For an error of Mitsuba's, which does not say whose it is. One of a plugin in
        Python passes as it is: its traceback names the line.
    """
    for bsdf in {class_of(bsdf): bsdf for bsdf in bsdfs}.values():
        try:
            _try(bsdf, wavelengths, estimator)
        except RuntimeError as error:
            if _in_python(error):
                raise
            said = abridged(" ".join(str(error).split()), 200)
            kind = mi.variant().partition("_")[0]
            others = [one for one in usable_variants() if one.startswith(kind)]
            others = [one for one in others if one != mi.variant()]
            raise SpecimenError(
                f"the BSDF {class_of(bsdf)} fails in the variant {mi.variant()}: "
                f"{said}; another variant may do ({', '.join(others)})"
            ) from error


def _try(bsdf: Any, wavelengths: Any, estimator: str) -> None:
    """Call the methods once, as in a launch."""
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.uv = mi.Point2f(0.5)
    si.wi = mi.Vector3f(0.6, 0, 0.8)
    si.wavelengths = wavelengths
    ctx = mi.BSDFContext(mi.TransportMode.Importance)
    delta = mi.has_flag(bsdf.flags(), mi.BSDFFlags.Delta)
    if delta or estimator != "quadrature":
        bsdf.sample(ctx, si, mi.Float(0.5), mi.Point2f(0.5), mi.Bool(True))
    if estimator in ("quadrature", "next_event"):
        bsdf.eval(ctx, si, mi.Vector3f(0, 0.6, 0.8), mi.Bool(True))


def _in_python(error: BaseException) -> bool:
    """Whether an error comes from below `_try`, which Mitsuba's own do not show."""
    frames = [
        frame.f_code.co_name for frame, _ in traceback.walk_tb(error.__traceback__)
    ]
    return frames[-1] != "_try"


def class_of(plugin: Any) -> str:
    """Class of a BSDF or texture; one in Python has the class name of its base."""
    name = plugin.class_name()
    return type(plugin).__name__ if name in ("BSDF", "Texture", "Medium") else name

"""A trial of each BSDF before rays are sent: what it raises is said in a sentence.

In the loop that follows rays through geometry, Dr.Jit would hide what it is.
"""

import os
from collections.abc import Iterable
from typing import Any

import drjit as dr
import mitsuba as mi

from ..errors import SpecimenError, abridged, own_frame
from .plugin_answers import (
    PluginFault,
    checked_answer,
    checked_sample,
    missing_method,
)
from .variants import usable_variants

__all__ = ["check_works", "class_of"]


def check_works(bsdfs: Iterable[Any], wavelengths: Any, estimator: str) -> None:
    """Raise what a BSDF raises in the methods that `estimator` needs.

    One BSDF of each class is tried, with the `wavelengths` of a ray; of what it answers
    only the form is looked at.

    Raises
    ------
    SpecimenError
        For an error of Mitsuba's, which does not say whose it is, and for an answer
        without the form of one. What a plugin in Python raises passes as it is: its
        traceback names the line.
    """
    for bsdf in {class_of(bsdf): bsdf for bsdf in bsdfs}.values():
        try:
            _try(bsdf, wavelengths, estimator)
        except PluginFault as fault:
            raise _refused(bsdf, str(fault), _is_of_colours(str(fault))) from fault
        except Exception as error:
            # a plugin may raise anything
            frame, text = own_frame(error), " ".join(str(error).split())
            if missing := missing_method(error):
                raise SpecimenError(
                    f"the BSDF {class_of(bsdf)} must have the method {missing}"
                ) from error
            if frame is None and isinstance(error, RuntimeError):
                raise _refused(bsdf, text) from error
            if frame is None or not _is_of_colours(text):
                raise
            place = f"{os.path.basename(frame.file)}, line {frame.line}"
            said = f"{type(error).__name__} in {place}: {text}"
            raise _refused(bsdf, said) from error


def _refused(bsdf: Any, text: str, elsewhere: bool = True) -> SpecimenError:
    """Error of a BSDF, which may work `elsewhere`: in another variant."""
    kind = mi.variant().partition("_")[0]
    others = [one for one in usable_variants() if one.startswith(kind)]
    others = [one for one in others if one != mi.variant()]
    hint = f"; another variant may do ({', '.join(others)})" if elsewhere else ""
    return SpecimenError(
        f"the BSDF {class_of(bsdf)} fails in the variant {mi.variant()}: "
        f"{abridged(text, 200).rstrip('.')}{hint}"
    )


def _is_of_colours(text: str) -> bool:
    """Whether an error may be one of a variant without the plugin's colours."""
    return not mi.is_rgb and mi.Spectrum.__name__ in text


def _try(bsdf: Any, wavelengths: Any, estimator: str) -> None:
    """Call the methods once, as in a launch."""
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.uv = mi.Point2f(0.5)
    si.wi = mi.Vector3f(0.6, 0, 0.8)
    si.wavelengths = wavelengths
    ctx = mi.BSDFContext(mi.TransportMode.Importance)
    delta = mi.has_flag(bsdf.flags(), mi.BSDFFlags.Delta)
    if delta or estimator != "quadrature":
        random = mi.Float(0.5), mi.Point2f(0.5)
        checked_sample("sample", bsdf.sample(ctx, si, *random, mi.Bool(True)), 1)
    if estimator in ("quadrature", "next_event"):
        value = bsdf.eval(ctx, si, mi.Vector3f(0, 0.6, 0.8), mi.Bool(True))
        checked_answer("eval", value, 1, mi.Spectrum)


def class_of(plugin: Any) -> str:
    """Class of a plugin; one in Python has the class name of its base."""
    name = plugin.class_name()
    own = ("BSDF", "Texture", "Medium", "PhaseFunction")
    return type(plugin).__name__ if name in own else name

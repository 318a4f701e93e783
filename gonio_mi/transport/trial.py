"""A trial of each BSDF before rays are sent: what it raises is said in a sentence.

In the loop that follows rays through geometry, Dr.Jit would hide what it is.
"""

import drjit as dr
import mitsuba as mi

from ..errors import SpecimenError

__all__ = ["check_works", "class_of"]


def check_works(bsdfs, wavelengths, estimator):
    """Raise :class:`SpecimenError` if what `estimator` needs of a BSDF raises.

    One BSDF of each class is tried, with the `wavelengths` of a ray; what it answers is
    not looked at.
    """
    for bsdf in {class_of(bsdf): bsdf for bsdf in bsdfs}.values():
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.uv = mi.Point2f(0.5)
        si.wi = mi.Vector3f(0.6, 0, 0.8)
        si.wavelengths = wavelengths
        ctx = mi.BSDFContext(mi.TransportMode.Importance)
        sampled = mi.has_flag(bsdf.flags(), mi.BSDFFlags.Delta)
        method = "sample"
        try:
            if sampled or estimator != "quadrature":
                bsdf.sample(ctx, si, mi.Float(0.5), mi.Point2f(0.5), mi.Bool(True))
            if estimator in ("quadrature", "next_event"):
                method = "eval"
                bsdf.eval(ctx, si, mi.Vector3f(0, 0.6, 0.8), mi.Bool(True))
        except Exception as error:  # a plugin in Python may raise anything
            kind, said = type(error).__name__, " ".join(str(error).split())[:200]
            raise SpecimenError(
                f"{method}() of the BSDF {class_of(bsdf)} raises {kind} in the variant "
                f"{mi.variant()}: {said}"
            ) from error


def class_of(plugin):
    """Class of a BSDF or texture; one in Python has the class name of its base."""
    name = plugin.class_name()
    return type(plugin).__name__ if name in ("BSDF", "Texture") else name

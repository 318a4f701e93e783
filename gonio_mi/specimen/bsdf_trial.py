"""A trial of each BSDF before rays are sent: its exceptions become one sentence.

In the loop that follows rays through geometry, Dr.Jit would hide the error.
"""

import os
import re
from collections.abc import Callable, Iterable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..errors import SpecimenError, abridged, own_frame, warn
from ..variants import unpolarised_variants
from .scene_objects import class_of, traversed

# Parameters of Mitsuba's BSDFs that say how rough a surface is, and the largest value
# that each may have; and what `roughplastic` puts in place of smaller ones.
MAX_ROUGHNESS = {
    **dict.fromkeys(("alpha", "alpha_u", "alpha_v"), np.inf),
    "roughness": 1.0,
}
CLAMPED = np.float32(1e-4)

# From which alpha on microfacet models lose nearly all light: 97.6 and 98.9 per cent of
# a white conductor's (Beckmann, GGX; measured at 30 degrees).
STEEP = 4.0

# What a method that a plugin in Python does not have raises.
_PURE = re.compile(r"::(\w+)\(\)'\): tried to call a pure virtual function")


class PluginFault(Exception):  # noqa: N818
    """A function of the plugin gave no usable answer.

    Attributes
    ----------
    function : str
        Its name.
    what : str
        What it did, as the rest of a sentence.
    """

    def __init__(self, function: str, what: str) -> None:
        super().__init__(f"`{function}` {what}")
        self.function, self.what = function, what


def checked_sample(function: str, answer: Any, n: int) -> tuple[Any, Any]:
    """Mitsuba's record and the weight that ``sample`` answers for `n` rays.

    Its directions are one for each ray, if the answer has one for all of them.

    Raises
    ------
    PluginFault
        If they are of another type, or of another number.
    """
    bs, weight = checked_parts(function, answer, 2)
    if not isinstance(bs, mi.BSDFSample3f):
        raise PluginFault(function, f"must return a BSDFSample3f, got {_kind(bs)}")
    weight = checked_answer(function, weight, n, mi.Spectrum)
    _check_width(function, bs, n)
    if dr.width(bs.wo) < n:
        bs.wo = mi.Vector3f(bs.wo) + dr.opaque(mi.Vector3f, 0, n)
    return bs, weight


def checked_parts(function: str, answer: Any, n: int) -> tuple[Any, ...]:
    """Answer that must be a tuple of `n`, or a list, which Mitsuba takes, too."""
    if not isinstance(answer, (tuple, list)) or len(answer) != n:
        raise PluginFault(
            function, f"must return a tuple of {n} values, got {_kind(answer)}"
        )
    return tuple(answer)


def checked_answer(function: str, value: Any, n: int, kind: Any) -> Any:
    """Answer for `n` rays as a Dr.Jit array of the type `kind`."""
    # Mitsuba takes a list for a spectrum, too
    simple = isinstance(value, (int, float, list)) or dr.is_array_v(value)
    depth = dr.depth_v(value) if dr.is_array_v(value) else 0
    try:
        if not simple or depth > dr.depth_v(kind):
            raise TypeError
        value = kind(value)
    except (TypeError, RuntimeError):
        raise PluginFault(
            function, f"must return a {kind.__name__}, got {_kind(value)}"
        ) from None
    _check_width(function, value, n)
    return value


def _check_width(function: str, value: Any, n: int) -> None:
    width = dr.width(value)
    if width not in (1, n):
        rays = f"{n} or 1" if n > 1 else "1"
        raise PluginFault(
            function, f"must return one value per ray, {rays}, got {width}"
        )


def _kind(value: Any) -> str:
    if isinstance(value, (tuple, list)):
        return f"a {type(value).__name__} of {len(value)}"
    return type(value).__name__


def missing_method(error: BaseException) -> str | None:
    """Name of the method that a plugin in Python lacks, if an error says so."""
    found = _PURE.search(str(error))
    return found[1] if found else None


def check_works(
    bsdfs: Iterable[Any], wavelengths: Any, functions: Callable[[Any], set[str]]
) -> None:
    """Raise what a BSDF raises in the `functions` that an estimator needs of it.

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
            _try(bsdf, wavelengths, functions(bsdf))
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


def warn_of_roughness(bsdfs: Iterable[Any]) -> None:
    """Warn of roughnesses out of their range, which Mitsuba takes without a word."""
    said = set()
    for bsdf in bsdfs:
        parameters = traversed(bsdf)
        for key in parameters.properties:
            name = key.removesuffix(".value").removesuffix(".data")
            largest = MAX_ROUGHNESS.get(name.rpartition(".")[2])
            if largest is None:
                continue
            numbers = np.ravel(np.array(parameters[key], dtype=np.float32))
            right = (numbers >= 0) & (numbers <= largest)
            named = f"{name} of the BSDF {class_of(bsdf)}"
            if key == name and np.any(numbers == CLAMPED):
                sentence = (
                    f"{named} is {CLAMPED:g}: Mitsuba puts that in place of any "
                    "smaller number, negative ones too"
                )
            elif np.all(right) and not (largest == np.inf and max(numbers) > STEEP):
                continue
            elif np.all(right):
                sentence = (
                    f"{named} is {max(numbers):g}: facets so steep reflect next to no "
                    f"light in a single scattering event; above {STEEP:g} models of "
                    "microfacets are nearly black"
                )
            else:
                limits = "0 or more" if largest == np.inf else f"from 0 to {largest:g}"
                sentence = (
                    f"{named} must be {limits}, got {numbers[~right][0]:g}: Mitsuba "
                    "does not refuse it, and what is measured has another roughness"
                )
            if sentence not in said:
                said.add(sentence)
                warn(sentence)


def _refused(bsdf: Any, text: str, elsewhere: bool = True) -> SpecimenError:
    """Error of a BSDF, which may work `elsewhere`: in another variant."""
    kind = mi.variant().partition("_")[0]
    others = [one for one in unpolarised_variants() if one.startswith(kind)]
    others = [one for one in others if one != mi.variant()]
    hint = f"; another variant may do ({', '.join(others)})" if elsewhere else ""
    return SpecimenError(
        f"the BSDF {class_of(bsdf)} fails in the variant {mi.variant()}: "
        f"{abridged(text, 200).rstrip('.')}{hint}"
    )


def _is_of_colours(text: str) -> bool:
    """Whether an error may be one of a variant without the plugin's colours."""
    return not mi.is_rgb and mi.Spectrum.__name__ in text


def _try(bsdf: Any, wavelengths: Any, functions: set[str]) -> None:
    """Call the functions once, as in a launch."""
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.uv = mi.Point2f(0.5)
    si.wi = mi.Vector3f(0.6, 0, 0.8)
    si.wavelengths = wavelengths
    ctx = mi.BSDFContext(mi.TransportMode.Importance)
    if "sample" in functions:
        random = mi.Float(0.5), mi.Point2f(0.5)
        checked_sample("sample", bsdf.sample(ctx, si, *random, mi.Bool(True)), 1)
    if "eval" in functions:
        value = bsdf.eval(ctx, si, mi.Vector3f(0, 0.6, 0.8), mi.Bool(True))
        checked_answer("eval", value, 1, mi.Spectrum)

"""The form of what the functions of a BSDF answer: types, and one value per ray."""

import re
from typing import Any

import drjit as dr
import mitsuba as mi

__all__ = [
    "PluginFault",
    "checked_answer",
    "checked_parts",
    "checked_sample",
    "missing_method",
]

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
    return bs, weight


def checked_parts(function: str, answer: Any, n: int) -> tuple[Any, ...]:
    """Answer that must be a tuple of `n`."""
    if not isinstance(answer, tuple) or len(answer) != n:
        raise PluginFault(
            function, f"must return a tuple of {n} values, got {_kind(answer)}"
        )
    return answer


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

"""Parameters and parts of scene objects, for all that plugins in Python may raise."""

import traceback
from typing import Any

import mitsuba as mi

__all__ = ["traversed"]


def traversed(thing: Any) -> Any:
    """What ``mi.traverse`` answers, without what plugins say whose ``traverse`` raises.

    Mitsuba renders such a plugin, for it does not ask: many were written for a version
    in which the callback had other methods. It is as one without ``traverse`` then.

    Parameters
    ----------
    thing : mi.Object

    Returns
    -------
    mi.SceneParameters
    """
    try:
        return mi.traverse(thing)
    except Exception as error:
        # a plugin may raise anything
        kind = _culprit(error)
        if kind is None:
            raise
    own = kind.traverse
    kind.traverse = lambda *_: None
    try:
        return traversed(thing)  # there may be others
    finally:
        kind.traverse = own


def _culprit(error: BaseException) -> Any:
    """The class whose ``traverse`` raised; None if there is none, or one of ours."""
    found = None
    for frame, _ in traceback.walk_tb(error.__traceback__):
        owner = frame.f_locals.get("self")
        if frame.f_code.co_name == "traverse" and isinstance(owner, mi.Object):
            found = type(owner)
    if found is not None and found.__module__.startswith(__package__.split(".")[0]):
        return None
    bases = [] if found is None else found.__mro__
    return next((base for base in bases if "traverse" in vars(base)), None)

"""The specimen of the last measurement, kept while nothing of it changes.

A measurement loads its specimen, describes it, tries it and computes its digest. If the
next one is given the same, only the digest is computed again and compared.
"""

from __future__ import annotations

import hashlib
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..errors import warned
from ..kernels import registered_by_others
from ..surfaces.height_maps import is_height_map
from .loading import period_of, plugin_files, specimen_of, surface_specimen
from .shapes import kept
from .specimen import Specimen
from .specimen_text import SpecimenLike

# Words of a dictionary that stand for no plugin.
WORDS = {"scene", "rgb", "spectrum", "ref"}

# Data of Mitsuba's that a material names.
DATA = "data/ior/{}.eta.spd", "data/ior/{}.k.spd"


class _CannotTell(Exception):  # noqa: N818
    """It cannot be determined whether a later call would load the same."""


class _Same:
    """Wrapper that compares objects by identity."""

    def __init__(self, thing: mi.Object) -> None:
        self.thing = thing

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and self.thing is other.thing

    __hash__ = None  # type: ignore[assignment]


@dataclass(frozen=True, eq=False)
class Kept:
    """A specimen, and the data to check that it is still up to date.

    Attributes
    ----------
    given : object
        Content of what it was loaded from.
    period : object
        In effect: given, or of the scene's integrator.
    specimen : Specimen
    parts : list of mi.Object
        Every object it contains.
    """

    given: Any
    period: Any
    specimen: Specimen
    parts: list[mi.Object]

    def is_same(self, given: Any, period: Any) -> bool:
        """Whether loading again would give the same specimen."""
        specimen = self.specimen
        if self.given != given or period_of(specimen.source, period) != self.period:
            return False
        digest, parts = specimen.state()
        return digest == specimen.digest and [*map(id, parts)] == [*map(id, self.parts)]


@contextmanager
def loaded_once(
    specimen: SpecimenLike | Specimen,
    parameters: dict[str, Any] | None = None,
    period: Any = None,
) -> Iterator[Specimen]:
    """Context with the specimen of :func:`.specimen_of`, or with it as it was kept.

    It is kept if the context, in which it is tried, gives no error and no warning:
    these are given each time; what Mitsuba logs of it, once. There is one at most, for
    the thread that loaded it, until something else is loaded or there is an error.
    Never kept are scene files; specimens with others' Python plugins, whose loading and
    trial may have side effects; and anything else whose reloading cannot be predicted.

    Parameters
    ----------
    specimen, parameters, period
        Those of :func:`.specimen_of`.
    """
    if isinstance(specimen, Specimen):
        yield specimen
        return
    try:
        # Dr.Jit 1.5 refuses what another thread has recorded and not yet evaluated
        where = mi.variant(), threading.get_ident()
        given = None if parameters else (*where, _given(specimen, period))
    except _CannotTell:
        given = None
    known = kept.pop() if kept else None
    if known is None or given is None or not known.is_same(given, period):
        known = None
    before = warned()
    one = known.specimen if known else specimen_of(specimen, parameters, period)
    yield one
    if warned() == before:
        known = known or _to_keep(given, one)
        kept[:] = [known] if known else []


def _to_keep(given: Any, specimen: Specimen) -> Kept | None:
    """Specimen to keep with the content it was loaded from; None if it cannot be."""
    if given is None or specimen.holds_foreign:
        return None
    parts = specimen.state()[1]
    among = {id(specimen.source), *map(id, parts)}
    if not all(id(thing) in among for thing in _objects(given)):
        return None  # it was copied into others
    return Kept(given, specimen.period, specimen, parts)


def _given(specimen: SpecimenLike, period: Any) -> Any:
    """Content of a specimen: of a dictionary, an object, or a file of heights."""
    if not isinstance(specimen, (str, os.PathLike)):
        return _content(specimen)
    if not (os.path.isfile(specimen) and is_height_map(Path(specimen))):
        raise _CannotTell
    return str(specimen), _content(surface_specimen(specimen, period=period))


def _objects(content: Any) -> Iterator[mi.Object]:
    """Yield the objects in a content."""
    if isinstance(content, _Same):
        yield content.thing
    elif isinstance(content, tuple):
        for one in content:
            yield from _objects(one)


def _content(value: Any) -> Any:
    """Comparable copy of a value; Mitsuba's objects compare by identity.

    Raise _CannotTell for values that may load differently although they are equal.
    """
    if isinstance(value, dict):
        _check_plugin(value.get("type"))
        items = ((key, _content(one)) for key, one in value.items())
        files = map(_content_of_files, value.items())
        return (*items, *files)
    if value is None or type(value) in (bool, int, str):
        return type(value), value
    if type(value) is float:
        return repr(value)  # tells zeros apart, and NaN equals itself
    if type(value) in (list, tuple):
        return type(value), *map(_content, value)
    if isinstance(value, mi.Object):
        return _Same(value)
    if type(value) is np.ndarray or isinstance(value, np.generic):
        return _numbers(value)
    if dr.is_array_v(value):
        return _numbers(value)
    if "Transform" in type(value).__name__ and _is_of_mitsuba(value):
        return tuple(map(_numbers, (value.matrix, value.inverse_transpose)))
    raise _CannotTell


def _is_of_mitsuba(value: Any) -> bool:
    """Whether a class of Mitsuba's has made it."""
    return type(value).__module__.partition(".")[0] == "mitsuba"


def _numbers(value: Any) -> Any:
    """Types and digest of an array of numbers."""
    array = np.ascontiguousarray(value)
    if array.dtype.hasobject or (dr.is_array_v(value) and dr.grad_enabled(value)):
        raise _CannotTell
    digest = hashlib.sha256(array.tobytes()).digest()
    return type(value), array.dtype.str, array.shape, digest


def _check_plugin(name: Any) -> None:
    """Raise _CannotTell unless a plugin is one of Mitsuba's or ours.

    Others may be arbitrary functions. So may any plugin once others have registered
    their own under a name of Mitsuba's or ours.
    """
    known = _known_plugins()
    if not (isinstance(name, str) and name in known):
        raise _CannotTell
    if not registered_by_others.isdisjoint(known):
        raise _CannotTell


@cache
def _known_plugins() -> frozenset[str]:
    return frozenset(WORDS | plugin_files().keys())


def _content_of_files(item: tuple[str, Any]) -> Any:
    """Digests of the files that a string in a dictionary may refer to."""
    key, value = item
    if not isinstance(value, str) or key in ("type", "id"):
        return ()
    names = [value, *(name.format(value) for name in DATA)]
    try:
        value.encode()  # Mitsuba writes on standard error that it cannot
        found = (Path(str(mi.file_resolver().resolve(name))) for name in names)
        paths = dict.fromkeys([Path(value), *found])
        texts = [path.read_bytes() for path in paths if path.is_file()]
    except (OSError, TypeError, ValueError):  # of a name that no file has
        raise _CannotTell from None
    return tuple(hashlib.sha256(text).digest() for text in texts)

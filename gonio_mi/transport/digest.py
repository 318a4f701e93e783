"""Digests that tell specimens, emitters and their geometry from others."""

from __future__ import annotations

import hashlib
import re
import weakref
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from .traversal import traversed

__all__ = ["digest", "emitter_digest", "specimen_digest"]

# Enough that no two specimens of anybody's share it.
LENGTH = 16

# What Python writes of an object without a text of its own.
ADDRESS = re.compile(r"\b0x[0-9a-fA-F]+")
FILE = re.compile(r'filename ?= ?"?([^",\]\n]+)')

_known: weakref.WeakKeyDictionary[Any, str] = weakref.WeakKeyDictionary()


def specimen_digest(specimen: Any) -> str:
    """:func:`digest` of the shapes of a :class:`Specimen`, which is taken once."""
    if specimen not in _known:
        shapes = specimen.scene.shapes()
        if specimen.groups:
            shapes = [*shapes, *specimen.groups, *specimen.surfaces]
        _known[specimen] = digest(shapes)
    return _known[specimen]


def emitter_digest(emitters: Iterable[mi.Emitter]) -> str:
    """:func:`digest` of emitters, or of the shapes that are some."""
    return digest(emitter.get_shape() or emitter for emitter in emitters)


def digest(things: Iterable[Any], geometry: bool = False) -> str:
    """Digest of shapes or other objects of a scene, in any order.

    Of their Mitsuba texts, all parameters that ``mi.traverse`` gives (geometry, the
    data of bitmaps, spectra), the boxes that bound them, and the content of files that
    a text names by a path. The same in every process. What none of these shows is not
    seen: the filter and wrap modes of bitmaps, the data of Mitsuba's ``measured``, and
    what a plugin in Python keeps to itself.

    Parameters
    ----------
    things : iterable of mi.Object
    geometry : bool
        Only the shapes' own parameters, in this order, without texts, BSDFs and
        emitters.

    Returns
    -------
    str
        Of 16 hexadecimal digits.
    """
    each = [_digest_of(thing, geometry) for thing in things]
    if not geometry:
        each.sort()
    return hashlib.sha256("".join(each).encode()).hexdigest()[:LENGTH]


def _digest_of(thing: Any, geometry: bool) -> str:
    """SHA-256 of one object, hexadecimal."""
    found = hashlib.sha256()
    if not geometry:
        for text in _texts(thing):
            found.update(ADDRESS.sub("", text).encode())
            for path in map(Path, FILE.findall(text)):
                if path.is_file():
                    found.update(path.read_bytes())
    parameters = traversed(thing)
    # the order of keys is not that of another process
    for key in sorted(parameters.properties):
        handle, _, node, *_ = parameters.properties[key]
        # a parameter that was not given has no value to ask for
        if handle is not None and (not geometry or isinstance(node, mi.Shape)):
            value = parameters[key]
            array = np.ascontiguousarray(getattr(value, "matrix", value))
            if array.dtype == object:
                array = np.array(ADDRESS.sub("", str(value)))[None]
            found.update(f"{key} {array.dtype} {array.shape}".encode())
            found.update(array.view(np.uint8).data if array.size else b"")
    return found.hexdigest()


def _texts(thing: Any) -> Iterator[str]:
    """What Mitsuba says of an object, and for a shape of its box and its BSDF."""
    yield _text(thing)
    if isinstance(thing, mi.Shape):
        yield str(thing.bbox())
        if thing.bsdf() is not None:
            yield _text(thing.bsdf())


def _text(thing: Any) -> str:
    """Class and Mitsuba's text of an object, if all that it holds has one."""
    name = type(thing).__qualname__
    try:
        return f"{name} {thing}"
    except Exception:  # one of them is a plugin in Python, which may raise anything
        return f"{name} {thing.class_name()}"

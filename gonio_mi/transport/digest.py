"""Digests that tell specimens, emitters and their geometry from others."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .plugin_digest import foreign_plugins
from .traversal import traversed

__all__ = ["digest", "emitter_digest"]

# Enough that no two specimens of anybody's share it.
LENGTH = 16

# What Python writes of an object without a text of its own.
ADDRESS = re.compile(r"\b0x[0-9a-fA-F]+")
FILE = re.compile(r'filename ?= ?"?([^",\]\n]+)')


def emitter_digest(emitters: Iterable[mi.Emitter]) -> str:
    """:func:`digest` of emitters, or of the shapes that are some."""
    return digest(emitter.get_shape() or emitter for emitter in emitters)


def digest(things: Iterable[Any], geometry: bool = False) -> str:
    """Digest of shapes or other objects of a scene, in any order.

    Of their Mitsuba texts, all parameters that ``mi.traverse`` gives (geometry, the
    data of bitmaps, spectra), the boxes that bound them, the content of files that a
    text names by a path, and the attributes of others' plugins in Python that are
    numbers, texts, arrays or objects of a scene. The same in every process. What none
    of these shows is not seen: the filter and wrap modes of bitmaps, the data of
    Mitsuba's ``measured``, and what else a plugin in Python keeps to itself.

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
        for plugin in foreign_plugins(thing):
            for name, value in sorted(vars(plugin).items()):
                found.update(name.encode() + b"".join(_state(value)))
    for part in _parameters(thing, geometry):
        found.update(part)
    return found.hexdigest()


def _parameters(thing: Any, geometry: bool = False) -> Iterator[bytes]:
    """Names and values of all that ``mi.traverse`` gives, or of the shapes' own."""
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
            yield f"{key} {array.dtype} {array.shape}".encode()
            yield array.tobytes()


def _state(value: Any) -> Iterator[bytes]:
    """What an attribute of a plugin adds to a digest; nothing of other objects.

    A file is what it holds: it may be elsewhere on another machine.
    """
    if isinstance(value, (list, tuple)):
        for one in value:
            yield from _state(one)
    elif isinstance(value, (str, Path)) and os.path.isfile(value):
        yield Path(value).read_bytes()
    elif isinstance(value, (bool, int, float, complex, str, bytes, np.generic)):
        yield ADDRESS.sub("", repr(value)).encode()
    elif isinstance(value, np.ndarray) or dr.is_array_v(value):
        try:
            array = np.array(value)
        except RuntimeError:  # of a variable that was left behind in a recorded loop
            return
        if array.dtype != object:
            yield f"{array.dtype} {array.shape}".encode()
            yield array.tobytes()
    elif isinstance(value, mi.Object):
        yield ADDRESS.sub("", _text(value)).encode()
        yield from _parameters(value)


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

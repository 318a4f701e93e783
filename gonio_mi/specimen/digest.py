"""Digests of specimens, emitters, geometry, and the code of plugins in Python."""

from __future__ import annotations

import hashlib
import inspect
import linecache
import os
import re
import sys
import weakref
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from importlib.util import decode_source
from os import PathLike
from pathlib import Path
from types import FunctionType
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..errors import is_installed
from .scene_objects import foreign_plugins, held_objects, is_foreign, traversed

# Enough that no two specimens of anybody's share it.
LENGTH = 16

# What Python writes of an object without a text of its own.
ADDRESS = re.compile(r"\b0x[0-9a-fA-F]+")
# Of a mesh that is no emitter, only once it was asked for.
AREA = re.compile(r"\n *surface_area = .*")
# Import statements, with what stands in parentheses or after a backslash.
IMPORT = re.compile(
    r"^[ \t]*(?:from|import)\b(?:[^\n(\\]*\([^)]*\)|(?:\\\n|[^\n])*)", re.MULTILINE
)
FILE = re.compile(r'filename ?= ?"?([^",\]\n]+)')


def emitter_digest(emitters: Iterable[mi.Emitter]) -> str:
    """:func:`digest` of emitters, or of the shapes that are some."""
    return digest(emitter.get_shape() or emitter for emitter in emitters)


def digest(things: Iterable[Any]) -> str:
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

    Returns
    -------
    str
        Of 16 hexadecimal digits.
    """
    each = (
        _object_digest(thing, foreign_plugins(thing), traversed(thing))
        for thing in things
    )
    return _joined(each)


def digest_and_parts(things: Iterable[mi.Object]) -> tuple[str, list[mi.Object]]:
    """:func:`digest` of things without others' Python plugins, and their parts.

    The parts are all objects that ``mi.traverse`` visits. It takes half as long.
    """
    each, parts = [], list[mi.Object]()
    for thing in things:
        parameters = traversed(thing)
        each.append(_object_digest(thing, (), parameters))
        parts += parameters.hierarchy
    return _joined(each), parts


def _joined(each: Iterable[str]) -> str:
    """Digest of digests in any order."""
    joined = "".join(sorted(each))
    return hashlib.sha256(joined.encode()).hexdigest()[:LENGTH]


def geometry_hash(shapes: Iterable[mi.Shape]) -> int:
    """Hash of the shapes' own parameters, in this order, without BSDF and emitter.

    Of this process alone, and faster than a digest.
    """
    parts = (
        part for shape in shapes for part in _parameters(traversed(shape), mi.Shape)
    )
    return hash(tuple(map(hash, parts)))


def _object_digest(thing: Any, foreign: Iterable[mi.Object], parameters: Any) -> str:
    """SHA-256 of one object, hexadecimal, from its traversed `parameters`."""
    found = hashlib.sha256()
    for text in _texts(thing):
        found.update(ADDRESS.sub("", text).encode())
        for path in map(Path, FILE.findall(text)):
            if path.is_file():
                found.update(path.read_bytes())
    for plugin in foreign:
        for name, value in sorted(vars(plugin).items()):
            found.update(name.encode() + b"".join(_state(value)))
    for part in _parameters(parameters):
        found.update(part)
    return found.hexdigest()


def _parameters(parameters: Any, kind: type = object) -> Iterator[bytes]:
    """Names and values of what ``mi.traverse`` gives, of objects of some `kind`."""
    # the order of keys is not that of another process
    for key in sorted(parameters.properties):
        handle, _, node, *_ = parameters.properties[key]
        # a parameter that was not given has no value to ask for
        if handle is not None and isinstance(node, kind):
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
        yield from _parameters(traversed(value))


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
        text = f"{name} {thing}"
    except Exception:  # one of them is a plugin in Python, which may raise anything
        return f"{name} {thing.class_name()}"
    by_area = not isinstance(thing, mi.Mesh) or thing.is_emitter()
    return text if by_area else AREA.sub("", text)


# Scripts and notebooks, also in a process that they started: they change for many
# reasons, so only what a class says itself counts.
SCRIPTS = ("__main__", "__mp_main__")

_known: weakref.WeakKeyDictionary[type, frozenset[str]] = weakref.WeakKeyDictionary()


def kinds_of(things: Iterable[mi.Object]) -> set[type]:
    """Classes of scene objects and of everything they contain."""
    return {type(held) for thing in things for held in held_objects(thing)}


def plugins_digest(kinds: Iterable[type]) -> str | None:
    """Digest of the plugins in Python among classes of objects of a scene.

    Of the files that define their classes and of the local files and packages that
    import statements name there, as they were when a class was first met; for a class
    of a script or a notebook of the texts of its methods and its plain values. What is
    not seen: modules imported under computed names, data files, and a module that was
    edited after it was imported.

    Parameters
    ----------
    kinds : iterable of type
        Of :func:`kinds_of`.

    Returns
    -------
    str or None
        16 hexadecimal digits; None if there is no such plugin, or none whose text can
        be found.
    """
    texts: set[str] = set()
    for kind in set(kinds):
        if kind not in _known:
            _known[kind] = frozenset(_class_texts(kind))
        texts |= _known[kind]
    return _text_digest(texts) if texts else None


def file_digest(path: str | PathLike[str]) -> str:
    """Digest of a Python file and of the local files that it names to import."""
    path = Path(path)
    text = decode_source(path.read_bytes())
    return _text_digest({text, *_imported(text, path)})


def _text_digest(texts: Iterable[str]) -> str:
    each = sorted(hashlib.sha256(text.encode()).hexdigest() for text in texts)
    return hashlib.sha256("".join(each).encode()).hexdigest()[:LENGTH]


def _class_texts(kind: type) -> Iterator[str]:
    """Texts that define a class and its bases."""
    for base in kind.__mro__:
        if not is_foreign(base):
            continue
        functions = [function for _, function in sorted(_functions(base))]
        if base.__module__ in SCRIPTS:
            plain = (bool, int, float, str, tuple)
            yield repr([v for v in vars(base).items() if isinstance(v[1], plain)])
            for function in functions:
                with suppress(OSError, TypeError):  # typed into a console
                    yield inspect.getsource(function)
            continue
        for name in {function.__code__.co_filename for function in functions}:
            # as it was when it was first read, by a traceback or for a digest
            text = "".join(linecache.getlines(name))
            if text:
                yield text
                yield from _imported(text, Path(name))


def _functions(kind: type) -> Iterator[tuple[str, FunctionType]]:
    """Names and functions that the body of a class defines."""
    for name, value in vars(kind).items():
        wrapped = (getattr(value, key, None) for key in ("__func__", "fget"))
        for function in (value, *wrapped):
            if isinstance(function, FunctionType):
                yield name, function


def _imported(text: str, path: Path) -> Iterator[str]:
    """Texts of the local files and packages that import statements name."""
    todo, seen = [(text, path.resolve())], {path.resolve()}
    while todo:
        text, path = todo.pop()
        folders = [path.parent, *(Path(one).resolve() for one in sys.path)]
        folders += path.parents[1:2]  # of a package, whose modules are named by dots
        words = re.findall(r"[\w.]+", " ".join(IMPORT.findall(text)))
        for name in sorted({word.strip(".") for word in words} - {""}):
            for found in _files(name.split("."), folders):
                if found not in seen and not is_installed(found):
                    seen.add(found)
                    content = found.read_text("utf-8", errors="replace")
                    todo.append((content, found))
                    yield content


def _files(parts: Sequence[str], folders: Iterable[Path]) -> list[Path]:
    """Files of a module and of the packages it is in, in the first folder with any."""
    for folder in folders:
        places = [folder.joinpath(*parts[: i + 1]) for i in range(len(parts))]
        if not is_installed(places[0]):
            files = [file for place in places for file in place.glob("*.py")]
            files += [place.with_name(f"{place.name}.py") for place in places]
            if found := [file.resolve() for file in files if file.is_file()]:
                return sorted(found)
    return []

"""Digests of plugins in Python: of the text that says what they do."""

import ast
import hashlib
import inspect
import linecache
import sys
import weakref
from collections.abc import Iterable, Iterator
from importlib.machinery import PathFinder
from os import PathLike
from pathlib import Path
from types import FunctionType

import mitsuba as mi

from ..errors import is_installed
from .traversal import traversed

__all__ = [
    "file_digest",
    "foreign_plugins",
    "holds_foreign_plugins",
    "plugins_digest",
]

LENGTH = 16

# Packages whose versions a record names.
VERSIONED = ("builtins", "drjit", "gonio_mi", "mitsuba", "nanobind")

# Scripts and notebooks, also in a process that they started: they change for many
# reasons, so only what a class says itself counts.
SCRIPTS = ("__main__", "__mp_main__")

_known: weakref.WeakKeyDictionary[type, frozenset[str]] = weakref.WeakKeyDictionary()


def plugins_digest(things: Iterable[mi.Object]) -> str | None:
    """Digest of the plugins in Python among objects of a scene and what they hold.

    Of the files that define their classes and of the local files that these import by
    an import statement, as they were when a class was first met; for a class of a
    script or a notebook of the texts of its methods and its plain values. What is not
    seen: modules imported under computed names, data files, and a module that was
    edited after it was imported.

    Parameters
    ----------
    things : iterable of mi.Object

    Returns
    -------
    str or None
        16 hexadecimal digits; None if there is no such plugin, or none whose text can
        be found.
    """
    texts: set[str] = set()
    for kind in {type(held) for thing in things for held in _held(thing)}:
        if kind not in _known:
            _known[kind] = frozenset(_texts(kind))
        texts |= _known[kind]
    return _digest(texts) if texts else None


def foreign_plugins(thing: mi.Object) -> list[mi.Object]:
    """Plugins in Python of others that an object of a scene is, or holds."""
    return [held for held in _held(thing) if _is_foreign(type(held))]


def holds_foreign_plugins(thing: mi.Object) -> bool:
    """Whether there is one of :func:`foreign_plugins`.

    What only has the methods of a BSDF, as a verdict's integrand, holds none.
    """
    return isinstance(thing, mi.Object) and bool(foreign_plugins(thing))


def _is_foreign(kind: type) -> bool:
    return kind.__module__.split(".")[0] not in VERSIONED


def file_digest(path: str | PathLike[str]) -> str:
    """Digest of a Python file and of the local files that it imports."""
    path = Path(path)
    return _digest({path.read_text(), *_imported(path.read_text(), path)})


def _digest(texts: Iterable[str]) -> str:
    each = sorted(hashlib.sha256(text.encode()).hexdigest() for text in texts)
    return hashlib.sha256("".join(each).encode()).hexdigest()[:LENGTH]


def _held(thing: mi.Object) -> Iterator[mi.Object]:
    """Yield an object of a scene and all that it holds, as far as it says so."""
    todo: list[mi.Object | None] = [thing]
    seen: set[int] = set()
    while todo:
        held = todo.pop()
        if held is None or id(held) in seen:
            continue
        seen.add(id(held))
        yield held
        todo += traversed(held).hierarchy
        if isinstance(held, mi.Shape):
            todo.append(held.bsdf())
        own = vars(held).values() if hasattr(held, "__dict__") else ()
        todo += (value for value in own if isinstance(value, mi.Object))


def _texts(kind: type) -> Iterator[str]:
    """Texts that define a class and its bases."""
    for base in kind.__mro__:
        if not _is_foreign(base):
            continue
        functions = [function for _, function in sorted(_functions(base))]
        if base.__module__ in SCRIPTS:
            plain = (bool, int, float, str, tuple)
            yield repr([v for v in vars(base).items() if isinstance(v[1], plain)])
            for function in functions:
                yield from _source(function)
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


def _source(function: FunctionType) -> Iterator[str]:
    try:
        yield inspect.getsource(function)
    except (OSError, TypeError):  # typed into a console
        return


def _imported(text: str, path: Path) -> Iterator[str]:
    """Texts of the local files that a Python text imports, directly or not."""
    todo, seen = [(text, path)], {path.resolve()}
    while todo:
        text, path = todo.pop()
        for name, folder in _imports(text, path):
            for found in _files(name, folder):
                if found not in seen and not is_installed(found):
                    seen.add(found)
                    content = found.read_text(errors="replace")
                    todo.append((content, found))
                    yield content


def _imports(text: str, path: Path) -> Iterator[tuple[str, list[str]]]:
    """Dotted names that a text imports, and where to look for the first of them."""
    try:
        tree = ast.parse(text)
    except (SyntaxError, ValueError):
        return
    anywhere = [str(path.resolve().parent), *sys.path]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, anywhere) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            folder = [str(path.parents[node.level - 1])] if node.level else anywhere
            module = [node.module] if node.module else []
            for alias in node.names:
                yield ".".join([*module, alias.name]), folder


def _files(name: str, folder: list[str]) -> Iterator[Path]:
    """Files of a module and of the packages it is in; of as many as there are."""
    first, _, rest = name.partition(".")
    try:
        spec = PathFinder.find_spec(first, folder)
    except (ImportError, ValueError):
        return
    if spec is None:
        return
    if spec.origin and spec.origin.endswith(".py"):
        yield Path(spec.origin).resolve()
    if rest and spec.submodule_search_locations:
        yield from _files(rest, list(spec.submodule_search_locations))

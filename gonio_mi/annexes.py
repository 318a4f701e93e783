"""Annexes, which stand on the core; and names that are imported when they are used.

The ``__init__`` of a package is its door. ``OFFERS`` says in which module each name is
that others ask for: packages below this one, which may not import it, and users of a
package that must be imported quickly. The door of an annex also has ``COMMANDS``, the
summary of each command by its name, a module of the annex's ``commands``; and
``PLUGINS``, the family of each Mitsuba plugin by the name of its module. The core
imports no annex in any other way, and does without those that are missing.
"""

import functools
import importlib
import sys
from collections.abc import Iterator
from types import ModuleType
from typing import Any

from .errors import SettingError

# Each may import from those before it.
ANNEXES = ("materials", "exchange", "analysis", "validation")


@functools.cache
def is_missing(module: str) -> bool:
    """Whether the annex of a module, such as ``"exchange.formats"``, is not there.

    An empty folder is no annex.
    """
    name = module.partition(".")[0]
    if name not in ANNEXES:
        return False
    import importlib.util

    spec = importlib.util.find_spec(f".{name}", __package__)
    return spec is None or spec.origin is None


def doors() -> Iterator[tuple[str, ModuleType]]:
    """Qualified names and doors of the annexes that are there."""
    for annex in ANNEXES:
        if not is_missing(annex):
            name = f"{__package__}.{annex}"
            yield name, importlib.import_module(name)


def check_there(annex: str, what: str) -> None:
    """Raise SettingError with a sentence if `what` needs an annex that is missing."""
    if is_missing(annex):
        raise SettingError(
            f"{what} needs the part {annex} of {__package__}, which is not installed"
        )


# No default.
REQUIRED = object()


def ask(package: str, name: str, default: Any = REQUIRED) -> Any:
    """Import what a package offers under a name; the default if it is a missing annex.

    Raises
    ------
    SettingError
        If the annex is missing, and there is no default.
    """
    if is_missing(package) and default is not REQUIRED:
        return default
    check_there(package, name)
    return _offered(importlib.import_module(f".{package}", __package__), name)


def attribute(door: str, name: str) -> Any:
    """Public name of a package, for its ``__getattr__``: imported when first used."""
    package = sys.modules[door]
    if name not in package.OFFERS:
        raise AttributeError(f"module {door!r} has no attribute {name!r}")
    value = _offered(package, name)
    setattr(package, name, value)
    return value


def _offered(door: ModuleType, name: str) -> Any:
    module = importlib.import_module(f".{door.OFFERS[name]}", door.__name__)
    return getattr(module, name)

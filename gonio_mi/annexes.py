"""Annexes: folders that stand on the core, which asks for what is there.

The ``__init__`` of each is its door: ``COMMANDS`` has the summary of each command by
its name, a module of the annex's ``commands``; ``PLUGINS`` names modules of Mitsuba
plugins; ``OFFERS`` says in which module what the core asks for is. The core imports
none of them in any other way, and does without those that are missing.
"""

import functools
import importlib
import importlib.util
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


def ask(annex: str, name: str, default: Any = REQUIRED) -> Any:
    """What an annex offers under a name; the default if the annex is missing.

    Raises
    ------
    SettingError
        If the annex is missing, and there is no default.
    """
    if is_missing(annex) and default is not REQUIRED:
        return default
    check_there(annex, name)
    door = importlib.import_module(f".{annex}", __package__)
    module = importlib.import_module(f".{door.OFFERS[name]}", door.__name__)
    return getattr(module, name)

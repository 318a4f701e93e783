"""A virtual goniophotometer for Mitsuba 3.

``import gonio_mi as gonio`` makes a usable LLVM visible to Dr.Jit and registers the
instrument's Mitsuba plugins, before or after ``mi.set_variant``. It never sets a
variant. What it offers is imported when it is first used.
"""

import ast
from pathlib import Path
from typing import Any

from . import start_up

start_up.begin()

from . import llvm  # noqa: E402
from .annexes import attribute, is_missing  # noqa: E402

llvm.prepare()

if start_up.needs_mitsuba():
    try:
        from .loops import mitsubas_made_late

        with mitsubas_made_late():
            from . import plugins  # noqa: F401
    except NameError as error:
        start_up.name_missing_library(error)
        raise

# The stub for type checkers says which module each public name is of.
_stub = ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
OFFERS = {
    name.name: statement.module
    for statement in _stub.body
    if isinstance(statement, ast.ImportFrom)
    for name in statement.names
    if not is_missing(statement.module or "")
}

__all__ = sorted(OFFERS)


def __getattr__(name: str) -> Any:
    """Import a public name; ``__version__`` is that of the installed package."""
    if name == "__version__":
        from importlib import metadata  # slow to import

        return metadata.version("gonio-mi")
    return attribute(__name__, name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})

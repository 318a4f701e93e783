"""A virtual goniophotometer for Mitsuba 3.

``import gonio_mi as gonio`` makes a usable LLVM visible to Dr.Jit and registers the
instrument's Mitsuba plugins, before or after ``mi.set_variant``. It never sets a
variant. What it offers is imported when it is first used.
"""

import functools
from typing import Any

from . import start_up
from .version import __version__ as __version__

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


@functools.cache
def _offers() -> dict[str, str]:
    """Module of each public name, as the stub for type checkers says."""
    import ast
    from pathlib import Path

    stub = ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    return {
        name.name: statement.module or ""
        for statement in stub.body
        if isinstance(statement, ast.ImportFrom)
        for name in statement.names
        if not is_missing(statement.module or "")
    }


def __getattr__(name: str) -> Any:
    """Import a public name on first access."""
    if name == "OFFERS":
        return _offers()
    if name == "__all__":
        return sorted(_offers())
    return attribute(__name__, name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_offers()})

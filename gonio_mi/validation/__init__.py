"""Whether a BSDF plugin is right, and which of its functions is wrong.

One flat BSDF at one incident direction is all that is needed: its functions are asked
about the same directions, and what they answer is compared.
"""

import importlib
from typing import Any

COMMANDS = {
    "validate": "Examine a BSDF plugin, and say which function is wrong.",
    "diff": "Compare what two Mitsuba versions say of the same BSDF.",
    "conformance": "Ask Mitsuba's own plugins under several versions, as a page.",
}
PLUGINS: tuple[str, ...] = ()
OFFERS: dict[str, str] = {}

# Public names by module.
_module_of = {
    "POLARISED": "questions",
    "PROPERTIES": "questions",
    "Property": "verdict",
    "Verdict": "verdict",
    "check_report": "verdict_page",
    "draw": "verdict_page",
    "from_numpy": "numpy_bsdf",
    "reproducer": "reproducers",
    "save_report": "verdict_page",
    "validate": "examination",
}
__all__ = [*_module_of]


def __getattr__(name: str) -> Any:
    """Import a public name when it is used: the door itself needs no renderer."""
    if name not in _module_of:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = importlib.import_module(f".{_module_of[name]}", __name__)
    globals()[name] = value = getattr(module, name)
    return value

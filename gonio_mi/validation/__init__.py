"""Whether a BSDF plugin is right, and which of its functions is wrong.

One flat BSDF at one incident direction is all that is needed: its functions are asked
about the same directions, and what they answer is compared.
"""

from typing import Any

from ..annexes import attribute

COMMANDS = {
    "validate": "Examine a BSDF plugin, and say which function is wrong.",
    "diff": "Compare what two Mitsuba versions say of the same BSDF.",
    "conformance": "Ask Mitsuba's own plugins under several versions, as a page.",
}
PLUGINS: dict[str, str] = {}
OFFERS = {
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
    "verdict_view": "verdict_page",
}
# all but what a verdict itself asks for
__all__ = sorted({*OFFERS} - {"verdict_view"})


def __getattr__(name: str) -> Any:
    """Import a public name when it is used: the door itself needs no renderer."""
    return attribute(__name__, name)

"""Examples on the manual pages of plugins: each is declared once, in both forms."""

from __future__ import annotations

import textwrap
from collections.abc import Callable
from typing import Any, TypeVar

Plugin = TypeVar("Plugin", bound=Callable[..., Any])

TABS = """
.. tabs::
    .. code-tab:: xml

{xml}

    .. code-tab:: python

{python}
"""

# Tags of a scene file, by the type of a value.
TAGS = {float: "float", int: "integer", str: "string"}


def example(family: str, plugin: str, **values: Any) -> Callable[[Plugin], Plugin]:
    """Decorator that ends a plugin's docstring with an example of its use.

    Parameters
    ----------
    family : str
        Of Mitsuba's plugins, such as ``bsdf``.
    plugin : str
        Its name.
    **values
        Properties: numbers, texts, and dictionaries of nested plugins, whose keys are
        their families.
    """
    content = [f"'type': '{plugin}'", *(f"{k!r}: {x!r}" for k, x in values.items())]
    tabs = TABS.format(
        xml=textwrap.indent("\n".join(_element(family, plugin, values)), " " * 8),
        python=textwrap.indent(",\n".join(content), " " * 8),
    )

    def _add(described: Plugin) -> Plugin:
        text = (described.__doc__ or "").rstrip()
        described.__doc__ = f"{text}\n{textwrap.indent(tabs, ' ' * 4)}    "
        return described

    return _add


def _element(family: str, plugin: str, values: dict[str, Any]) -> list[str]:
    """Lines of the element of a scene file."""
    lines = []
    for name, value in values.items():
        if isinstance(value, dict):
            nested = {key: x for key, x in value.items() if key != "type"}
            lines.append(
                "".join(x.strip() for x in _element(name, value["type"], nested))
            )
        else:
            lines.append(f'<{TAGS[type(value)]} name="{name}" value="{value}"/>')
    if not lines:
        return [f'<{family} type="{plugin}"/>']
    inner = [f"    {line}" for line in lines]
    return [f'<{family} type="{plugin}">', *inner, f"</{family}>"]

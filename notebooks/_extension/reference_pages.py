"""Directives that turn what the code says of itself into pages of reference.

``gonio-plugins`` renders the manual pages of the Mitsuba plugins, written as Mitsuba's
own are; ``gonio-commands`` the help of all commands.
"""

import importlib
import inspect
import re
from typing import Any

from docutils import nodes
from docutils.parsers.rst import Directive, roles
from docutils.statemachine import StringList

VARIANT = "llvm_ad_mono"  # plugins are classes of one; their texts are the same in all


def parsed(directive: Directive, lines: list[str]) -> list[nodes.Node]:
    """Nodes of lines of reStructuredText."""
    node = nodes.container()
    content = StringList(lines, source="reference")
    directive.state.nested_parse(content, 0, node)
    return node.children


class PluginParameters(Directive):
    """Mitsuba's table of parameters: name, type, description of each."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        head = [".. list-table::", "    :widths: 20 12 68", "    :header-rows: 1", ""]
        head += ["    * - Parameter", "      - Type", "      - Description"]
        return parsed(self, [*head, *(f"    {line}" for line in rows(self.content))])


def rows(lines: Any) -> list[str]:
    """Rows of three columns: what is said of a parameter's use joins its text."""
    text = inspect.cleandoc("\n".join(["", *lines]))
    text = re.sub(r"\|(\w+)\|", r"*\1*", text)
    return re.sub(r"\n  - (\*exposed\*.*)", r"\n    (\1)", text).splitlines()


class Tabs(Directive):
    """Mitsuba's tabs of examples: one block of code below the other."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        return parsed(self, list(self.content))


class CodeTab(Directive):
    """One example, in the language that is the argument."""

    has_content = True
    required_arguments = 1
    optional_arguments = 1
    final_argument_whitespace = True

    def run(self) -> list[nodes.Node]:
        text = "\n".join(self.content)
        return [nodes.literal_block(text, text, language=self.arguments[0])]


class GonioPlugins(Directive):
    """Manual pages of all plugins: the docstrings of their classes."""

    def run(self) -> list[nodes.Node]:
        import mitsuba as mi

        from gonio_mi import plugins

        mi.set_variant(VARIANT)
        return [self.page(name) for name in reversed(plugins.modules())]

    def page(self, name: str) -> nodes.section:
        """Section of the plugin in one module."""
        module = importlib.import_module(name)
        text = next(
            inspect.getdoc(thing)
            for thing in vars(module).values()
            if getattr(thing, "__module__", "") == name
            and ".. pluginparameters::" in (thing.__doc__ or "")
        )
        return section(name.rpartition(".")[2], parsed(self, (text or "").splitlines()))


class GonioCommands(Directive):
    """Help of all commands, as ``gonio-mi COMMAND --help`` prints it."""

    def run(self) -> list[nodes.Node]:
        import argparse

        from gonio_mi.cli import parser

        choices = next(
            action.choices
            for action in parser()._actions
            if isinstance(action, argparse._SubParsersAction)
        )
        pages = []
        for name, command in choices.items():
            text = command.format_help()
            block = nodes.literal_block(text, text, language="none")
            pages.append(section(f"gonio-mi {name}", [block]))
        return pages


def section(title: str, content: list[nodes.Node]) -> nodes.section:
    """A section with its title, which tables of contents name."""
    made = nodes.section(ids=[nodes.make_id(title)], names=[title])
    made += [nodes.title(title, title), *content]
    return made


def setup(app: Any) -> dict[str, bool]:
    """Register the directives with Sphinx."""
    import os

    os.environ["COLUMNS"] = "78"  # help as wide as a page
    roles.register_generic_role("monosp", nodes.literal)
    roles.register_generic_role("paramtype", nodes.literal)
    for name, directive in {
        "pluginparameters": PluginParameters,
        "tabs": Tabs,
        "code-tab": CodeTab,
        "gonio-plugins": GonioPlugins,
        "gonio-commands": GonioCommands,
    }.items():
        app.add_directive(name, directive)
    return {"parallel_read_safe": True}

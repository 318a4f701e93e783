"""pytest validates the BSDFs that its settings name, one line each.

What pip installs has it as a module of its own, ``gonio_mi_pytest``: pytest imports it
whenever it starts, and this package, with Mitsuba, only when a BSDF is examined.
"""

import contextlib
import os
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

SETTING = "gonio_bsdfs"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Declare the setting of pytest's file of settings."""
    parser.addini(
        SETTING,
        "BSDFs to validate, a line each: arguments of `gonio-mi validate`, such as "
        "`my_bsdf:roughness=0.3 --plugin my_bsdf.py`",
        type="linelist",
    )


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node: Any) -> None:
    """Tell a process of pytest-xdist, which does not know how pytest was called."""
    node.workerinput[SETTING] = _lines(node.config)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(
    session: pytest.Session, config: pytest.Config, items: list[pytest.Item]
) -> None:
    """Add a test for each line, before any are deselected."""
    for line in _lines(config):
        items.append(Validation.from_parent(session, name=line))


def _lines(config: pytest.Config) -> list[str]:
    """Lines of the setting; none if pytest was asked for certain files."""
    if hasattr(config, "workerinput"):
        return config.workerinput[SETTING]
    asked = config.args_source is pytest.Config.ArgsSource.ARGS
    return [] if asked else config.getini(SETTING)


class Validation(pytest.Item):
    """Test that a BSDF is right; its name is the line of the setting."""

    def runtest(self) -> None:
        """Validate as the command does; paths are relative to pytest's root."""
        from gonio_mi.validation.commands.validate import examined, told

        with _inside(self.config.rootpath):
            verdicts = examined(shlex.split(self.name))
        failed = [one for one in verdicts if not one.passed]
        if failed:
            text = told(failed[0], failed[1:], {})
            raise AssertionError(f"{failed[0].headline}\n{text}")

    def repr_failure(self, excinfo: Any, style: Any = None) -> Any:  # noqa: ARG002
        """The verdict, without a traceback through this package."""
        return excinfo.getrepr(style="value")

    def reportinfo(self) -> tuple[Path, None, str]:
        """Where the line stands."""
        settings = self.config.inipath or self.config.rootpath
        return settings, None, f"{SETTING}: {self.name}"


@contextlib.contextmanager
def _inside(folder: Path) -> Iterator[None]:
    """Work in a folder; that, Mitsuba's variant and the paths of modules come back."""
    import mitsuba as mi

    before, variant, paths = Path.cwd(), mi.variant(), sys.path[:]
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)
        sys.path[:] = paths
        if variant is not None:
            mi.set_variant(variant)

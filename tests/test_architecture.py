"""Imports point downwards, and the NumPy layer needs no renderer."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "gonio_mi"

# Physics and files that a reader can check, and use, without a renderer.
NUMPY_LAYER = (
    "cells",
    "directions",
    "errors",
    "estimates",
    "files",
    "files.astm",
    "files.channels",
    "files.exr",
    "files.loss",
    "files.material_files",
    "files.measured",
    "files.measured_table",
    "files.netcdf",
    "files.npz",
    "files.radiance_bsdf",
    "files.radiance_xml",
    "files.shirley_chiu",
    "files.tensor_file",
    "files.tensor_tree",
    "heights",
    "lobes",
    "memory",
    "morton",
    "ray_density",
    "record",
    "statistics",
    "subdivision",
    "subdivision.apertures",
    "subdivision.borders",
    "subdivision.equal_steps",
    "subdivision.hemisphere",
    "subdivision.klems",
    "summary",
    "tally",
)
PLUGIN_CLASSES = ("films", "integrators", "samplers", "sensors", "bsdfs", "shapes")

# Importers of the whole package or of plugins by name: the reason for each.
ALLOWED = {
    "plugins/__init__.py": "registers the plugin modules",
}


def imports(path, top=False):
    """Dotted names of all modules that a file imports, absolute within the package.

    With `top`, only those that run when the file is imported.
    """
    tree = ast.parse(path.read_text())
    package = ["gonio_mi", *path.relative_to(PACKAGE).parts[:-1]]
    nodes = tree.body if top else ast.walk(tree)
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            module = [*base, *(node.module.split(".") if node.module else [])]
            yield ".".join(module)
            yield from (".".join([*module, alias.name]) for alias in node.names)


def modules():
    return sorted(PACKAGE.rglob("*.py"))


def module_files():
    """Path of each module of the package by its dotted name, packages left out."""
    return {
        ".".join(["gonio_mi", *p.relative_to(PACKAGE).with_suffix("").parts]): p
        for p in modules()
        if p.name != "__init__.py"
    }


def package_files():
    """Path of what runs when each package inside of gonio_mi is imported."""
    return {
        ".".join(["gonio_mi", *p.parent.relative_to(PACKAGE).parts]): p
        for p in modules()
        if p.name == "__init__.py" and p.parent != PACKAGE
    }


@pytest.mark.parametrize("name", NUMPY_LAYER)
def test_numpy_layer_has_no_renderer(name):
    """Whatever it imports, however deep and however late, is no renderer."""
    files = module_files() | package_files()
    todo, seen = [f"gonio_mi.{name}"], set()
    while todo:
        module = todo.pop()
        if module in seen:
            continue
        seen.add(module)
        package = module.rpartition(".")[0]
        if package in files:
            todo.append(package)
        for other in imports(files[module]):
            root = other.split(".")[0]
            assert root not in ("mitsuba", "drjit"), f"{module} imports {other}"
            if other in files:
                todo.append(other)


@pytest.mark.parametrize("path", modules(), ids=lambda p: str(p.relative_to(PACKAGE)))
def test_nothing_imports_a_plugin_class(path):
    """Plugins are reached by name, through Mitsuba, so that variants can change."""
    if str(path.relative_to(PACKAGE)) in ALLOWED:
        return
    for module in imports(path):
        parts = module.split(".")
        if parts[:2] == ["gonio_mi", "plugins"] and len(parts) > 2:
            assert parts[2] not in PLUGIN_CLASSES, f"{path.name} imports {module}"


def test_imports_have_no_cycle():
    """Among what runs at import time: the modules can be put in an order."""
    graph = {}
    names = module_files()
    for name, path in names.items():
        graph[name] = {m for m in imports(path, top=True) if m in names} - {name}
    done = set()
    while len(done) < len(graph):
        ready = {name for name, needs in graph.items() if needs <= done} - done
        assert ready, f"a cycle among {sorted(set(graph) - done)}"
        done |= ready


def test_twin_sees_a_plugin_import():
    """The reader of imports sees relative and absolute ones."""
    source = "from .plugins.films import patches\nimport mitsuba as mi\n"
    path = PACKAGE / "not_a_file.py"

    class Fake:
        def read_text(self):
            return source

        def relative_to(self, base):
            return path.relative_to(base)

    found = set(imports(Fake()))
    assert "gonio_mi.plugins.films.patches" in found
    assert "mitsuba" in found

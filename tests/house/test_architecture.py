"""Imports point downwards, and the NumPy layer needs no renderer.

All imports count: those of ``__init__.py`` and those inside of functions too.
"""

import ast
import functools
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[2] / "gonio_mi"

# The core from the bottom upwards: each room imports only from itself and from those
# above it in this list.
CORE = (
    "version",
    "array_types",
    "errors",
    "start_up",
    "loops",
    "llvm",
    "annexes",
    "progress",
    "single_precision",
    "mitsuba_compat",
    "threads",
    "variants",
    "kernels",
    "collector",
    "settings",
    "results",
    "files",
    "surfaces",
    "plots",
    "specimen",
    "transport",
    "quadrature",
    "estimators",
    "instrument",
    "campaigns",
    "plugins",
    "reports",
    "commands",
    "cli",
    "__main__",
)

# The annexes, which stand on the core and on those above them, and their rooms.
IN_ANNEXES = (
    "materials.interpolation",
    "materials",
    "exchange.tables",
    "exchange.formats",
    "exchange.exports",
    "exchange.commands",
    "exchange",
    "analysis.points",
    "analysis.comparison",
    "analysis.quantities",
    "analysis.fitting",
    "analysis.charts",
    "analysis.commands",
    "analysis",
    "validation",
    "validation.versions",
    "validation.commands",
    "validation.pytest_entry",
    "testing",
)
ROOMS = (*CORE, *IN_ANNEXES)

# Physics and files that a reader can check, and use, without a renderer.
NUMPY_LAYER = (
    "analysis.smith",
    "array_types",
    "collector",
    "errors",
    "exchange.formats",
    "exchange.tables",
    "files",
    "instrument.schedule",
    "materials.interpolation.lobes",
    "quadrature.cells",
    "results",
    "single_precision",
    "settings",
    "surfaces.height_maps",
    "surfaces.meshes",
    "surfaces.topography",
    "transport.morton",
)
PLUGIN_CLASSES = ("films", "integrators", "samplers", "sensors", "bsdfs", "shapes")

# Importers of the whole package or of plugins by name: the reason for each.
ALLOWED = {
    "plugins/__init__.py": "registers the plugin modules",
}

# A screen. A docstring does not count: whoever reads it does not read the code, and
# ours say shapes, units, boundaries, errors and sources.
MOST_LINES = 60

# Functions of more lines: the reason for each.
LONG = {
    "transport/media_loop.py trace_inside": "a loop that Dr.Jit has to see whole",
    "transport/surface_loop.py trace": "a loop that Dr.Jit has to see whole",
}


def dotted(path):
    """Name of a module or package inside of gonio_mi, "" for gonio_mi itself."""
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(source, path):
    """Dotted names of all that a file imports, absolute within the package."""
    package = ["gonio_mi", *path.relative_to(PACKAGE).parts[:-1]]
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            module = [*base, *(node.module.split(".") if node.module else [])]
            yield from (".".join([*module, alias.name]) for alias in node.names)


@functools.cache
def paths():
    return sorted(PACKAGE.rglob("*.py"))


@functools.cache
def graph():
    """Modules of the package that each of them imports; a package is its __init__."""
    files = {dotted(path): path for path in paths()}
    arrows = {}
    for name, path in files.items():
        found = {module_of(other, files) for other in imports(path.read_text(), path)}
        arrows[name] = found - {None, "", name}
    return arrows


def module_of(imported, files):
    """The module among `files` that an imported name is, or is in; else None."""
    root, *parts = imported.split(".")
    while root == "gonio_mi" and parts and ".".join(parts) not in files:
        parts.pop()
    return ".".join(parts) if root == "gonio_mi" else None


def room(name):
    """The longest name in ROOMS that a module is, or is in."""
    parts = name.split(".")
    while parts and ".".join(parts) not in ROOMS:
        parts.pop()
    return ".".join(parts)


def upward(arrows):
    """Imports that do not point downwards, as pairs of importer and imported."""
    return {
        (name, other)
        for name, others in arrows.items()
        for other in others
        if name and ROOMS.index(room(other)) > ROOMS.index(room(name))
    }


def in_a_circle(arrows):
    """Modules that cannot be put in an order in which each imports what is before."""
    rest = dict(arrows)
    while ready := {n for n, needs in rest.items() if not needs & rest.keys()}:
        rest = {name: needs for name, needs in rest.items() if name not in ready}
    return set(rest)


def below_the_api():
    """The graph without the public API, which stands above all."""
    return {name: others for name, others in graph().items() if name}


@pytest.mark.parametrize("name", NUMPY_LAYER)
def test_numpy_layer_has_no_renderer(name):
    """Whatever it imports, however deep and however late, is no renderer."""
    arrows = below_the_api()
    files = {dotted(path): path for path in paths()}
    todo = [n for n in arrows if n == name or n.startswith(name + ".")]
    assert todo
    seen = set()
    while todo:
        module = todo.pop()
        seen.add(module)
        for other in imports(files[module].read_text(), files[module]):
            root = other.split(".")[0]
            assert root not in ("mitsuba", "drjit"), f"{module} imports {other}"
        todo += [other for other in arrows[module] if other not in seen]


@pytest.mark.parametrize("path", paths(), ids=lambda p: str(p.relative_to(PACKAGE)))
def test_nothing_imports_a_plugin_class(path):
    """Plugins are reached by name, through Mitsuba, so that variants can change."""
    if str(path.relative_to(PACKAGE)) in ALLOWED:
        return
    for module in imports(path.read_text(), path):
        parts = module.split(".")
        if parts[:2] == ["gonio_mi", "plugins"] and len(parts) > 2:
            assert parts[2] not in PLUGIN_CLASSES, f"{path.name} imports {module}"
        assert module != "gonio_mi.materials.goniometric"


def test_every_module_is_in_a_room():
    assert {room(name) for name in graph() if name} == set(ROOMS)


def test_imports_point_downwards():
    """Between rooms, without exception."""
    assert upward(below_the_api()) == set()


def test_the_core_imports_no_annex():
    """It asks at their doors, whatever the order of the list is."""
    doors = {name for name in IN_ANNEXES if "." not in name}
    for name, others in below_the_api().items():
        if room(name) in CORE:
            assert not {other.split(".")[0] for other in others} & doors, name


def test_imports_have_no_circle():
    """Among all modules, packages and late imports included."""
    assert in_a_circle(below_the_api()) == set()


def long_functions(source):
    """Functions and methods of more than `MOST_LINES` lines without the docstring."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            lines = node.end_lineno - node.lineno + 1
            if ast.get_docstring(node) is not None:
                lines -= node.body[0].end_lineno - node.body[0].lineno + 1
            if lines > MOST_LINES:
                yield node.name


def test_functions_fit_on_a_screen():
    """Each exception is listed, and none without need."""
    found = {
        f"{path.relative_to(PACKAGE).as_posix()} {name}"
        for path in paths()
        for name in long_functions(path.read_text())
    }
    assert found == set(LONG)


@pytest.mark.parametrize("lines", [MOST_LINES - 1, MOST_LINES])
def test_twin_sees_a_long_function(lines):
    """One line more is too many, and a docstring is none."""
    body = ['    """First.', "", '    Last."""', *["    x = 1"] * lines]
    source = "class A:\n  def f():\n  " + "\n  ".join(body)
    assert list(long_functions(source)) == ["f"] * (lines == MOST_LINES)


def test_twin_sees_a_circle_that_closes_in_a_function():
    """Were a record to import files when it is saved, both tests would find it."""
    source = "def save(record):\n    from .. import files\n    files.save(record)\n"
    arrows = below_the_api()
    found = imports(source, PACKAGE / "results" / "record.py")
    added = {module_of(name, arrows) for name in found}
    assert added == {"files"}
    arrows["results.record"] = arrows["results.record"] | added
    assert upward(arrows) == {("results.record", "files")}
    assert {"results.record", "files"} <= in_a_circle(arrows)


def test_twin_tells_a_circle_from_a_diamond():
    diamond = {"a": {"b", "c"}, "b": {"d"}, "c": {"d"}, "d": set()}
    assert in_a_circle(diamond) == set()
    assert in_a_circle(diamond | {"d": {"b"}}) == {"a", "b", "c", "d"}


def test_twin_sees_a_plugin_import():
    """The reader of imports sees relative and absolute ones."""
    source = "from .plugins.films import patches\nimport mitsuba as mi\n"
    found = set(imports(source, PACKAGE / "not_a_file.py"))
    assert "gonio_mi.plugins.films.patches" in found
    assert "mitsuba" in found

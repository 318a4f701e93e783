"""What `gonio_mi` offers: each public name is documented and is no module."""

import inspect
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

import gonio_mi as gonio

# What a first look at the package must find, whatever else there is.
VERBS = {"chart", "compare", "export", "measure", "plan", "plot", "report", "validate"}
# Optional packages, of which some take a second to load.
OPTIONAL = ("distributed", "matplotlib", "numba", "plotly", "pyradiance", "xarray")


def modules(package):
    """Names of the modules and packages directly inside a package."""
    folder = Path(package.__file__).parent
    files = {path.stem for path in folder.glob("*.py")} - {"__init__"}
    return files | {path.parent.name for path in folder.glob("*/__init__.py")}


def shadowed(package):
    """Public names that are modules of the package, or become such when imported."""
    loaded = {name for name, x in vars(package).items() if isinstance(x, ModuleType)}
    return set(package.__all__) & (loaded | modules(package))


@pytest.mark.parametrize("name", gonio.__all__)
def test_public_name_is_documented(name):
    """By a docstring of its own, whose first line is a sentence or a noun phrase."""
    public = getattr(gonio, name)
    assert callable(public)
    first = inspect.cleandoc(public.__doc__ or "").split("\n")[0]
    assert first.endswith(".")
    # what dataclasses write where there is no docstring
    assert not first.startswith(f"{name}(")


def test_verbs_are_public():
    assert set(gonio.__all__) >= VERBS
    assert len(set(gonio.__all__)) == len(gonio.__all__)


def test_no_public_name_is_a_module():
    """`gonio.subdivision` is a function before and after any import of a module."""
    assert shadowed(gonio) == set()


def test_twin_finds_a_module_in_the_way(tmp_path, monkeypatch):
    """A package with a function and a module of one name is found, imported or not."""
    package = tmp_path / "in_the_way"
    package.mkdir()
    (package / "plot.py").touch()
    (package / "chart.py").touch()
    lines = ["from . import chart", "def plot(): ...", '__all__ = ["chart", "plot"]']
    (package / "__init__.py").write_text("\n".join(lines))
    monkeypatch.syspath_prepend(tmp_path)
    import in_the_way

    assert shadowed(in_the_way) == {"chart", "plot"}


def test_import_loads_little_but_mitsuba():
    """Neither NumPy nor a room of ours: only what registers the plugins."""
    program = "import sys, mitsuba; before = {*sys.modules}; import gonio_mi; "
    program += "print(*{*sys.modules} - before)"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    more = set(done.stdout.split())
    folder = Path(gonio.__file__).parent
    rooms = {f"gonio_mi.{path.parent.name}" for path in folder.glob("*/__init__.py")}
    assert more & rooms == {"gonio_mi.plugins"}
    assert not more & {
        "numpy",
        "pathlib",
        "ctypes",
        "dataclasses",
        "importlib.metadata",
    }


def test_import_loads_nothing_optional():
    """They are loaded by what needs them, when it is called."""
    program = f"import sys, gonio_mi; print({set(OPTIONAL)!r} & set(sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "set()"

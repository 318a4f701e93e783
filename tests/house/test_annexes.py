"""The core stands without the annexes, and all else without any one of them."""

import ast
import importlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from gonio_mi.annexes import ANNEXES, ask

ROOT = Path(__file__).parents[2]

# Entrances to an annex beside its folder.
ENTRANCES = {"validation": ("testing.py",)}

# Prints the public names that cannot be had and the modules that cannot be imported,
# the commands and the plugins.
LOOK = """
import importlib, pkgutil
import mitsuba as mi
import gonio_mi
mi.set_variant("llvm_ad_mono")
for name in gonio_mi.__all__:
    getattr(gonio_mi, name)
for module in pkgutil.walk_packages(gonio_mi.__path__, "gonio_mi."):
    if module.name != "gonio_mi.__main__":
        try:
            importlib.import_module(module.name)
        except ModuleNotFoundError as error:
            print("lacks", module.name.rpartition(".")[2], error.name.split(".")[1])
from gonio_mi import cli, plugins
from gonio_mi.annexes import is_missing
print("commands", *cli.COMMANDS)
print("plugins", *plugins.modules())
if not is_missing("exchange"):
    from gonio_mi.exchange.exports import bsdf
    try:
        bsdf("diffuse", "missing_folder/diffuse.xml")
    except (OSError, ValueError) as error:
        print(error)
"""

# Modules that are imported where they are used, since they need another annex.
LATE = {f"lacks {name}_export materials" for name in ("measured", "radiance")}

FUTURE = "from __future__ import annotations\n"


# Of each room of the core tests that take little time.
CORE = """
    campaigns/test_folders.py::test_swapped_files
    campaigns/test_folders.py::test_task_files_are_records
    collector/test_patches_of_incidence.py::test_solid_angles_of_cells_are_integrals
    files/test_files.py::test_load_equals_save
    estimators/test_every_estimator.py::test_what_it_says_of_itself_is_so[weighted]
    instrument/test_rounds.py::test_rounds_lead_to_the_plan
    plots/test_drawn_patches.py::test_each_place_has_the_value_of_its_patch
    plugins/test_plugins.py::test_examples_of_manual_pages_load_and_are_the_same
    quadrature/test_quadrature.py::test_lambertian
    reports/test_reports.py::test_page_holds_the_record results/test_record.py
    results/test_estimates.py settings/test_settings.py
    specimen/test_first_mistakes.py::test_light_that_misses_is_told_once
    surfaces/test_height_steps.py::test_the_step_is_found
    transport/test_divergence.py::test_records_tell_the_divergence
"""


def without(annexes, folder):
    """What runs Python in a copy of the checkout that lacks some annexes."""
    # what Python has compiled is copied too, and is valid there
    ignored = shutil.ignore_patterns(".*")
    for name in ("gonio_mi", "tests", "scenes", "notebooks"):
        shutil.copytree(ROOT / name, folder / name, ignore=ignored)
    shutil.copy(ROOT / "pyproject.toml", folder)
    for annex in annexes:
        shutil.rmtree(folder / "gonio_mi" / annex)
        for entrance in ENTRANCES.get(annex, ()):
            (folder / "gonio_mi" / entrance).unlink()
    environment = os.environ | {"PYTHONPATH": str(folder)}

    def run(*arguments):
        done = subprocess.run(
            [sys.executable, *arguments],
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
        )
        return done.returncode, done.stdout + done.stderr

    return run


def test_core_alone(tmp_path):
    """Its own tests pass where no annex is, but for those that need one.

    All of them: ``pytest tests/core`` in such a copy.
    """
    run = without(ANNEXES, tmp_path)
    code, said = run("-c", LOOK)
    assert code == 0, said
    assert "lacks" not in said
    assert "validate" not in said
    rooms = {path.name for path in (ROOT / "tests/core").iterdir() if path.is_dir()}
    assert {one.partition("/")[0] for one in CORE.split()} == rooms - {"__pycache__"}
    code, said = run(
        *("-m", "pytest", "-q", "-x", "-p", "no:cacheprovider"),
        *(f"tests/core/{one}" for one in CORE.split()),
    )
    assert code == 0, said


def asked(source):
    """Package and name of each call of `ask` in Python code."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "ask":
            given = [getattr(one, "value", None) for one in node.args[:2]]
            if all(isinstance(one, str) for one in given):
                yield tuple(given)


def test_what_is_asked_for_is_offered():
    """And imported; of doors that users do not read nothing else is offered."""
    found = {
        each
        for path in (ROOT / "gonio_mi").rglob("*.py")
        for each in asked(path.read_text())
    }
    assert ("files", "save") in found
    for package, name in found:
        assert ask(package, name) is not None
    packages = {package for package, _ in found}
    doors = {name: importlib.import_module(f"gonio_mi.{name}") for name in packages}
    offered = {(name, each) for name, door in doors.items() for each in door.OFFERS}
    public = {("validation", name) for name in doors["validation"].__all__}
    assert offered - public == found
    with pytest.raises(KeyError):  # twin
        ask("files", "safe")


@pytest.mark.parametrize("annex", ANNEXES)
def test_without_one_annex(annex, tmp_path):
    """Every other module can be imported, and every command of others is there."""
    code, said = without([annex], tmp_path)("-c", LOOK)
    assert code == 0, said
    lacking = {line for line in said.split("\n") if line.startswith("lacks")}
    assert lacking == (LATE if annex == "materials" else set())
    assert "goniometric" not in said or annex != "materials"
    assert ("a file .xml needs the part materials" in said) == (annex == "materials")


def test_twin_a_core_that_imports_an_annex_does_not_start(tmp_path):
    run = without(ANNEXES, tmp_path)
    module = tmp_path / "gonio_mi" / "plots" / "plot.py"
    before, future, after = module.read_text().partition(FUTURE)
    module.write_text(f"{before}{future}from ..analysis import charts\n{after}")
    code, said = run("-c", LOOK)
    assert code != 0
    assert "No module named 'gonio_mi.analysis'" in said

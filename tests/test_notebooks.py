"""Every notebook runs from top to bottom, with few rays, and is kept without output."""

from pathlib import Path

import pytest

nbformat = pytest.importorskip("nbformat")
nbclient = pytest.importorskip("nbclient")

NOTEBOOKS = sorted((Path(__file__).parent.parent / "notebooks").glob("*.ipynb"))


def test_there_are_notebooks():
    assert NOTEBOOKS


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_stripped(path):
    notebook = nbformat.read(path, as_version=4)
    assert not [cell.outputs for cell in notebook.cells if cell.get("outputs")]


# Executed elsewhere, with tests of what it finds.
JUDGED = "where_methods_fail"


@pytest.mark.parametrize(
    "path", [p for p in NOTEBOOKS if p.stem != JUDGED], ids=lambda path: path.stem
)
def test_notebook_runs(path, monkeypatch, tmp_path):
    monkeypatch.setenv("GONIO_RAYS", "1e4")
    notebook = nbformat.read(path, as_version=4)
    resources = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(notebook, timeout=300, resources=resources).execute()
    figures = [
        output
        for cell in notebook.cells
        for output in cell.get("outputs", [])
        if "image/png" in output.get("data", {})
    ]
    assert figures

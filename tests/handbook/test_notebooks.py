"""Every notebook runs from top to bottom, with few rays, and is kept without output."""

import ast
import copy
import re
from pathlib import Path

import pytest

paper_page = pytest.importorskip("paper_page")
nbformat = pytest.importorskip("nbformat")
matplotlib = pytest.importorskip("matplotlib")
pytest.importorskip("matplotlib.pyplot")

NOTEBOOKS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))


def test_there_are_notebooks():
    assert NOTEBOOKS


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_stripped(path):
    notebook = nbformat.read(path, as_version=4)
    assert not [cell.outputs for cell in notebook.cells if cell.get("outputs")]


# Executed elsewhere, with tests of what it finds.
JUDGED = "where_methods_fail"

# Run by a kernel of Jupyter, as its readers do; the others here, where kernels that
# other tests have compiled are at hand.
BY_JUPYTER = "media"


def pictures_of_jupyter(notebook, folder):
    """Pictures that a kernel of its own shows."""
    nbclient = pytest.importorskip("nbclient")
    resources = {"metadata": {"path": str(folder)}}
    nbclient.NotebookClient(notebook, timeout=300, resources=resources).execute()
    return [
        output
        for cell in notebook.cells
        for output in cell.get("outputs", [])
        if "image/png" in output.get("data", {})
    ]


def pictures_here(notebook):
    """Figures that are open after each cell, or are what its last line is."""
    pyplot, found, scope = matplotlib.pyplot, [], {"__name__": "__main__"}
    for cell in notebook.cells:
        if cell.cell_type == "code":
            *lines, last = ast.parse(re.sub("^%.*", "", cell.source, flags=re.M)).body
            if not isinstance(last, ast.Expr):
                lines, last = [*lines, last], ast.parse("None").body[0]
            exec(compile(ast.Module(lines, []), "a cell", "exec"), scope)
            value = eval(compile(ast.Expression(last.value), "a cell", "eval"), scope)
            found += pyplot.get_fignums()
            if isinstance(value, matplotlib.figure.Figure):
                found.append(value)
            pyplot.close("all")
    # plugins that stay registered hold what they were defined beside, BSDFs among them
    scope.clear()
    return found


@pytest.mark.usefixtures("less")
# of notebooks, which are read by people
@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize(
    "path", [p for p in NOTEBOOKS if p.stem != JUDGED], ids=lambda path: path.stem
)
def test_notebook_runs(path, monkeypatch, tmp_path):
    monkeypatch.setenv("GONIO_RAYS", "1e4")
    monkeypatch.chdir(tmp_path)
    notebook = nbformat.read(path, as_version=4)
    if path.stem == BY_JUPYTER:
        assert pictures_of_jupyter(notebook, tmp_path)
    else:
        matplotlib.use("Agg")
        assert pictures_here(notebook)


def stale(page, notebook, figures):
    """Texts of the notebook that its page lacks, and figures that only one of them has.

    The page is made at a release by `paper_page`, and kept.
    """
    lacking = [text for text in paper_page.markdown(notebook) if text not in page]
    named = set(re.findall(r"\]\(images/paper/(.*)\)", page))
    return lacking + sorted(named ^ figures)


def test_the_page_of_the_paper_is_of_its_notebook():
    notebook = nbformat.read(paper_page.NOTEBOOK, as_version=4)
    page = paper_page.PAGE.read_text(encoding="utf-8")
    figures = {path.name for path in paper_page.FIGURES.iterdir()}
    assert stale(page, notebook, figures) == []
    changed = copy.deepcopy(notebook)
    changed.cells[1].source += " More."
    assert stale(page, changed, figures) == [changed.cells[1].source]
    assert stale(page, notebook, figures - {"01.png"}) == ["01.png"]

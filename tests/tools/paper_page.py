"""Make the page of the paper: ``python tests/tools/paper_page.py``, at each release.

Runs `notebooks/paper_again.ipynb` in full (``GONIO_RAYS`` in the environment: with
fewer rays) and writes `notebooks/paper.md`: what its cells say, print and draw, without
their code and without its first cell, which says how to run it.
"""

import base64
import io
import re
from pathlib import Path

import nbclient
import nbformat
from PIL import Image

NOTEBOOKS = Path(__file__).parents[2] / "notebooks"
NOTEBOOK, PAGE = NOTEBOOKS / "paper_again.ipynb", NOTEBOOKS / "paper.md"
FIGURES = NOTEBOOKS / "images" / "paper"
HEAD = """# The paper, reproduced

*Its tables and figures, made again for each version; [the
notebook](paper_again.ipynb) has the code.*
"""


def markdown(notebook):
    """What the page says word for word: texts of all cells but the first."""
    return [x.source for x in notebook.cells[1:] if x.cell_type == "markdown"]


def shown(cell, heading):
    """What a cell has printed and drawn, as parts of the page; writes the pictures."""
    if said := "".join(x.text for x in cell.outputs if x.get("name") == "stdout"):
        yield f"```text\n{said.rstrip()}\n```"
    for output in cell.outputs:
        if "image/png" in output.get("data", {}):
            png = io.BytesIO(base64.b64decode(output.data["image/png"]))
            path = FIGURES / f"{len([*FIGURES.iterdir()]) + 1:02}.png"
            picture = Image.open(png).convert("RGB").quantize(256)  # a third as large
            picture.save(path, optimize=True)
            yield f"![{heading}]({path.relative_to(NOTEBOOKS)})"


def main():
    """See the module."""
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbclient.NotebookClient(notebook, timeout=None).execute()
    FIGURES.mkdir(exist_ok=True)
    for old in FIGURES.iterdir():
        old.unlink()
    parts, heading = [HEAD.rstrip()], ""
    for cell in notebook.cells[1:]:
        if cell.cell_type == "markdown":
            parts.append(cell.source)
            heading = ([heading] + re.findall("^## (.*)", cell.source, re.M))[-1]
        else:
            parts += shown(cell, heading)
    PAGE.write_text("\n\n".join(parts) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

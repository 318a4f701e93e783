"""The handbook is built without a warning, and its reference leaves nothing out."""

import html
import os
import re
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote

import pytest
from museum import EXHIBITS

import gonio_mi as gonio
from gonio_mi.cli import COMMANDS
from gonio_mi.exchange.formats import reading
from gonio_mi.plugins import modules

ROOT = Path(__file__).parents[2]
PAGES = ROOT / "notebooks"


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Folder of the pages; notebooks, executed by their own test, are not here."""
    pytest.importorskip("sphinx_book_theme")
    pytest.importorskip("myst_nb")
    folder = tmp_path_factory.mktemp("handbook")
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q"]
    done = subprocess.run(
        [*command, "-d", str(folder / "trees"), str(PAGES), str(folder / "pages")],
        env={**os.environ, "GONIO_HANDBOOK": "pages", "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return folder / "pages"


def test_every_page_is_built(built):
    """Sphinx itself warns of a page that no table of contents holds."""
    for page in (*PAGES.glob("*.md"), *PAGES.glob("*.ipynb")):
        assert (built / f"{page.stem}.html").is_file()


def targets(page):
    """Local addresses of a built page, as paths with what follows ``#``."""
    for path in re.findall(r'(?:href|src)="([^"]*)"', page.read_text()):
        if not re.match(r"\w+:|//", path):
            file, _, anchor = html.unescape(unquote(path)).partition("#")
            yield (page.parent / file.partition("?")[0] if file else page), anchor


def broken(folder):
    """Local links of the pages in a folder that lead to no file, or to no place."""
    pages = [page for page in folder.rglob("*.html") if "_static" not in page.parts]
    names = {
        page: {*re.findall(r'\b(?:id|name)="([^"]*)"', page.read_text())}
        for page in pages
    }
    for page in pages:
        for file, anchor in targets(page):
            of_page = names.get(Path(os.path.normpath(file)), {anchor})
            if not file.exists() or (anchor and anchor not in of_page):
                yield f"{page.name}: {file.name}#{anchor}"


def test_local_links_lead_somewhere(built):
    assert [*targets(built / "index.html")]
    assert [*broken(built)] == []


def test_twin_broken_links_are_found(tmp_path):
    links = (f'<a href="{x}">' for x in ("a.html#x", "#y", "b.html", "https:z"))
    (tmp_path / "a.html").write_text('<p id="x">' + "".join(links))
    assert [*broken(tmp_path)] == ["a.html: a.html#y", "a.html: b.html#"]


def test_reference_shows_what_the_code_says(built):
    plugins = (built / "reference" / "plugins.html").read_text()
    assert "pluginparameters" not in plugins
    assert "rr_depth" in plugins
    for name in modules():
        _, _, stem = name.rpartition(".")
        assert f'<section id="{stem}">' in plugins
    commands = (built / "reference" / "command_line.html").read_text()
    assert commands.count("usage: gonio-mi") == len(COMMANDS)


def test_reference_of_python_is_complete():
    page = (PAGES / "reference" / "python.md").read_text()
    kinds = ("function", "class", "exception")
    for name in gonio.__all__:
        assert any(f".. auto{kind}:: {name}\n" in page for kind in kinds), name


def test_modules_that_the_handbook_names_exist():
    """In backquotes, of the package or of the tests, such as ``files/exr.py``."""
    for page in (*PAGES.glob("*.md"), ROOT / "README.md"):
        for name in re.findall(r"[` ](\w[\w/]*/\w+\.py)\b", page.read_text()):
            found = ROOT / name, ROOT / "gonio_mi" / name
            assert any(path.is_file() for path in found), f"{page.name}: {name}"


def test_the_page_of_other_programs_names_every_ending():
    page = (PAGES / "other_programs.md").read_text(encoding="utf-8")
    endings = {ending for one in reading._all() for ending in one.endings}
    assert {ending for ending in endings if f"`{ending}`" not in page} == set()


def test_the_museum_has_a_row_of_every_exhibit():
    rows = (PAGES / "museum.md").read_text(encoding="utf-8").splitlines()
    for one in EXHIBITS.values():
        place = "https://github.com/" + one.thread.replace("#", "/issues/") + ")"
        (row,) = (line for line in rows if place in line)
        assert any(f"`{name}`" in row for name in one.functions.split())
        assert any(f"`{name}`" in row for name in one.properties.split())
    assert sum("https://github.com/" in row and row[0] == "|" for row in rows) == 25
    assert len(EXHIBITS) == 25

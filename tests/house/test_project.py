"""What the project says of itself is one: version and local links of README."""

import re
from pathlib import Path

from gonio_mi.version import __version__

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_version_is_cited_and_has_an_entry():
    assert re.findall(r"version = \{(.*)\}", README) == [__version__]
    changes = (ROOT / "notebooks" / "changes.md").read_text(encoding="utf-8")
    assert f"\n## {__version__}\n" in changes
    recipe = (ROOT / ".github" / "conda" / "recipe.yaml").read_text(encoding="utf-8")
    assert f"\n  version: {__version__}\n" in recipe
    page = (ROOT / "notebooks" / "paper.md").read_text(encoding="utf-8")
    assert f"gonio-mi {__version__}, " in page.splitlines()[-2]


def broken(text):
    """Local targets of Markdown's links that lead to no file, or to no heading."""
    missing = []
    for path, anchor in re.findall(r"\]\(([\w./]+)(#[\w-]+)?\)", text):
        file = ROOT / path
        said = file.read_text(encoding="utf-8") if file.is_file() and anchor else ""
        headings = re.sub(r"[^\w\n -]", "", said).lower().replace(" ", "-")
        if not file.exists() or (anchor and f"-{anchor[1:]}\n" not in headings):
            missing.append(path + anchor)
    return missing


def test_local_links_of_readme():
    assert broken(README) == []


def test_twin_broken_links_are_found():
    page = "notebooks/conventions.md"
    text = f"[a]({page}#polarised-light) [b]({page}#nothing) [c](notebooks/no.md)"
    assert broken(text) == [f"{page}#nothing", "notebooks/no.md"]

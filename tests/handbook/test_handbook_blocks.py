"""Every command and Python block of README and handbook runs, word for word.

Where one takes more than seconds it has fewer rays or patches, or less effort, than it
says.
"""

import importlib.util
import json
import re
import runpy
import shlex
import sys
import textwrap
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
import surface_files

from gonio_mi.cli import main
from gonio_mi.surfaces import height_map_reader, height_maps
from gonio_mi.surfaces.heights import gaussian_heights

tomllib = pytest.importorskip("tomllib")

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "notebooks").glob("*.md"))]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRAS = PROJECT["optional-dependencies"]

# At most so many rays, no smaller tolerance, and what else makes a command short.
RAYS, TOLERANCE = 1e4, 0.3
FAST = {
    "bsdf": ["--rays", "64"],
    "chart": ["--seconds", "0.05"],
    "quantity": ["--rays", "1e4"],
    "surface": ["--points", "1e4"],
    "validate": ["--effort", "quick"],
}
# Commands that may find that something is not as it should be.
VERDICTS = {"compare": (0, 3), "validate": (0, 3)}


# What pages assume their reader has, beside the files that they show.
def measured(path, *options):
    command = ["measure", "roughplastic:alpha=0.2", "--theta-i", "45", "--rays", "1e4"]
    assert main([*command, "-o", str(path), *options]) == 0


def scanned(path):
    """A rough surface of half a millimetre, as a profilometer has it."""
    heights = gaussian_heights((64, 64), 2e-6, (0.3, 0.3), 1.6e-5)
    surface_files.write_x3p(path, heights)


def imaged(path):
    """The same as a 16-bit image."""
    heights = gaussian_heights((64, 64), 1.5, (0.3, 0.3), 12.0)
    codes = np.interp(heights, [heights.min(), heights.max()], [0, 65535])
    mi.Bitmap(codes.astype(np.uint16)[..., None]).write(str(path))


def tabulated(path):
    """Table about the mirror direction at 60 degrees, of integrals."""
    edges = ",".join(map(str, [0, *range(49, 73, 2), 90]))
    sectors = ",".join(map(str, [0, *range(150, 211, 5), 360]))
    settings = ["--collector", f"borders:{edges}x{sectors}"]
    settings += ["--estimator", "quadrature"]
    record = path.with_suffix(".npz")
    words = ["measure", "roughplastic:alpha=0.2", "--theta-i", "60", *settings]
    assert main([*words, "-o", str(record)]) == 0
    assert main(["export", str(record), "-o", str(path)]) == 0
    record.unlink()


GIVEN = {
    "plate.csv": tabulated,
    "ours.csv": tabulated,
    "theirs.csv": tabulated,
    "scan.x3p": scanned,
    "heights.png": imaged,
    "pilot.npz": measured,
    "a.npz": measured,
    "b.npz": lambda path: measured(path, "--seed", "2"),
}


def blocks(page):
    """Language and text of the blocks of a page, in their order."""
    found = re.findall(r"^( *)```(\w+)\n(.*?)^\1```", page.read_text(), re.M | re.S)
    return [(language, textwrap.dedent(text)) for _, language, text in found]


def shown_file(text):
    """Name of the file that a block shows, which its first line states, or None."""
    found = re.match(r"# (\w+\.(?:py|csv|txt))$", text.partition("\n")[0])
    return found and found[1]


def lines(text):
    """Commands of a block of them, comments left out, as lists of words."""
    for line in text.replace("\\\n", " ").splitlines():
        for command in line.split(" && "):
            words = shlex.split(command, comments=True)
            if words:
                yield words


# What says how many rays there are, if any.
PRECISE = {"--rel-err", "--tolerance", "quadrature"}


def fast(words):
    """Arguments of ``gonio-mi`` with few rays and patches."""
    command, *rest = words
    for option, limit in (("--rays", min), ("--tolerance", max)):
        if option in rest:
            at = rest.index(option) + 1
            bound = RAYS if option == "--rays" else TOLERANCE
            rest[at] = f"{limit(float(rest[at]), bound):g}"
    if command == "quantity" and rest[-1].endswith(".csv"):
        return [command, *rest]
    if command == "measure" and not {"--rays", *PRECISE} & {*rest}:
        rest += ["--rays", f"{RAYS:g}"]
    if "--tolerance" in rest:
        rest += ["--theta-max", "50"]
    if command == "measure" and "--points" not in rest:
        rest += ["--collector", "angle:8x24"]  # fine enough for materials
    of_matrices = command == "bsdf" or any(word.endswith(".xml") for word in rest)
    if command in ("bsdf", "export") and of_matrices and "--basis" not in rest:
        rest += ["--basis", "klems-quarter"]
    return [command, *rest, *FAST.get(command, [])]


# What needs a variant of Mitsuba.
OF_VARIANTS = r"gonio\.(?!load\b|read_measured\b|plan\b)\w+\(|mi\.load"


def sets_its_variant(said):
    """Whether the Python of a page sets a variant, if it needs one.

    Commands before it set one here, but not where a reader pastes the block.
    """
    return "mi.set_variant" in said or not re.search(OF_VARIANTS, said)


def run_command(words, folder):
    """Run one command of a page; what is not ours is looked at only."""
    if words[0] == "gonio-mi":
        for name in GIVEN.keys() & set(words):
            if not (folder / name).exists():
                GIVEN[name](folder / name)
        assert main(fast(words[1:])) in VERDICTS.get(words[1], (0,)), words
    elif words[:2] == ["pip", "install"]:
        extras = re.findall(r"\[(.*)\]", words[-1])
        assert set(",".join(extras).split(",")) <= EXTRAS.keys(), words
    elif words[1:2] == ["-m"] and words[0] in ("python", "python3"):
        assert importlib.util.find_spec(words[2]), words
    elif words[0] == "python":
        assert (ROOT / words[1]).exists(), words
    else:
        assert words[0] in ("pytest", "jupyter", "cd", "git", "."), words


def run_python(text, folder, known):
    """Run one block, which knows what those before it on the page have defined.

    Workers of a cluster are threads of this process.
    """
    path = folder / "block.py"
    path.write_text(text.replace("n_workers=2", "n_workers=1, processes=False"))
    known |= runpy.run_path(str(path), known, "__main__")


@pytest.mark.usefixtures("less")
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_page_runs_word_for_word(page, tmp_path, monkeypatch):
    pytest.importorskip("matplotlib")
    pytest.importorskip("plotly")
    (tmp_path / "scenes").symlink_to(ROOT / "scenes")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "my_bsdf", raising=False)
    # the libraries that read scans take seconds to be imported
    monkeypatch.setattr(height_maps, "read_apart", height_map_reader.read)
    variant, known, said = mi.variant(), {}, ""
    try:
        for language, text in blocks(page):
            if name := shown_file(text):
                (tmp_path / name).write_text(text)
            elif language in ("bash", "sh"):
                for words in lines(text):
                    run_command(words, tmp_path)
            elif language == "python":
                for name in GIVEN:
                    if name in text and not (tmp_path / name).exists():
                        GIVEN[name](tmp_path / name)
                said += text
                assert sets_its_variant(said), text
                run_python(text, tmp_path, known)
    finally:
        if variant is not None:
            mi.set_variant(variant)


def test_a_block_that_shows_a_file_is_told_from_others():
    assert shown_file("# my_bsdf.py\nimport mitsuba as mi\n") == "my_bsdf.py"
    assert shown_file("import mitsuba as mi\n# my_bsdf.py\n") is None


def test_twin_a_wrong_command_is_found(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(AssertionError):
        run_command(["gonio-mi", "measure", "difuse"], tmp_path)
    with pytest.raises(AssertionError):
        run_command(["pip", "install", ".[reports]"], tmp_path)
    with pytest.raises(NameError):
        run_python("record.dhr", tmp_path, {})
    assert not sets_its_variant("import gonio_mi as gonio\ngonio.measure('a.xml')")


def test_the_extra_docs_brings_what_the_notebooks_import():
    """The handbook runs its notebooks, in an environment that has this extra alone."""
    lines = PROJECT["dependencies"] + EXTRAS["docs"]
    brought = {re.match(r"[\w-]+", line)[0].lower() for line in lines}
    brought |= {"drjit", "gonio_mi", "ipython", *sys.stdlib_module_names}
    pages = sorted((ROOT / "notebooks").glob("*.ipynb"))
    assert pages
    for page in pages:
        cells = json.loads(page.read_text())["cells"]
        code = "\n".join(
            "".join(x["source"]) for x in cells if x["cell_type"] == "code"
        )
        names = re.findall(r"^ *(?:from|import) (\w+)", code, re.MULTILINE)
        assert {name.lower() for name in names} <= brought, page.name

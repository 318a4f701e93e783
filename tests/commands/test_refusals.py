"""What ended the process, or never ended, is one sentence; so are bytes for words."""

import os
import subprocess
import sys

import pytest

import gonio_mi as gonio
from gonio_mi import cli

BARE = """
import sys
from pathlib import Path
import gonio_mi as gonio
import mitsuba as mi
from gonio_mi.specimen.loading import load_specimen

mi.set_variant("llvm_ad_mono")
names = sorted(p.stem for p in (Path(mi.__file__).parent / "plugins").glob("*.so"))
for name in names + sys.argv[1:]:
    print(name, flush=True)
    try:
        load_specimen(name if name.endswith(".xml") else {"type": name})
    except (gonio.SpecimenError, gonio.FileFormatError) as error:
        assert "\\n" not in str(error)
print("done")
"""


def bare_scene(tmp_path, name, plugin):
    content = f"<shape type='rectangle'>{plugin}</shape>"
    path = tmp_path / f"{name}.xml"
    path.write_text(f"<scene version='3.0.0'>{content}</scene>")
    return str(path)


def test_no_plugin_ends_the_process(tmp_path):
    """Each of Mitsuba's by its bare name, and those that did it, in scene files."""
    scenes = [
        bare_scene(tmp_path, "blend", "<bsdf type='blendbsdf'/>"),
        bare_scene(
            tmp_path,
            "bitmap",
            "<bsdf type='diffuse'><texture type='bitmap' name='reflectance'>"
            "<boolean name='raw' value='true'/></texture></bsdf>",
        ),
    ]
    command = [sys.executable, "-c", BARE, *scenes]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-200:] + done.stderr[-400:]
    assert "\ndone\n" in done.stdout  # a colour may be reset after it
    assert "blendbsdf\n" in done.stdout


def test_twin_mitsuba_ends_the_process_itself():
    code = "import mitsuba as mi; mi.set_variant('llvm_ad_mono')\n"
    code += "mi.load_dict({'type': 'blendbsdf'})"
    assert subprocess.run([sys.executable, "-c", code]).returncode < 0


@pytest.mark.parametrize("name", ["blendbsdf", "bitmap"])
@pytest.mark.parametrize("command", ["measure", "validate", "surface"])
def test_what_a_plugin_needs_is_named(command, name, capsys):
    words = ["--theta-i", "0"] if command == "measure" else []
    assert cli.main([command, name, *words]) == 1
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert f"{name} must be given a " in told


def test_a_scene_that_includes_itself(tmp_path):
    """Of three inclusions each there were 3^15 files to be read."""
    include = "<include filename='{}.xml'/>" * 3
    for name, other in (("a", "b"), ("b", "a")):
        text = f"<scene version='3.0.0'>{include.format(other, other, other)}</scene>"
        (tmp_path / f"{name}.xml").write_text(text)
    with pytest.raises(gonio.SpecimenError, match=r"but a\.xml is included by b\.xml"):
        gonio.measure(tmp_path / "a.xml", 0)


@pytest.mark.parametrize("name", ["pipe.npz", "pipe.csv"])
def test_what_has_no_end_is_not_read(tmp_path, name, capsys):
    os.mkfifo(tmp_path / name)
    for path in (tmp_path / name, "/dev/zero"):
        assert cli.main(["show", str(path)]) == 1
        assert "is a pipe or a device" in capsys.readouterr().err


@pytest.mark.parametrize("ending", ["xml", "obj"])
def test_names_of_bytes_are_one_sentence(tmp_path, ending, capsys):
    path = os.fsencode(tmp_path) + b"/a\xff." + ending.encode()
    with open(path, "w") as stream:
        stream.write("<scene version='3.0.0'/>")
    words = ["--theta-i", "0", *(["--bsdf", "diffuse"] if ending == "obj" else [])]
    assert cli.main(["measure", os.fsdecode(path), *words]) == 1
    told = capsys.readouterr().err
    assert r"names of files must be UTF-8" in told
    assert "bug" not in told


def test_meshes_without_faces(tmp_path, capsys):
    """As a copy that was cut off before its faces."""
    path = tmp_path / "cut.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n")
    for command in (["measure", "--theta-i", "0"], ["surface"]):
        assert cli.main([*command, str(path), "--bsdf", "diffuse"]) == 1
        assert "must have triangles and finite" in capsys.readouterr().err


def test_a_deleted_folder_is_one_sentence(tmp_path):
    """Mitsuba ends the process there."""
    gone = tmp_path / "gone"
    gone.mkdir()
    code = f"import os; os.chdir({str(gone)!r}); os.rmdir('.' + '/../gone')\n"
    code += "import sys; sys.argv = ['gonio-mi', 'measure', 'diffuse']\n"
    code += "import gonio_mi"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (
        1,
        "gonio-mi: the working folder was deleted: change to another one\n",
    )


def test_escapes_of_a_plugin_do_not_reach_the_terminal(tmp_path, capsys):
    """Mitsuba's own words of a BSDF whose error holds some."""
    plugin = tmp_path / "own.py"
    plugin.write_text(LOUD)
    words = ["own_loud", "--plugin", str(plugin), "--effort", "quick"]
    assert cli.main(["validate", *words, "--variant", "llvm_ad_mono"]) in (1, 3, 4)
    both = capsys.readouterr()
    assert "\x1b" not in both.out + both.err
    assert r"\x1b[31mloud" in both.out


LOUD = """
import mitsuba as mi

class Loud(mi.BSDF):
    def __init__(self, props):
        super().__init__(props)
        self.m_components = [mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide]
        self.m_flags = self.m_components[0]

    def sample(self, *args):
        raise ValueError("\\x1b[31mloud")

    eval = pdf = eval_pdf = sample

    def to_string(self):
        return "Loud[]"

mi.register_bsdf("own_loud", Loud)
"""


def test_the_package_is_a_program():
    command = [sys.executable, "-m", "gonio_mi", "--version"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert (done.returncode, done.stdout.split()[0]) == (0, "gonio-mi")


# As Dr.Jit 1.5 does, whose own report of what is missing fails.
DRJIT = """
try:
    raise ImportError("libatomic.so.1: cannot open shared object file")
except ImportError:
    filename = _drjit_ext.__file__
"""


@pytest.mark.parametrize(
    ("program", "begins", "lines"),
    [("gonio-mi", "gonio-mi: ", 1), ("mine.py", "Traceback", None)],
)
def test_a_library_that_the_system_lacks_is_named(tmp_path, program, begins, lines):
    (tmp_path / "drjit.py").write_text(DRJIT)
    code = f"import sys; sys.argv = [{program!r}, 'measure', 'diffuse']\n"
    code += f"sys.path.insert(0, {str(tmp_path)!r}); import gonio_mi"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    said = done.stderr.splitlines()
    assert done.returncode == 1
    assert said[0].startswith(begins)
    assert len(said) == (lines or len(said))
    assert "Dr.Jit cannot be loaded: libatomic.so.1: cannot open" in said[-1]
    assert said[-1].endswith("`sudo apt install libatomic1` brings libatomic")

"""A file that was given to the wrong command is told which command takes it."""

import re
from xml.etree import ElementTree

import numpy as np
import pytest
import synthetic

from gonio_mi.cli import COMMANDS, main
from gonio_mi.exchange.formats.radiance import Product
from gonio_mi.surfaces import height_map_reader

KINDS = {
    "scan.sur": "gonio-mi surface or measure",
    "heights.npy": "gonio-mi surface or measure",
    "ball.obj": "a mesh: give it to gonio-mi measure or surface, with --bsdf",
    "lamp.ies": "the light of a lamp, which no command reads",
    "photo.jpg": "a picture, which no command reads",
    "arrays.h5": "gonio-mi export writes and no command reads",
    "scene.xml": "a scene: give it to gonio-mi measure",
    "blind.xml": "a BSDF of Radiance: measure the specimen goniometric:filename=",
    "own.bsdf": "a material of Mitsuba: measure the specimen measured:filename=",
    "plugin.py": "--plugin",
}
CONTENTS = {
    "ball.obj": b"o x\nv 0 0 0\n",
    "lamp.ies": b"IESNA:LM-63-2002\n",
    "plugin.py": b"import mitsuba\n",
    "scene.xml": b'<scene version="3.0.0"></scene>',
    "blind.xml": b'<?xml version="1.0"?>\n<WindowElement></WindowElement>',
    "own.bsdf": b"tensor_file\0\1\0",
}


def said(capsys, *words):
    """The one line that a command says before it ends with the code 1."""
    assert main([str(word) for word in words]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    return line


@pytest.mark.parametrize("command", ["show", "plot", "compare"])
@pytest.mark.parametrize("name", KINDS)
def test_what_is_no_record_and_no_table(name, command, tmp_path, capsys):
    path, record = tmp_path / name, tmp_path / "run.npz"
    path.write_bytes(CONTENTS.get(name, b"\x93\0\1\2"))
    synthetic.record().save(record)
    words = {
        "show": [path],
        "plot": [path, "-o", tmp_path / "a.png"],
        "compare": [record, path],
    }
    if (command, path.suffix) in {("compare", ".xml"), ("compare", ".obj")}:
        return  # there it is a specimen
    assert KINDS[name] in said(capsys, command, *words[command])


@pytest.mark.parametrize("name", ["run.npz", "table.csv", "lamp.ies", "own.bsdf"])
def test_what_is_no_specimen(name, tmp_path, capsys):
    path = tmp_path / name
    path.write_bytes(CONTENTS.get(name, b"theta_i\n"))
    line = said(capsys, "measure", path, "--theta-i", "30")
    taken = {
        "run.npz": "show, plot or report",
        "table.csv": "show, compare, fit or quantity",
    }
    assert (taken | KINDS)[name] in line


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("scan.xyz", "0 0 0\n1 0 0\n", "a cloud of points, which no command reads"),
        (
            "scan.ply",
            "ply\nformat ascii 1.0\nelement vertex 1\nend_header\n\n",
            "a cloud of points, which no command reads",
        ),
        ("part.glb", "glTF", "is a model of another program"),
        ("room.rad", "void plastic red\n0\n0\n", "is a scene of Radiance"),
        ("README.md", "# Title\n", "is no specimen: scenes are Mitsuba's, in XML"),
    ],
)
def test_what_no_command_reads_as_a_specimen(name, content, message, tmp_path, capsys):
    """Twin: a scene without the ending of one is read."""
    path = tmp_path / name
    path.write_text(content)
    assert message in said(capsys, "measure", path, "--theta-i", "30")
    assert message in said(capsys, "surface", path)
    path.write_text('\n<scene version="3.0.0"></scene>')
    if path.suffix == ".md":
        assert "no specimen" not in said(capsys, "measure", path, "--theta-i", "30")


SPECTRUM = (
    "0.3 0.02 0.05 0.05\n0.4 0.88 0.08 0.08\n0.5 0.90 0.08 0.08\n0.6 0.9 0.1 0.1\n"
)


@pytest.mark.parametrize("formats", ["metropro,asc", "asc"])
def test_text_with_labels_is_no_map_of_heights(formats, tmp_path):
    """Twins: other comments, and the labels of maps."""
    pytest.importorskip("SurfaceTopography")
    path = tmp_path / "glass.dat"
    for labels in ("{ Thickness } 3.0", "# wavelength T Rf Rb", "wavelength T Rf Rb"):
        path.write_text(f"{labels}\n{SPECTRUM}")
        with pytest.raises(
            ValueError, match=f"such as {labels}, and not a grid of heights"
        ):
            height_map_reader.read(str(path), formats.split(","))
    maps = "Channel: Main\nWidth: 10 um\nHeight: 10 um\nValue units: um\n"
    for labels in ("", "# a tile, 3 mm\n", maps, re.sub("(?m)^(?=.)", "# ", maps)):
        path.write_text(labels + SPECTRUM)
        _, heights = height_map_reader.read(str(path), formats.split(","))
        assert heights.shape == (4, 4)


def test_a_spectrum_is_shown_as_no_surface(tmp_path, capsys):
    path = tmp_path / "glass.dat"
    path.write_text("{ Thickness } 3.0\n" + SPECTRUM)
    assert "must name the columns" in said(capsys, "show", path)


def test_a_table_comes_second(tmp_path, capsys):
    path = tmp_path / "table.csv"
    path.write_text("theta_i,phi_i,theta_o,phi_o,value\n45,0,30,0,0.3\n")
    assert "a table comes second" in said(capsys, "compare", path, "diffuse")


def test_a_material_of_ours_that_is_not_there(capsys):
    line = said(capsys, "measure", "goniometric:filename=no.brdf", "--theta-i", "30")
    assert line.endswith("loaded: goniometric.filename: there is no file no.brdf")


def test_a_name_that_says_nothing_is_read(tmp_path, capsys):
    """As a table, whatever its ending; and heights in text may be one too."""
    for name in ("table.asc", "table.dat"):
        path = tmp_path / name
        path.write_text("theta_i,phi_i,theta_o,phi_o,value\n45,0,30,0,0.3\n")
        assert main(["show", str(path)]) == 0
    capsys.readouterr()
    np.savetxt(tmp_path / "heights.asc", np.zeros((3, 3)))
    assert "gonio-mi surface" in said(capsys, "show", tmp_path / "heights.asc")
    assert "there is no file" in said(capsys, "show", tmp_path / "none.sur")


def test_without_a_command_all_are_named(capsys):
    line = said(capsys)
    assert "gonio-mi --help" in line
    for command in COMMANDS:
        assert command in line


def test_control_characters_of_a_name_are_escaped_in_xml():
    """Exact: XML can hold none of them; a reader sees what a terminal would."""
    text = f"<a>{Product(name=chr(0) + 'a<' + chr(27), manufacturer='b').text()}</a>"
    assert ElementTree.fromstring(text).findtext("Name") == r"\x00a<\x1b"

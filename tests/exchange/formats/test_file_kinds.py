"""A file that was given to the wrong command is told which command takes it."""

import numpy as np
import pytest
import synthetic

from gonio_mi.cli import COMMANDS, main

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
    taken = {"run.npz": "show, plot or report", "table.csv": "show, compare or fit"}
    assert (taken | KINDS)[name] in line


@pytest.mark.parametrize("other", ["other.csv", "diffuse"])
def test_two_tables_cannot_be_compared(other, tmp_path, capsys):
    path = tmp_path / "table.csv"
    path.write_text("theta_i,phi_i,theta_o,phi_o,value\n45,0,30,0,0.3\n")
    line = said(capsys, "compare", path, other)
    assert "two tables cannot be compared" in line


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

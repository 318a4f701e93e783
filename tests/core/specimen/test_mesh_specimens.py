"""Meshes of other programs: read, turned, made of something, and warned of."""

import re
import struct

import mitsuba as mi
import numpy as np
import pytest

import gonio_mi as gonio
from gonio_mi import cli
from gonio_mi.errors import FileFormatError
from gonio_mi.surfaces.meshes import read_stl

MATT = {"type": "diffuse", "reflectance": 0.6}

# A slat that is tilted by 40 degrees, in mm, for a pitch of 25.
ENDS = (-12.5, 12.5, 12.5, -12.5)
HALF = 11.25 * np.array([np.sin(np.radians(40)), np.cos(np.radians(40))])
CORNERS = np.array(
    [[x, sign * HALF[0], sign * HALF[1]] for x, sign in zip(ENDS, (-1, -1, 1, 1))]
)
TRIANGLES = CORNERS[[[0, 1, 2], [0, 2, 3]]]


def obj(points):
    lines = ["v {} {} {}".format(*point) for point in points.tolist()]
    return "\n".join([*lines, "f 1 2 3", "f 1 3 4", ""]).encode()


def ply(points):
    head = "ply\nformat ascii 1.0\nelement vertex 4\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz")
    head += "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
    rows = ["{} {} {}".format(*point) for point in points.tolist()]
    return "\n".join([head + rows[0], *rows[1:], "3 0 1 2", "3 0 2 3", ""]).encode()


def stl(triangles=TRIANGLES, text=False):
    if text:
        facets = ""
        for triangle in triangles.tolist():
            vertices = "".join("vertex {} {} {}\n".format(*v) for v in triangle)
            facets += f"facet normal 0 0 1\nouter loop\n{vertices}endloop\nendfacet\n"
        return f"solid slat\n{facets}endsolid\n".encode()
    data = b"solid, though binary".ljust(80) + struct.pack("<I", len(triangles))
    for triangle in triangles:
        data += struct.pack("<12fH", 0, 0, 1, *triangle.ravel(), 0)
    return data


RAYS = 2**12


def measured(path, phi_i=80, **options):
    specimen = gonio.mesh(path, MATT, **options)
    settings = {"period": 25, "rays": RAYS, "collector": "angle:6x8"}
    return gonio.measure(specimen, 30, phi_i, **settings)


@pytest.fixture
def reference(tmp_path):
    (tmp_path / "slat.obj").write_bytes(obj(CORNERS))
    record = measured(tmp_path / "slat.obj")
    # not that of the dictionary, which all meshes have
    assert record.settings["specimen"] == "slat.obj of diffuse:reflectance=0.6"
    return record


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("slat.ply", ply(CORNERS)),
        ("SLAT.STL", stl()),
        ("text.stl", stl(text=True)),
    ],
)
@pytest.mark.promise("a mesh")
def test_formats_are_one_specimen(tmp_path, reference, name, content):
    """To the bit: the same vertices in single precision."""
    (tmp_path / name).write_bytes(content)
    assert measured(tmp_path / name).tallies == reference.tallies
    assert reference.dht[0] > 0.2


def more_vertices(name):
    """The slat in a file with a vertex that no triangle uses."""
    if name == "more.obj":
        return b"v 900 80 70\n" + obj(CORNERS).replace(
            b"f 1 2 3\nf 1 3 4", b"f 2 3 4\nf 2 4 5"
        )
    more = ply(CORNERS).replace(b"vertex 4", b"vertex 5")
    return more.replace(b"3 0 1 2", b"900 80 70\n3 0 1 2")


@pytest.mark.parametrize("name", ["more.obj", "more.ply"])
def test_vertices_without_triangles_are_no_part(tmp_path, reference, name):
    """Exact: Mitsuba's box holds them; a cell of that size would be nearly empty."""
    path = tmp_path / name
    path.write_bytes(more_vertices(name))
    assert mi.load_dict({"type": name[-3:], "filename": str(path)}).bbox().max[0] == 900
    assert measured(path).tallies == reference.tallies
    low, high = gonio.specimen.shapes.bounds(
        mi.load_dict(gonio.mesh(path, MATT)).shapes()
    )
    assert np.array_equal((high - low)[:2], np.ptp(CORNERS.astype("f4"), axis=0)[:2])


@pytest.mark.parametrize("normal", ["z", "-z", "y", "-y", "x", "-x"])
def test_the_axis_that_is_said_becomes_the_normal(tmp_path, reference, normal):
    """Whatever way the mesh was turned before; and shifts are undone.

    They round the vertices by 1e-6 of 25. About 7 edges are crossed by a radian, or by
    the width of a cell, where a ray goes another way then: one of 4096 with a chance of
    3e-3, two with one of 5e-6. Twin: light from a degree beside.
    """
    axis = "xyz".index(normal[-1])
    sign = -1 if normal[0] == "-" else 1
    path = tmp_path / "turned.obj"
    matrix = np.array(gonio.specimen.mesh.NORMALS[normal], dtype=float)
    assert np.linalg.det(matrix) == 1
    assert (matrix[2] == sign * np.eye(3)[axis]).all()
    path.write_bytes(obj(CORNERS @ matrix + [5, -3, 2]))
    for phi_i, same in ((80, True), (81, False)):
        light = measured(path, phi_i, normal=normal).flux_fraction
        off = np.abs(light - reference.flux_fraction).sum()
        assert (off <= 2 / RAYS) == same
    plane = gonio.mesh(path, MATT, normal=normal, mean_plane=1.0)
    # up is the file's z, or its y where z is the normal
    assert matrix[1].tolist() == np.eye(3)[1 if axis == 2 else 2].tolist()
    low, high = gonio.specimen.shapes.bounds(mi.load_dict(plane).shapes())
    middle = sign * [5, -3, 2][axis]
    assert np.isclose((low + high)[2] / 2, middle - 1, atol=1e-5)


def test_what_stands_upright_is_warned_of(tmp_path, capsys):
    """Unless it is said which axis is the normal; exactly, by how thick it lies."""
    path = tmp_path / "upright.obj"
    slat = np.array([[-9, -1, 0], [9, -1, 0], [9, 1, 1], [-9, 1, 1]])
    above = obj(slat + [0, 0, 8]).replace(b"f 1 2 3\nf 1 3 4", b"f 5 6 7\nf 5 7 8")
    path.write_bytes(obj(slat) + above)
    with pytest.warns(RuntimeWarning, match="but only 2 along y.* such as --normal y"):
        lying = gonio.mesh(path, MATT)
    for specimen, thick in (
        (lying, 9),
        (gonio.mesh(path, MATT, normal="z"), 9),
        (gonio.mesh(path, MATT, normal="-y"), 2),
    ):
        low, high = gonio.specimen.shapes.bounds(mi.load_dict(specimen).shapes())
        assert (high - low)[2] == thick
    words = ["measure", str(path), "--bsdf", "diffuse", "--theta-i", "0", "--rays"]
    words += ["64", "--period", "18,16", "-q"]
    assert cli.main([*words, "--normal", "-y"]) == 0
    assert "normal" not in capsys.readouterr().err


@pytest.mark.needs("exchange")
def test_the_command_line_measures_a_mesh(tmp_path, monkeypatch, capsys):
    # which other tests do
    read_back = "gonio_mi.exchange.exports.radiance_export.read_back"
    monkeypatch.setattr(read_back, lambda *_: [])
    monkeypatch.chdir(tmp_path)
    (tmp_path / "slat.obj").write_bytes(obj(CORNERS))
    words = ["slat.obj", "--unit", "mm", "--period", "25,25", "--rays", "64"]
    words += ["--bsdf", "diffuse:reflectance=0.6", "-o", "slat.xml"]
    words += ["--folder", "measured"]
    assert cli.main(["bsdf", *words, "--basis", "klems-quarter"]) == 0
    text = (tmp_path / "slat.xml").read_text()
    (thickness,) = re.findall('<Thickness unit="meter">(.*)</Thickness>', text)
    assert abs(float(thickness) - 2 * HALF[1] / 1000) <= 1e-8
    out = capsys.readouterr().out
    assert "Thickness" not in out
    assert out.startswith("slat.obj: 25 x 14.46 x 17.24 mm in x, y and along the norm")
    assert "which is the file's z; up is its y; period 25,25\n" in out
    unknown = [word for word in words if word not in ("--unit", "mm")]
    assert cli.main(["bsdf", *unknown, "--basis", "klems-quarter"]) == 0
    text = (tmp_path / "slat.xml").read_text()
    assert '<Thickness unit="meter">0</Thickness>' in text
    assert (
        "Thickness 0 (give --thickness, or --unit if the file has none)"
        in capsys.readouterr().out
    )
    for words, message in (
        (["slat.obj"], "must come with its material, such as --bsdf"),
        (["slat.obj", "--bsdf", "slat.obj"], "--bsdf must be a BSDF in one word"),
        (["slat.obj", "--bsdf", "rectangle"], "bsdf must be a BSDF, got 'rectangle'"),
        (["slat.obj", "--bsdf", "diffuse", "--form", "plane"], "--form applies to"),
        (["diffuse", "--normal", "x"], "--normal applies to meshes"),
    ):
        assert cli.main(["measure", *words, "--theta-i", "30"]) == 1
        error = capsys.readouterr().err
        assert message in error
        assert error.count("\n") == 1


def test_a_damaged_mesh_is_told_by_its_reason_alone(tmp_path):
    path = tmp_path / "slat.stl"
    path.write_text("solid nothing")
    reason = rf"^the mesh {path} cannot be loaded: cannot load {path}: it holds no"
    with pytest.raises(gonio.SpecimenError, match=reason):
        gonio.mesh(path, MATT)


def test_facets_of_a_mesh_need_no_material(tmp_path, capsys):
    (tmp_path / "slat.obj").write_bytes(obj(CORNERS))
    command = ["surface", str(tmp_path / "slat.obj"), "--normal", "y"]
    assert cli.main(command) == 0
    facets = capsys.readouterr().out
    assert facets.startswith("facets  ")
    assert cli.main([*command, "--bsdf", "dielectric"]) == 0
    assert capsys.readouterr().out == facets


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"normal": "w"}, "normal must be one of"),
        ({"mean_plane": np.nan}, "mean_plane must be a finite number"),
        ({"bsdf": None}, "bsdf must say what the mesh slat.obj is made of"),
    ],
)
def test_bad_arguments_are_refused(tmp_path, options, message):
    (tmp_path / "slat.obj").write_bytes(obj(CORNERS))
    with pytest.raises(ValueError, match=message):
        gonio.mesh(tmp_path / "slat.obj", **({"bsdf": MATT} | options))
    with pytest.raises(ValueError, match="there is no file"):
        gonio.mesh(tmp_path / "none.obj", MATT)
    with pytest.raises(ValueError, match="path must end in"):
        gonio.mesh(tmp_path / "slat.dae", MATT)


def sentence_or(read):
    """What an error says, or what was read."""
    try:
        return None, read()
    except FileFormatError as error:
        return str(error), None


@pytest.mark.parametrize("text", [False, True], ids=["binary", "text"])
def test_damaged_files_are_the_same_triangles_or_a_sentence(tmp_path, text):
    """200 of them, cut or with bytes changed; sizes in headers exhaust nothing."""
    data, rng = stl(text=text), np.random.default_rng(1)
    path = tmp_path / "slat.stl"
    for number in range(200):
        damaged = bytearray(data[: rng.integers(len(data)) if number % 2 else None])
        for _ in range(number % 4):
            damaged[rng.integers(len(damaged) or 1) : 1] = bytes([rng.integers(256)])
        path.write_bytes(damaged)
        told, vertices = sentence_or(lambda: read_stl(path))
        if told is None:
            assert vertices.shape[1:] == (3, 3)
            assert len(vertices) <= 2
        else:
            assert told.startswith(f"cannot load {path}: ")
            assert "\n" not in told
    path.write_bytes(data[:80] + struct.pack("<I", 2**32 - 1) + data[84:])
    with pytest.raises(FileFormatError):
        read_stl(path)


@pytest.mark.parametrize(
    ("bsdf", "period", "told"),
    [
        ("dielectric", "box", True),
        ("dielectric", (2.5, 2.5), False),
        ("diffuse", "box", False),
        ("thindielectric", "box", False),
    ],
)
def test_walls_of_glass_in_the_sides_of_a_cell_are_told(recwarn, bsdf, period, told):
    block = {"type": "scene", "block": {"type": "cube", "bsdf": {"type": bsdf}}}
    gonio.measure(block, 30, period=period, rays=64)
    messages = [str(one.message) for one in recwarn]
    assert any("walls in the sides of the periodic cell" in m for m in messages) == told


def test_a_film_without_walls_is_not_told_of(recwarn):
    """Two faces of glass, and nothing at the sides."""
    turned = mi.ScalarTransform4f().translate([0, 0, -1]).rotate([1, 0, 0], 180)
    face = {"type": "rectangle", "bsdf": {"type": "dielectric"}}
    film = {"type": "scene", "top": face, "bottom": face | {"to_world": turned}}
    gonio.measure(film, 30, period="box", rays=64)
    assert not recwarn.list


def test_a_mesh_is_measured_in_other_processes(tmp_path):
    """Mitsuba's transforms cannot be sent by themselves; the bits are the same."""
    path = tmp_path / "slat.obj"
    path.write_text("v 0 0 0\nv 2 0 1\nv 2 1 1\nv 0 1 0\nf 1 2 3 4\n")
    slat = gonio.mesh(path, {"type": "diffuse"}, mean_plane=0.2)
    settings = {"theta_i": (0, 40), "rays": 500, "collector": "projected:2x4"}
    (here, there) = (
        gonio.campaign({"slat": slat}, **settings, period=(2, 1), executor=executor)
        for executor in (None, 1)
    )
    assert here["slat"].tallies == there["slat"].tallies

"""The tool that finds names which a later Mitsuba does not have."""

import mitsuba_names

OLD = """
    .def("has_vertex_normals", []() {}, D(Mesh, has_vertex_normals))
    .def("kept", []() {}) MI_PY_CLASS(Disk) props.get<float>("alpha")
"""


def test_a_planted_name_is_found(tmp_path):
    """Attribute, keyword, parameter, plugin and script; what stays is not named."""
    for name in ("package", "old", "new"):
        (tmp_path / name).mkdir()
    package, old, new = (tmp_path / name for name in ("package", "old", "new"))
    (old / "bumpy.cpp").write_text(OLD)
    new_text = OLD.replace("has_vertex_normals", "has_normals").replace("alpha", "beta")
    (new / "other.cpp").write_text(new_text)
    (new / "tests").mkdir()
    (new / "tests" / "t.py").write_text("mesh.has_vertex_normals = 1")
    source = """a = mesh.has_vertex_normals()\nb = {"type": "bumpy", "alpha": 1}
mesh.kept(Disk, alpha=2)\nc = "x = mesh.has_vertex_normals()"\nown = mesh.unknown"""
    (package / "a.py").write_text(source)
    (package / "mitsuba_compat.py").write_text("mesh.has_vertex_normals()")
    assert mitsuba_names.gone(package, [old], [new]) == {
        "has_vertex_normals": ["a.py:1", "a.py:4"],
        "bumpy": ["a.py:2"],
        "alpha": ["a.py:2", "a.py:3"],
    }

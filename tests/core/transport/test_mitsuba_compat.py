"""Names that Mitsuba 3.10 changes: those of either version answer the same.

3.10 is not to be had: a stand-in has its names and shapes, as its sources have them.
"""

import importlib.util
import sys
from importlib.metadata import entry_points
from types import SimpleNamespace

import mitsuba as mi
import numpy as np
import pytest

from gonio_mi import mitsuba_compat

POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.5]], np.float32)
FACES = np.array([[0, 1, 2], [1, 3, 2]], np.uint32)
UV = POINTS[:, :2].copy()


class NewMesh:
    """As `mi.Mesh` of 3.10: filled by one call, refuses a transform not applied."""

    def __init__(self, props):
        self.props = props

    def from_fields(self, faces, positions, normals=None, texcoords=None):
        assert self.props["to_world"] == "identity"
        given = {"normals": normals, "texcoords": texcoords}
        self.parameters = {"faces": faces, "positions": positions} | {
            key: x for key, x in given.items() if x is not None
        }


@pytest.fixture
def of_310(monkeypatch):
    """The module as it is where Mitsuba has the new names."""
    stand_in = SimpleNamespace(
        RayFlags=SimpleNamespace(Minimal=0, Shading=1, NormalPartials=2),
        Mesh=NewMesh,
        ScalarTransform4f=lambda: "identity",
        TensorXf32=np.float32,
        TensorXu32=np.uint32,
    )
    monkeypatch.setitem(sys.modules, "mitsuba", stand_in)
    path = mitsuba_compat.__file__
    spec = importlib.util.spec_from_file_location("gonio_mi.of_310", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_flags():
    flags = mi.RayFlags
    own = mitsuba_compat
    assert (
        flags.Minimal,
        flags.ShadingFrame,
        flags.All,
        flags.All | flags.dNSdUV,
    ) == (own.MINIMAL, own.FRAME, own.SURFACE, own.PARTIALS)


def test_new_flags(of_310):
    found = (of_310.MINIMAL, of_310.FRAME, of_310.SURFACE, of_310.PARTIALS)
    assert found == (0, 1, 1, 3)


def test_renamed_methods_of_a_mesh():
    """Either name is asked; a box that cannot be recomputed is as it is."""
    has_normals, recompute = mitsuba_compat.has_normals, mitsuba_compat.recompute_box
    for found in (True, False):
        assert has_normals(SimpleNamespace(has_normals=lambda f=found: f)) is found
        assert (
            has_normals(SimpleNamespace(has_vertex_normals=lambda f=found: f)) == found
        )
    recompute(SimpleNamespace())
    calls = []
    recompute(SimpleNamespace(recompute_bbox=lambda: calls.append(1)))
    assert calls == [1]


def test_mesh():
    mesh = mitsuba_compat.mesh_of(
        mi.Properties("ply"), "square", POINTS, FACES, texcoords=UV
    )
    points, faces = mitsuba_compat.triangles_of(mi.traverse(mesh))
    assert (points == POINTS).all()
    assert (faces == FACES).all()
    assert 'name = "square"' in str(mesh)
    assert mesh.has_vertex_texcoords()
    assert not mesh.has_vertex_normals()
    assert mitsuba_compat.triangles_of({"to_world": None}) is None


def test_new_mesh(of_310):
    props = {"to_world": "elsewhere"}
    mesh = of_310.mesh_of(props, "square", POINTS, FACES, texcoords=UV)
    assert set(mesh.parameters) == {"faces", "positions", "texcoords"}
    points, faces = of_310.triangles_of(mesh.parameters)
    assert (points == POINTS).all()
    assert (faces == FACES).all()
    # two vertices at each end of a seam
    seam = {"positions": POINTS, "faces": [[0, 1, 2], [4, 3, 5]]}
    seam["position_index"] = np.array([0, 1, 2, 3, 1, 2])
    assert (of_310.triangles_of(seam)[1] == FACES).all()


def test_entry_point():
    """From 3.10 on Mitsuba imports, and for each variant reloads, what is named."""
    (found,) = entry_points(group="mitsuba", name="gonio_mi")
    set_variant = mi.set_variant
    mi.register_bsdf("cosinelobe", lambda props: props)
    importlib.reload(found.load())
    assert isinstance(mi.load_dict({"type": "cosinelobe"}), mi.BSDF)
    assert mi.set_variant is set_variant

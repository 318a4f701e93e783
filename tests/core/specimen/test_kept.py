"""A specimen that is measured again is loaded once, and never an old one.

What is measured after a change is compared with what is measured where nothing was
kept; and with the same where everything is taken for unchanged, which must differ.
"""

import contextlib
import os
import subprocess
import sys
import threading
import warnings

import mitsuba as mi
import numpy as np
import plain_bsdf
import pytest

import gonio_mi as gonio
from gonio_mi.errors import SpecimenError
from gonio_mi.kernels import registered_by_others
from gonio_mi.specimen import kept, shapes
from gonio_mi.specimen.kept import Kept

pytestmark = pytest.mark.usefixtures("mono")

SMALL = {"rays": 2000, "batches": 2, "collector": "projected:3x4"}
SQUARE = """v -1 -1 0
v 1 -1 0
v 1 1 0
v -1 1 {height}
f 1 2 3
f 1 3 4
"""
SCENE = """<scene version="3.0.0"><shape type="rectangle"><bsdf type="diffuse">
<spectrum name="reflectance" value="{value}"/></bsdf></shape></scene>"""


def lambertian(reflectance):
    return {"type": "diffuse", "reflectance": reflectance}


def measured(specimen):
    """What tells one measurement from another: values, and digest and words."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of finite surfaces
        record = gonio.measure(specimen, theta_i=30, **SMALL)
    told = record.provenance
    return record.counts.tobytes(), record.brdf.tobytes(), told.digest, told.surface


def afresh(specimen):
    """The same where nothing is kept."""
    shapes.forget()
    return measured(specimen)


@pytest.fixture
def loads(monkeypatch):
    """Specimens that were loaded."""
    loaded = []

    def counted(specimen, *others):
        loaded.append(specimen)
        return specimen_of(specimen, *others)

    specimen_of = kept.specimen_of
    monkeypatch.setattr(kept, "specimen_of", counted)
    shapes.forget()
    return loaded


@pytest.fixture(autouse=True)
def nothing_kept():
    yield
    shapes.forget()


# ------------------------------------------------------------------------------- alike


def heights():
    return np.random.default_rng(1).random((9, 9)).astype(np.float32) / 9


def field():
    return {"type": "heightfield", "heights": mi.TensorXf(heights()), "size": 2.0}


def write_heights(path, values):
    """As an ASCII grid, which knows its size."""
    head = "ncols 9\nnrows 9\nxllcorner 0\nyllcorner 0\ncellsize 0.25"
    np.savetxt(path, values, header=head, comments="")


def file_of_heights(folder):
    path = folder / "surface.asc"
    write_heights(path, heights())
    return path


def mesh_file(folder):
    path = folder / "square.obj"
    path.write_text(SQUARE.format(height=0))
    return {"type": "obj", "filename": str(path), "bsdf": lambertian(0.5)}


ALIKE = {
    "dictionary": lambda _: lambertian(0.5),
    "nested": lambda _: {"type": "twosided", "bsdf": {"type": "roughconductor"}},
    "turned": lambda _: {
        "type": "sphere",
        "to_world": mi.ScalarTransform4f().rotate([0, 0, 1], 30),
        "bsdf": {"type": "plastic", "diffuse_reflectance": {"type": "rgb", "value": 1}},
    },
    "array": lambda _: lambertian({"type": "rgb", "value": np.full(3, 0.5)}),
    "tensor": lambda _: field(),
    "file in a dictionary": mesh_file,
    "file of heights": file_of_heights,
}


@pytest.mark.parametrize("kind", ALIKE)
def test_equal_descriptions_are_loaded_once(kind, loads, tmp_path):
    results = [measured(ALIKE[kind](tmp_path)) for _ in range(3)]
    assert len(loads) == 1
    assert results[0] == results[1] == results[2] == afresh(ALIKE[kind](tmp_path))


OBJECTS = {
    "bsdf": lambda: mi.load_dict(lambertian(0.5)),
    "shape": lambda: mi.load_dict({"type": "sphere", "bsdf": lambertian(0.5)}),
    "scene": lambda: mi.load_dict({"type": "scene", "a": {"type": "rectangle"}}),
    "in a dictionary": lambda: {
        "type": "rectangle",
        "bsdf": mi.load_dict(lambertian(0.5)),
    },
}


@pytest.mark.parametrize("kind", OBJECTS)
def test_an_object_is_described_and_tried_once(kind, loads):
    thing = OBJECTS[kind]()
    results = [measured(thing) for _ in range(3)]
    assert len(loads) == 1
    assert results[0] == results[1] == results[2] == afresh(thing)
    measured(OBJECTS[kind]())  # another one
    assert len(loads) == 3


# ------------------------------------------------------------------------------ changed


def edited(key, value, specimen):
    def change():
        specimen[key] = value

    return specimen, change


def nested_edited(_):
    inner = {"type": "roughconductor", "alpha": 0.2}
    _, change = edited("alpha", 0.4, inner)
    return {"type": "twosided", "bsdf": inner}, change


def array_edited(_):
    array = np.full(3, 0.5)

    def change():
        array[:] = 0.25

    return lambertian({"type": "rgb", "value": array}), change


def tensor_edited(_):
    specimen = field()

    def change():
        specimen["heights"][4, 4] = 0.5

    return specimen, change


def updated(thing, key, value, specimen=None):
    """An object, or what holds it, and its change by ``mi.traverse``."""

    def change():
        parameters = mi.traverse(thing)
        parameters[key] = value
        parameters.update()

    return thing if specimen is None else specimen, change


def bsdf_updated(_):
    return updated(mi.load_dict(lambertian(0.5)), "reflectance.value", 0.25)


def held_bsdf_updated(_):
    bsdf = mi.load_dict(lambertian(0.5))
    specimen = {"type": "rectangle", "bsdf": bsdf}
    return updated(bsdf, "reflectance.value", 0.25, specimen)


def held_texture_updated(_):
    texture = mi.load_dict({"type": "uniform", "value": 0.5})
    specimen = {"type": "diffuse", "reflectance": texture}
    return updated(texture, "value", 0.25, specimen)


def scene_updated(_):
    scene = mi.load_dict(
        {"type": "scene", "a": {"type": "rectangle", "bsdf": lambertian(0.5)}}
    )
    return updated(scene, "a.bsdf.reflectance.value", 0.25)


def vertices_moved(folder):
    mesh = mi.load_dict(mesh_file(folder))
    places = np.array(mi.traverse(mesh)["vertex_positions"])
    places[2] += 0.5
    return updated(mesh, "vertex_positions", mi.Float(places))


def file_rewritten(folder):
    """To the same length, and as if at the same time."""
    specimen = mesh_file(folder)

    def change():
        before = os.stat(specimen["filename"])
        with open(specimen["filename"], "w", encoding="utf-8") as file:
            file.write(SQUARE.format(height=1))
        os.utime(specimen["filename"], ns=(before.st_atime_ns, before.st_mtime_ns))

    return specimen, change


def heights_rewritten(folder):
    path = file_of_heights(folder)
    return path, lambda: write_heights(path, heights() * 2)


CHANGES = {
    "dictionary": lambda _: edited("reflectance", 0.25, lambertian(0.5)),
    "key added": lambda _: edited("alpha", 0.5, {"type": "roughconductor"}),
    "nested": nested_edited,
    "array": array_edited,
    "tensor": tensor_edited,
    "bsdf": bsdf_updated,
    "bsdf in a dictionary": held_bsdf_updated,
    "texture in a dictionary": held_texture_updated,
    "scene": scene_updated,
    "mesh": vertices_moved,
    "file": file_rewritten,
    "file of heights": heights_rewritten,
}


@pytest.mark.parametrize("kind", CHANGES)
def test_a_change_is_seen(kind, tmp_path):
    specimen, change = CHANGES[kind](tmp_path)
    before = afresh(specimen)
    change()
    assert measured(specimen) == afresh(specimen) != before


@pytest.mark.parametrize("kind", CHANGES)
def test_without_a_look_it_would_not_be(kind, tmp_path, monkeypatch):
    """The twin: what was kept would be measured or told."""
    monkeypatch.setattr(Kept, "is_same", lambda *_: True)
    specimen, change = CHANGES[kind](tmp_path)
    afresh(specimen)
    change()
    assert measured(specimen) != afresh(specimen)


def test_another_bsdf_of_the_same_words_is_seen(loads):
    """A shape that is given another BSDF, equal in all that is told of it."""
    shape = mi.load_dict({"type": "rectangle", "bsdf": lambertian(0.5)})
    measured(shape)
    if not hasattr(shape, "set_bsdf"):
        pytest.skip("this Mitsuba cannot")
    shape.set_bsdf(mi.load_dict(lambertian(0.5)))
    measured(shape)
    assert len(loads) == 2


def test_the_period_of_a_scene_is_read_each_time():
    scene = mi.load_dict(
        {
            "type": "scene",
            "a": field(),
            "integrator": {"type": "goniophotometer"},
        }
    )
    finite = measured(scene)
    own = scene.integrator()
    own.settings = own.settings.changed(period="box")
    assert measured(scene) == afresh(scene) != finite


@pytest.mark.usefixtures("rgb", "mono")
def test_a_variant_has_its_own():
    """Two that take turns."""
    specimen, results = lambertian(0.5), []
    for _ in range(2):
        for name in ("rgb", "mono"):
            mi.set_variant(f"llvm_ad_{name}")
            results.append(measured(specimen))
    assert results[:2] == results[2:]


# --------------------------------------------------------------------------- never kept


def test_a_scene_file_is_loaded_each_time(tmp_path):
    path = tmp_path / "scene.xml"
    for value in (0.5, 0.7):
        path.write_text(SCENE.format(value=value))
        assert measured(str(path)) == afresh(path)
        assert not shapes.kept


def test_a_plugin_that_is_registered_again():
    """As a notebook does when a cell is run again."""
    results = []
    for value in (0.5, 0.25):

        class TestAgain(plain_bsdf.plain()):
            reflectance = value

        plain_bsdf.register([TestAgain])
        results.append(measured({"type": "test_again"}))
        assert not shapes.kept
    assert results[0] != results[1]


def test_a_function_of_others_may_return_anything():
    values = iter([0.5, 0.25])
    mi.register_bsdf("test_any", lambda _: mi.load_dict(lambertian(next(values))))
    one, other = (measured({"type": "test_any"}) for _ in range(2))
    assert one != other


OVERRIDDEN = """
import gonio_mi as gonio
import mitsuba as mi

mi.set_variant("llvm_ad_mono")
settings = {"theta_i": 30, "rays": 2000, "batches": 2, "collector": "projected:3x4"}
print(round(float(gonio.measure({"type": "diffuse"}, **settings).dhr[0]), 3))
mi.register_bsdf("diffuse", lambda _: mi.load_dict({"type": "conductor"}))
print(round(float(gonio.measure({"type": "diffuse"}, **settings).dhr[0]), 3))
"""


def run(script):
    """What another process prints, with nothing on standard error."""
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=300
    )
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.split()


def test_a_plugin_in_place_of_one_of_mitsuba():
    assert run(OVERRIDDEN) == ["0.5", "1.0"]


def test_nothing_is_kept_once_others_take_our_names(monkeypatch):
    measured(lambertian(0.5))
    monkeypatch.setattr(kept, "registered_by_others", {*registered_by_others, "mask"})
    measured(lambertian(0.5))
    assert not shapes.kept


def test_a_warning_is_given_each_time():
    for _ in range(3):
        with pytest.warns(RuntimeWarning, match="alpha of the BSDF"):
            gonio.measure({"type": "roughconductor", "alpha": 9.0}, 30, **SMALL)


def test_what_cannot_be_measured_is_not_kept():
    """It would take part in all kernels from then on."""
    measured(lambertian(0.5))
    with pytest.raises(SpecimenError):
        gonio.measure({"type": "sphere"}, 30, estimator="quadrature", **SMALL)
    assert not shapes.kept


@pytest.mark.parametrize(
    "value", [np.ma.masked_array([1.0]), object(), np.array([object()]), "\0"]
)
def test_what_cannot_be_told_is_loaded(value):
    """Whatever Mitsuba says of it."""
    for _ in range(2):
        with contextlib.suppress(SpecimenError):
            measured({"type": "diffuse", "reflectance": value})
        assert not shapes.kept


@pytest.mark.parametrize("value", [10**5000, "\udc80"], ids=["number", "name"])
def test_what_mitsuba_cannot_read_has_its_sentence(value, capfd):
    with pytest.raises(SpecimenError, match=r"cannot be loaded"):
        measured({"type": "diffuse", "reflectance": value})
    assert not capfd.readouterr().err


# ---------------------------------------------------------------------------- as guests


def test_it_lives_until_another_is_measured():
    bsdf = mi.load_dict(lambertian(0.5))
    before = sys.getrefcount(bsdf)
    measured(bsdf)
    assert len(shapes.kept) == 1
    measured(lambertian(0.5))
    assert len(shapes.kept) == 1
    assert sys.getrefcount(bsdf) == before


def test_threads_take_turns():
    specimens = [lambertian(value) for value in (0.25, 0.5, 0.75)]
    alone, wrong = [afresh(one) for one in specimens], []

    def work(number):
        for _ in range(4):
            if measured(specimens[number]) != alone[number]:
                wrong.append(number)

    threads = [threading.Thread(target=work, args=(i % 3,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


def test_what_another_thread_has_kept_is_loaded(loads):
    """Dr.Jit refuses the variables of a thread that is younger than this one."""
    results = []

    def work():
        results.extend(measured(field()) for _ in range(2))

    for _ in range(2):
        thread = threading.Thread(target=work)
        thread.start()
        thread.join()
        work()
    assert len(results) == 8
    assert len(set(results)) == 1
    assert len(loads) == 4


def test_a_process_ends_in_order():
    """With specimens of two variants, one of them kept."""
    lines = OVERRIDDEN.splitlines()[:7]
    again = [*lines, 'mi.set_variant("llvm_ad_rgb")', lines[-1], lines[-1]]
    assert run("\n".join(again)) == ["0.5"] * 3

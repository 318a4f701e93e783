"""A folder holds one campaign: what does not belong is refused in a sentence.

All is exact.
"""

import shutil
import sys

import mitsuba as mi
import numpy as np
import pytest

import gonio_mi as gonio
from gonio_mi.campaigns import tasks
from gonio_mi.cli import main

PLATE = {"plate": {"type": "diffuse"}}
SETTINGS = {"rays": 200, "batches": 2, "collector": "projected:2x2"}

PLUGIN = """
import mitsuba as mi
import {helper} as helper

class Plain(mi.BSDF):
    def __init__(self, props):
        super().__init__(props)
        self.diffuse = mi.load_dict({{"type": "diffuse", "reflectance": {value}}})
        self.m_components = [self.diffuse.flags(0)]
        self.m_flags = self.diffuse.flags()

    def sample(self, *arguments):
        bs, weight = self.diffuse.sample(*arguments)
        return bs, weight * helper.FACTOR

    def eval(self, *arguments):
        return self.diffuse.eval(*arguments)

    def to_string(self):
        return "Plain"

mi.register_bsdf("{name}", Plain)
"""


@pytest.fixture
def folder(tmp_path):
    """Folder of a campaign at three angles, one a task."""
    measure(tmp_path / "kept", theta_i=[0, 30, 60])
    return tmp_path / "kept"


@pytest.fixture(autouse=True)
def one_direction_a_task(monkeypatch):
    monkeypatch.setattr(tasks, "TASK_RAYS", 1)


def measure(folder, theta_i=(0, 30, 60), specimens=PLATE, **settings):
    settings = SETTINGS | settings
    return gonio.campaign(specimens, theta_i, folder=folder, **settings)


def task_files(folder):
    return sorted(folder.glob("*.npz"))


@pytest.fixture
def refused(folder):
    """Function that returns the one sentence by which a folder is refused."""

    def refused(**changes):
        with pytest.raises(ValueError, match="folder must") as caught:
            measure(changes.pop("folder", folder), **changes)
        text = str(caught.value)
        assert "\n" not in text
        assert len(text) < 400
        assert "another folder" in text
        return text

    return refused


def test_swapped_files(folder, refused):
    first, second, _ = task_files(folder)
    shutil.copy(first, second)
    assert "with incidents [[0.0, 0.0]], not [[30.0, 0.0]]" in refused()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"rays": 201}, "rays 200, not 201"),
        ({"seed": 1}, "seed left out, not 1"),
        ({"batches": 3}, "batches 2, not 3"),
        ({"collector": "projected:2x4"}, "collector 'projected:2x2'"),
        ({"specimens": {"plate": {"type": "conductor"}}}, "{type: 'conductor'}"),
    ],
)
@pytest.mark.parametrize("described", [True, False])
def test_other_settings(folder, refused, change, words, described):
    """With campaign.json and, as task files say it too, without."""
    if not described:
        (folder / "campaign.json").unlink()
    assert words in refused(**change)


def test_a_specimen_of_another_name(refused):
    assert "specimen plate, not sheet" in refused(specimens={"sheet": PLATE["plate"]})


def test_seeds_that_double_precision_cannot_tell_apart(tmp_path, refused):
    measure(tmp_path / "big", seed=2**53)
    words = refused(folder=tmp_path / "big", seed=2**53 + 1)
    assert f"seed {2**53}, not {2**53 + 1}" in words


def test_arrays_that_their_texts_do_not_tell_apart(tmp_path, refused):
    def plate(roughness):
        image = mi.Bitmap(np.full((64, 64, 1), roughness, np.float32))
        return {
            "plate": {
                "type": "roughconductor",
                "alpha": {"type": "bitmap", "bitmap": image, "raw": True},
            }
        }

    measure(tmp_path / "image", specimens=plate(0.5))
    measure(tmp_path / "image", specimens=plate(0.5))
    words = refused(folder=tmp_path / "image", specimens=plate(0.25))
    assert "plate" in words


def test_an_emitter_that_was_turned_a_little(tmp_path, refused):
    def emitter(angle):
        to_world = mi.ScalarTransform4f().rotate([0, 1, 0], angle).translate([0, 0, 9])
        turned = to_world.rotate([1, 0, 0], 180)
        return {"type": "rectangle", "to_world": turned, "l": {"type": "area"}}

    measure(tmp_path / "emitter", emitter=emitter(0))
    assert "emitter" in refused(folder=tmp_path / "emitter", emitter=emitter(1e-5))


def test_a_folder_at_work(folder, refused):
    measure_each = tasks.measure_each

    def at_work(specimen, incidents, **settings):
        assert "another campaign is at work" in refused(folder=folder.parent / "busy")
        return measure_each(specimen, incidents, **settings)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tasks, "measure_each", at_work)
        measure(folder.parent / "busy", theta_i=0)
    measure(folder.parent / "busy", theta_i=0)


def test_a_mistaken_attempt_does_not_block(tmp_path):
    with pytest.raises(ValueError, match="estimator"):
        measure(tmp_path / "f", estimator="magic")
    assert len(measure(tmp_path / "f")["plate"]) == 3


def test_a_lost_description_is_written_again(folder, refused):
    before = (folder / "campaign.json").read_bytes()
    for content in (b"", b"\0" * 100):
        (folder / "campaign.json").write_bytes(content)
        measure(folder)
        assert (folder / "campaign.json").read_bytes() == before
    (folder / "campaign.json").write_bytes(b"notes of mine")
    assert "is something else" in refused()


def test_a_file_without_its_task(folder, refused):
    """As gonio-mi 0.1 wrote them, and as a user saves a record."""
    path = task_files(folder)[1]
    record = measure(folder)["plate"][1]
    assert "task" not in record.settings
    record.save(path)
    assert "another version of gonio-mi wrote 000001" in refused()


def test_task_files_are_records(folder):
    """They stack and merge as any others."""
    records = [gonio.load(path) for path in task_files(folder)]
    whole = gonio.Record.stack(records)
    assert whole.tallies == measure(folder)["plate"].tallies
    assert "task" not in whole.settings
    measure(folder.parent / "other", seed=1)
    other = gonio.load(task_files(folder.parent / "other")[0])
    assert "task" not in records[0].merge(other).settings


def test_what_killed_writers_left(folder):
    left = folder / ".gonio-0123456789abcdef.partial"
    left.write_bytes(b"half")
    measure(folder)
    assert not left.exists()
    assert len(task_files(folder)) == 3


# -------------------------------------------------------------------------- plugins


@pytest.fixture
def plugin(tmp_path, monkeypatch):
    """Function that writes a plugin and what it imports."""
    monkeypatch.syspath_prepend(tmp_path)
    helper = f"helper_of_{tmp_path.name}"

    def write(value=0.2, factor=1.0):
        sys.modules.pop(helper, None)
        (tmp_path / f"{helper}.py").write_text(f"FACTOR = {factor}\n")
        text = PLUGIN.format(helper=helper, value=value, name="test_plain")
        (tmp_path / "p.py").write_text(text)
        return tmp_path / "p.py"

    return write


@pytest.mark.parametrize("change", [{"value": 0.9}, {"factor": 0.5}])
def test_an_edited_plugin(plugin, tmp_path, capsys, change):
    """In a folder and in a record, whether it or what it imports was edited."""
    measuring = ["measure", "test_plain", "--theta-i", "0", "30", "60", "--rays", "1e3"]
    measuring += ["-q", "--collector", "projected:2x2", "--plugin", str(plugin())]
    kept = ["--folder", str(tmp_path / "kept")]
    out = str(tmp_path / "out.npz")
    assert main([*measuring, *kept, "-o", out]) == 0
    task_files(tmp_path / "kept")[1].unlink()
    plugin(**change)
    assert main([*measuring, *kept]) == 1
    assert "p.py" in capsys.readouterr().err
    assert main([*measuring, "--resume", out]) == 1
    said = capsys.readouterr().err
    assert "other code of plugins" in said or "another specimen" in said
    plugin()
    assert main([*measuring, *kept]) == 0
    assert main([*measuring, "--resume", out]) == 0


def test_a_plugin_edited_while_it_is_measured(plugin, tmp_path):
    specimens, path = {"plain": {"type": "test_plain"}}, plugin()

    measure_each = tasks.measure_each

    def edited(specimen, incidents, **settings):
        plugin(0.9)
        return measure_each(specimen, incidents, **settings)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tasks, "measure_each", edited)
        with pytest.raises(ValueError, match=r"p\.py was edited"):
            measure(tmp_path / "kept", specimens=specimens, plugins=[path])


def test_each_plugin_file_has_the_modules_of_its_own_folder(tmp_path):
    """Of one name in both, and known from the paths of the files alone."""
    factors, files = {"dark": 0.5, "bright": 1.0}, []
    for name, factor in factors.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "helper_of_both.py").write_text(f"FACTOR = {factor}\n")
        text = PLUGIN.format(helper="helper_of_both", value=0.5, name=f"test_{name}")
        files.append(tmp_path / name / "p.py")
        files[-1].write_text(text)
    specimens = {name: {"type": f"test_{name}"} for name in factors}
    records = gonio.campaign(specimens, [0, 30], **SETTINGS, plugins=files)
    for name, factor in factors.items():
        assert (records[name].dhr == 0.5 * factor).all()


def test_records_of_an_edited_class_do_not_merge(plugin):
    """The class of a module, without any list of plugin files."""
    records = []
    for seed, value in enumerate((0.2, 0.2, 0.9)):
        gonio.specimen.loading.load_plugin_file(plugin(value))
        records.append(gonio.measure({"type": "test_plain"}, 0, **SETTINGS, seed=seed))
    assert records[0].merge(records[1]).ledger.emitted == 400
    with pytest.raises(
        ValueError, match="must agree in the specimen to be merged, but theirs differ"
    ):
        records[0].merge(records[2])
    codes = [one.settings["plugin_digest"] for one in records]
    assert codes[0] == codes[1] != codes[2]
    assert (
        gonio.measure({"type": "diffuse"}, 0, **SETTINGS).settings["plugin_digest"]
        is None
    )

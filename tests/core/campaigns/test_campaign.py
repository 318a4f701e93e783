"""Campaigns: the same bits wherever they are measured, and nothing finished is lost.

All is exact. Processes are killed for real.
"""

import gc
import os
import random
import signal
import subprocess
import sys
import time
import weakref
from concurrent.futures import BrokenExecutor, ThreadPoolExecutor
from pathlib import Path

import mitsuba as mi
import plain_bsdf
import pytest

import gonio_mi as gonio
from gonio_mi.campaigns import tasks
from gonio_mi.cli import main
from gonio_mi.specimen import loading
from gonio_mi.specimen.shapes import forget

SPECIMENS = {
    "matt": {"type": "diffuse"},
    "metal": {"type": "roughconductor", "alpha": 0.3},
}
ANGLES = {"theta_i": [0, 40], "phi_i": [0, 90, 200]}
SETTINGS = {"rays": 5000, "batches": 4, "collector": "projected:6x6"}

# Dies once in each folder it is told of; afterwards a diffuse reflector.
DEADLY = """
import os
import mitsuba as mi

class Deadly(mi.BSDF):
    def __new__(cls, props):
        marker = props["marker"]
        if not os.path.exists(marker) or props.get("always", False):
            open(marker, "w").close()
            os._exit(9)
        return mi.load_dict({"type": "diffuse"})

mi.register_bsdf("deadly", Deadly)
"""


@pytest.fixture(scope="module")
def reference():
    return {k: gonio.measure(v, **ANGLES, **SETTINGS) for k, v in SPECIMENS.items()}


def same(records, reference):
    return {k: r.tallies for k, r in records.items()} == {
        k: r.tallies for k, r in reference.items()
    }


@pytest.mark.parametrize("where", [None, ThreadPoolExecutor, 2])
def test_same_bits_wherever(where, reference, monkeypatch):
    """One direction a task, so that they end in another order than they began."""
    executor = where(3) if where is ThreadPoolExecutor else where
    monkeypatch.setattr(tasks, "TASK_RAYS", 1)
    records = gonio.campaign(SPECIMENS, **ANGLES, **SETTINGS, executor=executor)
    assert same(records, reference)
    assert list(records["matt"].phi_i) == [0, 90, 200] * 2
    assert records["metal"].brdf.shape == (6, 6, 6, 1)


def test_a_cluster(reference):
    distributed = pytest.importorskip("distributed")
    how = {"n_workers": 1, "threads_per_worker": 1, "dashboard_address": ":0"}
    with (
        distributed.LocalCluster(processes=True, **how) as cluster,
        distributed.Client(cluster) as client,
    ):
        where = {"executor": client.get_executor(), "threads": 1}
        records = gonio.campaign(SPECIMENS, **ANGLES, **SETTINGS, **where)
    assert same(records, reference)


def test_measure_takes_an_executor_and_a_folder(reference, tmp_path):
    settings = {**ANGLES, **SETTINGS, "folder": tmp_path}
    with ThreadPoolExecutor(2) as pool:
        record = gonio.measure(SPECIMENS["metal"], **settings, executor=pool)
    assert record.tallies == reference["metal"].tallies
    settings = SETTINGS | {"folder": tmp_path / "b"}
    single = gonio.measure(SPECIMENS["metal"], 40, 90, **settings)
    assert not single.stacked
    assert single.tallies == reference["metal"][4].tallies


@pytest.mark.promise("after an interruption")
def test_what_is_finished_is_not_measured_again(reference, tmp_path, monkeypatch):
    monkeypatch.setattr(tasks, "TASK_RAYS", 1)
    gonio.campaign(SPECIMENS, **ANGLES, **SETTINGS, folder=tmp_path)
    files = sorted(tmp_path.glob("*.npz"))
    assert len(files) == 12
    files[3].unlink()
    files[7].write_bytes(files[7].read_bytes()[:100])
    measured, measure_each = [], tasks.measure_each

    def measure(specimen, incidents, **settings):
        measured.extend(incidents)
        return measure_each(specimen, incidents, **settings)

    monkeypatch.setattr(tasks, "measure_each", measure)
    records = gonio.campaign(SPECIMENS, **ANGLES, **SETTINGS, folder=tmp_path)
    assert measured == [(40, 0), (0, 90)]
    assert same(records, reference)


@pytest.fixture
def interrupted():
    """BSDF plugin that reflects diffusely, until its eighth sample() is interrupted."""

    class Interrupted(plain_bsdf.plain()):
        calls = 0

        def load(self, _):
            self.diffuse = mi.load_dict({"type": "diffuse"})

        def sample(self, *arguments):
            Interrupted.calls += 1
            if Interrupted.calls == 8:
                raise KeyboardInterrupt
            return self.diffuse.sample(*arguments)

    plain_bsdf.register([Interrupted])
    return Interrupted


def test_ctrl_c_keeps_whole_directions_only(interrupted, tmp_path, monkeypatch):
    monkeypatch.setattr(tasks, "TASK_RAYS", 1)
    specimen = {"type": "interrupted"}
    settings = ANGLES | SETTINGS | {"sampler": "independent"}
    with pytest.warns(RuntimeWarning, match="interrupted: the record holds"):
        part = gonio.measure(specimen, **settings)
    assert part.settings["interrupted"]
    assert len(part) > 1
    assert 0 < part.tallies[-1].n_batches < 4  # it came amid a direction
    interrupted.calls = 0
    with pytest.raises(KeyboardInterrupt):
        gonio.campaign({"matt": specimen}, **settings, folder=tmp_path)
    assert len(list(tmp_path.glob("*.npz"))) == len(part) - 1
    record = gonio.campaign({"matt": specimen}, **settings, folder=tmp_path)["matt"]
    assert record.tallies == gonio.measure(SPECIMENS["matt"], **settings).tallies


def test_a_relative_path_is_found_from_elsewhere(tmp_path, monkeypatch):
    scene = '<scene version="3.0.0"><shape type="rectangle"/></scene>'
    (tmp_path / "plate.xml").write_text(scene)
    monkeypatch.chdir(tmp_path)
    with ThreadPoolExecutor(1) as pool:
        submit = pool.submit

        def elsewhere(run, task):
            monkeypatch.chdir("/")
            return submit(run, task)

        monkeypatch.setattr(pool, "submit", elsewhere)
        record = gonio.measure("plate.xml", 0, **SETTINGS, executor=pool)
    assert record.settings["specimen"] == "plate.xml"


@pytest.mark.parametrize("where", [{}, {"folder": "missing/parent"}])
def test_a_specimen_that_is_no_file(where, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    said = r"there is no file .*diffuse; a BSDF is a dictionary such as \{.type.: .diff"
    with pytest.raises(gonio.SpecimenError, match=said):
        gonio.campaign({"b": "diffuse"}, **ANGLES, **SETTINGS, **where)


def test_a_folder_of_something_else(tmp_path):
    gonio.campaign(SPECIMENS, 0, **SETTINGS, folder=tmp_path / "a")
    for change in ({"rays": 5001}, {"seed": 1}, {"theta_i": 1}):
        arguments = {"theta_i": 0} | SETTINGS | change
        with pytest.raises(ValueError, match="must hold this very campaign"):
            gonio.campaign(SPECIMENS, **arguments, folder=tmp_path / "a")
    # the same number in other words
    gonio.campaign(SPECIMENS, 0, **SETTINGS | {"rays": 5e3}, folder=tmp_path / "a")
    (tmp_path / "campaign.json").write_text("[]")
    with pytest.raises(ValueError, match="a campaign or nothing"):
        gonio.campaign(SPECIMENS, 0, **SETTINGS, folder=tmp_path)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ({"specimens": {}}, "at least one"),
        ({"specimens": {"type": "diffuse"}}, "diffuse"),
        ({"theta_i": None}, "theta_i must be given"),
        ({"executor": 0}, "executor must be at least 1"),
        ({"estimator": "magic"}, "estimator must be"),
    ],
)
def test_bad_arguments(arguments, reason):
    arguments = {"specimens": SPECIMENS, "theta_i": 0} | SETTINGS | arguments
    with pytest.raises((TypeError, ValueError), match=reason):
        gonio.campaign(**arguments)


def test_what_cannot_be_sent():
    bsdf = mi.load_dict({"type": "diffuse"})
    with pytest.raises(ValueError, match="white must be plain values or a path"):
        gonio.campaign({"white": bsdf}, 0, **SETTINGS, executor=1)


@pytest.fixture
def deadly(tmp_path):
    plugin = tmp_path / "deadly.py"
    plugin.write_text(DEADLY)
    specimen = {"type": "deadly", "marker": str(tmp_path / "died")}
    return specimen, {"plugins": [plugin], "executor": 1}


def test_a_worker_that_dies_is_replaced(deadly, reference):
    """Unless it keeps dying."""
    specimen, settings = deadly
    always = {"matt": specimen | {"always": True}}
    with pytest.raises(BrokenExecutor):
        gonio.campaign(always, 0, **SETTINGS, **settings, retries=0)
    Path(specimen["marker"]).unlink()
    with pytest.warns(
        RuntimeWarning, match="a worker process died; 6 tasks are repeated"
    ):
        records = gonio.campaign({"matt": specimen}, **ANGLES, **SETTINGS, **settings)
    assert records["matt"].tallies == reference["matt"].tallies


def command(folder, output):
    angles = ("--theta-i", "0", "20", "40", "60", "--phi-i", "0", "90")
    settings = ("--rays", "3e6", "--collector", "projected:6x6", "-q")
    return ["measure", "diffuse", *angles, *settings, "--folder", folder, "-o", output]


def test_killed_at_random_moments(tmp_path):
    """SIGKILL, and the same command again: no finished file changes, the same bits."""
    folder, output = str(tmp_path / "folder"), str(tmp_path / "out.npz")
    moments = random.Random(0)
    process = [sys.executable, "-m", "gonio_mi.cli", *command(folder, output)]
    finished = {}
    for _ in range(int(os.environ.get("GONIO_KILLS", 2))):
        with subprocess.Popen(process) as running:
            while not list(tmp_path.glob("folder/*.json")) and running.poll() is None:
                time.sleep(0.01)
            time.sleep(moments.uniform(0, 1.0))
            running.send_signal(signal.SIGKILL)
        now = {path: path.read_bytes() for path in tmp_path.glob("folder/*.npz")}
        assert finished.items() <= now.items()
        finished = now
    assert main(command(folder, output)) == 0
    whole = gonio.measure(
        {"type": "diffuse"},
        [0, 20, 40, 60],
        [0, 90],
        rays=3e6,
        collector="projected:6x6",
    )
    assert gonio.load(output).tallies == whole.tallies


def test_a_campaign_of_a_given_precision_is_the_stack():
    """Its tasks reach unlike errors, of which the stack tells the largest."""
    how = {"theta_i": [0, 30], "rel_err": 0.5, "collector": "angle:2x2"}
    record = gonio.campaign({"matt": {"type": "diffuse"}}, **how)["matt"]
    stack = gonio.measure({"type": "diffuse"}, **how)
    assert record.tallies == stack.tallies
    free = {"created", "specimen"}
    own, others = (
        {k: v for k, v in one.settings.items() if k not in free}
        for one in (record, stack)
    )
    assert own == others


def test_a_specimen_is_loaded_once_in_a_row(tmp_path, monkeypatch):
    """By all tasks of a campaign in this process; twin: by each, outside of one."""
    load, loads = loading._scene, []
    monkeypatch.setattr(loading, "_scene", lambda *how: loads.append(1) or load(*how))
    plate, how = {"type": "diffuse"}, {"rays": 100, "collector": "projected:2x2"}
    found = gonio.campaign({"a": plate}, [0, 30, 60], folder=tmp_path, **how)["a"]
    assert len(list(tmp_path.glob("0*.npz"))) == 3
    assert len(loads) == 1
    for number, theta_i in enumerate((0, 30, 60)):
        forget()  # else it would be kept
        assert gonio.measure(plate, theta_i, **how).tallies == found[number].tallies
    assert len(loads) == 4


def test_an_error_keeps_no_specimen(monkeypatch):
    """Its traceback would let it take part in all kernels from then on."""
    load, made = tasks.specimen_of, []

    def loads(*how):
        specimen = load(*how)
        made.append(weakref.ref(specimen))
        return specimen

    monkeypatch.setattr(tasks, "specimen_of", loads)
    with pytest.raises(gonio.SpecimenError, match="must enclose") as error:
        gonio.campaign({"ball": {"type": "sphere"}}, [0], collector_radius=0.5)
    gc.collect()
    assert error.tb is not None
    assert [one() for one in made] == [None]


def test_tensors_of_a_specimen_stay():
    """A texture's are still there when it is loaded again, and when it was refused."""
    pixels = mi.TensorXf([[0.2, 0.4], [0.6, 0.8]]).array
    image = {"type": "bitmap", "raw": True, "data": mi.TensorXf(pixels, (2, 2, 1))}
    board = {"type": "diffuse", "reflectance": image}
    once = gonio.measure(board, 0, rays=1000, footprint="full")
    records = gonio.campaign({"board": board}, [0, 40], rays=1000, footprint="full")
    assert image["data"].shape == (2, 2, 1)
    assert records["board"][0].tallies == once.tallies

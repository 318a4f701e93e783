"""What users do around a measurement: threads, Dr.Jit's flags, plugins that raise."""

import gc
import os
import subprocess
import sys
import threading
import warnings
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from threading import Thread

import drjit as dr
import mitsuba as mi
import plain_bsdf
import pytest
from specimens import OnGPU

import gonio_mi as gonio
from gonio_mi import threads
from gonio_mi.campaigns import tasks
from gonio_mi.campaigns.measure import measure_whole
from gonio_mi.cli import main
from gonio_mi.commands.arguments import INCOMPLETE
from gonio_mi.errors import LostLightWarning, SpecimenError, VariantError, is_ctrl_c
from gonio_mi.instrument import launcher
from gonio_mi.kernels import check_all_counted, launches_kernels
from gonio_mi.specimen.loading import load_specimen
from gonio_mi.threads import drjit_lock, thread_count, two_threads
from gonio_mi.transport import sampling, sums
from gonio_mi.transport.collector_sphere import DRJIT
from gonio_mi.transport.sampling import rays_per_lane

PLATE = {"type": "diffuse", "reflectance": 0.7}
SMALL = {"rays": 2000, "batches": 2, "collector": "projected:3x4"}


# ------------------------------------------------------------------------- threads


@pytest.fixture(autouse=True, scope="module")
def several_threads():
    """Several of Dr.Jit's own too, also where a process of the tests has one."""
    before = dr.thread_count()
    dr.set_thread_count(4)
    yield
    dr.set_thread_count(before)


def test_threads_share_the_instrument():
    """Exact: 80 measurements in four threads have the bits of one after the other.

    Without the lock 17 of 400 were wrong: of half as many, none in one run of five.
    """
    ways = [SMALL | {"seed": seed, "trace": seed == 4} for seed in range(5)]
    alone = [gonio.measure(PLATE, 30, **way).tallies for way in ways]
    todo = list(range(len(ways))) * 16
    with ThreadPoolExecutor(4) as pool:
        found = pool.map(lambda i: gonio.measure(PLATE, 30, **ways[i]).tallies, todo)
    assert all(tallies == alone[i] for i, tallies in zip(todo, found))


def test_threads_validate_and_render_too():
    """Exact: what else launches kernels takes its turn."""
    parts = {
        "plate": {"type": "rectangle", "bsdf": PLATE},
        "emitter": {"type": "directional", "direction": [0, 0, -1]},
        "sensor": {"type": "collector", "film": {"type": "patches"}},
        "integrator": {"type": "goniophotometer", "rays": 2000},
    }
    scene = mi.load_dict({"type": "scene", **parts})

    def rendered(_):
        return mi.render(scene).numpy().tobytes()

    def measured(_):
        return gonio.measure(PLATE, 30, **SMALL).tallies[0].sums.tobytes()

    with ThreadPoolExecutor(4) as pool:
        images = pool.map(rendered, range(8))
        sums = pool.map(measured, range(8))
        assert set(images) == {rendered(0)}
        assert set(sums) == {measured(0)}


def test_threads_of_a_campaign_do_not_wait_for_each_other():
    """A pool of threads measures while the thread that asked it waits."""
    with ThreadPoolExecutor(2) as pool:
        stack = gonio.measure(PLATE, [10, 20, 30], executor=pool, **SMALL)
    assert stack.tallies == gonio.measure(PLATE, [10, 20, 30], **SMALL).tallies


def in_a_thread(do):
    thread = Thread(target=do)
    thread.start()
    return thread


def others_may_record():
    """Whether another thread could record a kernel now."""
    free = []

    def tries():
        free.append(drjit_lock.acquire(blocking=False))
        if free[0]:
            drjit_lock.release()

    in_a_thread(tries).join()
    return free[0]


def test_nobody_records_while_threads_are_more_or_fewer(monkeypatch):
    """Dr.Jit writes out of bounds if they become more after a sum was recorded."""
    seen = []

    def looks(_=None):
        seen.append(others_may_record())

    monkeypatch.setattr(threads, "_set_thread_count", looks)
    with thread_count(dr.thread_count() + 1):
        looks()
    assert seen == [False] * 3
    assert others_may_record()


def test_threads_are_counted_when_nobody_changes_them(monkeypatch):
    """Those of another thread's campaign are gone when an EXR file is read."""
    seen = []

    def counted():
        seen.append(others_may_record())
        return 1

    monkeypatch.setattr(dr, "thread_count", counted)
    monkeypatch.setattr(threads, "_set_thread_count", lambda _: None)
    with two_threads():
        assert seen
        assert not any(seen)


@pytest.mark.parametrize(
    ("count", "forked", "changes"), [(1, 0, [2, 1]), (3, 0, []), (3, 1, [])]
)
def test_there_is_a_thread_that_reads_files(count, forked, changes, monkeypatch):
    """After a fork none of those that Dr.Jit counts is there, and none can be ended."""
    changed = []
    monkeypatch.setattr(dr, "thread_count", lambda: count)
    monkeypatch.setattr(threads, "_process", os.getpid() + forked)
    monkeypatch.setattr(threads, "_set_thread_count", changed.append)
    there = threading.active_count()
    with two_threads():
        assert threading.active_count() == there + forked
    assert changed == changes
    with thread_count(2):
        pass
    assert changed == changes + (not forked) * [2, count]


def test_what_was_recorded_is_computed_before_threads_change():
    """Exact: sums that wait are those of the threads that there were."""
    total, index = dr.zeros(mi.UInt32, 1), dr.arange(mi.UInt32, 10**6)
    dr.scatter_add(total, index, index % 1)
    with thread_count(dr.thread_count() + 3):
        pass
    assert int(total[0]) == 10**6 * (10**6 - 1) // 2 % 2**32


def test_a_gpu_has_lanes_enough(monkeypatch):
    """Exact: many in media too, whatever the threads; rays have the same bits."""
    scene = mi.load_file("scenes/milk_glass.xml")
    usual = gonio.measure(scene, 30, **SMALL).tallies
    sobol = mi.load_dict({"type": "sobol"})
    assert rays_per_lane(sobol, 2**20) > 2**9
    monkeypatch.setattr(sampling, "mi", OnGPU())
    assert rays_per_lane(sobol, 2**20) == 2**3
    assert gonio.measure(scene, 30, **SMALL).tallies == usual


def test_ctrl_c_leaves_as_many_threads_as_there_were(monkeypatch):
    before, change = dr.thread_count(), threads._set_thread_count

    def interrupted(n):
        change(n)
        if n == 1:
            raise KeyboardInterrupt

    monkeypatch.setattr(threads, "_set_thread_count", interrupted)
    with pytest.raises(KeyboardInterrupt), thread_count(1):
        pass
    assert dr.thread_count() == before > 1


# ----------------------------------------------------------------- a process of others

# Seconds after which a process is taken to hang, on a machine however busy.
HANGS = 300

HOST = """
import _thread, multiprocessing, os, signal, sys, threading, time
import mitsuba as mi
import numpy as np
import gonio_mi as gonio

mi.set_variant("llvm_ad_mono")
SMALL = {"rays": 2000, "batches": 2, "collector": "angle:2x2"}

def measured(seed=0, bsdf={"type": "roughconductor"}):
    np.linalg.inv(np.random.rand(300, 300))  # by threads of NumPy's
    return float(gonio.measure(bsdf, 30, seed=seed, **SMALL).dhr[0])

scene = mi.load_dict({
    "type": "scene",
    "plate": {"type": "rectangle", "bsdf": {"type": "diffuse"}},
    "emitter": {"type": "directional", "direction": [0, 0, -1]},
    "sensor": {"type": "collector", "film": {"type": "patches"}},
    "integrator": {"type": "goniophotometer", "rays": 2000},
})
expected, shown = measured(), np.array(mi.render(scene))
"""

# Dr.Jit's threads need Python's lock to release an image that they have written.
PICTURES = """
image = mi.TensorXf(np.random.rand(1024, 1024, 3).astype(np.float32))
for name in ("a.png", "b.exr", "c.jpg"):
    mi.util.write_bitmap(name, image)
    assert measured() == expected
print("measured")
for i in range(50):
    mi.util.write_bitmap(f"{i}.exr", mi.render(scene))
print("rendered")
mi.util.write_bitmap("d.png", image)
assert gonio.validate({"type": "diffuse"}, effort="quick").passed
print("validated")
mi.util.write_bitmap("e.png", image)
gonio.campaign({"a": {"type": "diffuse"}}, [10, 20], threads=1, **SMALL)
print("campaigned")
"""

FORKS = """
mi.Bitmap(np.full((4, 4), 0.5, np.float32)).write("half.exr")
texture = {"type": "bitmap", "filename": "half.exr", "raw": True}
painted = {"type": "diffuse", "reflectance": texture}

def forked(right):
    child = os.fork()
    if not child:
        os._exit(0 if right() else 1)
    assert os.waitpid(child, 0)[1] == 0

forked(lambda: measured() == expected)
print("measured")
forked(lambda: gonio.validate({"type": "diffuse"}, effort="quick").passed)
print("validated")
expected = measured(0, painted)  # EXR files are read in other threads
forked(lambda: measured(0, painted) == expected)
print("read")
forked(lambda: gonio.campaign({"a": painted}, [10, 20], threads=1, **SMALL))
print("campaigned")
with multiprocessing.get_context("fork").Pool(2) as pool:
    assert pool.map(measured, range(4)) == [measured(seed) for seed in range(4)]
print("pooled")
"""

# Such threads are those of C and of toolkits, too.
UNLISTED = """
def beside_images(job):
    done, ended = [], _thread.allocate_lock()

    def works():
        with ended:
            done.extend(job() for _ in range(20))

    _thread.start_new_thread(works, ())
    while not done or ended.locked():
        assert (np.array(mi.render(scene)) == shown).all()
    return done

assert beside_images(measured) == 20 * [expected]
print("measured")
beside_images(lambda: mi.load_dict({"type": "cosinelobe", "exponent": 20.0}))
print("loaded")

# what a shell starts in the background ignores it
signal.signal(signal.SIGINT, signal.default_int_handler)

def presses():
    time.sleep(0.5)
    os.kill(os.getpid(), signal.SIGINT)

threading.Thread(target=presses).start()
try:
    gonio.measure({"type": "roughconductor"}, 30, rays=10**13)
except KeyboardInterrupt:
    pass  # or a record of what was measured
print("interrupted")
"""

EXIT = """
def goes_on():
    while True:
        measured()
        if not started.is_set():
            print("measured", flush=True)
        started.set()

started = threading.Event()
threading.Thread(target=goes_on, daemon=True).start()
started.wait()
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")
@pytest.mark.parametrize(
    ("script", "steps"),
    [
        (PICTURES, "measured rendered validated campaigned"),
        (FORKS, "measured validated read campaigned pooled"),
        (UNLISTED, "measured loaded interrupted"),
        (EXIT, "measured"),
    ],
    ids=["pictures", "forks", "unlisted", "exit"],
)
def test_a_process_does_what_it_likes(script, steps, tmp_path):
    """Exact: it neither hangs nor crashes, and its numbers are the same."""
    command = [sys.executable, "-W", "ignore", "-c", HOST + script]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=HANGS, cwd=tmp_path
    )
    assert (done.returncode, done.stderr, done.stdout.split()) == (0, "", steps.split())


# ----------------------------------------------------------------------------- tasks


def task_of_plate():
    (task,) = tasks.tasks_of({"plate": PLATE}, [(30, 0)], (), None, SMALL)
    return task


def test_nobody_records_while_a_task_is_at_work(monkeypatch):
    """Also while its specimen is looked at: rays of others were lost."""
    seen = []
    measure, load = tasks.measure_each, tasks.specimen_of

    def measures(*arguments, **settings):
        seen.append(others_may_record())
        return measure(*arguments, **settings)

    def looks_at(*arguments):
        seen.append(others_may_record())
        return load(*arguments)

    monkeypatch.setattr(tasks, "measure_each", measures)
    monkeypatch.setattr(tasks, "specimen_of", looks_at)
    task = task_of_plate()
    assert task.digests()["digest"] == tasks.run_task(task).provenance.digest
    assert seen == [False] * 3
    assert others_may_record()


@pytest.mark.parametrize(
    "measure",
    [
        lambda: measure_whole(PLATE, 30, **SMALL),
        lambda: tasks.run_task(task_of_plate()),
    ],
    ids=["whole", "task"],
)
def test_warnings_of_other_threads_are_heard(measure, monkeypatch):
    """Those that a measurement does not give are not switched off for the process."""
    send = launcher.launch

    def warns():
        warnings.warn("in no patch", LostLightWarning, stacklevel=1)

    def sends(one):
        in_a_thread(warns).join()
        return send(one)

    monkeypatch.setattr(launcher, "launch", sends)
    with pytest.warns(LostLightWarning, match="in no patch"):
        measure()


def test_a_change_of_variant_waits_for_the_measurement(monkeypatch):
    """Of another thread; which sets it in the end, and this one's is no longer set."""
    send, threads = launcher.launch, []

    def changes(one):
        threads.append(in_a_thread(lambda: mi.set_variant("llvm_ad_rgb")))
        threads[0].join(0.05)
        return send(one)

    monkeypatch.setattr(launcher, "launch", changes)
    assert gonio.measure(PLATE, 30, **SMALL).settings["variant"] == "llvm_ad_mono"
    monkeypatch.undo()
    for thread in threads:
        thread.join()
    refused = (
        "this thread has set the variant llvm_ad_mono, and another one llvm_ad_rgb"
    )
    with pytest.raises(VariantError, match=refused):
        gonio.measure(PLATE, 30, **SMALL)
    mi.set_variant("llvm_ad_rgb")
    assert gonio.measure(PLATE, 30, **SMALL).settings["variant"] == "llvm_ad_rgb"


def test_a_change_of_variant_that_does_not_wait_is_noticed(monkeypatch):
    """By a function that was imported before gonio_mi."""
    send = launcher.launch
    set_variant = mi.set_variant.__wrapped__

    def changes(one):
        totals = send(one)
        in_a_thread(lambda: set_variant("llvm_ad_rgb")).join()
        return totals

    monkeypatch.setattr(launcher, "launch", changes)
    with pytest.raises(VariantError, match="llvm_ad_mono was changed to llvm_ad_rgb"):
        gonio.measure(PLATE, 30, **SMALL)


def test_a_thread_may_set_variants_by_either_function():
    """Both are this thread's; another thread's is refused, however it is set."""
    bare = mi.set_variant.__wrapped__
    bare("llvm_ad_rgb")
    assert gonio.measure(PLATE, 30, **SMALL).settings["variant"] == "llvm_ad_rgb"
    in_a_thread(lambda: bare("llvm_ad_mono")).join()
    with pytest.raises(VariantError, match="has set the variant llvm_ad_rgb, and"):
        gonio.measure(PLATE, 30, **SMALL)
    mi.set_variant("llvm_ad_mono")  # the same as before, and now this thread's
    assert gonio.measure(PLATE, 30, **SMALL).settings["variant"] == "llvm_ad_mono"


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_an_error_comes_out_after_a_change_of_variant(error):
    @launches_kernels()
    def changes(name, *errors):
        mi.set_variant(name)
        for one in errors:
            raise one

    with pytest.raises(error, match="the first"):
        changes("llvm_ad_rgb", error("the first"))
    changed = "changed to llvm_ad_mono during a measurement: all threads"
    with pytest.raises(VariantError, match=changed):
        changes("llvm_ad_mono")


def test_threads_of_other_variants_get_their_own_numbers_or_none():
    """Of 24 jobs in four threads; once a third got another's numbers, or crashed."""
    names = "llvm_ad_mono", "llvm_ad_rgb"

    def job(i):
        mi.set_variant(names[i % 2])
        try:
            record = gonio.measure(PLATE, 30, trace=i % 3 == 0, **SMALL)
        except VariantError:
            return True
        return record.settings["variant"] == names[i % 2]

    with ThreadPoolExecutor(4) as pool:
        assert all(pool.map(job, range(24)))
    mi.set_variant("llvm_ad_mono")


def test_lost_rays_are_an_error():
    check_all_counted(10, 10)
    with pytest.raises(gonio.LostRaysError, match="all 10 rays of a launch, got 9"):
        check_all_counted(10, 9)


def test_every_launch_is_checked(monkeypatch):
    """A kernel that loses one ray in two never becomes a record."""
    scatter = dr.scatter_reduce

    def lossy(op, target, value, index, active, mode):
        scatter(op, target, value, index, active & (index % 2 == 0), mode)

    monkeypatch.setattr(dr, "scatter_reduce", lossy)
    with pytest.raises(gonio.LostRaysError):
        gonio.measure(PLATE, 30, **SMALL)


# --------------------------------------------------------------------------- flags

# Flags that leave the numbers as they are, and whether they are on by default.
HARMLESS = """
    CompressLoops ConstantPropagation Debug KernelFreezing KernelHistory LaunchBlocking
    OptimizeCalls OptimizeLoops PacketOps ReuseIndices ScatterReduceLocal SymbolicCalls
    SymbolicConditionals SymbolicLoops ValueNumbering
"""


@pytest.mark.parametrize("name", HARMLESS.split())
@pytest.mark.parametrize("trace", [False, True])
def test_flags_do_not_change_the_bits(name, trace, rgb):  # noqa: ARG001
    """Exact: each flag of Dr.Jit the other way round, with several threads' sums."""
    way = SMALL | {"rays": 40_000, "batches": 4, "trace": trace, "sampler": "sobol"}
    before = gonio.measure(PLATE, 30, **way)
    flag = getattr(dr.JitFlag, name)
    level = dr.log_level()
    dr.set_log_level(dr.LogLevel.Error)  # Dr.Jit warns of what it does not switch off
    try:
        with dr.scoped_set_flag(flag, not dr.flag(flag)):
            flipped = gonio.measure(PLATE, 30, **way)
    finally:
        dr.set_log_level(level)
        dr.kernel_history_clear()
    assert flipped.tallies == before.tallies
    assert flipped.ledger.emitted == 40_000


@pytest.mark.parametrize(
    "name",
    ["MergeFunctions", "ForbidSynchronization", "FreezingScope", "SymbolicScope"],
)
def test_flags_that_break_dr_jit_are_refused(name):
    flag = getattr(dr.JitFlag, name)
    usual = dr.flag(flag)
    sentence = f"flag {name} must be {'on' if usual else 'off'}"
    dr.set_flag(flag, not usual)
    try:
        for function in (load_specimen, partial(gonio.measure, theta_i=30, **SMALL)):
            with pytest.raises(gonio.VariantError, match=sentence):
                function(PLATE)
    finally:
        dr.set_flag(flag, usual)
    assert gonio.measure(PLATE, 30, **SMALL).ledger.emitted == 2000


# ------------------------------------------------------------------- plugins that raise


def registered(name, mistake):
    """Register a matte BSDF whose ``sample`` or ``eval`` raises after a first call.

    That one is a trial, outside of any kernel.
    """
    calls = []

    def called(function):
        calls.append(function)
        if mistake == function and calls.count(function) > 1:
            raise ArithmeticError(f"a mistake in {function}")

    class Plugin(plain_bsdf.plain()):
        reflectance = 0.7

        def sample(self, *arguments):
            called("sample")
            return super().sample(*arguments)

        def eval(self, *arguments):
            called("eval")
            return super().eval(*arguments)

    mi.register_bsdf(name, Plugin)


def test_what_was_refused_takes_part_in_no_kernel():
    """A BSDF without `sample`, though its error is kept and no garbage collected."""

    class Lacking(plain_bsdf.plain()):
        sample = mi.BSDF.sample

        def load(self, _):
            checks = {"type": "diffuse", "reflectance": {"type": "checkerboard"}}
            self.nested = mi.load_dict(checks)

        def eval(self, *arguments):
            return self.nested.eval(*arguments)

    mi.register_bsdf("lacking_sample", Lacking)
    gc.disable()
    try:
        with pytest.raises(SpecimenError, match="the same BSDF all over") as kept:
            gonio.measure({"type": "lacking_sample"}, 30, estimator="quadrature")
        assert gonio.measure(PLATE, 30, **SMALL, trace=True).ledger.emitted > 0
        assert kept.value.__traceback__ is not None
    finally:
        gc.enable()


@pytest.mark.parametrize("where", ["trial", "launch"])
def test_what_failed_takes_part_in_no_picture_of_the_host(where):
    """Bumps that Mitsuba cannot compute; of a class the last BSDF is tried."""
    heights = mi.TensorXf([0, 1, 0, 1], (2, 2, 1))
    bad, good = (
        {"type": "checkerboard"},
        {"type": "bitmap", "data": heights, "raw": True},
    )
    bumps = [good, bad] if where == "trial" else [bad, good]
    plates = {
        f"plate{i}": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().translate([0, 0, i]),
            "bsdf": {"type": "bumpmap", "bumps": bump, "bsdf": PLATE},
        }
        for i, bump in enumerate(bumps)
    }
    with pytest.raises(RuntimeError if where == "launch" else SpecimenError) as error:
        gonio.measure({"type": "scene"} | plates, 30, **SMALL)
    assert "eval_1_grad" in str(error.value)
    film = {"type": "hdrfilm", "width": 4, "height": 4, "pixel_format": "luminance"}
    camera = {"type": "perspective", "film": film}
    scene = mi.load_dict(
        {"type": "scene", "a": camera, "b": {"type": "constant"}, "c": {"type": "cube"}}
    )
    image = mi.render(scene, integrator=mi.load_dict({"type": "path"}), spp=1)
    assert dr.all(dr.isfinite(image.array))


@pytest.mark.parametrize(
    ("function", "way"),
    [
        ("sample", {"trace": True}),
        ("sample", {"sampler": "independent"}),
        ("sample", {}),
        ("eval", {"trace": True, "estimator": "next_event"}),
    ],
)
def test_plugin_that_raises(function, way):
    """Its own error comes out, and goes away with its cause, though it is kept.

    As in Jupyter, which keeps the last error, and with it all that its traceback holds.
    """
    name = f"mistaken_{function}_{len(way)}_{'sampler' in way}"
    registered(name, function)
    with pytest.raises(ArithmeticError, match=f"^a mistake in {function}$") as kept:
        gonio.measure({"type": name}, 30, **SMALL, **way)
    assert kept.value.__traceback__ is not None
    assert kept.value.__suppress_context__ or kept.value.__context__ is None
    good = gonio.measure(PLATE, 30, **SMALL, **way)
    registered(name, "none")
    mended = gonio.measure({"type": name}, 30, **SMALL, **way)
    assert good.ledger == mended.ledger


@pytest.mark.parametrize("n", [1, 2])
def test_errors_that_cause_themselves_come_out(n):
    """As in ``raise error from error``, and in a circle of `n`."""
    errors = [ArithmeticError(f"error {i}") for i in range(n)]
    for i, error in enumerate(errors):
        error.__cause__ = errors[(i + 1) % n]
    assert not is_ctrl_c(errors[0])
    wrapper = RuntimeError("Dr.Jit encountered an exception")
    with pytest.raises(ArithmeticError, match=f"error {n - 1}"), launches_kernels():
        raise wrapper from errors[0]


def built(_):
    """Constructor in which Ctrl-C is pressed."""
    raise KeyboardInterrupt


def nested(_):
    """Constructor of a plugin that holds such a one."""
    return mi.load_dict({"type": "pressed_built"})


def named_alike(_):
    raise RuntimeError("KeyboardInterrupt")


@pytest.mark.parametrize("constructor", [built, nested])
def test_ctrl_c_while_a_plugin_is_built(constructor, capsys):
    """Of which Mitsuba keeps the text alone; the command said it was a bug of ours."""
    mi.register_bsdf("pressed_built", built)
    mi.register_bsdf("pressed", constructor)
    with pytest.raises(KeyboardInterrupt):
        gonio.measure({"type": "pressed"}, 30, **SMALL)
    assert main(["measure", "pressed", "--theta-i", "30"]) == INCOMPLETE
    assert "interrupted: nothing was finished" in capsys.readouterr().err


def test_ctrl_c_while_a_plugin_of_ours_is_built(monkeypatch, capsys):
    mi.load_dict({"type": "heightfield"})  # imports the plugin
    monkeypatch.setattr("gonio_mi.plugins.shapes.heightfield._topography", built)
    assert main(["measure", "heightfield", "--theta-i", "30"]) == INCOMPLETE
    assert "interrupted: nothing was finished" in capsys.readouterr().err


def test_twin_only_the_name_of_ctrl_c():
    mi.register_bsdf("named_alike", named_alike)
    with pytest.raises(SpecimenError, match='"named_alike": RuntimeError: KeyboardI'):
        gonio.measure({"type": "named_alike"}, 30, **SMALL)


# ------------------------------------------------------------------- one kernel each


def in_two_kernels(target, value, index, active):
    """`sums._scatter_add` of what is told by a plain scatter, which evaluates."""
    if dr.width(target) == sums.LEVELS:
        dr.scatter(target, value, index, active)
    else:
        dr.scatter_reduce(dr.ReduceOp.Add, target, value, index, active)


@pytest.mark.parametrize("scatter", [None, in_two_kernels], ids=["right", "twin"])
def test_a_launch_is_one_kernel(scatter, monkeypatch):
    """Exact: rays that add to several sums are followed once, and no oftener."""
    if scatter:
        monkeypatch.setattr(sums, "_scatter_add", scatter)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        gonio.measure(PLATE, 30, trace=True, estimator="next_event", rays=2**14)
        history = dr.kernel_history([dr.KernelType.JIT])
    traced = [one for one in history if one["operation_count"] > 1000]
    assert (len(traced) == 1) == (scatter is None)


def to_the_number(n):
    """`sums._room` without more of it."""
    return dr.zeros(mi.Int64, n)


@pytest.mark.parametrize("room", [None, to_the_number], ids=["right", "twin"])
@pytest.mark.parametrize(
    "specimen", [{"type": "diffuse"}, PLATE], ids=["flat", "plate"]
)
def test_another_number_of_batches_is_no_other_kernel(specimen, room, monkeypatch):
    """Exact, where the sums of both have room in arrays of one size."""
    if room:
        monkeypatch.setattr(sums, "_room", room)
    hashes = []
    for batches in (16, 17):
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            gonio.measure(
                specimen, 30, estimator="weighted", rays=2**14, batches=batches
            )
            history = dr.kernel_history([dr.KernelType.JIT])
        hashes.append({one["hash"] for one in history})
    assert (hashes[1] <= hashes[0]) == (room is None)


@pytest.mark.parametrize("known", [False, True], ids=["right", "twin"])
@pytest.mark.parametrize("kind", ["angle", "solid", "projected", "sine"])
@pytest.mark.parametrize(
    "specimen", [{"type": "diffuse"}, PLATE], ids=["flat", "plate"]
)
def test_another_number_of_patches_is_no_other_kernel(
    specimen, kind, known, monkeypatch
):
    """Exact, where the sums of both have room in arrays of one size."""
    if known:
        monkeypatch.setattr(DRJIT, "parameter", lambda x: x)
    hashes = []
    for size in ("30x60", "29x58"):
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            gonio.measure(
                specimen,
                30,
                estimator="weighted",
                rays=2**14,
                collector=f"{kind}:{size}",
            )
            history = dr.kernel_history([dr.KernelType.JIT])
        hashes.append({one["hash"] for one in history})
    assert (hashes[1] <= hashes[0]) == (not known)


@pytest.mark.parametrize("known", [False, True], ids=["right", "twin"])
def test_another_number_of_rays_is_no_other_kernel(known, monkeypatch):
    """Exact: few have a lane each, many share one; twin: a loop of known length."""
    if known:
        monkeypatch.setattr(dr, "opaque", lambda kind, x: kind(x))
    hashes = []
    for rays in (2**10, 2**16):
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            gonio.measure({"type": "diffuse"}, 30, estimator="weighted", rays=rays)
            history = dr.kernel_history([dr.KernelType.JIT])
        hashes.append({one["hash"] for one in history})
    assert (hashes[1] <= hashes[0]) == (not known)

"""A library is a guest: what its host has set is the same after each call."""

import contextlib
import decimal
import gc
import locale
import logging
import os
import random
import signal
import sys
import tempfile
import threading
import time
import warnings
from functools import partial
from pathlib import Path

import drjit as dr
import matplotlib as mpl
import mitsuba as mi
import numpy as np
import pytest

import gonio_mi as gonio
from gonio_mi import start_up
from gonio_mi.cli import main
from gonio_mi.errors import SpecimenError
from gonio_mi.specimen.loading import load_plugin_file
from gonio_mi.validation import pytest_entry

METAL = {"type": "roughconductor", "alpha": 0.3}
SMALL = {"rays": 2000, "batches": 2, "collector": "projected:3x4"}


def workers_of_dr_jit():
    """Numbers of the threads that Dr.Jit has made, where the system tells."""
    names = Path("/proc/self/task").glob("*/comm")
    return {one.parent.name for one in names if one.read_text().startswith("nt [")}


def umask():
    """Access that new files are denied; can only be asked by setting it."""
    now = os.umask(0o22)
    os.umask(now)
    return now


def paths_of_mitsuba():
    """Folders in which Mitsuba looks for files."""
    resolver = mi.file_resolver()
    return [str(resolver[i]) for i in range(len(resolver))]


# What a host may have set, or relies on, by its name.
STATE = {
    "variant": mi.variant,
    "number of threads": dr.thread_count,
    "threads": workers_of_dr_jit,
    "flags of Dr.Jit": lambda: {
        name: dr.flag(flag) for name, flag in dr.JitFlag.__members__.items()
    },
    "log level of Mitsuba": mi.log_level,
    "files of Mitsuba": paths_of_mitsuba,
    "logging": lambda: [
        (one.level, one.handlers[:], one.disabled, logging.root.manager.disable)
        for one in (logging.root, logging.getLogger("gonio_mi"))
    ],
    "warnings": lambda: (warnings.filters[:], warnings.showwarning),
    "signal handlers": lambda: [signal.getsignal(x) for x in signal.valid_signals()],
    "signal mask": lambda: signal.pthread_sigmask(signal.SIG_BLOCK, ()),
    "environment": lambda: dict(os.environ),
    "working folder": os.getcwd,
    "file mode": umask,
    "paths of modules": lambda: sys.path[:],
    "hooks": lambda: (
        sys.excepthook,
        threading.excepthook,
        sys.unraisablehook,
        sys.displayhook,
        sys.stdout,
        sys.stderr,
        sys.dont_write_bytecode,
        sys.getrecursionlimit(),
        sys.getswitchinterval(),
    ),
    "random numbers": random.getstate,
    "random numbers of NumPy": lambda: str(np.random.get_state()),  # noqa: NPY002
    "errors of NumPy": np.geterr,
    "print options of NumPy": np.get_printoptions,
    "decimals": lambda: str(decimal.getcontext()),
    "locale": lambda: locale.setlocale(locale.LC_ALL),
    "collection of garbage": lambda: (gc.isenabled(), gc.get_threshold()),
    "temporary folder": lambda: tempfile.tempdir,
    "matplotlib": lambda: (dict(mpl.rcParams), mpl.get_backend(auto_select=False)),
}


def state():
    return {name: seen() for name, seen in STATE.items()}


def changed(before):
    """Names of what is no longer as it was."""
    now = state()
    return [name for name in STATE if now[name] != before[name]]


@pytest.fixture(scope="module")
def records():
    """Two records, and one of few incident directions."""
    first = gonio.measure(METAL, 30, **SMALL)
    return first, gonio.measure(METAL, 30, seed=1, **SMALL)


@pytest.fixture
def plugin(tmp_path):
    """File of a plugin."""
    path = tmp_path / "own_plugin.py"
    path.write_text("import mitsuba as mi\n")
    return path


def table_of(folder):
    """File of two measured values."""
    path = folder / "table.csv"
    path.write_text("theta_i,phi_i,theta_o,phi_o,brdf\n30,0,30,180,1.5\n30,0,0,0,0.3\n")
    return str(path)


def ended_by_ctrl_c(_):
    raise KeyboardInterrupt


def interrupted():
    with contextlib.suppress(KeyboardInterrupt), pytest.MonkeyPatch.context() as patch:
        patch.setattr("gonio_mi.instrument.launcher.launch", ended_by_ctrl_c)
        gonio.measure(METAL, 30, **SMALL)


def refused():
    with contextlib.suppress(SpecimenError):
        gonio.measure({"type": "diffuse", "no": 1}, 30, **SMALL)


# What a user may call, with two records, a folder and a plugin file.
CALLS = {
    "measure": lambda **_: gonio.measure(METAL, [20, 40], **SMALL),
    "measure, another sampler": lambda **_: gonio.measure(
        METAL, 30, sampler="multijitter", **SMALL
    ),
    "measure, traced": lambda **_: gonio.measure(METAL, 30, trace=True, **SMALL),
    "measure, quadrature": lambda **_: gonio.measure(
        METAL, 30, estimator="quadrature", collector="projected:3x4"
    ),
    "measure, refused": lambda **_: refused(),
    "measure, Ctrl-C": lambda **_: interrupted(),
    "measure_orders": lambda **_: gonio.measure_orders(METAL, 30, orders=[1], **SMALL),
    "campaign": lambda folder, plugin, **_: gonio.campaign(
        {"a": METAL}, [20, 40], folder=folder / "kept", plugins=[plugin], **SMALL
    ),
    "plan": lambda records, **_: gonio.plan(records[0], rel_err=0.1),
    "validate": lambda **_: gonio.validate({"type": "diffuse"}, effort="quick"),
    "compare": lambda records, **_: gonio.compare(*records),
    "measure_like": lambda folder, **_: gonio.measure_like(
        METAL, gonio.read_measured(table_of(folder)), aperture_half_angle=3
    ),
    "fit": lambda records, **_: gonio.fit(records[0], "roughconductor", free=["alpha"]),
    "quantity": lambda **_: gonio.quantity("gloss60", METAL, rays=2000),
    "plot": lambda records, folder, **_: gonio.plot(records[0]).savefig(
        folder / "a.png"
    ),
    "report": lambda records, folder, **_: gonio.report(records, folder / "a.html"),
    "export": lambda records, folder, **_: gonio.export(records[0], folder / "a.csv"),
    "save and load": lambda records, folder, **_: [
        records[0].save(folder / name) or gonio.load(folder / name)
        for name in ("a.exr", "a.npz")
    ],
}


@pytest.fixture(autouse=True, scope="module")
def _imported():
    """What others add to the filters of warnings as they are imported is theirs."""
    pytest.importorskip("plotly.offline")
    pytest.importorskip("scipy.stats")


@pytest.mark.parametrize("call", CALLS)
def test_host_is_as_it_was(call, records, tmp_path, plugin):
    """Exact: all that it may have set."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        before = state()
        CALLS[call](records=records, folder=tmp_path, plugin=plugin)
        assert changed(before) == []


def test_a_line_of_pytest_is_a_guest_too(tmp_path, plugin):
    """Exact: other tests of the user's search modules where they did."""
    before = state()
    with pytest_entry._inside(tmp_path):
        load_plugin_file(plugin)
        assert changed(before) == ["working folder", "paths of modules"]
    assert changed(before) == []


@pytest.mark.parametrize("is_program", [False, True])
def test_a_command_in_a_host_leaves_its_garbage(is_program, monkeypatch):
    """The twin, the program, freezes what it has imported."""
    frozen = []
    monkeypatch.setattr(gc, "freeze", lambda: frozen.append("all"))
    monkeypatch.setattr(start_up, "_begun", is_program)
    assert main(["measure", "diffuse", "--theta-i", "30", "--rays", "100"]) == 0
    assert bool(frozen) == is_program


def test_measuring_in_threads_leaves_the_filters_of_warnings(monkeypatch, tmp_path):
    """Of two that overlap, the last to end put back what the first had changed."""
    both, one_is_there = threading.Barrier(2, timeout=300), threading.Event()
    before = warnings.filters[:]
    table = gonio.read_measured(table_of(tmp_path))

    def waits(*_):
        one_is_there.set()
        time.sleep(0.05 * both.wait())  # the first to come is the first to go
        return ()

    module = sys.modules[gonio.measure_like.__module__]
    monkeypatch.setattr(module, "_in_apertures", waits)
    ways = {"specimen": METAL, "like": table, "aperture_half_angle": 3}
    others = [
        threading.Thread(target=gonio.measure_like, kwargs=ways) for _ in range(2)
    ]
    for one in others:
        one.start()
        one_is_there.wait(300)
    for one in others:
        one.join()
    assert warnings.filters == before


def restored(target, name, value):
    """Function that changes an attribute, and one that changes it back."""
    before = getattr(target, name)
    return lambda: setattr(target, name, value), lambda: setattr(target, name, before)


# Changes that no call may leave, and what takes them back.
CHANGES = {
    "variant": lambda: (
        partial(mi.set_variant, "scalar_rgb"),
        partial(mi.set_variant, mi.variant()),
    ),
    "number of threads": lambda: (
        partial(dr.set_thread_count, dr.thread_count() + 1),
        partial(dr.set_thread_count, dr.thread_count()),
    ),
    "flags of Dr.Jit": lambda: (
        partial(dr.set_flag, dr.JitFlag.KernelHistory, True),
        partial(dr.set_flag, dr.JitFlag.KernelHistory, False),
    ),
    "log level of Mitsuba": lambda: (
        partial(mi.set_log_level, mi.LogLevel.Debug),
        partial(mi.set_log_level, mi.log_level()),
    ),
    "files of Mitsuba": lambda: (
        partial(mi.file_resolver().append, "/nowhere"),
        partial(mi.file_resolver().__delitem__, len(paths_of_mitsuba())),
    ),
    "logging": lambda: restored(logging.getLogger("gonio_mi"), "level", 10),
    "warnings": lambda: (
        partial(warnings.filterwarnings, "ignore", "any"),
        partial(warnings.filters.pop, 0),
    ),
    "signal handlers": lambda: (
        partial(signal.signal, signal.SIGUSR1, signal.SIG_IGN),
        partial(signal.signal, signal.SIGUSR1, signal.getsignal(signal.SIGUSR1)),
    ),
    "signal mask": lambda: (
        partial(signal.pthread_sigmask, signal.SIG_BLOCK, {signal.SIGUSR1}),
        partial(signal.pthread_sigmask, signal.SIG_UNBLOCK, {signal.SIGUSR1}),
    ),
    "environment": lambda: (
        partial(os.environ.__setitem__, "GONIO_TWIN", "1"),
        partial(os.environ.__delitem__, "GONIO_TWIN"),
    ),
    "working folder": lambda: (partial(os.chdir, "/"), partial(os.chdir, os.getcwd())),
    "file mode": lambda: (partial(os.umask, 0o27), partial(os.umask, umask())),
    "paths of modules": lambda: (
        partial(sys.path.insert, 0, "/nowhere"),
        partial(sys.path.pop, 0),
    ),
    "hooks": lambda: restored(sys, "excepthook", print),
    "random numbers": lambda: (
        random.random,
        partial(random.setstate, random.getstate()),
    ),
    "random numbers of NumPy": lambda: (
        np.random.random,
        partial(np.random.set_state, np.random.get_state()),  # noqa: NPY002
    ),
    "errors of NumPy": lambda: (
        partial(np.seterr, all="raise"),
        partial(np.seterr, **np.geterr()),
    ),
    "print options of NumPy": lambda: (
        partial(np.set_printoptions, precision=3),
        partial(np.set_printoptions, precision=np.get_printoptions()["precision"]),
    ),
    "decimals": lambda: restored(decimal.getcontext(), "prec", 3),
    "collection of garbage": lambda: (gc.disable, gc.enable),
    "temporary folder": lambda: restored(tempfile, "tempdir", "/nowhere"),
    "matplotlib": lambda: (
        partial(mpl.rcParams.__setitem__, "font.size", 3.0),
        partial(mpl.rcParams.__setitem__, "font.size", mpl.rcParams["font.size"]),
    ),
}


@pytest.mark.parametrize("name", CHANGES)
def test_twin_a_change_is_seen(name):
    before = state()
    change, back = CHANGES[name]()
    try:
        change()
        assert name in changed(before)
    finally:
        back()
    assert set(changed(before)) <= {"threads"}


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="no list of threads")
def test_twin_threads_that_were_made_anew_are_others():
    """Exact: as many as before, each once it has its name."""

    def make_threads():
        dr.set_thread_count(3)
        while len(workers_of_dr_jit()) != 2:
            time.sleep(1e-3)

    n = dr.thread_count()
    make_threads()
    before = state()
    dr.set_thread_count(1)
    make_threads()
    assert changed(before) == ["threads"]
    dr.set_thread_count(n)

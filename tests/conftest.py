"""Variants for the tests. `gonio_mi` comes first: it finds the LLVM for Dr.Jit.

``GONIO_LLVM_TARGET=x86-64-v3:8 pytest`` runs them as on a processor of that kind, with
vectors of 8 numbers (AVX2). Dr.Jit needs fused products, hence no less than that.
``GONIO_BACKEND=cuda pytest tests/core`` runs them on a GPU, but for those that name a
variant of their own; some ask for LLVM's last bits.
"""

import gonio_mi  # noqa: F401

# isort: split
import gc
import os
import re
import runpy
import sys
import types
from collections import Counter
from pathlib import Path

import budget
import drjit as dr
import durations
import mitsuba as mi
import pytest

from gonio_mi import progress
from gonio_mi.annexes import is_missing


def pytest_configure(config):
    """Share the processor's cores, and limit kernels to the target of the user.

    What is named on the command line, a file or a test, is run whether slow or not.
    """
    budget.begin()
    share_cores(config)
    named = any(".py" in str(word) for word in config.args)
    first = not hasattr(config, "workerinput")
    if first and named and "-m" not in config.invocation_params.args:
        config.option.markexpr = ""
    if os.environ.get("GONIO_LLVM_TARGET"):
        folder = Path(__file__).parent / "tools" / "llvm_target"
        paths = [str(folder), os.environ.get("PYTHONPATH", "")]
        os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, paths))
        runpy.run_path(str(folder / "sitecustomize.py"))


def share_cores(config):
    """Give each process of ``pytest -n`` its part of the cores.

    Threads that wait for work keep a core busy: with as many in each process as there
    are cores, a validation takes 1.5 times as long, in all processes together.
    See :func:`threads`, too.
    """
    if getattr(config.option, "numprocesses", None):
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # processes inherit it
        config.option.loadscopereorder = False  # see pytest_collection_modifyitems


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Keep the tests of a file in one process: what they share is made once.

    So with files that look at the same verdicts.
    """
    if config.option.dist != "load":
        return None
    from xdist.scheduler import LoadFileScheduling

    class Scheduling(LoadFileScheduling):
        def _split_scope(self, nodeid):
            name = Path(nodeid.partition("::")[0]).stem.removeprefix("test_")
            return "verdicts" if name in VERDICTS else super()._split_scope(nodeid)

    return Scheduling(config, log)


# Files that look at verdicts of `broken_bsdfs.judged`.
VERDICTS = ("cosines", "reproducers", "sentences", "suspects", "verdicts")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Mark the slow tests; several processes begin with the longest files.

    Tests of the core that need an annex are left out where it is missing.
    """
    stored, work = durations.read(), Counter()
    for item in items:
        for mark in item.iter_markers("needs"):
            if is_missing(mark.args[0]):
                item.add_marker(pytest.mark.skip(f"without {mark.args[0]}"))
        seconds = stored.get(durations.function_of(item.nodeid), 0.0)
        if durations.is_slow(seconds, item.get_closest_marker("promise")):
            item.add_marker("slow")
        work[item.path] += seconds
    if "PYTEST_XDIST_WORKER" in os.environ:
        items.sort(key=lambda item: -work[item.path])
    _set_variant(VARIANTS["mono"])  # which takes longest at first, and is no test's


@pytest.fixture(autouse=True, scope="module")
def threads(request):
    """Give Dr.Jit a process's part of the cores, but two where Mitsuba has files.

    It reads and writes EXR files in Dr.Jit's other threads, and waits for ever if
    there is none. What waits keeps a core busy.
    """
    before = dr.thread_count()
    processes = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", 1))
    files = re.search(r"Bitmap\(str|\.write\((str|path)", request.path.read_text())
    dr.set_thread_count(max(before // processes, 2 if files else 1))
    yield
    dr.set_thread_count(before)


# The variants by the names of their fixtures.
BACKEND = os.environ.get("GONIO_BACKEND", "llvm")
VARIANTS = {name: f"{BACKEND}_ad_{name}" for name in ("mono", "rgb", "spectral")}
POLARISED = f"{BACKEND}_ad_mono_polarized"


def _transformed_once(syntax):
    """Like ``dr.syntax``, but what is defined again is not transformed again.

    Mitsuba loads its integrators anew at each change of variant: 15 ms of CPU time with
    this, 80 ms without.
    """
    known = {}

    def transformed(f=None, **how):
        if f is None or how:
            return syntax(f, **how)
        place = f.__code__.co_filename, f.__code__
        if place not in known:
            known[place] = syntax(f).__code__
        again = types.FunctionType(known[place], f.__globals__)
        again.__defaults__ = f.__defaults__
        return again

    return transformed


dr.syntax = _transformed_once(dr.syntax)


def _set_variant(name):
    if mi.variant() != name:
        mi.set_variant(name)
    return name


@pytest.fixture(autouse=True, scope="module")
def settled():
    """Let `gc.collect` look at what comes after only: after each test, see `unmoved`.

    Without, 169 quick tests took 19 s of CPU time instead of 6.
    In the variant of most tests: its modules are loaded anew at each change.
    """
    _set_variant(VARIANTS["mono"])
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True)
def unmoved(request, monkeypatch, tmp_path_factory):
    """Begin each test in the same state, whatever its process has run before.

    In llvm_ad_mono unless the test says otherwise; in the same folder, with the same
    paths of modules and none of another test's; and with no line of progress, which
    depends on how long ago another test wrote one, and on how slow the machine is.
    Without another test's BSDFs too: Dr.Jit records the calls of all that exist.
    """
    from gonio_mi.specimen.shapes import forget

    if not {*VARIANTS, "variant", "polarised"} & {*request.fixturenames}:
        _set_variant(VARIANTS["mono"])
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setattr(progress, "PAUSE", 1e9)
    folder, known = Path.cwd(), {*sys.modules}
    yield
    os.chdir(folder)
    of_tests = str(tmp_path_factory.getbasetemp())
    forget()
    for name in {*sys.modules} - known:
        if str(getattr(sys.modules[name], "__file__", None)).startswith(of_tests):
            del sys.modules[name]
    gc.collect()
    if {*sys.modules} - known:
        gc.freeze()  # what was imported stays


@pytest.fixture
def mono():
    """Run the test in llvm_ad_mono."""
    return _set_variant(VARIANTS["mono"])


@pytest.fixture
def rgb():
    """Run the test in llvm_ad_rgb."""
    return _set_variant(VARIANTS["rgb"])


@pytest.fixture
def spectral():
    """Run the test in llvm_ad_spectral."""
    return _set_variant(VARIANTS["spectral"])


@pytest.fixture
def polarised():
    """Run the test in a polarised variant."""
    if POLARISED not in mi.variants():
        pytest.skip("not in this build")
    return _set_variant(POLARISED)


@pytest.fixture(params=VARIANTS.values())
def variant(request):
    """Run the test once in each variant."""
    return _set_variant(request.param)


# ------------------------------------------------------------------------- durations

# CPU seconds at which a test was begun, and those of fixtures that the tests of a file
# share: whichever is the first pays for them, so that they are every one's.
CLOCK, SHARED = {"begun": 0.0}, {}


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_setup():
    """Look at the clock before all that is set up."""
    CLOCK["begun"] = durations.cpu_seconds()
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(fixturedef):
    """Take what is shared off the time of the test that comes first."""
    before = durations.cpu_seconds()
    result = yield
    if fixturedef.scope != "function" and fixturedef.baseid.endswith(".py"):
        seconds = durations.cpu_seconds() - before
        SHARED[fixturedef.baseid, fixturedef.argname] = seconds
        CLOCK["begun"] += seconds
    return result


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_call(item):
    """Tell how long a test took, for the report that reaches the first process."""
    try:
        return (yield)
    finally:
        seconds = durations.cpu_seconds() - CLOCK["begun"]
        for (file, name), shared in SHARED.items():
            if item.nodeid.startswith(file) and name in item.fixturenames:
                seconds += shared
        item.user_properties.append(("cpu", seconds))


def pytest_runtest_logreport(report):
    """Collect how long tests took."""
    if report.when == "call":
        durations.TAKEN.add(report.nodeid, dict(report.user_properties)["cpu"])


# ------------------------------------------------------------ the false-alarm budget


def pytest_sessionfinish(session):
    """Report the verdicts of a process to the one that started it."""
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["verdicts"] = budget.spent()


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node):
    """Add the verdicts of a process that has ended."""
    budget.add(getattr(node, "workeroutput", {}).get("verdicts", 0))


def pytest_terminal_summary(terminalreporter):
    """Say how much of the false-alarm budget was used, and in CI what was slow."""
    if budget.spent():
        terminalreporter.write_line(
            f"false-alarm budget: {budget.spent()} of {budget.SHARES} verdicts"
        )
    if os.environ.get("CI"):
        found = durations.TAKEN
        terminalreporter.write_line(f"CPU time of the tests: {found.total:.0f} s")
        lines = found.wrong(durations.read(), durations.alone())
        if lines:
            again = f"{len(lines)} durations are wrong, tests/tools/durations.py:"
            terminalreporter.write_line("\n".join([again, *lines]))

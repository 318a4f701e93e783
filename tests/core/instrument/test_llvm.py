"""A usable LLVM is found, an unusable one is refused in a sentence, nothing aborts.

Alpha: the self-test of `doctor` fails a correct instrument with probability 1e-6; all
other assertions are exact.
"""

import glob
import os
import signal
import subprocess
import sys
from dataclasses import replace
from functools import partial
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import OpenEXR
import pytest

from gonio_mi import llvm
from gonio_mi.commands import doctor
from gonio_mi.errors import LLVMError
from gonio_mi.variants import parallel_variants

# isort: split
import drjit as dr

VARIABLE = "DRJIT_LIBLLVM_PATH"
# those that Dr.Jit accepts and that abort the process
OLD_LIBRARIES = [
    path
    for version in (15, 16)
    for path in glob.glob(f"/usr/lib*/*-linux-gnu/libLLVM-{version}.so.1")
    + glob.glob(f"/usr/lib64/libLLVM-{version}.so")
]
needs_old_library = pytest.mark.skipif(
    not OLD_LIBRARIES, reason="this system has no LLVM 15 or 16"
)

CHECK = """
import gonio_mi
gonio_mi.llvm.check()
"""
MEASURE = """
import gonio_mi, mitsuba as mi
mi.set_variant("llvm_ad_mono")
gonio_mi.measure({"type": "roughconductor"}, theta_i=45, rays=1000)
"""
# whatever the interpreter's start-up put into the environment, prepare() has to choose
VERSIONS = """
import os
os.environ.pop("DRJIT_LIBLLVM_PATH", None)
import gonio_mi, drjit
print(*gonio_mi.llvm.status().version, *drjit.detail.llvm_version())
print(os.environ["DRJIT_LIBLLVM_PATH"])
"""
MINIMUM = """
import drjit as dr
from drjit.llvm import Float
dr.eval(dr.minimum(dr.arange(Float, 10), 3))
"""
LATE = """
import os, mitsuba
del os.environ["DRJIT_LIBLLVM_PATH"]
import gonio_mi
gonio_mi.llvm.check()
"""
DOCTOR = """
import sys
from gonio_mi.commands import doctor
sys.exit(doctor.run(None))
"""


def python(code, library=None):
    """Finished process of `code`, in which the variable names `library`."""
    environment = {k: v for k, v in os.environ.items() if k != VARIABLE}
    if library is not None:
        environment[VARIABLE] = str(library)
    return subprocess.run(
        [sys.executable, "-c", code],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.fixture
def before_drjit(monkeypatch):
    """As in a process that has not imported Dr.Jit, with the variable unset."""
    monkeypatch.delitem(sys.modules, "drjit", raising=False)
    # setting it first makes monkeypatch restore it, whatever prepare() does
    monkeypatch.setenv(VARIABLE, "")
    monkeypatch.delenv(VARIABLE)
    return monkeypatch


def loaded(monkeypatch, *version):
    """As in a process whose Dr.Jit answers `version`, in an unknown file."""
    detail = SimpleNamespace(llvm_version=lambda: version)
    monkeypatch.setitem(sys.modules, "drjit", SimpleNamespace(detail=detail))
    monkeypatch.setattr(llvm, "_loaded_path", lambda: None)


# ---------------------------------------------------------------- version and verdict


@pytest.mark.parametrize("installed", [True, False])
def test_too_late(before_drjit, installed):
    """What is installed needs not be installed."""
    found = [(19, "/nonexistent/libLLVM.so.19.1")] * installed
    before_drjit.setattr(llvm, "_libraries", lambda: found)
    loaded(before_drjit, 15, 0, 6)
    llvm.prepare()
    assert VARIABLE not in os.environ
    assert llvm.status().version == (15, 0, 6)
    first = ": " if installed else ": .* and "
    match = rf"15\.0\.6.*newer{first}import gonio_mi before mitsuba"
    with pytest.raises(LLVMError, match=match):
        llvm.check()


def test_loaded_and_good(before_drjit):
    loaded(before_drjit, llvm.MINIMUM_VERSION, 0, 0)
    before_drjit.setenv(VARIABLE, "/nonexistent/libLLVM-15.so")
    llvm.check()


NAMED = {
    "touch": "is no LLVM that can be loaded",
    "mkdir": "is a folder, not a library",
    "exists": "does not exist",
}


@pytest.mark.parametrize("make", NAMED)
@pytest.mark.parametrize("ours", [True, False])
def test_named_but_not_loaded(before_drjit, tmp_path, make, ours):
    """Only what the user has set is to be unset."""
    path = tmp_path / "libLLVM.so.19.1"
    getattr(path, make)()
    found = [(19, str(path))] * ours
    before_drjit.setattr(llvm, "_libraries", lambda: found)
    before_drjit.setenv(VARIABLE, str(path))
    loaded(before_drjit, -1, -1, -1)
    step = "install it anew$" if ours else f".* and unset {VARIABLE}$"
    match = rf"{path} \({VARIABLE}\) {NAMED[make]}, .*newer: {step}"
    with pytest.raises(LLVMError, match=match):
        llvm.check()


@pytest.mark.parametrize(
    ("system", "machine", "line"),
    [
        ("linux", "x86_64", "run `pip install karellen-llvm-core`"),
        ("linux", "aarch64", "libllvm19"),
        ("darwin", "arm64", "run `brew install llvm`"),
        ("win32", "AMD64", "run `winget install LLVM.LLVM`"),
    ],
)
def test_nothing_found(before_drjit, system, machine, line):
    before_drjit.setattr(sys, "platform", system)
    before_drjit.setattr("platform.machine", lambda: machine)
    before_drjit.setattr(llvm, "_libraries", list)
    llvm.prepare()
    assert VARIABLE not in os.environ
    loaded(before_drjit, -1, -1, -1)
    with pytest.raises(LLVMError) as error:
        llvm.check()
    assert line in str(error.value)
    assert "\n" not in str(error.value)


# ---------------------------------------------------------------------------- prepare


def test_prepare_keeps_the_users_choice(before_drjit):
    before_drjit.setenv(VARIABLE, "/nonexistent/libLLVM-15.so")
    llvm.prepare()
    assert os.environ[VARIABLE] == "/nonexistent/libLLVM-15.so"


def test_prepare_never_raises(before_drjit):
    def broken(name):
        raise ValueError(name)

    before_drjit.setattr(metadata, "distribution", broken)
    llvm.prepare()
    assert VARIABLE not in os.environ


def test_prepare_takes_the_newest_of_this_environment(before_drjit, tmp_path):
    """From version 17 on; what has no name of a library is none."""
    folder = tmp_path / "lib"
    folder.mkdir()
    before_drjit.setattr(sys, "prefix", str(tmp_path))
    before_drjit.setattr(sys, "base_prefix", str(tmp_path))
    before_drjit.setattr(llvm, "WHEEL", "no-such-distribution")
    names = "libLLVM.so.16.0", "libLLVM.so.19.1", "libLLVM.so.100.1"
    for *ignored, name in (
        [None, names[0]],
        ["libLLVMSPIRVLib.so.200", names[1]],
        ["libLLVM-20.so", "libLLVM.so", names[2]],
    ):
        for one in filter(None, (*ignored, name)):
            (folder / one).touch()
        before_drjit.setenv(VARIABLE, "")
        llvm.prepare()
        taken = "" if name == names[0] else str(folder / name)
        assert os.environ[VARIABLE] == taken


# ------------------------------------------- the hook at the start of the interpreter

HOOK = (Path(__file__).parents[3] / "gonio_mi" / "llvm.pth").read_text()


def started(monkeypatch, folder):
    """Library that the hook names where `folder` is the environment's."""
    monkeypatch.setattr(sys, "prefix", str(folder))
    exec(HOOK, {}, {})  # as `site` does
    return os.environ.get(VARIABLE)


def test_the_hook_names_the_newest_of_this_environment(before_drjit, tmp_path):
    """From version 17 on; a line that `site` runs is one that begins with import."""
    assert HOOK.startswith("import ")
    assert HOOK.count("\n") == 1
    assert started(before_drjit, tmp_path) is None
    folder = tmp_path / "lib"
    folder.mkdir()
    for name in ("libLLVM.so.16.0", "libLLVM.so", "libLLVM-20.so", "libLLVM.so.x"):
        (folder / name).touch()
        assert started(before_drjit, tmp_path) is None
    for name in ("libLLVM.so.19.1", "libLLVM.so.100.1"):
        (folder / name).touch()
        assert started(before_drjit, tmp_path) == str(folder / name)
        del os.environ[VARIABLE]


@pytest.mark.parametrize("variable", [VARIABLE, "GONIO_MI_NO_HOOK"])
def test_a_variable_switches_the_hook_off(variable, before_drjit, tmp_path):
    (tmp_path / "lib").mkdir()
    (tmp_path / "lib" / "libLLVM.so.19.1").touch()
    before_drjit.setenv(variable, "1")
    before = dict(os.environ)
    started(before_drjit, tmp_path)
    assert dict(os.environ) == before


# -------------------------------------------------------------------- real processes


def test_with_nothing_set_a_usable_one_is_loaded():
    process = python(VERSIONS)
    assert process.returncode == 0, process.stderr
    numbers, path = process.stdout.splitlines()
    status, truth = np.array(numbers.split(), int).reshape(2, 3)
    assert status.tolist() == truth.tolist()
    assert truth[0] >= llvm.MINIMUM_VERSION
    assert os.path.isfile(path)


@needs_old_library
@pytest.mark.parametrize("code", [MEASURE, DOCTOR], ids=["measure", "doctor"])
def test_old_library(code):
    path = OLD_LIBRARIES[0]
    process = python(code, path)
    assert process.returncode == 1, process.stderr
    sentence = f"{path} ({VARIABLE}) is LLVM 1"
    assert sentence in process.stdout + process.stderr


@needs_old_library
def test_old_library_of_a_mitsuba_that_was_imported_first():
    process = python(LATE, OLD_LIBRARIES[0])
    assert process.returncode == 1
    assert "LLVMError: Dr.Jit found LLVM 1" in process.stderr
    assert "import gonio_mi before mitsuba" in process.stderr


@needs_old_library
def test_twin_without_the_check_an_old_library_aborts():
    process = python(MINIMUM, OLD_LIBRARIES[0])
    assert process.returncode == -signal.SIGABRT


NUMBA = """
import sys

def numba():
    from numba import njit, prange
    @njit(parallel=True)
    def total(n):
        found = 0.0
        for i in prange(n):
            found += i
        return found
    return total(1000)

def gonio():
    import gonio_mi, mitsuba as mi
    mi.set_variant("llvm_ad_mono")
    plate = {"type": "roughconductor"}
    return float(gonio_mi.measure(plate, theta_i=45, rays=1000).dhr.item())

print(*(globals()[name]() for name in sys.argv[1:]))
"""


def test_numba_in_the_same_process():
    """Exact: both LLVMs compile, whichever comes first, and no bit changes."""
    pytest.importorskip("numba")

    def printed(*names):
        command = [sys.executable, "-c", NUMBA, *names]
        done = subprocess.run(command, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout.split()

    total = str(999 * 1000 / 2)
    dhr, *later = printed("gonio", "numba", "gonio")  # first, without the other
    assert later == [total, dhr]
    assert printed("numba", "gonio", "numba") == [total, dhr, total]


def test_file_that_is_no_library(tmp_path):
    path = tmp_path / "libLLVM-15.so.1"
    path.touch()
    process = python(CHECK, path)
    assert process.returncode == 1
    assert process.stderr.splitlines()[-1].startswith(
        f"gonio_mi.errors.LLVMError: {path} ({VARIABLE}) is no LLVM that can be "
        f"loaded, and Dr.Jit needs {llvm.MINIMUM_VERSION} or newer: "
    )


# ----------------------------------------------------------------------------- doctor


def test_doctor_finds_this_machine_able(capsys):
    code, lines = doctor.run(None), capsys.readouterr().out.splitlines()
    assert code == 0, "\n".join(lines)
    assert len(lines) == len(doctor.diagnose()[0]) + 1
    assert lines[-1] == "this machine is able to measure"


def test_doctor_names_the_variants_of_a_gpu_that_is_there(monkeypatch):
    for kinds in ("llvm",), ("llvm", "cuda"):
        there = partial(lambda kinds, one: one.name.lower() in kinds, kinds)
        monkeypatch.setattr(dr, "has_backend", there)
        rows = {row.name: row.value for row in doctor.diagnose()[0]}
        known = [one for one in parallel_variants() if one.startswith(kinds)]
        assert rows["variants"] == ", ".join(known)


def test_doctor_says_what_is_missing(monkeypatch):
    loaded(monkeypatch, -1, -1, -1)
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setattr(doctor, "REQUIRED", ("no-such-distribution",))
    monkeypatch.setattr(doctor, "OPTIONAL", {"no-such-extra": "plot"})
    rows, able = doctor.diagnose()
    by_name = {row.name: row for row in rows}
    assert not able
    assert by_name["no-such-distribution"].value.endswith(
        "`pip install no-such-distribution`"
    )
    assert by_name["no-such-extra"].ok
    assert "not run: " in by_name["self-test"].value


def test_self_test_has_power():
    """Twins: a wrong BRDF, and one ray in the wrong row of the ledger."""
    record = doctor._measure_white()
    assert doctor._faults(record, 1 / np.pi) == []
    # the interval of a patch of 1e4 counts has a half width of 6 %
    assert len(doctor._faults(record, 1.1 / np.pi)) == 1
    fates = record.tallies[0].fates.copy()
    fates[0, :3] += np.array([-1, 0, 1]).astype(fates.dtype)
    moved = replace(record, tallies=(replace(record.tallies[0], fates=fates),))
    assert len(doctor._faults(moved, 1 / np.pi)) == 2


ONE_THREAD = """
import sys
import gonio_mi as gonio, drjit as dr, mitsuba as mi
mi.set_variant("llvm_ad_mono")
dr.set_thread_count(1)
ways = {"collector": "angle:2x2", "rays": 64, "batches": 2}
texture = {"type": "bitmap", "filename": sys.argv[1], "raw": True}
gonio.measure({"type": "diffuse", "reflectance": texture}, 30, **ways)
plate = {"type": "heightfield", "filename": sys.argv[1], "bsdf": {"type": "diffuse"}}
mi.load_dict(plate)
gonio.measure({"type": "scene", "plate": plate}, 30, **ways)
print(dr.thread_count())
"""


def test_a_single_thread_reads_exr_files(tmp_path):
    """Exact: files are read where Dr.Jit has one thread, as on one core, and it stays.

    Mitsuba waits for ever there; the time is that of a process that does.
    """
    pixels = np.full((4, 4), 0.5, np.float32)
    path = str(tmp_path / "half.exr")
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, {"Y": pixels}) as image:
        image.write(path)
    command = [sys.executable, "-W", "ignore", "-c", ONE_THREAD, path]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.stdout == "1\n", done.stderr

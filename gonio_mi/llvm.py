"""Finding a libLLVM that Dr.Jit can use, before Dr.Jit loads one.

Dr.Jit 1.5 loads libLLVM when ``drjit`` (or ``mitsuba``) is first imported and keeps it.
LLVM 15 and 16 are accepted, but abort the process at the first minimum or maximum.
"""

import contextlib
import ctypes
import glob
import os
import platform
import re
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from .errors import LLVMError

MINIMUM_VERSION = 17
VARIABLE = "DRJIT_LIBLLVM_PATH"
WHEEL = "karellen-llvm-core"

# Debian, Fedora, Arch, Gentoo, conda; Homebrew, MacPorts.
SYSTEM_PATTERNS = {
    "linux": (
        f"/usr/lib/{platform.machine()}-linux-gnu/libLLVM*.so*",
        "/usr/lib64/libLLVM*.so*",
        "/usr/lib/libLLVM*.so*",
        "/usr/lib*/llvm*/lib*/libLLVM*.so*",
        "/usr/lib/llvm/*/lib*/libLLVM*.so*",
        "/usr/local/lib*/libLLVM*.so*",
        f"{glob.escape(sys.base_prefix)}/lib/libLLVM*.so*",
    ),
    "darwin": (
        "/opt/homebrew/opt/llvm*/lib/libLLVM*.dylib",
        "/usr/local/opt/llvm*/lib/libLLVM*.dylib",
        "/opt/local/libexec/llvm-*/lib/libLLVM*.dylib",
        f"{glob.escape(sys.base_prefix)}/lib/libLLVM*.dylib",
    ),
}
# libLLVM-15.so.1, libLLVM-14.0.6.so.1, libLLVM.so.19.1, libLLVM-19.dylib
LIBRARY_NAME = re.compile(
    r"libLLVM(?:[-.](\d[\d.]*?))?(?:git)?\.(?:so|dylib)(?:\.(\d[\d.]*))?"
)
# Homebrew and MacPorts write the version into the folder only.
FOLDER_NAME = re.compile(r"/llvm(?:@\d+/|-|/)(\d+(?:\.\d+)*)")


@dataclass(frozen=True)
class LLVMStatus:
    """The LLVM that Dr.Jit uses, or would use, and whether it is good enough.

    Attributes
    ----------
    path : str or None
        The library; None where there is none or nobody knows.
    version : tuple of int or None
        As many of major, minor and patch as are known.
    usable : bool
        Whether kernels compile with it.
    reason : str
        One sentence; of an unusable one, with the line that fixes it.
    """

    path: str | None
    version: tuple[int, ...] | None
    usable: bool
    reason: str


def prepare() -> None:
    """Let ``DRJIT_LIBLLVM_PATH`` name the best usable library, unless the user did.

    That is the one of the wheel ``karellen-llvm-core``, otherwise the newest of the
    system, of at least version 17. Never raises; does nothing where there is none or
    where Dr.Jit, already imported, has read the variable.
    """
    if os.environ.get(VARIABLE) or "drjit" in sys.modules:
        return
    # A broken installation of something else must not break the import of this package.
    with contextlib.suppress(Exception):
        path, version = _best()
        if path and _is_enough(version):
            os.environ[VARIABLE] = path


def status() -> LLVMStatus:
    """:class:`LLVMStatus` of what Dr.Jit has loaded, or would load. Loads no Dr.Jit."""
    if "drjit" in sys.modules:
        return _loaded_status(sys.modules["drjit"].detail.llvm_version())
    named = os.environ.get(VARIABLE)
    path, version = (named, _version(named)) if named else _best()
    if path and _is_enough(version) and not _is_absent(path):
        return LLVMStatus(path, version, True, f"{path} is LLVM {dotted(version)}")
    return LLVMStatus(path, version, False, _complaint(path, version))


def check() -> None:
    """Make sure that Dr.Jit can compile, before it aborts the process.

    Raises
    ------
    LLVMError
        In one sentence, with the line that fixes it.
    """
    loaded = sys.modules.get("drjit")
    # each measurement asks, and the path that `status` looks for takes a while
    if loaded and loaded.detail.llvm_version()[0] >= MINIMUM_VERSION:
        return
    current = status()
    if not current.usable:
        raise LLVMError(current.reason)


# ------------------------------------------------------------------------- verdicts


def _loaded_status(choice: tuple[int, ...]) -> LLVMStatus:
    """Status when Dr.Jit has made its choice; it answers -1 where it has none."""
    named, path = os.environ.get(VARIABLE), _loaded_path()
    version: tuple[int, ...] | None = choice
    if choice[0] < 0:
        path, version = named, _version(named) if named else None
    elif choice[0] >= MINIMUM_VERSION:
        return LLVMStatus(path, version, True, f"Dr.Jit uses LLVM {dotted(version)}")
    if named and path in (named, None):
        return LLVMStatus(named, version, False, _complaint(named, version))
    found = f"LLVM {dotted(version)} ({path})" if version else "no LLVM it can use"
    best, best_version = _best()
    if _is_enough(best_version):
        fix = f"import gonio_mi before mitsuba, or set {VARIABLE}={best}"
    else:
        fix = f"{_install()} and import gonio_mi before mitsuba"
    reason = (
        f"Dr.Jit was imported before gonio_mi and loaded {found}, but needs "
        f"{MINIMUM_VERSION} or newer: {fix}"
    )
    return LLVMStatus(path, version, False, reason)


def _complaint(path: str | None, version: tuple[int, ...] | None) -> str:
    """Sentence on a library that Dr.Jit cannot use, and the line that fixes it."""
    need = f"Dr.Jit needs {MINIMUM_VERSION} or newer"
    named = f"{path} ({VARIABLE})"
    if path is None:
        return f"no LLVM was found, and {need}: {_install()}"
    if path != os.environ.get(VARIABLE):
        return f"the newest LLVM found is {dotted(version)}, and {need}: {_install()}"
    if _is_absent(path):
        state = "does not exist"
    elif _is_enough(version):
        return (
            f"{named} was not loaded: unset {VARIABLE}, or set it to an intact library "
            "before mitsuba is imported"
        )
    elif version is None:
        state = "is no LLVM that tells its version"
    else:
        state = f"is LLVM {dotted(version)}"
    fix = "" if _is_enough(_best()[1]) else f"{_install()} and "
    return f"{named} {state}, and {need}: {fix}unset {VARIABLE}"


def _install() -> str:
    """The line that installs a usable LLVM on this kind of machine."""
    if sys.platform == "darwin":
        return "run `brew install llvm`"
    if sys.platform == "win32":
        return "run `winget install LLVM.LLVM`"
    if platform.machine() == "x86_64":
        return f"run `pip install {WHEEL}`"
    return "install your system's LLVM (Debian: `sudo apt install libllvm19`)"


def _is_enough(version: tuple[int, ...] | None) -> bool:
    """Whether Dr.Jit's kernels compile with this version."""
    return version is not None and version[0] >= MINIMUM_VERSION


def _is_absent(path: str) -> bool:
    """Whether a path leads to no file; a bare name is left to the loader's search."""
    return os.path.basename(path) != path and not os.path.isfile(path)


def dotted(version: tuple[int, ...] | None) -> str:
    """Text of a version, also of an unknown one."""
    return ".".join(map(str, version)) if version else "unknown"


# ------------------------------------------------------------------------ libraries


def _best() -> tuple[str | None, tuple[int, ...] | None]:
    """Path and version of the library to use, else of the system's newest, or Nones."""
    for paths in (_wheel_libraries(), _system_libraries()):
        known = [(_version_in_name(path), path) for path in paths]
        version, path = max(known, default=(None, None))
        if _is_enough(version):
            break
    return path, version


def _wheel_libraries() -> list[str]:
    """Libraries of the wheel, wherever pip put it."""
    try:
        files = metadata.distribution(WHEEL).files or ()
    except metadata.PackageNotFoundError:
        files = ()
    paths = [os.path.abspath(file.locate()) for file in files if "LLVM" in file.name]
    return _libraries(paths) or _libraries(
        glob.glob(f"{glob.escape(sys.prefix)}/lib/libLLVM*.so*")
    )


def _system_libraries() -> list[str]:
    """Libraries of the system's packages."""
    patterns = SYSTEM_PATTERNS.get(sys.platform, ())
    return _libraries(path for pattern in patterns for path in glob.glob(pattern))


def _libraries(paths: Iterable[str]) -> list[str]:
    """Those of `paths` that are of known version and could be loaded."""
    return [path for path in paths if _version_in_name(path) and _is_native(path)]


def _is_native(path: str) -> bool:
    """Whether it is a 64 bit library, not one of 32 bits or a linker script."""
    try:
        with open(path, "rb") as file:
            return sys.platform != "linux" or file.read(5) == b"\x7fELF\x02"
    except OSError:
        return False


def _loaded_path() -> str | None:
    """Path of the libLLVM in this process's memory, if the system tells."""
    named = os.environ.get(VARIABLE)
    try:
        lines = Path("/proc/self/maps").read_text().splitlines()
    except OSError:
        return named
    mapped = {line.split(maxsplit=5)[-1] for line in lines}
    names = {os.path.basename(path) for path in mapped}
    if named and (named in names or os.path.realpath(named) in mapped):
        return named
    found = [path for path in mapped if LIBRARY_NAME.fullmatch(os.path.basename(path))]
    return found[0] if len(found) == 1 else None


def _version(path: str) -> tuple[int, ...] | None:
    """Version of a library by its name, or by asking it; None where neither tells."""
    return _version_in_name(path) or _version_in_library(path)


def _version_in_name(path: str) -> tuple[int, ...] | None:
    """Version that the name of the file, or of its folder, tells."""
    resolved = os.path.realpath(path)
    for name in (os.path.basename(resolved), os.path.basename(path)):
        match = LIBRARY_NAME.fullmatch(name)
        if match and (match[1] or match[2]):
            return tuple(map(int, (match[1] or match[2]).split(".")))
    match = LIBRARY_NAME.fullmatch(name) and FOLDER_NAME.search(resolved)
    return tuple(map(int, match[1].split("."))) if match else None


def _version_in_library(path: str) -> tuple[int, ...] | None:
    """Version that the library itself tells, from LLVM 16 on."""
    numbers = [ctypes.c_uint() for _ in range(3)]
    try:
        ctypes.CDLL(path).LLVMGetVersion(*map(ctypes.byref, numbers))
    except (OSError, AttributeError):
        return None
    return tuple(number.value for number in numbers)

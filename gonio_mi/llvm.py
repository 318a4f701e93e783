"""A libLLVM that Dr.Jit can use: that of the wheel, else what Dr.Jit finds itself.

Dr.Jit 1.5 loads libLLVM when ``drjit`` (or ``mitsuba``) is first imported and keeps it.
LLVM 15 and 16 are accepted, but abort the process at the first minimum or maximum.
"""

import contextlib
import os
import re
import sys
from typing import NamedTuple

from .errors import LLVMError

MINIMUM_VERSION = 17
VARIABLE = "DRJIT_LIBLLVM_PATH"
WHEEL = "karellen-llvm-core"

LIBRARY_NAME = r"libLLVM\.so\.(\d+)[.\d]*"


class LLVMStatus(NamedTuple):
    """The LLVM that Dr.Jit uses, and whether it is good enough.

    Attributes
    ----------
    path : str or None
        The library; None where there is none or nobody knows.
    version : tuple of int or None
        Major, minor and patch.
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
    """Let ``DRJIT_LIBLLVM_PATH`` name the library of the wheel, unless the user did.

    That is ``karellen-llvm-core``; or a library of the same environment, of at least
    version 17. Never raises; does nothing where there is none, so that Dr.Jit searches
    the system, or where Dr.Jit, already imported, has read the variable.
    """
    if os.environ.get(VARIABLE) or "drjit" in sys.modules:
        return
    # A broken installation of something else must not break the import of this package.
    with contextlib.suppress(Exception):
        version, path = max(_libraries())
        if version >= MINIMUM_VERSION:
            os.environ[VARIABLE] = path


def _libraries() -> list[tuple[int, str]]:
    """Versions and paths of this environment's libraries."""
    import glob
    from importlib import metadata  # slow to import

    folders = {sys.prefix, sys.base_prefix}
    paths = [
        x for one in folders for x in glob.glob(f"{glob.escape(one)}/lib/libLLVM*")
    ]
    with contextlib.suppress(metadata.PackageNotFoundError):
        files = metadata.distribution(WHEEL).files or ()
        paths += [os.path.abspath(file.locate()) for file in files]
    names = [(re.fullmatch(LIBRARY_NAME, os.path.basename(x)), x) for x in paths]
    return [(int(name[1]), path) for name, path in names if name]


def status() -> LLVMStatus:
    """:class:`LLVMStatus` of what Dr.Jit has loaded."""
    import drjit

    version: tuple[int, ...] = drjit.detail.llvm_version()
    named, path = os.environ.get(VARIABLE), _loaded_path()
    if version[0] >= MINIMUM_VERSION:
        return LLVMStatus(path, version, True, f"Dr.Jit uses LLVM {dotted(version)}")
    known = version if version[0] >= 0 else None
    found = f"LLVM {dotted(known)}" if known else "no LLVM that can be loaded"
    libraries: list[tuple[int, str]] = []
    with contextlib.suppress(Exception):  # as in `prepare`
        libraries = _libraries()
    steps = [] if any(n >= MINIMUM_VERSION for n, _ in libraries) else [_install()]
    if named in [path for _, path in libraries]:  # perhaps by `prepare`
        steps = ["install it anew"]
    else:
        first = "import gonio_mi before mitsuba"
        steps.append(f"unset {VARIABLE}" if named else first)
    if named:
        is_file = os.path.isfile(named) or os.path.basename(named) == named
        found = f"is {found}" if is_file else "does not exist"
        found = "is a folder, not a library" if os.path.isdir(named) else found
        found = f"{named} ({VARIABLE}) {found}"
    else:
        found = f"Dr.Jit found {found}" + (f" ({path})" if path else "")
    need = f"Dr.Jit needs {MINIMUM_VERSION} or newer"
    reason = f"{found}, and {need}: {' and '.join(steps)}"
    return LLVMStatus(named or path, known, False, reason)


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


def _install() -> str:
    """The line that installs a usable LLVM on this kind of machine."""
    import platform

    if sys.platform == "darwin":
        return "run `brew install llvm`"
    if sys.platform == "win32":
        return "run `winget install LLVM.LLVM`"
    if platform.machine() == "x86_64":
        return f"run `pip install {WHEEL}`"
    return "install your system's LLVM (Debian: `sudo apt install libllvm19`)"


def dotted(version: tuple[int, ...] | None) -> str:
    """Text of a version, also of an unknown one."""
    return ".".join(map(str, version)) if version else "unknown"


def _loaded_path() -> str | None:
    """Path of the libLLVM in this process's memory, if the system tells."""
    with contextlib.suppress(OSError), open("/proc/self/maps") as maps:
        if found := re.search(r"/.*/libLLVM[-.].*$", maps.read(), re.MULTILINE):
            return found[0]
    return os.environ.get(VARIABLE)

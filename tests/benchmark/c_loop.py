"""The hand-written C loop, built by this machine's compiler when it is asked for."""

import ctypes
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path

import numpy as np

from gonio_mi.array_types import Counts
from gonio_mi.collector import EqualProjectedSolidAngle

SOURCE = Path(__file__).with_name("count_diffuse.c")
COMPILERS = ("cc", "gcc", "clang")
# sqrtf without errno is one instruction
FLAGS = ("-O3", "-march=native", "-fno-math-errno", "-std=gnu11", "-shared", "-fPIC")


class CompilerError(OSError):
    """No C compiler, or one that cannot build the loop."""


@cache
def library() -> ctypes.CDLL:
    """Build and load the loop, once in each process.

    Raises
    ------
    CompilerError
        If there is no compiler, or it fails.
    """
    compiler = next(filter(None, map(shutil.which, COMPILERS)), None)
    if compiler is None:
        raise CompilerError(f"no C compiler ({', '.join(COMPILERS)}) was found")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "count_diffuse.so"
        command = [compiler, *FLAGS, str(SOURCE), "-o", str(path), "-pthread"]
        built = subprocess.run(command, capture_output=True, text=True, check=False)
        if built.returncode:
            reason = (built.stderr.strip().splitlines() or ["no message"])[0]
            raise CompilerError(f"{compiler} cannot build the C loop: {reason}")
        loaded = ctypes.CDLL(str(path))
    c_int, c_ulong = ctypes.c_int, ctypes.c_uint64
    counts = np.ctypeslib.ndpointer(np.uint64, flags="C_CONTIGUOUS")
    loaded.count_diffuse.argtypes = [c_ulong, c_ulong, c_int, c_int, c_int, counts]
    loaded.count_diffuse.restype = c_int
    return loaded


def count_diffuse(
    rays: int, seed: int, subdivision: EqualProjectedSolidAngle, threads: int
) -> Counts:
    """Count cosine-distributed directions in patches of equal projected solid angle.

    Parameters
    ----------
    rays, seed : int
    subdivision : EqualProjectedSolidAngle
    threads : int
        The counts do not depend on it.

    Returns
    -------
    ndarray of uint64, shape ``subdivision.shape``
    """
    counts = np.zeros(subdivision.shape, np.uint64)
    if library().count_diffuse(rays, seed, *subdivision.shape, threads, counts):
        raise MemoryError(f"the C loop got no memory or thread for {subdivision}")
    return counts

"""Compile a process's kernels for the processor that GONIO_LLVM_TARGET names.

``x86-64-v3:8`` is a processor and the width of its vectors. Python runs a module of
this name when it starts, if PYTHONPATH has its folder: `tests/conftest.py` sees to
that, so that the commands that tests start obey too.
"""

import contextlib
import ctypes
import os
from pathlib import Path

if os.environ.get("GONIO_LLVM_TARGET"):
    with contextlib.suppress(ImportError):
        import drjit as dr

        processor, width = os.environ["GONIO_LLVM_TARGET"].split(":")
        core = ctypes.CDLL(str(Path(dr.__file__).parent / "libdrjit-core.so"))
        core._Z8jit_initj(ctypes.c_uint32(1 << 2))  # LLVM: it finds the machine's own
        set_target = core._Z19jit_llvm_set_targetPKcS0_j  # no Python function calls it
        set_target(processor.encode(), None, ctypes.c_uint32(int(width)))

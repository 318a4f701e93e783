"""The Mitsuba variants in which the instrument measures, and what they compile for."""

from __future__ import annotations

import ctypes
import platform
from pathlib import Path

import drjit as dr
import mitsuba as mi

from .. import llvm
from ..errors import VariantError


def is_usable(variant: str) -> bool:
    """Whether it computes many rays at once, and without polarisation."""
    return not (variant.startswith("scalar") or variant.endswith("polarized"))


def usable_variants() -> list[str]:
    """Return those of this Mitsuba, whether or not they work on this machine."""
    return [name for name in mi.variants() if is_usable(name)]


def check_variant() -> None:
    """Raise :class:`VariantError` if no variant is set that the instrument can use.

    And :class:`LLVMError` if Dr.Jit would abort the process at its first kernel.
    """
    if not mi.variant():
        raise VariantError(
            "a Mitsuba variant must be set first, "
            "such as mi.set_variant('llvm_ad_mono')"
        )
    if not is_usable(mi.variant()):
        raise VariantError(
            "gonio_mi needs an unpolarised llvm or cuda variant, such as "
            f"mi.set_variant('llvm_ad_mono'), got {mi.variant()}"
        )
    if mi.variant().startswith("llvm"):
        llvm.check()


def processor() -> str:
    """Text on the processor that kernels of the variant are compiled for.

    On those of other names, widths of vectors or versions of LLVM the same rays may
    round otherwise.
    """
    if not mi.variant().startswith("llvm"):
        return str(mi.variant()).split("_")[0]
    name, width = target()
    vectors = f"vectors of {width}" if width else "vectors of unknown width"
    return f"{name}, {vectors}, LLVM {llvm.dotted(dr.detail.llvm_version())}"


def target() -> tuple[str, int | None]:
    """Name of the LLVM backend's processor, and how many numbers its vectors hold.

    Dr.Jit tells no Python function of it; where its library is another one, the name
    is the machine's and the width None.
    """
    try:
        core = ctypes.CDLL(str(Path(dr.__file__).parent / "libdrjit-core.so"))
        name, width = core._Z19jit_llvm_target_cpuv, core._Z21jit_llvm_vector_widthv
    except (OSError, AttributeError):
        return platform.machine(), None
    name.restype, width.restype = ctypes.c_char_p, ctypes.c_uint32
    text = name()
    return (text.decode() if text else platform.machine()), int(width()) or None

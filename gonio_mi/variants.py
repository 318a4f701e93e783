"""The Mitsuba variants in which the instrument measures, and what they compile for."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import drjit as dr
import mitsuba as mi

from . import llvm
from .errors import VariantError


def is_polarised(variant: str) -> bool:
    """Whether its spectra are Mueller matrices."""
    return variant.endswith("polarized")


def unpolarised(variant: str) -> str:
    """Name of the variant that has the same channels without polarisation."""
    return variant.removesuffix("_polarized")


def is_parallel(variant: str) -> bool:
    """Whether the variant is vectorised: in all of these BSDFs can be judged."""
    return not variant.startswith("scalar")


def is_parallel_unpolarised(variant: str) -> bool:
    """Whether the variant is vectorised and unpolarised."""
    return is_parallel(variant) and not is_polarised(variant)


def unpolarised_variants() -> list[str]:
    """Return those of this Mitsuba, whether or not they work on this machine."""
    return [name for name in mi.variants() if is_parallel_unpolarised(name)]


def parallel_variants() -> list[str]:
    """Return those of this Mitsuba in which BSDFs can be judged."""
    return [name for name in mi.variants() if is_parallel(name)]


def check_variant(accepts: Callable[[str], bool] = is_parallel_unpolarised) -> None:
    """Raise :class:`VariantError` if no variant is set that one `accepts`.

    And :class:`LLVMError` if Dr.Jit would abort the process at its first kernel.
    """
    if not mi.variant():
        raise VariantError(
            "a Mitsuba variant must be set first, "
            "such as mi.set_variant('llvm_ad_mono')"
        )
    if not accepts(mi.variant()):
        kind = "unpolarised llvm" if accepts is is_parallel_unpolarised else "llvm"
        raise VariantError(
            f"gonio_mi needs an {kind} or cuda variant, such as "
            f"mi.set_variant('llvm_ad_mono'), got {mi.variant()}"
        )
    if mi.variant().startswith("llvm"):
        llvm.check()


def check_unpolarised(what: str) -> None:
    """Raise :class:`VariantError` if the variant is polarised, for `what` is not."""
    if is_polarised(mi.variant()):
        raise VariantError(
            f"{what} needs an unpolarised variant, such as "
            f"{unpolarised(mi.variant())}, got {mi.variant()}"
        )


def check_differentiates(what: str) -> None:
    """Raise :class:`VariantError` if the variant has no derivatives."""
    if "_ad_" not in mi.variant():
        raise VariantError(
            f"{what} needs a variant with derivatives, such as llvm_ad_mono, got "
            f"{mi.variant()}"
        )


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
    import platform  # slow to import
    from pathlib import Path

    try:
        library = Path(dr.__file__).parent / "libdrjit-core.so"
        name, width = _target_functions(str(library))
    except (OSError, AttributeError):
        return platform.machine(), None
    text = name()
    return (text.decode() if text else platform.machine()), int(width()) or None


@cache
def _target_functions(library: str) -> tuple[Any, Any]:
    """Functions of Dr.Jit's library that tell the target's name and width."""
    import ctypes  # slow to import

    core = ctypes.CDLL(library)
    name, width = core._Z19jit_llvm_target_cpuv, core._Z21jit_llvm_vector_widthv
    name.restype, width.restype = ctypes.c_char_p, ctypes.c_uint32
    return name, width

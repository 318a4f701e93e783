"""Kernels are recorded by one thread at a time, and an error leaves none behind."""

from __future__ import annotations

import atexit
import functools
import threading
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import ContextDecorator
from typing import Any

import drjit as dr
import mitsuba as mi

from .errors import LostRaysError, VariantError
from .threads import drjit_lock
from .variants import check_variant, is_parallel_unpolarised

# Variants at the entrances of the contexts that are open, with the thread that is in
# them, and the variant that each thread has set last.
_entered: list[tuple[str | None, int]] = []
_own = threading.local()

# Names that others have registered plugins under since this package was imported.
registered_by_others: set[str] = set()

# What frees objects that are kept for the next call, after an error.
_frees: list[Callable[[], None]] = []

# Seconds that Python's exit waits at most for the launch of another thread.
PATIENCE = 30.0

# Flags without which Dr.Jit 1.5 ends the process, and those that only it itself sets.
NEEDED = ("MergeFunctions",)
INTERNAL = (
    "EnableObjectTraversal",
    "ForbidSynchronization",
    "FreezingScope",
    "SymbolicScope",
)


class launches_kernels(ContextDecorator):  # noqa: N801
    """Context or decorator of what records and launches kernels, a thread at a time.

    What a plugin raises inside of a recorded loop comes out as it was raised, without
    the errors that Dr.Jit wraps it in. The variables of its traceback are released: a
    specimen that they kept would take part in all kernels from then on, for Dr.Jit
    records the calls of every BSDF that exists, and each measurement would fail like
    the first, and what the host renders. So what is set up must be held by functions
    that the context calls, or be freed by one that is :func:`called_after_errors`.

    Raises
    ------
    VariantError
        At the entrance, if no usable variant is set, or a flag of Dr.Jit with which no
        kernel works, or if another thread has set another variant than this one; in
        the end, if that has happened meanwhile.
    LLVMError
        At the entrance, if Dr.Jit would abort the process.
    """

    def __init__(
        self, accepts: Callable[[str], bool] = is_parallel_unpolarised
    ) -> None:
        self._accepts = accepts

    def __enter__(self) -> None:
        drjit_lock.acquire()
        try:
            check_variant(self._accepts)
            _check_flags()
            if not _entered:
                _check_own_variant()
        except BaseException:
            drjit_lock.release()
            raise
        _entered.append((mi.variant(), threading.get_ident()))

    def __exit__(self, kind: object, error: BaseException | None, _: object) -> None:
        try:
            if error is not None:
                _let_go(error)
                for free in _frees:
                    free()
            else:
                check_variant_kept()
            if error is not None and _is_wrapped(error):
                raise first_cause(error) from None
        finally:
            _entered.pop()
            dr.sync_thread()  # a process that is forked now would wait for it
            # no variable of this very frame may hold what holds the frame
            del error, _
            drjit_lock.release()


def called_after_errors(free: Callable[[], None]) -> Callable[[], None]:
    """Function that the end of :class:`launches_kernels` calls after an error."""
    _frees.append(free)
    return free


def in_memory(numbers: Iterable[float]) -> list[mi.Float]:
    """Numbers that kernels read, so that others do not make them other kernels.

    Each in a place of its own: which of them are equal would make a difference too.
    """
    return [dr.opaque(mi.Float, float(number)) for number in numbers]


def check_variant_kept() -> None:
    """Raise VariantError if the variant is no longer that of the entrance."""
    if _entered and mi.variant() != (before := _entered[-1][0]):
        raise VariantError(
            f"the variant {before} was changed to {mi.variant()} during a measurement: "
            "all threads of a process share one variant; measure in one process for "
            "each"
        )


@atexit.register
def _end_measurements() -> None:
    """End what another thread measures, before Mitsuba is taken down beneath it.

    Python goes on with daemon threads as it exits: without this Dr.Jit 1.5 aborts the
    process. Nothing is measured from then on.
    """
    told, end = set[int](), time.monotonic() + PATIENCE
    while not drjit_lock.acquire(timeout=0.01) and time.monotonic() < end:
        for thread in {one for _, one in _entered} - told:
            _exit_in(thread)
            told.add(thread)


def _exit_in(thread: int) -> None:
    """Raise SystemExit in another thread."""
    import ctypes  # slow to import

    raised = ctypes.py_object(SystemExit)
    ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread), raised)


def orderly(set_variant: Callable[..., None]) -> Callable[..., None]:
    """``mi.set_variant`` that waits for measurements, and knows which thread set what.

    Mitsuba has one variant for all threads. Without this, threads that set different
    ones measure in each other's, or crash.
    """

    @functools.wraps(set_variant)
    def in_turn(*variants: str) -> None:
        with drjit_lock:
            set_variant(*variants)
            know_own_variant()  # Mitsuba calls nobody if it is the same as before

    return in_turn


def watched(register: Callable[..., None]) -> Callable[..., None]:
    """``mi.register_bsdf`` or its like that notes the names of plugins."""

    @functools.wraps(register)
    def noted(*given: Any, **named: Any) -> None:
        register(*given, **named)
        registered_by_others.add(given[0] if given else named["name"])

    return noted


def know_own_variant() -> None:
    """Remember that this thread has set the variant."""
    _own.variant = mi.variant()


def _check_own_variant() -> None:
    """Raise VariantError if another thread has set another variant than this one."""
    own = getattr(_own, "variant", None)
    if own not in (None, mi.variant()):
        raise VariantError(
            f"this thread has set the variant {own}, and another one {mi.variant()} "
            "since: all threads of a process share one variant; measure in one process "
            "for each"
        )


def _check_flags() -> None:
    """Raise VariantError if a flag of Dr.Jit is set with which no kernel works."""
    for name in NEEDED + INTERNAL:
        needed = name in NEEDED
        if dr.flag(getattr(dr.JitFlag, name)) != needed:
            raise VariantError(
                f"Dr.Jit's flag {name} must be {'on' if needed else 'off'}, got "
                f"{'off' if needed else 'on'}: "
                f"dr.set_flag(dr.JitFlag.{name}, {needed}) sets it"
            )


def check_all_counted(sent: int, counted: int) -> None:
    """Raise LostRaysError unless all rays of a launch are in its ledger."""
    if sent != counted:
        raise LostRaysError(
            f"the ledger must hold all {sent} rays of a launch, got {counted}: other "
            "kernels were launched meanwhile, or a flag of Dr.Jit changes what is "
            "computed; nothing of this measurement can be trusted"
        )


def _is_wrapped(error: BaseException) -> bool:
    """Whether Dr.Jit says no more than that recorded code raised the cause."""
    return (
        isinstance(error, RuntimeError)
        and error.__cause__ is not None
        and "encountered an exception" in str(error)
    )


def _let_go(error: BaseException) -> None:
    """Release the variables of the tracebacks of an error and of its causes."""
    for cause in _chain(error):
        traceback.clear_frames(cause.__traceback__)


def first_cause(error: BaseException) -> BaseException:
    """The error that led to all others."""
    *_, first = _chain(error)
    return first


def _chain(error: BaseException | None) -> Iterator[BaseException]:
    """The error, its cause, and so on, each once."""
    seen: list[BaseException] = []
    while error is not None and error not in seen:
        yield error
        seen.append(error)
        error = error.__cause__

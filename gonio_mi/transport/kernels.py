"""Kernels are recorded by one thread at a time, and an error leaves none behind."""

import functools
import threading
import traceback
from collections.abc import Callable, Iterator
from typing import ParamSpec, TypeVar

import drjit as dr

from ..errors import LostRaysError, VariantError

__all__ = ["check_all_counted", "launches_kernels"]

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

# Dr.Jit records side effects, such as the sums of a tally, in one state for all
# threads.
_lock = threading.RLock()

# Flags without which Dr.Jit 1.5 ends the process, and those that only it itself sets.
NEEDED = ("MergeFunctions",)
INTERNAL = (
    "EnableObjectTraversal",
    "ForbidSynchronization",
    "FreezingScope",
    "SymbolicScope",
)


def launches_kernels(
    *, unless: tuple[str, ...] = ()
) -> Callable[[Callable[Arguments, Result]], Callable[Arguments, Result]]:
    """Decorator of what records and launches kernels: one thread at a time does.

    What a plugin raises inside of a recorded loop comes out as it was raised, without
    the errors that Dr.Jit wraps it in. The variables of its traceback are released: a
    specimen that they kept would take part in all kernels from then on, for Dr.Jit
    records the calls of every BSDF that exists, and each measurement would fail like
    the first.

    Parameters
    ----------
    unless : tuple of str
        Keyword arguments with which the function leaves the kernels to other threads.

    Raises
    ------
    VariantError
        By the function, if a flag of Dr.Jit is set with which no kernel works.
    """

    def decorate(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
        @functools.wraps(function)
        def entrance(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
            if any(kwargs.get(name) is not None for name in unless):
                return function(*args, **kwargs)
            with _lock:
                _check_flags()
                try:
                    return function(*args, **kwargs)
                except BaseException as error:
                    # no variable of this very frame may hold what holds the frame
                    _let_go(error)
                    if not _is_wrapped(error):
                        raise
                    raise _first_cause(error) from None

        return entrance

    return decorate


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


def _first_cause(error: BaseException) -> BaseException:
    """The error that led to all others."""
    *_, first = _chain(error)
    return first


def _chain(error: BaseException | None) -> Iterator[BaseException]:
    """The error, its cause, and so on."""
    while error is not None:
        yield error
        error = error.__cause__

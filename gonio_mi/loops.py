"""Loops that Dr.Jit records, made when they are first called.

``dr.syntax`` takes 2 to 25 ms a function to transform its loops.
"""

import contextlib
import functools
from collections.abc import Callable, Iterator
from typing import Any, TypeVar, cast

import drjit as dr
from drjit.ast import syntax as transform

from . import start_up

Recorded = TypeVar("Recorded", bound=Callable[..., Any])


def syntax(function: Recorded) -> Recorded:
    """Function with loops that Dr.Jit records, as ``dr.syntax`` makes it."""

    @functools.cache
    def transformed() -> Recorded:
        return transform(function)

    @functools.wraps(function)
    def call(*values: Any, **named: Any) -> Any:
        return transformed()(*values, **named)

    return cast("Recorded", call)


@contextlib.contextmanager
def mitsubas_made_late() -> Iterator[None]:
    """Context for importing Mitsuba's own integrators, in the program ``gonio-mi``.

    Transforming their ten functions, which no command calls, took a quarter of the CPU
    time of a short command. In other processes ``dr.syntax`` is left alone.
    """
    if not start_up.is_program():
        yield
        return
    before, dr.syntax = dr.syntax, _late_if_mitsubas
    try:
        yield
    finally:
        dr.syntax = before


def _late_if_mitsubas(function: Any = None, **how: Any) -> Any:
    """``dr.syntax`` that is late for functions of Mitsuba, and for no others."""
    if not how and getattr(function, "__module__", "").startswith("mitsuba."):
        return syntax(function)
    return transform(function, **how)

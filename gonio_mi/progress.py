"""A progress bar on standard error."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Any

from tqdm import tqdm

__all__ = ["bar"]


def bar(
    shown: bool, **settings: Any
) -> AbstractContextManager[Callable[[float], Any] | None]:
    """Context of the function to report progress to; of None if it is not `shown`.

    `settings` are those of :class:`tqdm.tqdm`.
    """
    return _Bar(leave=False, **settings) if shown else nullcontext()


class _Bar(tqdm):
    """Progress bar whose context is its function to report."""

    def __enter__(self) -> Callable[[float], Any]:
        super().__enter__()
        return self.update

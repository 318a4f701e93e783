"""A progress bar on standard error."""

from contextlib import nullcontext

from tqdm import tqdm

__all__ = ["bar"]


def bar(shown, **settings):
    """Context of the function to report progress to; of None if it is not `shown`.

    `settings` are those of :class:`tqdm.tqdm`.
    """
    return _Bar(leave=False, **settings) if shown else nullcontext()


class _Bar(tqdm):
    """Progress bar whose context is its function to report."""

    def __enter__(self):
        super().__enter__()
        return self.update

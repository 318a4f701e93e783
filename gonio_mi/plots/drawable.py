"""Whether a picture can be drawn and written: matplotlib is the extra ``plot``."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import PackageError
from ..files import check_output, replacing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "ANIMATION_ENDINGS",
    "FIGURE_ENDINGS",
    "check_matplotlib",
    "check_picture",
    "save_picture",
]

FIGURE_ENDINGS = (".pdf", ".png", ".svg")
ANIMATION_ENDINGS = (".gif",)


def check_matplotlib() -> None:
    """Raise ImportError in one sentence if matplotlib is not installed."""
    try:
        import matplotlib.figure  # noqa: F401
    except ImportError:
        raise PackageError(
            'pictures need matplotlib: run pip install "gonio-mi[plot]"'
        ) from None


def check_picture(path: str | PathLike[str]) -> None:
    """Raise one clear sentence unless a picture can be drawn and written to `path`.

    Raises
    ------
    ImportError
        If matplotlib is not installed.
    ValueError, OSError
        If the ending is not one of `FIGURE_ENDINGS`, or the file cannot be written.
    """
    check_matplotlib()
    check_output(path, FIGURE_ENDINGS)


def save_picture(figure: Figure, path: str | PathLike[str]) -> None:
    """Write a figure to a path that :func:`check_picture` found right."""
    with replacing(path) as stream:
        figure.savefig(stream, format=Path(path).suffix[1:].lower(), dpi=150)

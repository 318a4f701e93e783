"""Figures: whether they can be drawn, how they begin, and how they are finished.

matplotlib is the optional extra ``plot``; it is imported when a figure is drawn.
"""

from __future__ import annotations

import functools
import io
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import PackageError, to_install
from ..files import check_output, replacing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Part of a figure's width that a title may fill.
TITLE_WIDTH = 0.97

FIGURE_ENDINGS = (".pdf", ".png", ".svg")
ANIMATION_ENDINGS = (".gif",)


def evenly(n: int, most: int) -> list[int]:
    """Up to `most` numbers below `n`, evenly spaced."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(int)).tolist()


def direction_text(theta: float, phi: float) -> str:
    """An incident direction, in degrees, as all pictures name it."""
    return f"θᵢ = {theta + 0.0:g}°, φᵢ = {phi + 0.0:g}°"  # no -0


def check_matplotlib() -> None:
    """Raise ImportError in one sentence if matplotlib is not installed."""
    try:
        import matplotlib.figure  # noqa: F401
    except ImportError:
        raise PackageError(f"pictures need matplotlib: {to_install('plot')}") from None


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


def set_title(figure: Figure, text: str, size: str = "medium") -> None:
    """Write the title of a figure; lines wider than the figure are broken.

    Between words, and within those that are wider alone. Dollars are no formulas.
    """
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import text_to_path

    font = FontProperties(size=size)
    limit = TITLE_WIDTH * 72 * figure.get_figwidth()

    def fits(line: str) -> bool:
        width, *_ = text_to_path.get_text_width_height_descent(line, font, False)
        return bool(width <= limit)

    lines = []
    for paragraph in text.split("\n"):
        line = ""
        for word in paragraph.split(" "):
            if line and not fits(f"{line} {word}"):
                lines.append(line)
                line = ""
            line = f"{line} {word}" if line else word
            while not fits(line):
                n = max(sum(fits(line[:i]) for i in range(2, len(line))), 1)
                lines.append(line[: n + 1])
                line = line[n + 1 :]
        lines.append(line)
    figure.suptitle("\n".join(lines), size=size, parse_math=False)


def new_figure(path: str | PathLike[str] | None, **settings: Any) -> Figure:
    """Return an empty figure, for :func:`finished` to write to `path` if it is given.

    Notebooks show it without ``%matplotlib inline``; pyplot does not know it, so that
    it is shown once and needs no closing. `settings` are those of the class.

    Raises
    ------
    ImportError, ValueError, OSError
        As :func:`check_picture`, of which only the first concerns no file.
    """
    check_matplotlib()
    if path is not None:
        check_picture(path)
    return _notebook_figure_class()(**{"layout": "constrained"} | settings)


@functools.cache
def _notebook_figure_class() -> type[Figure]:
    from matplotlib.figure import Figure

    class NotebookFigure(Figure):
        """A figure that a notebook shows, without the state of pyplot."""

        def _repr_png_(self) -> bytes:
            stream = io.BytesIO()
            self.savefig(stream, format="png")
            return stream.getvalue()

    return NotebookFigure


def finished(
    figure: Figure, path: str | PathLike[str] | None, title: str = ""
) -> Figure:
    """The figure with its title, written if `path` is given."""
    if title:
        set_title(figure, title)
    if path is not None:
        with replacing(path) as stream:
            ending = Path(path).suffix[1:].lower()
            figure.savefig(stream, format=ending, dpi=150)
    return figure

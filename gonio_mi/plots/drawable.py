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
    "set_title",
]

# Part of a figure's width that a title may fill.
TITLE_WIDTH = 0.97

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


def save_picture(figure: Figure, path: str | PathLike[str]) -> None:
    """Write a figure to a path that :func:`check_picture` found right."""
    with replacing(path) as stream:
        figure.savefig(stream, format=Path(path).suffix[1:].lower(), dpi=150)

"""Whether a picture can be drawn and written: matplotlib is the extra ``plot``."""

from os import PathLike

from ..errors import PackageError
from ..files import check_output

__all__ = ["FIGURE_ENDINGS", "check_matplotlib", "check_picture"]

FIGURE_ENDINGS = (".pdf", ".png", ".svg")


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

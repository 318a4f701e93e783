"""The figure that :func:`gonio_mi.plots.plot` returns."""

import io

from matplotlib.figure import Figure

__all__ = ["NotebookFigure"]


class NotebookFigure(Figure):
    """A matplotlib figure that notebooks show without ``%matplotlib inline``.

    It is not registered with pyplot, so it is shown once and needs no closing.
    """

    def _repr_png_(self) -> bytes:
        stream = io.BytesIO()
        self.savefig(stream, format="png")
        return stream.getvalue()

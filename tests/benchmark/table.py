"""Tables in plain text, which are Markdown too."""

from collections.abc import Iterable, Sequence


def print_table(
    title: str, header: Sequence[str], rows: Sequence[Sequence[str]]
) -> None:
    """Print a title and a table; all columns but the first two are right-aligned.

    Parameters
    ----------
    title : str
    header : sequence of str
    rows : sequence of sequence of str
    """
    widths = [max(len(row[i]) for row in (header, *rows)) for i in range(len(header))]

    def _line(row: Iterable[str]) -> str:
        cells = [
            text.ljust(width) if i < 2 else text.rjust(width)
            for i, (text, width) in enumerate(zip(row, widths))
        ]
        return f"| {' | '.join(cells)} |"

    rule = [
        "-" * width if i < 2 else "-" * (width - 1) + ":"
        for i, width in enumerate(widths)
    ]
    print(f"\n{title}\n")
    for row in (header, rule, *rows):
        print(_line(row))
    print(flush=True)

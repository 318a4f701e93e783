"""The frame that all our HTML pages share: title, style, body."""

import html
from collections.abc import Iterable

__all__ = ["html_page"]

STYLE = """
:root { --ink: #222; --soft: #666; --line: #ddd; --accent: #1f5f9e;
        color-scheme: only light; }
body { font: 15px/1.5 system-ui, sans-serif; color: var(--ink); max-width: 78em;
       margin: 1.5em auto; padding: 0 1em; }
h1 { font-size: 1.4em; margin: 0 0 .3em; overflow-wrap: anywhere; }
h2 { font-size: 1.1em; margin: 1.2em 0 .3em; }
table { border-collapse: collapse; }
td, th { padding: .25em .8em; vertical-align: top; text-align: left; }
tr { border-top: 1px solid var(--line); }
img { max-width: 100%; }
small, .soft { color: var(--soft); }
pre { overflow-x: auto; font-size: .85em; background: #f6f6f6; padding: .8em; }
"""


def html_page(title: str, body: Iterable[str], style: str = "") -> str:
    """Return a whole HTML page.

    Parameters
    ----------
    title : str
        Plain text.
    body : iterable of str
        Pieces of HTML.
    style : str
        More rules of style, after those that all pages have.
    """
    return "\n".join(
        [
            "<!doctype html>",
            '<html lang="en"><head><meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            '<link rel="icon" href="data:,">',
            f"<title>{html.escape(title)}</title>",
            f"<style>{STYLE}{style}</style></head><body>",
            *body,
            "</body></html>",
        ]
    )

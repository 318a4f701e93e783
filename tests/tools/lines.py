"""Count the lines of code of each room: ``python tests/tools/lines.py [PACKAGE]``.

Lines of code hold code: no blank line, no comment and no docstring.
"""

import ast
import io
import sys
import tokenize
from collections import Counter
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / "gonio_mi"
ANNEXES = ("materials", "exchange", "analysis", "validation")
NO_CODE = (
    *(tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE),
    *(tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER),
)
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


def lines_of_code(source):
    """Numbers of the lines of a source that hold code."""
    text = {
        number
        for node in ast.walk(ast.parse(source))
        if isinstance(node, DOCUMENTED) and ast.get_docstring(node) is not None
        for number in range(node.body[0].lineno, node.body[0].end_lineno + 1)
    }
    code = {
        number
        for token in tokenize.generate_tokens(io.StringIO(source).readline)
        if token.type not in NO_CODE
        for number in range(token.start[0], token.end[0] + 1)
    }
    return code - text


def rooms(package=PACKAGE):
    """Lines of code by room; those of modules beside the rooms are of ``entrance``."""
    counts = Counter()
    for path in sorted(package.rglob("*.py")):
        parts = path.relative_to(package).parts
        room = parts[0] if len(parts) > 1 else "entrance"
        counts[room] += len(lines_of_code(path.read_text(encoding="utf-8")))
    return counts


def core(counts):
    """Lines of all rooms but the annexes."""
    return sum(n for room, n in counts.items() if room not in ANNEXES)


if __name__ == "__main__":
    found = rooms(*map(Path, sys.argv[1:2]))
    for name, n in sorted(found.items(), key=lambda item: (item[0] in ANNEXES, item)):
        print(f"{name:12} {n:6}")
    print(f"{'core':12} {core(found):6}\n{'whole':12} {found.total():6}")

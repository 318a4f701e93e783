"""What the signatures of the package ask of a reader.

``python tests/tools/signatures.py`` counts the functions of more than seven parameters,
the parameters that are flags, and those whose type is `Any`; ``--list``
names each of them.
"""

import argparse
import ast
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / "gonio_mi"
MOST_PARAMETERS = 7


def functions():
    """Each function of the package: its place, its name and its parameters."""
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                args = node.args
                parameters = [*args.posonlyargs, *args.args, *args.kwonlyargs]
                place = f"{path.relative_to(PACKAGE)}:{node.lineno} {node.name}"
                yield place, [a for a in parameters if a.arg not in ("self", "cls")]


def found():
    """What is counted: a title, and the places."""
    long, flags, unknown, n = [], [], [], 0
    for place, parameters in functions():
        n += len(parameters)
        if len(parameters) > MOST_PARAMETERS:
            long.append(f"{place}: {len(parameters)}")
        for a in parameters:
            annotation = "" if a.annotation is None else ast.unparse(a.annotation)
            if annotation in ("bool", "bool | None"):
                flags.append(f"{place}: {a.arg}")
            elif annotation == "Any":
                unknown.append(f"{place}: {a.arg}")
    yield f"functions of more than {MOST_PARAMETERS} parameters", long
    yield "parameters that are flags", flags
    yield f"parameters of type Any, of {n}", unknown


def main():
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--list", action="store_true", help="name each of them")
    names = parser.parse_args().list
    for title, places in found():
        print(f"{len(places):4d} {title}")
        if names:
            print("\n".join(f"       {place}" for place in places))


if __name__ == "__main__":
    main()

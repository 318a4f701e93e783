"""Names of Mitsuba and Dr.Jit that the package uses, and a newer one does not have.

``python tests/tools/mitsuba_names.py --old mitsuba3 drjit --new mitsuba3 drjit`` takes
source trees of the version that is installed, and of a later one, and prints each name
that went, with the places of the package where it stands, to be looked through. What
the type of an object is, it cannot tell: a name is any attribute, keyword or word in
quotes of the package, and is known by a tree that binds it in Python, has it in quotes
(parameters), or as the name of a file (plugins). So names of NumPy's may be among them;
a name that is still another's, and a parameter that means something else, are not.
"""

import argparse
import ast
import re
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / "gonio_mi"

# The one module that may use names that go: it asks which there are.
COMPATIBLE = "mitsuba_compat.py"

WORD = re.compile(r"[A-Za-z_]\w*")
IN_TEXT = re.compile(r"\w\.([A-Za-z_]\w*)")
# In C++ words in quotes, classes that macros bind, and what is documented by its name.
BOUND = re.compile(
    r'"([A-Za-z_]\w*)"'
    r"|\b(?:MI_PY_|MI_EXPORT_|NB_|DRJIT_)\w+\(([^\n;{]*)"
    r"|\bD\(([^\n;{]*?)\)"
)


def bound_names(tree):
    """Set of the names that a folder of sources binds in Python."""
    names = set()
    for path in tree.rglob("*"):
        if path.suffix not in (".py", ".cpp", ".h", ".in") or "tests" in path.parts:
            continue
        names.add(path.stem)
        text = path.read_text(errors="replace")
        if path.suffix == ".py":
            try:
                names |= used_names(ast.parse(text), defined=True).keys()
            except SyntaxError:
                continue
        else:
            for found in BOUND.finditer(text):
                names.update(WORD.findall(" ".join(filter(None, found.groups()))))
    return names


def used_names(module, defined=False):
    """Lines by name: attributes, keywords and quoted words; or what is `defined`."""
    names = {}
    for node in ast.walk(module):
        if isinstance(node, ast.FunctionDef | ast.ClassDef | ast.alias) and defined:
            found = [node.name]
        elif isinstance(node, ast.Name) and defined:
            found = [node.id] if isinstance(node.ctx, ast.Store) else []
        elif isinstance(node, ast.Attribute):
            found = (
                [node.attr] if not defined or isinstance(node.ctx, ast.Store) else []
            )
        elif isinstance(node, ast.keyword) and not defined:
            found = [node.arg] if node.arg else []
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            # of a longer text what may be an attribute: some are scripts
            text = node.value
            found = [text] if WORD.fullmatch(text) else IN_TEXT.findall(text)
            found = [] if defined and found != [text] else found
        else:
            continue
        for name in found:
            names.setdefault(name, []).append(getattr(node, "lineno", 0))
    return names


def gone(package, old, new):
    """Places by name: what `package` uses, `old` trees have and `new` ones do not."""
    before, after = (set().union(*map(bound_names, trees)) for trees in (old, new))
    places = {}
    for path in sorted(package.rglob("*.py")):
        if path.name == COMPATIBLE:
            continue
        for name, lines in used_names(ast.parse(path.read_text())).items():
            if name in before - after:
                where = path.relative_to(package)
                places.setdefault(name, []).extend(
                    f"{where}:{n}" for n in sorted(lines)
                )
    return places


def main():
    """Print what is gone."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--old", nargs="+", type=Path, required=True)
    parser.add_argument("--new", nargs="+", type=Path, required=True)
    trees = parser.parse_args()
    places = gone(PACKAGE, trees.old, trees.new)
    for name, where in sorted(places.items()):
        print(name, *where)


if __name__ == "__main__":
    main()

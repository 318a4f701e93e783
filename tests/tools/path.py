"""How long the path from `measure` to a BSDF is, and how much code there is.

``python tests/tools/path.py`` prints the frames of the package that lie between
`gonio_mi.measure` and the `sample` of a BSDF written in Python, for a specimen that is
flat and for one that is traced; how often settings are looked up by a string outside of
the border of files; and the modules and lines of code of each room.
"""

import argparse
import ast
import collections
import io
import re
import sys
import tokenize
from pathlib import Path

import gonio_mi as gonio

# isort: split
import drjit as dr
import mitsuba as mi

PACKAGE = Path(gonio.__file__).parent
LOOK_UP = re.compile(r"""(?:settings|provenance)(?:\.get\(|\[)["']""")
# where settings are text: files, and options that are not yet parsed
BORDER = ("files",)
NO_CODE = {
    *(tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE),
    *(tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER),
}


def frames():
    """File and function of each frame of the package above the caller, outermost first.

    What Python makes of a comprehension is no frame of its own.
    """
    found, frame = [], sys._getframe(1)
    while frame is not None:
        path, name = Path(frame.f_code.co_filename), frame.f_code.co_name
        if path.is_relative_to(PACKAGE) and not name.endswith("comp>"):
            found.append(f"{path.relative_to(PACKAGE)} {name}")
        frame = frame.f_back
    return found[::-1]


def path_to_sample(specimen, **settings):
    """Frames between `measure` and the `sample` of a BSDF, at its last call."""
    seen = []

    class Walked(mi.BSDF):
        def __init__(self, props):
            mi.BSDF.__init__(self, props)
            self.m_components = [
                mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide
            ]
            self.m_flags = self.m_components[0]

        def sample(self, ctx, si, u1, u2, active=True):
            del ctx, u1
            seen[:] = frames()
            bs = dr.zeros(mi.BSDFSample3f)
            bs.wo = mi.warp.square_to_cosine_hemisphere(u2)
            bs.pdf = mi.warp.square_to_cosine_hemisphere_pdf(bs.wo)
            bs.eta = 1.0
            bs.sampled_type = mi.UInt32(+mi.BSDFFlags.DiffuseReflection)
            valid = active & (si.wi.z > 0)
            return bs, dr.select(valid, mi.Spectrum(0.5), 0.0)

        def eval(self, ctx, si, wo, active=True):
            del ctx
            lit = active & (si.wi.z > 0) & (wo.z > 0)
            return dr.select(lit, mi.Spectrum(0.5 * dr.inv_pi * wo.z), 0.0)

        def pdf(self, ctx, si, wo, active=True):
            del ctx
            lit = active & (si.wi.z > 0) & (wo.z > 0)
            return dr.select(lit, dr.inv_pi * wo.z, 0.0)

        def to_string(self):
            return "Walked[]"

    mi.register_bsdf("walked", lambda props: Walked(props))
    gonio.measure(specimen, 30, rays=2000, batches=2, **settings)
    return seen


def look_ups():
    """Look-ups of settings by a string, by file."""
    found = collections.Counter()
    for path in PACKAGE.rglob("*.py"):
        name = path.relative_to(PACKAGE)
        if name.parts[0] not in BORDER:
            found[name.as_posix()] = len(LOOK_UP.findall(path.read_text()))
    return +found


def code_lines(text):
    """Lines of a module that hold code: no docstring, no comment, not blank."""
    told = set()
    for node in ast.walk(ast.parse(text)):
        documented = isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef))
        if documented and ast.get_docstring(node, clean=False) is not None:
            told.update(range(node.body[0].lineno, node.body[0].end_lineno + 1))
    rows = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in NO_CODE:
            rows.update(range(token.start[0], token.end[0] + 1))
    return len(rows - told)


def print_sizes():
    """Modules and lines of code of each room, and of all."""
    modules, lines = collections.Counter(), collections.Counter()
    for path in PACKAGE.rglob("*.py"):
        parts = path.relative_to(PACKAGE).parts
        room = parts[0] if len(parts) > 1 else "."
        modules[room] += 1
        lines[room] += code_lines(path.read_text())
    for room in sorted(modules):
        print(f"{room:15s} {modules[room]:4d} modules {lines[room]:6d} lines")
    print(f"{'all':15s} {modules.total():4d} modules {lines.total():6d} lines")


def main():
    """See the module."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    mi.set_variant("llvm_ad_mono")
    walked = {"type": "walked"}
    ball = {"type": "sphere", "bsdf": walked}
    for name, specimen, settings in (
        ("flat", walked, {}),
        ("flat, independent", walked, {"sampler": "independent"}),
        ("traced", ball, {}),
    ):
        path = path_to_sample(specimen, **settings)
        print(f"{name}: {len(path)} frames of the package")
        print("\n".join(f"  {i:2d} {frame}" for i, frame in enumerate(path, 1)))
    found = look_ups()
    print(f"{found.total()} look-ups of settings by string in {len(found)} modules")
    for name, number in sorted(found.items()):
        print(f"  {number:2d} {name}")
    print_sizes()


if __name__ == "__main__":
    main()

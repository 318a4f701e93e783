"""How long the path from `measure` to a BSDF is.

``PYTHONPATH=tests/references python tests/tools/path.py`` prints the frames of the
package that lie between `gonio_mi.measure` and the `sample` of a BSDF written in
Python, for a specimen that is flat and for one that is traced.
"""

import sys
from pathlib import Path

import gonio_mi as gonio

# isort: split
import mitsuba as mi
import plain_bsdf

PACKAGE = Path(gonio.__file__).parent


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

    class Walked(plain_bsdf.plain()):
        def sample(self, *arguments):
            seen[:] = frames()
            return super().sample(*arguments)

    plain_bsdf.register([Walked])
    gonio.measure(specimen, 30, rays=2000, batches=2, **settings)
    return seen


def main():
    """See the module."""
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


if __name__ == "__main__":
    main()

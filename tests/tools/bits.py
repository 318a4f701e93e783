"""The bits of many small measurements, to hold two states of the code side by side.

``python tests/tools/bits.py before.json`` writes a digest of each; with
``after.json --against before.json`` it names those that have changed, and ends with 1
if there are any. Bits are a promise for one kind of processor and one set of versions:
compare on the same machine.
"""

import argparse
import hashlib
import itertools
import json
import sys
import tempfile
import warnings
from pathlib import Path

import gonio_mi as gonio

# isort: split
import mitsuba as mi
import numpy as np

FIRST_ROWS = 12
SCENES = Path(__file__).parents[2] / "scenes"
MIRROR = {"type": "twosided", "bsdf": {"type": "conductor"}}
SHINY = {"type": "roughconductor", "alpha": 0.2, "distribution": "ggx"}
PLASTIC = {"type": "roughplastic", "alpha": 0.2, "distribution": "ggx"}
COLOURED = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.7, 0.4, 0.1]}}
GLASS = {"type": "roughdielectric", "alpha": 0.3, "distribution": "ggx"}
FLAT = {
    "diffuse": {"type": "diffuse"},
    "coloured": COLOURED,
    "shiny": SHINY,
    "plastic": PLASTIC,
    "glass": GLASS,
    "clear": {"type": "dielectric"},
    "principled": {"type": "principled", "roughness": 0.4, "spec_tint": 0.3},
    "phong": {"type": "anisotropicphong", "exponent_u": 20.0},
    "mixture": {"type": "glossymixture", "specular_reflectance": 0.2},
    "lobe": {"type": "cosinelobe", "exponent": 30.0},
}
HILLS = {
    "type": "heightfield",
    "alpha": 0.4,
    "resolution": 32,
    "correlation_length": 0.2,
    "seed": 3,
}
SHAPES = {
    "hills": HILLS | {"bsdf": MIRROR},
    "matt hills": HILLS | {"bsdf": COLOURED},
    "glossy hills": HILLS | {"bsdf": {"type": "twosided", "bsdf": SHINY}},
    "ball": {"type": "sphere", "bsdf": {"type": "plastic"}},
    "bubble": {"type": "sphere", "bsdf": GLASS},
}
EMITTER = {
    "type": "rectangle",
    "to_world": [[0.5, 0, 0, 0], [0, -0.5, 0, 0], [0, 0, -1, 4], [0, 0, 0, 1]],
    "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [1.0, 0.5, 0.2]}},
}
VARIANTS = ("llvm_ad_mono", "llvm_ad_rgb", "llvm_ad_spectral")
COLLECTORS = (
    "projected:6x8",
    "angle:5x7",
    "solid:4x9",
    "sine:5x5",
    "borders:0,20,70,90x0,10,100,360",
    "klems",
    "apertures:5@10/0,45/90",
)


def _emitter():
    matrix = EMITTER["to_world"]
    return EMITTER | {"to_world": mi.ScalarTransform4f(matrix)}


def _plain(specimen, theta_i=(30,), **settings):
    """Bits of one measurement, its values and intervals included."""
    settings = {"rays": 3000, "batches": 4, "collector": "projected:6x8"} | settings
    return _of_record(gonio.measure(specimen, list(theta_i), **settings))


def _of_record(record):
    arrays = []
    for tally in record.tallies:
        arrays += [tally.hits, tally.sums, tally.incident, _rows(tally.fates)]
    arrays += [record.brdf, record.brdf_std_err, *record.interval(0.95), record.dhr]
    return _digest(arrays)


def _rows(fates):
    """Rows of the ledger: those that came later only if there is a ray in one."""
    return fates if fates[:, FIRST_ROWS:].any() else fates[:, :FIRST_ROWS]


def _digest(arrays):
    digest = hashlib.sha256()
    for array in arrays:
        array = np.ascontiguousarray(array)
        digest.update(f"{array.dtype}{array.shape}".encode() + array.tobytes())
    return digest.hexdigest()[:16]


def _saved(specimen, ending):
    record = gonio.measure(specimen, [20, 50], rays=2000, collector="projected:4x6")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"a{ending}"
        record.save(path)
        return _of_record(gonio.load(path))


def _campaign(specimen):
    specimens = {"a": specimen, "b": {"type": "diffuse"}}
    records = gonio.campaign(
        specimens, [0, 40], [0, 90], rays=2000, batches=4, collector="projected:4x6"
    )
    return "".join(_of_record(record) for record in records.values())


def _rendered(path):
    scene = mi.load_file(str(path))
    return _digest([np.array(mi.render(scene, spp=2000, seed=5))])


def measurements():
    """Name, variant and function of each measurement, in the order of the variants."""
    for variant in VARIANTS:
        short = variant.removeprefix("llvm_ad_")
        for name, method in _in_any_variant():
            yield f"{short}: {name}", variant, method
    for name, method in _in_one_variant():
        yield f"mono: {name}", VARIANTS[0], method


def _in_any_variant():
    methods = itertools.product(
        ("weighted", "analog"), ("sobol", "independent", "stratified")
    )
    for estimator, sampler in methods:
        for name in ("coloured", "shiny", "glass"):
            settings = {"estimator": estimator, "sampler": sampler}
            yield (
                f"{name}, {estimator}, {sampler}",
                lambda s=settings, n=name: _plain(FLAT[n], (30, 70), **s),
            )
    for name in FLAT:
        yield f"{name}, plain", lambda n=name: _plain(FLAT[n], (0, 45, 80))
    for name in ("coloured", "plastic", "glass"):
        yield (
            f"{name}, quadrature",
            lambda n=name: _plain(FLAT[n], (40,), estimator="quadrature", rel_err=1e-3),
        )
    for name in SHAPES:
        for estimator in ("weighted", "next_event"):
            settings = {"estimator": estimator, "period": "none"}
            if "hills" in name:
                settings["period"] = "box"
            yield (
                f"{name}, {estimator}",
                lambda n=name, s=settings: _plain(SHAPES[n], (20, 60), **s),
            )
    yield "lamp", lambda: _plain(COLOURED, (30,), emitter=_emitter())
    yield (
        "lamp, equal power",
        lambda: _plain(SHINY, (30,), emitter=_emitter(), emission="equal_power"),
    )
    yield "back", lambda: _plain(GLASS, (35,), side="back", phi_i=20)
    yield "traced plane", lambda: _plain(PLASTIC, (45,), trace=True)


def _in_one_variant():
    for collector in COLLECTORS:
        for name in ("plastic", "glass"):
            yield (
                f"{name}, {collector}",
                lambda c=collector, n=name: _plain(FLAT[n], (25,), collector=c),
            )
        yield (
            f"hills, {collector}",
            lambda c=collector: _plain(SHAPES["hills"], collector=c, period="box"),
        )
    for order in ("1", "2", "3+"):
        yield (
            f"hills, order {order}",
            lambda o=order: _plain(SHAPES["hills"], (60,), order=o, period="box"),
        )
    for theta_i, phi_i in itertools.product((0, 15, 60, 85), (0, 130)):
        for name in ("shiny", "clear", "phong"):
            yield (
                f"{name}, from {theta_i}, {phi_i}",
                lambda n=name, t=theta_i, p=phi_i: _plain(FLAT[n], (t,), phi_i=p),
            )
    for footprint in ("point", "full", 0.3):
        for specimen in (SHINY, SHAPES["matt hills"]):
            yield (
                f"{specimen['type']}, footprint {footprint}",
                lambda f=footprint, s=specimen: _plain(s, (30,), footprint=f),
            )
    yield "collector of radius 9", lambda: _plain(SHINY, collector_radius=9)
    yield "max_depth 1", lambda: _plain(SHAPES["hills"], max_depth=1, period="box")
    yield "rr_depth 1", lambda: _plain(SHAPES["matt hills"], rr_depth=1, period="box")
    yield (
        "three points",
        lambda: _plain(
            SHAPES["matt hills"], estimator="next_event", points=3, period="box"
        ),
    )
    yield "seed 7", lambda: _plain(PLASTIC, seed=7)
    yield "32 batches", lambda: _plain(PLASTIC, batches=32)
    yield "one batch", lambda: _plain(PLASTIC, batches=1)
    yield "upper only", lambda: _plain(GLASS, hemispheres="upper")
    yield "to 5 %", lambda: _plain(PLASTIC, rays=None, rel_err=0.05)
    for ending in (".npz", ".exr"):
        for name in ("plastic", "glass"):
            yield (
                f"{name}, saved as {ending}",
                lambda e=ending, n=name: _saved(FLAT[n], e),
            )
    yield "campaign", lambda: _campaign(SHINY)
    for path in sorted(SCENES.glob("*.xml")):
        yield path.name, lambda p=path: _rendered(p)


def bits(share=1):
    """Digest of every `share`-th measurement by name."""
    found = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name, variant, method in list(measurements())[::share]:
            if mi.variant() != variant:
                mi.set_variant(variant)
            found[name] = method()
    return found


def main():
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("output", type=Path)
    parser.add_argument("--against", type=Path)
    parser.add_argument("--share", type=int, default=1)
    options = parser.parse_args()
    found = bits(options.share)
    options.output.write_text(json.dumps(found, indent=1))
    print(len(found), "measurements")
    if options.against:
        before = json.loads(options.against.read_text())
        changed = [name for name in found if before.get(name) != found[name]]
        print("\n".join(f"changed: {name}" for name in changed) or "all as before")
        sys.exit(bool(changed))


if __name__ == "__main__":
    main()

"""Trials of damaged files and odd command lines, in a process that may die of them.

``python fuzz.py REPORT FIRST N KIND ...`` makes the trials FIRST to FIRST + N - 1 of
each kind and writes a line of JSON into the file REPORT when one begins and when one
has failed. A trial fails if it answers with anything but what the intact file gives,
one sentence of at most 400 characters or, for formats without a check sum, another
value of the right type; if it prints; if it takes more than 1 GiB; or if the process
ends. :func:`trials` runs such processes and gathers what has failed.
"""

import contextlib
import io
import json
import os
import subprocess
import sys
import tempfile
import traceback
import warnings
from pathlib import Path

import numpy as np
from surface_files import write_sur, write_tiff, write_x3p

from gonio_mi.errors import SettingError

MOST_BYTES, MOST_CHARACTERS = 2**30, 400

# What damage writes where a number stood.
ODD_NUMBERS = [
    *("0", "-1", "1", "nan", "inf", "-inf", "1e300", "1e-300", "-0", "0_3", "400"),
    *("99999999999999999999", "2147483648", "4294967295", "", "x", "None", "true"),
    *("1e", "0x10", "\u0663", "1,5", "9" * 5000),
]


def damaged(data, rng):
    """Bytes with one to three changes: bits, bytes, numbers, cuts and copies."""
    data = bytearray(data)
    for _ in range(rng.integers(1, 4)):
        at = int(rng.integers(len(data) + 1)) if data else 0
        # headers are short, and most can go wrong in them
        at = at % min(len(data) + 1, 2000) if rng.random() < 0.5 else at
        length = int(2 ** rng.uniform(0, 8))
        kind = rng.integers(8)
        if kind == 0 and at < len(data):
            data[at] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            data[at : at + length] = rng.bytes(len(data[at : at + length]))
        elif kind == 2:
            del data[at:]
        elif kind == 3:
            del data[at : at + length]
        elif kind == 4:
            data[at:at] = data[at : at + length] * int(rng.integers(1, 20))
        elif kind == 5:
            data[at : at + 8] = int(
                rng.choice([0, 1, 2**31, 2**32 - 1, 2**40])
            ).to_bytes(8, "little")
        else:
            _replace_number(data, at, rng)
    return bytes(data)


def _replace_number(data, at, rng):
    """Put something odd in place of the digits at or after a place."""
    digits = b"+-.0123456789eE"
    while at < len(data) and not chr(data[at]).isdigit():
        at += 1
    end = at
    while end < len(data) and data[end] in digits:
        end += 1
    data[at:end] = str(rng.choice(ODD_NUMBERS)).encode()


# ------------------------------------------------------------------- kinds of trials


class Files:
    """Damaged files of one format.

    Parameters
    ----------
    name : str
        Of the file.
    make : callable
        Writes the intact file to a path.
    read : callable
        Returns what the file at a path says.
    exact : bool
        Whether only what the intact file says may come of it.
    """

    def __init__(self, name, make, read, exact=False):
        self.name, self.make, self.read, self.exact = name, make, read, exact

    def start(self, folder):
        """Make the intact file and read it once."""
        self.path = Path(folder) / self.name
        self.make(self.path)
        self.data = self.path.read_bytes()
        self.intact = self.read(self.path)

    def trial(self, rng):
        """Read a damaged file; return what is wrong with the answer, or None."""
        self.path.write_bytes(damaged(self.data, rng))
        try:
            answer = self.read(self.path)
        except (ValueError, OSError) as error:
            return bad_sentence(error)
        if self.exact and answer != self.intact:
            return "another answer"
        return None

    def keep(self, place):
        """Keep the damaged file for whoever mends its reader."""
        place.with_suffix(self.path.suffix).write_bytes(self.path.read_bytes())


class Commands:
    """Random command lines."""

    def start(self, folder):
        """Make a few files to name."""
        import synthetic

        os.chdir(folder)
        synthetic.record().save("a.npz")
        synthetic.record(seed=2).save("b.exr")
        synthetic.record(theta_i=(0, 30, 60), phi_i=(0, 0, 0), both=True).save("c.npz")
        Path("table.csv").write_text(
            "# quantity: brdf\ntheta_i,phi_i,theta_o,phi_o,value\n30,20,40,200,0.3\n"
        )
        Path("plugin.py").write_text("import mitsuba as mi\n")
        Path("noise.py").write_text("raise ValueError('x' * 5000)\n")
        Path("scene.xml").write_text(SCENE)

    def trial(self, rng):
        """Run a command; return what is wrong with how it ends, or None."""
        from gonio_mi import cli

        self.words = random_command(rng)
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            try:
                code = cli.main(self.words)
            except SystemExit as stop:  # --help and --version
                code = stop.code or 0
        lines = err.getvalue().splitlines()
        if code not in (0, 1, 2, 3):
            return f"exit code {code}"
        if code == 1 and not lines:
            return "an error without a sentence"
        long = [line for line in lines if len(line) > MOST_CHARACTERS]
        if long:
            return f"{len(long[0])} characters: {long[0]:.200}"
        if "Traceback" in err.getvalue() + out.getvalue():
            return f"a traceback: {err.getvalue()[-300:]}"
        if "this is a bug of" in err.getvalue():
            return err.getvalue()[-300:]
        return None

    def keep(self, place):
        """Keep the command line."""
        place.with_suffix(".json").write_text(json.dumps(self.words))


def bad_sentence(error):
    """What is wrong with the message of an error, or None."""
    text = str(error)
    if not text or "\n" in text or "Traceback" in text:
        return f"no sentence: {text:.300}"
    if len(text) > MOST_CHARACTERS:
        return f"{len(text)} characters: {text:.200}"
    innermost = traceback.extract_tb(error.__traceback__)[-1].filename
    if not isinstance(error, (OSError, SettingError)):
        return f"{type(error).__name__} of {innermost}: {text:.200}"
    return None


SCENE = """<scene version="3.0.0">
    <default name="alpha" value="0.2"/>
    <integrator type="goniophotometer">
        <integer name="rays" value="1000"/>
        <string name="estimator" value="weighted"/>
    </integrator>
    <sensor type="collector">
        <film type="patches"><string name="subdivision" value="projected:4x6"/></film>
        <sampler type="independent"/>
    </sensor>
    <emitter type="directional">
        <vector name="direction" x="0.5" y="0" z="-1"/>
    </emitter>
    <shape type="heightfield">
        <integer name="resolution" value="16"/>
        <float name="alpha" value="0.3"/>
        <bsdf type="twosided"><bsdf type="roughconductor">
            <float name="alpha" value="$alpha"/>
            <string name="distribution" value="ggx"/>
        </bsdf></bsdf>
    </shape>
    <shape type="rectangle">
        <transform name="to_world"><scale value="2"/><translate z="-0.5"/></transform>
        <bsdf type="diffuse"><rgb name="reflectance" value="0.2, 0.3, 0.4"/></bsdf>
    </shape>
</scene>
"""

SPECIMENS = [
    *("diffuse", "roughconductor:alpha=0.2", "diffuse:reflectance=0.2/0.5/0.1", ""),
    *("scene.xml", "absent.xml", "a.npz", "nothing", "diffuse:", "diffuse:a"),
    *("x" * 5000, "diffuse:reflectance=nan", "roughplastic:alpha=-1"),
    *("diffuse:reflectance=1e300", "goniometric:filename=c.npz"),
    *("goniometric:filename=absent.npz", "dielectric", "measured:filename=a.npz"),
    *("heightfield:alpha=0.3", "twosided", "\x1b[31m", "."),
]
NUMBERS = [
    *("1", "0.1", "45", "0", "-1", "90", "89.99", "1e300", "nan", "inf", "x"),
    *("", "1e2", "9" * 400, "-0", "1e-300", "180", "1000"),
]
COLLECTORS = [
    *("angle:3x4", "projected:4x6", "solid:2x2", "klems", "angle:0x1", "angle:1x1"),
    *("x", "projected:99999x99999", "apertures:5@10/0,45/90"),
    *("apertures:5@0/0,0/0", "angle:", "borders:0,30,90x0,180,360"),
    *("borders:0,nanx0,360", "apertures:nan@0/0", "y" * 999),
    "angle:" + "9" * 600 + "x1",
]
FILES = [
    *("a.npz", "b.exr", "c.npz", "absent.npz", "table.csv", "scene.xml", "."),
    "z" * 300,
]
OUTPUTS = ["o.npz", "o.exr", "absent/o.npz", "o.txt", "."]
PICTURES = ["o.png", "o.svg", "o.txt", "absent/o.png", "."]
EXPORTS = [
    *("o.zemax.bsdf", "o.brdf", "o.anisotropicbsdf", "o.json", "o.csv", "o.nc"),
    *("o.h5", "o.xml", "o.bsdf", "o.x", "absent/o.csv"),
]

# Values of each option, or None if it takes none.
OPTIONS = {
    "measure": {
        "--theta-i": NUMBERS,
        "--phi-i": NUMBERS,
        "--collector": COLLECTORS,
        "--rays": ["1000", "100", "2", "0", "-1", "x", "nan", "1e400", "1_000"],
        "--rel-err": ["0.5", "0", "x", "nan", "1e300", "1e-300"],
        "--max-rays": ["1000", "0", "x"],
        "--estimator": ["weighted", "analog", "quadrature", "next_event", "x", ""],
        "--sampler": ["sobol", "independent", "x", "diffuse"],
        "--batches": ["2", "1", "0", "1e9", "x", "4"],
        "--seed": ["1", "-1", "1e30", "x"],
        "--side": ["front", "back", "x"],
        "--variant": ["llvm_ad_mono", "x", "scalar_rgb", ""],
        "--wavelengths": ["550", "x", "nan", "-1"],
        "--plugin": ["plugin.py", "noise.py", "absent.py", "a.npz"],
        "-D": ["alpha=0.3", "alpha=x", "x", "a=" + "b" * 3000],
        "--footprint": ["point", "full", "0.1", "x", "nan", "1e300"],
        "--period": ["1,1", "x", "0", "nan,1", "1e300"],
        "--order": ["1", "x", "-1", "all"],
        "--max-depth": NUMBERS,
        "--rr-depth": NUMBERS,
        "--emission": ["uniform", "x", "nan"],
        "--points": NUMBERS,
        "--trace": None,
        "--hemispheres": ["both", "upper", "x"],
        "--collector-radius": NUMBERS,
        "-o": OUTPUTS,
    },
    "show": {"--json": None},
    "plot": {"-o": PICTURES, "--index": NUMBERS},
    "compare": {
        "-o": PICTURES,
        "--channel": ["Y", "x"],
        "--quantity": ["brdf", "x"],
        "--columns": ["theta_i=a", "value=x", "x", "theta_i=1"],
        "--azimuth": ["source", "mirror", "x"],
        "--divergence": NUMBERS,
        "--budget": ["o.csv", "o.txt", "."],
        "--uncertainty": NUMBERS,
        "--scale-uncertainty": NUMBERS,
        "--alpha": NUMBERS,
        "--json": None,
    },
    "export": {"--basis": ["klems", "tensor3", "x"]},
    "plan": {
        "--collector": COLLECTORS,
        "--epsilon": NUMBERS,
        "--delta": NUMBERS,
        "--rel-err": NUMBERS,
        "--level": NUMBERS,
        "--floor": NUMBERS,
    },
    "doctor": {"--x": None},
    "": {"--help": None, "--version": None, "nothing": None},
}
POSITIONAL = {
    "measure": [SPECIMENS],
    "show": [FILES],
    "plan": [FILES],
    "plot": [FILES],
    "compare": [FILES, FILES],
    "export": [FILES],
}
SHARES = {"measure": 10, "compare": 2, "doctor": 0.2, "": 0.5}


def random_command(rng):
    """Words of a command line, most of them right."""
    names = list(OPTIONS)
    shares = np.array([SHARES.get(name, 1) for name in names])
    name = str(rng.choice(names, p=shares / shares.sum()))
    words = [name] * bool(name)
    words += [_one_of(values, rng) for values in POSITIONAL.get(name, [])]
    options = OPTIONS[name]
    if name == "measure":  # a small one
        words += ["--rays", "1000", "--batches", "2", "--collector", "angle:3x4"]
        words += ["--theta-i", _one_of(NUMBERS, rng)]
    if name == "export":
        words += ["-o", _one_of(EXPORTS, rng)]
    n_options = min(len(options), int(rng.integers(0, 4)))
    for key in rng.choice(list(options), n_options, replace=False):
        words.append(str(key))
        if options[key] is not None and rng.random() < 0.97:
            words.append(_one_of(options[key], rng))
    return words


def _one_of(values, rng):
    """One of the values; the first are the likeliest."""
    return values[int(len(values) * rng.random() ** 4)]


# ------------------------------------------------------------------------- the kinds


def kinds():
    """What can be tried, by name."""
    import synthetic
    from scatter_trials import scatter_kinds

    import gonio_mi as gonio
    from gonio_mi.exchange.formats.reading import read_measured

    record = synthetic.record("projected:3x4", theta_i=(0, 40), phi_i=(0, 0), both=True)
    return {
        "npz": Files("f.npz", record.save, gonio.load, exact=True),
        "exr": Files("f.exr", record.save, gonio.load, exact=True),
        "csv": Files("f.csv", _write_csv, read_measured),
        "astm": Files("f.astm", _write_astm, _read_astm),
        "klems": Files("f.xml", _write_klems, _read_radiance),
        "tensor": Files("f.xml", _write_tensor, _read_radiance),
        "tensor file": Files("f.bsdf", _write_bsdf, _read_tensor_file),
        "bsdf": Files("f.bsdf", _write_bsdf, _load("measured")),
        "npy": Files("f.npy", _write_npy, _load("heightfield", size=2.0)),
        "png": Files("f.png", _write_image, _load("heightfield", size=2.0, range=0.1)),
        "sur": Files("f.sur", write_sur, _read_heights),
        "x3p": Files("f.x3p", write_x3p, _read_heights),
        "tiff": Files("f.tif", write_tiff, _read_heights),
        "image": Files("f.exr", _write_image, _load("heightfield", size=2.0)),
        "goniometric": Files("f.npz", _write_stack, _load("goniometric")),
        "scene": Files("f.xml", lambda path: path.write_text(SCENE), _load_scene),
        "command": Commands(),
        **scatter_kinds(Files),
        **BROKEN,
    }


def _write_csv(path):
    lines = ["# units: 1/sr", "# quantity: brdf", "# scale_uncertainty: 0.01"]
    lines += ["# instrument: a", "theta_i,phi_i,theta_o,phi_o,value,sigma"]
    lines += [f"{t},0,{o},180,0.3{o},0.001" for t in (0, 45) for o in range(0, 80, 20)]
    path.write_text("\n".join(lines) + "\n")


def _write_astm(path):
    rows = np.random.default_rng(0).uniform(0, 1.5, (20, 5)).tolist()
    lines = ["SOURCE test", "NUM_POINTS 20", "VARS theta_i,phi_i,theta_s,phi_s,550nm"]
    lines += [",".join(map(repr, row)) for row in rows]
    path.write_text("\n".join(lines) + "\n")


def _read_astm(path):
    from gonio_mi.exchange.formats.reading import read_measured

    return read_measured(path, None)


def _write_klems(path):
    from gonio_mi.exchange.formats import radiance

    blocks = {("Visible", "Reflection Back"): np.full((145, 145), 0.1)}
    with open(path, "wb") as stream:
        radiance.write(blocks, stream)


def _write_tensor(path):
    from gonio_mi.exchange.formats import radiance
    from gonio_mi.exchange.formats.tensor_tree import TensorTree

    values = np.random.default_rng(0).uniform(0, 1, (4, 4, 4))
    blocks = {("Visible", "Reflection Back"): TensorTree.of(values)}
    with open(path, "wb") as stream:
        radiance.write(blocks, stream)


def _read_radiance(path):
    from gonio_mi.exchange.formats.radiance import RadianceBSDF

    with open(path, "rb") as stream:
        bsdf = RadianceBSDF(stream)
    wo = np.array([[0.6, 0, 0.8], [0, 0, 1], [0.8, 0.6, 0]])
    return [
        bsdf.values("front", h, 30.0, 0.0, wo) for h in (0, 1) if bsdf.holds("front", h)
    ]


def measured_fields():
    """Fields of a small isotropic material for Mitsuba's `measured`, in rgb."""
    single = {
        "theta_i": np.linspace(0, 1.5, 3),
        "phi_i": np.zeros(1),
        "ndf": np.ones((2, 2)),
        "sigma": np.ones((2, 2)),
        "vndf": np.ones((1, 3, 2, 2)),
        "luminance": np.ones((1, 3, 4, 4)),
        "rgb": np.full((1, 3, 3, 4, 4), 0.1),
    }
    return {name: array.astype(np.float32) for name, array in single.items()} | {
        "description": np.frombuffer(b"made by hand", np.uint8),
        "jacobian": np.zeros(1, np.uint8),
    }


def _write_bsdf(path):
    from gonio_mi.files import tensor_file

    with open(path, "wb") as stream:
        tensor_file.write(measured_fields(), stream)


def _read_tensor_file(path):
    from gonio_mi.files import tensor_file

    with open(path, "rb") as stream:
        return tensor_file.read(stream)


def _write_npy(path):
    np.save(path, np.random.default_rng(0).normal(0, 0.01, (12, 16)))


def _write_image(path):
    import mitsuba as mi

    heights = np.random.default_rng(0).uniform(0, 1, (12, 16, 1)).astype(np.float32)
    bitmap = mi.Bitmap(heights)
    if path.suffix == ".png":
        bitmap = bitmap.convert(mi.Bitmap.PixelFormat.Y, mi.Struct.Type.UInt8, True)
    bitmap.write(str(path))


def _write_stack(path):
    import synthetic

    synthetic.record("projected:3x4", theta_i=(0, 40), phi_i=(0, 0)).save(path)


def _read_heights(path):
    """Heights of an instrument's file, read in this process of limited memory."""
    from gonio_mi.surfaces import height_map_reader, height_maps

    height_maps.read_apart = height_map_reader.read
    return height_maps.read_height_map(path, None).heights


def _load(plugin, **settings):
    """Reader that makes a specimen of a file, and measures a few rays if that works."""

    def load(path):
        import mitsuba as mi

        from gonio_mi.specimen.loading import load_specimen

        mi.set_variant("llvm_ad_rgb")
        mi.set_log_level(mi.LogLevel.Error)  # libpng warns of a damaged comment
        warnings.filterwarnings("ignore", "the facets of", RuntimeWarning)
        scene = load_specimen({"type": plugin, "filename": str(path)} | settings)
        if plugin == "measured":
            _evaluate(mi, scene.shapes()[0].bsdf())
        return plugin

    return load


def _evaluate(mi, bsdf):
    """Sample and evaluate a BSDF at three directions."""
    import drjit as dr

    si = dr.zeros(mi.SurfaceInteraction3f, 3)
    si.wi = dr.normalize(mi.Vector3f([0.0, 0.6, 0.99], 0.0, [1.0, 0.8, 0.1]))
    context = mi.BSDFContext()
    bs, weight = bsdf.sample(context, si, mi.Float(0.5), mi.Point2f(0.3, 0.7))
    dr.eval(weight, bsdf.eval(context, si, bs.wo), bsdf.pdf(context, si, bs.wo))


def _load_scene(path):
    import mitsuba as mi

    from gonio_mi.specimen.loading import load_specimen

    mi.set_variant("llvm_ad_mono")
    load_specimen(path)
    return "a scene"


def _raise(error):
    raise error


def _broken(fault):
    """Kind of trial whose reader has a fault, which damage brings out."""

    def read(path):
        return path.read_bytes() == bytes(99) or fault()

    return Files("f", lambda path: path.write_bytes(bytes(99)), read, exact=True)


# Readers with the faults that trials are to find, one each.
BROKEN = {
    "broken: raises": _broken(lambda: {}["a bug"]),
    "broken: speaks": _broken(lambda: _raise(ValueError("x" * 500))),
    "broken: differs": _broken(lambda: False),
    "broken: dies": _broken(os.abort),
    "broken: prints": _broken(lambda: os.write(2, b"oh") > 0),
    "broken: takes": _broken(lambda: len(bytes(2**30 + 2**29)) > 0),
}


# ------------------------------------------------------------------------- processes


def trials(names, n, folder, first=0):
    """Make `n` trials of each kind in processes of their own.

    Returns
    -------
    failures : list of dict
        ``kind``, ``trial`` and ``wrong`` of each.
    """
    report, output = Path(folder) / "report.jsonl", Path(folder) / "output"
    failures, start = [], first
    while start < first + n:
        report.write_text("")
        command = [sys.executable, __file__, report, start, first + n - start, *names]
        with open(output, "wb") as stream:
            done = subprocess.run(
                [str(word) for word in command],
                stdout=stream,
                stderr=stream,
                check=False,
                env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
            )
        lines = [json.loads(line) for line in report.read_text().splitlines()]
        failures += [line for line in lines if "wrong" in line]
        said = output.read_text(errors="replace")
        if done.returncode == 0:
            if said:
                failures.append({"kind": names, "trial": None, "wrong": said[:500]})
            break
        if not lines:
            raise RuntimeError(f"no trial began: {said[-2000:]}")
        last = lines[-1]
        wrong = f"the process ended with {done.returncode}: {said[-500:]}"
        failures.append({**last, "wrong": wrong})
        # the kinds after it miss this one trial
        start = last["trial"] + 1
    return failures


def _limit_memory():
    """Let the process take `MOST_BYTES` more than it has."""
    import resource

    status = Path("/proc/self/status").read_text().splitlines()
    size = next(line for line in status if line.startswith("VmSize"))
    limit = int(size.split()[1]) * 1024 + MOST_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def _main(report, first, n, *names):
    warnings.simplefilter("error")
    every = kinds()
    keep = os.environ.get("GONIO_FUZZ_KEEP")
    with tempfile.TemporaryDirectory() as folder, open(report, "a") as stream:
        chosen = {name: every[name] for name in names}
        for kind in chosen.values():
            kind.start(folder)
        _limit_memory()
        for trial in range(int(first), int(first) + int(n)):
            for name, kind in chosen.items():
                print(
                    json.dumps({"kind": name, "trial": trial}), file=stream, flush=True
                )
                rng = np.random.default_rng([trial, *name.encode()])
                try:
                    wrong = kind.trial(rng)
                except BaseException as error:
                    wrong = " ".join(traceback.format_exc().split())[-900:]
                    wrong = f"{type(error).__name__}: {wrong}"
                if wrong:
                    line = {"kind": name, "trial": trial, "wrong": wrong}
                    print(json.dumps(line), file=stream, flush=True)
                    if keep:
                        kind.keep(Path(keep) / f"{name.replace(' ', '_')}_{trial}")
        os.chdir("/")


if __name__ == "__main__":
    _main(*sys.argv[1:])

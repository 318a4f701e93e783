"""The command line: what it prints and writes, and one sentence for each bad input."""

import importlib
import io
import json
import os
import re
import shlex
import signal
import subprocess
import sys
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import gonio_mi as gonio
from gonio_mi import cli, files, start_up
from gonio_mi.files import npz
from gonio_mi.results.summary import summarize
from gonio_mi.settings import MeasurementSettings, declarations

DIFFUSE = ("measure", "diffuse", "--theta-i", "45")
QUICK = (*DIFFUSE, "--rays", "1e4")

SCENE = """<scene version="3.0.0">
    <default name="alpha" value="0.3"/>
    <shape type="rectangle">
        <bsdf type="roughconductor"><float name="alpha" value="$alpha"/></bsdf>
    </shape>
</scene>"""

# Lambertian BSDFs: with a quarter of the weights invalid; one that raises; and one that
# is interrupted, or waits to be, in its `at`-th sample().
PLUGINS = """
import signal, time
from types import SimpleNamespace
import drjit as dr
import mitsuba as mi

class Diffuse(mi.BSDF):
    def __init__(self, props):
        super().__init__(props)
        self.m_components = [mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide]
        self.m_flags = self.m_components[0]

    def sample(self, ctx, si, sample1, sample2, active=True):
        bs = mi.BSDFSample3f()
        bs.wo = mi.warp.square_to_cosine_hemisphere(sample2)
        bs.pdf = mi.warp.square_to_cosine_hemisphere_pdf(bs.wo)
        bs.eta = 1.0
        bs.sampled_type = +mi.BSDFFlags.DiffuseReflection
        bs.sampled_component = 0
        return bs, mi.Spectrum(self.weight(sample1)) & active

    def weight(self, sample1):
        return 0.5

    def eval(self, ctx, si, wo, active=True):
        above = (si.wi.z > 0) & (wo.z > 0)
        return mi.Spectrum(self.weight(0.5) * wo.z * dr.inv_pi) & above & active

    def to_string(self):
        return type(self).__name__

class Invalid(Diffuse):
    def weight(self, sample1):
        return dr.select(sample1 < 0.25, dr.nan, 0.5)

class Raising(Diffuse):
    def weight(self, sample1):
        raise ZeroDivisionError("no weight")

class Interrupted(Diffuse):
    def __init__(self, props):
        super().__init__(props)
        # no part of the specimen
        self.control = SimpleNamespace(at=props.get("at", 0), calls=0)
        self.control.wait = props.get("wait", False)

    def weight(self, sample1):
        self.control.calls += 1
        if self.control.calls == self.control.at:
            if self.control.wait:
                print("waiting", flush=True)
                for _ in range(600):  # a signal just before a sleep ends none
                    time.sleep(1)
            signal.raise_signal(signal.SIGINT)
        return 0.5

class Nameless(mi.BSDF):
    def __init__(self, props):
        super().__init__(props)
        self.m_components = [mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide]
        self.m_flags = self.m_components[0]

    sample, weight = Diffuse.sample, Diffuse.weight

for plugin in (Diffuse, Invalid, Raising, Interrupted, Nameless):
    mi.register_bsdf("test_" + plugin.__name__.lower(), plugin)
"""


@pytest.fixture
def run(capsys):
    """Function that runs the command line: exit code, standard output and error."""

    def run(*arguments):
        code = cli.main([str(argument) for argument in arguments])
        return code, *capsys.readouterr()

    return run


@pytest.fixture
def refuse(run):
    """Function that returns the one sentence by which bad input is refused."""

    def refuse(*arguments):
        code, out, err = run(*arguments)
        assert code == 1
        assert out == ""
        assert err.startswith("gonio-mi: ")
        assert err.count("\n") == 1
        return err

    return refuse


@pytest.fixture
def write(tmp_path):
    """Function that writes a file and returns its path."""

    def write(name, content):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


@pytest.fixture
def plugins(write):
    """Arguments that load `PLUGINS`."""
    return ("--plugin", write("my_bsdfs.py", PLUGINS))


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """Paths of one record as NPZ and as EXR; two directions, both hemispheres."""
    folder = tmp_path_factory.mktemp("saved")
    paths = folder / "run.npz", folder / "run.exr"
    arguments = ["measure", "roughdielectric:alpha=0.2", "--theta-i", "0", "60"]
    arguments += ["--rays", "1e4", "--collector", "solid:6x8", "-q"]
    assert cli.main([*arguments, "-o", *map(str, paths)]) == 0
    return paths


@pytest.fixture
def sigint():
    """React to Ctrl-C as Python does, even if a shell in the background ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


# ------------------------------------------------------------------------- measuring


def test_measure_equals_the_python_call(run, tmp_path):
    path = tmp_path / "run.npz"
    arguments = ["--theta-i", "45", "--phi-i", "-30", "--rays", "1e4", "--seed", "3"]
    arguments += ["--estimator", "analog", "--collector", "angle:4x6", "--batches", "5"]
    code, out, err = run(
        "measure", "roughconductor:alpha=0.3", *arguments, "-q", "-o", path
    )
    assert (code, out, err) == (0, "", "")
    expected = gonio.measure(
        {"type": "roughconductor", "alpha": 0.3},
        theta_i=45,
        phi_i=-30,
        rays=10**4,
        seed=3,
        estimator="analog",
        collector="angle:4x6",
        batches=5,
    )
    record = gonio.load(path)
    assert record.tallies == expected.tallies
    assert record.brdf.shape == (4, 6, 1)
    own = {"created"}
    assert {k: v for k, v in record.settings.items() if k not in own} == {
        k: v for k, v in expected.settings.items() if k not in own
    }


def test_all_outputs_hold_the_same_stack(saved):
    npz, exr = map(gonio.load, saved)
    assert npz == exr
    assert npz.brdf.shape == (2, 6, 8, 1)
    np.testing.assert_array_equal(np.round(npz.theta_i, 3), [0, 60])


def test_without_output_the_numbers_are_shown_and_nothing_is_written(
    run, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    code, out, err = run(*QUICK)
    assert (code, err) == (0, "")
    assert "dhr" in out
    assert list(tmp_path.iterdir()) == []


def test_scene_parameters(run, write, tmp_path):
    scene = write("scene.xml", SCENE)
    path = tmp_path / "run.npz"
    arguments = ("measure", scene, "--theta-i", "60", "--rays", "1e3", "-q", "-o", path)
    assert run(*arguments, "-D", "alpha=0.1")[0] == 0
    assert (
        "alpha_u = UniformSpectrum[value=[0.1]]" in gonio.load(path).settings["surface"]
    )


def test_spectral_channels(run, tmp_path):
    path = tmp_path / "run.npz"
    spectral = ("--variant", "llvm_ad_spectral", "--wavelengths", "450", "550.5")
    assert run(*QUICK, *spectral, "-q", "-o", path)[0] == 0
    assert gonio.load(path).channels == ("450nm", "550.5nm")


def test_invalid_weights_are_measured_around(run, plugins, tmp_path):
    path = tmp_path / "run.npz"
    code, out, err = run("measure", "test_invalid", *QUICK[2:], *plugins, "-o", path)
    ledger = gonio.load(path).ledger
    assert code == 0
    assert err.startswith("gonio-mi: warning: the BSDF's sample() returned")
    assert err.count("\n") == 1
    assert 0 < ledger.invalid < ledger.emitted == 10**4
    assert ledger.invalid + ledger.reflected + ledger.absorbed == ledger.emitted
    assert np.isfinite(gonio.load(path).brdf).all()
    assert "warning" in out
    assert "invalid" in out


def test_precision_that_is_not_reached_exits_with_2(run, tmp_path):
    path = tmp_path / "run.npz"
    code, _, err = run(
        *DIFFUSE, "--rel-err", "1e-6", "--max-rays", 2**18, "-q", "-o", path
    )
    assert code == 2
    assert err.startswith("gonio-mi: warning: rel_err of 1e-06 was not reached")
    assert gonio.load(path).ledger.emitted == 2**18


def test_precision_that_is_reached_exits_with_0(run):
    assert run(*DIFFUSE, "--rel-err", "0.5", "-q") == (0, "", "")


# ------------------------------------------------------------------------- bad input


# What follows a measurement of `diffuse` at 45 degrees, and what is said of it.
BAD_OPTIONS = [
    ("--rays", "--rays"),
    ("--rays many", "--rays must be a number such as 45 or 1e7"),
    ("--phi-i inf", "phi_i must be a finite angle"),
    ("--rays 0", "rays must be at least 1, got 0"),
    ("--rays -5", "rays must be at least 1, got -5"),
    ("--rays 1.5", "rays must be a whole number, got 1.5"),
    ("--rays 1e30", "rays must be at most 1e+15, got 1e+30"),
    ("--rays nan", "rays must be a whole number, got nan"),
    ("--rays 5 --rel-err 0.1", "are mutually exclusive"),
    ("--rel-err 2", "rel_err must be a number in (0, 1)"),
    ("--max-rays 1e6", "max_rays requires rel_err"),
    ("--collector projected:0x30", "at least 1, got 0"),
    ("--collector foo:1x1", "must look like projected:30x30"),
    ("--collector-radius -1", "radius must be"),
    ("--hemispheres left", "got 'left'"),
    ("--estimator guess", "estimator must be one of"),
    ("--sampler guess", 'the sampler cannot be loaded: Plugin "guess"'),
    ("--seed -1", "seed must be at least 0, got -1"),
    ("--side left", "side must be one of front, back, got 'left'"),
    ("--footprint -1", "'full' or a positive radius, got -1"),
    ("--footprint wide", "'full' or a positive radius, got 'wide'"),
    ("--emission x", "emission must be one of"),
    ("--max-depth 0", "max_depth must be at least 1, got 0"),
    ("--rr-depth -2", "rr_depth must be at least -1, got -2"),
    ("--batches 0", "batches must be at least 1, got 0"),
    ("--variant scalar_rgb", "--variant must be one of"),
    ("--variant scalar_rgb", "got 'scalar_rgb'"),
    ("--variant foo", "--variant must be one of"),
    ("--variant llvm_ad_mono_polarised", "mean llvm_ad_mono_polariz"),
    ("--wavelengths 500", "wavelengths need a spectral variant"),
    ("-D alpha", "-D must look like key=value, got 'alpha'"),
    ("-D alpha=1", "-D applies to scene files only, got 'diffuse'"),
    ("--tolerence 1", ": --tolerence; did you mean --tolerance?\n"),
    ("--ior 1", "unrecognized arguments: --ior 1\n"),
    ("--samples 30", ": --samples; did you mean --rays?\n"),
    ("--spp 30", ": --spp; did you mean --rays?\n"),
    ("--n_rays=3", ": --n_rays; did you mean --rays?\n"),
    ("-n 3", ": -n; did you mean --rays?\n"),
    ("--alpha 0.3", ": --alpha; say SPECIMEN:alpha=0.3\n"),
    ("--int-ior=1.3", ": --int-ior; say SPECIMEN:int_ior=1.3\n"),
    ("--threads 2", "; all cores are used: taskset -c 0-3"),
    ("--pitch 1", "; --size is the extent in x: the pitch, times"),
    ("--rel-err '1 %'", "1e7, got '1 %' (write 0.01)\n"),
    ("--rel-err x%", "1e7, got 'x%'\n"),
    ("--plugin missing.py", "there is no file missing.py"),
    ("--resume missing.npz", "missing.npz"),
]

# The same of specimens that are measured at 45 degrees.
BAD_SPECIMENS = [
    ("difuse", "not found; did you mean diffuse?\n"),
    ("diffuse --phi_i=5", "--phi_i; did you mean --phi-i?\n"),
    ("nothing", '"nothing" not found; import your own plugins first, or name'),
    ("diffuse:rho=1", "the plugin diffuse has no use for rho\n"),
    ("dielectric:eta=1.5", "the plugin dielectric has no use for eta\n"),
    (
        "glossymixture:diffuse=1",
        "; it knows diffuse_reflectance, exponent, normalisation, specular_reflect",
    ),
    ("goniometric:x=1,filename=none.npz", "there is no file none.npz\n"),
    (
        "diffuse:rho=1,reflectence=0.3",
        "no use for rho, reflectence; did you mean reflectance?\n",
    ),
    (
        "cosinelobe:expnent=3",
        "cosinelobe has no use for expnent; did you mean exponent?\n",
    ),
    ("goniometrik:filename=none.npz", "did you mean goniometric?"),
    ("ggx", "mean roughconductor:distribution=ggx?\n"),
    (
        "roughplastic,alpha=0.2",
        "must have a colon before its parameters, as in roughplastic:alpha=0.2",
    ),
    (
        "principled:base_color=0.5,0.5,0.5",
        "base_color must be a colour with slashes, such as 0.5/0.5/0.5, got 0.5,0.",
    ),
    (
        "roughplastic:alpha=0,2,nonlinear=true",
        "alpha must be a number with a point, such as 0.2, got 0,2\n",
    ),
    ("roughplastic:alpha=a,b", "alpha must be a value without commas, got a,b\n"),
    ("roughconductor:material=gold", "got 'gold'; gold is Au\n"),
    ("conductor:material=Agg", "; did you mean Ag?\n"),
    ("diffuse:rho", "got 'diffuse:rho'"),
    ("diffuse:reflectance=.5,reflectance=.6", "reflectance must be given once, got"),
    ("roughconductor:alpha=nan", "alpha must be a finite number, got nan\n"),
    ("dielectric:int_ior=-Inf", "int_ior must be a finite number, got -Inf\n"),
    ("point", "specimen must be a BSDF"),
    ("missing.xml", "there is no file missing.xml"),
    ("none.png", "there is no file none.png\n"),
    ("'no word'", "no file no word; a BSDF in one word is"),
    (
        "goniometric:filename=none.npz",
        "goniometric.filename: there is no file none.npz\n",
    ),
]

# And of whole lines.
BAD_LINES = [
    ("", "COMMAND"),
    ("fly", "'fly'"),
    ("mesure diffuse", "); did you mean measure?\n"),
    ("measure", "SPECIMEN"),
    ("measure diffuse", "--theta-i 45"),
    ("measure diffuse --theta-i abc", "--theta-i must be a number"),
    ("measure diffuse --theta-i 90", "[0, 90), got 90"),
    ("measure diffuse --theta-i -1", "[0, 90), got -1"),
    ("measure diffuse --theta-i -1e-3", "[0, 90), got -0.001"),
    ("measure diffuse --theta-i nan", "[0, 90), got nan"),
    ("measure diffuse --angle 3", ": --angle; did you mean --theta-i?"),
    ("measure diffuse --theta=3", ": --theta; did you mean --theta-i?"),
    ("measure diffuse --theta-i 0 --workers 0", "workers must be at least 1, got 0"),
    ("plan --spp=30", "unrecognized arguments: --spp=30\n"),
    ("plan --alpha 0.3", "unrecognized arguments: --alpha"),
    ("plan --pitch 2", "unrecognized arguments: --pitch\n"),
    ("plan --rel-err 2", ": rel_err must be a number in (0, 1), got 2\n"),
    ("plan --epsilon 0", ": epsilon must be a number in (0, 1), got 0\n"),
    ("plan --delta abc", "--delta must be a number such as 45 or 1e7, got 'abc'\n"),
    ("plan --collector projected:0x3", ": n_theta must be at least 1, got 0\n"),
    ("plan nowhere.npz", ": there is no file nowhere.npz\n"),
    ("plan --json a.json", "--json takes no file, for it prints"),
    ("fit a.npz diffuse --alpha 1", "; say MODEL:alpha=1\n"),
    ("fit none.csv diffuse", ": there is no file none.csv\n"),
    ("validate diffuse --level 3", "; did you mean --effort?\n"),
    ("validate diffuse --json a.json", "--json takes no file, for it prints"),
    ("validate --json a.json", "--json takes no file, for it prints"),
    ("compare diffuse none.csv", ": there is no file none.csv\n"),
    ("show --json a.json", "--json takes no file, for it prints"),
    ("show missing.npz", "missing.npz"),
    ("validate .", ". is a folder, not a file"),
    ("show run.txt", "there is no file run.txt"),
    ("plot missing.npz -o a.png", "missing.npz"),
]


@pytest.mark.parametrize(
    ("line", "words"),
    [
        *((f"measure diffuse --theta-i 45 {one}", said) for one, said in BAD_OPTIONS),
        *((f"measure {one} --theta-i 45", said) for one, said in BAD_SPECIMENS),
        *BAD_LINES,
    ],
)
def test_bad_arguments(refuse, line, words):
    assert words in refuse(*shlex.split(line))


def test_a_json_file_that_exists_is_an_argument(refuse, tmp_path):
    """A table of OpenMATERIAL may stand before ``--json``; a file to write may not."""
    table = tmp_path / "panel.json"
    words = ("show", str(table), "--json")
    assert "--json takes no file" in refuse(*words)
    table.write_text("{}")
    assert "--json takes no file" not in refuse(*words)


def test_spaces_around_parameters_are_none(run):
    """A name with a space in it is shown as such, where a dictionary has it."""
    words = ("--theta-i", "45", "--rays", "1e3")
    for specimen in ("diffuse: reflectance = 0.5", "diffuse:reflectance=0.5,"):
        code, out, _ = run("measure", specimen, *words)
        assert (code, "diffuse:reflectance=0.5" in out) == (0, True)
    with pytest.raises(gonio.SpecimenError, match="no use for ' reflectance'; did you"):
        gonio.measure({"type": "diffuse", " reflectance": 0.5}, 45)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "No document element"),
        ("<scene version='3.0.0'><shape type='rectangle'></scene>", "mismatch"),
        ("<scene version='3.0.0'><bsdf type='diffuse'/></scene>", "shape to measure"),
        ("<scene version='3.0.0'><shape type='rectangel'/></scene>", "rectangel"),
        (
            "<scene version='3.0.0'><shape type='cube'>"
            "<medium type='homogeneous' name='interior'/></shape></scene>",
            "must be behind a BSDF that transmits",
        ),
        (SCENE.replace("$alpha", "$beta"), "$beta"),
    ],
)
def test_bad_scene_files(refuse, write, content, words):
    path = write("scene.xml", content)
    assert words in refuse("measure", path, *QUICK[2:])


def test_bad_scene_parameters(refuse, write):
    path = write("scene.xml", SCENE)
    assert "$beta=1" in refuse("measure", path, *QUICK[2:], "-D", "beta=1")
    assert '"x"' in refuse("measure", path, *QUICK[2:], "-D", "alpha=x")
    assert "--theta-i 45" in refuse("measure", path)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("raise RuntimeError('first\\nsecond')", "raised RuntimeError: first second"),
        ("raise SystemExit(3)", "raised SystemExit: 3"),
        ("def (", "raised SyntaxError: invalid syntax"),
        ("import nowhere_to_be_found", "raised ModuleNotFoundError"),
        (b"\xff\x00", "raised SyntaxError"),
    ],
)
def test_bad_plugin_files(refuse, write, content, words):
    said = refuse(*QUICK, "--plugin", write("mine.py", content))
    assert words in said
    assert "(--debug shows the traceback)" in said or "SyntaxError" in words


def test_what_mitsuba_refuses_while_measuring_is_a_sentence(refuse):
    said = refuse("measure", "hair", "--theta-i", "45")
    assert "non-spectral color type" in said
    assert "another variant may do (llvm_ad_rgb, llvm_ad_spectral)" in said


def test_a_folder_says_only_which_settings_differ(run, refuse, tmp_path):
    arguments = ("measure", "diffuse", "--theta-i", "0", "-q", "--folder", tmp_path)
    assert run(*arguments, "--rays", "5000")[0] == 0
    err = refuse(*arguments, "--rays", "6000")
    assert "with rays 5000, not 6000: take another folder" in err


def test_an_aperture_goes_with_what_is_measured(run, refuse, write, tmp_path):
    record = tmp_path / "run.npz"
    assert run(*QUICK, "-q", "-o", record)[0] == 0
    table = write("table.csv", "theta_i,phi_i,theta_o,phi_o,value\n45,0,30,180,0.3\n")
    arguments = ("compare", record, table, "--aperture-half-angle", "2")
    assert "--aperture-half-angle applies to a specimen" in refuse(*arguments)


def test_a_plugin_without_to_string(run, plugins):
    code, out, _ = run("measure", "test_nameless", *QUICK[2:], *plugins)
    assert code == 0
    assert "Nameless" in out


def test_errors_in_plugins_name_the_line(refuse, plugins):
    line = 1 + PLUGINS.splitlines().index(
        '        raise ZeroDivisionError("no weight")'
    )
    message = refuse("measure", "test_raising", *QUICK[2:], *plugins)
    place = f"{plugins[1]}, line {line}, in weight: ZeroDivisionError: no weight"
    assert message == f"gonio-mi: {place} (--debug shows the traceback)\n"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("none/run.npz", "there is no folder"),
        ("file/run.npz", "there is no folder"),
        ("folder.npz", "is a folder"),
        ("run.txt", "must end in .exr or .npz"),
        ("map.png", "save one, and gonio-mi plot makes"),
        ("map.gif", "save one, and gonio-mi plot makes"),
        ("map.HTML", "save one, and gonio-mi report makes"),
        ("map.csv", "save one, and gonio-mi export makes"),
        ("run", "must end in .exr or .npz"),
    ],
)
def test_bad_outputs_are_refused_before_measuring(
    refuse, write, tmp_path, monkeypatch, name, words
):
    write("file", "")
    (tmp_path / "folder.npz").mkdir()
    before = sorted(tmp_path.iterdir())

    def measure(*_, **__):
        raise AssertionError("it has measured")

    monkeypatch.setattr("gonio_mi.campaigns.measure.measure", measure)
    good = tmp_path / "good.npz"
    assert words in refuse(*QUICK, "-o", good, tmp_path / name)
    assert sorted(tmp_path.iterdir()) == before


def test_a_file_that_cannot_be_saved_costs_no_other(run, tmp_path, monkeypatch):
    paths = tmp_path / "a.npz", tmp_path / "b.npz"
    save = files.save

    def save_all_but_one(record, path):
        if path == str(paths[0]):
            raise OSError(28, "No space left on device", path)
        save(record, path)

    monkeypatch.setattr("gonio_mi.files.storage.save", save_all_but_one)
    code, out, err = run(*QUICK, "-o", *paths)
    assert (code, err) == (1, f"gonio-mi: {paths[0]}: No space left on device\n")
    assert "dhr" in out
    assert gonio.load(paths[1]).ledger.emitted == 10**4


def test_truncated_records(refuse, write, saved):
    for record, command in zip(saved, (("show",), ("plot", "-o", "never.png"))):
        content = record.read_bytes()
        path = write(f"cut{record.suffix}", content[: len(content) // 2])
        assert f"cannot load {path}" in refuse(*command, path)


# ---------------------------------------------------------------------------- Ctrl-C


def interruptible(plugins, *settings):
    """Arguments of a measurement in eight batches with the BSDF `test_interrupted`.

    With independent rays, whose small batches share no launch.
    """
    specimen = ":".join(["test_interrupted", ",".join(settings)])
    batches = ("--batches", "8", "--sampler", "independent")
    return ("measure", specimen, *QUICK[2:], *batches, *plugins)


@pytest.fixture
def check_continued(run, plugins, tmp_path):
    """Function that compares a part, continued, with what was never interrupted."""

    def check_continued(part, *more):
        rest, whole = tmp_path / "rest.npz", tmp_path / "whole.npz"
        for arguments in (("--resume", part, "-o", rest), ("-o", whole)):
            measured = run(*interruptible(plugins), *more, "-q", *arguments)
            assert measured == (0, "", "")
        assert gonio.load(rest).tallies == gonio.load(whole).tallies

    return check_continued


@pytest.mark.usefixtures("sigint")
def test_ctrl_c_keeps_what_was_measured(run, plugins, tmp_path, check_continued):
    part = tmp_path / "part.npz"
    code, out, err = run(*interruptible(plugins, "at=4"), "-o", part)
    kept = gonio.load(part)
    rays = f"{kept.ledger.emitted:,}".replace(",", " ")
    assert code == 2
    assert 0 < kept.n_batches < 8
    assert f"{rays} of 10 000 asked for" in out
    assert err == (
        f"gonio-mi: interrupted: {part} holds {rays} rays; "
        f"--resume {part} continues it\n"
    )
    check_continued(part)


@pytest.mark.usefixtures("sigint")
def test_ctrl_c_in_a_stack(run, plugins, tmp_path, check_continued):
    part = tmp_path / "part.npz"
    angles = ("--theta-i", "0", "30", "60")
    assert run(*interruptible(plugins, "at=17"), *angles, "-q", "-o", part)[0] == 2
    assert 1 < len(gonio.load(part)) < 3
    check_continued(part, *angles)


@pytest.mark.usefixtures("sigint")
def test_ctrl_c_keeps_whole_integrals(run, plugins, tmp_path, monkeypatch):
    """Of those that share kernels all or none: here each has its own."""
    monkeypatch.setattr("gonio_mi.estimators.Quadrature.together", 1)
    part = tmp_path / "part.npz"
    angles = ("--theta-i", "0", "30", "60", "--estimator", "quadrature", "-q")
    plate = ("measure", "test_interrupted:at=24", *plugins, *angles)
    code, _, err = run(*plate, "-o", part)
    n = len(gonio.load(part))
    assert code == 2
    assert 0 < n < 3
    assert err == (
        f"gonio-mi: interrupted: {part} holds {n} of 3 incident directions\n"
    )


@pytest.mark.usefixtures("sigint")
def test_ctrl_c_while_saving_does_not_lose_the_file(
    run, tmp_path, plugins, monkeypatch
):
    path = tmp_path / "run.npz"
    write = npz.write

    def write_interrupted(record, stream):
        signal.raise_signal(signal.SIGINT)
        write(record, stream)
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(npz, "write", write_interrupted)
    assert run(*QUICK, "-q", "-o", path)[0] == 0
    assert gonio.load(path).n_batches == 16
    # the second one, and the third
    assert run(*interruptible(plugins, "at=4"), "-q", "-o", path)[0] == 2
    assert 0 < gonio.load(path).n_batches < 8


@pytest.mark.usefixtures("sigint")
def test_ctrl_c_gives_no_verdict(run, plugins, write):
    """Neither of a part of what is compared, nor of a chart with time to spare."""
    table = "theta_i,phi_i,theta_o,phi_o,value\n45,0,30,180,0.9\n"
    compared = ("compare", "test_interrupted:at=4", write("table.csv", table))
    compared += ("--aperture-half-angle", "5", "--rays", "2e7", *plugins)
    drawn = ("chart", "test_interrupted:at=40", "--theta-i", "45", *plugins)
    drawn += ("--estimator", "analog", "--sampler", "independent", "--seconds", "600")
    for arguments in (compared, drawn):
        code, out, err = run(*arguments)
        assert (code, out) == (2, ""), err
        assert err == "gonio-mi: interrupted: nothing was finished, nothing is kept\n"


@pytest.mark.usefixtures("sigint")
def test_ctrl_c_before_the_first_batch(run, plugins, tmp_path):
    path = tmp_path / "run.npz"
    code, out, err = run(*interruptible(plugins, "at=1"), "-o", path)
    assert (code, out) == (2, "")
    assert err == "gonio-mi: interrupted: nothing was finished, nothing is kept\n"
    assert not path.exists()


@pytest.mark.skipif(sys.platform == "win32", reason="Windows sends no SIGINT to others")
def test_ctrl_c_from_outside(plugins, tmp_path, check_continued):
    part = tmp_path / "part.npz"
    with start(
        *interruptible(plugins, "at=4", "wait=true"), "-q", "-o", part
    ) as process:
        assert process.stdout.readline() == "waiting\n"
        process.send_signal(signal.SIGINT)
        out, err = process.communicate()
    assert (process.returncode, out) == (2, "")
    assert err.startswith(f"gonio-mi: interrupted: {part} holds ")
    assert 0 < gonio.load(part).n_batches < 8
    check_continued(part)


STARTING = """
import signal, sys
from importlib.abc import MetaPathFinder
signal.signal(signal.SIGINT, signal.default_int_handler)
class Pressed(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            signal.raise_signal(signal.SIGINT)
sys.meta_path.insert(0, Pressed())
sys.argv = [{program!r}, "measure", "diffuse", "--rays", "10"]
from gonio_mi.cli import main
sys.exit(main())
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such exit codes")
@pytest.mark.parametrize("module", ["drjit", "mitsuba", "numpy", "gonio_mi.results"])
def test_ctrl_c_while_starting_is_a_line(module):
    program = STARTING.format(module=module, program="/usr/bin/gonio-mi")
    done = subprocess.run([sys.executable, "-c", program], capture_output=True)
    said = (done.returncode, done.stdout, done.stderr)
    assert said == (130, b"", b"gonio-mi: interrupted\n")


def test_twin_another_program_that_imports_this_answers_ctrl_c_itself():
    program = STARTING.format(module="mitsuba", program="/usr/bin/other")
    done = subprocess.run([sys.executable, "-c", program], capture_output=True)
    assert b"KeyboardInterrupt" in done.stderr
    assert done.returncode != 130


def test_output_that_is_not_utf_8_loses_no_numbers(write, monkeypatch):
    """What cannot be encoded is escaped: help, and the numbers of a measurement."""
    scene, out = write("sc\u00e8ne \u0451.xml", SCENE), io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(out, "ascii"))
    with pytest.raises(SystemExit):
        cli.main(["measure", "--help"])
    assert cli.main(["measure", str(scene), *QUICK[2:]]) == 0
    said = out.getvalue().decode("ascii")
    assert "dhr" in said
    assert "\\u0451" in said


def start(*arguments):
    """Start the command line in a process of its own."""
    program = "import sys; from gonio_mi.cli import main; sys.exit(main())"
    return subprocess.Popen(
        [sys.executable, "-c", program, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def test_other_settings_cannot_be_resumed(refuse, saved, tmp_path):
    path = tmp_path / "run.npz"
    assert cli.main([*QUICK, "-q", "-o", str(path)]) == 0
    said = refuse(*DIFFUSE, "--rays", "2e4", "--resume", path)
    assert "but it was made with rays=10000 instead of 20000" in said
    assert "16 batches" in refuse(*QUICK, "--batches", "64", "--resume", path)
    assert "16 batches" in refuse(*QUICK, "--batches", "8", "--resume", path)
    assert "resume must" in refuse(*QUICK, "--resume", saved[0])


# ------------------------------------------------------------------------ the numbers


def test_show_is_what_measure_shows(run, tmp_path):
    path = tmp_path / "run.npz"
    code, shown, _ = run(*QUICK, "-o", path)
    assert code == 0
    assert run("show", path) == (0, shown, "")


def test_show_json_holds_the_records_numbers(run, saved):
    code, out, err = run("show", saved[1], "--json")
    assert (code, err) == (0, "")
    numbers = json.loads(out)
    record = gonio.load(saved[1])
    for i, direction in enumerate(numbers["directions"]):
        assert direction["theta_i"] == record.theta_i[i]
        for of in ("dhr", "dht"):
            low, high = record.interval(0.95, of=of)
            (total,) = direction[of]
            assert total["value"] == getattr(record, of)[i, 0]
            assert total["std_err"] == getattr(record, f"{of}_std_err")[i, 0]
            assert (total["low"], total["high"]) == (low[i, 0], high[i, 0])
        assert direction["n_without_hit"] == np.sum(record.counts[i] == 0)
    ledger = numbers["ledger"]
    assert ledger.pop("emitted") == sum(ledger.values()) == 2 * 10**4
    assert numbers["settings"]["collector"] == "solid:6x8"


def test_measure_json_is_that_of_show(run, tmp_path):
    """Exact, of one direction and of a stack; nothing but JSON is printed."""
    path = tmp_path / "run.npz"
    for angles in (["45"], ["0", "60"]):
        measured = ("measure", "diffuse", "--theta-i", *angles, "--rays", "1e4")
        code, out, err = run(*measured, "--json", "-o", path)
        assert (code, err) == (0, "")
        assert len(json.loads(out)["directions"]) == len(angles)
        assert run("show", path, "--json") == (0, out, "")
        assert run(*measured, "--json", "-q")[0] == 0


def test_measure_json_is_of_one_order(refuse):
    assert "apply to one order" in refuse(*QUICK, "--json", "--order", "1,2+")


def test_worst_patches_have_the_largest_relative_error(saved):
    record = gonio.load(saved[0])
    patches = summarize(record).worst_patches
    value = np.stack([record.brdf, record.btdf], axis=1)
    std_err = np.stack([record.brdf_std_err, record.btdf_std_err], axis=1)
    # of those that reach a tenth of the mean over both hemispheres, direction by
    # direction
    weights = np.broadcast_to(
        record.subdivision.projected_solid_angles[..., None], value.shape[1:]
    )
    mean = [np.average(one, weights=weights) for one in value]
    inside = value >= 0.1 * np.reshape(mean, (-1, 1, 1, 1, 1))
    relative = std_err[inside] / value[inside]
    worst = np.sort(relative)[::-1][: len(patches)]
    np.testing.assert_array_equal([patch.rel_err for patch in patches], worst)
    for patch in patches:
        theta_o, phi_o = np.radians([patch.theta_o, patch.phi_o])
        wo = [np.sin(theta_o) * f(phi_o) for f in (np.cos, np.sin)] + [np.cos(theta_o)]
        i, j = np.unravel_index(record.subdivision.patch(wo), record.subdivision.shape)
        look = record[int(np.argmin(np.abs(record.theta_i - patch.theta_i)))]
        assert (theta_o > np.pi / 2) == (patch.of == "btdf")
        assert patch.value == getattr(look, patch.of)[i, j, 0]
        assert patch.std_err == getattr(look, f"{patch.of}_std_err")[i, j, 0]


# --------------------------------------------------------------------- other commands


@pytest.mark.parametrize("command", ["", *cli.COMMANDS])
def test_every_command_has_help_for_a_terminal(command, monkeypatch):
    """Sentences of ASCII with a full stop, no line beyond 80 columns, `--debug`."""
    monkeypatch.setenv("COLUMNS", "80")
    whole = cli.parser(command)
    if command:
        (commands,) = (one for one in whole._actions if one.nargs == "A...")
        whole = commands.choices[command]
    said = whole.format_help()
    assert said.isascii()  # no escapes where there is no UTF-8
    assert "--debug" in said
    assert max(map(len, said.splitlines())) <= 80
    examples = said.partition("\nexamples:\n")[2].partition("\n\n")[0]
    for line in examples.splitlines():
        assert "\\" not in line.removesuffix(" \\")
        assert "   " not in line.strip()  # of a line break that was lost
    for action in whole._actions:
        if action.help is not None:
            assert action.help.endswith("."), action.option_strings
            # a few begin with a value of the option
            assert re.match("[A-Z]|both,|weighted |box ", action.help)


def loaded(words):
    """Modules that the program has loaded at its end, with the exit code 0."""
    program = (
        "import sys\n"
        f"sys.argv = {['gonio-mi', *map(str, words)]!r}\n"
        "from gonio_mi.cli import main\n"
        "try: sys.exit(main())\n"
        "finally: print(*sys.modules, file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True)
    assert done.returncode == 0, done.stderr
    return set(done.stderr.decode().split())


# What takes long to import, and a short command does without.
SLOW = {"tqdm", "email", "importlib.metadata", "subprocess", "xml", "scipy", "OpenEXR"}


def test_a_command_imports_no_other():
    """Help of the program loads not even NumPy; that of a command no measurement."""
    slow = SLOW | {"gonio_mi.instrument.measure", "mitsuba", "drjit"}
    for words in ("measure --help", "show --help", "validate --help"):
        assert not loaded(words.split()) & {*slow, "gonio_mi.commands.plan"}
    for words in ("--help", "--version"):
        assert not loaded([words]) & {*slow, "gonio_mi.commands.measure", "numpy"}


def test_a_short_command_imports_what_it_needs():
    """Of Mitsuba plugins that of its sampler; twin: that of the BSDF, too."""
    modules = loaded([*QUICK])
    assert not modules & {*SLOW, "gonio_mi.plugins.integrators.goniophotometer"}
    plugins = {x for x in modules if re.match(r"gonio_mi\.plugins\.\w+\.", x)}
    assert plugins == {"gonio_mi.plugins.samplers.sobol"}
    twin = loaded(["measure", "cosinelobe", *QUICK[2:]])
    assert "gonio_mi.plugins.bsdfs.cosinelobe" in twin


@pytest.mark.parametrize(
    ("command", "output"), [("show", ""), ("report", "page.html"), ("plot", "a.png")]
)
def test_commands_that_only_read_do_not_load_mitsuba(command, output, saved, tmp_path):
    modules = loaded(
        [command, saved[0], *(["-o", tmp_path / output] if output else [])]
    )
    assert "gonio_mi.results.record" in modules
    assert not modules & {"mitsuba", "drjit"}


def test_help_and_version(capsys):
    for arguments in (["--help"], ["measure", "--help"], ["--version"]):
        with pytest.raises(SystemExit) as caught:
            cli.main(arguments)
        assert caught.value.code == 0
    assert capsys.readouterr().out.endswith(f"gonio-mi {gonio.__version__}\n")


def test_plot(run, saved, tmp_path):
    pytest.importorskip("matplotlib")
    path = tmp_path / "fig.png"
    assert run("plot", saved[0], "-o", path, "--index", "1") == (0, "", "")
    assert path.read_bytes().startswith(b"\x89PNG")


def test_plot_without_matplotlib(refuse, saved, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    said = refuse("plot", saved[0], "-o", tmp_path / "a.png")
    assert 'run pip install ".[plot]" in a checkout' in said


def test_ctrl_c_while_mitsuba_imports_is_no_bug(run, monkeypatch):
    """Its own errors wrap it there."""

    def interrupted():
        raise SystemError("error return without exception set") from KeyboardInterrupt()

    monkeypatch.setattr("gonio_mi.start_up.end", interrupted)
    code, _, err = run("doctor")
    assert code == 2
    assert err == "gonio-mi: interrupted: nothing was finished, nothing is kept\n"


@pytest.mark.parametrize(
    ("program", "before", "after"),
    [("gonio-mi", None, "1"), ("gonio-mi", "8", "8"), ("mine.py", None, None)],
)
def test_numpy_gets_no_threads_unless_asked_for(monkeypatch, program, before, after):
    """They wait busily: half the CPU time of `gonio-mi --help`."""
    name = "OPENBLAS_NUM_THREADS"
    monkeypatch.setenv(name, before or "")
    if before is None:
        monkeypatch.delenv(name)
    monkeypatch.setattr("sys.argv", [program])
    start_up.begin()
    start_up.end()
    assert os.environ.get(name) == after


@pytest.mark.parametrize("argv", [None, []])
def test_a_host_may_have_no_command_line(monkeypatch, argv):
    """As Python within another program, which has no list of words or an empty one."""
    monkeypatch.setattr(sys, "argv", argv)
    if argv is None:
        monkeypatch.delattr(sys, "argv")
    start_up.begin()
    assert start_up.needs_mitsuba()
    assert not start_up.is_program()


def test_doctor(run):
    code, out, _ = run("doctor")
    assert code == 0
    assert "able to measure" in out


# Faults whose classes Python gives to a user's errors too.
FAULTS = ["float('ours')", "len(1)", "np.zeros(2) + np.zeros(3)", "{}['rays']"]


@pytest.fixture
def report_of_bug(refuse, tmp_path, monkeypatch):
    """Function that returns what a command keeps of a bug that it meets."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))

    def report_of_bug(*arguments):
        said = refuse(*arguments)
        assert "this is a bug of gonio-mi and not an error of yours" in said
        place = Path(re.search(r"with the file (\S+\.txt)", said)[1])
        assert place.parent == tmp_path
        return place.read_text()

    return report_of_bug


@pytest.fixture
def break_measure(monkeypatch):
    """Function that puts one with a bug where our `measure` was."""

    def break_measure(fault):
        scope = {"__name__": "gonio_mi.campaigns.measure", "np": np}
        exec(f"def measure(*_, **__):\n    return {fault}", scope)
        monkeypatch.setattr("gonio_mi.campaigns.measure.measure", scope["measure"])

    return break_measure


@pytest.mark.parametrize("fault", FAULTS)
def test_bugs_of_ours_are_reported(report_of_bug, break_measure, fault):
    break_measure(fault)
    report = report_of_bug(*QUICK, "-o", "my file.npz")
    assert f"gonio-mi {gonio.__version__}, mitsuba " in report
    assert "'my file.npz'" in report
    assert "Traceback (most recent call last)" in report


def test_a_full_memory_is_no_bug(refuse, break_measure):
    """Of a GPU, or of the machine: Dr.Jit's words, where Python has a MemoryError."""
    text = "jit_malloc(): out of memory! Could not allocate 8 bytes (backend=CUDA, "
    break_measure(f"(_ for _ in ()).throw(RuntimeError({text!r}))")
    message = refuse(*QUICK)
    assert text.strip() in message
    assert "this is a bug of" not in message


def test_bugs_are_shown_where_no_file_can_be(run, break_measure, monkeypatch, tmp_path):
    break_measure(FAULTS[0])
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "absent"))
    code, out, err = run(*QUICK)
    assert (code, out) == (1, "")
    assert "Traceback (most recent call last)" in err
    assert "report it to its maintainers with what is above" in err.splitlines()[-1]


@pytest.mark.parametrize("fault", [*FAULTS, "np.linalg.inv(np.zeros(2))"])
def test_bugs_of_ours_in_plugins_are_reported(report_of_bug, monkeypatch, fault):
    """Although only the text of an error survives the loading of a plugin."""
    # imports the plugin; another surface, for what is kept is not made again
    gonio.measure({"type": "heightfield", "resolution": 32}, 0, rays=10)
    plugin = importlib.import_module("gonio_mi.plugins.shapes.heightfield")
    code = f"def gaussian_heights(*_, **__):\n    return {fault}"
    exec(compile(code, plugin.__file__, "exec"), scope := {"np": np})
    monkeypatch.setattr(plugin, "gaussian_heights", scope["gaussian_heights"])
    report = report_of_bug("measure", "heightfield:resolution=16", *QUICK[2:])
    assert "in gaussian_heights" in report


def test_bugs_of_users_plugins_are_theirs(refuse, write):
    """Also where a library raises what they have caused."""
    code = "import numpy as np\nimport mitsuba as mi\n"
    code += "mi.register_bsdf('test_bad', lambda _: np.linalg.inv(np.zeros(2)))\n"
    plugin = write("bad.py", code)
    message = refuse("measure", "test_bad", *QUICK[2:], "--plugin", plugin)
    assert "this is a bug of" not in message
    assert "LinAlgError" in message


def test_scenes_that_are_no_text_are_the_users(refuse, write):
    """Mitsuba reads them, and hands their words to our plugins."""
    word = b'<integrator type="goniophotometer"><string name="estimator" value="\xef"/>'
    scene = SCENE.encode().replace(b"<shape", word + b"</integrator><shape", 1)
    message = refuse("measure", write("scene.xml", scene), *QUICK[2:])
    assert "this is a bug of" not in message


def test_debug_shows_where_errors_of_users_arose(run):
    message = "gonio-mi: rays must be at least 1, got 0\n"
    code, out, err = run(*DIFFUSE, "--rays", "0", "--debug")
    assert (code, out) == (1, "")
    assert err.startswith("Traceback (most recent call last)")
    assert err.endswith(message)
    assert run(*DIFFUSE, "--rays", "0") == (1, "", message)


@pytest.mark.parametrize("command", ["measure", "bsdf"])
def test_short_help_leads_to_all_of_it(command, capsys, monkeypatch):
    """At 80 columns, 90 lines; the long one has every option and every sentence."""
    monkeypatch.setenv("COLUMNS", "80")
    said = {}
    for words in (["--help"], ["--help-all"], ["-h"], ["help"]):
        with pytest.raises(SystemExit) as caught:
            cli.main([*words, command] if words == ["help"] else [command, *words])
        assert caught.value.code == 0
        said[words[0]] = capsys.readouterr().out
    assert said["--help"].count("\n") <= 90
    assert said["--help"] == said["-h"] == said["help"]
    assert "--help-all" in said["--help"]
    assert "--rr-depth" not in said["--help"]
    whole = " ".join(said["--help-all"].split())
    parser = cli.parser(command)._subparsers._group_actions[0].choices[command]
    options = {*parser._option_string_actions}
    assert all(option in whole for option in options)
    for declared in declarations(MeasurementSettings).values():
        if declared.option in options:
            plain = re.sub(r"[`*]", "", declared.sentence)
            assert plain.replace("- ", "-") in whole.replace("- ", "-")
    # `measure` has all that are settings of a measurement
    named = {
        one.option for one in declarations(MeasurementSettings).values() if one.group
    }
    assert command != "measure" or named <= options


def test_the_command_line_works_in_any_thread(tmp_path, capsys):
    """Where signals cannot be answered; of a campaign too."""
    folder = ("--folder", str(tmp_path), "-q")
    with ThreadPoolExecutor(1) as thread:
        for more in ((), folder):
            assert thread.submit(cli.main, [*QUICK, *more]).result() == 0
    assert capsys.readouterr().err == ""


def test_what_the_project_says():
    """Versions that NumPy 2 loads with, tried one by one: the one before fails."""
    text = (Path(__file__).parents[2] / "pyproject.toml").read_text()
    assert '"numpy>=2"' in text
    lowest = {"scipy": "1.13", "matplotlib": "3.8.4", "xarray": "2024.6"}
    for package, first in (lowest | {"numba": "0.60"}).items():
        assert set(re.findall(f'"{package}>=([^"]+)"', text)) == {first}
    assert 'gonio-mi = "gonio_mi.cli:main"' in text


def test_plan_prints_the_papers_numbers(run):
    code, out, err = run("plan", "--json")
    assert (code, err) == (0, "")
    plan = json.loads(out)
    assert plan["chebyshev"] == 105_967
    assert plan["paper"] == 900 * 105_967


def test_a_warning_is_told_once_by_each_command(capsys, monkeypatch):
    """A campaign loads its specimen, and warns of it, for each direction."""

    def campaign(_):
        for text in ("coarse", "small", "coarse"):
            warnings.warn(text, RuntimeWarning, stacklevel=1)
        return 0

    parsed = SimpleNamespace(parse_args=lambda _: SimpleNamespace(run=campaign))
    monkeypatch.setattr(cli, "parser", lambda *_: parsed)
    for _ in range(2):
        assert cli.main(["measure"]) == 0
        told = capsys.readouterr().err.splitlines()
        assert told == [f"gonio-mi: warning: {x}" for x in ("coarse", "small")]


def test_plan_from_a_pilot(run, tmp_path):
    path = tmp_path / "pilot.npz"
    assert run(*QUICK, "-q", "-o", path)[0] == 0
    code, out, _ = run("plan", path, "--rel-err", "0.1")
    assert code == 0
    assert "a pilot of" in out


@pytest.mark.parametrize("option", [("--side", "back"), ("--phi-i", "90")])
def test_what_the_scenes_emitter_decides_is_refused(run, option):
    scene = Path(__file__).parents[2] / "scenes" / "lambertian.xml"
    code, _, err = run("measure", scene, *option)
    assert code == 1
    name = option[0].removeprefix("--").replace("-", "_")
    assert err.startswith(f"gonio-mi: {name} requires theta_i, ")

"""Verdicts in polarised variants: stock plugins, broken ones, and the frames.

GONIO_SEEDS=200 tries more of them on right plugins.
"""

import os

import mitsuba as mi
import mueller
import numpy as np
import polarised_bsdfs
import pytest
from polarised_bsdfs import MISTAKES, RIGHT

import gonio_mi as gonio
from gonio_mi import cli
from gonio_mi.collector.directions import direction
from gonio_mi.collector.stokes import (
    coherency_eigenvalues,
    implicit_axis,
    plane_axis,
    turn,
)
from gonio_mi.validation import POLARISED, validate
from gonio_mi.validation.checks import answers
from gonio_mi.validation.conditions import Condition
from gonio_mi.validation.mueller import flux_of, samples_at
from gonio_mi.validation.samples import ELEMENT_ROUNDING, samples_of, unequal

SEEDS = max(12, int(os.environ.get("GONIO_SEEDS", "1")))
VARIANT = "llvm_ad_mono_polarized"
ROUGH = {"type": "roughconductor", "eta": 0.2, "k": 3.0, "alpha": 0.3}

# Single precision, after some dozens of operations on elements up to 1.
ROUNDING = 1e-5


@pytest.fixture(scope="module")
def registered():
    """Register broken and right plugins, in both variants."""
    for variant in ("llvm_ad_mono", VARIANT):
        if variant in mi.variants():
            mi.set_variant(variant)
            polarised_bsdfs.register()


@pytest.fixture
def plugins(registered, polarised):
    """Broken and right plugins, in a polarised variant."""


def _directions(n, seed=0):
    rng = np.random.default_rng(seed)
    theta = np.radians(5 + 80 * rng.random(n))
    return direction(theta, 2 * np.pi * rng.random(n)).astype(np.float32).astype(float)


@pytest.mark.usefixtures("polarised")
def test_frames_are_those_of_mitsuba():
    k = _directions(200) * np.where(np.arange(200) % 2, 1, -1)[:, None]
    vectors = mi.Vector3f(np.ascontiguousarray(k.T, dtype=np.float32))
    axis = mi.mueller.stokes_basis(vectors)
    assert np.allclose(np.array(axis).T, implicit_axis(k), rtol=0, atol=1e-6)
    plane = plane_axis(k)
    target = mi.Vector3f(np.ascontiguousarray(plane.T, dtype=np.float32))
    theirs = np.array(mi.mueller.rotate_stokes_basis(vectors, axis, target))
    ours = turn(k, implicit_axis(k), plane)
    theirs = np.moveaxis(theirs.reshape(4, 4, -1), -1, 0)
    assert np.allclose(theirs, ours, rtol=0, atol=ROUNDING)


@pytest.mark.usefixtures("polarised")
@pytest.mark.parametrize("index", [0.2 + 3j, 1.5 + 0.4j])
def test_conductor_is_fresnel_in_all_elements(index):
    plate = {"type": "conductor", "eta": index.real, "k": index.imag}
    wi = _directions(100)
    lobes = samples_at(mi.load_dict(plate), wi, np.full((100, 3), 0.5))
    due = mueller.reflection(wi[:, 2], index)[:, None]
    assert np.allclose(flux_of(lobes).in_plane(), due, rtol=0, atol=ROUNDING)


@pytest.mark.usefixtures("polarised")
@pytest.mark.parametrize("mode", ["importance", "radiance"])
def test_dielectric_is_fresnel_in_all_elements(mode):
    index = 1.5
    plate = mi.load_dict({"type": "dielectric", "int_ior": index, "ext_ior": 1.0})
    wi = _directions(100)
    for choice, due in (
        (0.0, mueller.reflection(wi[:, 2], index)),
        (0.9999, mueller.transmission(wi[:, 2], index)),
    ):
        lobes = samples_at(plate, wi, np.full((100, 3), choice), mode=mode)
        found = flux_of(lobes).in_plane()[:, 0]
        if mode == "radiance" and choice:
            # light goes the other way, and its radiance is that of another medium
            found = np.swapaxes(found, -1, -2) * index**2
        assert np.allclose(found, due, rtol=0, atol=ROUNDING)


@pytest.mark.usefixtures("polarised")
def test_total_reflection_has_its_phase():
    index = 1.5
    plate = mi.load_dict({"type": "dielectric", "int_ior": index, "ext_ior": 1.0})
    wi = -direction(np.radians(np.linspace(43, 88, 20)), np.linspace(0, 6, 20))
    wi = wi.astype(np.float32).astype(float)
    lobes = samples_at(plate, wi, np.full((20, 3), 0.5))
    due = mueller.reflection(-wi[:, 2], 1 / index)
    # near the critical angle the phase is the square root of a difference
    assert np.allclose(flux_of(lobes).in_plane()[:, 0], due, rtol=0, atol=1e-3)


def test_eigenvalues_tell_real_surfaces():
    surface = mueller.reflection(0.6, 0.2 + 3j)
    least = coherency_eigenvalues(surface)
    assert np.allclose(least, [0, 0, 0, 1], atol=1e-12)
    assert coherency_eigenvalues(np.diag([1, 1, 1, -1]) @ surface)[0] < -0.1
    assert np.allclose(coherency_eigenvalues(np.diag([1.0, 0, 0, 0])), 0.25)


@pytest.mark.parametrize("fixture", ["mono", "polarised"])
def test_samples_have_all_elements(request, fixture):
    """Matrices beside their first elements; numbers are all there is without."""
    request.getfixturevalue(fixture)
    bsdf = mi.load_dict({"type": "conductor", "eta": 0.2, "k": 3.0})
    samples = samples_of(bsdf, Condition(40.0, 25.0), 8, (0, 1))
    weight = samples.full("weight")
    assert weight.shape == ((8, 1, 4, 4) if samples.matrices else (8, 1))
    assert np.array_equal(weight.reshape(8, 1, -1)[..., 0], samples.weight)
    assert bool(samples.matrices) == (fixture == "polarised")


def test_elements_are_judged_by_the_first_one():
    """Alike within a part of it, of either sign; the twins are one too far off."""
    due = np.tile(np.diag([0.5, -0.4, 0.0, 0.0]), (100, 1, 1, 1))
    for off, differs in ((0.4 * ELEMENT_ROUNDING, False), (ELEMENT_ROUNDING, True)):
        other = due.copy()
        other[..., 2, 1] += off
        assert unequal(due, other, 0.0).all() == differs
    assert not answers.improper(due).any()
    for element, value in (((0, 0), -0.1), ((1, 2), np.nan)):
        other = due.copy()
        other[(7, 0, *element)] = value
        assert np.flatnonzero(answers.improper(other)).tolist() == [7]


# Stock plugins: whether the property frames holds, and a word of the mistake.
STOCK = {
    "diffuse": ({"type": "diffuse"}, ""),
    "conductor": ({"type": "conductor"}, ""),
    "roughconductor": (ROUGH, ""),
    "dielectric": ({"type": "dielectric"}, ""),
    "polarizer": ({"type": "polarizer", "theta": 30.0}, ""),
    "circular": ({"type": "circular"}, ""),
    "pplastic": ({"type": "pplastic", "alpha": 0.2}, ""),
    "mask": ({"type": "mask", "opacity": 0.4, "bsdf": ROUGH}, ""),
    "blendbsdf": (
        {"type": "blendbsdf", "weight": 0.3, "a": ROUGH, "b": {"type": "pplastic"}},
        "",
    ),
    "spotted": (
        {"type": "blendbsdf", "a": ROUGH, "b": {"type": "diffuse"}}
        | {"weight": {"type": "checkerboard", "color0": 0.2, "color1": 0.7}},
        "",
    ),
    "retarder": ({"type": "retarder", "delta": 90.0}, "wi.y = 0"),
    "twosided": ({"type": "twosided", "bsdf": ROUGH}, "matrix of the front"),
}


@pytest.mark.usefixtures("polarised")
@pytest.mark.parametrize("name", STOCK)
def test_stock_plugin(name):
    specimen, mistake = STOCK[name]
    verdict = validate(specimen, effort="quick")
    assert [one.name for one in verdict.properties] == list(POLARISED)
    assert (verdict["frames"].status == "holds") == (not mistake), str(verdict)
    assert verdict.passed == (not mistake), str(verdict)
    assert mistake in (verdict.mistake or ""), str(verdict)
    assert verdict["first_element"].status == "holds", str(verdict)
    assert mi.variant() == VARIANT


def _map(normal):
    pixels = np.broadcast_to(np.float32(normal), (2, 2, 3))
    return {"type": "bitmap", "raw": True, "data": mi.TensorXf(pixels.copy())}


@pytest.mark.usefixtures("polarised")
def test_tilted_frames_are_not_turned():
    specimen = {
        "type": "normalmap",
        "normalmap": _map([0.65, 0.6, 0.93]),
        "bsdf": ROUGH,
    }
    verdict = validate(specimen, effort="quick")
    assert verdict.function == "eval"
    assert "nested" in verdict.mistake
    # the twin: a map that does not tilt
    upright = specimen | {"normalmap": _map([0.5, 0.5, 1.0])}
    assert validate(upright, effort="quick").passed


@pytest.mark.usefixtures("polarised")
def test_bumps_are_not_turned():
    height = np.add.outer(0.03 * np.arange(8), 0.05 * np.arange(8))[..., None]
    bitmap = {"type": "bitmap", "raw": True, "data": mi.TensorXf(np.float32(height))}
    specimen = {"type": "bumpmap", "map": bitmap, "scale": 4.0, "bsdf": ROUGH}
    verdict = validate(specimen, effort="quick")
    assert verdict.function == "eval"
    assert "nested" in verdict.mistake


@pytest.mark.usefixtures("polarised")
def test_verdict_is_deterministic():
    first, second = (validate(ROUGH, effort="quick") for _ in range(2))
    assert first.to_dict() == second.to_dict()


DEPOLARISES = "nothing wrong was found, but it depolarises all light"


@pytest.mark.usefixtures("polarised")
def test_it_is_told_that_all_light_leaves_unpolarised():
    assert DEPOLARISES in validate({"type": "diffuse"}, effort="quick").headline
    # the twin: half of it keeps its polarisation
    half = {"type": "blendbsdf", "weight": 0.5, "a": ROUGH, "b": {"type": "diffuse"}}
    assert DEPOLARISES not in validate(half, effort="quick").headline


@pytest.mark.usefixtures("plugins")
@pytest.mark.parametrize("name", RIGHT)
def test_right_plugin_passes_with_all_seeds(name):
    verdict = validate({"type": name}, effort="quick", strict=True)
    assert verdict.passed, str(verdict)
    assert verdict["first_element"].status == "holds", str(verdict)
    # the variant is not changed for an object
    bsdf = mi.load_dict({"type": name})
    for seed in range(1, SEEDS):
        verdict = validate(bsdf, effort="quick", seed=seed, strict=True)
        assert not verdict.failures, str(verdict)
    assert "a file, which llvm_ad_mono can load" in verdict["first_element"].statistic
    assert not verdict.passed
    assert verdict.undecided == verdict["first_element"].statistic


@pytest.mark.usefixtures("plugins")
@pytest.mark.parametrize("name", MISTAKES)
def test_mistake_is_seen_and_its_function_named(name):
    """The twins of the test above."""
    verdict = validate({"type": name}, effort="quick", strict=True)
    function, words = MISTAKES[name]
    assert not verdict.passed, str(verdict)
    assert verdict.function == function, str(verdict)
    assert words in verdict.mistake, str(verdict)


def test_a_metal_of_many_wavelengths_is_right():
    """Gold, whose matrices depend on the wavelength; all pairs have the same ones."""
    before, variant = mi.variant(), "llvm_ad_spectral_polarized"
    if variant not in mi.variants():
        pytest.skip(f"this Mitsuba has no {variant}")
    mi.set_variant(variant)
    try:
        gold = {"type": "conductor", "material": "Au"}
        verdict = validate(gold, effort="quick", strict=True)
    finally:
        mi.set_variant(before)
    assert verdict.passed, str(verdict)


@pytest.mark.usefixtures("polarised")
def test_retarder_turns_its_axis_from_one_side_only():
    """Near the normal the axis is where it says in radiance mode, else mirrored."""
    plate = mi.load_dict({"type": "retarder", "delta": 90.0, "theta": 20.0})
    wi = direction(np.radians([0.01]), 0.3)
    random = np.full((1, 3), 0.5)
    there, back = (samples_at(plate, x, random) for x in (wi, -wi))
    radiance = samples_at(plate, wi, random, mode="radiance")
    off = np.abs(flux_of(radiance).in_plane() - flux_of(back).in_plane()).max()
    assert off > 0.5
    specimen = {"type": "retarder", "delta": 90.0, "theta": 20.0}
    verdict = validate(specimen, effort="quick")
    assert verdict["adjoint"].status == "fails"
    assert np.allclose(there.flux, 1)


@pytest.mark.usefixtures("polarised")
def test_command_judges_in_the_variant_that_it_is_given(capsys):
    words = ["validate", "conductor", "--effort", "quick", "--variant", VARIANT]
    assert cli.main(words) == 0
    assert "realisable" in capsys.readouterr().out


def test_scalar_variant_is_refused_in_a_sentence():
    before = mi.variant()
    mi.set_variant("scalar_rgb")
    try:
        with pytest.raises(gonio.VariantError, match="an llvm or cuda variant"):
            validate({"type": "diffuse"})
    finally:
        mi.set_variant(before)

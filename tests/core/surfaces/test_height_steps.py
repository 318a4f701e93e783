"""Heights of few bits are warned of, and steps that are meant are not."""

import warnings

import numpy as np
import pytest

import gonio_mi as gonio
from gonio_mi.cli import main
from gonio_mi.surfaces.height_maps import HeightMap
from gonio_mi.surfaces.heights import gaussian_heights
from gonio_mi.surfaces.topography import Preparation, height_step, topography

# isort: split
import mitsuba as mi

X = np.arange(128)
RANGE = 0.3


def waves():
    """Heights from 0 to 1, such as 8 bits have no slopes for."""
    heights = gaussian_heights((128, 128), 2 / 128, (0.5, 0.35), 0.25, seed=1)
    return (heights - heights.min()) / np.ptp(heights)


def in_codes(heights, bits):
    """Heights as an image of so many bits has them."""
    return np.round(heights * (2**bits - 1))


def profile(heights):
    return np.tile(heights, (128, 1))


@pytest.mark.parametrize("bits", [5, 8, 12, 16])
def test_the_step_is_found(bits):
    """Exact: of whole numbers, with gaps, of parts of the range, stretched to more.

    Single precision: rounding, of levels that are 2^-16 apart in numbers below 1.
    """
    codes = in_codes(waves(), bits)
    assert height_step(codes) == 1
    part = np.round(codes / 2)
    assert height_step(part) == 1
    assert height_step(codes * 257) == 257
    codes[3:9, 5:7] = np.nan
    assert height_step(codes) == 1
    single = (codes / (2**bits - 1)).astype(np.float32).astype(float)
    assert height_step(single) * (2**bits - 1) == pytest.approx(1, rel=1e-3)


def test_a_stretched_histogram_has_wider_steps():
    """Exact: 100 levels over 16 bits, which are 655 or 656 apart; over 8, 2 or 3."""
    levels = np.round(99 * waves())
    stretched = np.round(levels * (65535 / 99))
    assert height_step(stretched) == pytest.approx(65535 / 99, rel=1e-3)
    assert height_step(np.round(levels * (255 / 99))) == 1


def test_what_is_meant_has_no_step():
    """Floats, planes, gratings of few levels, and flanks that are straight."""
    grooves = profile(abs(X % 64 - 32) * 1.0)
    for meant in (
        waves(),
        waves().astype(np.float32).astype(float),
        profile(np.sin(2 * np.pi * X / 64)),
        np.full((9, 9), 7.0),
        profile(X * 0.2),
        profile(X // 8 % 2 * 255.0),
        np.random.default_rng(0).integers(0, 16, (64, 64)) * 3.0,
        grooves,
        np.minimum(grooves, grooves.T),
        np.arange(40.0).reshape(2, 20),
    ):
        assert height_step(meant) is None
    # the twin: flanks whose slope is no whole number of steps are not straight
    assert height_step(profile(np.round(0.7 * abs(X % 64 - 32)))) == 1


def test_coarse_steps_are_warned_of():
    """The bound of 0.03 of the rms slope: 8 bits are beyond it, 12 and 16 are not."""

    def said(bits):
        codes = in_codes(waves(), bits)
        given = HeightMap(codes, "a.png", codes=2**bits - 1)
        return topography(given, Preparation(size=2.0, height_range=RANGE)).concerns()

    (one,) = said(8)
    assert "of the rms slope" in one
    slope = RANGE / 255 / (2 / 128)
    assert f"the heights of a.png come in steps of {RANGE / 255:.3g}, and " in one
    assert f"slopes in steps of {slope:.3g}, " in one
    assert "take 16 bits" in one
    assert said(12) == said(16) == []
    # a part of 16 bits is as few as 8
    given = HeightMap(in_codes(waves(), 8), "a.png", codes=65535)
    stretched = Preparation(size=2.0, height_range=RANGE * 257)
    assert len(topography(given, stretched).concerns()) == 1


@pytest.mark.needs("analysis")
def test_commands_tell_it_once(tmp_path, capfd):
    """An image of 8 bits in both commands and in Python; the same of 16 in none."""
    settings = ["--range", str(RANGE), "--size", "2", "--period", "box"]
    for bits, times in ((8, 1), (16, 0)):
        path = str(tmp_path / f"waves_{bits}.png")
        kind = {8: np.uint8, 16: np.uint16}[bits]
        mi.Bitmap(in_codes(waves(), bits).astype(kind)[..., None]).write(path)
        shape = {"type": "heightfield", "filename": path, "range": RANGE}
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            plate = shape | {"bsdf": {"type": "conductor"}}
            record = gonio.measure(plate, 0, rays=1000)
        # for whoever gets the record only
        assert ("slopes in steps of" in record.settings["surface"]) == bool(times)
        assert sum("come in steps" in str(one.message) for one in caught) == times
        for command in (
            ["surface", path, "--points", "1e3"],
            ["measure", path, "--theta-i", "0", "--rays", "1e3", "-q"]
            + ["-o", str(tmp_path / f"{bits}.npz")],
        ):
            assert main([*command, *settings]) == 0
            told = capfd.readouterr()
            assert (told.out + told.err).count("come in steps") == times

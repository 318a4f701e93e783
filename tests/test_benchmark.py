"""Every method of the benchmark gives the right answer; how fast is not tested."""

import mitsuba as mi
import numpy as np
import pytest
from budget import agree, count_verdict, disagree

from gonio_mi.benchmark import c_loop
from gonio_mi.benchmark.counting import SPECIMENS, rivals
from gonio_mi.benchmark.rivals import (
    GRID,
    THETA_I,
    c_rays,
    chi2_rays,
    gonio_rays,
    numba_rays,
    numpy_rays,
)
from gonio_mi.quadrature import integrate
from gonio_mi.subdivision import subdivision

RAYS = 2 * 10**6

WHITE = {
    "gonio-mi": lambda: gonio_rays(SPECIMENS["diffuse"], "analog", "independent"),
    "mi.chi2": lambda: chi2_rays(SPECIMENS["diffuse"]),
    "NumPy": numpy_rays,
    "numba": numba_rays,
    "C": c_rays,
}


def built(build):
    """Rival, or a skipped test where what it needs is absent."""
    try:
        return build()
    except (ImportError, c_loop.CompilerError) as error:
        pytest.skip(str(error))


@pytest.mark.usefixtures("mono")
@pytest.mark.parametrize("name", WHITE)
def test_white_lambertian(name):
    """All rays are counted, in proportion to the projected solid angles.

    The twin: half of the azimuth is 4 % brighter.
    """
    rival = built(WHITE[name])
    counts = rival.flux(RAYS, 1) * RAYS
    assert np.rint(counts.sum()) == RAYS
    shares = rival.grid.projected_solid_angles
    agree(count_verdict(counts, shares))
    wrong = shares.copy()
    wrong[:, 15:] *= 1.04
    disagree(count_verdict(counts, wrong))


@pytest.mark.usefixtures("mono")
def test_seeds_are_other_rays():
    """Two seeds of one method do not count the same."""
    for build in (chi2_rays, numpy_rays, numba_rays, c_rays):
        arguments = (SPECIMENS["diffuse"],) if build is chi2_rays else ()
        rival = built(lambda build=build, arguments=arguments: build(*arguments))
        assert (rival.flux(10**4, 1) != rival.flux(10**4, 2)).any()


@pytest.mark.usefixtures("mono")
def test_rough_conductor_histogram():
    """Mitsuba's histogram has the density of ``sample``; twin: of another roughness."""
    specimen = SPECIMENS["rough conductor"]
    rival = chi2_rays(specimen)
    counts = rival.flux(RAYS, 1) * RAYS

    def shares(specimen):
        bsdf = mi.load_dict(specimen)
        return integrate(bsdf, THETA_I, 0, rival.grid, rel_err=1e-5, pdf=True).flux[0]

    agree(count_verdict(counts, shares(specimen)))
    disagree(count_verdict(counts, shares(specimen | {"alpha": 0.21})))


@pytest.mark.usefixtures("mono")
def test_what_is_compared():
    """Both specimens have our samplers and estimators, and what can run here."""
    found, absent = rivals()
    assert len(found) + len(absent) == 2 * 5 + 3
    assert all(rival.grid.n_patches == GRID.n_patches for rival in found.values())


# ----------------------------------------------------------------------------- C loop


def test_c_loop_counts_are_the_same_in_any_number_of_threads():
    built(c_rays)
    # not a multiple of a chunk, nor of the lanes
    counts = c_loop.count_diffuse(3 * 10**6 + 1, 5, GRID, 1)
    assert counts.sum() == 3 * 10**6 + 1
    assert (counts == c_loop.count_diffuse(3 * 10**6 + 1, 5, GRID, 3)).all()


@pytest.mark.parametrize("collector", ["projected:1x1", "projected:500x7"])
def test_c_loop_has_any_number_of_patches(collector):
    built(c_rays)
    grid = subdivision(collector)
    counts = c_loop.count_diffuse(10**6, 2, grid, 2)
    assert counts.shape == grid.shape
    assert counts.sum() == 10**6
    if grid.n_patches > 1:
        agree(count_verdict(counts, grid.projected_solid_angles))


def test_without_a_compiler_one_line_says_so(monkeypatch):
    monkeypatch.setattr(c_loop.shutil, "which", lambda _: None)
    c_loop.library.cache_clear()
    try:
        _, absent = rivals_without_renderer(monkeypatch)
    finally:
        c_loop.library.cache_clear()
    assert "the C loop is left out: no C compiler (cc, gcc, clang) was found" in absent


def rivals_without_renderer(monkeypatch):
    monkeypatch.setattr("gonio_mi.benchmark.counting.SPECIMENS", {})
    return rivals()


def test_a_compiler_that_fails_is_named(monkeypatch):
    monkeypatch.setattr(c_loop, "FLAGS", ("-no-such-flag",))
    if not any(map(c_loop.shutil.which, c_loop.COMPILERS)):
        pytest.skip("no C compiler")
    with pytest.raises(c_loop.CompilerError, match="cannot build the C loop"):
        c_loop.library.__wrapped__()

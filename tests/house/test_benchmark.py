"""Every method of the benchmark gives the right answer; how fast is not tested."""

import itertools
import re
import subprocess
import time
from dataclasses import replace

import budget
import mitsuba as mi
import numpy as np
import pytest
from benchmark import (
    c_loop,
    commands,
    diffuse_facets,
    groove,
    renderers,
    round_trips,
    turbid_layer,
)
from benchmark.baselines import (
    PATCHES,
    THETA_I,
    Baseline,
    c_rays,
    chi2_rays,
    gonio_rays,
    numba_rays,
    numpy_rays,
    without_renderer,
)
from benchmark.batch_designs import crossing
from benchmark.counting import SPECIMENS, baselines
from benchmark.equal_error import error, klems_groove_flux, search
from benchmark.tolerances import ANGLES_OF_AZIMUTHS, AZIMUTHS, _fewest
from budget import agree, count_verdict, disagree, normal_scores, scores, verdict
from sampled_material import SamplingDensity
from scipy import stats

import gonio_mi as gonio
from gonio_mi.collector import subdivision
from gonio_mi.collector.directions import direction
from gonio_mi.quadrature import integrate

RAYS = 2 * 10**6

WHITE = {
    "gonio-mi": lambda: gonio_rays(SPECIMENS["diffuse"], "analog", "independent"),
    "mi.chi2": lambda: chi2_rays(SPECIMENS["diffuse"]),
    "NumPy": numpy_rays,
    "numba": numba_rays,
    "C": c_rays,
}


def built(build):
    """Baseline, or a skipped test where what it needs is absent."""
    try:
        return build()
    except (ImportError, c_loop.CompilerError) as error:
        pytest.skip(str(error))


@pytest.mark.parametrize("name", WHITE)
def test_white_lambertian(name):
    """Rays are counted in proportion to the projected solid angles, and all of them.

    The twin: half of the azimuth is 4 % brighter.
    """
    baseline = built(WHITE[name])
    counts = baseline.flux(RAYS, 1) * RAYS
    if name in ("NumPy", "numba", "C"):
        # Mitsuba's diffuse rejects a few rays in ten million, on the horizon
        assert np.rint(counts.sum()) == RAYS
    shares = baseline.subdivision.projected_solid_angles
    agree(count_verdict(counts, shares))
    wrong = shares.copy()
    wrong[:, 15:] *= 1.04
    disagree(count_verdict(counts, wrong))


def test_seeds_are_other_rays():
    """Two seeds of one method do not count the same."""
    for build in (chi2_rays, numpy_rays, numba_rays, c_rays):
        arguments = (SPECIMENS["diffuse"],) if build is chi2_rays else ()
        baseline = built(lambda build=build, arguments=arguments: build(*arguments))
        assert (baseline.flux(10**4, 1) != baseline.flux(10**4, 2)).any()


def test_rough_conductor_histogram():
    """Mitsuba's histogram has the density of ``sample``; twin: of another roughness."""
    specimen = SPECIMENS["rough conductor"]
    baseline = chi2_rays(specimen)
    counts = baseline.flux(RAYS, 1) * RAYS

    def shares(specimen):
        density = SamplingDensity(mi.load_dict(specimen))
        found = integrate(density, THETA_I, 0, baseline.subdivision, integral_err=1e-5)
        return found.flux[0]

    agree(count_verdict(counts, shares(specimen)))
    disagree(count_verdict(counts, shares(specimen | {"alpha": 0.21})))


def test_what_is_compared():
    """Both specimens have our samplers and estimators, and what can run here."""
    found, absent = baselines()
    assert len(found) + len(absent) == 2 * 5 + 3
    assert all(
        baseline.subdivision.n_patches == PATCHES.n_patches
        for baseline in found.values()
    )


# ----------------------------------------------------------------------------- C loop


def test_c_loop_counts_are_the_same_in_any_number_of_threads():
    built(c_rays)
    # not a multiple of a chunk, nor of the lanes
    counts = c_loop.count_diffuse(3 * 10**6 + 1, 5, PATCHES, 1)
    assert counts.sum() == 3 * 10**6 + 1
    assert (counts == c_loop.count_diffuse(3 * 10**6 + 1, 5, PATCHES, 3)).all()


@pytest.mark.parametrize("collector", ["projected:1x1", "projected:500x7"])
def test_c_loop_has_any_number_of_patches(collector):
    built(c_rays)
    patches = subdivision(collector)
    counts = c_loop.count_diffuse(10**6, 2, patches, 2)
    assert counts.shape == patches.shape
    assert counts.sum() == 10**6
    if patches.n_patches > 1:
        agree(count_verdict(counts, patches.projected_solid_angles))


def test_without_a_compiler_one_line_says_so(monkeypatch):
    monkeypatch.setattr(c_loop.shutil, "which", lambda _: None)
    monkeypatch.setattr(c_loop, "library", c_loop.library.__wrapped__)
    _, absent = without_renderer()
    assert "the C loop is left out: no C compiler (cc, gcc, clang) was found" in absent


def test_a_compiler_that_fails_is_named(monkeypatch):
    monkeypatch.setattr(c_loop, "FLAGS", ("-no-such-flag",))
    if not any(map(c_loop.shutil.which, c_loop.COMPILERS)):
        pytest.skip("no C compiler")
    with pytest.raises(c_loop.CompilerError, match="cannot build the C loop"):
        c_loop.library.__wrapped__()


# ----------------------------------------------------------- V-groove and renderers

WI = direction(np.radians([THETA_I]), np.zeros(1))
COARSE = subdivision("projected:6x8")


def test_groove_is_reciprocal(monkeypatch):
    """Swapped directions give the same, but for an error of second order."""
    rng = np.random.default_rng(0)
    v = direction(np.arcsin(np.sqrt(rng.random(20))), 2 * np.pi * rng.random(20))
    differences = []
    for n in (25, 50):
        monkeypatch.setattr(groove, "N_PANELS", n)
        f = groove.brdf(v, v)
        differences.append(np.abs(f - f.T).max())
    assert differences[1] < differences[0] / 2**1.5


@pytest.mark.parametrize("theta_deg", [0.0, 45.0, 80.0])
def test_groove_without_absorption(monkeypatch, theta_deg):
    """All the light comes back, the better the finer the panels: second order."""
    monkeypatch.setattr(groove, "REFLECTANCE", 1.0)
    hemisphere = gonio.EqualAngle(1, 1)
    wi = direction(np.radians([theta_deg]), np.zeros(1))
    lost = []
    for n in (20, 40):
        monkeypatch.setattr(groove, "N_PANELS", n)
        points = hemisphere.points(8 * n)
        lost.append(abs(np.pi * groove.patch_means(wi, points)[0, 0] - 1))
    assert lost[1] < lost[0] / 2**1.5


def test_instrument_measures_the_groove():
    """The traced V-groove has the BRDF of its radiosity; twin: 2 % more."""
    scene = mi.load_dict({"type": "scene", **groove.walls()}, optimize=False)
    how = {"collector": COARSE, "rays": 2 * 10**5, "sampler": "independent"}
    record = gonio.measure(scene, THETA_I, **how)
    exact = groove.patch_means(WI, COARSE.points(8)).reshape(COARSE.shape)
    exact *= COARSE.projected_solid_angles
    agree(verdict(scores(record, exact)))
    disagree(verdict(scores(record, 1.02 * exact)))


def test_path_towards_directions():
    """A ray is exact for its direction; more of them in a patch are better."""
    white = renderers.path_directions(SPECIMENS["diffuse"]).flux(1, 0)
    # single precision of a product of few factors
    single = 16 * np.finfo(np.float32).eps
    np.testing.assert_allclose(white * PATCHES.n_patches, 1, rtol=single)
    conductor = SPECIMENS["rough conductor"]
    exact = integrate(mi.load_dict(conductor), THETA_I, 0, PATCHES).flux[0, ..., 0]
    baseline = renderers.path_directions(conductor)
    # midpoints: second order
    assert error(baseline, exact, 2) < error(baseline, exact, 1) / 2**1.5


def grouped(flux, rows=5, columns=5):
    """Flux of groups of patches, so that means are normal; by seed or batch."""
    return flux.reshape(-1, 30 // rows, rows, 30 // columns, columns).sum(axis=(2, 4))


def of_seeds(baseline, size):
    """Flux of 16 seeds."""
    return np.stack([baseline.flux(size, seed) for seed in range(16)])


def compared(flux, exact):
    """Verdict on the means of 16 seeds."""
    values, (target,) = grouped(flux), grouped(exact)
    t = 4 * (values.mean(axis=0) - target) / values.std(axis=0, ddof=1)
    return verdict(normal_scores(t.ravel(), 15))


@pytest.fixture
def fewer_facets(monkeypatch):
    """A quarter of them."""
    monkeypatch.setattr(diffuse_facets, "CELLS", diffuse_facets.CELLS // 2)
    monkeypatch.setattr(diffuse_facets, "SPACING", diffuse_facets.SPACING * 2)
    heights = diffuse_facets._heights.__wrapped__
    monkeypatch.setattr(diffuse_facets, "_heights", heights)


def test_path_samples_of_the_groove():
    """Means of seeds agree with the radiosity at the same points; twin: 2 % more."""
    flux = of_seeds(renderers.path_samples(groove.walls), 256)
    exact = groove.patch_means(WI, PATCHES.points(1)).reshape(PATCHES.shape)
    exact *= PATCHES.projected_solid_angles
    agree(compared(flux, exact))
    disagree(compared(flux, 1.02 * exact))


def test_path_samples_of_a_layer():
    """Mitsuba's volpath agrees with discrete ordinates; twin: as lit from the left."""
    (((_, exact), *_, (baseline, _), _),) = turbid_layer.layer_contests()[0].values()
    assert baseline.name.startswith("Mitsuba volpath")
    flux = of_seeds(baseline, 16)
    agree(compared(flux, exact))
    disagree(compared(flux, np.roll(exact, 15, axis=1)))


@pytest.mark.usefixtures("fewer_facets")
def test_path_samples_of_facets():
    """Copies of a cell about one of them are as good as a period; twin: 4 % more."""
    shapes = {"facets": diffuse_facets.facets(diffuse_facets.COPIES)}
    flux = grouped(of_seeds(renderers.path_samples(lambda: shapes), 64), 5, 10)
    how = {"estimator": "next_event", "points": PATCHES.n_patches, "rays": 2**12}
    cell = {"type": "scene", "facets": diffuse_facets.facets()}
    (tally,) = gonio.measure(cell, THETA_I, period="box", **how).tallies
    ours = grouped(tally.sums[:, 0, ..., 0] / tally.incident[:, None], 5, 10)

    def judged(factor):
        variance = factor**2 * flux.var(axis=0, ddof=1) + ours.var(axis=0, ddof=1)
        differences = (factor * flux - ours).mean(axis=0)
        # few errors in common
        z = normal_scores((differences / np.sqrt(variance / 16)).ravel(), 30)
        worst = z.size * 2 * stats.norm.sf(np.abs(z).max())
        return budget.Verdict({"worst": min(1.0, worst)}, z.size)

    agree(judged(1))
    disagree(judged(1.04))


@pytest.mark.usefixtures("fewer_facets")
def test_radiance_of_facets():
    """More samples come nearer to our reflectance; twin: not to that of a plate."""
    baseline = built(diffuse_facets.facets_of_radiance)
    few, many = (baseline.flux(samples, 0).sum() for samples in (2, 8))
    how = {"divergence": diffuse_facets.FIRST_KLEMS, "collector": renderers.KLEMS}
    cell = {"type": "scene", "facets": diffuse_facets.facets()}
    record = gonio.measure(cell, 0, period="box", rays=2**18, **how)
    ours, plate = record.dhr[0], diffuse_facets.REFLECTANCE
    assert record.dhr_std_err[0] < 1e-2 * (plate - ours)
    assert abs(many - ours) < abs(few - ours) / 2
    assert abs(many - plate) > abs(few - plate) / 2


def radiance(geometry):
    return built(lambda: renderers.radiance_genbsdf(geometry, groove.REFLECTANCE))


def test_radiance_of_the_plate():
    """Every incident direction gets its light back, to the six digits of the file."""
    flux = radiance(renderers.RADIANCE_PLATE).flux(4, 0)
    assert flux.shape == (145, 145, 1)
    np.testing.assert_allclose(flux.sum(axis=(1, 2)), groove.REFLECTANCE, rtol=145e-6)


def test_radiance_of_the_groove():
    """It comes nearer to the radiosity with more samples; not if lit from elsewhere."""
    baseline = radiance(renderers.RADIANCE_GROOVE)
    exact = klems_groove_flux()
    maps = {samples: baseline.flux(samples, 0) for samples in (2, 9)}
    baseline = replace(baseline, flux=lambda samples, _: maps[samples])
    few, many = (error(baseline, exact, samples) for samples in (2, 9))
    assert many < few / 2
    opposite = exact[np.r_[0, 5:9, 1:5]]
    swapped = np.concatenate([opposite, exact[9:]])
    assert error(baseline, swapped, 9) > many


# ---------------------------------------------------------------------- equal error


def law(size, order=0.5, spent=0.0):
    """Baseline whose relative error is ``size ** -order``."""

    def flux(n, seed):
        deadline = time.process_time() + n * spent
        while time.process_time() < deadline:
            pass
        sign = (-1) ** (np.indices(PATCHES.shape).sum(axis=0) + seed)
        return PATCHES.projected_solid_angles * (1 + sign * n**-order)

    return Baseline("law", flux, first=size)


def test_search_finds_the_size():
    """Within the step of three bisections of a factor of four."""
    found = search(law(7), PATCHES.projected_solid_angles, 0.01, limit=np.inf)
    assert found.scale == 1
    assert 1e4 <= found.size <= 1e4 * 4 ** (1 / 8) + 1
    assert found.error <= 0.01
    assert search(law(10**6), PATCHES.projected_solid_angles, 0.01, 1).size == 10**6


def test_search_extrapolates_what_is_too_slow():
    """By the law of the errors so far; of one error alone, as independent samples."""
    exact = PATCHES.projected_solid_angles
    slow = search(law(16, spent=0.001), exact, 0.01, limit=0.001)
    assert slow.size == 16
    # rounding: a sum over all patches, squared
    rounding = 2 * PATCHES.n_patches * np.finfo(float).eps
    assert slow.size * slow.scale == pytest.approx(1e4, rel=rounding)
    limit = 1.5 * 2**-10
    later = search(law(16, order=0.75, spent=2**-20), exact, 1e-4, limit=limit)
    # the order is a ratio of logarithms, and the size a power of it: 1e-4 is ten
    # octaves of it from the errors that tell it, so ten times the rounding
    expected = 1e-4 ** (-1 / 0.75)
    assert later.size * later.scale == pytest.approx(expected, rel=10 * rounding)


def test_crossing():
    """A power law is met where it should be; its error bar is that of the goal."""
    goal = np.array([0.9, 1.1]) * 1e5**-1.5
    found = crossing(goal, lambda n: np.full(2, float(n) ** -1.5))
    # rounding: logarithms and powers of numbers up to 2^17
    rounding = 100 * np.finfo(float).eps
    assert found.rays == pytest.approx(1e5, rel=rounding)
    relative = goal.std(ddof=1) / goal.mean() / 2**0.5
    assert found.std_err / found.rays == pytest.approx(relative / 1.5, rel=rounding)
    with pytest.raises(ValueError, match="beyond the first 16384 rays"):
        crossing(np.ones(2), lambda n: np.full(2, 1 / n))


@pytest.mark.filterwarnings("ignore:the file describes light from")
def test_commands_are_timed_as_they_are_run(monkeypatch, capsys):
    monkeypatch.setattr(commands, "IMPORTS", ())
    monkeypatch.setattr(commands, "COMMANDS", ("--help",))
    commands.main(["--repeats", "1"])
    said = capsys.readouterr().out
    (row,) = re.findall(r"--help +\| .* \| +([\d.]+) \| +([\d.]+) \|", said)
    assert min(map(float, row)) > 0
    monkeypatch.setattr(commands, "COMMANDS", ("--hepl",))
    with pytest.raises(subprocess.CalledProcessError):
        commands.main(["--repeats", "1"])


def test_round_trips_lose_what_is_stated(monkeypatch):
    """A file of the record's own patches loses nothing, but for noise.

    What another loses it says, up to what `goniometric` interpolates between incidences
    and patches: convergence, at least of first order in the patches.
    """
    monkeypatch.setattr(round_trips, "THETA_I", (0, 40))
    formats = {"a.npz": "", "a.zemax.bsdf": ""}
    metal = {"type": "roughconductor", "alpha": 0.3}
    unsaid = []
    for collector in ("projected:6x12", "projected:12x24"):
        monkeypatch.setattr(round_trips, "COLLECTOR", collector)
        own, zemax = round_trips.round_trips(metal, 2**18, formats)
        assert own[:2] == (".npz", [])
        assert zemax[0] == ".zemax.bsdf"
        for found, passes in ((own[2], agree), (zemax[2], disagree)):
            t = [one.total_variation / one.std_err for one in found]
            passes(verdict(normal_scores(t, 15)))  # of 16 batches
        unsaid.append(
            [one.total_variation - said for one, said in zip(zemax[2], zemax[1])]
        )
    coarse, fine = np.abs(unsaid).mean(axis=1)
    assert fine < coarse / 2


@pytest.mark.parametrize("needed", [100, 200, 260, 400, 700, 2000])
@pytest.mark.parametrize("slope", [0.5, 1, 2])
def test_the_smallest_right_grid_is_found(needed, slope):
    """As one finds it who looks at grid after grid; it looks at fewer of them."""
    looked_at = []

    def is_right(n_azimuths, steps):
        looked_at.append((steps, n_azimuths))
        return steps**slope * n_azimuths ** (2 - slope) >= needed

    found = _fewest(ANGLES_OF_AZIMUTHS, AZIMUTHS, is_right)
    assert found in looked_at
    looked_at, seen = [], len(looked_at)
    grids = itertools.product(ANGLES_OF_AZIMUTHS, AZIMUTHS)
    ascending = sorted(grids, key=lambda one: one[0] * one[1])
    right = (one for one in ascending if is_right(one[1], one[0]))
    assert found == next(right, ascending[-1])
    assert seen <= 9

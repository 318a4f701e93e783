"""Speed against accuracy: orders, fronts and costs, and where the numbers come from."""

import csv
import html
import importlib
import time
from dataclasses import replace
from itertools import count
from types import SimpleNamespace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from budget import agree, disagree, single

import gonio_mi as gonio
from gonio_mi import cli
from gonio_mi.analysis.charts.curves import Chart, Curve, Point, Reference
from gonio_mi.analysis.charts.figure import plot_chart, save_chart_page
from gonio_mi.results.planning import rms_expectation

# the package has functions of these names
charting = importlib.import_module("gonio_mi.analysis.charts.chart")

DIFFUSE = {"type": "diffuse", "reflectance": 0.5}
GLASS = {"type": "dielectric"}
PLASTIC = {"type": "roughplastic", "alpha": 0.2}

EPS = np.finfo(float).eps
# rounding: lines through and between logarithms of up to 17, and back by exp
LOGARITHMS = 100 * EPS


# ------------------------------------------------------------------ curves


def curve(estimator, order, seconds_per_ray, error=1.0, rays=(2**12, 2**16, 2**20)):
    """Curve of an exact power law."""
    points = [
        Point(n, seconds_per_ray * n, error * (n / rays[0]) ** -order, 0.01, np.nan)
        for n in rays
    ]
    return Curve(estimator, "sobol", tuple(points))


def synthetic(*curves, error=1e-6):
    values = np.ones((1, 3, 4, 1))
    reference = Reference(values, error, 1.0, "a formula")
    return Chart("a thing", 45.0, 0.0, "angle:3x4", curves, reference, 64.0, {})


def test_a_power_law_has_its_order():
    """By rounding: a straight line in logarithms."""
    order, std_err = curve("weighted", 0.75, 1e-8).order(12, 0)
    assert order == pytest.approx(0.75, abs=LOGARITHMS)
    assert std_err < LOGARITHMS
    bent = [*curve("weighted", 0.75, 1e-8).points]
    bent[1] = Point(bent[1].rays, 1.0, 2 * bent[1].error, 0, 0)
    order, std_err = Curve("weighted", "sobol", tuple(bent)).order(12, 0)
    assert order == pytest.approx(0.75, abs=LOGARITHMS)
    # ln 2 times sqrt(2 / 3) is left, over the root of 2 (ln 16)^2
    assert std_err == pytest.approx(np.sqrt(1 / 3) / 4, rel=LOGARITHMS)


def test_no_order_without_three_points_that_count():
    steep = curve("weighted", 0.75, 1e-8)
    assert np.isnan(steep.order(2**12, 0)).all(), "too few rays for the patches"
    assert np.isnan(steep.order(12, 0.1)).all(), "the reference is not exact enough"


def test_cost_is_interpolated_on_a_power_law():
    half = curve("weighted", 0.5, 1e-8)
    cost = half.cost(2.0**-3)
    assert cost.measured
    assert cost.rays == pytest.approx(2**18, rel=LOGARITHMS)
    assert cost.cpu_seconds == pytest.approx(1e-8 * 2**18, rel=LOGARITHMS)
    far = half.cost(2.0**-6)
    assert not far.measured
    # rounding: some ten operations
    assert far.rays == pytest.approx(2**24, rel=16 * EPS)
    assert far.cpu_seconds == pytest.approx(1e-8 * 2**24, rel=16 * EPS)
    near = half.cost(3.0)
    assert (near.rays, near.measured) == (2**12, True)


def test_a_fixed_part_of_the_time_is_not_extrapolated():
    points = tuple(
        Point(n, 1.0 + 1e-6 * n, n**-0.5, 0, 0) for n in (10**2, 10**4, 10**6)
    )
    cost = Curve("analog", "independent", points).cost(1e-4)
    # rounding: some ten operations
    assert cost.cpu_seconds == pytest.approx(101, rel=16 * EPS)
    # where nothing has grown, all of the time may be that of the rays
    flat = tuple(Point(n, 1.0, n**-0.5, 0, 0) for n in (10**2, 10**4))
    cost = Curve("analog", "independent", flat).cost(1e-3)
    assert cost.cpu_seconds == pytest.approx(100, rel=16 * EPS)


def test_the_front_holds_what_nothing_beats():
    cheap = curve("weighted", 0.5, 1e-8)
    dear = curve("analog", 0.5, 2e-8)
    fast = curve("weighted", 1.0, 1e-8, error=1.5)
    front = synthetic(dear, cheap, fast).pareto()
    every = [p for c in (dear, cheap, fast) for p in c.points]
    best = [
        p
        for p in every
        if not any(
            (q.cpu_seconds <= p.cpu_seconds and q.error < p.error)
            or (q.cpu_seconds < p.cpu_seconds and q.error <= p.error)
            for q in every
        )
    ]
    assert sorted(p.cpu_seconds for _, p in front) == sorted(
        {p.cpu_seconds for p in best}
    )
    assert all(c is not dear for c, _ in front)
    assert [c.estimator for c, _ in synthetic(dear, cheap).ranking(0.1)] == [
        "weighted",
        "analog",
    ]


@pytest.mark.parametrize(
    ("rays", "at_most"), [((2**12, 2**16), False), ((2**12,), True)]
)
def test_a_single_point_tells_no_more_than_a_limit_of_time(rays, at_most):
    """Of launches that take 1 s and rays that take 1 ns: 256 s, at most, and 1.02 s."""
    curved = curve("weighted", 0.5, 1e-8, rays=rays)
    points = tuple(replace(p, cpu_seconds=1.0 + 1e-9 * p.rays) for p in curved.points)
    method = replace(curved, points=points)
    target = 2**-4 if at_most else 2**-6
    cost = method.cost(target)
    assert cost.at_most == at_most
    assert not cost.measured
    due = 256 * (1 + 1e-9 * 2**12) if at_most else 1 + 1e-9 * 2**24
    assert cost.cpu_seconds == pytest.approx(due, rel=64 * EPS)  # some operations
    row = synthetic(method).table(target).splitlines()[-1]
    assert row.split("  ")[1].strip().startswith("below" if at_most else "about")


def test_advice_counts_independent_rays_by_theory():
    chart = synthetic(curve("weighted", 1.0, 1e-8, rays=(2**6, 2**9, 2**12)))
    # 64 / sqrt(n) is 1/8 for 2^18 rays, and the curve reaches it with 2^9
    assert chart.independent_rays(1 / 8) == 2**18
    assert "5.1e+02 rays, 1/512 of independent ones" in chart.advice(1 / 8)
    assert "extrapolated" in chart.advice(1e-3)


def test_claims_are_compared_with_errors():
    points = tuple(Point(n, 1.0, e, 0, 0.8 * e) for n, e in ((10, 0.5), (100, 0.1)))
    low = Point(1000, 1.0, 1e-6, 0, 1.0)  # where the reference decides
    method = Curve("weighted", "sobol", (*points, low))
    # rounding: a product and a quotient
    assert method.claim(1e-3) == pytest.approx(0.8, rel=2 * EPS)
    assert np.isnan(method.claim(1.0))
    assert " 0.80" in synthetic(method, error=1e-3).table(0.1)


def test_csv_holds_every_point(tmp_path):
    chart = synthetic(curve("weighted", 0.5, 1e-8), curve("analog", 0.5, 2e-8))
    chart.save_csv(tmp_path / "chart.csv")
    lines = (tmp_path / "chart.csv").read_text().splitlines()
    assert "# specimen: a thing" in lines
    rows = list(csv.DictReader(line for line in lines if line[0] != "#"))
    points = [(c, p) for c in chart.curves for p in c.points]
    assert len(rows) == len(points)
    front = [point for _, point in chart.pareto()]
    for row, (method, point) in zip(rows, points):
        assert (row["estimator"], row["sampler"]) == (method.estimator, method.sampler)
        assert float(row["error"]) == point.error
        assert float(row["cpu_seconds"]) == point.cpu_seconds
        assert int(row["rays"]) == point.rays
        assert int(row["pareto"]) == (point in front)


# ------------------------------------------------------------------ measurements


@pytest.fixture
def short(monkeypatch):
    """Levels of 2^12, 2^14 and 2^16 rays, however long they take.

    References are as long on any machine, by a clock that is looked at each 0.04 s.
    """
    monkeypatch.setattr(charting, "MAX_RAYS", 2**16)
    looks = (0.04 * n for n in count())
    clock = SimpleNamespace(
        perf_counter=lambda: next(looks), process_time=time.process_time
    )
    monkeypatch.setattr(charting, "time", clock)


def scores(of_curve, grid, repeats):
    """Scores of the squared errors of each point, of a Lambertian of 1/2."""
    for point in of_curve.points:
        p = 0.5 * grid.projected_solid_angles / np.pi
        expected, spread = rms_expectation(grid, p, point.rays)
        square = (point.error * 0.5 / np.pi) ** 2
        yield (square / expected - 1) / (spread / np.sqrt(repeats))


def test_points_are_means_over_seeds(monkeypatch):
    """Of squares; with the scatter of their mean, and no seed twice."""
    values = np.ones((1, 3, 4, 1))
    reference = Reference(2 * values, 0.0, 2.0, "a formula")
    seeds, off = [], (1.0, 2.0, 4.0)

    def measure(_, seed, **settings):
        seeds.append((seed, *settings.values()))
        return off[(len(seeds) - 1) % 3]

    monkeypatch.setattr(charting.Runs, "measure", measure)
    monkeypatch.setattr(charting, "arrays", lambda x: (x + 2 * values, 0.5 * values))
    several = charting.Runs(None, {}, 0, repeats=3)
    method = charting.Method("analog", "sobol")
    point = several.point(method, 0, reference)
    squares = np.square(off) / 4
    # rounding: some ten operations
    assert point.error == pytest.approx(np.sqrt(squares.mean()), rel=16 * EPS)
    scatter = squares.std(ddof=1) / np.sqrt(3)
    expected = scatter / (2 * point.error)  # by the derivative of the root
    assert point.error_std_err == pytest.approx(expected, rel=16 * EPS)
    assert point.claimed == pytest.approx(0.25, rel=16 * EPS)
    several.point(method, 1, reference)
    # 0 is that of the reference, and of first runs, which are not measured
    assert {0, *(seed for seed, *_ in seeds)} == set(range(7))


@pytest.mark.usefixtures("short")
def test_counted_rays_err_as_multinomial_statistics_say():
    repeats = 3
    chart = charting.chart(
        DIFFUSE, 30, estimators=["analog"], seconds=600, repeats=repeats
    )
    grid = gonio.subdivision(chart.collector)
    independent, sobol = chart.curves
    assert [c.label for c in chart.curves] == ["analog, independent", "analog, sobol"]
    assert independent.rays.tolist() == [2**12, 2**14, 2**16]
    for z in scores(independent, grid, repeats):
        agree(single(z))
    # twin: the errors of points that are more even than random ones
    *_, z = scores(sobol, grid, repeats)
    disagree(single(z))
    # (p - p^2) / w^2 with p = w / 2 pi, equal patches; relative to p / w
    p = 0.5 / grid.n_patches
    assert chart.reference.source == "quadrature to 1e-06"
    assert chart.independent == pytest.approx(np.sqrt((1 - p) / p), rel=1e-6)
    assert chart.reference.mean == pytest.approx(0.5 / np.pi, rel=1e-6)


@pytest.mark.usefixtures("short")
def test_nothing_is_compiled_while_time_is_taken(monkeypatch):
    compiled = {"timed": [], "before": []}
    run = charting.Runs.measure

    def watched(self, seed, **settings):
        dr.kernel_history_clear()
        record = run(self, seed, **settings)
        history = dr.kernel_history([dr.KernelType.JIT])
        # out of the cache in memory
        phase = compiled["timed" if seed else "before"]
        phase.extend(
            not kernel["cache_hit"] or kernel["cache_disk"] for kernel in history
        )
        return record

    monkeypatch.setattr(charting.Runs, "measure", watched)
    dr.flush_kernel_cache()
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        charting.chart(DIFFUSE, 30, samplers=["sobol"], seconds=600, repeats=2)
    assert compiled["timed"]
    assert not any(compiled["timed"])
    assert any(compiled["before"]), "twin: the watch sees what the first runs compile"


@pytest.mark.usefixtures("short")
def test_both_sides_of_glass():
    chart = charting.chart(GLASS, 30, samplers=["sobol"], seconds=4, repeats=2)
    assert chart.reference.values.shape == (2, 30, 30, 1)
    assert "rays for delta lobes" in chart.reference.source
    assert chart.n_patches == 1800
    assert chart.curves[-1].label == "quadrature, sobol"
    # all patches but two are dark; those two are on either side
    lit = np.argwhere(chart.reference.values[..., 0] > 0)
    assert sorted(lit[:, 0]) == [0, 1]


@pytest.mark.usefixtures("short")
def test_integrals_err_less_than_rays():
    how = {"samplers": ["sobol"], "estimators": ["weighted", "quadrature"]}
    chart = charting.chart(PLASTIC, 45, seconds=600, repeats=2, **how)
    sampled, integrals = chart.curves
    assert integrals.label == "quadrature"
    assert not integrals.rays.any()
    assert len(integrals.points) == len(charting.TOLERANCES)
    for point, tolerance in zip(integrals.points, charting.TOLERANCES):
        assert point.error <= tolerance
        assert point.error >= chart.reference.error, "none can be told from less"
    assert max(integrals.error) < sampled.error.min()
    assert "rays" not in chart.advice(1e-5)


@pytest.mark.usefixtures("short")
def test_geometry_is_measured_against_a_long_run():
    settings = {"trace": True, "samplers": ["sobol"], "repeats": 2}
    chart = charting.chart(PLASTIC, 45, seconds=1, **settings)
    assert chart.reference.source.endswith(" rays, weighted, sobol")
    assert "needs a single flat rectangle" in chart.reference.refused
    methods = ["analog", "weighted", "next_event"]
    assert [c.estimator for c in chart.curves] == methods
    # the same truth by a way that knows no rays
    exact = gonio.measure(PLASTIC, 45, estimator="quadrature", rel_err=1e-6)
    error = chart.reference.values - charting.arrays(exact)[0]
    rms = np.sqrt(np.mean(error**2)) / np.mean(exact.brdf)
    # of 900 patches, whose scatter is that of Student's t with 15 degrees of freedom:
    # a mean square of 15 / 13, certain to sqrt(2.55 / 900)
    square = (rms / chart.reference.error) ** 2 * 13 / 15
    z = (square - 1) / np.sqrt(2.55 / 900)
    agree(single(z))
    wrong = (2 * rms / chart.reference.error) ** 2 * 13 / 15
    disagree(single((wrong - 1) / np.sqrt(2.55 / 900)))


@pytest.mark.usefixtures("short")
def test_textures_are_run():
    """`eval` in the middle is not what the footprint sends."""
    pixels = np.array([[[0.1], [0.9]], [[0.2], [0.1]]], np.float32)
    texture = {"type": "bitmap", "bitmap": mi.Bitmap(pixels), "raw": True}
    uneven = {"type": "diffuse", "reflectance": texture | {"filter_type": "nearest"}}
    chart = charting.chart(uneven, 30, samplers=["sobol"], seconds=2, repeats=2)
    assert "the same BSDF all over the specimen" in chart.reference.refused


@pytest.mark.usefixtures("short")
def test_integrals_that_disagree_with_rays_are_not_the_truth(monkeypatch):
    right = charting.Runs.measure

    def wrong(self, seed, **settings):
        record = right(self, seed, **settings)
        if settings["estimator"] == "quadrature":
            (tally,) = record.tallies
            tally = replace(tally, sums=(tally.sums * 1.03).astype(tally.sums.dtype))
            record = replace(record, tallies=(tally,))
        return record

    monkeypatch.setattr(charting.Runs, "measure", wrong)
    chart = charting.chart(DIFFUSE, 30, samplers=["sobol"], seconds=2, repeats=2)
    assert chart.reference.refused == "eval and sample disagree"
    assert all(c.sampler for c in chart.curves)
    # exact weights of 1/2: but some rays in 1e7 leave along the horizon
    assert chart.reference.mean == pytest.approx(0.5 / np.pi, rel=1e-6)


@pytest.mark.usefixtures("short")
def test_a_wrong_reference_is_noticed(monkeypatch):
    right = charting.find_reference

    def wrong(*args):
        pilot, found, integrates = right(*args)
        values = found.values * 1.03
        found = Reference(values, found.error, found.mean, found.source)
        return pilot, found, integrates

    monkeypatch.setattr(charting, "find_reference", wrong)
    monkeypatch.setattr(charting, "MAX_RAYS", 2**20)
    settings = {"estimators": ["weighted"], "samplers": ["sobol"], "seconds": 600}
    with pytest.warns(RuntimeWarning, match="off the reference by 0.03"):
        charting.chart(DIFFUSE, 30, **settings)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"seconds": 0}, "seconds must be a positive number, got 0"),
        ({"repeats": 1}, "repeats must be at least 2, got 1"),
        ({"samplers": "sobol"}, "samplers must be a sequence of names, got 'sobol'"),
        ({"theta_i": [0, 30]}, "must be one incident direction, got 2"),
        ({"estimators": ["magic"]}, "magic"),
        ({"estimators": ["quadrature"], "trace": True}, "needs a single flat"),
    ],
)
def test_bad_settings_are_one_sentence(settings, message):
    with pytest.raises(ValueError, match=message.replace("[", r"\[")):
        charting.chart(DIFFUSE, **{"theta_i": 30, "seconds": 1, **settings})


# ------------------------------------------------------------------ picture, command


def test_picture_and_page_show_every_method_and_what_to_use(tmp_path):
    chart = synthetic(curve("weighted", 0.75, 1e-8), curve("analog", 0.5, 2e-8))
    figure = plot_chart(chart, tmp_path / "chart.png", target=0.01)
    assert (tmp_path / "chart.png").read_bytes()[:4] == b"\x89PNG"
    by_rays = figure.subfigs[0].axes[1]
    labels = by_rays.get_legend_handles_labels()[1]
    assert {"weighted, sobol", "analog, sobol"} < set(labels)
    assert "use" not in figure.get_suptitle()
    assert chart.advice(0.01) in figure.get_suptitle()
    save_chart_page(chart, tmp_path / "chart.html", target=0.02)
    for shown, target in (
        ((tmp_path / "chart.html").read_text(), 0.02),
        (chart._repr_html_(), 0.01),
    ):
        assert "<img" in shown
        assert html.escape(chart.advice(target)) in shown
        tables = [html.escape(chart.table(one)) in shown for one in (0.02, 0.01)]
        assert tables == [target == 0.02, target == 0.01]


@pytest.mark.parametrize("repeats", [2, 4])
def test_bars_know_that_seeds_are_few(repeats):
    """Student's t: 12.7 and 3.18 standard errors, where a normal law has 1.96."""
    chart = synthetic(curve("weighted", 0.25, 1e-8, error=9.0))
    chart = replace(chart, settings={"repeats": repeats})
    axes = plot_chart(chart).subfigs[0].axes[0]
    ((bars,),) = [c[2] for c in axes.containers]
    below, above = bars.get_segments()[0][:, 1]
    quantile = {2: 12.7062047, 4: 3.1824463}[repeats]
    # tables of Student's t have nine digits
    assert (above - below) / 2 == pytest.approx(0.01 * quantile, rel=1e-8)


@pytest.mark.usefixtures("short")
def test_command(tmp_path, capsys):
    outputs = [str(tmp_path / name) for name in ("chart.png", "chart.csv")]
    options = ("--theta-i", "30", "--seconds", "600", "--estimator", "weighted")
    few = ("--repeats", "2", "--target", "0.2")
    assert cli.main(["chart", "diffuse", *options, *few, "-o", *outputs]) == 0
    out = capsys.readouterr().out
    assert "use to 0.2: weighted, " in out
    assert "reference: quadrature to" in out
    rows = (tmp_path / "chart.csv").read_text().splitlines()
    assert sum(row.startswith("weighted,sobol") for row in rows) == 3
    assert (tmp_path / "chart.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["-o", "chart.txt"], "must end in .pdf or .png or .svg"),
        (["--target", "2"], "target must be a number in (0, 1), got 2"),
        (["--seconds", "soon"], "--seconds must be a number"),
        (["--sampler", "ldsampler"], "must not be ldsampler"),
        (["-D", "a=1"], "-D applies to scene files"),
    ],
)
def test_command_says_what_is_wrong(arguments, message, capsys):
    assert cli.main(["chart", "diffuse", "--theta-i", "30", *arguments]) == 1
    err = capsys.readouterr().err
    assert message in err
    assert err.count("\n") == 1

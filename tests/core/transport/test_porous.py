"""A periodic cell is the specimen: what passes its openings is transmitted, told apart.

References: closed forms of what straight rays pass, and an own tracer of threads, slats
and grids in NumPy (`blinds`).
"""

from dataclasses import replace
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from blinds import Bar, Slat, direct_share, follow, shapes
from budget import (
    agree,
    disagree,
    normal_scores,
    of_total,
    often_enough,
    single,
    verdict,
)

import gonio_mi as gonio
from gonio_mi.results.summary import summarize
from gonio_mi.results.summary_text import summary_text
from gonio_mi.specimen.loading import load_specimen

SCENES = Path(__file__).parents[3] / "scenes"

# Parts, reflectance and incident angles.
SPECIMENS = {
    "louver": ([Slat(1, 0.1, 0, 0.8, 30)], 0.5, 20, 200),
    "wide slats": ([Slat(1, 0.1, 0, 2.04, 45)], 0.6, 40, 10),
    "threads": ([Bar(0, 0, 0, 0.2)], 0.8, 55, 50),
    "grid": ([Slat(1, 0, 0, 0.5, 0), Slat(0, 0, 0, 0.4, 0)], 0.7, 40, 30),
}
# those of the scene file
CROSSED_THREADS = ([Bar(0, -0.5, -0.3, 0.3), Bar(1, -0.5, -0.9, 0.3)], 0.8, 30, 0)
BLACK = [Slat(1, 0, 0, 0.5, 0), Slat(0, 0, 0, 0.4, 10)]
ESTIMATORS = ("weighted", "analog", "next_event")
GRID = "projected:4x6"
RAYS = 50_000


def plate(width, depth, rho=0.6):
    """Thin plate of a cell of 1 x 1 with one rectangular hole in a corner."""
    bsdf = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": rho}}

    def rectangle(x, y):
        middle = [sum(x) / 2, sum(y) / 2, 0]
        half = [(x[1] - x[0]) / 2, (y[1] - y[0]) / 2, 1]
        to_world = mi.ScalarTransform4f().translate(middle).scale(half)
        return {"type": "rectangle", "to_world": to_world, "bsdf": bsdf}

    return {
        "type": "scene",
        "full": rectangle((width, 1), (0, 1)),
        "beside": rectangle((0, width), (depth, 1)),
    }


def measured(parts, rho, theta_i, phi_i, **settings):
    return gonio.measure(
        shapes(parts, rho),
        theta_i,
        phi_i,
        **({"period": (1, 1), "collector": GRID, "rays": RAYS} | settings),
    )


# ------------------------------------------------------------------------- its totals


@pytest.mark.parametrize("name", SPECIMENS)
@pytest.mark.promise("a periodic cell")
def test_direct_light_is_that_of_the_closed_form(name):
    """Counted independent rays: exact binomial."""
    parts, rho, theta_i, phi_i = SPECIMENS[name]
    how = {"sampler": "independent", "batches": 1}
    record = measured(parts, rho, theta_i, phi_i, **how)
    n, share = record.ledger.emitted, direct_share(parts, theta_i, phi_i)
    assert record.direct == record.ledger.direct / n
    spread = np.sqrt(n * share * (1 - share))
    agree(single((record.ledger.direct - n * share) / spread))
    disagree(single((record.ledger.direct - 1.03 * n * share) / spread))


@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize("name", [*SPECIMENS, "crossed threads"])
def test_totals_are_those_of_an_own_tracer(name, estimator):
    """Twin: what passes the openings is left out of the incident light."""
    parts, rho, theta_i, phi_i = given = SPECIMENS.get(name, CROSSED_THREADS)
    if name in SPECIMENS:
        record = measured(*given, estimator=estimator)
    else:
        settings = {"estimator": estimator, "rays": RAYS, "collector": GRID}
        record = gonio.measure(SCENES / "crossed_threads.xml", theta_i, **settings)
    own = follow(parts, 1.0, rho, theta_i, phi_i, 40_000)
    assert sum(record.ledger.rows.values()) == record.ledger.emitted
    assert record.ledger.missed == 0
    for value, std_err, rows in (
        (record.dhr, record.dhr_std_err, own.up),
        (record.dht, record.dht_std_err, own.down | own.direct),
    ):
        weight = own.weight * rows
        spread = np.hypot(std_err, weight.std() / np.sqrt(weight.size))
        agree(single(((value - weight.mean()) / spread).item()))
        wrong = (weight * ~own.direct).sum() / (~own.direct).sum()
        disagree(single(((value - wrong) / spread).item()))


@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize("theta_i", [0, 60])
def test_thin_screen_of_a_quarter(theta_i, estimator):
    """Closed form at any angle: a quarter passes, the rest is a grey Lambertian.

    The hole is a quarter of the square that Sobol's points fill evenly: exact.
    """
    settings = {"period": (1, 1), "rays": 2**16, "collector": GRID}
    record = gonio.measure(plate(0.5, 0.5), theta_i, estimator=estimator, **settings)
    assert record.direct == record.dht == 0.25
    assert record.ledger.direct == 2**14
    if estimator == "weighted":  # no more than the rounding of single precision
        assert abs(record.dhr - 0.45) < 2.0**-22
    else:
        agree(of_total(record, 0.45))
    assert abs(record.dhr - 0.6) > 10 * (record.dhr_std_err + 1e-6)


# ------------------------------------------------------------- where it is, and its row


@pytest.mark.parametrize("side", ["front", "back"])
@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_direct_light_is_in_the_patch_straight_on(estimator, side):
    """Exact: black slats transmit nothing else."""
    record = measured(BLACK, 0.0, 40, 70, estimator=estimator, side=side)
    d = gonio.subdivision(GRID).patch(straight_on(40, 70))
    flux = record.flux_fraction[1].ravel()
    assert flux[d] == record.direct == record.dht
    assert np.count_nonzero(flux) == 1
    assert record.dhr == 0
    assert record.counts[1].ravel()[d] == record.ledger.direct
    assert record.ledger.absorbed + record.ledger.direct == record.ledger.emitted
    assert record.ledger.transmitted == 0


def straight_on(theta_i, phi_i):
    """Direction straight on, mirrored into the upper hemisphere."""
    theta, phi = np.radians([theta_i, phi_i + 180])
    sine = np.sin(theta)
    return np.array([[sine * np.cos(phi), sine * np.sin(phi), np.cos(theta)]])


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_orders_and_direct_light_add_up(estimator):
    """Exact: the sums of orders 0, 1 and 2+ are those of all rays."""
    total, *by_order = (
        measured(*SPECIMENS["grid"], order=order, estimator=estimator, rays=10_000)
        for order in ("all", 0, 1, "2+")
    )
    (tally,) = total.tallies
    tallies = [record.tallies[0] for record in by_order]
    for name in ("sums", "hits", "direct"):
        assert np.array_equal(
            sum(getattr(t, name) for t in tallies), getattr(tally, name)
        )
    assert np.array_equal(tallies[0].sums[:, 1].sum(axis=(1, 2)), tally.direct)
    assert by_order[0].direct == by_order[0].dht == total.direct > 0
    assert by_order[1].ledger.other_order > 0 == total.ledger.other_order
    assert all(record.ledger.emitted == 10_000 for record in by_order)
    assert [record.direct[0] for record in by_order[1:]] == [0, 0]
    assert all(np.array_equal(t.incident, tally.incident) for t in tallies)


def test_upper_hemisphere_alone():
    """Exact: the ledger knows of direct light where no patch is there to receive it."""
    both, upper = (
        measured(*SPECIMENS["grid"], hemispheres=hemispheres)
        for hemispheres in ("both", "upper")
    )
    assert upper.dht is None
    assert upper.ledger == both.ledger
    assert upper.direct == both.direct > 0
    assert upper.dhr == both.dhr


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_coloured_emitter_of_finite_area(estimator, rgb):  # noqa: ARG001
    """Exact: through black slats all that arrives is direct, channel by channel."""
    emitter = {
        "type": "disk",
        "to_world": mi.ScalarTransform4f().translate([0, 0, 6]).rotate([1, 0, 0], 180),
        "emitter": {
            "type": "area",
            "radiance": {"type": "rgb", "value": [3.0, 1.0, 0.5]},
        },
    }
    record = measured(BLACK, 0.0, 30, 10, emitter=emitter, estimator=estimator)
    (tally,) = record.tallies
    assert np.array_equal(tally.sums[:, 1].sum(axis=(1, 2)), tally.direct)
    assert np.all(tally.direct.sum(axis=0) > 0)
    assert np.allclose(record.direct, record.dht, rtol=0, atol=0)
    assert record.ledger.direct == record.counts[1].sum()
    assert np.count_nonzero(record.counts[1]) > 1


def test_more_wavelengths_than_a_ray_carries(spectral):  # noqa: ARG001
    """Each pass counts its own direct light: the ledger holds that of both."""
    nm = [400, 450, 500, 550, 600, 650]
    record = measured(*SPECIMENS["grid"], wavelengths=nm, rays=20_000)
    assert record.settings["passes"] == 2
    assert len(set(record.direct[:4])) == len(set(record.direct[4:])) == 1
    passed = 20_000 * (record.direct[0] + record.direct[4])
    assert record.ledger.direct == round(passed)
    low, high = record.interval(of="direct")
    share = direct_share(SPECIMENS["grid"][0], *SPECIMENS["grid"][2:])
    assert np.all((low < record.direct) & (record.direct < high))
    agree(of_total(record, share, "direct"))
    disagree(of_total(record, 1.05 * share, "direct"))


def test_direct_light_of_merged_and_grown_batches():
    """Exact: sums of two seeds, and of rounds until an error is met."""
    one, two = (measured(*SPECIMENS["grid"], seed=seed) for seed in (1, 2))
    merged = one.merge(two)
    assert merged.ledger.direct == one.ledger.direct + two.ledger.direct
    parts = [*one.tallies[0].direct, *two.tallies[0].direct]
    assert np.array_equal(merged.tallies[0].direct, parts)
    grown = measured(*SPECIMENS["grid"], rays=None, rel_err=0.02)
    assert grown.ledger.emitted > 2**18
    assert grown.direct == grown.ledger.direct / grown.ledger.emitted


def test_direct_light_above_the_horizon_of_a_near_collector():
    """Exact: it is no reflection, so it is in no patch and not hidden."""
    record = measured([Slat(0, 0, 0, 0.4, 10)], 0.0, 85, 0, collector_radius=0.8)
    ledger = record.ledger
    assert record.dhr == 0
    assert ledger.sideways + ledger.direct + ledger.absorbed == ledger.emitted
    assert ledger.sideways > 0


# ------------------------------------------------------------------------- reciprocity


def test_porous_specimen_is_reciprocal():
    """f(a, b) and f(b, a) of a louver, through which more or less light passes.

    A detector is a cone of one degree about the other incident direction; the mean
    over it differs from the value in its middle by the square of 0.017, times a
    curvature that both directions nearly share. Twin: light that passes is left out of
    what is incident.
    """
    parts, rho = [Slat(1, 0, 0, 0.7, 25), Slat(0, 0, -1, 0.3, -40)], 0.8
    pairs = [(20, 60, 0, 180), (70, 30, 120, 40), (10, 75, 300, 100), (50, 60, 90, 350)]
    settings = {"batches": 64, "rays": 2**15, "estimator": "next_event"}

    def aimed(theta_i, phi_i, theta_o, phi_o):
        """BRDF and its standard error, and what passes."""
        aperture = f"apertures:1@{theta_o}/{phi_o}"
        record = measured(parts, rho, theta_i, phi_i, collector=aperture, **settings)
        return record.brdf.item(0), record.brdf_std_err.item(0), record.direct[0]

    scores, twins = [], []
    for theta_a, theta_b, phi_a, phi_b in pairs:
        f, df, passed = aimed(theta_a, phi_a, theta_b, phi_b)
        g, dg, other = aimed(theta_b, phi_b, theta_a, phi_a)
        scores.append((f - g) / np.hypot(df, dg))
        f, df, g, dg = (
            f / (1 - passed),
            df / (1 - passed),
            g / (1 - other),
            dg / (1 - other),
        )
        twins.append((f - g) / np.hypot(df, dg))
    agree(verdict(normal_scores(np.array(scores), 63)))
    disagree(verdict(normal_scores(np.array(twins), 63)))


# ---------------------------------------------------------------------------- coverage


@pytest.mark.parametrize("sampler", ["sobol", "independent"])
@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_intervals_cover_what_is_known(estimator, sampler):
    """At least 95 of 100 intervals hold the truth of a thin screen, within chance.

    Twin: the truth with the light that passes left out.
    """
    open_area, rho, runs = 0.45 * 0.55, 0.6, 20
    patches = gonio.subdivision("projected:2x4")
    spread = rho * (1 - open_area) / np.pi
    through = patches.patch(straight_on(30, 20))[0]
    straight = open_area / patches.projected_solid_angles.ravel()[through]
    truths = {"dhr": rho * (1 - open_area), "dht": open_area, "direct": open_area}
    truths |= {"brdf": spread, "btdf": straight}
    covers = {of: [] for of in (*truths, "twin")}
    specimen = load_specimen(plate(0.45, 0.55, rho))
    settings = {"estimator": estimator, "sampler": sampler, "rays": 4000}
    settings |= {"collector": patches, "period": (1, 1)}
    if sampler == "independent":
        settings["batches"] = 4  # each of which is a launch of its own
    for seed in range(runs):
        record = gonio.measure(specimen, 30, 20, seed=seed, **settings)
        for of, truth in truths.items():
            low, high = (limit.ravel() for limit in record.interval(of=of))
            if of == "btdf":
                low, high = low[through], high[through]
            covers[of].append(np.mean((low <= truth) & (truth <= high)))
            if of == "dhr":
                covers["twin"].append(np.mean((low <= rho) & (rho <= high)))
    disagree(often_enough(covers.pop("twin")))
    for covered in covers.values():
        agree(often_enough(covered))


# -------------------------------------------------------------- what is said and kept


def said(record):
    return " ".join(summarize(record).warnings)


def test_show_tells_direct_light_apart_and_files_keep_it(tmp_path):
    record = measured(*SPECIMENS["grid"])
    numbers = summarize(record)
    (direct,) = numbers.directions[0].direct
    assert direct.value == record.direct
    assert direct.low < record.direct < direct.high
    text = summary_text(numbers)
    lines = [line.split() for line in text.splitlines()]
    assert any(line[2:3] == ["direct"] for line in lines)
    assert any(line[:1] == ["direct"] for line in lines)
    assert "period 1.0,1.0, order all" in " ".join(text.split())
    assert "passed openings of the periodic cell" in said(record)
    for name in ("grid.npz", "grid.exr"):
        record.save(tmp_path / name)
        again = gonio.load(tmp_path / name)
        assert again == record
        assert again.direct == record.direct > 0
    assert record.tallies[0] != replace(record.tallies[0], direct=None)
    finite = measured(*SPECIMENS["grid"], period="none")
    assert summarize(finite).directions[0].direct is None
    assert finite.direct == 0
    assert finite.ledger.missed > 0
    assert "give a period" in said(finite)
    assert "smaller footprint" not in said(finite)
    disk = measured(*SPECIMENS["grid"], period="none", footprint=2.0)
    assert "smaller footprint" in said(disk)


def test_plot_says_order_and_period():
    plot = pytest.importorskip("gonio_mi.plots").plot
    record = measured(*SPECIMENS["grid"], order="2+")
    title = plot(record)._suptitle.get_text()
    assert "period\N{NO-BREAK SPACE}1.0,1.0" in title
    assert "order\N{NO-BREAK SPACE}2+" in title
    title = plot(measured(*SPECIMENS["grid"]))._suptitle.get_text()
    assert "direct\N{NO-BREAK SPACE}0." in title


@pytest.mark.needs("materials")
@pytest.mark.needs("exchange")
def test_exports_are_not_silent(tmp_path):
    from gonio_mi.exchange.exports import export

    screen = plate(0.5, 0.5)
    settings = {"rays": 20_000, "collector": GRID}
    missed = gonio.measure(screen, [0, 40], **settings, footprint=0.9)
    with pytest.warns(RuntimeWarning, match="missed the specimen, and the file"):
        export(missed, tmp_path / "screen.csv")
    porous = gonio.measure(screen, [0, 50], **settings, period="box")
    with pytest.warns(RuntimeWarning) as told:
        export(porous, tmp_path / "screen.xml", "klems-quarter")
    messages = [str(one.message) for one in told]
    assert len(messages) == 2
    assert "describes light from the front only, and the back reflects" in messages[1]
    assert "has light from theta_i 0, 50 only" in messages[0]

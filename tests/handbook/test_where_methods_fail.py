"""The failures of the notebook: the naive method is wrong, and the instrument is not.

The notebook's cells are run as they stand; what they found is judged here.
"""

import json
import os
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from budget import agree, disagree, normal_scores, single

import gonio_mi as gonio

pytest.importorskip("IPython")
matplotlib = pytest.importorskip("matplotlib")

NOTEBOOK = Path(__file__).parents[2] / "notebooks" / "where_methods_fail.ipynb"

# Degrees of freedom of the instrument's standard error, where it is not a known one.
BATCHES = {"ldsampler": 31, "fixed quadrature": 31}
STATISTICAL = (
    "PCG32 streams",
    "ldsampler",
    "fixed quadrature",
    "theta from acos(z)",
    "1.96 standard errors",
    "stopping at once",
)
EXACT = (
    "float32 sums",
    "beam sampled across",
    "rounding at borders",
    "BSDFContext()",
)


@pytest.fixture(scope="module")
def names():
    """Everything that the notebook's cells have defined."""
    matplotlib.use("Agg")
    before, rays = mi.variant(), os.environ.pop("GONIO_RAYS", None)
    scope = {}
    try:
        for cell in json.loads(NOTEBOOK.read_text())["cells"]:
            if cell["cell_type"] == "code":
                exec("".join(cell["source"]), scope)
        yield scope
    finally:
        matplotlib.pyplot.close("all")
        if rays is not None:
            os.environ["GONIO_RAYS"] = rays
        if before:
            mi.set_variant(before)


def score(name, value, std_err, truth):
    return normal_scores((value - truth) / std_err, BATCHES.get(name, np.inf))


def test_all_are_judged(names):
    assert set(names["found"]) == {*STATISTICAL, *EXACT}


@pytest.mark.parametrize("name", STATISTICAL)
def test_number_with_a_standard_error(names, name):
    """The naive one shows what the verdict on the instrument's can see."""
    row = names["found"][name]
    agree(single(score(name, *row["instrument"], row["truth"])))
    value, std_err = row["naive"]
    if std_err == 0:  # a fixed grid has none
        std_err = row["instrument"][1]
    disagree(single((value - row["truth"]) / std_err))


@pytest.mark.parametrize("name", EXACT)
def test_exact_number(names, name):
    row = names["found"][name]
    assert row["instrument"] == (row["truth"], 0)
    assert row["naive"][0] < 0.9 * row["truth"]


def test_integer_tallies_go_on(names):
    """Exactly: 2^30 rays, of which float32 sums keep 2^24."""
    assert names["many"].hits.sum() == 2**30
    assert names["many"].ledger.emitted == 2**30
    assert names["received"][0] == 2**24


def test_padded_points_converge_to_something_else(names):
    """By order: the error of 16 times the rays is the same, and joint points' falls."""
    padded, even = names["rms"]["padded"], names["rms"]["even"]
    # an order below a tenth of that of independent rays, which is 1/2
    assert padded[-1] > padded[0] * 16 ** (-0.1 / 2)
    assert even[-1] < even[0] / 4, "as fast as independent rays at least"
    with pytest.raises(gonio.SpecimenError, match="must not be ldsampler"):
        gonio.measure({"type": "diffuse"}, 45, rays=100, sampler="ldsampler")


@pytest.mark.parametrize("theta_i", [90, 90.001])
def test_the_horizon_is_refused(names, theta_i):
    with pytest.raises(ValueError, match=r"theta_i must be an angle in degrees in \[0"):
        gonio.measure(names["LAMBERTIAN"], theta_i)


@pytest.mark.parametrize("trace", [False, True])
@pytest.mark.parametrize("theta_i", [89, 89.9, 89.99])
def test_grazing_light_is_not_lost(names, theta_i, trace):
    """By rounding: weights of 1/2, each rounded to a fixed-point fraction of 2^-24.

    Of a million rays some leave along the horizon itself, which the ledger counts.
    """
    record = gonio.measure(names["LAMBERTIAN"], theta_i, rays=2**12, trace=trace)
    assert record.ledger.missed == 0
    received = record.ledger.reflected / record.ledger.emitted
    assert abs(record.dhr[0] - 0.5 * received) <= 2.0**-24
    assert record.ledger.reflected >= record.ledger.emitted - 1


def test_delta_lobes_are_seen_by_rays_alone(names):
    assert names["on_a_grid"](mi.load_dict(names["MIRROR"]), 45) == 0
    assert gonio.measure(names["MIRROR"], 45, rays=2**10).dhr[0] == 1


def test_the_error_of_one_batch_is_unknown(names):
    assert np.isnan(names["single"].brdf_std_err).all()
    low, high = names["single"].interval(0.95)
    assert np.isnan([low, high]).all()


def test_the_table_has_a_guard_for_each(names):
    table = names["lines"][2:]
    assert len(table) == len(names["found"])
    assert all(line.count("|") == 8 and "|  |" not in line for line in table)

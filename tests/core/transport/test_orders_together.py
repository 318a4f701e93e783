"""Scattering orders traced together are, to the bit, those measured one by one."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from specimens import GREY

import gonio_mi as gonio
from gonio_mi.cli import main
from gonio_mi.errors import SettingError
from gonio_mi.results.tally import Fate, Ledger
from gonio_mi.settings.values import Order
from gonio_mi.transport.exits import OrderClasses

SCENES = Path(__file__).parents[3] / "scenes"
ORDERS = (0, 1, "2+", 6, "all")
HILLS = {"type": "heightfield", "alpha": 0.8, "resolution": 16, "bsdf": GREY}
SPECIMENS = {
    "hills": (HILLS, {"period": "box", "rr_depth": 1, "max_depth": 4}),
    "edges": (HILLS, {"footprint": "full", "estimator": "analog"}),
    "blind": (SCENES / "venetian_blind.xml", {"hemispheres": "upper"}),
    "medium": (SCENES / "milk_glass.xml", {}),
    "plane": ({"type": "roughdielectric", "alpha": 0.3}, {"divergence": 3}),
}


def parsed(orders=ORDERS):
    return {str(Order.parse("order", one)): one for one in orders}


@pytest.mark.parametrize("name", SPECIMENS)
def test_together_and_one_by_one_are_the_same(name):
    """Exact: sums, counts and ledger of each order, also of those that overlap."""
    specimen, settings = SPECIMENS[name]
    settings = {"rays": 4000, "collector": "projected:3x4", "batches": 4} | settings
    together = gonio.measure_orders(specimen, 50, 20, orders=ORDERS, **settings)
    assert list(together) == list(parsed())
    for text, order in parsed().items():
        alone = gonio.measure(specimen, 50, 20, order=order, **settings)
        assert together[text].tallies == alone.tallies
        said = dict(together[text].settings), dict(alone.settings)
        assert [one.pop("created") is not None for one in said] == [True, True]
        assert said[0] == said[1]
    counts = [together[text].counts.sum() for text in ("0", "1", "2+")]
    assert sum(counts) == together["all"].counts.sum()
    aside = [together[text].ledger.over_the_edge for text in ("0", "1", "2+", "all")]
    assert sum(aside[:3]) == aside[3]
    assert (aside[3] > 0) == (name == "edges")
    if name != "plane":
        assert min(counts[1:]) > 0


def test_deposits_are_measured_one_by_one():
    """Exact: a dictionary of what `measure` gives."""
    settings = {"collector": "projected:2x2", "estimator": "next_event", "rays": 500}
    found = gonio.measure_orders(HILLS, 50, orders=(1, "2+"), **settings)
    assert list(found) == ["1", "2+"]
    alone = gonio.measure(HILLS, 50, order="2+", **settings)
    assert found["2+"].tallies == alone.tallies


def test_rows_of_the_ledger_by_classes():
    """Exact, by hand: what an order that is traced alone would have lost, and where.

    Classes of 0, 1, 2 and more events; one patch above and one below.
    """
    orders = [Order.parse("order", text) for text in ("1", "2")]
    classes = OrderClasses(orders)
    assert len(classes) == 4
    rays = np.zeros((4, 1, 2 + len(Fate)), int)
    # straight through, so in its patch too; past; from one, two and three events
    rays[0, 0, [1, 2 + Fate.DIRECT, 2 + Fate.MISSED]] = 5, 5, 7
    rays[1, 0, [0, 1, 2 + Fate.ABSORBED, 2 + Fate.SIDEWAYS]] = 10, 20, 30, 40
    rays[1, 0, 2 + Fate.TRUNCATED] = 50
    rays[2, 0, [0, 2 + Fate.ABSORBED, 2 + Fate.TRUNCATED]] = 100, 300, 500
    rays[3, 0, [0, 2 + Fate.INVALID]] = 1000, 4000
    # of those in patches
    rays[1:, 0, 2 + Fate.OVER_THE_EDGE] = 3, 2, 1
    kept = classes.rays(orders[0], rays, (2, 1, 1))[0]
    assert kept[:2].tolist() == [10, 20]
    other = 5 + 50 + 100 + 300 + 500 + 1000 + 4000
    expected = Ledger(missed=7, absorbed=30, sideways=40, other_order=other)
    assert Ledger.from_counts(kept[2:]) == replace(expected, over_the_edge=3)
    kept = classes.rays(orders[1], rays, (2, 1, 1))[0]
    assert kept[:2].tolist() == [100, 0]
    # what the first event absorbed is absorbed; what had two and goes on is no second;
    # what was cut off after one might have been
    other = 5 + 10 + 20 + 40 + 500 + 1000 + 4000
    expected = Ledger(missed=7, absorbed=330, truncated=50, other_order=other)
    assert Ledger.from_counts(kept[2:]) == replace(expected, over_the_edge=2)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"orders": ()}, "orders must hold at least one order, got"),
        ({"orders": ("x",)}, "orders must be 'all', a number"),
        ({"order": "1"}, "measure_orders does not accept order"),
        ({"resume": None}, "measure_orders does not accept resume"),
    ],
)
def test_bad_orders_are_refused(settings, message):
    with pytest.raises(SettingError, match=message):
        gonio.measure_orders({"type": "diffuse"}, 30, **settings)


def test_theta_max_needs_a_tolerance_with_orders_too(capfd):
    assert main(["measure", "diffuse", "--order", "1,2", "--theta-max", "50"]) == 1
    assert "--theta-max applies with --tolerance" in capfd.readouterr().err

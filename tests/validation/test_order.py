"""What matters is named first: planted faults beside a small effect of stock facets.

The density of Mitsuba's Beckmann facets is not that of what they draw at grazing
incidence (see test_validation_stock.py), where a surface gets next to no light.
"""

from dataclasses import replace

import mitsuba as mi
import pytest

from gonio_mi.validation import validate
from gonio_mi.validation.checks.answers import ANSWERS
from gonio_mi.validation.checks.weights import WEIGHTS
from gonio_mi.validation.conditions import EFFORTS, Condition
from gonio_mi.validation.evidence import Breach, Test

# Fault, factor, function that may be named, and what the mistake has to say.
PLANTED = [
    ("weight", 0.99, "sample", "0.99 times `eval`"),
    ("eval", 1.05, "eval", " 1.05 everywhere"),
    ("pdf", 1.05, "pdf", "1.05 everywhere"),
]


@pytest.fixture
def planted(mono, monkeypatch):
    """The quick effort, with a map where the small effect is seen."""
    few = {"angles": (0, 40), "map_angles": (35, 89), "few_angles": (40,)}
    few |= {"samples": 2**16, "checked": 2**12}
    monkeypatch.setitem(EFFORTS, "quick", replace(EFFORTS["quick"], **few))

    class Planted(mi.BSDF):
        def __init__(self, props):
            super().__init__(props)
            self.fault, self.factor = props["fault"], props["factor"]
            self.facets = mi.load_dict({"type": "roughconductor", "alpha": 0.2})
            n = self.facets.component_count()
            self.m_components = [self.facets.flags(i) for i in range(n)]
            self.m_flags = self.facets.flags()

        def times(self, what, value):
            return value * (self.factor if what == self.fault else 1.0)

        def sample(self, *args):
            bs, weight = self.facets.sample(*args)
            bs.pdf = self.times("sampled_pdf", bs.pdf)
            return bs, self.times("weight", weight)

        def eval(self, *args):
            return self.times("eval", self.facets.eval(*args))

        def pdf(self, *args):
            return self.times("pdf", self.facets.pdf(*args))

        def eval_pdf(self, *args):
            return self.eval(*args), self.pdf(*args)

        def traverse(self, callback):
            self.facets.traverse(callback)

        def to_string(self):
            return "Planted[]"

    mi.register_bsdf("planted", Planted)
    return mono


def judged(fault, factor):
    words = {"type": "planted", "fault": fault, "factor": factor}
    return validate(words, effort="quick")


@pytest.mark.usefixtures("planted")
@pytest.mark.parametrize(("fault", "factor", "function", "said"), PLANTED)
def test_a_planted_factor_comes_before_a_small_effect(fault, factor, function, said):
    verdict = judged(fault, factor)
    assert said in verdict.mistake, str(verdict)
    assert function in verdict.function.split(" or ")
    first, *rest = verdict.failures
    # of all light at the normal, or of that at 35 degrees
    off = sorted([abs(factor - 1), abs(1 / factor - 1)])
    assert 0.8 * off[0] < first.share < 1.001 * off[1]
    shares = [one.share for one in rest if one.effect == first.effect]
    assert shares == sorted(shares, reverse=True)
    if fault in ("weight", "eval"):
        # what stock facets do is told too
        assert shares[-1] == verdict["sampling"].share < 0.2 * first.share
        assert "theta_i 89" in verdict["sampling"].statistic
        assert first.name == "sampled_weight"


@pytest.mark.usefixtures("planted")
def test_alone_the_small_effect_is_named():
    """The twin of the test above."""
    verdict = judged("none", 1.0)
    assert verdict.failures[0].name == "sampling"
    # less than a hundredth is off at 89 degrees, whose cosine is 0.0175
    assert 0 < verdict.failures[0].share < 0.01 * 0.0175
    assert "everywhere" not in verdict.mistake


def test_a_share_is_of_what_a_surface_gets():
    """By the cosine, exact at 0 and to rounding at 60 degrees."""
    steep, slanted = (Condition(theta) for theta in (0.0, 60.0))
    for condition, part in ((None, 1), (steep, 1), (slanted, 0.5)):
        found = Test(WEIGHTS, "", condition, 0.3)
        assert found.share == pytest.approx(0.3 * part, rel=1e-15)
    breach = Breach(WEIGHTS, "", Condition(60.0), 0.3)
    assert breach.share == pytest.approx(0.15, rel=1e-15)
    assert Breach(ANSWERS, "").share is None

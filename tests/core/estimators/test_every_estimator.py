"""What all estimators have in common; and one more is added here, in a few lines."""

import drjit as dr
import numpy as np
import pytest
from budget import agree, disagree, of_total
from specimens import GREY, MIRROR, diffuse_groove_dhr, grooves

import gonio_mi as gonio
from gonio_mi.errors import SettingError, SpecimenError
from gonio_mi.estimators import METHODS
from gonio_mi.settings import Estimator, MeasurementSettings
from gonio_mi.transport.method import Method

ESTIMATORS = [str(one) for one in Estimator]
BLACK = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": 0.0}}
HOW = {"period": "box", "collector": "projected:4x6", "rays": 2**14}
HALF_ANGLE, THETA = 40.0, 30.0
FLAT = "quadrature"


def measured(estimator, bsdf=GREY, **settings):
    """Grooves of a BSDF; of `quadrature`, which needs a plane, a rectangle."""
    how = HOW | {"estimator": estimator} | settings
    if estimator == FLAT:
        return gonio.measure(bsdf, THETA, **how | {"period": "none"})
    return gonio.measure(grooves(HALF_ANGLE, 1, bsdf=bsdf), THETA, **how)


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_agrees_with_a_closed_form(estimator):
    """All orders between two grey walls; twin: a tenth more."""
    record = measured(estimator)
    if estimator == FLAT:
        assert np.all(abs(record.dhr - 0.8) <= record.dhr_std_err)
        assert np.all(abs(record.dhr - 0.808) > record.dhr_std_err)
        return
    expected = diffuse_groove_dhr(HALF_ANGLE, THETA, 0.8)
    agree(of_total(record, expected))
    disagree(of_total(record, 1.1 * expected))


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_dark_and_few_rays(estimator):
    """Nothing is 0, below a limit; limits of a ray in each batch hold the value."""
    if estimator == "split":
        with pytest.raises(SpecimenError, match="no light to any patch"):
            measured(estimator, BLACK)
    else:
        dark = measured(estimator, BLACK)
        assert not dark.dhr.any()
        assert np.all(dark.interval(0.95, "dhr")[1] >= 0)
    one = measured(estimator, rays=16)
    low, high = one.interval(0.95, "dhr")
    truth = 0.8 if estimator == FLAT else diffuse_groove_dhr(HALF_ANGLE, THETA, 0.8)
    assert low <= truth <= high


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_what_it_says_of_itself_is_so(estimator):
    """Exact: what a file tells of its estimator, and orders and more rays."""
    settings = MeasurementSettings(estimator=estimator)
    method = METHODS[settings.estimator]
    assert method.integrates == settings.integrates
    assert method.deposits == (settings.sends_points or settings.joins_points)
    whole = measured(estimator, rays=2**10)
    if method.resumes:
        again = measured(estimator, rays=2**10, resume=whole)
        assert again.ledger == whole.ledger
    else:
        with pytest.raises(SettingError, match=f"got the estimator {estimator}"):
            measured(estimator, rays=2**10, resume=whole)


@pytest.mark.parametrize("rays", [20, 1000])
@pytest.mark.parametrize("estimator", [*ESTIMATORS, "facets"])
def test_one_sum_has_one_estimate(estimator, rays):
    """Exact: a total and a patch, as the quantities of their weights."""
    how = {"estimator": estimator, "rays": rays}
    if estimator == "facets":  # mirrors, whose first order is a sum
        how |= {"estimator": "next_event", "bsdf": MIRROR}
    record = measured(**how)
    shape = record.flux_fraction.shape[:-1]
    everything, patch = np.zeros((2, *shape))
    everything[0], patch[0, 1, 2] = 1.0, 1.0
    total = record.quantity(everything)
    assert total.value == record.dhr[0]
    assert total.interval == tuple(np.ravel(record.interval(0.95, "dhr")))
    np.testing.assert_equal(total.std_err, record.dhr_std_err[0])
    one, where = record.quantity(patch), record.estimates[0].patches(0)
    assert one.interval == tuple(x[1, 2, 0] for x in where.interval(0.95))
    np.testing.assert_equal(one.std_err, where.std_err[1, 2, 0])
    solid = record.subdivision.projected_solid_angles[1, 2]
    assert one.value / solid == record.brdf[1, 2, 0]


class Thinned(Method):
    """A toy: one ray in two, by chance, counts twice, and the others not at all."""

    def add(self, rays, sampler, ray):
        exits = rays.path()(sampler)
        exits.throughput *= dr.select(sampler.next_1d() < 0.5, 2.0, 0.0)
        rays.collect(exits, ray < rays.size)


def test_one_more_is_one_class(monkeypatch):
    """In place of another: nothing else knows which it is. Twin: noisier."""
    plain = measured("weighted")
    monkeypatch.setitem(METHODS, Estimator.WEIGHTED, Thinned())
    record = measured("weighted")
    agree(of_total(record, diffuse_groove_dhr(HALF_ANGLE, THETA, 0.8)))
    assert record.dhr_std_err > plain.dhr_std_err


def test_ctrl_c_while_rays_are_joined_costs_none(monkeypatch):
    """Exact: what nothing is beside is not finished outside of what hears it."""

    class Pressed(Method):
        def finish(self, *_):
            raise KeyboardInterrupt

    monkeypatch.setitem(METHODS, Estimator.WEIGHTED, Pressed())
    assert measured("weighted", rays=2**10).ledger.emitted == 2**10

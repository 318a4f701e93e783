"""Comparisons in which errors of all directions are one: those of a fit's parameters.

What a right model's p-value may be is counted over many draws of a known covariance.
"""

from dataclasses import replace

import numpy as np
import pytest
from budget import agree, disagree, often_enough
from scipy import stats

import gonio_mi as gonio
from gonio_mi.analysis.comparison.agreement import PointPairs, judge
from gonio_mi.analysis.comparison.sum_of_squares import p_value_of_squares
from gonio_mi.analysis.points import Points

# isort: split
import mitsuba as mi

WHITE = {"type": "diffuse", "reflectance": 0.5}
BEAM = {"collector": "projected:4x8", "sampler": "independent", "estimator": "analog"}

# Directions, points of each, and errors in common, of a size relative to the others.
N_SETS, N, SIZE = 4, 40, 0.7


def common_roots(rng):
    """Two errors of all points: of all alike, and of some more than of others."""
    shape = np.ones(N_SETS * N), rng.normal(size=N_SETS * N)
    return SIZE * np.array(shape)


def p_values(rng, roots, told):
    """Of chi-square, of points that are off by `roots`, where they are `told`."""
    zero, one = np.zeros(N), np.ones(N)
    off = rng.normal(size=len(roots)) @ roots + rng.normal(size=N_SETS * N)
    sets = [
        PointPairs(
            {},
            Points(off[part], one),
            Points(zero, zero, told[:, part]),
            weight=one,
            total_of=[k] * N,
        )
        for k, part in enumerate(np.split(np.arange(N_SETS * N), N_SETS))
    ]
    return judge(sets, 0.0)[3]["chi2"]


def test_errors_in_common_are_so_at_all_directions():
    """600 draws at 1 %; twins: as if each direction had its own errors, or none had."""
    rng = np.random.default_rng(1)
    roots = common_roots(rng)
    apart = np.zeros((N_SETS, 2, N_SETS, N))
    for k in range(N_SETS):
        apart[k, :, k] = roots.reshape(2, N_SETS, N)[:, k]
    for told, passes in (
        (roots, agree),
        (apart.reshape(2 * N_SETS, -1), disagree),
        (0 * roots, disagree),
    ):
        drawn = [p_values(rng, roots, told) >= 0.01 for _ in range(600)]
        passes(often_enough(drawn, 0.99))


@pytest.mark.parametrize("share", [0.02, 0.1, 0.3, 0.95])
@pytest.mark.parametrize("p", [0.5, 0.01, 1e-6])
def test_the_tail_is_that_of_unequal_eigenvalues(share, p):
    """Beside an integral over the common error; one chi-square is off by a factor."""
    n = 384
    weight, rest = share * n + 1 - share, 1 - share
    trace = weight**2 + (n - 1) * rest**2
    # the median of a normal score in equal steps of probability, far into its tails
    x, step = np.linspace(-12, 12, 20_001, retstep=True)

    def exact(q):
        left = stats.chi2.sf((q - weight * x**2) / rest, n - 1)
        return np.sum(stats.norm.pdf(x) * left) * step

    low, high = 0.0, 1e5
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if exact(middle) > p else (low, middle)
    common = np.full((1, n), share**0.5)
    found = p_value_of_squares(low, trace, common, n)
    # of one chi-square with one degree of freedom the saddlepoint has 1.09 at 1e-6
    assert 0.9 < found / p < 1.12
    dof = n**2 / trace
    if p == 1e-6 and share in (0.1, 0.3):
        assert stats.chi2.sf(low * dof / n, dof) < p / 10


def test_without_errors_in_common_it_is_one_chi_square():
    none = np.zeros((1, 50))
    assert p_value_of_squares(60, 80, none, 50) == pytest.approx(
        stats.chi2.sf(60 * 50 / 80, 50**2 / 80), rel=1e-12
    )
    assert p_value_of_squares(60, 50, none, 20) == pytest.approx(
        stats.chi2.sf(24, 20), rel=1e-12
    )


@pytest.mark.slow
def test_a_fit_beside_several_directions_is_rejected_as_often_as_it_says():
    """40 fits at 5 %; twins: taken for exact, and 10 that are off by 4 errors more.

    Fits of other light would be off by draws of their covariance; so these are drawn.
    """
    mi.set_variant("llvm_ad_mono")
    fit = gonio.fit(gonio.measure(WHITE, 60, rays=3000, **BEAM), "diffuse")
    rng = np.random.default_rng(0)
    right, exact, off = [], [], []
    for seed in range(40):
        light = {"rays": 50_000, "seed": 1000 + seed} | BEAM
        record = gonio.measure(WHITE, [20, 45, 70], **light)
        drawn = replace(fit, values=0.5 + rng.normal() * fit.std_errs)
        right.append(gonio.compare(record, drawn, alpha=0.05).passed)
        surer = replace(drawn, covariance=0 * fit.covariance)
        exact.append(gonio.compare(record, surer, alpha=0.05).passed)
        if seed < 10:
            shifted = replace(drawn, values=drawn.values + 4 * fit.std_errs)
            off.append(gonio.compare(record, shifted, alpha=0.05).passed)
    agree(often_enough(right))
    disagree(often_enough(exact))
    disagree(often_enough(off))

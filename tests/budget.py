"""The suite's false-alarm budget, and the statistical verdicts that share it.

A correct instrument turns the whole suite red, after a change of its random numbers,
with a probability of at most ``SUITE_ALPHA``. Every statistical verdict takes one of
``SHARES`` equal shares of it (Bonferroni), and a verdict on many patches splits its
share between three views of their normal scores: their mean (a small bias everywhere),
their spread (either way: too large an error bar hides every error) and the worst one.

A test calls :func:`agree` with a verdict, and its twin calls :func:`disagree` with the
verdict on a wrong reference, which shows that the test can fail:

>>> agree(verdict(scores(record, reference)))
>>> disagree(verdict(scores(record, 1.01 * reference)))
"""

from dataclasses import dataclass, field

import numpy as np
from scipy import stats

SUITE_ALPHA = 1e-3
SHARES = 2000
ALPHA = SUITE_ALPHA / SHARES

# Hits per batch and patch below which a mean of batches is not normal enough
# (below that, patches are merged).
ENOUGH_HITS = 30

_spent = 0


def begin():
    """Start a session: of several in one process, each has the whole budget."""
    global _spent
    _spent = 0


def spent():
    """Return how many verdicts have been passed in this session."""
    return _spent


def add(verdicts):
    """Count the verdicts that another process has passed."""
    global _spent
    _spent += verdicts
    assert _spent <= SHARES, "more verdicts than budget.SHARES: raise it"


@dataclass
class Verdict:
    """The p-values of one statistical comparison, by view."""

    p: dict = field(default_factory=dict)
    n: int = 1

    @property
    def ok(self):
        """Whether no view is below its part of the share."""
        return all(p > ALPHA / len(self.p) for p in self.p.values())

    def __str__(self):
        views = ", ".join(f"{view} p = {p:.3g}" for view, p in self.p.items())
        return f"{self.n} scores: {views}; each must be above {ALPHA / len(self.p):.2g}"


def of_comparison(comparison):
    """Return the verdict of a comparison, whose p-value is its one view."""
    return Verdict({"comparison": comparison.p_value}, len(comparison.z))


def agree(verdict):
    """Assert that a comparison is within statistics, at the cost of one share."""
    global _spent
    _spent += 1
    assert _spent <= SHARES, "more verdicts than budget.SHARES: raise it"
    assert verdict.ok, str(verdict)


def disagree(verdict):
    """Assert that a comparison with a wrong reference is noticed; costs no budget."""
    assert not verdict.ok, str(verdict)


# ---------------------------------------------------------------- scores and verdicts


def normal_scores(t, dof):
    """Normal score of the same probability as Student's `t` with `dof` d.o.f."""
    t = np.asarray(t, dtype=float)
    # the log of the smaller tail keeps its precision far out
    return np.sign(t) * -stats.norm.ppf(stats.t.sf(np.abs(t), dof).clip(1e-300))


def single(z):
    """Verdict on one normal score."""
    return Verdict({"value": float(2 * stats.norm.sf(abs(z)))})


def verdict(z):
    """Verdict on many independent normal scores: mean, spread and worst.

    Scores of all patches of a map whose every ray is collected are slightly negatively
    correlated, which leaves their mean quieter than is asked for.
    """
    z = np.ravel(z)
    n = z.size
    assert n > 0
    assert np.isfinite(z).all()
    square = np.sum(z**2)
    spread = 2 * min(stats.chi2.cdf(square, n), stats.chi2.sf(square, n))
    worst = -np.expm1(n * np.log1p(-2 * stats.norm.sf(np.abs(z).max())))
    return Verdict(
        {
            "mean": float(2 * stats.norm.sf(abs(z.mean()) * np.sqrt(n))),
            "spread": float(spread),
            "worst": float(worst),
        },
        n,
    )


def often_enough(covered, level=0.95):
    """Verdict on a coverage of at least `level`; `covered` is that of each seed."""
    covered = np.asarray(covered, dtype=float)
    if set(covered) <= {0, 1}:
        p = stats.binom.cdf(covered.sum(), len(covered), level)
    else:
        z = (covered.mean() - level) / (covered.std(ddof=1) / len(covered) ** 0.5)
        p = stats.norm.cdf(normal_scores(z, len(covered) - 1))
    return Verdict({"coverage": float(p)})


def merge_small(hits, least):
    """Group consecutive patches until each group has at least `least` hits.

    Returns
    -------
    ndarray of int
        First index of each group, for ``np.add.reduceat``; what is left at the end
        joins the last group. Empty if there are not enough hits for one.
    """
    starts, total = [], least
    for i, n in enumerate(np.ravel(hits).tolist()):
        if total >= least:
            starts.append(i)
            total = 0
        total += n
    if total < least:
        starts.pop()
    return np.array(starts, dtype=int)


def batch_groups(record, hemisphere, channel, keep=None):
    """Flux fractions batch by batch, of groups of patches with enough hits.

    Returns
    -------
    values : ndarray, shape (n_batches, n_groups)
    group : callable
        Merges a map of flux fractions in the same way.
    """
    (tally,) = record.tallies
    keep = np.ones(record.subdivision.shape, bool) if keep is None else keep
    hits = tally.hits[hemisphere][keep]
    starts = merge_small(hits, ENOUGH_HITS * tally.n_batches)

    def group(values):
        values = np.broadcast_to(values, keep.shape)[keep]
        return np.add.reduceat(values, starts) if starts.size else np.zeros(0)

    sums = tally.sums[:, hemisphere, :, :, channel].astype(float)
    values = sums / tally.incident[:, None, None, channel]
    return np.stack([group(v) for v in values]), group


def scores(record, reference, hemisphere=0, channel=0, keep=None):
    """Normal scores of a record's flux fractions against exact ones.

    `reference` holds flux fractions (patch mean times projected solid angle), shaped
    ``(n_theta, n_phi)``; `keep` leaves patches out.
    """
    values, group = batch_groups(record, hemisphere, channel, keep)
    n = len(values)
    std_err = values.std(axis=0, ddof=1) / np.sqrt(n)
    return normal_scores((values.mean(axis=0) - group(reference)) / std_err, n - 1)


def of_total(record, expected, of="dhr", channel=0):
    """Verdict on a total of a record, which is normal over its batches."""
    off = getattr(record, of)[channel] - expected
    t = off / getattr(record, f"{of}_std_err")[channel]
    return single(normal_scores(t, record.n_batches - 1).item())


def two_sample(a, b):
    """Verdict on two independent histograms of equally many rays."""
    keep = a + b > 100
    a, b = a[keep], b[keep]
    return verdict((a - b) / np.sqrt(a + b))


def difference_scores(a, b, hemisphere=0, channel=0, keep=None):
    """Normal scores of two records' difference; both have the same batches and rays."""
    first, group = batch_groups(a, hemisphere, channel, keep)
    (tally,) = b.tallies
    sums = tally.sums[:, hemisphere, :, :, channel].astype(float)
    second = sums / tally.incident[:, None, None, channel]
    second = np.stack([group(v) for v in second])
    n = len(first)
    assert n == len(second)
    std_err = np.sqrt((first.var(axis=0, ddof=1) + second.var(axis=0, ddof=1)) / n)
    return normal_scores(
        (first.mean(axis=0) - second.mean(axis=0)) / std_err, 2 * n - 2
    )


def count_verdict(counts, shares):
    """Verdict on counts of independent rays, one cell each: Pearson's chi-square.

    `shares` holds what each cell should get, in any unit. The sum of the counts is
    taken as it is, for a test of its own. Views: the statistic either way, and the
    worst cell by its exact binomial tail.
    """
    counts, shares = np.ravel(counts).astype(float), np.ravel(shares)
    rays = counts.sum()
    expected = shares * (rays / shares.sum())
    starts = merge_small(expected, ENOUGH_HITS)
    counts = np.add.reduceat(counts, starts)
    expected = np.add.reduceat(expected, starts)
    chi2 = np.sum((counts - expected) ** 2 / expected)
    dof = counts.size - 1
    tail = np.minimum(
        stats.binom.cdf(counts, rays, expected / rays),
        stats.binom.sf(counts - 1, rays, expected / rays),
    ).min()
    return Verdict(
        {
            "chi-square": float(
                2 * min(stats.chi2.cdf(chi2, dof), stats.chi2.sf(chi2, dof))
            ),
            "worst": float(min(1.0, 2 * tail * counts.size)),
        },
        counts.size,
    )

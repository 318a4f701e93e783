"""Directions are drawn with the density of `pdf`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeAlias

import mitsuba as mi
import numpy as np
from scipy import special

from ...array_types import Flags, Floats, Integers
from ...collector.directions import direction
from ...single_precision import BSDF_ROUNDING
from ..arrays import of_pdf
from ..conditions import Condition, Sweep
from ..densities import directions, in_box, total
from ..evidence import BIAS, COMBINED, INTERFACE, MAX_P, NOISE, SAME, Evidence, Question
from ..guilt.ratios import VALUE, WEIGHT, Ratios
from ..integrals import SUM_ERROR
from ..judgements import apart
from ..maps import FourMaps, skew_score, unexplained_fraction
from ..mistakes import PDF, SAMPLE, Claim, Function, Mistake
from ..probe import Probe, is_delta, numbers, spectral, uniform, vectors
from ..samples import beyond_rounding, samples_of
from .answers import lattice
from .weights import WEIGHTS, check_scores

SAMPLING = Question(
    "sampling",
    __doc__,
    BIAS,
    COMBINED,
    volumes=SAME,
    identity=True,
    needed=True,
    shown=Claim(in_box, apart, (directions,)),
)


# Terms of a sum, their squares, cubes and sizes.
Terms: TypeAlias = tuple[Floats, ...]


class Sampling(Mistake):
    """Mistakes in densities."""

    MORE_THAN_1 = "{who} integrates to {mass:.4g}, more than 1{dark}"
    DARK_SIDE = """{who} is not 0 from a side that `flags` does not declare, where
        `eval` is zero and `sample` scatters nothing"""
    OTHER_PROBABILITY = """{who}: directions are drawn with another probability than
        `pdf` says ({sums})"""
    ROULETTE = """{who} rejects directions by a Russian roulette of its own, and its
        weights make up for it"""


# Bands of the angle of incidence, and sectors of its azimuth, and the least number of
# equal terms that a sum must be worth.
N_CELLS = 30
MIN_TERMS = 100

# Samples that tell a roulette, the least fraction that it rejects, and standard errors
# within which weights make up for that.
N_ROULETTE = 2**16
MIN_REJECTED = 0.01
MAX_SCORE = 4


@SAMPLING.asks("maps")
def check_maps(evidence: Evidence, maps: FourMaps) -> None:
    """Test counts by patch and in total, and that ``pdf`` integrates to at most 1.

    A density does no harm where ``eval`` is black.
    """
    check_scores(evidence, maps, SAMPLING)
    used, unused = maps.pdf.sum(), maps.due.unused.values.sum()
    slack = max(maps.pdf_sum_bound, SUM_ERROR) + maps.due.unused.sum_bound
    if used + unused > 1 + slack:
        shown = Claim(total, apart, (of_pdf, 1))
        mass, how = used + unused, {"shown": shown, "of_flux": True}
        dark = ""
        if used <= 1 + slack:
            how["effect"] = INTERFACE
            dark = f", {unused:.4g} of it where `eval` is zero"
        guess = Sampling.MORE_THAN_1(PDF, mass=mass, dark=dark)
        how |= {"found": f"{mass:.5g}", "size": mass - 1, "off": min(mass - 1, 1.0)}
        evidence.breach(SAMPLING, guess, maps.condition, **how)


def check_unsampled_side(evidence: Evidence, condition: Condition) -> None:
    """Check that ``pdf`` is 0 for incidence from a side that scatters no light.

    It is a matter of the interface, for no integrator uses it there.
    """
    density = Probe(evidence.bsdf, condition).densities(lattice())
    mass = 4 * np.pi * float(np.nan_to_num(density, nan=0).mean())
    if mass > 0:
        how = {"found": f"`pdf` integrates to {mass:.3g}", "size": mass}
        how |= {"effect": INTERFACE, "shown": Claim(total, apart, (of_pdf, 0))}
        evidence.breach(SAMPLING, Sampling.DARK_SIDE(PDF), condition, **how)


@SAMPLING.asks("sweep")
def check_sweep(evidence: Evidence, sweep: Sweep, key: tuple[int, ...]) -> None:
    """Test directions against ``pdf`` over a sweep of incident directions.

    If samples have the density p, the mean of g u / (p + u) over them is that of
    g p / (p + u) over directions of the density u, whatever the function g: of terms
    between 0 and 1, in each band and sector of incidence, without an integral.
    """
    n, probe = sweep.n, Probe(evidence.bsdf, sweep)
    bs, weight = probe.sample(*uniform(n, (*key, 1)))
    drawn = spectral(bs.wo, n)
    given = (spectral(weight, n) != 0).any(axis=1) & ~numbers(is_delta(bs), n)
    given &= np.isfinite(drawn).all(axis=1)
    # whatever `flags` declares, which is a property of its own
    crossing = given & (drawn[:, 2] * sweep.wi[:, 2] < 0)
    through = _transmits(evidence.bsdf) or beyond_rounding(crossing)
    even = _even_directions(sweep, through, key)
    asked = np.where(given[:, None], drawn, sweep.wi)
    pdf, lit = _densities(probe, asked, given)
    pdf_even, _ = _densities(probe, even, np.ones(n, dtype=bool))
    if not (lit.any() or pdf_even.any()):
        return
    u = 1 / (4 * np.pi if through else 2 * np.pi)
    terms = [lit * u / (pdf + u), pdf_even / (pdf_even + u)]
    cells = _cells(sweep)
    weighed = [_weighings(sweep, wo, x) for wo, x in zip((drawn, even), terms)]
    z, own = _worst_score(cells, weighed)
    n_scores = 2 * N_CELLS * len(cells) * len(weighed[0])
    tail = 2 * special.ndtr(-abs(z))
    p = float(-np.expm1(n_scores * np.log1p(-min(tail, 1 - 1e-16))))
    mass = float((pdf_even / u)[own].mean())
    std_err = float((pdf_even / u)[own].std() / np.sqrt(own.sum()))
    counted = float(lit[own].mean())
    place = sweep.place(own)
    sums = (
        f"`pdf` integrates to {mass:.4g} +- {std_err:.1g} (std_err), where it should "
        f"equal the sampled mass of {counted:.4g}, at {place}"
    )
    off = abs(mass - counted) / max(mass, counted, 1e-9) * float(own.mean())
    guess = None
    if p < MAX_P:
        function = _guilty_of_mass(mass, counted, max(MAX_SCORE * std_err, SUM_ERROR))
        guess = Sampling.OTHER_PROBABILITY(function, sums=sums)
    text = f"worst z {z:+.3g} of {n_scores} bands and sectors of incidence: {place}"
    evidence.test(SAMPLING, p, text, sweep.middle(own), off=off, guess=guess)


def _guilty_of_mass(mass: float, counted: float, slack: float) -> Function:
    """Function that is at fault, by the integral of ``pdf`` and the sampled mass."""
    complete = abs(mass - 1) < slack
    if mass > 1 + slack or (counted > 1 - SUM_ERROR and not complete):
        return PDF
    return SAMPLE if complete and counted < 1 - slack else SAMPLE | PDF


def _densities(probe: Probe, wo: Floats, usable: Flags) -> tuple[Floats, Flags]:
    """Densities of directions, 0 where ``eval`` is black, and a mask of those lit.

    Directions that are not `usable` count as black.
    """
    value, pdf = probe.eval_and_pdf(vectors(wo))
    lit = usable & (np.nan_to_num(spectral(value, len(wo))) > 0).any(axis=1)
    pdf = np.nan_to_num(numbers(pdf, len(wo)).astype(float))
    return np.where(lit, np.maximum(pdf, 0), 0), lit


def _transmits(bsdf: mi.BSDF) -> bool:
    return bool(int(bsdf.flags()) & int(mi.BSDFFlags.Transmission))


def _even_directions(sweep: Sweep, through: bool, key: tuple[int, ...]) -> Floats:
    """Directions of uniform density over the sphere, or over the lit hemisphere."""
    random = np.random.default_rng([*key, 2])
    low = -1 if through else 0
    z, phi = random.uniform(low, 1, sweep.n), random.uniform(0, 2 * np.pi, sweep.n)
    wo = direction(np.arccos(z), phi)
    wo[:, 2] *= np.sign(sweep.wi[:, 2])
    return wo


def _cells(sweep: Sweep) -> Integers:
    """Band of the polar angle, sector of the azimuth, place and face, (4, n)."""
    theta, phi = sweep.angles
    each = ((theta, 90), (phi, 360))
    bands = ((x / limit * N_CELLS).astype(int) for x, limit in each)
    return np.stack([*bands, sweep.places, (sweep.wi[:, 2] < 0).astype(int)])


def _weighings(sweep: Sweep, wo: Floats, x: Floats) -> list[Terms]:
    """Terms times 1, the cosine of wo, its parts along and across the plane of wi."""
    phi = np.radians(sweep.angles[1])
    along = wo[:, 0] * np.cos(phi) + wo[:, 1] * np.sin(phi)
    across = wo[:, 1] * np.cos(phi) - wo[:, 0] * np.sin(phi)
    each = (np.nan_to_num(x * y) for y in (1.0, np.abs(wo[:, 2]), along, across))
    return [(x, x * x, x * x * x, np.abs(x)) for x in each]


def _worst_score(
    cells: Integers, weighed: Sequence[Sequence[Terms]]
) -> tuple[float, Flags]:
    """Worst score in a band, sector or place of one face, or all of it, and its mask.

    What all of these share is summed once: 2000 numbers instead of each sample.
    """
    shape = cells.max(axis=1) + 1
    joint = np.ravel_multi_index(tuple(cells), tuple(shape))

    def summed(x: Floats | None) -> Floats:
        return np.bincount(joint, x, int(shape.prod())).reshape(shape)

    n = summed(None)
    sums = np.array([[[summed(x) for x in one] for one in both] for both in weighed])
    found = []
    for axes in ((0, 3), (1, 3), (2, 3), (3,)):
        others = tuple({0, 1, 2, 3} - {*axes})
        z = _scores(n.sum(others), sums.sum(tuple(3 + k for k in others)))
        at = np.unravel_index(np.abs(z).argmax(), z.shape)
        own = [cells[k] == i for k, i in zip(axes, at[1:])]
        found.append((float(z[at]), np.all(own, axis=0)))
    return max(found, key=lambda one: abs(one[0]))


def _scores(n: Floats, sums: Floats) -> Floats:
    """Normal scores of the differences of two sums in each cell; 0 of too few terms."""
    n = np.maximum(n, 1)
    total, squares, cubes, size = np.moveaxis(sums, 2, 0)
    mean = total / n
    # equal terms vary by rounding alone
    variance = squares - n * mean**2 + (BSDF_ROUNDING * size) ** 2
    third = cubes - 3 * mean * squares + 2 * n * mean**3
    enough = (size**2 > MIN_TERMS * squares).all(axis=0)
    known = np.where(enough, variance.sum(axis=0), 0)
    sigma = np.sqrt(np.where(known > 0, known, np.inf))
    (first, second), (third, other) = total, third
    return np.nan_to_num(
        skew_score((first - second) / sigma, (third - other) / sigma**3)
    )


def check_pooled(evidence: Evidence) -> None:
    """Test sums over all patches and conditions, for a small error everywhere."""
    for question in (SAMPLING, WEIGHTS):
        name = question.name
        varying = (m for m in evidence.maps if name == "weights" or m.is_count_random)
        # what is certain is judged one by one
        scores = [z for m in varying if 0 < abs(z := m.scores(name).total) < 8]
        if len(scores) > 1:
            z = float(np.sum(scores) / np.sqrt(len(scores)))
            p = float(2 * special.ndtr(-abs(z)))
            gains = [unexplained_fraction(m, name)[1] for m in evidence.maps]
            off = abs(float(np.mean(gains)))
            evidence.test(question, p, f"z of all sums together {z:+.1f}", off=off)


def check_roulette(evidence: Evidence) -> None:
    """Whether ``sample`` rejects directions at random and its weights make up for it.

    Then directions are rarer than by ``pdf``, and weights larger than ``eval`` over it,
    by the same factor: noise, and no bias, as long as `weights` holds.
    """
    whole = evidence.whole_maps
    if not whole or not evidence.of("sampled_weight"):
        return
    if not all(_is_roulette(evidence, maps) for maps in whole):
        return
    if Ratios.of(evidence, WEIGHT, VALUE).varies:
        return  # a cosine or a Jacobian is no chance: `pdf` lacks it
    biased = [b for b in evidence.of("sampled_weight") if b.effect == BIAS]
    evidence.change(biased, effect=NOISE, guess=Sampling.ROULETTE(SAMPLE))
    evidence.tests[:] = [
        replace(t, effect=NOISE) if t.name == "sampling" and t.effect == BIAS else t
        for t in evidence.tests
    ]


def _is_roulette(evidence: Evidence, maps: FourMaps) -> bool:
    """Whether the mean of weight times pdf over ``eval`` is the integral of ``pdf``."""
    key = (evidence.seed, 2, 73)
    samples = samples_of(evidence.bsdf, maps.condition, N_ROULETTE, key, False)
    lit = samples.usable & (samples.eval > 0).any(axis=1)
    ratio = np.zeros(samples.n)
    over = samples.weight[lit].sum(axis=1) * samples.pdf[lit]
    ratio[lit] = over / samples.eval[lit].sum(axis=1)
    due, std_err = maps.pdf.sum(), ratio.std() / np.sqrt(samples.n)
    rejected, missing = 1 - samples.given.mean(), due - lit.mean()
    return bool(
        missing > MIN_REJECTED
        and rejected > missing / 2
        and (ratio[lit] > 1 - BSDF_ROUNDING).all()
        and abs(ratio.mean() - due) < MAX_SCORE * std_err + SUM_ERROR
    )

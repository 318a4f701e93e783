"""Owen-scrambled Sobol' points: their net, their randomness, and what they measure.

Verdicts share the suite's budget of false alarms (`budget`). Nets, sequences and
bits are exact. Evenly distributed counts scatter less than random ones, so that their
chi-square is tested on the upper side alone.
"""

import itertools
import time
from functools import cache
from itertools import combinations, pairwise

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from budget import (
    Verdict,
    agree,
    count_verdict,
    difference_scores,
    disagree,
    normal_scores,
    often_enough,
    single,
    verdict,
)
from closed_forms import fresnel
from scipy import stats
from scipy.stats import qmc

import gonio_mi as gonio
from gonio_mi.instrument import launcher
from gonio_mi.instrument.launcher import LaunchSize
from gonio_mi.transport import curve, sampling, sobol_points as sobol
from gonio_mi.transport.curve import MAX_SEQUENCES, Curve, curves
from gonio_mi.transport.morton import leading_digits

SEEDS = 2**18
PLASTIC = {"type": "roughplastic", "alpha": 0.2}


def numbers(index, seed, draw):
    """Scrambled numbers as uint32, for scalars or arrays that broadcast."""
    index, seed = np.broadcast_arrays(np.uint32(index), np.uint32(seed))
    # gathered: what NumPy has allocated may not be aligned, which is another kernel
    both = mi.UInt32(np.stack([index, seed], axis=-1).ravel())
    n = dr.arange(mi.UInt32, index.size)
    both = [dr.gather(mi.UInt32, both, 2 * n + i) for i in (0, 1)]
    bits = sobol.sobol_number(*both, dr.opaque(mi.UInt32, draw))
    return bits.numpy().reshape(index.shape)


def draw_all(sampler, pattern=(2, 1, 2, 1, 1)):
    """Array of the numbers of one ray a column, drawn in 2D and 1D."""
    rows = []
    for n in pattern:
        rows += [*sampler.next_2d()] if n == 2 else [sampler.next_1d()]
    dr.eval(rows)
    return np.array([row.numpy() for row in rows])


# ------------------------------------------------------------------ the points


def test_unscrambled_points_are_scipys():
    n = 2**16
    points = qmc.Sobol(sobol.BLOCK, scramble=False, bits=32).random(n) * 2.0**32
    # SciPy's order is that of the Gray code
    gray = np.arange(n) ^ np.arange(n) >> 1
    index = dr.arange(mi.UInt32, n)
    for draw, dimension in enumerate(sobol.ORDER):
        ours = dr.brev(sobol.sobol_known(index, draw)).numpy()
        assert np.array_equal(ours[gray], points[:, dimension].astype(np.uint32))


def test_both_ways_to_a_coordinate_agree():
    """In all 32 bits: a matrix when tracing, tables for a draw known to the kernel."""
    index = np.random.default_rng(1).integers(2**32, size=4096, dtype=np.uint32)
    for draw in range(sobol.BLOCK):
        known = sobol.sobol_known(mi.UInt32(index), draw)
        table = sobol.sobol_any(mi.UInt32(index), mi.UInt32(draw))
        assert dr.all(known == table)


@pytest.mark.parametrize("index", [16 * 3_141_592, 1234 << 4])
def test_points_beside_an_index_have_the_numbers_of_their_own(index):
    """Exact, in the first block and those that are shuffled; twin: of one bit less."""

    def differing(draw, bits):
        draw = mi.UInt32(draw) if draw < sobol.BLOCK else dr.opaque(mi.UInt32, draw)
        beside = dr.arange(mi.UInt32, 2**bits)
        whole = sobol.sobol_number(index ^ beside, mi.UInt32(5), draw)
        shared = sobol.sobol_number(mi.UInt32(index), mi.UInt32(5), draw, beside)
        return dr.count(whole != shared)[0]

    for draw in (*range(sobol.BLOCK), 20, 40):
        assert differing(draw, sobol.BESIDE_BITS) == 0
        if draw < sobol.BLOCK and sobol.ORDER[draw]:
            assert differing(draw, sobol.BESIDE_BITS + 1) == 2**sobol.BESIDE_BITS


def quality(x, y, m):
    """Parameter t of the net of 2**m points in base 2: 0 is best, m says nothing."""
    for t in range(m + 1):
        for i in range(m - t + 1):
            j = m - t - i
            cell = (x >> np.uint64(32 - i) << np.uint64(j)) + (y >> np.uint64(32 - j))
            counts = np.bincount(cell, minlength=2 ** (m - t))
            if not np.all(counts == 2**t):
                break
        else:
            return t
    return None


def test_scrambling_keeps_the_net():
    """Every pair of numbers, in any aligned stretch of the sequence and any block."""
    m = 9
    index = 37 * 2**m + np.arange(2**m)
    draws = range(sobol.BLOCK)
    plain = [
        dr.brev(sobol.sobol_known(mi.UInt32(index), draw)).numpy().astype(np.uint64)
        for draw in draws
    ]
    pairs = combinations(draws, 2)
    qualities = {(a, b): quality(plain[a], plain[b], m) for a, b in pairs}
    for first in (0, 3 * sobol.BLOCK):
        mixed = [numbers(index, 5, first + draw).astype(np.uint64) for draw in draws]
        for (a, b), t in qualities.items():
            assert quality(mixed[a], mixed[b], m) == t
    # the direction of scattering, and the lobe with either of its coordinates
    assert qualities[3, 4] == 0
    assert max(qualities[2, 3], qualities[2, 4]) <= 1
    # twins: random numbers, and a bijection of each coordinate that is not nested
    rng = np.random.default_rng(2)
    assert quality(*rng.integers(2**32, size=(2, 2**m), dtype=np.uint64), m) > 5
    shuffled = sobol._hash(mi.UInt32(plain[3].astype(np.uint32))).numpy()
    assert quality(shuffled.astype(np.uint64), plain[4], m) > 5


# ------------------------------------------------------------------ their randomness


def cells(*rows):
    """Joint histogram of 32-bit numbers in 256 cells, equally many a dimension."""
    bits = 8 // len(rows)
    cell = np.zeros(len(rows[0]), np.int64)
    for row in rows:
        cell = cell << bits | (row >> np.uint32(32 - bits)).astype(np.int64)
    return np.bincount(cell, minlength=2 ** (bits * len(rows)))


def flat(*rows):
    """Verdict on random numbers being jointly uniform."""
    counts = cells(*rows)
    return count_verdict(counts, np.ones(counts.size))


@pytest.mark.parametrize("index", [0, 31_250, 2**31 + 77])
def test_each_point_is_uniform_over_seeds(index):
    """Unbiased, for any number of rays: in its leading and in its further digits."""
    seeds = np.arange(SEEDS)
    rows = {d: numbers(index, seeds, d) for d in (0, 2, 3, 4, 7, 20, 37)}
    for draw in (0, 3, 4, 37):
        agree(flat(rows[draw]))
        agree(flat(rows[draw] << np.uint32(16)))
    for pair in [(2, 3), (2, 4), (3, 4), (0, 7), (3, 20), (4, 37), (20, 37)]:
        agree(flat(*(rows[d] for d in pair)))
    agree(flat(rows[2], rows[3], rows[4], rows[20]))
    # seeds in a row are unrelated
    for draw in (3, 4, 20):
        agree(flat(rows[draw][:-1:2], rows[draw][1::2]))
    # twin: one key for two numbers
    key = sobol.key(mi.UInt32(seeds), mi.UInt32(2))
    same = dr.brev(sobol.owen(sobol.sobol_known(mi.UInt32(index), 3), key)).numpy()
    disagree(flat(rows[2], same))


def after_the_split(x, y):
    """Binary digits of pairs of numbers that follow the first in which they differ."""
    shift = 32 - np.floor(np.log2((x ^ y).astype(float))).astype(np.uint32)
    assert np.all(shift == shift[0]), "the first different digit depends on the seed"
    return x << shift[0], y << shift[0]


@pytest.mark.parametrize("pair", [(0, 1), (5, 7), (40, 2**20 + 40)])
def test_two_points_are_independent_after_they_part(pair):
    """What Owen's scrambling promises of each pair, and his variance follows from."""
    seeds = np.random.default_rng(3).integers(2**32, size=SEEDS, dtype=np.uint32)
    for draw in (0, 3, 4):
        x, y = after_the_split(*(numbers(i, seeds, draw) for i in pair))
        agree(flat(x, y))
    # twin: a digital shift, the same for all points
    x, y = (np.uint32(i * 0x9E3779B1 % 2**32) ^ seeds for i in pair)
    disagree(flat(*after_the_split(x, y)))


def welch(a, b):
    """Verdict on the means of two samples."""
    t = stats.ttest_ind(a, b, equal_var=False)
    return single(normal_scores(t.statistic, t.df))


# ------------------------------------------------------------------ the curve


def test_scrambling_is_undone():
    """Exact, in the lowest 16 bits, of which no place along a curve has more."""
    x, key = np.random.default_rng(2).integers(2**32, size=(2, 4096), dtype=np.uint32)
    found = sobol.owen_inverse(mi.UInt32(x), mi.UInt32(key))
    again = sobol.owen(found, mi.UInt32(key)).numpy()
    assert np.array_equal(again & 0xFFFF, x & 0xFFFF)
    assert not np.array_equal(found.numpy() & 0xFFFF, x & 0xFFFF)


@pytest.mark.parametrize(
    ("base", "bits"),
    [(0, 0), (0, 4), (0, 14), (0, 17), (7, 0), (8, 2), (2**20, 9), (2**32 - 2**12, 12)],
)
def test_the_curve_meets_each_point_once(base, bits):
    """Exact, of any aligned block: in the order of the leading digits of both numbers.

    And the three digits behind tell the eighth of the place. The last digits of some
    blocks depend on those before, and tell no points apart.
    """
    seeds = [1, 99]
    tables = curve.curve_tables(base, bits, mi.UInt32(seeds), len(seeds))
    place = dr.arange(mi.UInt32, 2**bits)
    leading = leading_digits(*sobol.FOOTPRINT, bits)
    assert leading == bits or bits in (4, 14, 17)
    for number, seed in enumerate(seeds):
        index, eighth = curve.on_curve(tables, place, mi.UInt32(number), base, bits)
        met = np.sort(index.numpy().astype(np.int64))
        assert np.array_equal(met, np.arange(base, base + 2**bits))
        x, y = (numbers(index.numpy(), seed, draw) for draw in (0, 1))
        digits = np.zeros(2**bits, np.int64)
        for digit in range(leading + 3):
            coordinate = (x, y)[digit % 2]
            digits = digits << 1 | (coordinate >> np.uint32(31 - digit // 2) & 1)
        wanted = place.numpy().astype(np.int64) >> (bits - leading)
        assert np.array_equal(digits >> 3, wanted)
        # first, half, second: along one half of the place, and back along the other
        way = np.array([[0, 1, 7, 6], [2, 3, 5, 4]]).ravel()
        assert np.array_equal(way[digits & 7], eighth.numpy())


@pytest.mark.parametrize(
    ("n", "shift"), [(6, 0), (255, 0), (256, 1), (300, 1), (4 * MAX_SEQUENCES, 1)]
)
def test_groups_are_sorted_by_a_digit(n, shift):
    """Exact, and stable, also in groups of no power of two; of large ones by half."""
    lane = np.arange(n * max(2, 10_000 // n), dtype=np.uint32)
    digit = np.random.default_rng(5).integers(8, size=lane.size, dtype=np.uint32)
    digit[:n] = 7  # all in one group alike
    (found,) = curve.sorted_within(n, mi.UInt32(digit), mi.UInt32(lane))
    assert np.array_equal(found.numpy(), np.lexsort((lane, digit >> shift, lane // n)))


def test_as_many_batches_as_may_share_a_launch():
    """Each point is met once where four of each batch are at one place."""
    n = MAX_SEQUENCES
    sampler = loaded(seed=mi.UInt32(range(n)), n=16 * n)
    sequence, number = (x.numpy().astype(int) for x in sampler.follow(Curve(0, 16, n)))
    assert np.array_equal(np.sort(16 * sequence + number), np.arange(16 * n))


@pytest.mark.parametrize(
    ("start", "n"),
    [(0, 1), (0, 2**10), (0, 1000), (7, 1), (12_345, 3210), (2**20 - 100, 300)],
)
def test_stretches_of_the_curve_meet_each_point_once(start, n):
    """Exact, wherever a wavefront begins and ends in the sequences.

    With its own numbers; of 1000 points and more those in a row are neighbours.
    """
    given = {"seed": mi.UInt32([5, 6, 7]), "n": 3 * n, "start": start}
    apart = draw_all(loaded(**given))
    whole = Curve(start, start + n, 3)
    bounds = [*range(0, whole.rays, whole.rays // 3), whole.rays]
    met = []
    for first, last in pairwise(bounds):
        sampler = loaded(**given)
        sequence, number = (
            x.numpy().astype(int) for x in sampler.follow(whole.stretch(first, last))
        )
        wanted = (number >= 0) & (number < n)
        place = (sequence * n + number)[wanted]
        together = draw_all(sampler)[:, wanted]
        assert np.array_equal(together, apart[:, place])
        if place.size >= 1000:
            steps = np.hypot(*np.diff(together[:2], axis=1))
            assert np.median(steps) < 3 / np.sqrt(n)
            assert np.median(np.hypot(*np.diff(apart[:2], axis=1))) > 3 / np.sqrt(n)
        met += place.tolist()
    assert sorted(met) == [*range(3 * n)]


@pytest.mark.parametrize(
    ("begin", "end"), [(0, 1), (0, 2**20), (5, 6), (4096, 125_000), (2**32 - 9, 2**33)]
)
def test_curves_are_worth_a_block_about_them(begin, end):
    """Exact; blocks about what straddles their borders would be mostly empty."""
    found = list(curves(begin, end, 8, 2))
    assert [one.begin for one in found] == [begin, *(one.end for one in found[:-1])]
    assert found[-1].end == end
    for one in found:
        assert one.rays < 2 * 8 * (one.end - one.begin)
        assert one.end - one.begin <= 2**27


# ------------------------------------------------------------------ the sampler


def loaded(name="sobol", seed=0, n=64, start=0):
    sampler = mi.load_dict({"type": name})
    sampler.start = start
    sampler.seed(seed, n)
    return sampler


def test_numbers_stay_below_one():
    assert sobol.fraction(mi.UInt32(2**32 - 1))[0] == 1 - 2.0**-24
    assert sobol.fraction(mi.UInt32(0))[0] == 0


def test_a_sequence_continues():
    whole = draw_all(loaded(n=1000))
    parts = [draw_all(loaded(n=n, start=s)) for s, n in ((0, 300), (300, 700))]
    assert np.array_equal(np.hstack(parts), whole)
    advanced = loaded(n=500)
    first = draw_all(advanced)
    advanced.advance()
    assert np.array_equal(np.hstack([first, draw_all(advanced)]), whole)
    assert not np.array_equal(draw_all(loaded(n=1000, seed=1)), whole)


def test_the_samplers_own_seed_is_added():
    sampler = mi.load_dict({"type": "sobol", "seed": 3}).fork()
    sampler.seed(4, 64)
    assert np.array_equal(draw_all(sampler), draw_all(loaded(seed=7)))


def test_clone_and_fork():
    sampler = loaded()
    sampler.next_2d()
    clone = sampler.clone()
    assert clone.wavefront_size() == 64
    assert np.array_equal(draw_all(clone), draw_all(sampler))
    fork = sampler.fork()
    assert fork.wavefront_size() == 0
    fork.seed(0, 64)
    assert np.array_equal(draw_all(fork), draw_all(loaded()))


@dr.syntax
def sum_in_loop(sampler, events):
    """Sum of 4 numbers of each of several events, differently weighted."""
    i = mi.UInt32(0)
    total = mi.Float(0)
    while i < events:
        x = sampler.next_1d()
        p = sampler.next_2d()
        total += (x + 2 * p.x + 4 * p.y + 8 * sampler.next_1d()) * mi.Float(i + 1)
        i += 1
    return total


@pytest.mark.parametrize("symbolic", [True, False])
def test_loops_draw_the_same_numbers(symbolic):
    events = dr.arange(mi.UInt32, 64) % 9
    with dr.scoped_set_flag(dr.JitFlag.SymbolicLoops, symbolic):
        total = sum_in_loop(loaded(), events).numpy()
    rows = draw_all(loaded(), (1, 2, 1) * 8).reshape(8, 4, 64)
    weights = np.array([1, 2, 4, 8])[:, None]
    terms = (rows * weights).sum(axis=1) * np.arange(1, 9)[:, None]
    expected = [terms[:k, i].sum() for i, k in enumerate(events.numpy())]
    # four roundings an event of sums of at most 540
    np.testing.assert_allclose(total, expected, atol=32 * 540 * 2.0**-24)


def brightness(sampler, seeds=24):
    """Mean radiance of a scene of many bounces by Mitsuba's path tracer, each seed."""
    scene = mi.cornell_box()
    scene["integrator"] = {"type": "path", "max_depth": 12, "rr_depth": 4}
    film = {"type": "hdrfilm", "width": 8, "height": 8}
    scene["sensor"] |= {"film": film, "sampler": sampler}
    scene = mi.load_dict(scene)
    images = [mi.render(scene, spp=256, seed=seed) for seed in range(seeds)]
    return np.array([np.mean(np.array(image)) for image in images])


def test_mitsubas_path_tracer_renders_the_same():
    sobol = type(mi.load_dict({"type": "sobol"}))

    class Stuck(sobol):
        """Twin: draws the same two numbers again at each event."""

        def next_1d(self, active=True):
            self.draw = 0 * self.draw
            return super().next_1d(active)

    mi.register_sampler("stuck", Stuck)
    reference = brightness({"type": "independent"})
    agree(welch(brightness({"type": "sobol"}), reference))
    disagree(welch(brightness({"type": "stuck"}), reference))


# ------------------------------------------------------------------ any sampler


def at_most_random(rows):
    """Verdict on the joint distribution of each three of `rows` in [0, 1)."""
    n_cells, p = 8, []
    for three in combinations(rows, 3):
        cell = np.ravel_multi_index([(x * n_cells).astype(int) for x in three], [8] * 3)
        counts = np.bincount(cell, minlength=n_cells**3)
        p.append(stats.chisquare(counts).pvalue)
    return Verdict({"worst of three": min(1.0, min(p) * len(p))}, len(p))


def wavefront(name, n):
    return draw_all(sampling.seeded(mi.load_dict({"type": name}), [(1, 2)], 0, n))


def test_seeds_are_those_of_numpy():
    """Exact, of small and large numbers in any order; twin: with one bit changed."""
    rng = np.random.default_rng(1)
    for length in range(1, 9):
        bits = rng.integers(0, 64, (50, length), dtype=np.uint64)
        numbers = rng.integers(0, 2**64, bits.shape, dtype=np.uint64) >> bits
        keys = [(0,) * length, *map(tuple, numbers.tolist())]
        keys += [(2**96 + 1,) * length] * (length > 4)
        own = [np.random.SeedSequence(key).generate_state(1)[0] for key in keys]
        np.testing.assert_array_equal(sampling._seeds(keys), own)
        changed = [(key[0] ^ 1, *key[1:]) for key in keys]
        assert np.all(sampling._seeds(changed) != own)


SAMPLERS = ["independent", "stratified", "multijitter", "orthogonal", "sobol"]


@pytest.mark.parametrize("n", [2**18, 200_001])
@pytest.mark.parametrize("name", SAMPLERS)
def test_numbers_of_a_ray_are_jointly_uniform(name, n):
    rows = wavefront(name, n)
    assert rows.max() < 1
    agree(at_most_random(rows))


@pytest.mark.parametrize("name", ["stratified", "multijitter", "ldsampler"])
def test_short_sequences_are_not_jointly_uniform(name):
    """Twin: Mitsuba's default, one sequence of four points for each ray."""
    sampler = mi.load_dict({"type": name})
    sampler.seed(0, 2**18)
    disagree(at_most_random(draw_all(sampler)))


def test_ldsampler_is_not_jointly_uniform_as_one_sequence(monkeypatch):
    """The reason why it is refused."""
    monkeypatch.setattr(sampling, "OF_FIXED_SIZE", ("ldsampler",))
    disagree(at_most_random(wavefront("ldsampler", 2**18)))


@pytest.mark.parametrize(
    ("sampler", "reason"),
    [
        ("ldsampler", "must not be ldsampler: it repeats one pattern"),
        ({"type": "stratified", "jitter": False}, "must have jitter on"),
        ({"type": "multijitter", "jitter": False}, "must have jitter on"),
        ({"type": "orthogonal", "jitter": False}, "must have jitter on"),
    ],
)
def test_samplers_that_measure_wrongly_are_refused(sampler, reason):
    with pytest.raises(gonio.SpecimenError, match=reason):
        gonio.measure({"type": "diffuse"}, 30, rays=1000, sampler=sampler)


# ------------------------------------------------------------------ measurements


def test_the_best_dimensions_go_to_the_scattering_with_any_footprint():
    """Exact: where light lands is of no importance to a BSDF without textures."""
    settings = {"theta_i": 30, "rays": 10_000}
    full, point = (
        gonio.measure(PLASTIC, **settings, footprint=f) for f in ("full", "point")
    )
    assert full.settings["sampler"] == "sobol"
    assert full.tallies == point.tallies


@pytest.mark.filterwarnings("ignore:the specimen lies up to 1001 scene units")
@pytest.mark.parametrize(
    ("rays", "batches"), [(299_998, 16), (499_998, 16), (420_007, 7)]
)
def test_the_clock_decides_about_no_bit(monkeypatch, rays, batches):
    """Exact: rays of a mirror field on a machine that is idle, and under load.

    Batches are 0.57 and 0.95 of their block of points, or 0.92 of one that whole chunks
    do not fill. Launches are cut elsewhere; rays within rounding of an edge, of which
    there are many far from the origin, stay in their packets. The twin cuts launches
    anywhere.
    """
    bsdf = {"type": "twosided", "bsdf": {"type": "conductor"}}
    hills = {"type": "heightfield", "alpha": 0.5, "resolution": 64, "bsdf": bsdf}
    hills["to_world"] = mi.ScalarTransform4f().translate([1000, 1000, 0])
    settings = {"theta_i": 60, "rays": rays, "batches": batches, "period": "box"}
    send, rate, sent = launcher.launch, [], []

    def timed(*arguments):
        totals = send(*arguments)
        sent.append(totals.emitted)
        started = time.perf_counter() - totals.emitted / rate[0]
        monkeypatch.setattr(type(totals), "started", started)
        return totals

    def hits(speed):
        rate[:], sent[:] = [speed], []
        record = gonio.measure(hills, **settings)
        return len(sent), record.tallies[0]

    monkeypatch.setattr(launcher, "launch", timed)
    n_whole, whole = hits(1e8)
    for speed in (9999, 60_000):
        n_parts, parts = hits(speed)
        assert n_parts >= n_whole + 2
        assert parts == whole

    def anywhere(whole, _):
        bounds = [*range(0, whole.rays, 9999), whole.rays]
        return itertools.starmap(whole.stretch, pairwise(bounds))

    monkeypatch.setattr(Curve, "cut", anywhere)
    assert hits(9999)[1] != whole


@pytest.mark.parametrize("seed", [3, 4])
def test_a_single_ray_along_a_curve(seed):
    """Exact: it passes by the ball or meets it; with half of the seeds it was lost."""
    ball = {"type": "sphere", "bsdf": {"type": "conductor"}}
    settings = {"rays": 1, "batches": 1, "collector": "angle:1x1", "period": "box"}
    assert gonio.measure(ball, 30, seed=seed, **settings).ledger.emitted == 1


@pytest.mark.parametrize("trace", [False, True])
def test_launches_of_any_length_have_the_same_bits(monkeypatch, trace):
    """Exact; down to the slowest machine there is, with launches of 1024 rays.

    With batches of unequal size, together or alone. Twin: independent random numbers
    are those of another launch.
    """
    settings = {"theta_i": 60, "rays": 20_003, "batches": 7, "trace": trace}
    random = settings | {"sampler": "independent"}
    sent = []
    send = launcher.launch

    def heard(*arguments):
        totals = send(*arguments)
        sent.append(totals.emitted)
        return totals

    monkeypatch.setattr(launcher, "launch", heard)
    whole = gonio.measure(PLASTIC, **settings)
    assert sent == [20_003]
    one = gonio.measure(PLASTIC, **random)
    for limits in (
        {"FUSED_RAYS": 5000},
        {"FUSED_SUMS": 0},
        {"MAX_LAUNCH": 1000},
        {"FUSED_RAYS": 2048, "LAUNCH_SECONDS": 1e-9}
        | {"FIRST_TRACED": 2000, "FIRST_PLANE": 2000},
    ):
        for name, value in limits.items():
            monkeypatch.setattr(launcher, name, value)
        sent.clear()
        assert gonio.measure(PLASTIC, **settings).tallies == whole.tallies
        assert sum(sent) == 20_003
        assert len(sent) > 1
    assert sent[0] <= (2048 if trace else 2000)
    assert max(sent[1:]) <= 1024
    assert gonio.measure(PLASTIC, **random).tallies != one.tallies


@pytest.mark.parametrize("estimator", ["weighted", "analog"])
def test_points_that_share_words_have_the_same_bits(monkeypatch, estimator):
    """Exact: in launches that begin and end anywhere, up to the end of the sequence.

    Down to a batch of fewer points than a lane has. Twin: rays of one lane that all
    have the numbers of the first.
    """
    settings = {"theta_i": 60, "estimator": estimator}
    sizes = [(20_003, 7), (5, 1), (33, 2), (1, 1)]

    def tallies():
        measured = (
            gonio.measure(PLASTIC, rays=rays, batches=batches, **settings)
            for rays, batches in sizes
        )
        return [record.tallies for record in measured]

    apart = tallies()
    together = sampling.points_per_lane(2**30)
    assert together == 2**sobol.BESIDE_BITS
    monkeypatch.setattr(sampling, "MIN_SHARING_LANES", 1)
    assert tallies() == apart
    for name in ("FUSED_RAYS", "FIRST_PLANE", "MAX_LAUNCH"):
        monkeypatch.setattr(launcher, name, 1003)
    assert tallies() == apart
    monkeypatch.setattr(sobol, "BESIDE_BITS", 0)
    assert tallies() != apart


def test_a_lane_sends_each_point_once_at_the_end_of_a_sequence():
    """Exact: the last points of 2**32, from any of those that a lane draws for."""
    for before, n in itertools.product((1, 5, 21, 40), (1, 4, 16)):
        sampler = mi.load_dict({"type": "sobol"})
        start = 2**32 - before
        lanes = -(-(before + start % n) // n) + 1
        sampler = sampling.seeded(sampler, [(1,)], start, lanes)
        sent = dr.zeros(mi.UInt32, before + 1)

        def add(sampler, ray, sent=sent, before=before, start=start):
            right = (sampler.index ^ sampler.beside) == ray + start
            place = dr.select(right & (ray < before), ray, before)
            dr.scatter_add(sent, mi.UInt32(1), place)

        lane = dr.arange(mi.UInt32, lanes)
        sampling.in_points_beside(add, sampler, lane, n)
        assert sent.numpy()[:before].tolist() == [1] * before


@pytest.mark.parametrize("rate", [1e2, 1e5, 3e6, 1e9])
def test_ctrl_c_is_heard_after_a_second(monkeypatch, rate):
    """By a clock of our own, at `rate` rays a second; but for the first launches."""
    clock = [0.0]

    monkeypatch.setattr(launcher.time, "perf_counter", lambda: clock[0])
    ours, begin, end = LaunchSize(2**18), 2**32 - 10**6, 2**32 + int(20 * rate)
    parts, ends = [], []
    while begin < end:
        parts.append(ours.next_part(begin, end, 2**40))
        begin += parts[-1]
        clock[0] += 60  # it is compiled
        started = clock[0]
        clock[0] += 1e-6 + parts[-1] / rate
        ours.learn(parts[-1], started)
        ends.append(clock[0] - started)
    assert sum(parts) == end - (2**32 - 10**6)
    assert 2**32 in np.cumsum(parts) + 2**32 - 10**6
    assert max(ends[6:]) <= max(1.001, 1024 / rate + 1e-6)


def two_lobes(sampler, seed=0):
    settings = {"estimator": "analog", "rays": 10**6, "collector": "projected:10x10"}
    return gonio.measure(PLASTIC, 50, sampler=sampler, seed=seed, **settings)


@cache
def two_lobes_of_independent_rays():
    return two_lobes("independent", 1)


@pytest.mark.parametrize("name", ["stratified", "multijitter", "orthogonal", "sobol"])
def test_two_lobes_as_with_independent_rays(name, monkeypatch):
    """Twin: Mitsuba's default of one sequence of four points for each ray."""
    random = two_lobes_of_independent_rays()
    agree(verdict(difference_scores(two_lobes(name), random)))
    if name == "stratified":
        monkeypatch.setattr(sampling, "OF_FIXED_SIZE", ())
        disagree(verdict(difference_scores(two_lobes(name), random)))


def rms_error(sampler, rays):
    diffuse = {"type": "diffuse"}
    record = gonio.measure(diffuse, 30, rays=rays, sampler=sampler, batches=4)
    reference = 0.5 / np.pi
    return np.sqrt(np.mean((record.brdf / reference - 1) ** 2))


FEW, MANY = 2**14, 2**22


@cache
def slope(sampler):
    """Order of convergence: the root mean square error falls as rays**-slope."""
    ratio = rms_error(sampler, FEW) / rms_error(sampler, MANY)
    return np.log(ratio) / np.log(MANY / FEW)


def test_error_falls_faster_than_that_of_independent_rays():
    """The order of independent rays is 1/2; twin: that of even ones is not.

    A root mean square over 900 patches is certain to 1 / sqrt(1800), and so is the
    logarithm of each of two.
    """
    std_err = np.sqrt(2 / 1800) / np.log(MANY / FEW)
    agree(single((slope("independent") - 0.5) / std_err))
    disagree(single((slope("sobol") - 0.5) / std_err))
    assert slope("sobol") > 0.5


def covered(specimen, truth, rays, estimator, theta_i):
    """Part of the patches whose intervals hold the truth, of each seed.

    Of the intervals, and of four fifths of them.
    """
    settings = {"collector": "projected:10x10", "rays": rays, "estimator": estimator}
    parts = []
    for seed in range(24):
        record = gonio.measure(specimen, theta_i, seed=seed, **settings)
        low, high = record.interval(0.95)
        off, half = np.abs(truth - (low + high) / 2), (high - low) / 2
        parts.append([np.mean(off <= shrink * half) for shrink in (1, 0.8)])
    return np.transpose(parts)


@pytest.mark.parametrize(
    ("estimator", "rays"),
    [("analog", 300), ("weighted", 5000), ("weighted", 100_000)],
)
@pytest.mark.promise("Reliable error bars")
def test_intervals_cover(rays, estimator):
    """With few hits a patch, some, and many; and not a power of two of rays.

    Those of few hits may be too wide. Twin: narrower ones.
    """
    diffuse = {"type": "diffuse", "reflectance": 0.5}
    parts, narrower = covered(diffuse, 0.5 / np.pi, rays, estimator, 30)
    agree(often_enough(parts))
    if rays == 100_000:
        t = stats.ttest_1samp(parts, 0.95).statistic
        agree(single(normal_scores(t, len(parts) - 1)))
        disagree(often_enough(narrower))


def test_intervals_cover_at_grazing_incidence():
    """Where most patches are empty or nearly so; the truth from 200 times the rays."""
    specimen = {"type": "roughconductor", "alpha": 0.1}
    truth = gonio.measure(
        specimen, 85, collector="projected:10x10", rays=2**23, seed=12345
    )
    agree(often_enough(covered(specimen, truth.brdf, 40_000, "weighted", 85)[0]))
    assert np.mean(truth.counts[0] < 2**23 / 40_000) > 0.5


def test_batches_that_agree_are_not_certain():
    """A share of nearly whole rays a batch gives all batches the same sum."""
    agreeing = 0
    for theta_i in np.linspace(5, 80, 40):
        record = gonio.measure(
            {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0},
            theta_i,
            collector="projected:2x2",
            rays=2**20,
            seed=int(theta_i * 10),
        )
        if record.dhr_std_err[0] == 0:
            agreeing += 1
            truth = fresnel(np.cos(np.radians(theta_i)), 1.5)
            low, high = record.interval(0.95, of="dhr")
            assert low[0] <= truth <= high[0]
            # the twin, without the least width
            assert record.dhr[0] != pytest.approx(truth, rel=1e-9)
    assert agreeing > 0

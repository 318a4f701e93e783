"""Intervals cover the truth where it is hard: rare losses, few and unlike deposits.

Each verdict takes a share of the suite's false-alarm budget. `python -m
tests.benchmark --coverage` measures the whole table.
"""

from dataclasses import replace
from functools import cache

import mitsuba as mi
import numpy as np
import pytest
from benchmark import coverage
from benchmark.coverage import CASES, LEVEL, Coverage
from budget import agree, disagree, normal_scores, often_enough, verdict
from scipy import special
from specimens import diffuse_groove_dhr, grooves

import gonio_mi as gonio
from gonio_mi.collector.directions import direction
from gonio_mi.quadrature import integrate
from gonio_mi.results.estimates import SampledEstimate
from gonio_mi.results.statistics import batch_std_err, binomial_interval

SEEDS = 24

NONE = np.zeros(1, bool)  # patches are judged by their own hits alone


# Lobes of which a part is drawn below the horizon: one ray in 9000, 700 and 50.
LOSING = {
    "rarely": ({"type": "glossymixture", "exponent": 16.0}, 50),
    "seldom": ({"type": "glossymixture", "exponent": 16.0}, 60),
    "often": ({"type": "cosinelobe", "exponent": 30.0}, 65),
}


@pytest.mark.parametrize("sampler", ["sobol", "independent"])
@pytest.mark.parametrize("name", LOSING)
def test_all_received_is_no_proof_of_none_lost(name, sampler):
    """Dhr against the integral of `eval`, from 4 batches of 250 rays.

    Twin: Student's t alone, whose batches often agree that nothing was lost.
    """
    bsdf, theta_i = LOSING[name]
    grid, bsdf = gonio.EqualProjectedSolidAngle(4, 4), mi.load_dict(bsdf)
    truth = integrate(bsdf, theta_i, 0, grid).flux.sum()
    covered, students = [], []
    for seed in range(SEEDS):
        record = gonio.measure(
            bsdf,
            theta_i,
            rays=1000,
            batches=4,
            seed=seed,
            sampler=sampler,
            collector=grid,
        )
        low, high = record.interval(LEVEL, of="dhr")
        covered.append(low[0] <= truth <= high[0])
        half = special.stdtrit(3, (1 + LEVEL) / 2) * record.dhr_std_err[0]
        students.append(abs(record.dhr[0] - truth) <= half)
    agree(often_enough(covered))
    if name == "rarely":
        disagree(often_enough(students))


@cache
def glossy(order, name="glossy"):
    """A glossy groove's flux fractions, from 2e6 rays that are waited for."""
    mi.set_variant("llvm_ad_mono")
    how = {"rays": 2**21, "seed": 2**20, "order": order}
    return gonio.measure(CASES[name].specimen(), **CASES["glossy"].settings, **how)


@pytest.mark.parametrize(
    ("order", "rays", "points"), [("2", 1000, 1), ("all", 4000, 96)]
)
def test_deposits_of_glossy_facets_cover(order, rays, points):
    """All patches, and those off the lobes; twin: intervals of half their width."""
    truth = glossy(order).brdf
    lit = truth > 0
    off = lit & (truth < 0.1 * truth.mean())
    case = CASES["glossy"]
    specimen, parts, twins = mi.load_dict(case.specimen()), [], []
    for seed in range(SEEDS):
        record = gonio.measure(
            specimen,
            **case.settings,
            order=order,
            rays=rays,
            seed=seed,
            estimator="next_event",
            points=points,
        )
        low, high = record.interval(LEVEL)
        held = (low <= truth) & (truth <= high)
        parts.append([held[lit].mean(), held[off].mean()])
        near = np.abs((low + high) / 2 - truth) <= (high - low) / 4
        twins.append([near[lit].mean(), near[off].mean()])
    for part, twin in zip(np.transpose(parts), np.transpose(twins)):
        agree(often_enough(part))
        disagree(often_enough(twin))


def test_even_deposits_beside_lobes_cover():
    """Patches that none of 25 rays a batch hits, though their points agree.

    Twin: the interval by Student's t of their own deposits.
    """
    case, truth = CASES["lobes, 96 points"], glossy("all", "lobes, 96 points").brdf
    off = (truth > 0) & (truth < 0.1 * truth.mean())
    specimen, parts, twins = mi.load_dict(case.specimen()), [], []
    for seed in range(SEEDS // 2):
        record = gonio.measure(
            specimen, **case.settings, rays=400, seed=seed, estimator="next_event"
        )
        low, high = record.interval(LEVEL)
        parts.append(((low <= truth) & (truth <= high))[off].mean())
        # of their own: where heavy hits are rare, the record's standard error is more
        (tally,) = record.tallies
        own = batch_std_err(tally.sums[:, 0], tally.incident[:, None, None])
        half = special.stdtrit(15, (1 + LEVEL) / 2) * own
        half = half / record.subdivision.projected_solid_angles[..., None]
        twins.append((np.abs(record.brdf - truth) <= half)[off].mean())
    agree(often_enough(parts))
    disagree(often_enough(twins))


def test_few_hits_of_unlike_weights_cover():
    """Patches of a dark groove: of few hits, some weigh a hundredth of the others.

    Twin: the limits of their count times their mean weight, which they used to be.
    """
    case, rays = CASES["dark"], 1000
    how = case.settings | {"sampler": "independent"}
    specimen, parts, twins = mi.load_dict(case.specimen()), [], []
    truth = gonio.measure(specimen, **how, rays=2**20, seed=2**20).brdf
    for seed in range(SEEDS):
        record = gonio.measure(specimen, **how, rays=rays, seed=seed)
        hits = record.counts[0][..., None]
        few = (hits > 0) & (hits < 100)
        low, high = record.interval(LEVEL)
        parts.append(((low <= truth) & (truth <= high))[few].mean())
        weight = np.where(few, record.brdf / np.maximum(hits, 1), 0) * rays
        low, high = (limit * weight for limit in binomial_interval(hits, rays, LEVEL))
        twins.append(((low <= truth) & (truth <= high))[few].mean())
    agree(often_enough(parts))
    disagree(often_enough(twins))


@pytest.mark.parametrize(
    ("name", "rays"),
    [
        ("spots 0.01", 3000),
        ("spots 0.01", 300_000),
        ("spots 0.05", 10_000),
        ("bright spots", 30_000),
        ("glossy spots", 30_000),
    ],
)
def test_rare_bright_spots_are_covered(name, rays):
    """Patches whose spots were missed; twin: the interval of their own hits alone.

    These tell too little of most patches that have some, and `pooled` says so.
    """
    case = CASES[name]
    specimen, truth = mi.load_dict(case.specimen()), coverage.truth_of(name).brdf
    parts, twins, pooled = [], [], []
    for seed in range(SEEDS // 2):
        record = gonio.measure(specimen, **case.settings, rays=rays, seed=seed)
        pooled.append((record.pooled | record.without_hit).mean())
        for heavy, found in ((True, parts), (False, twins)):
            with pytest.MonkeyPatch.context() as patch:
                if not heavy:
                    patch.setattr(SampledEstimate, "pooled", NONE)
                low, high = replace(record).interval(LEVEL)  # nothing kept
            found.append(((low <= truth) & (truth <= high)).mean())
    agree(often_enough(parts))
    disagree(often_enough(twins))
    assert np.mean(pooled) > 0.5


def test_standard_errors_know_of_spots_that_a_patch_missed():
    """Mean square of all patches' scores: at most 1, but for Student's 15 of 13.

    Twin: the scatter of their own batches, far too small of those without a spot.
    """
    case, truth = CASES["spots 0.01"], coverage.truth_of("spots 0.01").brdf
    specimen, parts, twins = mi.load_dict(case.specimen()), [], []
    for seed in range(SEEDS // 2):
        record = gonio.measure(specimen, **case.settings, rays=30_000, seed=seed)
        (estimates,) = record.estimates
        solid = record.subdivision.projected_solid_angles[..., None]
        own = estimates.patches(0).scatter / solid
        for std_err, found in ((record.brdf_std_err, parts), (own, twins)):
            known = std_err > 0
            score = (record.brdf - truth)[known] / std_err[known]
            found.append(np.mean(score**2))
    assert np.mean(parts) < 15 / 13
    assert np.mean(twins) > 1000


# A square whose vertex normals lean by 30 degrees: the fewer rays are sampled close to
# the horizon of these, the more each weighs there, and nowhere else.
LEANING = """ply
format ascii 1.0
element vertex 4
{}
element face 2
property list uchar int vertex_index
end_header
-1 -1 0 0.5 0 0.866025404
1 -1 0 0.5 0 0.866025404
1 1 0 0.5 0 0.866025404
-1 1 0 0.5 0 0.866025404
3 0 1 2
3 0 2 3
"""


def test_heavy_weights_of_some_directions_are_not_of_others(tmp_path):
    """Normal scores against the closed form, of patches above the leaning horizon.

    The cosine of incidence counts from the leaning normal. Twin: standard errors of at
    least the mean square of a hit in all patches, each patch counted alike.
    """
    path, names = tmp_path / "leaning.ply", ["x", "y", "z", "nx", "ny", "nz"]
    path.write_text(LEANING.format("\n".join(f"property float {n}" for n in names)))
    bsdf = {"type": "diffuse", "reflectance": 0.5}
    mesh = {"type": "ply", "filename": str(path), "bsdf": bsdf}
    normal = np.sin(np.pi / 6), np.cos(np.pi / 6)
    incident = np.sin(np.radians(50)), np.cos(np.radians(50))
    truth = 0.5 / np.pi * np.dot(normal, incident) / incident[1]
    grid = gonio.EqualAngle(6, 8)
    corners = direction(grid.theta_edges[:, None], grid.phi_edges)
    above = corners @ (normal[0], 0, normal[1]) > 0
    inside = above[:-1, :-1] & above[1:, :-1] & above[:-1, 1:] & above[1:, 1:]
    right, wrong = [], []
    for seed in range(8):
        settings = {"rays": 10**5, "sampler": "independent", "seed": seed}
        record = gonio.measure(mesh, 50, collector=grid, **settings)
        off = (record.brdf - truth) * grid.projected_solid_angles[..., None]
        (one,) = record.estimates
        hits = one.hits[0][..., None]
        square = np.mean((one.patches(0).std_err ** 2 / hits)[hits > 0])
        for scores, least in ((right, 0), (wrong, np.sqrt(square * hits))):
            std_err = np.fmax(one.patches(0).std_err, least)[inside]
            scores += normal_scores(off[inside] / std_err, 15).tolist()
    agree(verdict(right))
    disagree(verdict(wrong))


@pytest.mark.parametrize("sampler", ["sobol", "independent"])
@pytest.mark.parametrize(
    "bsdf",
    [
        {"type": "diffuse"},
        {"type": "roughconductor", "alpha": 0.2},
        {"type": "roughplastic", "alpha": 0.2},
        {"type": "roughdielectric", "alpha": 0.3},
    ],
    ids=lambda bsdf: bsdf["type"],
)
def test_plain_specimens_pay_nothing(monkeypatch, bsdf, sampler):
    """Of 1e5 rays, intervals are as wide as those of a patch's own hits, within 5 %."""
    record = gonio.measure(
        bsdf, theta_i=45, collector="projected:30x30", rays=10**5, sampler=sampler
    )
    widths = []
    for _ in range(2):
        low, high = replace(record).interval(LEVEL)  # nothing kept
        widths.append(high - low)
        monkeypatch.setattr(SampledEstimate, "pooled", NONE)
    assert np.mean(widths[0] / widths[1]) < 1.05
    assert widths[0].sum() < 1.05 * widths[1].sum()
    if bsdf["type"] == "diffuse":
        assert not record.pooled.any()


def test_no_deposit_weighs_more_than_rays():
    """Rays and points together scatter less than twice as much as rays alone.

    A point adds at most what a ray carries. Points alone had 36 times the mean square
    error of both over all patches of this groove, and 150 times off its lobes.
    """
    case, squares = CASES["glossy"], {}
    for estimator in ("weighted", "next_event"):
        record = gonio.measure(
            case.specimen(),
            **case.settings,
            rays=2**14,
            batches=64,
            seed=1,
            estimator=estimator,
            sampler="independent",
        )
        squares[estimator] = np.nansum(record.brdf_std_err**2)
    assert squares["next_event"] < 2 * squares["weighted"]


@pytest.mark.parametrize("estimator", ["analog", "weighted"])
def test_the_benchmark_finds_nominal_coverage(estimator):
    """A small share of its table; twin: the truth of a specimen 10 % darker."""
    found = coverage.coverage("flat", estimator, "independent", 10_000, repeats=20)
    assert not any(found.warned)
    for part in found.covered.values():
        agree(often_enough(part))
    truth = gonio.measure(
        {"type": "glossymixture", "diffuse_reflectance": 0.45},
        **CASES["flat"].settings,
        estimator="quadrature",
    )
    record = gonio.measure(
        CASES["flat"].specimen(),
        **CASES["flat"].settings,
        rays=10_000,
        estimator=estimator,
    )
    wrong = Coverage()
    for _ in range(20):
        wrong.add(record, truth, warned=False)
    assert wrong.mean("dhr")[0] == 0
    disagree(often_enough(wrong.covered["dhr"]))


@pytest.mark.parametrize("estimator", ["next_event", "weighted"])
def test_few_rays_of_a_small_near_emitter_cover(estimator):
    """Exact by symmetry: half of the light falls on either half of the plate.

    Most of it is in the batch that has the ray nearest to the emitter. Twin: Student's
    t of batches as if all of them had as much.
    """
    case = CASES["near emitter"]
    specimen, covered, students = mi.load_dict(case.specimen()), [], []
    for seed in range(3 * SEEDS // 2):
        how = case.settings | {"estimator": estimator, "rays": 300, "seed": seed}
        record = gonio.measure(specimen, **how)
        low, high = record.interval(LEVEL, of="dhr")
        covered.append(low[0] <= 0.5 <= high[0])
        (tally,) = record.tallies
        own = batch_std_err(tally.sums[:, 0].sum(axis=(1, 2)), tally.incident)
        half = special.stdtrit(15, (1 + LEVEL) / 2) * own[0]
        students.append(abs(record.dhr[0] - 0.5) <= half)
    agree(often_enough(covered))
    disagree(often_enough(students))


def bright_texel(rest):
    """One texel in 100 x 100 reflects all light, the others `rest`."""
    texels = np.full((100, 100, 1), rest, np.float32)
    texels[3, 7] = 1.0
    texture = {"type": "bitmap", "data": mi.TensorXf(texels), "raw": True}
    return {"type": "diffuse", "reflectance": texture | {"filter_type": "nearest"}}


HOLE = {"type": "mask", "opacity": 0.999, "bsdf": {"type": "diffuse"}}
DARK_GREY = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": 0.3}}
CELL = {"period": "box"}
# specimen, total, its truth, rays for each hit, settings
FEW_HITS = {
    "weighted": (HOLE, "dht", 1e-3, 1000, {"hemispheres": "both"}),
    "analog": (
        {"type": "diffuse", "reflectance": 1e-3},
        "dhr",
        1e-3,
        1000,
        {"estimator": "analog"},
    ),
    "counted": (
        {"type": "diffuse", "reflectance": 1e-3},
        "dhr",
        1e-3,
        1000,
        {"estimator": "analog", "sampler": "independent"},
    ),
    "texel": (0.0, "dhr", 1e-4, 10_000, {}),
    "texel on grey": (1e-3, "dhr", 1e-3 + 0.999e-4, 10_000, {}),
    "next_event": (None, "dhr", None, 5, {"estimator": "next_event"} | CELL),
    "split": (None, "dhr", None, 5, {"estimator": "split"} | CELL),
}


def few_hits(name, hits):
    """Specimen, total and its truth, and settings with rays for so many hits."""
    specimen, of, truth, rays, how = FEW_HITS[name]
    if isinstance(specimen, float):
        specimen = bright_texel(specimen)
    if specimen is None:
        specimen = grooves(40.0, 1, bsdf=DARK_GREY)
        truth = diffuse_groove_dhr(40.0, 30.0, 0.3)
    return (
        specimen,
        of,
        truth,
        how | {"rays": hits * rays, "collector": "projected:4x6"},
    )


@pytest.mark.parametrize("hits", [3, 24, 100])
@pytest.mark.parametrize("name", FEW_HITS)
def test_totals_of_few_hits_cover(name, hits):
    """Against closed forms; twin: intervals of half their width."""
    specimen, of, truth, how = few_hits(name, hits)
    specimen, covered, twins = mi.load_dict(specimen), [], []
    for seed in range(2 * SEEDS):
        (low,), (high,) = gonio.measure(specimen, 30, seed=seed, **how).interval(of=of)
        covered.append(low <= truth <= high)
        twins.append(abs((low + high) / 2 - truth) <= (high - low) / 4)
    agree(often_enough(covered))
    if name == "counted" and hits > 3:
        disagree(often_enough(twins))

"""``gonio-mi bsdf``: what a file says of a specimen is what the specimen does."""

import json
import re
import subprocess
from pathlib import Path

import blinds
import mitsuba as mi
import numpy as np
import pytest
import synthetic
from budget import ENOUGH_HITS, Verdict, agree, disagree, normal_scores, verdict
from scipy import stats

import gonio_mi as gonio
from gonio_mi import cli
from gonio_mi.collector.klems import Klems
from gonio_mi.collector.shirley_chiu import ShirleyChiu
from gonio_mi.exchange.exports import exporting, radiance_export
from gonio_mi.exchange.exports.bsdf_file import properties
from gonio_mi.exchange.exports.loss import Loss, in_words
from gonio_mi.exchange.formats import radiance, radiance_basis, tensor_tree
from gonio_mi.exchange.formats.radiance import RadianceBSDF
from gonio_mi.materials import resampling
from gonio_mi.specimen.specimen_text import parse_specimen

KLEMS = Klems()
OMEGA = KLEMS.projected_solid_angles
FULL = radiance_basis.Basis.named("klems", 0)

# Seven digits in the file, or six in its trees.
DIGITS = 1e-6
TREE_DIGITS = 1e-5

# One slat of a venetian blind for each period, and the same seen from below.
BLIND = [blinds.Slat(0, 0.0, 0.0, 0.9, 40.0)]
UPSIDE_DOWN = [blinds.Slat(0, 0.0, 0.0, 0.9, -40.0)]
RHO = 0.6

# Index of refraction of Mitsuba's glass, bk7, in air.
GLASS = 1.5046 / 1.000277

TAU_RHO, ENDS, N_BATCHES = ("tau", "rho"), ("", "_std_err"), 8

one_sided = pytest.mark.filterwarnings("ignore:the file describes light from")


def loaded(path, of=radiance.read):
    with open(path, "rb") as stream:
        return of(stream)


def columns(path):
    """Light of each incident patch in each exit patch, by block of a file."""
    blocks = loaded(path)
    return {name: block * OMEGA for (_, name), block in blocks.items()}


# ---------------------------------------------------------------------- light is kept


def narrow(share, theta_i=(0, 20, 40, 60, 80), collector="projected:30x30"):
    """Record of a pane: `share` of the light goes on in the patch straight on."""
    patches = gonio.subdivision(collector)
    weights = np.zeros((len(theta_i), 2, *patches.shape))
    for (_, through), theta in zip(weights, theta_i):
        x, z = np.sin(np.radians(theta)), np.cos(np.radians(theta))
        through.flat[int(patches.patch([-x, 0, z]))] = share(theta)
    return synthetic.exact(weights, theta_i, collector)


def linear(theta, theta_i, values):
    return np.interp(np.sin(theta), np.sin(np.radians(theta_i)), values)


@pytest.mark.parametrize("collector", ["projected:30x30", "projected:90x180", "klems"])
@one_sided
def test_a_delta_lands_whole(tmp_path, monkeypatch, collector):
    """In the opposite patch, and nothing is lost or made: exact up to rounding."""
    monkeypatch.setattr(radiance_export, "POINTS_OUT", 2)
    theta_i = (0, 20, 40, 60, 80)
    share = {0: 0.92, 20: 0.92, 40: 0.91, 60: 0.84, 80: 0.44}
    record = narrow(share.get, theta_i, collector)
    exporting.export(record, tmp_path / "pane.xml")
    light = columns(tmp_path / "pane.xml")["Transmission Back"]
    assert np.array_equal(light.argmax(axis=0), np.arange(145))  # by the way of flight
    assert np.allclose(light.max(axis=0), light.sum(axis=0), rtol=DIGITS)
    theta = np.arccos(KLEMS.points(radiance_export.POINTS_IN)[..., 2])
    expected = linear(theta, theta_i, list(share.values())).mean(axis=1)
    # single precision of the angles near the horizon
    assert np.allclose(light.sum(axis=0), expected, rtol=1e-4)


def points_of_incidence(basis, theta_i):
    """Polar angles in radians of the points of incidence of the patch of an angle."""
    rank, n = radiance_basis.RANKS.get(basis), radiance_export.CELL_POINTS
    if rank is None:
        own = radiance_basis.Basis.named(basis, 0)
        points = own.patches.points(radiance_export.POINTS_IN)
        return np.arccos(points[own.incident_patch(theta_i, 0), :, 2])
    size, up = radiance_export.TREE_SIZES[rank], np.array([[0, 0, 1.0]])
    place = tensor_tree.coordinates(rank, theta_i, 0.0, up)[0, : rank - 2]
    cell = tuple((place * size).astype(int))
    if rank == 3:
        return np.radians(tensor_tree.isotropic_incidence(size, n)[cell])
    points = ShirleyChiu(size).points(n)[np.ravel_multi_index(cell, (size, size))]
    return np.arccos(points[:, 2])


@pytest.fixture
def every_cell(monkeypatch):
    """Trees whose cells are merged only if they are alike to the last bit."""
    merged = tensor_tree._merged
    monkeypatch.setattr(tensor_tree, "_merged", lambda values, _: merged(values, 0))


@pytest.mark.usefixtures("mono", "every_cell")
@pytest.mark.parametrize("basis", ["klems-half", "tensor3", "tensor4"])
@one_sided
@pytest.mark.filterwarnings("ignore:the front is not reciprocal")  # of few points
def test_every_basis_keeps_the_light_of_narrow_lobes(tmp_path, monkeypatch, basis):
    """Of a sharp lobe, narrower than the points of the patches: exact up to rounding.

    The file holds the mean, over points of a patch of incidence, of the record's
    totals, linear in the sine between its angles; twin: not those of its very angles.
    """
    monkeypatch.setattr(radiance_export, "POINTS_IN", 2)
    monkeypatch.setattr(radiance_export, "POINTS_OUT", 2)
    monkeypatch.setattr(radiance_export, "TREE_SIZES", {3: 16, 4: 8})
    lacquer = {"type": "roughconductor", "alpha": 0.02, "eta": 1.5, "k": 0.0}
    theta_i = (0, 30, 60, 80)
    record = gonio.measure(lacquer, theta_i, collector="solid:40x20", rays=2**12)
    losses = exporting.export(record, tmp_path / "lacquer.xml", basis)
    assert [loss.theta_i for loss in losses] == pytest.approx(theta_i)
    written = [loss.written for loss in losses]
    points = [points_of_incidence(basis, theta) for theta in theta_i]
    expected = [linear(one, theta_i, record.dhr[:, 0]).mean() for one in points]
    digits = TREE_DIGITS if basis in radiance_basis.RANKS else DIGITS
    assert np.allclose(written, expected, rtol=digits)
    assert not np.allclose(written, record.dhr[:, 0], rtol=0.1)
    assert all(0 <= loss.misplaced <= 1 for loss in losses)
    lines = in_words(losses)
    assert lines[0].startswith("front, reflected: ")
    assert "is in neighbouring patches, at worst" in lines[0]


def test_what_hardly_any_light_does_is_left_out_of_the_words():
    """Beyond total reflection all is misplaced; twin: with light there it is told."""
    bright = Loss(0, 0, "dht", 0.9, 0, 0.88, 0.1, 0)
    for light, told in ((1e-6, "10.0%"), (0.1, "55.0%")):
        (line,) = in_words([bright, Loss(73, 0, "dht", light, 0, light, 1.0, 0)])
        assert line.startswith(f"front, transmitted: {told} of the flux")
        assert line.endswith("faint directions left out") == (light < 1e-3)
        assert "total off by 0.02 at theta_i 0, phi_i 0, the most of 2 incident" in line


def test_totals_are_off_by_no_more_than_is_said():
    """At rough glass from inside, by one digit, 0.1457 was at most 0.1."""
    losses = [
        Loss(t, 0, "dht", 0.6, 0, 0.6 - e, 0, 0) for t, e in [(0, 0), (37, 0.1457)]
    ]
    (line,) = in_words(losses)
    assert "total off by 0.15 at theta_i 37, phi_i 0, the most of 2 incident" in line
    assert in_words(losses[1:])[0].endswith("theta_i 37, phi_i 0; total off by 0.15")


@one_sided
def test_twin_points_alone_lose_the_delta(tmp_path, monkeypatch):
    """Without the peaks apart and light carried, a sliver of a patch is missed."""
    record = narrow(lambda _: 0.9, collector="projected:90x180")
    monkeypatch.setattr(resampling, "MAX_MISSED", 1e9)
    monkeypatch.setattr(
        radiance_export,
        "specular_peaks",
        lambda record: np.zeros((len(record), 2, 1)),
    )
    monkeypatch.setattr(radiance_export, "POINTS_OUT", 2)
    exporting.export(record, tmp_path / "pane.xml", "klems-quarter")
    light = loaded(tmp_path / "pane.xml")["Visible", "Transmission Back"]
    light = light * Klems("quarter").projected_solid_angles
    assert not np.allclose(light.sum(axis=0), 0.9, rtol=0.05)


# -------------------------------------------------------------- the blind, both sides


@pytest.fixture(scope="module")
def blind(tmp_path_factory):
    """File and records of the blind."""
    before = mi.variant()
    mi.set_variant("llvm_ad_mono")
    path = tmp_path_factory.mktemp("blind") / "blind.xml"
    scene = mi.load_dict(blinds.shapes(BLIND, RHO))
    records = gonio.bsdf(scene, path, period=1, rays=2**11)
    yield path, records
    if before:
        mi.set_variant(before)


def traced(parts, number, rays):
    """Light in exit patches of the upper and lower hemisphere, and its errors.

    By the tracer of NumPy, from `rays` directions that fill an incident patch.
    """
    points = KLEMS.points(6)[number]
    light = []
    for k, (x, y, z) in enumerate(points):
        theta, phi = np.degrees([np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)])
        fates = blinds.follow(parts, 1, RHO, theta, phi, rays // 36, 36 * number + k)
        down = ~fates.up
        patch = KLEMS.patch(fates.d) + 145 * down
        light.append(np.bincount(patch, fates.weight, 290) / len(patch))
    light = np.array(light)
    # between points, which stand for strata, there is more spread than within
    return light.mean(axis=0), light.std(axis=0, ddof=1) / np.sqrt(len(light))


GROUPS = [range(61), range(61, 145), range(145, 206), range(206, 290)]


@pytest.mark.parametrize(
    ("side", "parts"), [("front", BLIND), ("back", UPSIDE_DOWN)], ids=["front", "back"]
)
def test_columns_of_the_blind_are_those_of_another_tracer(blind, side, parts):
    """Totals of four parts of both hemispheres, for four incident patches."""
    _, records = blind
    record = records[side]
    scores, wrong = [], []
    for number in (3, 22, 70, 115):
        mean, error = traced(parts, number, 36 * 100)
        for of, into in ((number, scores), ((number + 2) % 145, wrong)):
            tally = record.tallies[of]
            batches = tally.sums.reshape(len(tally.sums), 290) / tally.incident
            for group in GROUPS:
                theirs, squares = mean[group].sum(), (error[group] ** 2).sum()
                own = batches[:, group].sum(axis=1)
                square = own.var(ddof=1) / len(own)
                into.append((own.mean() - theirs) / np.sqrt(square + squares))
    # of fewer degrees of freedom than both have
    for t, judge in ((scores, agree), (wrong, disagree)):
        z = np.abs(normal_scores(t, len(batches) - 1)).max()
        judge(Verdict({"worst": min(1.0, len(t) * 2 * stats.norm.sf(z))}))


def test_the_file_holds_what_was_measured(blind):
    """To seven digits, at the column of the direction of flight."""
    path, records = blind
    light = columns(path)
    assert light.keys() == set(radiance.DIRECTIONS.values())
    for (side, hemisphere), name in radiance.DIRECTIONS.items():
        record = records[side]
        column = FULL.incident_patch(record.theta_i, record.phi_i)
        flux = record.flux_fraction[:, hemisphere, :, 0, 0]
        assert np.allclose(light[name][:, column].T, flux, rtol=DIGITS, atol=1e-9)


def test_direct_light_is_in_one_patch(blind):
    """Of each incident patch, and as much as the closed form says; twin: 3 % more."""
    _, records = blind
    record = records["front"]
    # a grid of 256 points is right to 3e-5, a hundredth of a standard error
    points = KLEMS.points(16)
    theta = np.degrees(np.arccos(points[..., 2]))
    phi = np.degrees(np.arctan2(points[..., 1], points[..., 0]))
    numbers = np.arange(0, 145, 5)
    direct, std_err = record.direct[numbers, 0], record.direct_std_err[numbers, 0]
    angles = (zip(theta[number], phi[number]) for number in numbers)
    share = np.array(
        [np.mean([blinds.direct_share(BLIND, *a) for a in each]) for each in angles]
    )
    assert (direct[share == 0] == 0).all()
    known = share * 2**11 > ENOUGH_HITS
    for factor, passes in ((1, agree), (1.03, disagree)):
        t = (direct - factor * share)[known] / std_err[known]
        passes(verdict(normal_scores(t, record.n_batches - 1)))
    there = FULL.incident_patch(record.theta_i, record.phi_i)[numbers]
    flux = record.flux_fraction[numbers, 1, there, 0, 0]
    assert (flux >= direct).all()
    # what was scattered any number of times leaves by the cosine law of a slat
    most = RHO / (1 - RHO) * KLEMS.solid_angles.ravel()[there] / np.pi
    assert (flux - direct <= most).all()


def test_radiance_reads_the_blind(blind):
    """`checkBSDF` finds both sides, and the totals of the file."""
    pyradiance = pytest.importorskip("pyradiance")
    program = Path(pyradiance.__file__).parent / "bin" / "checkBSDF"
    command = [program, blind[0]]
    ran = subprocess.run(command, capture_output=True, text=True, check=True)
    # component, Lambertian part, and the largest total of a direction
    above = ran.stdout.partition("Reciprocity")[0]
    rows = [re.split("\t+", line) for line in above.splitlines()]
    most = {row[0]: float(row[2].rstrip("%")) for row in rows[-5:] if len(row) == 4}
    light = columns(blind[0])
    names = {
        "Interior Refl": "Reflection Back",
        "Exterior Refl": "Reflection Front",
        "Int->Ext Trans": "Transmission Back",
    }
    for theirs, ours in names.items():
        total = 100 * light[ours].sum(axis=0).max()
        assert abs(most[theirs] - total) <= 0.05 + 100 * DIGITS  # one decimal


# ------------------------------------------------------------------- other ways to ask


@pytest.fixture
def unread(monkeypatch):
    """Files are not read back: the one of the command with a product is."""
    monkeypatch.setattr(radiance_export, "read_back", lambda *_: [])


@pytest.mark.usefixtures("unread")
def test_two_records_make_one_file(blind, tmp_path):
    path, records = blind
    files = []
    for side, record in records.items():
        files.append(str(tmp_path / f"{side}.npz"))
        record.save(files[-1])
    target = tmp_path / "both.xml"
    assert cli.main(["export", *files, "-o", str(target)]) == 0
    ours, theirs = columns(target), columns(path)
    assert all(np.array_equal(ours[name], theirs[name]) for name in theirs)
    front = records["front"]
    with pytest.raises(ValueError, match="one record of each side, front and back"):
        exporting.export([front, front], target)
    other = records["back"].with_settings(digest="of another")
    with pytest.raises(ValueError, match="must be of one specimen"):
        exporting.export([front, other], target)
    with pytest.raises(ValueError, match="several records, a product and solar light"):
        exporting.export([front, front], tmp_path / "both.csv")
    with pytest.raises(ValueError, match="goes to a file of the same patches"):
        exporting.export(front, target, "klems-half")
    with pytest.raises(ValueError, match="each of the 145 incident patches of klems"):
        exporting.export(gonio.Record.stack([front[0], front[1]]), target)


@pytest.mark.usefixtures("mono", "every_cell")
def test_trees_of_a_sheet_say_what_matrices_say(tmp_path):
    """A Lambertian sheet: what was measured in cells, and the light of each column.

    Exact up to rounding: every ray has the weight 1/2.
    """
    matt = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": 0.5}}
    for basis, cells in (("tensor3", 8), ("tensor4", 4), ("klems-quarter", None)):
        path = tmp_path / f"{basis}.xml"
        settings = {"cells": cells, "rays": 2**10}
        records = gonio.bsdf(matt, path, basis, **settings)
        file = loaded(path, RadianceBSDF)
        for side, record in records.items():
            patches, digits = record.subdivision, TREE_DIGITS if cells else DIGITS
            wo = patches.points(1)[:, 0]
            for theta_i, phi_i, brdf in zip(record.theta_i, record.phi_i, record.brdf):
                values = file.values(side, 0, theta_i, phi_i, wo)[:, 0]
                assert np.allclose(values, brdf.ravel(), rtol=digits)
                total = (values * patches.projected_solid_angles.ravel()).sum()
                assert total == pytest.approx(0.5, rel=digits)


def test_command_writes_the_product_and_solar_light(tmp_path, capsys):
    path = tmp_path / "sheet.xml"
    words = ["bsdf", "diffuse:reflectance=0.5", "--solar", "diffuse:reflectance=0.25"]
    words += ["--basis", "klems-quarter", "--rays", "256", "-o", str(path)]
    words += ["--name", "a & b", "--manufacturer", "us", "--thickness", "1e-3"]
    assert cli.main([*words, "--width", "2"]) == 0
    head, first, *more = capsys.readouterr().out.splitlines()
    assert head.split() == ["tau_vis", "rho_vis", "tau_sol", "rho_sol"]
    of_front = ["0.0000", "0.5000", "0.0000", "0.2500"]
    assert re.findall(r"0\.\d{4}", first) == of_front
    assert first.startswith("front, normal ")
    back = [line for line in more if line.startswith(radiance_export.READ_BACK)]
    assert len(back) == 2
    # every ray has the weight of the reflectance
    assert float(back[0].partition("total off by ")[2].split()[0]) <= 2 * DIGITS
    text = path.read_text()
    assert "<Name>a &amp; b</Name>" in text
    assert '<Thickness unit="meter">0.001</Thickness>' in text
    assert '<Width unit="meter">2</Width>' in text
    assert "<Height" not in text
    blocks = loaded(path)
    name = "Reflection Back"
    half = blocks["Visible", name] / 2
    assert np.allclose(blocks["Solar", name], half, atol=2 * DIGITS)


@pytest.mark.usefixtures("unread")
def test_command_prints_properties_of_a_pane(tmp_path, capsys):
    """As JSON, of mean T and R over the patches that touch the normal, and of all.

    Sheets of a dielectric: Fresnel's, of all reflections within, at every ray's angle,
    averaged over the quarter basis by a midpoint rule.
    """
    words = ["bsdf", "thindielectric", "--basis", "klems-quarter", "--rays", "2048"]
    words += ["--sampler", "independent", "--batches", str(N_BATCHES)]
    assert cli.main([*words, "--json", "-o", str(tmp_path / "pane.xml")]) == 0
    found = json.loads(capsys.readouterr().out)

    def transmitted(steps):
        cos_i = np.sqrt(1 - steps)
        cos_t = np.sqrt(1 - steps / GLASS**2)
        s = ((cos_i - GLASS * cos_t) / (cos_i + GLASS * cos_t)) ** 2
        p = ((GLASS * cos_i - cos_t) / (GLASS * cos_i + cos_t)) ** 2
        r = (s + p) / 2
        return np.mean(1 - (r + (1 - r) ** 2 * r / (1 - r**2)))

    steps = (np.arange(10_000) + 0.5) / 10_000  # of the squared sine
    t, wrong = [], []
    for side in ("front", "back"):
        for light, most in (("normal", np.sin(np.radians(9)) ** 2), ("diffuse", 1)):
            row, tau = found[side][light], transmitted(most * steps)
            assert row.keys() == {f"{q}_vis{e}" for q in TAU_RHO for e in ENDS}
            assert abs(row["tau_vis"] + row["rho_vis"] - 1) <= DIGITS
            for factor, scores in ((1, t), (1.03, wrong)):
                off = row["tau_vis"] - factor * tau
                scores.append(off / row["tau_vis_std_err"])
    for scores, judge in ((t, agree), (wrong, disagree)):
        # those of diffuse light have more degrees of freedom
        z = np.abs(normal_scores(scores, N_BATCHES - 1)).max()
        judge(Verdict({"worst": min(1.0, len(t) * 2 * stats.norm.sf(z))}))


def test_the_cells_that_touch_the_normal_are_averaged(tmp_path):
    """Four of a tree of rank 4, exactly; not the first of them alone."""
    matt = {"type": "roughdielectric", "alpha": 0.5}
    record = gonio.bsdf(matt, tmp_path / "a.xml", "tensor4", cells=4, rays=64)["front"]
    order = np.argsort(record.theta_i, kind="stable")[:4]
    assert np.ptp(record.theta_i[order]) < 1e-3 < np.ptp(record.dht[order])
    found = properties({"front": record})["front"]["normal"]["tau_vis"]
    assert found == pytest.approx(record.dht[order].mean(), rel=1e-12)


@pytest.mark.usefixtures("unread")
def test_a_mesh_has_a_bsdf_for_sunlight(tmp_path, capsys):
    """An upright plate: matrices in the ratio of both reflectances, exactly."""
    path = tmp_path / "plate.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 1 0 1\nv 0 0 1\nf 1 2 3\nf 1 3 4\n")
    words = ["bsdf", str(path), "--normal", "y", "--basis", "klems-quarter", "-q"]
    words += ["--rays", "16", "--period", "1,1", "-o", str(tmp_path / "plate.xml")]
    given = ["--bsdf", "diffuse:reflectance=0.5"]
    given += ["--solar-bsdf", "diffuse:reflectance=0.25"]
    assert cli.main([*words, *given]) == 0
    blocks = loaded(tmp_path / "plate.xml")
    half = blocks["Visible", "Reflection Back"] / 2
    assert np.allclose(blocks["Solar", "Reflection Back"], half, atol=2 * DIGITS)
    assert half.any()
    assert cli.main([*words, *given, "--solar", "diffuse"]) == 1
    assert "--solar and --solar-bsdf are mutually exclusive" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["-o", "x.xml", "--solar-bsdf", "diffuse"], "applies to meshes and height m"),
        (["-o", "x.npz"], "must end in .xml"),
        (["-o", "x.xml", "--cells", "8"], "cells applies to the basis tensor3"),
        (["-o", "x.xml", "--basis", "tensor4", "--cells", "6"], "a power of two"),
        (["-o", "x.xml", "--width", "0"], "--width must be a positive number"),
        (["-o", "x.xml", "--normal", "y"], "--normal applies to meshes"),
    ],
)
def test_command_refuses(tmp_path, monkeypatch, capsys, words, message):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["bsdf", "diffuse", *words]) == 1
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_what_the_file_decides_is_not_asked_for(tmp_path):
    with pytest.raises(ValueError, match="theta_i is decided by the file, got 3"):
        gonio.bsdf({"type": "diffuse"}, tmp_path / "x.xml", theta_i=3)


@pytest.mark.parametrize("folder", [None, "parts"])
def test_both_sides_are_measured_with_rays_of_their_own(tmp_path, folder):
    """Exact: `measure` repeats both with the seeds that their records state."""
    matt = {"type": "twosided", "bsdf": {"type": "diffuse"}}
    where = {} if folder is None else {"folder": tmp_path / folder}
    asked = {"rays": 64, "seed": 5}
    records = gonio.bsdf(matt, tmp_path / "m.xml", "klems-quarter", **asked, **where)
    same = {"incident": "klems-quarter", "collector": "klems-quarter", "rays": 64}
    for seed, (side, record) in zip((5, 6), records.items()):
        assert record.asked.seed == seed
        again = gonio.measure(matt, **same, side=side, seed=seed)
        assert np.array_equal(record.counts, again.counts)
    assert not np.array_equal(records["front"].counts, records["back"].counts)


@pytest.mark.usefixtures("rgb")
def test_a_coloured_face_and_a_black_back(tmp_path):
    """Which has one channel; in the file both are coloured."""
    colour = {"type": "rgb", "value": [0.7, 0.5, 0.2]}
    paint = {"type": "diffuse", "reflectance": colour}
    path = tmp_path / "paint.xml"
    with pytest.warns(RuntimeWarning, match=r"the back .* is black in the file"):
        records = gonio.bsdf(paint, path, "klems-quarter", rays=256)
    assert records["back"].channels == ("Y",)
    file = loaded(path, RadianceBSDF)
    wo = file.basis.patches.points(1)[:, 0]
    seen = (
        file.values("front", 0, 40.0, 80.0, wo)
        * file.basis.patches.projected_solid_angles
    )
    # every ray has this weight; seven digits, and the matrices to XYZ and back
    assert np.allclose(seen.sum(axis=0), colour["value"], rtol=20 * DIGITS)
    assert (np.abs(file.values("back", 0, 40.0, 80.0, wo)) <= DIGITS).all()


def test_a_grain_is_told_of_a_tree_of_rank_3(tmp_path, recwarn):
    """And none of what is the same at all azimuths, with light in deltas or not."""
    path, few = tmp_path / "tree.xml", {"cells": 4, "rays": 16}
    brushed = {"type": "roughconductor", "alpha_u": 0.1, "alpha_v": 0.3}
    with pytest.warns(RuntimeWarning, match=r"not isotropic.*take tensor4 or klems"):
        gonio.bsdf(brushed, path, "tensor3", **few)
    recwarn.clear()
    for even in ("roughdielectric:alpha=0.2", "thindielectric"):
        gonio.bsdf(parse_specimen(even), path, "tensor3", **few)
    gonio.bsdf(brushed, path, "tensor4", **few)
    assert not any("isotropic" in str(one.message) for one in recwarn)


def test_light_that_leaves_over_the_edge_is_told(tmp_path, recwarn):
    """Of a pane without a period; with one there is none."""
    faces = {
        f"face{z}": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().translate([0, 0, z]).rotate(*turn),
            "bsdf": {"type": "dielectric"},
        }
        for z, turn in ((0, ([0, 0, 1], 0)), (-1, ([1, 0, 0], 180)))
    }
    scene, path = mi.load_dict({"type": "scene"} | faces), tmp_path / "pane.xml"
    with pytest.warns(RuntimeWarning, match="rays left over the edge") as told:
        gonio.bsdf(scene, path, "tensor4", cells=4, rays=64)
    assert all("for a larger surface" in str(one.message) for one in told)
    recwarn.clear()
    gonio.bsdf(scene, path, "tensor4", cells=4, rays=64, period=2)
    assert not recwarn.list

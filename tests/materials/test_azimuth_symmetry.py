"""Specimens that may be turned or mirrored: recognised by measuring, and then copied.

Lobes are closed forms: of facets whose slopes are as symmetric as a test wants them.
"""

from dataclasses import replace

import mitsuba as mi
import numpy as np
import pytest
import synthetic
from synthetic import facet_lobes

import gonio_mi as gonio
from gonio_mi.campaigns import execution
from gonio_mi.campaigns.execution import ExecutionContext
from gonio_mi.materials import measured_directions, whole_bsdf
from gonio_mi.materials.interpolation.incident_grid import IncidentGrid
from gonio_mi.materials.interpolation.lobes import MeasuredLobes
from gonio_mi.materials.measured_directions import NOISE, MeasuredDirections
from gonio_mi.materials.symmetry_recognition import SymmetryRecognition
from gonio_mi.results.azimuth_symmetry import AzimuthSymmetry, sources
from gonio_mi.results.campaign_outcome import CampaignOutcome
from gonio_mi.results.prediction_error import expected_noise, prediction_error
from gonio_mi.results.record import Record

PATCHES = gonio.subdivision("projected:8x24")
ANGLES = (0.0, 25.0, 50.0, 75.0)

# Sums of 2**40ths that are rounded, of some hundred patches, over half of the light.
WHOLE = 2.0**-30


class Facets(MeasuredDirections):
    """Directions of facets that are computed, not measured."""

    def __init__(self, tolerance, *surfaces):
        super().__init__("facets", None, tolerance, ExecutionContext(), {})
        self.surfaces = surfaces
        self.measure([(theta, 0.0) for theta in ANGLES], "")

    def measure(self, incidents, purpose, noise=0):  # noqa: ARG002
        for one in set(incidents) - self.records.keys():
            lobes = [facet_lobes(PATCHES, [one], **how) for how in self.surfaces]
            lobe = np.mean(lobes, axis=0)[:, None]
            self.records[one] = synthetic.exact(lobe, one[:1], str(PATCHES), one[1])[0]


def brushed(**how):
    return {"widths": (0.2, 0.45)} | how


CASES = {
    "brushed": ([brushed()], 2, {0, 12}),
    "brushed, turned": ([brushed(turn=37.5)], 2, {5, 17}),
    "tilted along": ([brushed(tilt=(0.2, 0))], 1, {0}),
    "tilted across": ([brushed(tilt=(0, 0.2))], 1, {12}),
    "tilted askew": ([brushed(tilt=(0.2, 0.1))], 1, {None}),
    "crossed": ([brushed(), brushed(turn=90)], 4, {0, 6, 12, 18}),
    "crossed askew": ([brushed(), brushed(turn=60)], 2, {4, 16}),
    "six": ([brushed(turn=turn) for turn in (0, 60, 120)], 6, set(range(0, 24, 2))),
    "three": (
        [
            {"widths": (0.2, 0.2), "tilt": 0.3 * np.array([np.cos(a), np.sin(a)])}
            for a in np.radians([0, 120, 240])
        ],
        3,
        {0, 8, 16},
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_symmetries_are_those_of_the_slopes(case):
    """Each of them, and none more; mirrors by twice their azimuth in sectors."""
    surfaces, turns, mirrors = CASES[case]
    directions = Facets(0.01, *surfaces)
    found = SymmetryRecognition(directions, ANGLES).symmetry()
    assert found.turns == turns
    assert found.mirror in mirrors
    # few directions tell: two azimuths of two angles, for each turn or mirror tried
    assert len(directions.records) <= len(ANGLES) + 2 * (2 + 2 * 4)


@pytest.mark.parametrize("tilt", [0.004, 0.02])
def test_nearly_symmetric_is_what_the_tolerance_says(tilt):
    """A lobe that is moved misplaces light; half of the tolerance may be."""
    surface = brushed(tilt=(tilt, 0))
    lobes = facet_lobes(PATCHES, [(25, 45), (25, 225), (50, 45), (50, 225)], **surface)
    lobes = lobes[::2] - np.roll(lobes[1::2], 12, axis=2)
    change = np.abs(lobes).sum(axis=(1, 2)).max()  # half of half the light
    for tolerance, turns in ((1.9 * change, 1), (4 * change, 2)):
        found = SymmetryRecognition(Facets(tolerance, surface), ANGLES).symmetry()
        assert found.turns == turns


@pytest.mark.parametrize(("parts", "isotropic"), [(0, True), (5, False), (8, False)])
def test_isotropic_is_not_what_eighths_of_a_turn_leave(parts, isotropic):
    """Ridges of pyramids with eight sides; twin: facets tilted alike all around."""
    angles = 2 * np.pi * np.arange(parts or 24) / (parts or 24)
    tilts = 0.5 * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    surfaces = [{"widths": (0.15, 0.15), "tilt": tilt} for tilt in tilts]
    directions = Facets(0.1, *surfaces)
    assert SymmetryRecognition(directions, ANGLES).is_isotropic() == isotropic


@pytest.mark.parametrize("turn", [0, 7.5, 37.5])
def test_copies_are_what_would_be_measured(turn):
    """At all images; twin: with a mirror that is a sector off."""
    directions = Facets(0.01, brushed(turn=turn))
    start = 50.0, 30.0
    for by, right in ((round(turn / 7.5), True), (round(turn / 7.5) + 2, False)):
        symmetry = AzimuthSymmetry(24, 2, by)
        images = [(50.0, motion.azimuth(30.0)) for motion in symmetry.motions]
        assert len(set(images)) == 4
        directions.measure([start, *images], "")
        for motion, image in zip(symmetry.motions, images):
            copy, known = (
                motion.copy(directions.records[start]),
                directions.records[image],
            )
            assert (copy.theta_i, copy.phi_i) == image
            same = np.allclose(copy.brdf, known.brdf, rtol=0, atol=WHOLE * 24)
            assert same == (right or not motion.mirrored)


@pytest.mark.parametrize(
    ("turns", "mirror"),
    [(1, None), (2, None), (6, None), (1, 0), (1, 7), (2, 3), (3, 5), (6, 1)],
)
def test_each_azimuth_has_one_image_in_the_domain(turns, mirror):
    """Up to its ends; and all motions are made of the generators."""
    symmetry = AzimuthSymmetry(24, turns, mirror)
    first, last = symmetry.domain
    motions = {(one.by, one.mirrored) for one in symmetry.motions}
    assert len(motions) == turns * (1 if mirror is None else 2)

    def images(sector):
        return {one.edge(sector) for one in symmetry.motions}

    covered = set()
    for sector in range(first, last + 1):
        covered |= images(sector)
        assert symmetry.home(sector) in {first, last, sector}
        inside = images(sector) & set(range(first + 1, last))
        assert inside <= {sector}
    assert covered == set(range(24))
    for sector in np.arange(0.25, 24, 0.5):
        home = symmetry.home(sector)
        assert first - 0.5 <= home <= last + 0.5
        assert sector in images(home)
    made = {(0, False)}
    for _ in range(24):
        made |= {
            (one.edge(by) % 24, one.mirrored != mirrored)
            for one in symmetry.generators
            for by, mirrored in made
        }
    assert made == motions


def profile(heights):
    """Periodic grooves along y of metal, of one period."""
    return {
        "type": "heightfield",
        "heights": mi.TensorXf(np.array([heights, heights], dtype=np.float32)),
        "size": 1.0,
        "bsdf": {"type": "roughconductor", "alpha": 0.4},
    }


@pytest.mark.parametrize(
    ("heights", "turns"), [([0.0, -0.25], 2), ([0.0, 0.1, 0.2, 0.3], 1)]
)
def test_grooves_are_symmetric_and_blazed_ones_only_along(heights, turns):
    """Sampled, with noise of a quarter of the tolerance."""
    how = {"collector": "angle:6x16", "estimator": "weighted", "period": "box"}
    directions = MeasuredDirections(
        "it", profile(heights), 0.1, ExecutionContext(), how
    )
    directions.measure([(theta, 0.0) for theta in ANGLES], "")
    found = SymmetryRecognition(directions, ANGLES)
    assert not found.is_isotropic()
    assert found.symmetry() == AzimuthSymmetry(16, turns, 0)


BRUSHED = {"type": "roughconductor", "alpha_u": 0.3, "alpha_v": 0.7}
CAMPAIGN = {
    "tolerance": 0.1,
    "theta_max": 80,
    "within": 1.0,
    "measured": 9,
    "rays": 0,
    "isotropic": False,
    "unseen": [[0.0] * 6],
}
COARSE = {"tolerance": 0.2, "collector": "projected:6x16", "theta_max": 60}


def test_a_material_holds_copies_and_says_so(tmp_path, monkeypatch):
    """From rays, as few as the tolerance asks for; any reader can use it."""
    monkeypatch.setattr(whole_bsdf, "N_UNSEEN", 8)
    how = COARSE | {"estimator": "weighted"}
    record = gonio.campaign({"brushed": BRUSHED}, **how)["brushed"]
    found = record.settings["campaign"]
    assert not found["isotropic"]
    assert (found["symmetry"]["turns"], found["symmetry"]["mirror"]) == (2, 0)
    noise = [expected_noise(record[number]) for number in range(len(record))]
    goal = NOISE * how["tolerance"]
    assert max(noise) <= goal
    assert record.settings["noise"] == goal
    copies = {tuple(one) for one in found["symmetry"]["copies"]}
    every = set(zip(record.theta_i.tolist(), record.phi_i.tolist()))
    assert copies < every
    assert found["measured"] >= len(every - copies) + whole_bsdf.N_UNSEEN
    for theta in set(record.theta_i) - {0}:
        azimuths = record.phi_i[record.theta_i == theta]
        assert len(azimuths) >= whole_bsdf.N_COARSE[1]
        assert set((-azimuths) % 360) == set((azimuths + 180) % 360) == set(azimuths)
    text = gonio.results.summary_text.summary_text(
        gonio.results.summary.summarize(record), most_rows=40
    )
    said = "the same if turned by 180 degrees or mirrored at the azimuth 0 ("
    assert said + f"{len(copies)} of its" in " ".join(text.split())
    # measured directions have a line each, copies one for all, and the rest is below
    assert text.count("  dhr  ") == len(every - copies)
    assert f"\n{len(copies)} copies of these are left out" in text
    assert text.split("\n\n")[-1].startswith("material  tolerance 0.2 ")
    angles = list(zip(record.theta_i.tolist(), record.phi_i.tolist()))
    alone = gonio.results.summary.summarize(record[angles.index(min(copies))])
    assert "  dhr  " in gonio.results.summary_text.summary_text(alone)
    record.save(tmp_path / "m.npz")
    assert gonio.load(tmp_path / "m.npz") == record
    plugin = {"type": "goniometric", "filename": str(tmp_path / "m.npz")}
    how = {"collector": COARSE["collector"], "rays": 2**16}
    seen, truth = (gonio.measure(bsdf, 30, 200, **how) for bsdf in (plugin, BRUSHED))
    assert not prediction_error(seen, truth.flux_fraction).exceeds(COARSE["tolerance"])


@pytest.mark.parametrize(
    ("change", "sound"),
    [
        ({}, True),
        ({"mirror": None, "copies": []}, True),
        ({"turns": 0}, False),
        ({"turns": 2.5}, False),
        ({"turns": 10**9}, False),
        ({"mirror": "0"}, False),
        ({"copies": [[30.0]]}, False),
        ({"copies": None}, False),
    ],
)
def test_symmetries_of_files_are_checked(change, sound):
    """What a campaign writes is sound; nothing that would spoil a comparison is."""
    symmetry = {"turns": 2, "mirror": 0, "copies": [[30.0, 180.0]]}
    found = CAMPAIGN | {"symmetry": symmetry | change}
    if sound:
        assert CampaignOutcome.from_mapping(found).as_mapping() == found
    else:
        with pytest.raises(ValueError, match="campaign must be"):
            CampaignOutcome.from_mapping(found)
    assert CampaignOutcome.from_mapping(CAMPAIGN).copies == (), "without a symmetry"


def described(symmetry, copies):
    """A symmetry and the copies made by it, as files hold them."""
    mirror = symmetry.mirror_azimuth
    return {"turns": symmetry.turns, "mirror": mirror, "copies": copies}


def with_copies(turns, mirror):
    """Record as of a campaign: the normal, two measured directions, and images."""
    symmetry = AzimuthSymmetry(24, turns, mirror)
    angles = {"theta_i": (0, 30, 60), "phi_i": (0, 45, 60)}
    measured = synthetic.record("projected:6x24", both=True, **angles)
    known = {(0.0, 0.0): measured[0], (30.0, 45.0): measured[1]}
    known[60.0, 60.0] = measured[2]
    stack = Record.stack(symmetry.whole(known, known))
    every = zip(stack.theta_i.tolist(), stack.phi_i.tolist())
    copies = [list(one) for one in every if one not in known]
    found = {"symmetry": described(symmetry, copies)}
    return stack.with_settings(campaign=CAMPAIGN | found)


@pytest.mark.parametrize(("turns", "mirror"), [(2, None), (1, 7), (2, 0), (6, 3)])
def test_files_leave_out_copies(tmp_path, turns, mirror):
    """Nothing is lost; twin: one that a ray tells from its original is kept."""
    record = with_copies(turns, mirror)
    record.save(tmp_path / "left_out.npz")
    assert gonio.load(tmp_path / "left_out.npz") == record
    images = turns * (1 if mirror is None else 2)
    assert len(record) == 1 + 2 * images
    with np.load(tmp_path / "left_out.npz") as archive:
        assert archive["hits"].shape[0] == 3
    number = next(n for n, (source, _) in enumerate(sources(record)) if n != source)
    tally = record.tallies[number]
    hits = tally.hits.copy()
    hits[0, 0, 0] += 1
    tallies = list(record.tallies)
    tallies[number] = replace(tally, hits=hits)
    other = replace(record, tallies=tuple(tallies))
    other.save(tmp_path / "other.npz")
    with np.load(tmp_path / "other.npz") as archive:
        assert archive["hits"].shape[0] == 4
        assert (archive["hits"] == hits).all(axis=(1, 2, 3)).any()


@pytest.mark.parametrize("told", [True, False])
def test_what_is_filled_in_is_sought_once(told, monkeypatch):
    """Images of it are the same; twin: not known to be, each is sought."""
    record = with_copies(2, 0)
    if not told:
        record = record.with_settings(campaign=None)
    sought, fill = [], IncidentGrid._filled

    def counted(self, values, azimuth, angle):
        sought.append((azimuth, angle))
        return fill(self, values, azimuth, angle)

    monkeypatch.setattr(IncidentGrid, "_filled", counted)
    lobes = MeasuredLobes(record)
    azimuths, angles = (range(n) for n in lobes.grid.index.shape)
    found = lobes.brdf(azimuths, angles)
    # rings of four azimuths each, none in common: of eight, four are not measured
    assert found.shape[:2] == (8, 3)
    assert len(sought) == 2 * (4 + (1 if told else 4))
    for row, phi_i in enumerate(lobes.grid.phi_i.tolist()):
        for motion in AzimuthSymmetry(24, 2, 0).motions:
            image = int(np.argmin(np.abs(lobes.grid.phi_i - motion.azimuth(phi_i))))
            moved = motion.moved(found[row, 1:], 3)
            assert np.allclose(moved, found[image, 1:], rtol=1e-12, atol=0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda copies: copies[:-1], "not of its incident directions"),
        (lambda copies: copies[:, :2], "does not fit its other entries"),
        (lambda copies: copies * [0, 1, 1], "not of directions that it holds"),
        (lambda copies: copies * [-1, 1, 1], "not of directions that it holds"),
        (lambda copies: copies + [0, 24, 0], "an unknown motion"),
        (lambda copies: copies + [0, 0, 2], "an unknown motion"),
        (lambda _: None, "its arrays are not those of a record"),
    ],
)
def test_copies_of_files_are_checked(tmp_path, change, message):
    """Twin: rewritten as they are, they are read."""
    record, path = with_copies(2, 0), tmp_path / "copies.npz"
    record.save(path)
    with np.load(path) as archive:
        arrays = dict(archive)
    np.savez(path, **arrays)
    synthetic.seal_again(path)
    assert gonio.load(path) == record
    arrays["copies"] = change(arrays["copies"])
    np.savez(path, **{name: a for name, a in arrays.items() if a is not None})
    synthetic.seal_again(path)
    with pytest.raises(gonio.FileFormatError, match=message):
        gonio.load(path)


@pytest.mark.parametrize("told", [True, False])
def test_the_noise_of_copies_counts_once(told):
    """Exact: copies change neither a fit nor a comparison; twin: if none says so."""
    symmetry, start = AzimuthSymmetry(16, 2, 0), (30.0, 45.0)
    records, measured = [], []
    for seed in (1, 2):
        how = {"collector": "projected:6x16", "sampler": "independent", "rays": 2**14}
        one = gonio.measure(BRUSHED, *start, **how, seed=seed)
        stack = Record.stack(symmetry.whole({start: one}, [start]))
        copies = [[30.0, phi] for phi in stack.phi_i.tolist() if phi != start[1]]
        assert len(copies) == 3
        found = {"symmetry": described(symmetry, copies if told else [])}
        records.append(stack.with_settings(campaign=CAMPAIGN | found))
        measured.append(one)
    many, one = gonio.compare(*records), gonio.compare(*measured)
    # rounding: sums of some hundred scores in other orders
    assert many.statistics["chi2"] == pytest.approx(4 * one.statistics["chi2"], 1e-12)
    dof = (1 if told else 4) * one.statistics["chi2_dof"]
    assert many.statistics["chi2_dof"] == pytest.approx(dof, 1e-12)
    model, free = "roughconductor:distribution=beckmann", ["alpha_u", "alpha_v"]
    many, one = (gonio.fit(some[0], model, free) for some in (records, measured))
    assert (many.dof == one.dof) == told
    assert np.all(many.std_errs == one.std_errs) == told


@pytest.fixture(scope="module")
def records():
    """Stacks of directions, by what is asked for."""
    return {}


@pytest.fixture
def remembered(records, monkeypatch):
    """Rounds of directions that campaigns have in common are measured once."""

    def records_of(specimens, incidents, where, settings, label=None):
        asked = repr((specimens, incidents, settings))
        if asked not in records:
            records[asked] = execution.records_of(
                specimens, incidents, where, settings, label
            )
        return records[asked]

    monkeypatch.setattr(measured_directions, "records_of", records_of)


@pytest.mark.usefixtures("mono", "remembered")
@pytest.mark.parametrize("believed", [False, True])
@pytest.mark.parametrize("isotropic", [False, True])
def test_a_symmetry_that_does_not_hold_is_given_up(isotropic, believed, monkeypatch):
    """Where directions never used miss; twin: believed, it spoils the material."""
    askew = AzimuthSymmetry(16, 2, 4)
    monkeypatch.setattr(SymmetryRecognition, "symmetry", lambda _: askew)
    monkeypatch.setattr(SymmetryRecognition, "is_isotropic", lambda _: isotropic)
    for name, number in (("N_UNSEEN", 10), ("MAX_LOOKS", 2), ("MAX_MISSES", 0)):
        monkeypatch.setattr(whole_bsdf, name, number)
    how = COARSE | {"tolerance": 0.1}
    if believed:
        monkeypatch.setattr(SymmetryRecognition, "is_any_refuted", lambda *_: False)
        helps = "was not reached.*a larger tolerance helps"
        with pytest.warns(RuntimeWarning, match=helps):
            record = gonio.campaign({"brushed": BRUSHED}, **how)["brushed"]
    else:
        record = gonio.campaign({"brushed": BRUSHED}, **how)["brushed"]
    found = record.settings["campaign"]
    assert found["isotropic"] == (isotropic and believed)
    assert (found["symmetry"]["copies"] != []) == (believed and not isotropic)
    assert (found["within"] == 1) != believed

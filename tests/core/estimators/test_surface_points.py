"""Estimator `split`: single scattering is an integral over the surface.

Patches scatter together, so that they are judged by sums over rings and quarters of the
azimuth, whose p-values are added up (Bonferroni), not as if independent.
"""

from contextlib import suppress

import mitsuba as mi
import numpy as np
import pytest
from benchmark import groove
from budget import Verdict, agree, disagree, normal_scores
from scipy import stats
from specimens import (
    GREY,
    MIRROR,
    both_sided,
    grooves,
    heightfield,
    spheres_on_a_plane,
    with_faces,
)

import gonio_mi as gonio
from gonio_mi.campaigns.campaign import campaign
from gonio_mi.collector.directions import direction
from gonio_mi.errors import SettingError, SpecimenError
from gonio_mi.estimators import split as method, surface_points
from gonio_mi.instrument import launcher, schedule
from gonio_mi.instrument.measure import measure_each

COMMON = {"period": "box", "collector": "projected:6x8"}
INCIDENTS = [(0.0, 0.0), (30.0, 20.0), (75.0, 80.0), (70.0, 5.0)]


ROUGH_MIRROR = {"type": "roughconductor", "alpha": 0.3}
BLACK = both_sided({"type": "diffuse", "reflectance": 0.0})
GLOSSY = both_sided({"type": "roughconductor", "alpha": 0.02})


def split(specimen, incidents=INCIDENTS, **settings):
    settings = COMMON | {"estimator": "split", "rays": 2**15} | settings
    return measure_each(specimen, incidents, **settings)


def parts(values):
    """Sums over rings and over quarters of the azimuth; of all."""
    *outer, n_theta, n_phi = values.shape
    quarters = values.reshape(*outer, n_theta, 4, n_phi // 4).sum(axis=(-3, -1))
    rings = values.sum(axis=-1)
    return np.concatenate([rings, quarters, rings.sum(-1, keepdims=True)], axis=-1)


def of_batches(record):
    """Means and standard errors of these parts of the upper hemisphere."""
    (tally,) = record.tallies
    each = parts(tally.sums[:, 0, ..., 0] / tally.incident[:, :1, None])
    return each.mean(axis=0), each.std(axis=0, ddof=1) / np.sqrt(len(each))


def verdict(record, expected, of_expected=0.0):
    """Of parts that are expected, with a standard error of their own or none."""
    found, std_err = of_batches(record)
    error = np.maximum(np.hypot(std_err, of_expected), 1e-6)  # single precision
    z = normal_scores((found - expected) / error, record.n_batches - 1)
    worst = 2 * stats.norm.sf(np.abs(z).max()) * z.size
    return Verdict({"worst": float(min(worst, 1))}, z.size)


def test_exact_diffuse_groove():
    """All orders against radiosity; twin: 5 % more light."""
    bsdf = both_sided({"type": "diffuse", "reflectance": groove.REFLECTANCE})
    stack = split(grooves(45, 1, bsdf=bsdf))
    points = stack.subdivision.points(8)
    for number, (theta_i, phi_i) in enumerate(INCIDENTS):
        wi = direction(np.radians(theta_i), np.radians(phi_i))
        brdf = groove.patch_means(np.array([wi]), points)[0]
        flux = brdf.reshape(stack.subdivision.shape)
        flux = parts(flux * stack.subdivision.projected_solid_angles)
        agree(verdict(stack[number], flux))
        disagree(verdict(stack[number], 1.05 * flux))


def coinciding():
    """Two planes in one place beneath the spheres."""
    spheres = spheres_on_a_plane()
    return spheres | {"again": spheres["plane"]}


def overlapping():
    """Flat triangles, half of which lie in a large one."""
    flat = {"type": "heightfield", "heights": mi.TensorXf(np.zeros((16, 16)))}
    return with_faces(flat | {"bsdf": GREY}, lambda faces: [*faces, [0, 16, 288]])


def field(bsdf, **settings):
    return heightfield(bsdf=bsdf, alpha=0.5, resolution=16, **settings)


CASES = {
    "rough mirrors": lambda: (field(ROUGH_MIRROR), {}),
    "smooth normals": lambda: (field(GREY, face_normals=False), {}),
    "spheres, two planes in one": lambda: (coinciding(), {"period": "2,2"}),
    "from behind": lambda: (grooves(30, 1, bsdf=GREY), {"side": "back"}),
    "two events": lambda: (grooves(60, 1, bsdf=GREY), {"max_depth": 2}),
    "one event": lambda: (grooves(60, 1, bsdf=GREY), {"max_depth": 1}),
    "both hemispheres": lambda: (grooves(30, 1, bsdf=GREY), {"hemispheres": "both"}),
}


@pytest.mark.parametrize("name", CASES)
def test_as_rays_say(name, monkeypatch):
    """Against `weighted`; twin: 2 % more light, at 75 degrees 5 %."""
    monkeypatch.setattr(surface_points, "N_FIXED", 2**8)
    specimen, settings = CASES[name]()
    stack = split(specimen, INCIDENTS[1:3], **settings, rays=2**16)
    settings = COMMON | settings | {"rays": 2**17, "seed": 1}
    rays = measure_each(specimen, INCIDENTS[1:3], **settings)
    for number, more in enumerate((1.02, 1.05)):
        expected = of_batches(rays[number])
        agree(verdict(stack[number], *expected))
        disagree(verdict(stack[number], more * expected[0], expected[1]))


def test_intervals_where_rays_are_few():
    """Of 95 %, over 24 seeds; twin: Student's t alone.

    Patches that no ray of more events reached scatter by their points alone. The
    truth is 4096 times as many rays.
    """
    specimen, where = grooves(30, 1, bsdf=ROUGH_MIRROR), INCIDENTS[2:3]
    truth = measure_each(specimen, where, rays=2**18, **COMMON)[0].flux_fraction[0]
    lit, t = truth > 1e-3 * truth.max(), stats.t.ppf(0.975, 15)
    held: list[list[float]] = [[], []]
    for seed in range(24):
        one = split(specimen, where, rays=2**6, seed=seed).estimates[0].patches(0)
        value, alone = one.value, t * one.noise
        limits = one.interval(0.95), (value - alone, value + alone)
        for found, (low, high) in zip(held, limits):
            found.append(((low <= truth) & (truth <= high))[lit].mean())
    ours, twin = (
        Verdict({"covered": float(stats.ttest_1samp(x, 0.95, alternative="less")[1])})
        for x in held
    )
    agree(ours)
    disagree(twin)


def test_channels(rgb):  # noqa: ARG001
    """Each channel has its own light; twin: that of another."""
    colour = {"type": "rgb", "value": [0.9, 0.5, 0.1]}
    bsdf = both_sided({"type": "diffuse", "reflectance": colour})
    stack = split(grooves(30, 1, bsdf=bsdf), [(30.0, 20.0)])
    rays = gonio.measure(grooves(30, 1, bsdf=bsdf), 30, 20, rays=2**16, **COMMON)
    error = np.hypot(stack.dhr_std_err[0], rays.dhr_std_err)
    z = (stack.dhr[0] - rays.dhr) / error
    # of the same paths: the worst of three (Bonferroni), either way
    agree(Verdict({"worst": float(min(1, 6 * stats.norm.sf(np.abs(z).max())))}, 3))
    assert np.all(np.abs(np.roll(stack.dhr[0], 1) - rays.dhr) > 10 * error)


def test_bits_alone_and_in_a_stack(tmp_path, monkeypatch):
    """Exact, where launches are shared and from a file too; other seeds, other bits."""
    # else rays cost less
    monkeypatch.setattr(surface_points, "MAX_POINTS_NOISE2", np.inf)
    specimen = field(ROUGH_MIRROR)
    wish = {"rays": None, "noise": 0.1}
    stack = split(specimen, **wish)
    assert stack.provenance.reached <= 0.1
    for number in (0, 3):
        alone = split(specimen, INCIDENTS[number : number + 1], **wish)
        assert alone.tallies[0] == stack.tallies[number]
    monkeypatch.setattr(surface_points, "N_FIXED", 2**5)
    monkeypatch.setattr(surface_points, "MAX_LANES", 2**12)  # five at once
    sent, send = [], launcher.launch
    monkeypatch.setattr(launcher, "launch", lambda one: sent.append(one) or send(one))
    nine = [*INCIDENTS, *((10.0, 40.0 * i) for i in range(5))]
    cut = split(specimen, nine, rays=2**8)
    assert [len(one.beams) for one in sent] == [9]
    assert split(specimen, INCIDENTS[3:], rays=2**8).tallies[0] == cut.tallies[3]
    other = split(specimen, INCIDENTS[:1], seed=1, **wish)
    assert other.tallies[0] != stack.tallies[0]
    rays = gonio.measure(specimen, 30, rays=2**10, **COMMON)
    assert rays.provenance.digest == stack.provenance.digest
    stack.save(tmp_path / "stack.npz")
    assert gonio.load(tmp_path / "stack.npz") == stack


def spotted(part, dark=0.001):
    """Grooves of 45 degrees, a part of whose texels is white and the rest dark."""
    texels = np.full(2**14, dark, np.float32)
    spots = np.random.default_rng(0).choice(2**14, round(part * 2**14), replace=False)
    texels[spots] = 1
    bitmap = {"type": "bitmap", "raw": True, "filter_type": "nearest"}
    bitmap["bitmap"] = mi.Bitmap(texels.reshape(128, 128, 1))
    return grooves(45, 1, bsdf=both_sided({"type": "diffuse", "reflectance": bitmap}))


def test_spots_that_nothing_met():
    """They are in its interval; twin: if only a branch may be missed.

    Against 32 times as many rays of `weighted`; where rays meet one, it is refused.
    """
    specimen, where = spotted(3 / 2**14), INCIDENTS[1:2]
    ((truth,),) = measure_each(specimen, where, rays=2**18, **COMMON).dhr
    within = []
    for seed in range(4):
        with suppress(SpecimenError):
            record = split(specimen, where, rays=2**13, seed=seed)
            value, low, high = *record.dhr[0], *np.ravel(record.interval(0.95, "dhr"))
            within.append((low <= truth <= high, truth <= value + (high - value) / 16))
    ours, twin = np.transpose(within)
    assert ours.all()
    assert not twin.all()


def test_points_are_compared_with_rays(monkeypatch):
    """Their light of one event agrees; twin: points that do not see some patch."""
    light = surface_points.SurfacePoints.single_scattering

    def blind(self, *arguments):
        found = light(self, *arguments)
        for one in found:
            one.sums[:, 20] = 0
        return found

    specimen, where = grooves(30, 1, bsdf=GREY), INCIDENTS[1:2]
    split(specimen, where)
    monkeypatch.setattr(surface_points.SurfacePoints, "single_scattering", blind)
    with pytest.raises(SpecimenError, match="differs in some patches"):
        split(specimen, where)


def test_more_rays_more_points():
    """As many looks at patches as rays have branches, 128 points at least: exact."""
    found = [split(spotted(0.1), INCIDENTS[:1], rays=rays) for rays in (2**9, 2**16)]
    least = [int(one.counts[one.counts > 0].min()) // 16 for one in found]
    assert [2 ** (n.bit_length() - 1) for n in least] == [128, 1024]


@pytest.mark.parametrize(
    ("specimen", "settings", "reason"),
    [
        (lambda: spotted(1e-3), {}, "fewer than 30 times"),
        (lambda: spotted(1e-3), {"rays": None, "noise": 0.05}, "rare bright places"),
        (lambda: field(GREY), {"period": "none"}, "periodic cell"),
        (lambda: field(MIRROR), {}, "without delta"),
        (lambda: coinciding()["sphere"], {}, "without gaps"),
        (lambda: field(GREY), {"order": 2}, "all orders"),
        (lambda: field(GREY), {"sampler": "independent"}, "sampler sobol"),
        (lambda: field(GREY), {"divergence": 1.0}, "collimated"),
        (lambda: with_faces(field(GREY), lambda f: [*f, *f[:9]]), {}, "coincide"),
        (overlapping, {}, "do not coincide: 1.5 of the incident light"),
        (lambda: field(GLOSSY), {"rays": None, "noise": 0.02}, "wide lobes"),
        (lambda: field(GLOSSY), {"rays": None, "rel_err": 0.1}, "noise or rays"),
        (lambda: field(BLACK), {}, "no light"),
    ],
)
def test_refused(specimen, settings, reason):
    with pytest.raises(SpecimenError, match=reason):
        split(specimen(), **settings)


def test_batches_may_miss_a_stratum_alike():
    """Without any scatter, and are not refused; twin: half as much light again."""
    sums = np.ones((16, 1, 1))
    surface_points.SingleScattering(sums, np.full(16, 32 + 0.2), 32).check_lit()
    with pytest.raises(SpecimenError, match=r"1\.5 of the incident light"):
        surface_points.SingleScattering(sums, np.full(16, 48.0), 32).check_lit()


def test_is_not_resumed():
    record = gonio.measure(field(GREY), 30, estimator="split", rays=2**10, **COMMON)
    with pytest.raises(SettingError, match="got the estimator split"):
        gonio.measure(
            field(GREY), 30, estimator="split", rays=2**11, resume=record, **COMMON
        )


@pytest.fixture
def adaptive(monkeypatch):
    """A function that measures a whole BSDF, in a few rounds."""
    from gonio_mi.materials import whole_bsdf

    monkeypatch.setattr(schedule, "PILOT_RAYS", 2**12)
    monkeypatch.setattr(whole_bsdf, "N_UNSEEN", 4)

    def measured(theta_max, points_noise2):
        monkeypatch.setattr(surface_points, "MAX_POINTS_NOISE2", points_noise2)
        settings = {"tolerance": 0.2, "theta_max": theta_max} | COMMON
        return campaign({"it": grooves(20, 1, bsdf=GREY)}, **settings)["it"]

    return measured


@pytest.mark.needs("materials")
def test_a_campaign_is_of_rays_where_points_do_not_pay(adaptive, monkeypatch):
    """Where it is refused from the start, rays measure all."""
    monkeypatch.setattr(surface_points, "PART_OF_NOISE", 1 / 40)
    assert str(adaptive(10, 0.0).asked.estimator) == "weighted"


@pytest.mark.needs("materials")
def test_a_campaign_keeps_what_it_found(adaptive, monkeypatch):
    """Where a round is refused late, rays tell it, and no other one anew."""
    setups, refusals, found = [], [], method.single_scattering

    def refused(some, report):
        if any(one.theta_i == 11.25 for one in some):
            refusals.append(some)
            raise SpecimenError("rays cost less")
        setups.extend(some)
        return found(some, report)

    monkeypatch.setattr(method, "single_scattering", refused)
    record = adaptive(15, np.inf)
    assert refusals
    assert str(record.asked.estimator) == "split"
    incidents = [(one.theta_i, one.phi_i, one.settings.noise) for one in setups]
    assert len(set(incidents)) == len(incidents)
    # tests are by other points than the material's
    tests = {one.theta_i for one in setups if one.settings.seed == 1}
    assert len(tests) == 4
    assert not tests & set(record.theta_i)

"""Mueller matrices measured in polarised variants, against closed forms in NumPy."""

import re
from itertools import combinations

import mitsuba as mi
import mueller
import numpy as np
import plain_bsdf
import pytest
from budget import agree, disagree, normal_scores, often_enough, verdict

import gonio_mi as gonio
from gonio_mi import cli
from gonio_mi.collector.directions import direction

# Single precision, after some dozens of operations on elements up to 1.
ROUNDING = 4e-6

METAL = 0.2 + 3.0j
CONDUCTOR = {"type": "conductor", "eta": METAL.real, "k": METAL.imag}
FEW = {"rays": 256, "batches": 2, "collector": "projected:4x8"}
FINE = {"rays": 4096, "collector": "projected:20x36", "footprint": "full"}


pytestmark = pytest.mark.usefixtures("polarised")


def _wi(theta_i, phi_i):
    return direction(np.radians(theta_i), np.radians(phi_i))


def _near(found, due):
    return np.allclose(found, due, rtol=0, atol=ROUNDING)


def test_smooth_conductor_is_fresnel():
    theta_i = [0, 30, 60, 80]
    stack = gonio.measure(CONDUCTOR, theta_i, [0, 70], **FEW)  # share launches
    due = mueller.reflection(np.cos(np.radians(np.repeat(theta_i, 2))), METAL)
    assert _near(stack.dhr_mueller[:, 0], due)
    assert np.array_equal(stack.dhr_mueller[..., 0, 0], stack.dhr)
    assert np.array_equal(stack.brdf_mueller[..., 0, 0], stack.brdf)


def test_smooth_dielectric_is_fresnel():
    """Brewster's angle among others; and total reflection, which has a phase."""
    brewster = np.degrees(np.arctan(1.5))
    glass = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
    stack = gonio.measure(glass, [30, brewster, 80], 20, **FEW)
    cosine = np.cos(np.radians(stack.theta_i))
    for found, due in (
        (stack.dhr_mueller, mueller.reflection(cosine, 1.5)),
        (stack.dht_mueller, mueller.transmission(cosine, 1.5)),
    ):
        # how many rays are reflected is chance, of which light is not
        of_light = found[:, 0] / found[:, 0, :1, :1]
        assert _near(of_light, due / due[:, :1, :1])
    from_glass = glass | {"int_ior": 1.0, "ext_ior": 1.5}
    inside = gonio.measure(from_glass, [50, 70], 20, **FEW)
    cosine = np.cos(np.radians(inside.theta_i))
    due = mueller.reflection(cosine, 1 / 1.5)
    assert _near(inside.dhr_mueller[:, 0], due)
    assert np.abs(due[:, 2, 3]).min() > 0.1


@pytest.mark.promise("Polarised light")
def test_plates_are_closed_forms():
    """Polariser, upright and tilted, wave plates and circular polariser."""
    theta = 30.0
    fast = np.array([np.cos(np.radians(theta)), -np.sin(np.radians(theta)), 0])
    slow = np.cross([0, 0, 1], fast)

    def check(plate, due, theta_i=0, phi_i=0):
        record = gonio.measure(plate, theta_i, phi_i, **FEW)
        assert _near(record.dht_mueller[0], due)

    down, k = -_wi(0, 0), -_wi(40, 20)
    due = mueller.of_path(down, down, mueller.polariser(down, slow))
    check({"type": "polarizer", "theta": theta}, due)
    due = mueller.of_path(k, k, mueller.polariser(k, [0.0, 1.0, 0.0]))
    check({"type": "polarizer"}, due, 40, 20)
    for delta in (90.0, 180.0):
        late = np.exp(1j * np.radians(delta))
        field = np.outer(fast, fast) + late * np.outer(slow, slow)
        due = mueller.of_path(down, down, field)
        check({"type": "retarder", "theta": theta, "delta": delta}, due)
    due = np.zeros((4, 4))
    due[::3, ::3] = 0.5
    check({"type": "circular"}, due)


def _wall(centre, normal, bsdf, scale=1.0):
    """Square wall about a point that faces along a normal."""
    centre, normal = np.asarray(centre, float), np.asarray(normal, float)
    transform = mi.ScalarTransform4f().look_at(
        centre.tolist(), (centre + normal).tolist(), [0.1, 1.0, 0.3]
    )
    return {
        "type": "rectangle",
        "to_world": transform @ mi.ScalarTransform4f().scale(scale),
        "bsdf": bsdf,
    }


def _after_two(record, walls, index):
    """Matrix of the patch that light reaches after two walls, and what is due there."""
    wi = _wi(record.theta_i[0], record.phi_i[0])
    k, fields = -wi, []
    for normal in walls:
        k, field = mueller.reflected(k, normal, index)
        fields.append(field)
    patch = np.unravel_index(int(record.subdivision.patch(k)), record.counts[0].shape)
    ledger = record.ledger
    share = record.counts[0][patch] / (ledger.emitted - ledger.missed)
    assert share > 0
    omega = record.subdivision.projected_solid_angles[patch]
    found = record.brdf_mueller[(*patch, 0)] * omega / share
    return found, mueller.of_path(-wi, k, *fields)


ALONG = np.array([np.cos(np.radians(140)), np.sin(np.radians(140)), 0.0])


@pytest.mark.parametrize(
    ("place", "lower", "upper", "incidents"),
    [
        ([1.5, 0, 0], [1.0, 0.0, 1.0], [-1.0, 0.5, 0.9], [(0, 0), (10, 30), (20, 90)]),
        (1.5 * ALONG, ALONG + [0, 0, 1], [0.1, -0.2, 1.0] - ALONG, [(0, 0)]),
    ],
    ids=["crossed planes", "along the horizon"],
)
@pytest.mark.promise("Polarised light")
def test_two_mirrors_are_jones_calculus(place, lower, upper, incidents):
    """Between walls of 45 degrees light flies where Mitsuba's frames jump."""
    scene = {
        "type": "scene",
        "a": _wall(-np.array(place), lower, CONDUCTOR),
        "b": _wall(place, upper, CONDUCTOR, 2.0),
    }
    for incident in incidents:
        record = gonio.measure(scene, *incident, order=2, **FEW | FINE)
        found, due = _after_two(record, (lower, upper), METAL)
        assert _near(found, due)
        # not the product in the other order
        assert not np.allclose(found, due.T, rtol=0, atol=0.01)


def test_dielectric_groove_is_jones_calculus():
    glass = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
    left, right = [0.8, 0.0, 0.6], [-0.8, 0.0, 0.6]
    scene = {
        "type": "scene",
        "a": _wall([-0.6, 0, 0], left, glass),
        "b": _wall([0.6, 0, 0], right, glass),
    }
    record = gonio.measure(scene, 20, 60, order=2, **FEW | FINE)
    for walls in ((left, right), (right, left)):
        found, due = _after_two(record, walls, 1.5)
        assert _near(found / found[0, 0], due / due[0, 0])


def test_polarisers_obey_malus():
    for theta in (0.0, 35.0, 90.0):
        lower = {"type": "polarizer", "theta": theta}
        upper = _wall([0, 0, 0.5], [0, 0, 1], {"type": "polarizer"})
        pair = {
            "type": "scene",
            "upper": upper,
            "lower": _wall([0] * 3, [0, 0, 1], lower),
        }
        record = gonio.measure(pair, 0, **FEW)
        assert _near(record.dht, np.cos(np.radians(theta)) ** 2 / 2)
        assert np.all(np.abs(record.dht_mueller) <= record.dht + ROUNDING)


ROUGH = {
    "type": "roughconductor",
    "distribution": "ggx",
    "alpha": 0.3,
    "eta": METAL.real,
    "k": METAL.imag,
}
STATISTICAL = {"collector": "projected:6x8", "sampler": "independent", "batches": 16}


def _patch_means(function, subdivision, n=12):
    """Means over patches of a function of directions, by Gauss-Legendre rules."""
    nodes, weights = np.polynomial.legendre.leggauss(n)
    theta_low, theta_high, phi_low, phi_high = subdivision.cells.T[..., None, None]
    middle = (theta_low + theta_high) / 2, (phi_low + phi_high) / 2
    theta = middle[0] + (theta_high - theta_low) / 2 * nodes[:, None]
    phi = middle[1] + (phi_high - phi_low) / 2 * nodes
    measure = weights[:, None] * weights * np.sin(theta) * np.cos(theta)
    values = function(direction(*np.broadcast_arrays(theta, phi)))
    total = np.sum(measure[..., None, None] * values, axis=(1, 2))
    means = total / np.sum(measure + 0 * phi, axis=(1, 2))[:, None, None]
    return means.reshape(*subdivision.shape, 4, 4)


@pytest.fixture(scope="module")
def facets():
    wi = _wi(50, 20)
    return _patch_means(
        lambda wo: mueller.rough_conductor(wi, wo, ROUGH["alpha"], METAL),
        gonio.EqualProjectedSolidAngle(6, 8),
    )


def test_rough_conductor_is_facets_in_all_elements(facets):
    record = gonio.measure(ROUGH, 50, 20, rays=2**20, **STATISTICAL)
    lit = record.counts[0] > 2000
    assert lit.sum() > 25
    values, std_err = record.brdf_mueller[lit][:, 0], record.brdf_mueller_std_err[lit]

    def z(due, i, j):
        t = (values - due[lit])[:, i, j] / std_err[:, 0, i, j]
        return normal_scores(t, record.n_batches - 1)

    for i in range(4):
        for j in range(4):
            if (i, j) not in ((0, 3), (3, 0)):  # no light, but for rounding
                agree(verdict(z(facets, i, j)))
    flipped = np.diag([1, 1, 1, -1]) @ facets
    disagree(verdict(z(flipped, 3, 2)))
    disagree(verdict(z(facets.swapaxes(-1, -2), 0, 1)))


def test_intervals_cover_elements_and_degrees_of_polarisation(facets):
    """Weak degrees, of which noise has more than the light, and strong ones."""
    lights = np.array([[1, 0, 0, 0], [1, 0, 0.6, 0.8]])
    stokes = facets @ lights.T
    lit = (stokes[..., 0, :] > 0.02).all(axis=-1)
    due = np.linalg.norm(stokes[lit][:, 1:], axis=1) / stokes[lit][:, 0]
    assert due.min() < 0.01
    assert due.max() > 0.99
    wrong = np.where(due > 0.5, due - 0.1, due + 0.1)
    elements, covered, other = [], [], []
    for seed in range(12):
        record = gonio.measure(ROUGH, 50, 20, rays=2**13, seed=seed, **STATISTICAL)
        low, high = record.interval(0.95, "brdf_mueller")
        elements.append((low[:, :, 0] <= facets) & (facets <= high[:, :, 0]))
        limits = [record.degree_interval(light, 0.95) for light in lights]
        low, high = np.stack(limits, axis=-1)[:, lit, 0]
        covered.append(np.mean((low <= due) & (due <= high)))
        other.append(np.mean((low <= wrong) & (wrong <= high)))
    for where in (facets[..., 0, 0] > 0.2, facets[..., 0, 0] < 0.2):
        agree(often_enough(np.mean(np.array(elements)[:, where], axis=(1, 2, 3))))
    agree(often_enough(covered))
    disagree(often_enough(other))


@pytest.mark.needs("analysis")
@pytest.mark.needs("exchange")
def test_a_record_is_all_there(tmp_path):
    """Files, Stokes vectors, and what is refused, each in one sentence."""
    record = gonio.measure(ROUGH, [0, 50], 20, rays=2**13, **STATISTICAL)
    assert record.brdf_mueller.shape == (2, 6, 8, 1, 4, 4)
    for ending in ("npz", "exr"):
        record.save(tmp_path / f"run.{ending}")
        assert gonio.load(tmp_path / f"run.{ending}") == record
    half = gonio.measure(ROUGH, 50, 20, rays=2**13, seed=7, **STATISTICAL)
    both = record[1].merge(half)
    assert np.allclose(
        both.dhr_mueller, (record[1].dhr_mueller + half.dhr_mueller) / 2, rtol=1e-12
    )
    found = gonio.compare(record[1], half)
    assert found.verdict == "agree"
    assert len(set(found.channel)) == 16
    turned = gonio.measure(ROUGH | {"k": 2.0}, 50, 20, rays=2**13, **STATISTICAL)
    assert gonio.compare(turned, half).verdict == "differ"
    values, std_err = record.stokes([1, 1, 0, 0])
    due = record.brdf_mueller[..., 0] + record.brdf_mueller[..., 1]
    assert np.allclose(values, due, rtol=1e-12)
    assert np.isfinite(std_err[record.counts[:, 0] > 0]).all()
    for wrong in ([1, 1, 1, 0], [0, 0, 0, 0], [1, 0], "light"):
        with pytest.raises(ValueError, match="stokes must be"):
            record.stokes(wrong)
    with pytest.raises(ValueError, match=r"\.xml holds no Mueller matrices"):
        gonio.export(record, tmp_path / "run.xml")
    gonio.export(record[1], tmp_path / "run.csv")
    head = (tmp_path / "run.csv").read_text().splitlines()
    (names,) = (line for line in head if line.startswith("theta_i,"))
    assert "M01" in names
    assert "sigma_M33" in names
    with pytest.raises(gonio.VariantError, match="quadrature needs an unpolarised"):
        gonio.measure(ROUGH, 50, estimator="quadrature")
    with pytest.raises(gonio.VariantError, match="tolerance needs an unpolarised"):
        gonio.campaign({"metal": ROUGH}, tolerance=0.1)


def test_no_word_of_a_picture_of_polarisation_is_on_another(tmp_path):
    """Of reflection and transmission: headings, and the names of colour bars."""
    pytest.importorskip("matplotlib")
    from matplotlib.text import Text

    from gonio_mi.plots import plot_stokes

    glass = {"type": "dielectric"}
    figure = plot_stokes(gonio.measure(glass, 56, rays=2**10), tmp_path / "a.png")
    named = "Reflection", "Transmission", "BRDF (1/sr)", "BTDF (1/sr)"
    places = {
        word.get_text(): word.get_window_extent()
        for word in figure.findobj(Text)
        if word.get_text() in named
    }
    assert set(places) == set(named)
    pairs = combinations(places.values(), 2)
    assert not any(one.overlaps(other) for one, other in pairs)


def test_pictures_and_numbers_show_the_matrices(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    from gonio_mi.plots import plot_mueller, plot_stokes

    record = gonio.measure(ROUGH, 50, 20, rays=2**13, **STATISTICAL)
    lit = record.counts[0] > 0
    figure = plot_mueller(record)
    maps = {axes.get_title(): axes for axes in figure.axes if axes.get_title()}
    assert len(maps) == 16
    drawn = maps["M23 / M00"].collections[0].get_array()
    m = record.brdf_mueller[:, :, 0]
    due = np.divide(m[..., 2, 3], m[..., 0, 0], where=lit, out=np.zeros(lit.shape))
    assert np.allclose(drawn[:, :: drawn.shape[1] // 8][lit], due[lit], atol=1e-12)
    figure = plot_stokes(record, stokes=[1, 0, 0, 1])
    circular = figure.subfigs[0].subfigs[0].axes[3].collections[0].get_array()
    due = (m[..., 3, 0] + m[..., 3, 3]) / np.where(lit, m[..., 0, 0] + m[..., 0, 3], 1)
    assert np.allclose(circular[:, :: drawn.shape[1] // 8][lit], due[lit], atol=1e-12)
    due = np.hypot(np.hypot(m[..., 1, 0], m[..., 2, 0]), m[..., 3, 0])[lit]
    figure = plot_stokes(record)
    drawn = figure.subfigs[0].subfigs[0].axes[1].collections[0]
    degrees = due / m[..., 0, 0][lit]
    assert drawn.norm.vmax == pytest.approx(degrees.max(), rel=1e-12)
    said = drawn.colorbar.ax.get_xlabel()
    assert said == f"degree of polarisation, at most {degrees.max():.2g}"
    titles = set()
    for vector in ([1, 0, 0, 0], [2, 2, 0, 0], [1, -1, 0, 0]):
        title = plot_stokes(record, stokes=vector).get_suptitle()
        titles.add(dhr := re.search("dhr.([0-9.]+)", title)[1])
        power, std_err = (x[0, 0] / vector[0] for x in record.stokes(vector, "dhr"))
        assert abs(float(dhr) - power) < std_err  # which has two digits in the title
    assert len(titles) == 3
    path = str(tmp_path / "run.npz")
    record.save(path)
    assert cli.main(["show", path, "--stokes", "1", "1", "0", "0"]) == 0
    shown = capsys.readouterr().out
    (light, q, *_), _ = (x[0] for x in record.stokes([1, 1, 0, 0], "dhr"))
    assert f"{light:.5f}" in shown
    assert f"{q / light:.5f}" in shown
    assert "-0.00000" not in shown
    assert "incident Stokes vector: 1 1 0 0" in shown
    assert "greatest degree of a patch" in shown
    assert cli.main(["plot", path, "--mueller", "-o", str(tmp_path / "a.png")]) == 0
    words = ["plot", path, "--stokes", "1", "0", "0", "2"]
    assert cli.main([*words, "-o", str(tmp_path / "b.png")]) == 1
    assert "must be light" in capsys.readouterr().err
    mono = tmp_path / "mono.npz"
    mi.set_variant("llvm_ad_mono")
    gonio.measure({"type": "diffuse"}, 0, rays=64, collector="angle:2x2").save(mono)
    assert cli.main(["show", str(mono), "--stokes", "1", "1", "0", "0"]) == 1
    assert "need a polarised variant" in capsys.readouterr().err


def test_errors_of_normalised_stokes_are_those_of_ratios(tmp_path, capsys):
    """At Brewster's angle Q is I, however many rays are reflected."""
    brewster = np.degrees(np.arctan(1.5))
    glass = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
    record = gonio.measure(glass, brewster, rays=2**12, sampler="independent")
    value, std_err = (x[0] for x in record.normalised_stokes([1, 0, 0, 0], "dhr"))
    assert np.allclose(value, [1, 0, 0], rtol=0, atol=ROUNDING)
    assert std_err.max() <= ROUNDING
    alone = record.stokes([1, 0, 0, 0], "dhr")[1][0, 1] / record.dhr[0]
    assert alone > 100 * ROUNDING
    patches, errors = record.normalised_stokes([1, 0, 0, 0])
    assert np.allclose(patches[record.counts[0] > 0, 0], [1, 0, 0], atol=ROUNDING)
    assert errors.shape == patches.shape == (*record.brdf.shape, 3)
    record.save(path := str(tmp_path / "glass.npz"))
    assert cli.main(["show", path]) == 0
    shown = capsys.readouterr().out.partition("incident Stokes")[2]
    row = next(line.split() for line in shown.splitlines() if " dhr " in line)
    assert row[-3] == row[-1] == "<6e-08"
    assert "<: below single-precision rounding" in " ".join(shown.split())


def test_own_bsdfs_depolarise():
    record = gonio.measure({"type": "glossymixture"}, 40, 20, **FEW)
    assert record.dhr[0] > 0.1
    due = np.zeros((4, 4))
    due[0, 0] = record.dhr[0]
    assert np.array_equal(record.dhr_mueller[0], due)


def test_what_no_surface_does_is_invalid():
    class Impossible(plain_bsdf.plain()):
        """Polarises light by more than there is."""

        def weight(self, ctx, si, bs):  # noqa: ARG002
            weight = mi.Spectrum(0.5)
            weight[0, 1] = mi.UnpolarizedSpectrum(0.6)
            return weight

    plain_bsdf.register([Impossible])
    with pytest.warns(RuntimeWarning, match="elements above the first"):
        record = gonio.measure({"type": "impossible"}, 40, 20, **FEW)
    assert record.ledger.invalid == record.ledger.emitted
    assert not record.brdf.any()

"""Micro-normals and masking of surfaces: against facets, identities, closed forms."""

import numpy as np
import pytest
from budget import agree, count_verdict, disagree, single
from closed_forms import micro_normal_density
from scipy import integrate

import gonio_mi as gonio
from gonio_mi.analysis import smith
from gonio_mi.analysis.micro_normals import LINE_STYLES
from gonio_mi.cli import main
from gonio_mi.errors import SpecimenError
from gonio_mi.surfaces.heights import gaussian_heights, height_statistics

# isort: split
import mitsuba as mi

N, SIZE = 64, 2.0
EPS = float(np.finfo(np.float32).eps)


def field(**settings):
    asked = {"alpha_u": 0.5, "alpha_v": 0.3, "resolution": N, "size": SIZE} | settings
    return {"type": "heightfield", **asked}


def facets(seed=0):
    """Normals and areas of the triangles of that field, by NumPy alone."""
    z = gaussian_heights((N, N), SIZE / N, (0.5, 0.3), SIZE / 16, seed=seed)
    z = np.pad(z, ((0, 1), (0, 1)), mode="wrap")
    x = np.arange(N + 1) * SIZE / N
    p = np.stack([*np.meshgrid(x, x), z], axis=-1)
    a, b, c, d = p[:-1, :-1], p[:-1, 1:], p[1:, :-1], p[1:, 1:]
    both = np.concatenate([np.cross(b - a, d - a), np.cross(d - a, c - a)])
    both = both.reshape(-1, 3) / 2
    area = np.linalg.norm(both, axis=1)
    return both / area[:, None], area


@pytest.fixture(scope="module")
def found():
    mi.set_variant("llvm_ad_mono")
    return gonio.micro_normals(field(), points=2**16, theta=(40, 70, 80), phi=(0, 90))


def test_density_is_that_of_the_facets(found):
    """Counts of random points in rings; twin: the facets of another surface."""
    points = 2**16

    def verdict(seed):
        n, area = facets(seed)
        theta = np.degrees(np.arccos(n[:, 2]))
        expected, _ = np.histogram(theta, found.theta_edges, weights=area)
        total = area.sum()
        solid = -2 * np.pi * np.diff(np.cos(np.radians(found.theta_edges)))
        counts = found.density * solid * SIZE**2 / total * points
        return count_verdict(counts, expected + 1e-12)

    agree(verdict(0))
    disagree(verdict(1))


def test_alphas_are_those_of_the_heights(found):
    """Beckmann's alphas of the facets, which the heights have by difference quotients.

    The points are fewer than what blocks of surface scatter, so the score is narrow;
    twin: 10 % off.
    """
    z = gaussian_heights((N, N), SIZE / N, (0.5, 0.3), SIZE / 16)
    exact = height_statistics(z, SIZE / N)
    error = found.alpha_std_errs["beckmann"]
    for alpha, std_err, truth in zip(
        found.alphas["beckmann"], error, (exact.alpha_u, exact.alpha_v)
    ):
        agree(single((alpha - truth) / std_err))
        assert std_err < 0.06 * truth
    assert found.elsewhere["beckmann"] < found.elsewhere["ggx"] / 2


def test_a_plane_is_seen_as_large_as_it_is(found):
    """Seen from afar, facets cover cos(theta) of the plane, whatever hides them.

    Exact for a closed surface: G1 is that over all that looks there. Binomial error of
    the points; twin: one that hides nothing.
    """
    n, area = facets()
    for i, (theta, phi) in enumerate(
        zip(np.radians(found.theta), np.radians(found.phi))
    ):
        towards = [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi)]
        cosines = n @ [*towards, np.cos(theta)]
        facing = np.maximum(cosines, 0)
        exact = np.cos(theta) * SIZE**2 / (facing @ area)
        # 1 - exact, as the facets that look away cover it: not below 0 by rounding
        hidden = np.maximum(-cosines, 0) @ area / (facing @ area)
        # of points in proportion to area, each counts as it faces there
        effective = (facing @ area) ** 2 / (facing**2 @ area) / area.sum() * 2**16
        error = np.sqrt(exact * hidden / effective) + 1e-5
        agree(single((found.masking[i] - exact) / error))
        if exact < 0.95:
            disagree(single((1 - exact) / error))
            assert 0 < found.shadowing[i] < found.masking[i]


def test_grooves_hide_what_they_must():
    """V-grooves of 45 degrees from 60: a closed form; twin: 5 % off.

    Of the walls that look there, in the direction across, the visible part is
    cos(60) / (cos(60) + sin(60)) times 2; along the grooves all is seen.
    """
    z = np.tile([0.0, 1.0], (8, 4))
    grooves = {"type": "heightfield", "heights": mi.TensorXf(z), "size": 8.0}
    found = gonio.micro_normals(grooves, points=2**14, theta=(60,), phi=(0, 90))
    theta = np.radians(60)
    across = 2 * np.cos(theta) / (np.cos(theta) + np.sin(theta))
    error = np.sqrt(across * (1 - across) / 2**13)
    agree(single((found.masking[0] - across) / error))
    disagree(single((found.masking[0] - 1.05 * across) / error))
    assert found.masking[1] == 1
    assert np.count_nonzero(found.density) == 1


@pytest.mark.parametrize("name", smith.DISTRIBUTIONS)
def test_models_are_normalised(name):
    """Convergence: densities project to 1, and masking is what that asks of Smith's.

    The facets that look anywhere, times their visible part, cover the cosine.
    """
    alphas = 0.4, 0.25

    def projected(theta):
        value = micro_normal_density(name, np.array(theta), *alphas)
        return float(value * np.cos(theta) * np.sin(theta) * 2 * np.pi)

    assert abs(integrate.quad(projected, 0, np.pi / 2)[0] - 1) < 1e-6
    alpha, theta_o, n = 0.4, np.radians(65), 2000
    # midpoints, of the second order in the step, also where facets turn away
    theta = (np.arange(n) + 0.5)[:, None] * (np.pi / 2 / n)
    phi = (np.arange(n) + 0.5) * (2 * np.pi / n)
    cosine = np.cos(theta) * np.cos(theta_o)
    cosine = cosine + np.sin(theta) * np.sin(theta_o) * np.cos(phi)
    value = micro_normal_density(name, theta, alpha, alpha) * np.sin(theta)
    area = (np.maximum(cosine, 0) * value).sum() * np.pi**2 / n**2
    g1 = smith.masking(name, np.array(theta_o), np.array(0.0), alpha, alpha)
    assert abs(float(g1) * area - np.cos(theta_o)) < 1e-5


def test_alphas_of_largest_likelihood():
    """Statistics: slopes drawn from both distributions; twin: the other's."""
    rng, n = np.random.default_rng(1), 20_000
    gauss = rng.normal(size=(2, n)) * np.array([[0.4], [0.2]]) / np.sqrt(2)
    heavy = gauss * np.sqrt(2 / rng.chisquare(2, n))
    for name, slopes, other in (("beckmann", gauss, "ggx"), ("ggx", heavy, "beckmann")):
        found = smith.fitted_alphas(name, *slopes, np.ones(n))
        # the information of one slope: 2 / alpha^2, and for GGX half of that
        error = found / np.sqrt(2 * n) * (1 if name == "beckmann" else np.sqrt(2))
        for i, truth in enumerate((0.4, 0.2)):
            agree(single((found[i] - truth) / error[i]))
            wrong = smith.fitted_alphas(other, *slopes, np.ones(n))[i]
            disagree(single((wrong - truth) / error[i]))


def test_alphas_of_grooves():
    """Statistics: slopes of one direction only, drawn from the marginals of both."""
    rng, n, alpha = np.random.default_rng(2), 20_000, 0.3
    u = rng.uniform(-1, 1, n)
    drawn = {
        "beckmann": rng.normal(size=n) * alpha / np.sqrt(2),
        "ggx": alpha * u / np.sqrt(1 - u**2),
    }
    # the information of one slope about alpha: 2 / alpha^2, and 4 / (5 alpha^2)
    for name, information in (("beckmann", 2.0), ("ggx", 0.8)):
        found, flat = smith.fitted_alphas(name, drawn[name], np.zeros(n), np.ones(n))
        assert flat == smith.MIN_ALPHA
        error = alpha / np.sqrt(n * information)
        agree(single((found - alpha) / error))
        disagree(single((1.05 * found - alpha) / error))
    # exact: the likelihood of slopes of one size is largest at sqrt(2) of it, for both
    for name in drawn:
        (found, _) = smith.fitted_alphas(
            name, np.array([0.5, -0.5]), np.zeros(2), np.ones(2)
        )
        np.testing.assert_allclose(found, 0.5 * np.sqrt(2), rtol=1e-6)


def test_other_shapes_have_normals_too():
    """A sphere: its points are as many in each solid angle; twin: as on a plane."""
    found = gonio.micro_normals({"type": "sphere"}, points=2**14, theta=(0,), phi=(0,))
    edges = np.radians(found.theta_edges)
    solid = -2 * np.pi * np.diff(np.cos(edges))
    # 4 pi of surface over 4 of plane
    counts = found.density * solid * 2**14 / np.pi
    agree(count_verdict(counts, solid))
    disagree(count_verdict(counts, np.diff(np.sin(edges) ** 2)))


def test_bad_input_is_one_sentence():
    with pytest.raises(ValueError, match="blocks must be at least 2"):
        gonio.micro_normals(field(), blocks=1)
    with pytest.raises(ValueError, match="theta must be an angle"):
        gonio.micro_normals(field(), theta=(95,))
    scene = {
        "type": "scene",
        "group": {"type": "shapegroup", "one": {"type": "sphere"}},
        "copy": {"type": "instance", "shapegroup": {"type": "ref", "id": "group"}},
    }
    with pytest.raises(SpecimenError, match="without instances"):
        gonio.micro_normals(scene)


def test_command(tmp_path, capfd):
    """A file of heights: what it is like, what is doubtful, and how its facets lie."""
    z = gaussian_heights((N, N), 0.25, (0.3, 0.3), 1.0) + 0.1 * np.arange(N)
    np.save(tmp_path / "a.npy", z)
    command = ["surface", str(tmp_path / "a.npy"), "--size", "15.75"]
    command += ["--form", "plane", "--unit", "um", "--points", "1e4"]
    assert main([*command, "-o", str(tmp_path / "a.png")]) == 0
    said = capfd.readouterr()
    assert "64 x 64, 0.25 x 0.25 um apart" in said.out
    assert "slopes    rms" in said.out
    assert "as beckmann" in said.out
    assert "are smaller than the wavelength, 0.25 um" in said.err
    assert (tmp_path / "a.png").stat().st_size > 10_000


@pytest.mark.parametrize(("alpha", "least", "most"), [(0.02, 8, 12), (0.3, 40, 70)])
def test_the_picture_ends_where_the_facets_do(alpha, least, most):
    mi.set_variant("llvm_ad_mono")
    flat = gonio.micro_normals(field(alpha_u=alpha, alpha_v=alpha), points=2**12)
    (low, high) = flat.plot().axes[0].get_xlim()
    assert low == 0
    assert flat.theta_edges[np.flatnonzero(flat.density)[-1] + 1] <= high
    assert least <= high <= most
    assert len(repr(flat)) < 100


def test_colours_of_the_picture_are_azimuths_and_its_line_styles_models(found):
    """Exact: of both panels, and the legend of the right one says so."""
    left, right = found.plot().axes
    colours = {line.get_label(): line.get_color() for line in right.lines}
    texts = [text.get_text() for text in right.get_legend().get_texts()]
    azimuths = np.unique(found.phi)
    assert texts == [
        *(f"{name}, Smith" for name in LINE_STYLES),
        *(f"φ = {phi:g}°, facets +- std_err" for phi in azimuths),
    ]
    of_azimuths = {bars[0].get_color() for bars in right.containers}
    assert len(of_azimuths) == len(azimuths)
    for line, (name, style) in zip(left.lines[1:], LINE_STYLES.items()):
        assert line.get_label().startswith(name)
        assert line.get_linestyle() == style
        assert line.get_color() == colours[f"{name}, Smith"]
        assert line.get_color() not in of_azimuths


def test_rectangles_show_no_triangles():
    """Two that face +z, one above a part of the other, as exact shares of area."""
    above = mi.ScalarTransform4f().translate([0, 0, 0.5]).scale(0.5)
    plates = {
        "type": "scene",
        "low": {"type": "rectangle"},
        "high": {"type": "rectangle", "to_world": above},
    }
    points = 2**12
    found = gonio.micro_normals(plates, points=points, theta=(0,), phi=(0,))
    ring = -2 * np.pi * np.diff(np.cos(np.radians(found.theta_edges)))
    area = found.density * ring
    assert area[0] == pytest.approx(1 + 0.25, rel=points * EPS)
    assert not area[1:].any()
    # a quarter of the lower one is hidden: 1 of 1.25 is seen
    error = np.sqrt(0.8 * 0.2 / points)
    agree(single((found.masking[0] - 0.8) / error))
    disagree(single((found.masking[0] - 1) / error))
    upright = mi.ScalarTransform4f().rotate([1, 0, 0], 90)
    wall = {"type": "rectangle", "to_world": upright}
    with pytest.raises(SpecimenError, match="extended along x and y"):
        gonio.micro_normals(wall, points=points)
    with pytest.raises(ValueError, match="phi must be an angle in degrees, got nan"):
        gonio.micro_normals(plates, phi=(np.nan,))
    # a plane is what both models are without roughness
    plane = gonio.micro_normals({"type": "rectangle"}, points=points)
    # but that in a ring the mean cosine stands for each: of the first, for 1
    assert max(plane.elsewhere.values()) < (1 - np.cos(np.radians(2))) / 2
    assert "as ggx          flat                  flat " in str(plane)
    assert plane.model_density("ggx")[0] == pytest.approx(plane.density[0], rel=1e-3)


@pytest.mark.parametrize("name", smith.DISTRIBUTIONS)
def test_means_of_rings_are_the_density(name):
    """Convergence, by Gauss's rule over angles where that resolves the lobe.

    A lobe narrower than a ring, which it does not, has an area of 1: rounding, with the
    squares of alpha that are left.
    """
    edges = np.linspace(0, 90, 46)
    low, high = np.radians(edges[:-1, None]), np.radians(edges[1:, None])
    nodes, weights = np.polynomial.legendre.leggauss(64)
    theta = (low + high) / 2 + nodes * (high - low) / 2
    weight = weights * np.sin(theta)
    values = micro_normal_density(name, theta, 0.5, 0.3) * weight
    means = smith.ring_means(name, edges, 0.5, 0.3)
    assert np.allclose(means, values.sum(1) / weight.sum(1), rtol=1e-6, atol=1e-12)
    narrow = smith.ring_means(name, edges, 1e-4, 1e-4)
    solid = -2 * np.pi * np.diff(np.cos(np.radians(edges)))
    assert narrow @ solid == pytest.approx(1, rel=1e-6)


def test_what_no_facet_sees_is_no_number():
    """No wall of 65 degrees is seen from 60 degrees and from the mirror direction.

    Twin: those of 20 degrees are.
    """
    for slope, named in ((65, True), (20, False)):
        heights = np.tile(
            np.tan(np.radians(slope)) * np.abs(np.arange(8) - 4.0), (8, 1)
        )
        tent = {"type": "heightfield", "heights": mi.TensorXf(heights), "size": 8.0}
        said = str(gonio.micro_normals(tent, points=1000, theta=(60,), phi=(0,)))
        assert ("  -  " in said) == said.endswith("-: there is no such facet") == named
        assert "nan" not in said


@pytest.mark.parametrize("alphas", [(0.3, 0.3), (0.5, 0.1)])
@pytest.mark.parametrize("name", smith.DISTRIBUTIONS)
def test_shares_of_rings_are_the_density(name, alphas):
    """Against adaptive integrals of the density; in all they are 1."""
    edges = np.linspace(0, 90, 10)
    shares = smith.ring_shares(name, edges, *alphas)
    assert shares.sum() == pytest.approx(1, rel=1e-13)  # rounding

    def light(theta):
        value = micro_normal_density(name, np.array(theta), *alphas)
        return 2 * np.pi * value * np.sin(theta) * np.cos(theta)

    for low, high, share in zip(np.radians(edges), np.radians(edges[1:]), shares):
        exact = integrate.quad(light, low, min(high, np.pi / 2 - 1e-9))[0]
        assert share == pytest.approx(exact, abs=1e-8)  # what quad promises

"""The paper's materials: lobes, mixture and facets, against formulas written anew here.

Three functions of a BSDF are three claims, and each meets a reference of its own:
`eval` the formula in float64, `pdf` the counts of sampled directions, `sample` the
integral of `eval`.
"""

import itertools
import re
from functools import lru_cache

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from budget import Verdict, agree, count_verdict, disagree, scores, single, verdict
from closed_forms import patch_fluxes, vectors
from scipy import special, stats

import gonio_mi as gonio
from gonio_mi.collector.directions import direction
from gonio_mi.plugins.phong_facets import averted_area, averted_area_table, mean_cosine
from gonio_mi.quadrature.evaluator import square
from gonio_mi.specimen.specimen_text import parse_specimen

EPS = 2.0**-24  # largest relative rounding error of a float32 operation
RAYS = 2 * 10**6
PHI_I = 25.0

SPECIMENS = {
    "unit": {"type": "cosinelobe"},
    "unit 200": {"type": "cosinelobe", "exponent": 200.0, "reflectance": 0.7},
    "phong": {"type": "cosinelobe", "normalisation": "modified_phong"},
    "mixture": {"type": "glossymixture"},
    "mixture phong": parse_specimen(
        "glossymixture:diffuse_reflectance=0.3,specular_reflectance=0.6,"
        "exponent=60.0,normalisation=modified_phong"
    ),
    "facets": {"type": "anisotropicphong"},
    "facets rough": parse_specimen(
        "anisotropicphong:exponent_u=6.0,exponent_v=0.0,f0=0.04"
    ),
}
EXPONENTS = ((0, 0), (0.5, 3), (50, 1000), (1e5, 10), (1e6, 1e6))


# ------------------------------------------------------------------ the formulas, anew


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def cosine_density(n, wi, wo):
    """Exponentiated cosine about the mirror direction, and the cosine itself."""
    cos = np.sum(unit(wi) * [-1, -1, 1] * unit(wo), axis=-1)
    return np.where(cos > 0, (n + 1) / (2 * np.pi) * np.abs(cos) ** n, 0), cos


def lobe_flux(form, n, wi, wo):
    """BRDF times cosine of the lobe, of unit reflectance."""
    density, _ = cosine_density(n, wi, wo)
    if form == "modified_phong":
        density *= (n + 2) / (n + 1) * unit(wo)[..., 2]
    return density


def lost(n, theta):
    """Part of the exponentiated cosine below the horizon, closed form."""
    return special.betainc((n + 1) / 2, 0.5, np.sin(theta) ** 2) / 2


def reflected(form, n, theta):
    """Directional albedo of the lobe, closed form."""
    if form == "unit":
        return 1 - lost(n, theta)
    gammas = np.exp(special.gammaln((n + 3) / 2) - special.gammaln((n + 4) / 2))
    edge = (n + 2) / (n + 1) * gammas / (2 * np.sqrt(np.pi))
    return (1 - lost(n + 1, theta)) * np.cos(theta) + edge * np.sin(theta) ** (n + 2)


def facing_area(k, e_u, e_v):
    """g(k) by brute force: the definition, summed over facets that face `k`."""
    psi = (np.arange(4096) + 0.5) * (2 * np.pi / 4096)
    x = np.sqrt(e_v + 1) * np.cos(psi)
    y = np.sqrt(e_u + 1) * np.sin(psi)
    cos, sin = x / np.hypot(x, y), y / np.hypot(x, y)
    exponent = e_u * cos**2 + e_v * sin**2
    node, weight = np.polynomial.legendre.leggauss(64)
    areas = []
    for k_x, k_y, k_z in np.reshape(k, (-1, 3)):
        along = k_x * cos + k_y * sin
        end = np.where(along >= 0, np.pi / 2, np.arctan2(k_z, -along))
        # beyond 14 standard deviations is less than 1e-40
        end = np.minimum(end, 14 / np.sqrt(exponent + 1))[:, None]
        theta = (node + 1) / 2 * end
        p = (exponent[:, None] + 1) * np.cos(theta) ** exponent[:, None] * np.sin(theta)
        towards = along[:, None] * np.sin(theta) + k_z * np.cos(theta)
        areas.append(np.mean((p * towards * end / 2) @ weight))
    return np.reshape(areas, np.shape(k)[:-1])


def facets_brdf(wi, wo, e_u, e_v, f0):
    """The microfacet BRDF. Also the cosine of h and its exponent."""
    # unnormalised, as float32 holds them: a sharp highlight would feel the difference
    h = unit(wi + wo)
    cos_d = np.linalg.norm(wi + wo, axis=-1) / 2
    phi = np.arctan2(h[..., 1], h[..., 0])
    exponent = e_u * np.cos(phi) ** 2 + e_v * np.sin(phi) ** 2
    p = np.sqrt((e_u + 1) * (e_v + 1)) / (2 * np.pi) * h[..., 2] ** exponent
    fresnel = f0 + (1 - f0) * (1 - cos_d) ** 5
    mean = np.sqrt((e_u + 1) / (e_u + 2) * (e_v + 1) / (e_v + 2))
    areas = [k[..., 2] * mean + averted_area(k, e_u, e_v) for k in (wi, wo)]
    return mean * p * fresnel / (4 * areas[0] * areas[1]), h[..., 2], exponent


def power_error(n, cos, operations=30):
    """Bound of the relative rounding error of cos**n times some factors.

    The chord, known to a few EPS of itself, gives 1 - cos to a few EPS of itself, so
    that log(cos) is off by a few EPS of (1 - cos) / cos.
    """
    return operations * EPS * (1 + n * (1 / cos - 1))


# ------------------------------------------------------------------ calling the plugins


def interaction(wi, nm=550.0):
    si = square()
    if mi.is_spectral:
        si.wavelengths = mi.Spectrum(nm)
    si.wi = vectors(wi)
    return si


def array(x, n):
    """Float64 of shape (n, channels) of a spectrum, (n,) of a number."""
    values = np.array(x, dtype=float)
    if values.ndim == 2:
        return np.broadcast_to(values.T, (n, len(values)))
    return np.broadcast_to(values, (n,))


def context(mode=None, **masks):
    """Flux as the instrument sends it, unless told otherwise."""
    ctx = mi.BSDFContext(mi.TransportMode.Importance if mode is None else mode)
    for name, value in masks.items():
        setattr(ctx, name, value)
    return ctx


def evaluate(bsdf, wi, wo, **masks):
    """`eval` of one channel and `pdf`, float64 of shape (n,)."""
    n = max(np.size(wi), np.size(wo)) // 3
    value, pdf = bsdf.eval_pdf(context(**masks), interaction(wi), vectors(wo))
    dr.eval(value, pdf)
    return array(value, n)[:, 0], array(pdf, n)


def draw(bsdf, wi, n=10**5, seed=1, **masks):
    """Sampled directions, and all that `sample` says of them."""
    samples = np.random.default_rng(seed).random((3, n), dtype=np.float32)
    # the corners of the unit square
    samples[1:, :4] = np.indices((2, 2)).reshape(2, 4) * (1 - EPS)
    *two, one = vectors(samples[[1, 2, 0]].T)
    bs, weight = bsdf.sample(context(**masks), interaction(wi), one, mi.Point2f(two))
    dr.eval(bs, weight)
    return bs, array(weight, n)


def pairs(n=2000, seed=3):
    """Pairs of directions above the horizon as float32 can hold them."""
    z, phi = np.random.default_rng(seed).random((2, 2, n))
    phi *= 2 * np.pi
    sin = np.sqrt(1 - z**2)
    v = np.stack([sin * np.cos(phi), sin * np.sin(phi), z], axis=-1)
    return v.astype(np.float32).astype(float)


def incident(theta_i, phi_i=PHI_I):
    return direction(np.radians(theta_i), np.radians(phi_i))


def dhr(bsdf, theta_i, phi_i=PHI_I):
    """Reflectance and its error, by converged quadrature of `eval`."""
    wi, grid = incident(theta_i, phi_i), gonio.subdivision("projected:8x16")

    def flux(wo):
        return evaluate(bsdf, wi, wo)[0][:, None]

    values, errors = patch_fluxes(flux, grid, tolerance=1e-5 / grid.n_patches)
    return values.sum(), errors.sum()


# ------------------------------------------------------------------ creation


@pytest.mark.usefixtures("variant")
@pytest.mark.parametrize("name", SPECIMENS)
def test_creation_flags_and_values(name):
    bsdf = mi.load_dict(SPECIMENS[name])
    mixture, reciprocal = "mixture" in name, "unit" not in name and name != "mixture"
    assert bsdf.component_count() == 1 + mixture
    flags = bsdf.flags()
    has = [x for x in FLAGS if mi.has_flag(flags, getattr(mi.BSDFFlags, x))]
    expected = {"GlossyReflection", "FrontSide"}
    expected |= {"DiffuseReflection"} if mixture else set()
    expected |= set() if reciprocal else {"NonSymmetric"}
    expected |= {"Anisotropic"} if "facets" in name else set()
    assert set(has) == expected
    flags = [bsdf.flags(i) for i in range(bsdf.component_count())]
    assert np.bitwise_or.reduce(flags) == bsdf.flags()
    assert "exponent" in str(bsdf)
    # the same numbers in every variant, in each channel
    wi, wo = incident(40), incident(44, PHI_I + 184)
    value = array(bsdf.eval(context(), interaction(wi), vectors(wo)), 1)[0]
    assert len(value) == len(mi.Spectrum())
    # rounding, and two areas from the facets' table
    bound = power_error(1000, 0.999) + 4.4e-5
    np.testing.assert_allclose(value, model_flux(name, wi, wo), rtol=bound)


FLAGS = ("DiffuseReflection", "GlossyReflection", "DeltaReflection", "Null")
FLAGS += ("DiffuseTransmission", "GlossyTransmission", "DeltaTransmission")
FLAGS += ("Anisotropic", "NonSymmetric", "FrontSide", "BackSide")


def model_flux(name, wi, wo):
    """`eval` of a specimen by the formulas above."""
    values = {"exponent": 16.0, "normalisation": "unit", "reflectance": 1.0}
    values |= {"diffuse_reflectance": 0.8, "specular_reflectance": 0.2}
    values |= {"exponent_u": 50.0, "exponent_v": 1000.0, "f0": 1.0} | SPECIMENS[name]
    cos_o = unit(wo)[..., 2]
    if values["type"] == "anisotropicphong":
        e_u, e_v = values["exponent_u"], values["exponent_v"]

        return facets_brdf(wi, wo, e_u, e_v, values["f0"])[0] * cos_o
    flux = lobe_flux(values["normalisation"], values["exponent"], wi, wo)
    if values["type"] == "cosinelobe":
        return values["reflectance"] * flux
    diffuse = values["diffuse_reflectance"] * cos_o / np.pi
    return diffuse + values["specular_reflectance"] * flux


@pytest.mark.parametrize(
    ("kind", "key", "value", "message"),
    [
        ("cosinelobe", "exponent", -1.0, "{} must be .* from 0 to 1000000, got -1"),
        ("cosinelobe", "exponent", 2e6, "{} must be .* from 0 to 1000000, got 2000000"),
        ("cosinelobe", "exponent", "sharp", "{} must be a number .*, got 'sharp'"),
        ("cosinelobe", "normalisation", "phong", "{} must be one of .*, got 'phong'"),
        ("cosinelobe", "reflectance", 1.5, "{} must be a reflectance .* 1, got 1.5"),
        ("cosinelobe", "reflectance", "white", "{} must be .* a texture, got 'white'"),
        ("glossymixture", "specular_reflectance", 0.3, "diffuse.* at most 1, got 1.1"),
        ("anisotropicphong", "exponent_u", float("nan"), "{} .* got nan"),
        ("anisotropicphong", "f0", -0.1, "{} .* from 0 to 1, got -0.1"),
        ("anisotropicphong", "alpha", 0.1, "alpha"),
    ],
)
def test_wrong_parameters_are_named(kind, key, value, message):
    with pytest.raises(RuntimeError, match=message.format(rf"{kind}\.{key}")):
        mi.load_dict({"type": kind, key: value})


@pytest.mark.parametrize("name", SPECIMENS)
def test_xml_and_parameters(name):
    """A scene file says the same as a dictionary; what is exposed can be changed."""
    plugin = dict(SPECIMENS[name])
    kind, children = plugin["type"], ""
    for key, value in [*plugin.items()][1:]:
        tag = "string" if isinstance(value, str) else "float"
        children += f'<{tag} name="{key}" value="{value}"/>'
    bsdf = mi.load_string(f'<bsdf version="3.0.0" type="{kind}">{children}</bsdf>')
    assert str(bsdf) == str(mi.load_dict(plugin))

    wi, wo = pairs(200)
    changed = {"exponent_u": 7.0} if kind == "anisotropicphong" else {"exponent": 7.0}
    params = mi.traverse(bsdf)
    for key, value in changed.items():
        params[key] = mi.Float(value)
    if kind == "glossymixture":
        params["diffuse_reflectance.value"] = changed["diffuse_reflectance"] = 0.1
    params.update()
    other = mi.load_dict(plugin | changed)
    assert str(bsdf) == str(other)
    # exact: the same operations on the same numbers
    assert np.array_equal(evaluate(bsdf, wi, wo), evaluate(other, wi, wo))
    assert not np.array_equal(
        evaluate(bsdf, wi, wo), evaluate(mi.load_dict(plugin), wi, wo)
    )


@pytest.mark.usefixtures("rgb")
@pytest.mark.parametrize(
    ("plugin", "key"),
    [
        *(("cosinelobe", "reflectance"), ("glossymixture", "specular_reflectance")),
        ("anisotropicphong", "f0"),
    ],
)
def test_colours_and_textures(plugin, key):
    """Reflectances enter linearly, each channel by itself."""
    colour = np.array([0.125, 0.0625, 0.1875])
    wi, wo = incident(40), incident(50, 200)
    fixed = {"type": plugin}
    if plugin == "glossymixture":
        fixed["diffuse_reflectance"] = 0.5

    def value(reflectance):
        bsdf = mi.load_dict(fixed | {key: reflectance})
        return array(bsdf.eval(context(), interaction(wi), vectors(wo)), 1)[0]

    pixels = np.tile(np.float32(colour), (2, 2, 1))
    bitmap = {"type": "bitmap", "bitmap": mi.Bitmap(pixels), "raw": True}
    black, full = value(0.0), value(0.25)
    expected = black + (full - black) * colour / 0.25
    # rounding: some ten operations
    tolerance = 10 * EPS * np.abs(full).max()
    for texture in ({"type": "rgb", "value": colour.tolist()}, bitmap):
        np.testing.assert_allclose(value(texture), expected, atol=tolerance, rtol=0)


# ------------------------------------------------------------------ eval: the formulas


@pytest.mark.parametrize("form", ["unit", "modified_phong"])
@pytest.mark.parametrize("n", [0.0, 0.5, 16.0, 1000.0, 1e6])
def test_lobe_is_the_formula(form, n):
    plugin = {"type": "cosinelobe", "normalisation": form, "exponent": n}
    bsdf = mi.load_dict(plugin)
    wi, wo = pairs()
    # half of the pairs close to the mirror direction, also of sharp lobes
    near = wi * [-1, -1, 1] + (wo - 0.5) * np.minimum(1, 2 / np.sqrt(n + 1))
    wo[::2] = unit(near).astype(np.float32)[::2]
    density, cos = cosine_density(n, wi, wo)
    value, pdf = evaluate(bsdf, wi, wo)
    above = (wi[:, 2] > 0) & (wo[:, 2] > 0)
    assert not value[~above].any()
    assert not pdf[~above].any()
    # at a right angle to the mirror direction float32 cannot tell the sides
    seen = above & (np.abs(cos) > 1e-4)
    assert not pdf[seen & (cos < 0)].any()
    # and what is too small for float32 is 0
    seen &= density > 1e-30
    bound = power_error(n, cos[seen])
    expected = lobe_flux(form, n, wi, wo)[seen]
    assert (np.abs(pdf[seen] / density[seen] - 1) <= bound).all()
    assert (np.abs(value[seen] / expected - 1) <= bound).all()
    # twin: an exponent off by 1 % is seen
    wrong = cosine_density(n * 1.01 + 0.01, wi, wo)[0][seen]
    assert (np.abs(pdf[seen] / wrong - 1) > bound).mean() > 0.9


@pytest.mark.parametrize("form", ["unit", "modified_phong"])
def test_mixture_is_the_sum_of_its_parts(form):
    plugin = {"normalisation": form, "exponent": 9.0}
    mixture = mi.load_dict(plugin | {"type": "glossymixture"})
    lobe = mi.load_dict(plugin | {"type": "cosinelobe", "reflectance": 0.2})
    diffuse = mi.load_dict({"type": "diffuse", "reflectance": 0.8})
    wi, wo = pairs()
    value, pdf = evaluate(mixture, wi, wo)
    parts = evaluate(lobe, wi, wo), evaluate(diffuse, wi, wo)
    # rounding: five operations each
    np.testing.assert_allclose(value, parts[0][0] + parts[1][0], rtol=10 * EPS)
    expected = 0.2 * parts[0][1] + 0.8 * parts[1][1]
    np.testing.assert_allclose(pdf, expected, rtol=10 * EPS)


@pytest.mark.parametrize(("e_u", "e_v"), EXPONENTS)
def test_area_of_facets(e_u, e_v):
    """The helper's integral against the definition, and the table against both."""
    theta = np.radians([0, 30, 80, 88, 89.5, 89.999])
    phi = np.radians([0, 1, 40, 90])
    k = direction(theta[:, None], phi).reshape(-1, 3)
    exact = facing_area(k, e_u, e_v)
    mean = mean_cosine(e_u, e_v)
    area = k[:, 2] * mean + averted_area(k, e_u, e_v)
    # convergence: 5e-7 of the helper's 32 nodes, as much of the brute force, whose
    # values change by less than that with twice the azimuths
    np.testing.assert_allclose(area, exact, rtol=1e-6)
    # rounding: of the closed form, to which nothing is added
    assert area[0] == pytest.approx(mean, rel=4 * np.finfo(float).eps)
    # twin: the facets that face away are needed
    assert np.abs(k[:, 2] * mean / exact - 1).max() > 0.9

    # random points of a bilinear interpolation as the plugin makes it
    table = averted_area_table(e_u, e_v).astype(float)
    a, q = np.random.default_rng(5).random((2, 4000))
    a[:1000] **= 8
    stretched = (1 - a) * (1 - q) * np.sqrt(e_u + 1), (1 - a) * q * np.sqrt(e_v + 1), a
    exact = averted_area(np.stack(stretched, axis=-1), e_u, e_v, 100)
    row, column = np.floor(q * 256).astype(int), np.floor(a * 256).astype(int)
    down, right = q * 256 - row, a * 256 - column
    upper = table[row, column] * (1 - right) + table[row, column + 1] * right
    lower = table[row + 1, column] * (1 - right) + table[row + 1, column + 1] * right
    error = upper * (1 - down) + lower * down - exact
    error /= a * mean + exact
    # the accuracy that the manual states
    assert error.max() <= 2e-5
    assert error.min() >= -5e-7
    # that nothing coarser would do: the table is not finer than need be
    assert error.max() > 5e-6


@pytest.mark.parametrize("f0", [1.0, 0.04])
@pytest.mark.parametrize(("e_u", "e_v"), EXPONENTS)
def test_facets_are_the_formula(e_u, e_v, f0):
    plugin = {"type": "anisotropicphong", "exponent_u": e_u, "exponent_v": e_v}
    bsdf = mi.load_dict(plugin | {"f0": f0})

    wi, wo = pairs(500)
    # outgoing directions in the lobe
    h = (wo - [0.1, 0, 0]) * [0.7, 1.2, 0] / np.sqrt([e_u + 1, e_v + 1, 1])
    h = unit(h + [0, 0, 1])
    wi = wi + [0, 0, 0.02]
    wi = unit(wi).astype(np.float32).astype(float)
    wo = 2 * np.sum(wi * h, axis=-1, keepdims=True) * h - wi
    wo = unit(wo).astype(np.float32).astype(float)
    keep = wo[:, 2] > 1e-3
    wi, wo = wi[keep], wo[keep]
    brdf, cos_h, exponent = facets_brdf(wi, wo, e_u, e_v, f0)
    value, pdf = evaluate(bsdf, wi, wo)
    rounding = power_error(exponent, cos_h)
    ratio = value / (brdf * unit(wo)[:, 2]) - 1
    # two areas, each at most 2e-5 too large and 5e-7 too small, here as in the table
    assert (ratio <= 2e-6 + rounding).all()
    assert (ratio >= -4.2e-5 - rounding).all()
    p = np.sqrt((e_u + 1) * (e_v + 1)) / (2 * np.pi) * cos_h**exponent
    cos_d = np.linalg.norm(wi + wo, axis=-1) / 2
    assert (np.abs(pdf / (p / (4 * cos_d)) - 1) <= rounding).all()
    # twins: the axes swapped, Fresnel left out
    if e_u != e_v:
        swapped = facets_brdf(wi[:, [1, 0, 2]], wo[:, [1, 0, 2]], e_u, e_v, f0)[0]
        assert (np.abs(value - swapped * wo[:, 2]) > 1e-3 * value).any()
    if f0 < 1:
        mirror = facets_brdf(wi, wo, e_u, e_v, 1)[0]
        assert (value < 0.999 * mirror * wo[:, 2]).any()


# ---------------------------------------------------------------- energy, reciprocity


@pytest.mark.parametrize("form", ["unit", "modified_phong"])
@pytest.mark.parametrize("n", [1.0, 16.0, 100.0])
def test_albedo_of_the_lobe_is_the_closed_form(form, n):
    plugin = {"type": "cosinelobe", "normalisation": form, "exponent": n}
    bsdf = mi.load_dict(plugin)
    for theta_i in (0, 30, 60, 85, 89):
        value, error = dhr(bsdf, theta_i)
        exact = reflected(form, n, np.radians(theta_i))
        # convergence, and rounding of `eval` at the lobe's foot
        bound = error + power_error(n, n / (n + 3))
        assert value == pytest.approx(exact, abs=bound)
        assert value <= 1 + bound
        # twin: without the loss below the horizon it would be another number
        without = np.cos(np.radians(theta_i)) if form == "modified_phong" else 1
        if theta_i == 85:
            assert value != pytest.approx(without, abs=100 * bound)


def test_albedo_in_the_manual():
    """The numbers printed in the manual pages."""
    theta = np.radians([0, 30, 45, 60, 75, 85, 90])
    manual = type(mi.load_dict({"type": "cosinelobe"})).__doc__
    for form, n in itertools.product(("unit", "modified_phong"), (1, 16, 100)):
        row = " ".join(f"{x:.4f}" for x in reflected(form, n, theta))
        assert re.search(rf"\b{form}, {n} +{row}\n", manual)


@pytest.mark.parametrize(("e_u", "e_v"), [(0, 0), (50, 1000), (3, 300)])
def test_facets_conserve_energy(e_u, e_v):
    """The manual prints what those of default exponents reflect."""
    plugin = {"type": "anisotropicphong", "exponent_u": e_u, "exponent_v": e_v}
    bsdf = mi.load_dict(plugin)
    for phi_i in (0, 90 if e_u == 50 else 35):
        angles = (0, 30, 45, 60, 75, 85, 89)
        albedo = np.array([dhr(bsdf, t, phi_i) for t in angles])
        # two areas of 5e-7 too small, rounding, convergence
        assert (albedo[:, 0] <= 1 + 1e-6 + 30 * EPS + albedo[:, 1]).all()
        if e_u == 50:
            row = " ".join(f"{x:.4f}" for x in albedo[:, 0])
            assert row in type(bsdf).__doc__
            # twin: without the mean cosine of smooth facets light would be gained
            assert (albedo[:, 0] / mean_cosine(e_u, e_v) > 1 + 1e-3).any()


def both_ways(bsdf, mode=None):
    """BRDF from wi to wo and back, for pairs away from the horizon."""
    wi, wo = pairs()
    wi, wo = (unit(v + [0, 0, 0.02]).astype(np.float32).astype(float) for v in (wi, wo))
    there = evaluate(bsdf, wi, wo, mode=mi.TransportMode.Importance)[0] / wo[:, 2]
    back = evaluate(bsdf, wo, wi, mode=mode)[0] / wi[:, 2]
    seen = (there > 1e-30) & (back > 1e-30)
    return there[seen], back[seen], wi[seen], wo[seen]


@pytest.mark.parametrize("name", SPECIMENS)
def test_reciprocity(name):
    """Of what says so; radiance mode is the adjoint of importance mode anyway."""
    bsdf, mode = mi.load_dict(SPECIMENS[name]), mi.TransportMode.Radiance
    for adjoint in (True, False):
        there, back, wi, wo = both_ways(bsdf, mode if adjoint else None)
        # rounding: the mirror direction of the one is not exactly that of the other
        _, cos = cosine_density(1, wi, wo)
        bound = 4 * power_error(200, np.maximum(cos, 1e-3))
        same = np.abs(there / back - 1) <= bound
        reciprocal = name in ("phong", "mixture phong", "facets", "facets rough")
        assert same.all() == (adjoint or reciprocal)
        if not same.all() and "mixture" not in name:
            # as the formula has it: proportional to 1 / cos(theta_o)
            ratio = there / back * wo[:, 2] / wi[:, 2]
            assert (np.abs(ratio - 1) <= bound).all()


# ------------------------------------------------------------------ sample


@pytest.mark.usefixtures("variant")
@pytest.mark.parametrize("name", SPECIMENS)
def test_weight_times_density_is_eval(name, variant):
    """Of every sample, from normal to grazing incidence; nothing comes from below."""
    bsdf = mi.load_dict(SPECIMENS[name])
    check_weights(bsdf, mi.TransportMode.Importance)
    if variant == "llvm_ad_mono":
        check_weights(bsdf, mi.TransportMode.Radiance)


def check_weights(bsdf, mode):
    ctx = context(mode)
    for theta_i in (0, 45, 89.99, 90.01, 180):
        wi = incident(theta_i)
        bs, weight = draw(bsdf, wi, 20000, mode=mode)
        n = len(weight)
        value, pdf = bsdf.eval_pdf(ctx, interaction(wi), bs.wo)
        alone = [f(ctx, interaction(wi), bs.wo) for f in (bsdf.eval, bsdf.pdf)]
        dr.eval(value, pdf, alone)
        # exact: one computation
        assert dr.all(value == alone[0], axis=None)
        assert dr.all(pdf == alone[1])
        drawn = array(bs.pdf, n)
        value, pdf = array(value, n), array(pdf, n)
        assert np.isfinite([weight[:, 0], value[:, 0], pdf, drawn]).all()
        # rounding: some ten operations
        np.testing.assert_allclose(weight * drawn[:, None], value, rtol=10 * EPS)
        assert (drawn[weight[:, 0] > 0] == pdf[weight[:, 0] > 0]).all()
        assert weight.any() == (theta_i < 90)
        assert (weight[array(bs.wo.z, n) <= 0] == 0).all()
        length = np.linalg.norm(np.array(bs.wo), axis=0)
        assert theta_i > 90 or (np.abs(length - 1) <= 4 * EPS).all()


@pytest.mark.parametrize("e_u", [0.0, 0.3, 1e6])
def test_extreme_exponents_are_finite(e_u):
    for plugin in (
        {"type": "cosinelobe", "exponent": e_u},
        {"type": "anisotropicphong", "exponent_u": e_u, "exponent_v": 1e6 - e_u},
    ):
        bsdf = mi.load_dict(plugin)
        for theta_i in (0, 60, 89.99):
            bs, weight = draw(bsdf, incident(theta_i))
            assert np.isfinite(weight).all()
            assert np.isfinite(np.array(bs.wo)).all()
            assert np.isfinite(np.array(bs.pdf)).all()
            # far below what the instrument takes for an error
            assert weight.max() < 100


@lru_cache
def measured(name, theta_i):
    """A measurement, and the patch integrals of `eval` and of `pdf`."""
    plugin = SPECIMENS[name]
    how = {"collector": "projected:12x24", "rays": RAYS, "sampler": "independent"}
    record = gonio.measure(plugin, theta_i, PHI_I, **how)
    bsdf, wi = mi.load_dict(plugin), incident(theta_i)

    def both(wo):
        return np.stack(evaluate(bsdf, wi, wo), axis=-1)

    integrals, errors = patch_fluxes(both, record.subdivision, tolerance=1e-8)
    # convergence: far below the statistics of any patch with hits
    assert errors.sum() < 1e-2 / np.sqrt(RAYS)
    return record, integrals[..., 0], integrals[..., 1]


def binomial(count, rays, p):
    """Verdict on a count of independent rays, by exact tails."""
    law = stats.binom(int(rays), p)
    tails = law.cdf(int(count)), law.sf(int(count) - 1)
    return Verdict({"count": float(min(1.0, 2 * min(tails)))})


CASES = [(name, theta_i) for name in SPECIMENS for theta_i in (30, 80)]


@pytest.mark.parametrize(("name", "theta_i"), CASES)
def test_sampled_directions_have_the_density(name, theta_i):
    """Shape by chi-square over patches, and total mass, which that cannot see."""
    record, _, pdf = measured(name, theta_i)
    hits = record.counts[0]
    agree(count_verdict(hits, pdf))
    mass, rays = pdf.sum(), record.ledger.emitted
    # up to a millionth may be lost to rounding, at the horizon
    agree(binomial(rays - hits.sum(), rays, max(1 - mass, 1e-6)))
    disagree(binomial(rays - hits.sum(), rays, 1 - 0.99 * mass))
    # twin: 5 % exchanged between neighbouring sectors
    wrong = pdf * (1 + 0.05 * np.cos(np.pi * np.arange(record.subdivision.n_phi)))
    disagree(count_verdict(hits, wrong))


@pytest.mark.parametrize(("name", "theta_i"), CASES)
def test_measured_flux_is_the_integral_of_eval(name, theta_i):
    record, flux, _ = measured(name, theta_i)
    agree(verdict(scores(record, flux)))
    disagree(verdict(scores(record, 1.01 * flux)))


@pytest.mark.parametrize("theta_i", [30, 80])
def test_total_mass_of_the_lobe(theta_i):
    """The ledger's absorbed rays are the closed form of what is lost."""
    record, _, _ = measured("unit", theta_i)
    loss = lost(16, np.radians(theta_i))
    ledger = record.ledger
    agree(binomial(ledger.absorbed, RAYS, loss))
    disagree(binomial(ledger.absorbed, RAYS, 1.03 * loss + 1e-4))
    assert ledger.reflected + ledger.absorbed == ledger.emitted


# ------------------------------------------------------------------ masks, other scenes


@pytest.mark.parametrize("name", SPECIMENS)
def test_masks_are_respected(name):
    bsdf = mi.load_dict(SPECIMENS[name])
    wi, wo = pairs()
    value, _ = evaluate(bsdf, wi, wo)
    glossy = bsdf.component_count() - 1
    parts = [evaluate(bsdf, wi, wo, component=i)[0] for i in range(glossy + 1)]
    # rounding: one sum
    np.testing.assert_allclose(sum(parts), value, rtol=2 * EPS)
    types = {
        mi.BSDFFlags.GlossyReflection: parts[glossy],
        mi.BSDFFlags.DiffuseReflection: parts[0] if glossy else 0 * value,
        mi.BSDFFlags.Transmission: 0 * value,
    }
    for flag, expected in types.items():
        masks = {"type_mask": int(flag)}
        assert np.array_equal(evaluate(bsdf, wi, wo, **masks)[0], expected)
        assert expected.any() == evaluate(bsdf, wi, wo, **masks)[1].any()
        wi_0 = incident(50)
        bs, weight = draw(bsdf, wi_0, **masks)
        assert weight.any() == expected.any()
        if not expected.any():
            continue
        assert (np.array(bs.sampled_type) == int(flag)).all()
        component = glossy if flag == mi.BSDFFlags.GlossyReflection else 0
        assert (np.array(bs.sampled_component) == component).all()
        masked = bsdf.eval(context(**masks), interaction(wi_0), bs.wo)
        product = weight[:, 0] * array(bs.pdf, len(weight))
        expected = array(masked, len(weight))[:, 0]
        np.testing.assert_allclose(product, expected, rtol=10 * EPS)


@pytest.mark.parametrize("name", SPECIMENS)
def test_inactive_lanes_are_zero(name):
    bsdf = mi.load_dict(SPECIMENS[name])
    wi, wo = pairs(100)
    si, active = interaction(wi), mi.Bool(np.arange(100) % 2 == 0)
    value, pdf = bsdf.eval_pdf(context(), si, vectors(wo), active)
    u = np.random.default_rng(2).random((3, 100), dtype=np.float32)
    draws = mi.Float(u[0]), mi.Point2f(u[1:])
    _, weight = bsdf.sample(context(), si, *draws, active)
    for found in (value, pdf, weight):
        assert not array(found, 100)[1::2].any()
        assert array(found, 100)[::2].any()


def test_lobes_of_the_mixture_are_picked_by_weight():
    bsdf = mi.load_dict(SPECIMENS["mixture"])
    n = 10**5
    bs, weight = draw(bsdf, incident(30), n)
    glossy = (np.array(bs.sampled_component) == 1).sum()
    agree(single((glossy - 0.2 * n) / np.sqrt(n * 0.2 * 0.8)))
    disagree(single((glossy - 0.22 * n) / np.sqrt(n * 0.2 * 0.8)))
    # rounding: both lobes are drawn as they are weighted, so that nothing is left over
    kept = weight[weight > 0]
    np.testing.assert_allclose(kept, 1, rtol=10 * EPS)


def test_anisotropy_turns_with_the_specimen():
    """The narrow direction is that of the larger exponent, also in a traced scene."""
    bsdf = dict(SPECIMENS["facets"])
    settings = {"rays": 10**5, "collector": "projected:10x40", "trace": True}

    def spread(to_world):
        shape = {"type": "rectangle", "to_world": to_world, "bsdf": bsdf}
        record = gonio.measure({"type": "scene", "shape": shape}, 0, **settings)
        axes = direction(record.subdivision.theta[:, None], record.subdivision.phi)
        share = record.flux_fraction[0, ..., 0]
        return [np.sum(share * axes[..., i] ** 2) for i in (0, 1)]

    x2, y2 = spread(mi.ScalarTransform4f())
    assert x2 > 4 * y2
    x2, y2 = spread(mi.ScalarTransform4f().rotate([0, 0, 1], 90))
    assert y2 > 4 * x2


@pytest.mark.parametrize("name", ["unit", "mixture", "facets"])
def test_other_side(name):
    """Dark from behind; `twosided` makes both sides alike."""
    plugin = SPECIMENS[name]
    assert gonio.measure(plugin, 40, rays=1000, side="back").dhr[0] == 0
    both = {"type": "twosided", "bsdf": plugin}
    wi, wo = pairs(200)
    down = [1, 1, -1]
    front = evaluate(mi.load_dict(plugin), wi, wo)
    # exact: only signs differ
    behind = evaluate(mi.load_dict(both), wi * down, wo * down)
    assert np.array_equal(front, behind)

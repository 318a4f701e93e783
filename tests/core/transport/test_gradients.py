"""Derivatives by parameters: closed forms, own derivations, differences, refusals."""

import functools
import itertools

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from budget import agree, disagree, normal_scores, often_enough, single, verdict
from plain_bsdf import plain

import gonio_mi as gonio
from gonio_mi.cli import main
from gonio_mi.errors import SettingError, SpecimenError, VariantError

ALPHA = 0.3
GGX = {"type": "roughconductor", "distribution": "ggx", "alpha": ALPHA}
GREY = {"type": "diffuse", "reflectance": 0.5}
RGB = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.2, 0.4, 0.6]}}
HILLS = {"type": "heightfield", "alpha": 0.8, "resolution": 16}
SOLID = np.pi / 36  # of a patch
SETTINGS = {"theta_i": 50, "collector": "projected:6x6"}


def ggx(theta_i, theta_o, phi, alpha):
    """``eval`` of a GGX mirror with separable shadowing, and its d log / d alpha."""
    wi = np.array([np.sin(theta_i), 0, np.cos(theta_i)])
    theta_o, phi = np.broadcast_arrays(theta_o, phi)
    sine = np.sin(theta_o)
    wo = np.stack([sine * np.cos(phi), sine * np.sin(phi), np.cos(theta_o)], -1)
    half = wo + wi
    cosine2 = half[..., 2] ** 2 / np.sum(half**2, axis=-1)
    tan2 = 1 / cosine2 - 1
    value = 1 / (np.pi * alpha**2 * cosine2**2 * (1 + tan2 / alpha**2) ** 2)
    slope = -2 / alpha + 4 * tan2 / alpha**3 / (1 + tan2 / alpha**2)
    for theta in (theta_i, theta_o):
        root = np.sqrt(1 + (alpha * np.tan(theta)) ** 2)
        value = value * 2 / (1 + root)
        slope = slope - alpha * np.tan(theta) ** 2 / (root * (1 + root))
    return value / (4 * np.cos(theta_i)), slope


@functools.cache
def expected(alpha=ALPHA):
    """Patch means of d brdf / d alpha, by an own derivation and Gauss' rule."""
    edges = gonio.EqualProjectedSolidAngle(6, 6).theta_edges
    nodes, weights = np.polynomial.legendre.leggauss(40)
    found = np.zeros((6, 6))
    for i, (low, high) in enumerate(itertools.pairwise(edges)):
        theta = (low + high + (high - low) * nodes[:, None]) / 2
        for j in range(6):
            phi = (j + (1 + nodes) / 2) * np.pi / 3
            value, slope = ggx(np.radians(50), theta, phi, alpha)
            area = np.outer(weights, weights) * (high - low) / 4 * np.pi / 3
            found[i, j] = np.sum(value * slope * np.sin(theta) * area)
    return found / SOLID


def scores(record, name, reference):
    """Normal scores of the derivative in each patch."""
    t = (record.gradient(name) - reference) / record.gradient_std_err(name)
    return normal_scores(t, record.n_batches - 1)


# --------------------------------------------------------------------- right numbers


def test_own_derivative_of_ggx_patch_by_patch():
    """Statistics of independent rays; the twin is 2 % off."""
    record = gonio.measure(
        GGX, gradients=["alpha.value"], sampler="independent", **SETTINGS
    )
    reference = expected()[..., None]
    agree(verdict(scores(record, "alpha.value", reference)))
    disagree(verdict(scores(record, "alpha.value", 1.02 * reference)))
    total = reference.sum() * SOLID
    error = record.gradient_std_err("alpha.value", "dhr")
    t = (record.gradient("alpha.value", "dhr") - total) / error
    agree(single(normal_scores(t, 15)[0]))
    low, high = record.gradient_interval("alpha.value", 1 - 1e-6)
    assert np.all((low <= reference) & (reference <= high))


def test_quadrature_integrates_the_derivative():
    """Convergence: within what it says, and roundings of `eval`; the twin is 1e-4."""
    record = gonio.measure(
        GGX, gradients=["alpha.value"], estimator="quadrature", **SETTINGS
    )
    off = np.abs(record.gradient("alpha.value")[..., 0] - expected())
    allowed = record.gradient_std_err("alpha.value")[..., 0]
    allowed = allowed + 2e-6 * np.abs(expected()).max()
    assert np.all(off <= allowed)
    assert np.any(np.abs(1.0001 * expected() - expected()) > allowed)


def test_light_of_n_events_goes_with_the_nth_power_of_a_reflectance():
    """Rounding: d f / d r = n f / r ray by ray."""
    specimen = HILLS | {"bsdf": GREY}
    name = "bsdf.reflectance.value"
    settings = SETTINGS | {"rays": 20_000, "period": "box", "gradients": [name]}
    for order, record in gonio.measure_orders(
        specimen, orders=(1, 2), **settings
    ).items():
        wanted = int(order) * record.brdf / 0.5
        assert record.brdf.max() > 0
        np.testing.assert_allclose(record.gradient(name), wanted, rtol=1e-5)
        total = int(order) * record.dhr / 0.5
        np.testing.assert_allclose(record.gradient(name, "dhr"), total, rtol=1e-5)


@pytest.mark.parametrize("estimator", ["weighted", "next_event"])
def test_light_itself_keeps_its_bits(estimator):
    """Exact: sums, hits and ledger, traced and on a plane, and a scene as it was."""
    flat = {"estimator": "weighted"}
    for specimen, name, more in (
        (GGX, "alpha.value", flat),
        (HILLS | {"bsdf": GGX}, "bsdf.alpha.value", {"period": "box"}),
    ):
        settings = SETTINGS | {"rays": 5000, "estimator": estimator} | more
        plain = gonio.measure(specimen, **settings)
        record = gonio.measure(specimen, gradients=[name], **settings)
        for array in plain.tallies[0].arrays:
            one, other = (getattr(x.tallies[0], array) for x in (plain, record))
            assert np.array_equal(one, other)


def test_numbers_of_a_parameter_are_an_axis():
    """Rounding: each channel of a colour follows its own number alone."""
    mi.set_variant("llvm_ad_rgb")
    record = gonio.measure(
        RGB,
        [0, 50],
        rays=2000,
        collector="projected:2x2",
        gradients=["reflectance.value"],
    )
    found = record.gradient("reflectance.value")
    assert found.shape == (2, 2, 2, 3, 3)
    np.testing.assert_allclose(
        found, record.brdf[..., None] / [0.2, 0.4, 0.6] * np.eye(3), rtol=1e-5
    )
    assert np.array_equal(record.gradient("reflectance.value[1]"), found[..., 1])
    dhr = record.gradient("reflectance.value", "dhr")
    np.testing.assert_allclose(dhr, [np.eye(3)] * 2, rtol=1e-5)


@pytest.mark.parametrize("ending", ["npz", "exr"])
@pytest.mark.parametrize("estimator", ["weighted", "quadrature"])
def test_records_with_gradients_are_saved(tmp_path, estimator, ending):
    """Exact: what is loaded equals what was measured, and tells the same."""
    settings = SETTINGS | {"collector": "projected:2x3", "rays": 2000}
    record = gonio.measure(
        GGX, gradients=["alpha.value"], estimator=estimator, **settings
    )
    record.save(tmp_path / f"r.{ending}")
    loaded = gonio.load(tmp_path / f"r.{ending}")
    assert loaded == record
    told = loaded.gradient_interval("alpha.value")
    assert np.array_equal(told, record.gradient_interval("alpha.value"))


def test_the_command_shows_and_draws_them(tmp_path, capsys):
    """Exact: the table has the record's numbers; the map is drawn."""
    word = f"roughconductor:distribution=ggx,alpha={ALPHA}"
    path, figure = str(tmp_path / "r.npz"), str(tmp_path / "r.png")
    how = ["--theta-i", "50", "--rays", "2000", "--collector", "projected:6x6"]
    assert main(["measure", word, *how, "--gradients", "alpha.value", "-o", path]) == 0
    value = gonio.load(path).gradient("alpha.value", "dhr")[0]
    assert f"alpha.value  {value:>10.6g}" in capsys.readouterr().out
    assert main(["plot", path, "--gradient", "alpha.value", "-o", figure]) == 0
    assert main(["plot", path, "--gradient", "alpha", "-o", figure]) == 1
    assert "did you mean alpha.value?" not in capsys.readouterr().out


def test_names_are_those_of_the_scene_that_was_given():
    """Exact: of a BSDF that two shapes share, too."""
    ref = {"type": "ref", "id": "metal"}
    two = {"a": {"type": "rectangle", "b": ref}, "c": {"type": "sphere", "b": ref}}
    scene = mi.load_dict({"type": "scene", "metal": GGX} | two)
    name = next(k for k in mi.traverse(scene).keys() if "alpha" in k)  # noqa: SIM118
    record = gonio.measure(scene, 50, rays=100, gradients=[name])
    assert record.gradients == (name,)


# ------------------------------------------------------------------ mi.render in a loss


def scene_of(shape, **integrator):
    """Scene that is a complete measurement."""
    film = {"type": "patches", "subdivision": "projected:3x4", "hemispheres": "upper"}
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "goniophotometer", "rays": 4000} | integrator,
            "sensor": {"type": "collector", "film": film},
            "emitter": {"type": "directional", "direction": [0.5, 0, -0.866]},
            "shape": shape,
        }
    )


def texels(seed, channels=1):
    return np.random.default_rng(seed).uniform(0.3, 0.9, (4, 4, channels))


def along(scene, name, tangent, weights):
    """Change of a weighted sum of the map along a tangent: forward and backward."""
    params = mi.traverse(scene)
    kind, found = type(params[name]), []
    value = kind(params[name])
    for forward in (True, False):
        own = kind(value)
        dr.enable_grad(own)
        params[name] = own
        params.update()
        pixels = mi.render(scene, params, seed_grad=5)
        assert dr.grad_enabled(pixels)
        if forward:
            dr.set_grad(own, tangent)
            dr.forward_from(own)
            found.append(np.sum(np.array(dr.grad(pixels)) * weights))
        else:
            dr.backward(dr.sum(pixels * mi.TensorXf(weights), axis=None))
            found.append(np.sum(np.array(dr.grad(own)) * np.array(tangent)))
    params[name] = value
    params.update()
    return found


TEXTURE = {"type": "bitmap", "raw": True, "filter_type": "nearest"}
LOSSES = {
    "plane": ({"type": "rectangle", "bsdf": GGX}, "alpha.value", {}),
    "hills": (HILLS | {"bsdf": GGX}, "alpha.value", {"period": "box"}),
    "texels": (HILLS | {"bsdf": GREY}, "reflectance.data", {"period": "box"}),
    "lobes": (
        HILLS | {"bsdf": {"type": "plastic", "diffuse_reflectance": 0.5}},
        *("diffuse_reflectance.value", {"period": "box"}),
    ),
}


@pytest.mark.parametrize("name", LOSSES)
def test_forward_and_backward_tell_the_same(name):
    """Rounding: both are sums over the same rays, by different ways."""
    shape, end, settings = LOSSES[name]
    if name == "texels":
        data = {"data": mi.TensorXf(texels(1).astype(np.float32))}
        shape = shape | {"bsdf": {"type": "diffuse", "reflectance": TEXTURE | data}}
    scene = scene_of(shape, **settings)
    params = mi.traverse(scene)
    key = next(key for key in params.keys() if key.endswith(end))  # noqa: SIM118
    kind = type(params[key])
    tangent = kind(mi.TensorXf(texels(2) - 0.5)) if name == "texels" else kind(1.0)
    weights = np.random.default_rng(3).normal(size=(3, 4, 1)) + 0.5
    forward, backward = along(scene, key, tangent, weights)
    assert forward != 0
    np.testing.assert_allclose(backward, forward, rtol=1e-4)


def test_forward_goes_along_the_gradients_of_several():
    """Rounding: linear in a large one, and in one that is 0, of two parameters."""
    scene = scene_of({"type": "rectangle", "bsdf": GGX | {"specular_reflectance": 0.5}})
    params = mi.traverse(scene)
    names = [f"shape.bsdf.{end}.value" for end in ("alpha", "specular_reflectance")]
    found = []
    for tangents in ((100, 0), (0, 100), (1, 1)):
        own = [mi.Float(ALPHA), mi.Float(0.5)]
        for name, value, tangent in zip(names, own, tangents):
            dr.enable_grad(value)
            dr.set_grad(value, tangent)
            params[name] = value
        params.update()
        pixels = mi.render(scene, params, seed_grad=5)
        found.append(np.array(dr.forward_to(pixels)))
    one, other, both = found
    np.testing.assert_allclose((one + other) / 100, both, rtol=1e-3, atol=1e-4)


def test_grey_map_has_all_channels_of_a_colour():
    """Rounding: of a diffuse plate the map goes with the reflectance."""
    mi.set_variant("llvm_ad_rgb")
    grey = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.5}}
    scene = scene_of({"type": "rectangle", "bsdf": grey})
    name = next(k for k in mi.traverse(scene).keys() if "reflectance" in k)  # noqa: SIM118
    tangent = mi.Color3f(1, 2, 4)
    forward, backward = along(scene, name, tangent, np.ones((3, 4, 3)))
    np.testing.assert_allclose([forward, backward], 7 * 12 / np.pi, rtol=1e-3)


def test_wavelengths_of_several_passes():
    """Rounding: each is a channel of the loss, in the pass that carries it."""
    mi.set_variant("llvm_ad_spectral")
    metal = GGX | {"material": "Au"}
    nm = "450,500,550,600,650"
    scene = scene_of({"type": "rectangle", "bsdf": metal}, wavelengths=nm)
    weights = np.random.default_rng(3).normal(size=(3, 4, 5)) + 0.5
    name = "shape.bsdf.alpha.value"
    forward, backward = along(scene, name, mi.Float(1), weights)
    np.testing.assert_allclose(backward, forward, rtol=1e-4)


def test_what_cannot_go_backward_is_told():
    """Exact: heights, and estimators that deposit, by `mi.render` too."""
    for end, settings, words in (
        ("vertex_positions", {}, "vertex_positions of "),
        ("alpha.value", {"estimator": "next_event"}, "got next_event"),
    ):
        scene = scene_of(HILLS | {"bsdf": GGX}, period="box", **settings)
        params = mi.traverse(scene)
        key = next(key for key in params.keys() if key.endswith(end))  # noqa: SIM118
        dr.enable_grad(params[key])
        params.update()
        loss = dr.sum(mi.render(scene, params, spp=100), axis=None)
        with pytest.raises(Exception, match=r"gradients|dr\.backward") as error:
            dr.backward(loss)
        assert words in str(error.value) + str(error.value.__cause__)


# --------------------------------------------------------------------------- refusals

LIMIT = "is at a limit"
REFUSED = {
    "no such name": (GREY, "reflectance.valu", {}, "did you mean reflectance.value?"),
    "a plane": (GREY, "to_world", {}, "got to_world of Rectangle"),
    "detached": ({"type": "dielectric"}, "eta", {}, "does not differentiate"),
    "geometry": (HILLS, "vertex_positions", {}, "got vertex_positions of "),
    "counted": (GREY, "reflectance.value", {"estimator": "analog"}, "got analog"),
    "black": (GREY | {"reflectance": 0.0}, "reflectance.value", {}, LIMIT),
    "eval": (
        {"type": "roughplastic", "alpha": 0.3, "diffuse_reflectance": 0.5},
        *("alpha", {}, "derivative of `eval` of RoughPlastic by alpha is wrong"),
    ),
    "a lobe that is never drawn": (
        {"type": "mask", "opacity": 1.0, "bsdf": GREY},
        *("opacity.value", {}, LIMIT),
    ),
    "a medium": (
        {
            "type": "cube",
            "bsdf": {"type": "roughdielectric"},
            "interior": {"type": "homogeneous"},
        },
        *("alpha.value", {}, "need a specimen without media"),
    ),
    "split": (GREY, "reflectance.value", {"estimator": "split"}, "got split"),
    "facets": (
        HILLS | {"bsdf": {"type": "conductor", "specular_reflectance": 0.8}},
        "bsdf.specular_reflectance.value",
        {"estimator": "next_event", "period": "box"},
        "gradients of mirror facets need the estimator weighted",
    ),
}


@pytest.mark.parametrize("why", REFUSED)
def test_what_cannot_be_differentiated_is_told(why):
    """Exact."""
    specimen, name, settings, words = REFUSED[why]
    with pytest.raises((SettingError, SpecimenError), match=None) as error:
        gonio.measure(specimen, 30, gradients=[name], rays=10, **settings)
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_polarised_variants_are_refused():
    """Exact."""
    mi.set_variant("llvm_ad_spectral_polarized")
    with pytest.raises(VariantError, match="needs an unpolarised variant"):
        gonio.measure(GREY, 30, gradients=["reflectance.value"], rays=10)


def test_a_limit_that_a_parameter_reaches_later_is_told():
    """What was found before holds for other values, but not there."""
    pane = {"type": "mask", "opacity": 0.5, "bsdf": GREY}
    scene = scene_of({"type": "rectangle", "bsdf": pane})
    params = mi.traverse(scene)
    key = next(key for key in params.keys() if key.endswith("opacity.value"))  # noqa: SIM118
    for value, refused in ((0.5, False), (0.7, False), (1.0, True)):
        params[key] = mi.Float(value)
        dr.enable_grad(params[key])
        params.update()
        image = mi.render(scene, params, spp=100)
        dr.set_grad(params[key], 1.0)
        if refused:
            with pytest.raises((RuntimeError, SpecimenError)) as error:
                dr.forward_to(image)
            assert LIMIT in str(error.value) + str(error.value.__cause__)
        else:
            assert np.any(dr.forward_to(image).numpy())


def test_rays_without_a_derivative_are_told():
    """Exact: `sample` sends a ray where `eval` is 0."""

    class Holes(plain()):
        def load(self, props):  # noqa: ARG002
            self.reflectance = mi.Float(0.5)

        def traverse(self, callback):
            flag = mi.ParamFlags.Differentiable
            callback.put("reflectance", self.reflectance, flag)

        def value(self, ctx, si, wo):
            lit = mi.Frame3f.cos_theta(wo) > 0.2
            return super().value(ctx, si, wo) & lit

        def weight(self, ctx, si, bs):  # noqa: ARG002
            return mi.Spectrum(self.reflectance)

    mi.register_bsdf("holes", Holes)
    with pytest.warns(match="derivative of .* rays was not finite"):
        record = gonio.measure(
            {"type": "holes"}, 30, gradients=["reflectance"], rays=1000
        )
    # as much of them as goes elsewhere: a cosine below 0.2 has 0.04 of all
    assert record.gradient("reflectance", "dhr") == pytest.approx(0.96, abs=0.01)


# ------------------------------------------------------------------- differences, slow

MIXED = {"type": "blendbsdf", "weight": 0.3, "a": GREY, "b": GGX}
MIRRORS = {
    "type": "blendbsdf",
    "weight": 0.3,
    "a": {"type": "conductor", "specular_reflectance": 0.9},
    "b": {"type": "conductor", "specular_reflectance": 0.4},
}
PLASTIC = {"type": "plastic", "diffuse_reflectance": 0.5, "specular_reflectance": 0.8}
PAINT = {"type": "principled", "roughness": 0.4, "metallic": 0.3, "base_color": 0.5}
LEAF = {
    "type": "principledthin",
    "roughness": 0.4,
    "diff_trans": 0.6,
    "spec_trans": 0.3,
}
GLASS = {"type": "roughdielectric", "alpha": 0.3}
VEIL = {"type": "mask", "opacity": 0.6, "bsdf": GREY}
ROUGH = {"type": "roughplastic", "alpha": 0.3, "diffuse_reflectance": 0.5}
ANISOTROPIC = {"type": "roughconductor", "alpha_u": 0.2, "alpha_v": 0.4}
CASES = {
    "metal": (GGX, "alpha.value"),
    "brushed metal": (ANISOTROPIC, "alpha_u.value"),
    "rough glass": (GLASS, "alpha.value"),
    "rough plastic": (ROUGH, "diffuse_reflectance.value"),
    "varnish": (PLASTIC, "specular_reflectance.value"),
    "plastic": (PLASTIC, "diffuse_reflectance.value"),
    "pane": ({"type": "thindielectric"}, "eta"),
    "mirrors": (MIRRORS, "weight.value"),
    "mixture": (MIXED, "weight.value"),
    "veil": (VEIL, "opacity.value"),
    "paint": (PAINT, "roughness.value"),
    "flakes": (PAINT, "metallic.value"),
    "leaf": (LEAF, "diff_trans.value"),
    "thin glass": (LEAF, "spec_trans.value"),
}
ON_HILLS = ("metal", "varnish", "plastic", "mixture", "veil", "paint")
PLACES = [*((one, "plane") for one in CASES), *((one, "hills") for one in ON_HILLS)]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "where"), PLACES)
def test_totals_are_those_of_differences(name, where):
    """Statistics: six differences with common random numbers; the twin is half off."""
    bsdf, end = CASES[name]
    shape = {"type": "rectangle"} if where == "plane" else HILLS
    scene = mi.load_dict({"type": "scene", "s": shape | {"bsdf": bsdf}})
    settings = {"theta_i": 50, "collector": "projected:2x2", "rays": 2**18}
    settings |= {} if where == "plane" else {"period": "box"}
    record = gonio.measure(scene, gradients=[end], **settings)
    params = mi.traverse(scene)
    key = next(key for key in params.keys() if key.endswith(f".{end}"))  # noqa: SIM118
    value = type(params[key])(params[key])
    step, found = 0.03 * float(np.array(value).ravel()[0]), []
    for seed in range(1, 7):
        ends = []
        for sign in (1, -1):
            params[key] = type(value)(value + sign * step)
            params.update()
            measured = gonio.measure(scene, seed=seed, **settings)
            ends.append([x[0] for x in (measured.dhr, measured.dht) if x is not None])
        found.append(np.subtract(*ends) / (2 * step))
    found = np.array(found)
    own = ("dhr", "dht")[: found.shape[1]]
    mean, error = found.mean(axis=0), found.std(axis=0, ddof=1) / 6**0.5
    value = np.array([record.gradient(end, of)[0] for of in own])
    noise = np.array([record.gradient_std_err(end, of)[0] for of in own])
    # what the third derivative leaves of a difference
    error = np.hypot(np.hypot(error, noise), 1e-3 * np.abs(mean) + 1e-7)
    for i in np.flatnonzero(np.abs(mean) > 1e-6):
        agree(single(normal_scores((value[i] - mean[i]) / error[i], 5)))
    far = np.argmax(np.abs(mean) / error)
    if name != "rough glass":  # of which hardly anything changes
        wrong = (1.5 * value[far] - mean[far]) / error[far]
        disagree(single(normal_scores(wrong, 5)))


@pytest.mark.slow
@pytest.mark.parametrize(("alpha", "sampler"), [(0.05, "sobol"), (0.3, "independent")])
def test_intervals_cover_the_truth(alpha, sampler):
    """Statistics over 100 seeds: patches of many, few and no hits, and the total.

    The twin: intervals of 80 % do not cover .95 of patches with many hits.
    """
    settings = SETTINGS | {"sampler": sampler, "gradients": ["alpha.value"]}
    bsdf = GGX | {"alpha": alpha}
    truth = gonio.measure(bsdf, **settings | {"estimator": "quadrature"})
    patches, total = (truth.gradient("alpha.value", of) for of in ("brdf", "dhr"))
    scene = mi.load_dict({"type": "scene", "s": {"type": "rectangle", "bsdf": bsdf}})
    covered = {name: [] for name in ("dark", "few", "many", "total", "twin")}
    for seed in range(100):
        record = gonio.measure(scene, seed=seed, rays=1000 + 100 * seed, **settings)
        hits = record.counts[0]
        enough = 30 if sampler == "sobol" else 100
        kinds = {"dark": hits == 0, "few": (hits > 0) & (hits < enough)}
        kinds["many"] = kinds["twin"] = hits >= enough
        for name, some in kinds.items():
            level = 0.8 if name == "twin" else 0.95
            low, high = record.gradient_interval("alpha.value", level)
            held = (low <= patches) & (patches <= high)
            if some.any():
                covered[name].append(held[some].mean())
        low, high = record.gradient_interval("alpha.value", of="dhr")
        covered["total"].append(bool(low[0] <= total[0] <= high[0]))
    for name in ("few", "many", "total"):
        agree(often_enough(covered[name]))
    assert np.mean(covered["many"]) < 0.975
    disagree(often_enough(covered["twin"]))
    if covered["dark"]:
        agree(often_enough([np.mean(covered["dark"]) >= 0.95] * len(covered["dark"])))


def test_scenes_with_other_bsdfs_share_no_rule():
    """Though their parameters have the same names; twin: another scene of the same."""
    mi.set_variant("llvm_ad_mono")
    from gonio_mi.plugins.integrators.goniophotometer import kinds_of

    def scene(bsdf):
        plate = {"type": "rectangle", "bsdf": {"type": bsdf}}
        return mi.load_dict({"type": "scene", "plate": plate})

    pane, glass = scene("thindielectric"), scene("dielectric")
    assert kinds_of(pane) != kinds_of(glass)
    assert kinds_of(pane) == kinds_of(scene("thindielectric"))

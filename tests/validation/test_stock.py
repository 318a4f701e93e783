"""What `validate` finds in Mitsuba's own BSDFs, confirmed by plain calls of Mitsuba.

Nothing of gonio_mi takes part here, but for files that `measured` and
`measured_polarized` read and for a tolerance: if a later Mitsuba mends one of these,
its test fails, and the table of notebooks/stock_plugins.md has a row too many.
"""

import budget
import drjit as dr
import mitsuba as mi
import mueller
import numpy as np
import pytest
from benchmark.stock import coloured
from scipy import stats

from gonio_mi.files import tensor_file
from gonio_mi.single_precision import BSDF_ROUNDING

pytestmark = pytest.mark.usefixtures("mono")

GGX = {"type": "roughconductor", "alpha": 0.2, "distribution": "ggx"}
DIFFUSE = {"type": "diffuse"}


def lit_from(theta, side=1, phi=0.0):
    si = dr.zeros(mi.SurfaceInteraction3f)
    sine = np.sin(theta)
    x, y, z = sine * np.cos(phi), sine * np.sin(phi), side * np.cos(theta)
    si.wi = mi.Vector3f(float(x), float(y), float(z))
    # with literals, Dr.Jit would skip what it knows to be inactive
    dr.make_opaque(si.wi)
    si.n = mi.Normal3f(0, 0, 1)
    si.sh_frame = mi.Frame3f(si.n)
    return si


def context(component=None):
    ctx = mi.BSDFContext()
    if component is not None:
        ctx.component = component
    return ctx


def only(value):
    return float(np.ravel(np.array(value))[0])


@pytest.mark.parametrize("visible", [False, True], ids=["all normals", "twin"])
@pytest.mark.parametrize("distribution", ["beckmann", "ggx"])
def test_smooth_conductors_draw_the_mirror_direction(distribution, visible):
    """Of all normals those nearest to the mean one are drawn as the mean one itself.

    At normal incidence, in 2^20 samples, against the distribution's own law of the
    tangent of the half vector, in double precision: a square below 1e-9 is due in
    0.025 % of the samples. In float32 `sqrt(1 - cos^2)` is 0 below about 2^-24, which
    is drawn in 1.5 %. Visible normals, of the same law there, are drawn by slopes.
    """
    n, alpha, small = 2**20, 0.002, 1e-9
    settings = {"alpha": alpha, "distribution": distribution, "sample_visible": visible}
    bsdf = mi.load_dict({"type": "roughconductor"} | settings)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, n)
    uniform = sampler.next_1d(), sampler.next_2d()
    wo = bsdf.sample(context(), lit_from(0), *uniform)[0].wo.numpy().astype(float)
    # exact to rounding so near to the pole: z is that of a unit vector
    sine = np.hypot(wo[0], wo[1])
    tangent = sine / (1 + np.sqrt(1 - sine**2))
    scaled = small / alpha**2
    due = -np.expm1(-scaled) if distribution == "beckmann" else scaled / (1 + scaled)
    found = np.count_nonzero(tangent**2 < small)
    tails = stats.binom.cdf(found, n, due), stats.binom.sf(found - 1, n, due)
    verdict = budget.Verdict({"share": 2 * min(tails)})
    (budget.agree if visible else budget.disagree)(verdict)
    atom = np.count_nonzero(sine == 0) / n
    assert (atom > 0.01) == (not visible), atom


def test_beckmann_density():
    """Counted in 2^22 samples, and by a midpoint rule of 2400 x 1200 directions."""
    bsdf = mi.load_dict({"type": "roughconductor", "alpha": 0.3})
    si = lit_from(np.radians(80))
    n = 2**22
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, n)
    weight = bsdf.sample(context(), si, sampler.next_1d(), sampler.next_2d())[1]
    sampled = np.count_nonzero(np.array(weight)) / n
    z = ((np.arange(2400) + 0.5) / 2400)[:, None]
    phi = (np.arange(1200) + 0.5) / 1200 * 2 * np.pi
    sine = np.sqrt(1 - z**2)
    wo = np.stack(np.broadcast_arrays(sine * np.cos(phi), sine * np.sin(phi), z))
    pdf = bsdf.pdf(context(), si, mi.Vector3f(wo.reshape(3, -1).astype(np.float32)))
    integral = np.mean(pdf.numpy(), dtype=float) * 2 * np.pi
    std_err = np.sqrt(sampled * (1 - sampled) / n)
    assert sampled - integral > 20 * std_err


@pytest.mark.parametrize("visible", [False, True], ids=["all normals", "twin"])
def test_rough_glass_of_all_normals_is_sampled_with_another_roughness(visible):
    """Weight times pdf against `eval`, of half of the samples, beyond 0.1 %."""
    settings = {"alpha": 0.3, "distribution": "ggx", "sample_visible": visible}
    bsdf, n = mi.load_dict({"type": "roughdielectric"} | settings), 2**12
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, n)
    ctx = mi.BSDFContext(mi.TransportMode.Importance)
    si = lit_from(np.radians(60))
    bs, weight = bsdf.sample(ctx, si, sampler.next_1d(), sampler.next_2d())
    product = np.ravel(np.array(weight)) * np.ravel(np.array(bs.pdf))
    value = np.ravel(np.array(bsdf.eval(ctx, si, bs.wo)))
    off = np.abs(product - value)[product > 0] / value[product > 0]
    assert (np.median(off) > 16 * BSDF_ROUNDING) == (not visible)


def test_mask_passes_light_whatever_types_are_asked_for():
    bsdf = mi.load_dict({"type": "mask", "opacity": 0.4, "nested": DIFFUSE})
    ctx = context()
    ctx.type_mask = int(mi.BSDFFlags.DiffuseReflection)
    weight = bsdf.sample(ctx, lit_from(0.5), mi.Float([0.9]), mi.Point2f(0.3, 0.6))[1]
    assert only(weight) > 0


def test_roughplastic_has_a_density_below_the_horizon():
    bsdf = mi.load_dict({"type": "roughplastic", "alpha": 0.3, "distribution": "ggx"})
    below = mi.Vector3f(0.6, 0, -0.8)
    dr.make_opaque(below)
    si = lit_from(0.5)
    assert only(bsdf.pdf(context(), si, below)) > 0
    assert only(bsdf.eval(context(), si, below)) == 0


def test_beckmann_roughplastic_has_it_too():
    bsdf = mi.load_dict({"type": "roughplastic", "alpha": 0.3})
    below = mi.Vector3f(-0.995, 0, -0.0999)
    dr.make_opaque(below)
    assert only(bsdf.pdf(context(), lit_from(1.3), below)) > 0
    assert only(bsdf.eval(context(), lit_from(1.3), below)) == 0


def test_the_diffuse_density_of_roughplastic_is_negative_below():
    bsdf = mi.load_dict({"type": "roughplastic", "alpha": 0.3, "distribution": "ggx"})
    below = mi.Vector3f(0.6, 0, -0.8)
    dr.make_opaque(below)
    assert only(bsdf.pdf(context(1), lit_from(0.5), below)) < 0


@pytest.mark.parametrize("name", ["alpha", "eta"])
def test_gradients_of_roughplastic(name):
    """They know nothing of the tables that the parameter changes."""
    bsdf = mi.load_dict({"type": "roughplastic", "alpha": 0.3, "distribution": "ggx"})
    # far from the mirror direction, where light is diffuse
    si, wo = lit_from(0.5), mi.Vector3f(0.6, 0, 0.8)
    params = mi.traverse(bsdf)
    value = float(np.ravel(np.array(params[name]))[0])
    kind = type(params[name])

    def at(number):
        params[name] = kind(number)
        params.update()
        return only(bsdf.eval(context(), si, wo))

    h = 0.02 * value
    difference = (at(value + h) - at(value - h)) / (2 * h)
    finer = (at(value + h / 2) - at(value - h / 2)) / h
    variable = kind(value)
    dr.enable_grad(variable)
    params[name] = variable
    params.update()
    answer = bsdf.eval(context(), si, wo)
    dr.forward(variable, flags=dr.ADFlag.Default | dr.ADFlag.AllowNoGrad)
    gradient = only(dr.grad(answer))
    assert abs(gradient - finer) > 20 * abs(finer - difference)


@pytest.mark.parametrize("kind", ["bumpmap", "normalmap"])
def test_maps_of_normals_are_anisotropic_and_do_not_say_so(kind):
    normals = np.tile(np.array([0.55, 0.5, 0.99], np.float32), (2, 2, 1))
    heights = np.linspace(0, 0.3, 16, dtype=np.float32).reshape(4, 4, 1)
    values = normals if kind == "normalmap" else heights
    texture = {"type": "bitmap", "bitmap": mi.Bitmap(values), "raw": True}
    name = "normalmap" if kind == "normalmap" else "arbitrary"
    bsdf = mi.load_dict({"type": kind, name: texture, "nested": DIFFUSE})
    assert not mi.has_flag(bsdf.flags(), mi.BSDFFlags.Anisotropic)
    answers = []
    for phi in (0.3, 1.3):
        si = lit_from(0.5, phi=phi)
        si.uv = mi.Point2f(0.5, 0.5)
        si.dp_du, si.dp_dv = mi.Vector3f(2, 0, 0), mi.Vector3f(0, 2, 0)
        x, y = 0.6 * np.cos(phi + 2), 0.6 * np.sin(phi + 2)
        wo = mi.Vector3f(float(x), float(y), 0.8)
        answers.append(only(bsdf.eval(context(), si, wo)))
    assert abs(answers[0] / answers[1] - 1) > 0.01


def test_blendbsdf():
    bsdf = mi.load_dict({"type": "blendbsdf", "weight": 0.3, "a": DIFFUSE, "b": GGX})
    random = mi.Float([0.1]), mi.Point2f(0.0, 0.5)
    behind = bsdf.sample(context(), lit_from(0.5, -1), mi.Float([0.0]), random[1])
    assert np.isnan(only(behind[1]))
    first, second = (
        bsdf.sample(context(), lit_from(0.5), mi.Float([u]), mi.Point2f(0.3, 0.6))[0]
        for u in (0.9, 0.1)
    )
    assert only(first.sampled_type) != only(second.sampled_type)
    assert only(first.sampled_component) == only(second.sampled_component) == 0


def test_blendbsdf_of_a_mirror():
    """Mirrored light must be worth 1, but the other lobe's density takes part."""
    nested = {"a": {"type": "diffuse"}, "b": {"type": "conductor"}}
    bsdf = mi.load_dict({"type": "blendbsdf", "weight": 0.25, **nested})
    random = mi.Float([0.1]), mi.Point2f(0.3, 0.6)
    bs, weight = bsdf.sample(context(), lit_from(0.5), *random)
    assert mi.has_flag(bs.sampled_type, mi.BSDFFlags.DeltaReflection)
    density = np.cos(0.5) / np.pi  # diffuse: reflectance 0.5
    mixed = (0.25 + 0.75 * 0.5 * density) / (0.25 + 0.75 * density)
    assert abs(only(weight) - mixed) <= 16 * np.finfo(np.float32).eps
    assert mixed < 0.8


def test_principled():
    bsdf = mi.load_dict({"type": "principled"})
    si, wo = lit_from(0.5), mi.Vector3f(0, 0.6, 0.8)
    values = {only(bsdf.eval(context(i), si, wo)) for i in (None, 0, 1)}
    assert len(values) == 1
    one = bsdf.sample(context(), si, mi.Float([0.95]), mi.Point2f(0.3, 0.6))[0]
    assert only(one.sampled_component) == 3 > bsdf.component_count() - 1
    behind = lit_from(0.5, -1)
    down = mi.Vector3f(0.6, 0, -0.8)
    assert only(bsdf.pdf(context(), behind, down)) > 0
    weight = bsdf.sample(context(), behind, mi.Float([0.5]), mi.Point2f(0.3, 0.6))[1]
    assert only(weight) == 0


def test_principledthin_is_not_reciprocal():
    settings = {"spec_trans": 0.5, "diff_trans": 1.0, "roughness": 0.4}
    bsdf = mi.load_dict({"type": "principledthin"} | settings)
    one, other = lit_from(0.5), lit_from(1.2, -1)
    there = only(bsdf.eval(context(), one, other.wi)) / np.cos(1.2)
    back = only(bsdf.eval(context(), other, one.wi)) / np.cos(0.5)
    assert abs(there / back - 1) > 0.01


def test_pplastic_samples_an_undeclared_component():
    bsdf = mi.load_dict({"type": "pplastic", "alpha": 0.3})
    one = bsdf.sample(context(), lit_from(0.5), mi.Float([0.9]), mi.Point2f(0.3, 0.6))
    assert only(one[0].sampled_component) == bsdf.component_count() == 1


def test_mask():
    bsdf = mi.load_dict({"type": "mask", "opacity": 0.4, "nested": DIFFUSE})
    si, random = lit_from(0.5), (mi.Float([0.5]), mi.Point2f(0.3, 0.6))
    bs, weight = bsdf.sample(context(0), si, *random)
    assert only(weight) == only(bs.pdf) == 1
    assert only(bsdf.pdf(context(0), si, bs.wo)) == 0


@pytest.mark.parametrize(
    "specimen", [{"type": "null"}, {"type": "mask", "opacity": 0.4, "n": DIFFUSE}]
)
def test_inactive_rays_get_weight(specimen):
    bsdf = mi.load_dict(specimen)
    random = mi.Float([0.9]), mi.Point2f(0.3, 0.6)
    assert only(bsdf.sample(context(), lit_from(0.5), *random, False)[1]) == 1


def test_twosided_counts_its_back_twice():
    bsdf = mi.load_dict({"type": "twosided", "a": DIFFUSE, "b": GGX})
    si, wo = lit_from(0.5, -1), mi.Vector3f(-0.5, 0, -(0.75**0.5))
    values = [only(bsdf.eval(context(i), si, wo)) for i in (None, 0, 1)]
    assert values[0] == values[1] == values[2] > 0


# The fibre of `hair` runs along y. This one absorbs nothing.
PALE = {"type": "hair", "sigma_a": 0.0}


def hair_integral(bsdf, si, n):
    """Integral of pdf over the sphere, by a midpoint rule of n x n directions."""
    y = ((np.arange(n) + 0.5) / n * 2 - 1)[:, None]
    phi = (np.arange(n) + 0.5) / n * 2 * np.pi
    across = np.sqrt(1 - y**2)
    wo = np.stack(np.broadcast_arrays(across * np.cos(phi), y, across * np.sin(phi)))
    pdf = bsdf.pdf(context(), si, mi.Vector3f(wo.reshape(3, -1).astype(np.float32)))
    return np.mean(pdf.numpy(), dtype=float) * 4 * np.pi


def test_hair_has_a_density_of_less_than_one():
    """No sample fails, and light that nothing absorbs is lost in `eval` too."""
    bsdf = mi.load_dict(PALE)
    si = lit_from(np.radians(35), phi=np.radians(25))
    coarse, fine = (hair_integral(bsdf, si, n) for n in (500, 1000))
    n = 2**16
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, n)
    weight = bsdf.sample(context(), si, sampler.next_1d(), sampler.next_2d())[1]
    assert np.all(np.array(weight) > 0)
    assert 1 - fine > 20 * abs(fine - coarse)
    assert 1 - fine > 1e-3


def test_hair_samples_late_orders_across_the_fibre_only():
    """They have no component along the fibre at all; `pdf` says they are spread."""
    bsdf = mi.load_dict(PALE)
    si = lit_from(np.radians(70))
    n = 2**16
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, n)
    bs = bsdf.sample(context(), si, sampler.next_1d(), sampler.next_2d())[0]
    assert np.count_nonzero(np.array(bs.wo.y) == 0) > n / 50


def test_hair_is_not_adjoint():
    bsdf = mi.load_dict(PALE)
    one, other = lit_from(0.5), lit_from(1.2, -1, 0.3)
    radiance, importance = context(), mi.BSDFContext(mi.TransportMode.Importance)
    there, back = (
        only(bsdf.eval(ctx, si, wo)) / abs(only(wo.z))
        for ctx, si, wo in ((radiance, one, other.wi), (importance, other, one.wi))
    )
    assert abs(there / back - 1) > 0.01


@pytest.mark.parametrize(
    "specimen",
    [PALE, {"type": "principled", "clearcoat": 1.0, "sheen": 0.5}],
    ids=["hair", "principled"],
)
def test_rounding_is_that_of_so_many_operations(specimen):
    """The largest of Mitsuba's own functions have fewer than a tolerance allows for."""
    bsdf = mi.load_dict(specimen)
    wo = mi.Vector3f([0.1, 0.2], [0.3, -0.1], [0.9, 0.8])
    dr.eval(wo)
    allowed = BSDF_ROUNDING / 2.0**-24
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for function in (bsdf.eval, bsdf.pdf):
            dr.kernel_history_clear()
            dr.eval(function(context(), lit_from(0.5), wo))
            n = sum(k.get("operation_count", 0) for k in dr.kernel_history())
            assert 100 < n < allowed


def test_pigments_of_hair_need_colours():
    bsdf = mi.load_dict({"type": "hair"})
    with pytest.raises(RuntimeError, match="non-spectral"):
        bsdf.eval(context(), lit_from(0.5), mi.Vector3f(0, 0.6, 0.8))


def test_measured_is_as_reciprocal_as_its_table(rgb):
    assert mi.variant() == rgb
    bsdf = next(mi.load_dict(d) for name, d in coloured() if name == "measured")
    one, other = lit_from(0.5), lit_from(1.2, phi=2.0)
    there = only(bsdf.eval(context(), one, other.wi)) / np.cos(1.2)
    back = only(bsdf.eval(context(), other, one.wi)) / np.cos(0.5)
    assert abs(there / back - 1) > 0.01


# ------------------------------------------------------------------ polarised variants

# Single precision, after some dozens of operations on elements up to 1.
ROUNDING = 4e-6
INDEX = 0.2 + 3j
MIRROR = {"type": "conductor", "eta": INDEX.real, "k": INDEX.imag}


@pytest.fixture
def polarised(mono):
    if "llvm_ad_mono_polarized" not in mi.variants():
        pytest.skip("not in this build")
    mi.set_variant("llvm_ad_mono_polarized")
    yield
    mi.set_variant(mono)


def bitmap(values):
    tensor = mi.TensorXf(np.ascontiguousarray(values, dtype=np.float32))
    return {"type": "bitmap", "raw": True, "data": tensor}


def normal_map(*normal):
    texture = bitmap(np.broadcast_to(normal, (2, 2, 3)))
    return {"type": "normalmap", "normalmap": texture, "nested": MIRROR}


def bump_map(scale):
    heights = np.add.outer(0.03 * np.arange(8), 0.05 * np.arange(8))[..., None]
    return {"type": "bumpmap", "map": bitmap(heights), "scale": scale, "nested": MIRROR}


def directions(seed, side=1, n=512):
    rng = np.random.default_rng(seed)
    theta, phi = np.radians(5 + 75 * rng.random(n)), 2 * np.pi * rng.random(n)
    x, y = np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi)
    return np.stack([x, y, side * np.cos(theta)], axis=1)


def lit_by(wi):
    si = dr.zeros(mi.SurfaceInteraction3f, len(wi))
    si.wi = vectors(wi)
    dr.make_opaque(si.wi)
    si.n = mi.Normal3f(0, 0, 1)
    si.sh_frame, si.uv = mi.Frame3f(si.n), mi.Point2f(0.5, 0.5)
    si.dp_du, si.dp_dv = mi.Vector3f(2, 0, 0), mi.Vector3f(0, 2, 0)
    return si


def vectors(rows):
    return mi.Vector3f(np.ascontiguousarray(rows.T, dtype=np.float32))


def per_light(matrix, wi, wo):
    """Elements over the first, (n, 4, 4), in frames of s = k x h, and lit lanes.

    In radiance mode light arrives along -wo and leaves along wi.
    """
    h = wi + wo
    frames = []
    for k in (-wo, wi):
        s = np.cross(k, h)
        s /= np.linalg.norm(s, axis=1, keepdims=True)
        frames += [vectors(k), mi.mueller.stokes_basis(vectors(k)), vectors(s)]
    turned = mi.mueller.rotate_mueller_basis(matrix, *frames)
    rows = [[np.ravel(turned[i, j]) for j in range(4)] for i in range(4)]
    m = np.moveaxis(np.array(rows), -1, 0)
    lit = m[:, 0, 0] > 0
    return m / np.where(lit, m[:, 0, 0], 1)[:, None, None], lit


def fresnel(wi, wo):
    h = (wi + wo) / np.linalg.norm(wi + wo, axis=1, keepdims=True)
    m = mueller.reflection(np.sum(wi * h, axis=1), INDEX)
    return m / m[:, :1, :1]


@pytest.mark.usefixtures("polarised")
@pytest.mark.parametrize(
    ("specimen", "side", "off"),
    [
        (lambda: {"type": "twosided", "nested": MIRROR}, 1, 0),
        (lambda: {"type": "twosided", "nested": MIRROR}, -1, 1.9),
        (lambda: normal_map(0.5, 0.5, 1), 1, 0),
        (lambda: normal_map(0.65, 0.6, 0.93), 1, 0.6),
        (lambda: bump_map(0), 1, 0),
        (lambda: bump_map(4), 1, 0.9),
    ],
    ids=["front", "behind", "upright", "normalmap", "flat", "bumpmap"],
)
def test_mirrors_within_others_are_not_fresnels(specimen, side, off):
    """Their frames are not turned with the directions; upright ones are the twins."""
    wi = directions(1, side)
    bsdf, n = mi.load_dict(specimen()), len(wi)
    random = mi.Float(np.full(n, 0.5, np.float32)), mi.Point2f(0.3, 0.4)
    bs, weight = bsdf.sample(context(), lit_by(wi), *random)
    wo = bs.wo.numpy().T.astype(float)
    m, lit = per_light(weight, wi, wo)
    worst = np.abs(m - fresnel(wi, wo))[lit].max()
    assert lit.sum() > n / 2
    assert worst > off if off else worst < ROUNDING


@pytest.mark.usefixtures("polarised")
@pytest.mark.parametrize("theta", [0.0, 20.0])
def test_retarder_jumps(theta):
    """Over wi.y = 0, and not over wi.x = 0."""
    plate = mi.load_dict({"type": "retarder", "delta": 90.0, "theta": theta})
    wi = np.array([[0.6, 1e-3, 0.8], [0.6, -1e-3, 0.8]])
    steps = []
    for at in (wi, wi[:, [1, 0, 2]]):
        random = mi.Float([0.5, 0.5]), mi.Point2f(0.3, 0.4)
        m = plate.sample(context(), lit_by(at), *random)[1]
        pairs = [np.ravel(m[i, j]) for i in range(4) for j in range(4)]
        steps.append(max(np.ptp(pair) for pair in pairs))
    assert steps[0] > 1.3
    assert steps[1] < 0.01


@pytest.mark.usefixtures("polarised")
def test_measured_polarized_is_its_table(tmp_path):
    """But for light straight back. The table is linear between Fresnel's matrices."""
    theta_d, ends = np.radians(np.arange(91.0)), np.array([[0, np.pi / 2]])
    table = 0.1 * mueller.reflection(np.cos(theta_d), INDEX)
    fields = {
        "M": np.broadcast_to(table[None, :, None, None], (2, 91, 2, 5, 4, 4)),
        "theta_h": ends,
        "theta_d": theta_d[None],
        "phi_d": np.array([[-np.pi, np.pi]]),
    }
    fields = {name: x.astype(np.float32) for name, x in fields.items()}
    fields["wvls"] = np.arange(450, 651, 50).astype(np.uint16)
    with (tmp_path / "mirror.pbsdf").open("wb") as stream:
        tensor_file.write(fields, stream)
    settings = {"filename": str(tmp_path / "mirror.pbsdf"), "wavelength": 550.0}
    bsdf = mi.load_dict({"type": "measured_polarized"} | settings)
    wi, wo = directions(1), directions(2)
    m, lit = per_light(bsdf.eval(context(), lit_by(wi), vectors(wo)), wi, wo)
    assert lit.all()
    # an eighth of the second difference, of values and of the first element
    bound = np.abs(np.diff(table[:82], 2, axis=0)).max() / 8 / table[:, 0, 0].min()
    assert np.abs(m - fresnel(wi, wo)).max() < 2 * bound + ROUNDING
    back = bsdf.eval(context(), lit_by(wi[:1]), vectors(wi[:1]))
    assert np.isnan(np.ravel(back[1, 1])).all()
    assert only(back[0, 0]) > 0

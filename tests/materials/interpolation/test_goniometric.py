"""The material made from a record: it is the record, and light is kept in between."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import synthetic
from budget import agree, disagree, normal_scores, scores, single, verdict
from lit_points import (
    EPS,
    IMPORTANCE,
    RADIANCE,
    ROUNDING,
    interaction,
    isotropic,
    patch_middles,
    values,
)
from sampled_material import SamplingDensity

import gonio_mi as gonio
from gonio_mi.collector.directions import direction
from gonio_mi.errors import FinerPatchesWarning
from gonio_mi.materials.interpolation.lobes import MeasuredLobes
from gonio_mi.materials.interpolation.lookups import singles
from gonio_mi.quadrature import integrate
from gonio_mi.results.patch_means import PatchMeans


@pytest.fixture(autouse=True)
def _in_mono(mono):
    """Run in llvm_ad_mono, unless a test asks for more."""


@pytest.fixture
def plugin(tmp_path):
    """Return a function that makes the material of a record."""

    def load(record, ending=".npz", **parameters):
        path = tmp_path / f"{len(list(tmp_path.iterdir()))}{ending}"
        record.save(path)
        return mi.load_dict({"type": "goniometric", "filename": str(path)} | parameters)

    return load


def anisotropic(**settings):
    grid = [(theta, phi) for theta in (20, 60) for phi in (0, 90, 180, 270)]
    theta_i, phi_i = zip(*grid)
    return synthetic.record(theta_i=theta_i, phi_i=phi_i, **settings)


def drawn(seed, n):
    """Random numbers of a sample."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, n)
    return sampler.next_1d(), sampler.next_2d()


# --------------------------------------------------------------- it is the record


def test_integral_over_each_patch_is_what_was_measured(plugin):
    """Twin: at another angle it is another record."""
    patches = "borders:0,20,70,90x0,10,100,360"
    record = isotropic(collector=patches, both=True, phi_i=(25, 25, 25))
    bsdf = plugin(record)
    for number, theta_i in enumerate(record.theta_i):
        result = integrate(bsdf, theta_i, 25, record.subdivision, integral_err=1e-5)
        fraction = record.flux_fraction[number]
        error = np.abs(result.flux[: len(fraction)] - fraction)
        tolerated = ROUNDING * fraction + result.error[: len(fraction)]
        # what single precision displaces over a border of the largest patch
        tolerated += EPS * fraction.max() * record.subdivision.n_patches
        assert (error <= tolerated).all(), error.max()
        other = record.flux_fraction[number - 1]
        assert np.abs(result.flux[: len(other)] - other).max() > 1e-3


def test_from_exr_and_from_npz_alike(plugin):
    wo = direction(*np.random.default_rng(1).uniform(0, 1.5, (2, 1000)))
    record = isotropic(both=True)
    both = [values(plugin(record, ending), wo, 40) for ending in (".npz", ".exr")]
    assert np.array_equal(*both)


@pytest.mark.parametrize(("theta_i", "phi_i"), [(30, 0), (45, 20)])
def test_density_integrates_to_one(plugin, theta_i, phi_i):
    """On and between the angles of the record, over both hemispheres."""
    record = isotropic(both=True, collector="projected:4x6")
    bsdf = plugin(record)
    tolerance = 1e-5 if theta_i == 30 else 3e-3
    density = SamplingDensity(bsdf)
    result = integrate(
        density, theta_i, phi_i, record.subdivision, integral_err=tolerance
    )
    rounding = ROUNDING * record.subdivision.n_patches
    assert abs(result.flux.sum() - 1) <= result.error.sum() + rounding


@pytest.mark.parametrize(
    ("make", "theta_i", "phi_i"),
    [(isotropic, 45, 30), (anisotropic, 50, 250)],
)
def test_samples_follow_eval(plugin, make, theta_i, phi_i):
    record = make(both=True, power=8, collector="projected:4x6")
    bsdf = plugin(record)
    patches = record.subdivision
    reference = integrate(bsdf, theta_i, phi_i, patches, integral_err=3e-3).flux[..., 0]
    measured = gonio.measure(
        bsdf, theta_i, phi_i, collector=patches, rays=2**19, sampler="independent"
    )
    for hemisphere in (0, 1):
        agree(verdict(scores(measured, reference[hemisphere], hemisphere)))
        disagree(verdict(scores(measured, 1.02 * reference[hemisphere], hemisphere)))


@pytest.mark.promise("a material for Mitsuba")
def test_weights_are_eval_over_density(plugin):
    bsdf = plugin(isotropic(both=True))
    ctx = mi.BSDFContext(IMPORTANCE)
    si = interaction(40, 110)
    bs, weight = bsdf.sample(ctx, si, *drawn(3, 10_000))
    value, pdf = bsdf.eval_pdf(ctx, si, bs.wo)
    assert np.array_equal(pdf.numpy(), bs.pdf.numpy())
    error = np.abs(value.numpy()[0] / pdf.numpy() - weight.numpy()[0])
    assert (error <= 2 * EPS * weight.numpy()[0]).all()
    # of one channel: the same weight for all, reflectance and transmittance together
    spread = weight.numpy().max() - weight.numpy().min()
    assert spread <= ROUNDING * weight.numpy().max()


# ------------------------------------------------------------------ between angles


def test_diffuse_stays_diffuse(plugin):
    patches = gonio.subdivision("projected:6x8")
    even = np.full((2, 1, *patches.shape), 0.75 / patches.n_patches)
    bsdf = plugin(synthetic.exact(even, (10, 80), "projected:6x8"))
    wo = direction(*np.random.default_rng(2).uniform(0, 1.5, (2, 1000)))
    error = np.abs(values(bsdf, wo, 50, 200) - 0.75 / np.pi)
    assert (error <= ROUNDING * 0.75 / np.pi).all()


@pytest.mark.parametrize(("angles", "theta_i"), [((0, 20), 10), ((30, 60), 45)])
def test_moving_is_nearer_the_truth_than_mixing(plugin, angles, theta_i):
    """A lobe that both angles see elsewhere: the mixture shows it twice."""
    conductor = {"type": "roughconductor", "alpha": 0.2}
    patches = gonio.subdivision("projected:16x32")
    record = gonio.measure(conductor, angles, collector=patches, rays=2**16)
    truth = integrate(mi.load_dict(conductor), theta_i, 0, patches, integral_err=1e-3)
    moved = gonio.measure(plugin(record), theta_i, collector=patches, rays=2**16)
    mixed = record.flux_fraction[:, 0].mean(axis=0)
    errors = [
        np.abs(flux - truth.flux[0]).sum() for flux in (moved.flux_fraction[0], mixed)
    ]
    assert errors[0] < errors[1] / 2


@pytest.mark.parametrize("theta_i", [0, 20, 45, 89])
def test_energy_is_linear_in_between(plugin, theta_i):
    """In the sine of the angle of incidence; constant beyond the last one."""
    patches = gonio.subdivision("projected:6x8")
    lobe = [synthetic.specular(patches, theta, 180, 20) for theta in (30, 60)]
    weights = np.stack([0.25 * lobe[0], 0.75 * lobe[1]])[:, None]
    bsdf = plugin(synthetic.exact(weights, (30, 60), "projected:6x8"))
    numbers = drawn(3, 1000)
    ctx = mi.BSDFContext(IMPORTANCE)
    _, weight = bsdf.sample(ctx, interaction(theta_i), *numbers)
    low, high, sine = np.sin(np.radians([30, 60, theta_i]))
    share = (sine - low) / (high - low)
    expected = 0.25 + 0.5 * np.clip(share, 0, 1)
    assert (np.abs(weight.numpy() - expected) <= ROUNDING).all()


def test_azimuth_turns_with_incidence(plugin):
    record = isotropic()
    theta, phi = (angle.ravel() for angle in record.subdivision.middles)
    turned = values(plugin(record), direction(theta, phi + np.radians(70)), 30, 70)
    brdf = record.brdf[1].reshape(-1, 1)
    assert (np.abs(turned - brdf) <= ROUNDING * brdf).all()


@pytest.mark.parametrize(
    ("phi_i", "records"), [(45, (0, 1)), (180, (2, 2)), (315, (3, 0))]
)
def test_between_azimuths_the_neighbours_are_mixed(plugin, phi_i, records):
    """Each turned to the direction of incidence, the last and the first one too."""
    record = anisotropic(power=4)
    theta, phi = (angle.ravel() for angle in record.subdivision.middles)
    mixed = values(plugin(record), direction(theta, phi + np.radians(phi_i)), 20, phi_i)
    own = [direction(theta, phi + np.radians(record.phi_i[n])) for n in records]
    patches = [record.subdivision.patch(wo) for wo in own]
    ends = [record.brdf[n].ravel()[p] for n, p in zip(records, patches)]
    # the azimuth of incidence in float32, as a part of 90 degrees
    error = np.abs(mixed[:, 0] - np.mean(ends, axis=0))
    assert (error <= ROUNDING * record.brdf.max()).all()


# --------------------------------------------------------------- colours, modes, faces


@pytest.mark.usefixtures("rgb")
def test_colours_are_the_records(plugin):
    record = isotropic(channels=("R", "G", "B"), both=True)
    wo, one = patch_middles(record), record[1]
    for up, means in ((1, one.brdf), (-1, one.btdf)):
        seen = values(plugin(record), wo * [1, 1, up], 30)
        means = means.reshape(-1, 3)[record.subdivision.patch(wo)]
        assert (np.abs(seen - means) <= ROUNDING * means).all()
    half_way = np.degrees(np.arcsin(np.sin(np.radians([30, 60])).mean()))
    how = {"collector": "projected:1x1", "sampler": "independent", "batches": 32}
    measured = gonio.measure(plugin(record), half_way, rays=2**18, **how)
    fractions = record.flux_fraction[1:].sum(axis=(2, 3)).mean(axis=0)
    for hemisphere, channel in np.ndindex(2, 3):
        expected = fractions[hemisphere, channel].reshape(1, 1)
        z = scores(measured, expected, hemisphere, channel)
        agree(single(z[0]))
        disagree(single(scores(measured, 1.02 * expected, hemisphere, channel)[0]))


def test_rgb_record_in_mono_is_its_luminance(plugin):
    record = isotropic(channels=("R", "G", "B"))
    wo = patch_middles(record)
    means = record[1].brdf.reshape(-1, 3)[record.subdivision.patch(wo)]
    luminance = means @ [[0.212671], [0.715160], [0.072169]]
    seen = values(plugin(record), wo, 30)
    assert (np.abs(seen - luminance) <= ROUNDING * luminance).all()


@pytest.mark.usefixtures("variant")
def test_grey_record_in_any_variant(plugin):
    record = isotropic()
    wo = patch_middles(record)
    seen = values(plugin(record), wo, 30)
    brdf = record[1].brdf.reshape(-1, 1)[record.subdivision.patch(wo)]
    assert (np.abs(seen - brdf) <= ROUNDING * brdf).all()


def test_a_back_that_nothing_tells_of_is_told_once(plugin, tmp_path, capfd):
    """Of what transmits; not with a back, nor of what reflects alone."""
    record = isotropic(both=True)
    plugin(isotropic())
    plugin(record, back_filename=saved(record, tmp_path))
    assert capfd.readouterr() == ("", "")
    name = saved(record, tmp_path)
    for said in (1, 0):
        mi.load_dict({"type": "goniometric", "filename": name})
        told = "".join(capfd.readouterr())
        assert told.count("WARN") == told.count("as back_filename") == said


def test_a_record_of_the_back_as_the_front_is_told(tmp_path, capfd):
    """Twin: as the back it is what was measured, and nothing is said."""
    record = isotropic()
    back = record.with_settings(side="back")
    name, front = saved(back, tmp_path), saved(record, tmp_path)
    mi.load_dict({"type": "goniometric", "filename": front, "back_filename": name})
    assert capfd.readouterr() == ("", "")
    mi.load_dict({"type": "goniometric", "filename": name})
    told = "".join(capfd.readouterr())
    assert told.count("WARN") == told.count("was measured from the back") == 1


@pytest.mark.parametrize("side", [1, -1])
def test_radiance_mode_is_adjoint(plugin, tmp_path, side):
    """Its value is what was measured with light from `wo`, on either face."""
    record = isotropic(both=True)
    bsdf = plugin(record, back_filename=saved(record, tmp_path))
    wi = direction(np.radians(40.0), np.radians(70.0)) * [1, 1, side]
    for theta_o, phi_o in ((25.0, 200.0), (155.0, 200.0)):
        wo = direction(np.radians(theta_o), np.radians(phi_o))
        radiance = values(bsdf, wo[None], 40, 70, side, RADIANCE)[0, 0]
        lit = 1 if wo[2] > 0 else -1
        angle = min(theta_o, 180 - theta_o)
        flux = values(bsdf, wi[None], angle, phi_o, lit)[0, 0]
        assert flux > 0
        assert abs(radiance - flux) <= ROUNDING * flux


@pytest.mark.parametrize("max_cells", [0, 2**24])
def test_radiance_mode_samples_follow_its_density(plugin, monkeypatch, max_cells):
    """Shares of directions against `pdf` at others, batch by batch, on both sides.

    Of lobes, and of a guide.
    """
    module = "gonio_mi.materials.interpolation.radiance_guide"
    monkeypatch.setattr(f"{module}.MAX_CELLS", max_cells)
    bsdf = plugin(isotropic(both=True, power=4, collector="projected:3x4"))
    assert (bsdf.guide is None) == (max_cells == 0)
    ctx, n, batches = mi.BSDFContext(RADIANCE), 2**18, 32
    patches = gonio.subdivision("projected:2x4")
    rng = np.random.default_rng(5)

    def shares(wo, weights):
        index = patches.patch(wo) + patches.n_patches * (wo[:, 2] < 0)
        batch = np.arange(n) // (n // batches)
        joint = batch * 2 * patches.n_patches + index
        total = np.bincount(joint, weights, minlength=2 * patches.n_patches * batches)
        return total.reshape(batches, -1) / (n / batches)

    for side in (1, -1):
        si = interaction(40, 20, side)
        bs, _ = bsdf.sample(ctx, si, *drawn(11, n))
        sampled = shares(bs.wo.numpy().T.astype(float), None)
        x = rng.random((3, n))
        wo = direction(np.arcsin(np.sqrt(x[0])), 2 * np.pi * x[1])
        wo[:, 2] *= np.where(x[2] < 0.5, -1, 1)
        density = bsdf.pdf(ctx, si, mi.Vector3f(wo.T.astype(np.float32))).numpy()
        expected = shares(wo, 2 * np.pi * density / np.abs(wo[:, 2]))
        known = expected.mean(axis=0) > 0.01  # eighty rays of a batch
        assert known.any()
        assert (sampled[:, expected.sum(axis=0) == 0] == 0).all()
        for factor, judge in ((1, agree), (1.1, disagree)):
            difference = (sampled - factor * expected)[:, known]
            std_err = difference.std(axis=0, ddof=1) / np.sqrt(batches)
            t = difference.mean(axis=0) / std_err
            judge(verdict(normal_scores(t, batches - 1)))


@pytest.mark.parametrize("component", [None, 0, 1])
@pytest.mark.parametrize("side", [1, -1])
def test_pictures_draw_what_they_see(plugin, tmp_path, component, side):
    """Weights of directions that are drawn have the mean of the value over all.

    With either component alone, too, and less spread than those drawn evenly.
    """
    record = isotropic(both=True, power=8)
    bsdf = plugin(record, back_filename=saved(isotropic(seed=5, both=True), tmp_path))
    ctx, n = mi.BSDFContext(RADIANCE), 2**17
    if component is not None:
        ctx.component = component
    si, (sample1, sample2) = interaction(50, 20, side), drawn(7, n)
    bs, weight = bsdf.sample(ctx, si, sample1, sample2)
    even = mi.warp.square_to_cosine_hemisphere(sample2)
    even.z = dr.select(sample1 < 0.5, -even.z, even.z)
    value, pdf = bsdf.eval_pdf(ctx, si, even)
    evenly = 2 * np.pi / np.abs(even.z.numpy())
    weights, expected = weight.numpy()[0], value.numpy()[0] * evenly
    assert (pdf.numpy()[expected > 0] > 0).all()
    if component is not None:
        assert (bs.sampled_component.numpy() == component).all()
    for factor, judge in ((1, agree), (1.1, disagree)):
        for own, other in ((weights, expected), (pdf.numpy() * evenly, np.ones(n))):
            error = own.mean() - factor * other.mean()
            judge(single(error / np.hypot(own.std(), other.std()) * np.sqrt(n)))
    assert weights.std() < expected.std() / 2


def test_a_face_that_was_not_measured_is_black(plugin):
    """In pictures, too: seen from behind is what was lit in front, and else nothing."""
    bsdf = plugin(isotropic(both=True))
    up, down = direction(np.array([[0.3], [2.8]]), 3.0)
    assert (values(bsdf, np.concatenate([up, down]), 30, side=-1) == 0).all()
    assert (values(bsdf, up, 30, side=-1, mode=RADIANCE) > 0).all()
    assert (values(bsdf, down, 30, side=-1, mode=RADIANCE) == 0).all()
    assert (values(bsdf, down, 30, side=1, mode=RADIANCE) == 0).all()


def test_the_back_face_is_a_mirror_image(plugin, tmp_path):
    record = isotropic(both=True)
    bsdf = plugin(record, back_filename=saved(record, tmp_path))
    wo = direction(*np.random.default_rng(1).uniform(0, 1.5, (2, 500)))
    for up in (1, -1):
        front = values(bsdf, wo * [1, 1, up], 40)
        assert np.array_equal(front, values(bsdf, wo * [1, 1, -up], 40, side=-1))
    how = {"collector": record.subdivision, "rays": 2**18, "sampler": "independent"}
    back = gonio.measure(bsdf, 30, side="back", **how)
    for hemisphere in (0, 1):
        fraction = record.flux_fraction[1, hemisphere, ..., 0]
        agree(verdict(scores(back, fraction, hemisphere)))
        disagree(verdict(scores(back, np.roll(fraction, 1, axis=1), hemisphere)))


@pytest.mark.parametrize(
    ("transmitted", "transmits"), [(0.0, False), (1e-17, False), (1e-9, True)]
)
def test_of_an_opaque_record_the_back_is_no_part(plugin, transmitted, transmits):
    """Also if a few rays slipped through a mesh; twin: of a dark filter it is."""
    record = isotropic(both=True)
    flux = record.flux_fraction.copy()
    flux[:, 1] = transmitted / flux[0, 1].size
    means = PatchMeans(
        record.subdivision, record.theta_i, record.phi_i, record.channels, flux
    )
    assert MeasuredLobes(means).flux.shape[1] == 1 + transmits
    assert MeasuredLobes(means, keep_dark=True).flux.shape[1] == 2
    if transmitted != 1e-17:  # less than a record's sums can hold
        weights = flux[..., 0]
        bsdf = plugin(synthetic.exact(weights, record.theta_i, "projected:6x8"))
        assert mi.has_flag(bsdf.flags(), mi.BSDFFlags.Transmission) == transmits
        assert bsdf.component_count() == 1 + transmits


def test_disabled_components_are_absent(plugin):
    bsdf = plugin(isotropic(both=True))
    wo = mi.Vector3f([0.5, 0.5], [0, 0], [0.8, -0.8])
    for component, alive in ((0, [True, False]), (1, [False, True])):
        ctx = mi.BSDFContext(IMPORTANCE)
        ctx.component = component
        value, pdf = bsdf.eval_pdf(ctx, interaction(30), wo)
        assert (value.numpy()[0] > 0).tolist() == alive
        assert (pdf.numpy() > 0).tolist() == alive
        bs, _ = bsdf.sample(
            ctx, interaction(30), mi.Float([0.1, 0.9]), mi.Point2f(0.4, 0.6)
        )
        assert (bs.sampled_component.numpy() == component).all()


# --------------------------------------------------------------- in scenes and kernels


def test_white_sphere_vanishes_in_a_furnace(plugin):
    """In the mean of Mitsuba's own integrator, which samples light and BSDF."""
    patches = gonio.subdivision("projected:6x8")
    even = np.full((1, 1, *patches.shape), 1 / patches.n_patches)
    view = mi.ScalarTransform4f().look_at([0, 0, 4], [0] * 3, [0, 1, 0])
    film = {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}}
    bsdf = plugin(synthetic.exact(even, (0,), "projected:6x8"))
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct"},
            "sphere": {"type": "sphere", "bsdf": bsdf},
            "light": {"type": "constant"},
            "sensor": {"type": "perspective", "to_world": view, "film": film},
        }
    )
    picture = mi.render(scene, spp=256).numpy()
    noisy = picture[..., 0][np.abs(picture[..., 0] - 1) > ROUNDING]
    assert len(noisy) > 50  # the pixels of the sphere
    z = (noisy.mean() - 1) / noisy.std(ddof=1) * np.sqrt(len(noisy))
    agree(single(z))
    disagree(single(z + 0.1 / noisy.std(ddof=1) * np.sqrt(len(noisy))))


def test_in_xml(tmp_path):
    record = isotropic()
    path = saved(record, tmp_path)
    bsdf = mi.load_string(
        f"""<bsdf type="goniometric" version="3.0.0">
                <string name="filename" value="{path}"/>
            </bsdf>"""
    )
    assert "goniometric" in str(bsdf).lower()
    error = gonio.measure(bsdf, 30, collector="projected:6x8", rays=2**12).dhr
    assert abs(error[0] - record.dhr[1, 0]) <= ROUNDING


def test_a_finer_collector_is_told(tmp_path):
    """Than the record's, on either side; twin: one with its own patches is not."""
    path = saved(isotropic(), tmp_path)
    both = {"type": "goniometric", "filename": path, "back_filename": path}
    for side in ("front", "back"):
        gonio.measure(both, 30, collector="projected:6x8", rays=64, side=side)
        with pytest.warns(FinerPatchesWarning, match="30x30.* finer .* projected:6x8"):
            gonio.measure(both, 30, rays=64, side=side)


def test_another_angle_or_record_compiles_nothing(plugin):
    bsdfs = [plugin(isotropic(seed=seed)) for seed in (1, 2)]
    wo = direction(np.linspace(0.1, 1.2, 64), 1.0)
    values(bsdfs[0], wo, 20, 10)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        for bsdf in bsdfs:
            values(bsdf, wo, 50, 120)
        history = dr.kernel_history([dr.KernelType.JIT])
    assert history
    assert all(kernel["cache_hit"] for kernel in history)


@pytest.mark.parametrize("size", [1, 64])
def test_a_table_anywhere_in_memory_compiles_nothing(size):
    """Twin: as Dr.Jit takes NumPy's memory, its place decides on the kernel."""
    memory = np.arange(128, dtype=np.float32)

    def kernels(load):
        factor = dr.opaque(mi.Float, 3, 64)
        dr.kernel_history_clear()
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            for place in range(8):
                dr.eval(load(memory[place : place + size]) * factor + 0.25)
            history = dr.kernel_history([dr.KernelType.JIT])
        return {kernel["hash"] for kernel in history}

    assert len(kernels(singles)) == 1
    assert len(kernels(mi.Float)) == 2


# ------------------------------------------------------------------------- refusals


def saved(record, folder):
    path = folder / f"saved{len(list(folder.iterdir()))}.npz"
    record.save(path)
    return str(path)


@pytest.mark.parametrize(
    ("record", "message"),
    [
        (
            synthetic.record(theta_i=(20, 30), phi_i=(0, 91)),
            "each of its 2 polar angles .* whole sectors apart",
        ),
        (synthetic.record(theta_i=(20, 30), phi_i=(0, 90)), "gaps of at most 120"),
        (synthetic.record(theta_i=(30, 30), phi_i=(0, 90)), "gaps of at most 120"),
        (synthetic.record(theta_i=(30, 30), phi_i=(0, 360)), "once"),
        (synthetic.record(theta_i=(np.nan,)), "know its incident directions"),
        (synthetic.record(channels=("400nm", "500nm")), "in a spectral variant"),
        (synthetic.record(channels=("L", "R")), "one channel, R, G, B or wavelengths"),
    ],
)
def test_unfit_records_are_refused_in_a_sentence(plugin, record, message):
    with pytest.raises(RuntimeError, match=message) as error:
        plugin(record)
    assert "goniometric.filename: " in str(error.value)


def test_table_that_does_not_fit_is_refused(monkeypatch):
    monkeypatch.setattr("gonio_mi.materials.interpolation.lobes.MAX_BYTES", 1000)
    with pytest.raises(ValueError, match=r"must need at most 1e\+03 bytes, got"):
        MeasuredLobes(isotropic()).whole()


def test_missing_and_foreign_files_are_refused(tmp_path):
    (tmp_path / "foreign.npz").write_bytes(b"PK\x03\x04 nothing")
    for name, message in (
        ("none.npz", "there is no file"),
        ("foreign.npz", "cannot load"),
        ("table.txt", "must end in"),
    ):
        with pytest.raises(RuntimeError, match=message):
            mi.load_dict({"type": "goniometric", "filename": str(tmp_path / name)})
    with pytest.raises(RuntimeError, match="must name a record"):
        mi.load_dict({"type": "goniometric"})


def test_a_black_record_is_black(plugin):
    bsdf = plugin(synthetic.exact(np.zeros((1, 1, 6, 8)), (30,), "projected:6x8"))
    bs, weight = bsdf.sample(
        mi.BSDFContext(IMPORTANCE), interaction(20), mi.Float(0.5), mi.Point2f(0.5)
    )
    assert (weight.numpy() == 0).all()
    assert (bs.pdf.numpy() == 0).all()

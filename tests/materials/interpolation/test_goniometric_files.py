"""Materials of wavelengths, and of Radiance's files."""

import tracemalloc
from dataclasses import replace

import mitsuba as mi
import numpy as np
import pytest
import synthetic
from budget import agree, disagree, scores, single
from lit_points import (
    EPS,
    IMPORTANCE,
    ROUNDING,
    interaction,
    isotropic,
    patch_middles,
    values,
)

import gonio_mi as gonio
from gonio_mi import files
from gonio_mi.collector.directions import direction
from gonio_mi.collector.klems import Klems
from gonio_mi.exchange.exports import exporting, measured_export, radiance_export
from gonio_mi.exchange.formats import radiance
from gonio_mi.exchange.formats.radiance_basis import Basis
from gonio_mi.materials.interpolation import interpolated_bsdf, lobes

# Not in their order.
CHANNELS = ("500nm", "400nm", "650nm")

# Most records here are of one side, and their files say so.
pytestmark = pytest.mark.filterwarnings("ignore:the file describes light from")


def material(path, **parameters):
    return mi.load_dict({"type": "goniometric", "filename": str(path)} | parameters)


@pytest.fixture
def coarse(monkeypatch):
    """Average over fewer points of each Klems patch, and predict one record."""
    monkeypatch.setattr(interpolated_bsdf, "MAX_TRIALS", 1)
    monkeypatch.setattr(radiance_export, "POINTS_OUT", 2)
    monkeypatch.setattr(radiance_export, "POINTS_IN", 1)


# ---------------------------------------------------------------------------- memory


@pytest.mark.parametrize("ending", [".npz", ".exr"])
def test_loading_takes_the_memory_that_is_kept(tmp_path, monkeypatch, ending):
    """And two numbers a patch in double precision at most, as its flux is made.

    Twin: not where all batches of a record are read first.
    """
    monkeypatch.setattr(lobes, "N_POINTS", 2)  # 8 MiB for points, of any table
    patches, theta_i = "projected:64x64", np.linspace(0, 80, 32)
    record = synthetic.record(patches, theta_i, 0 * theta_i, n_batches=16)
    path = tmp_path / f"run{ending}"
    record.save(path)
    material(path)  # what is only made once
    beyond, kept = [], []
    for load in (files.load_added_up, files.load):
        monkeypatch.setattr(files, "load_added_up", load)
        tracemalloc.start()
        kept.append(material(path))
        now, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert now > 5 * record.tallies[0].hits.nbytes * len(record)
        beyond.append(peak - now)
    n_patches = record.tallies[0].hits.size * len(record)
    assert beyond[0] < 2 * 8 * n_patches < beyond[1]


@pytest.mark.parametrize("ending", [".npz", ".exr"])
@pytest.mark.parametrize("weights", [True, False])
def test_added_up_batches_have_the_values_of_all(tmp_path, ending, weights):
    """To the bit; twin: batches in another order do not."""
    record = synthetic.record("projected:6x8", (0, 30, 60), (0, 0, 0), n_batches=16)
    if weights:
        rng, tallies = np.random.default_rng(1), []
        for one in record.tallies:
            sums, incident = (
                a * rng.uniform(0.5, 1, a.shape) for a in (one.sums, one.incident)
            )
            tallies.append(replace(one, sums=sums, incident=incident, direct=None))
        record = replace(record, tallies=tuple(tallies))
        turned = [replace(one, sums=one.sums[::-1]) for one in tallies]
        other = replace(record, tallies=tuple(turned))
        assert not np.array_equal(other.brdf, record.brdf)
    record.save(tmp_path / f"run{ending}")
    loaded = files.load_added_up(tmp_path / f"run{ending}")
    assert [tally.n_batches for tally in loaded.tallies] == [1, 1, 1]
    np.testing.assert_array_equal(loaded.brdf, record.brdf)
    np.testing.assert_array_equal(loaded.dhr, record.dhr)
    assert loaded.ledger == record.ledger


# ----------------------------------------------------------------------- wavelengths


@pytest.mark.usefixtures("spectral")
def test_spectra_are_linear_between_wavelengths(tmp_path):
    record = isotropic(channels=CHANNELS)
    record.save(tmp_path / "run.npz")
    bsdf = material(tmp_path / "run.npz")
    wo = patch_middles(record)
    si = interaction(30)
    si.wavelengths = mi.Spectrum(380, 430, 500, 700)
    vectors = mi.Vector3f(np.ascontiguousarray(wo.T, dtype=np.float32))
    seen = bsdf.eval(mi.BSDFContext(IMPORTANCE), si, vectors).numpy().T / wo[:, 2:]
    brdf = record[1].brdf.reshape(-1, 3)[record.subdivision.patch(wo)]
    # 400, 500 and 650 nm
    ascending = brdf[:, [1, 0, 2]]
    expected = [np.interp([380, 430, 500, 700], [400, 500, 650], b) for b in ascending]
    assert (np.abs(seen - expected) <= ROUNDING * brdf.max()).all()


@pytest.mark.usefixtures("spectral")
def test_measuring_wavelengths_returns_the_record(tmp_path):
    """By integrals, and by rays in the sum of each wavelength."""
    record = isotropic(channels=CHANNELS, both=True)
    record.save(tmp_path / "run.npz")
    settings = {
        "collector": record.subdivision,
        "wavelengths": [400, 500, 650],
        "phi_i": 0,
    }
    bsdf = material(tmp_path / "run.npz")
    again = gonio.measure(bsdf, 30, estimator="quadrature", **settings)
    assert again.channels == ("400nm", "500nm", "650nm")
    expected = record.flux_fraction[1][..., [1, 0, 2]]
    errors = np.stack([again.brdf_std_err, again.btdf_std_err])
    tolerated = ROUNDING * expected
    tolerated += errors * record.subdivision.projected_solid_angles[..., None]
    # what single precision displaces over a border of the largest patch
    tolerated += EPS * expected.max() * record.subdivision.n_patches
    assert (np.abs(again.flux_fraction - expected) <= tolerated).all()

    settings |= {"collector": "projected:1x1", "sampler": "independent", "batches": 32}
    sampled = gonio.measure(bsdf, 30, rays=2**18, **settings)
    for channel in range(3):
        total = expected[0, ..., channel].sum().reshape(1, 1)
        agree(single(scores(sampled, total, 0, channel)[0]))
        disagree(single(scores(sampled, 1.02 * total, 0, channel)[0]))


@pytest.mark.usefixtures("rgb")
def test_several_wavelengths_need_a_spectral_variant(tmp_path):
    isotropic(channels=CHANNELS).save(tmp_path / "run.npz")
    with pytest.raises(RuntimeError, match="must be used in a spectral variant, got"):
        material(tmp_path / "run.npz")


@pytest.mark.usefixtures("variant")
def test_one_wavelength_fits_any_variant(tmp_path):
    record = isotropic(channels=("550nm",))
    record.save(tmp_path / "run.npz")
    wo = patch_middles(record)
    seen = values(material(tmp_path / "run.npz"), wo, 30)
    brdf = record[1].brdf.reshape(-1, 1)[record.subdivision.patch(wo)]
    assert (np.abs(seen - brdf) <= ROUNDING * brdf).all()


@pytest.mark.usefixtures("spectral")
def test_measured_has_spectra(tmp_path, monkeypatch):
    """Of Mitsuba's own plugin, whose grid loses what it loses of a grey record."""
    monkeypatch.setattr(measured_export, "GRID", 32)
    monkeypatch.setattr(measured_export, "READ_BACK_RAYS", 2**14)
    grey, coloured = (
        isotropic(collector="projected:4x8", channels=channels, power=2)
        for channels in (("550nm",), CHANNELS)
    )
    lost = [
        exporting.export(record, tmp_path / f"{len(record.channels)}.bsdf")
        for record in (grey, coloured)
    ]
    # the channels of a synthetic record are one shape, times 1, 0.625 and 0.25
    for one, several in zip(*lost):
        scale = one.written / one.recorded
        # noise of what is measured again: as many rays as patches have in the mean
        noise = 4 * np.sqrt(32 / 2**14)
        assert abs(several.written / several.recorded - scale) <= noise
        assert abs(several.misplaced - one.misplaced) <= noise
    with pytest.raises(gonio.VariantError, match="needs a variant of rgb"):
        exporting.export(isotropic(), tmp_path / "grey.bsdf")


# --------------------------------------------------------------------------- Radiance


@pytest.mark.usefixtures("mono", "coarse")
def test_a_klems_file_is_a_material(tmp_path):
    """Patch by patch at the incident patches' middles, lit from either side."""
    path, rng = tmp_path / "both.xml", np.random.default_rng(3)
    blocks = {
        ("Visible", name): 0.1 + rng.random((145, 145))
        for name in radiance.DIRECTIONS.values()
    }
    with open(path, "wb") as stream:
        radiance.write(blocks, stream)
    bsdf = material(path)  # which brings its other side itself
    klems = Klems()
    wo = direction(*(angle[:, 0] for angle in klems.middles))
    for (side, hemisphere), name in radiance.DIRECTIONS.items():
        sign = 1 if side == "front" else -1
        signs = np.array([1, 1, -sign if hemisphere else sign])
        # middles of rings, at azimuths that are in the middle of their patches too
        for theta_i, phi_i in ((10, 45), (40, 15), (70, 90), (82.5, 30)):
            seen = values(bsdf, wo * signs, theta_i, phi_i, sign)[:, 0]
            column = Basis.named("klems", 0).incident_patch(theta_i, phi_i)
            expected = blocks["Visible", name][:, column]
            # neighbours that single precision mixes in: gaps of sines and azimuths
            gaps = np.sin(np.radians(82.5)) - np.sin(np.radians(70)), 15 / phi_i
            mixed = 2 * EPS * (1 / gaps[0] + 1 / gaps[1]) * expected.max()
            assert (np.abs(seen - expected) <= mixed + ROUNDING * expected).all()


@pytest.mark.usefixtures("mono")
def test_all_directions_of_an_incident_patch_have_its_column(tmp_path):
    """Between azimuths of a ring too, and of all variants of Dr.Jit's functions."""
    matrix = 0.1 + np.random.default_rng(4).random((41, 41))
    with open(tmp_path / "a.xml", "wb") as stream:
        radiance.write({("Visible", "Reflection Back"): matrix}, stream)
    bsdf, klems = material(tmp_path / "a.xml"), Klems("quarter")
    wo = direction(*(angle[:, 0] for angle in klems.middles))
    for theta_i, phi_i in ((2, 100), (18, 22), (26.9, 23), (44, 15.5), (89, 337)):
        seen = values(bsdf, wo, theta_i, phi_i)[:, 0]
        expected = matrix[:, Basis.of(matrix).incident_patch(theta_i, phi_i)]
        assert (np.abs(seen - expected) <= ROUNDING * expected).all()


@pytest.mark.usefixtures("mono")
@pytest.mark.parametrize("kind", ["file", "record"])
def test_patches_measured_again_are_the_same(tmp_path, kind):
    """What goes straight on, in patches of its own: exactly, and so is the total.

    Some rings have 8 sectors, others 12: as means of two of the neighbours' azimuths up
    to a third of the light would be in patches beside. Twin: other patches do lose it.
    """
    klems, path = Klems("quarter"), tmp_path / "slats.xml"
    straight = np.diag(np.linspace(0.2, 0.6, 41)) / klems.projected_solid_angles
    with open(path, "wb") as stream:
        radiance.write({("Visible", "Transmission Back"): straight}, stream)
    same = {"incident": "klems-quarter", "collector": "klems-quarter", "rays": 64}
    again = gonio.measure(material(path), **same)
    if kind == "record":  # whose light filled its incident patches
        again.save(tmp_path / "slats.npz")
        again = gonio.measure(material(tmp_path / "slats.npz"), **same)
    column = Basis.of(straight).incident_patch(again.theta_i, again.phi_i)
    flux = again.flux_fraction[:, 1, :, 0, 0]
    expected = np.diag(np.linspace(0.2, 0.6, 41))[:, column].T
    # seven digits of the file, and edges of patches in single precision
    assert (np.abs(flux - expected) <= 1e-6 + expected * 2 * ROUNDING).all()
    assert (np.abs(again.dht[:, 0] - expected.sum(axis=1)) <= 1e-6).all()
    turned = gonio.measure(material(path), **same | {"incident": "klems-half"})
    flux = turned.flux_fraction[:, 1, :, 0, 0]
    assert (flux.max(axis=1) < 0.9 * flux.sum(axis=1)).any()


@pytest.mark.usefixtures("rgb", "coarse")
@pytest.mark.filterwarnings("ignore:the front is not reciprocal")  # made-up lobes
def test_files_that_are_no_material_are_refused(tmp_path):
    record = isotropic()
    exporting.export(record, tmp_path / "front.xml", "klems")
    (tmp_path / "foreign.xml").write_text("<a/>")
    front = {"back_filename": str(tmp_path / "front.xml")}
    for name, parameters, message in (
        ("foreign.xml", {}, "filename: cannot load .* not a Radiance WindowElement"),
        ("front.xml", front, "back_filename: .* no light that meets its back"),
    ):
        with pytest.raises(RuntimeError, match=message):
            material(tmp_path / name, **parameters)
    with pytest.raises(RuntimeError, match=r"nothing\.xml"):
        material(tmp_path / "nothing.xml")

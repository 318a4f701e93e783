"""Files of other tools: read back, by independent readers where there are some."""

import io
import json
import struct
import warnings

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import synthetic

import gonio_mi as gonio
from gonio_mi import cli, progress
from gonio_mi.collector import subdivision
from gonio_mi.collector.directions import direction
from gonio_mi.collector.klems import Klems
from gonio_mi.errors import FileFormatError, VariantError
from gonio_mi.exchange.exports import exporting, loss, measured_export, radiance_export
from gonio_mi.exchange.formats import merl
from gonio_mi.exchange.formats.radiance import RadianceBSDF
from gonio_mi.files import tensor_file
from gonio_mi.materials import resampling
from gonio_mi.transport.collector_sphere import CollectorSphere

# Most records here are of one side, with lobes that are not reciprocal: files say so.
pytestmark = [
    pytest.mark.filterwarnings("ignore:the file describes light from"),
    pytest.mark.filterwarnings("ignore:the (front|back) is not reciprocal"),
]

EPS = float(np.finfo(np.float32).eps)

# Radiance perturbs its values by up to this, on purpose.
RADIANCE_NOISE = 3e-4


@pytest.fixture
def coarse(monkeypatch):
    """Average over fewer points of each Klems patch."""
    monkeypatch.setattr(radiance_export, "POINTS_OUT", 2)
    monkeypatch.setattr(radiance_export, "POINTS_IN", 1)


@pytest.fixture
def glossy():
    return synthetic.record(
        "projected:8x16", theta_i=(0, 30, 60), phi_i=(0, 0, 0), power=6, both=True
    )


# ---------------------------------------------------------------------------- Klems


def test_klems_sizes_and_order():
    klems = subdivision("klems")
    assert klems == Klems()
    assert str(klems) == "klems"
    assert klems.n_patches == 145
    rounding = 145 * np.finfo(float).eps
    assert abs(klems.solid_angles.sum() - 2 * np.pi) <= 2 * np.pi * rounding
    assert abs(klems.projected_solid_angles.sum() - np.pi) <= np.pi * rounding
    theta, phi = klems.middles
    assert klems.patch(direction(theta, phi))[:, 0].tolist() == list(range(145))
    points = klems.points(4)
    assert (klems.patch(points) == np.arange(145)[:, None]).all()


def test_klems_in_the_instrument(tmp_path):
    """Dr.Jit numbers the patches as NumPy does; files and sums are as of any other."""
    record = gonio.measure(
        {"type": "diffuse", "reflectance": 0.5},
        30,
        collector="klems",
        rays=2**16,
        estimator="analog",
    )
    assert record.brdf.shape == (145, 1, 1)
    assert record.counts.sum() == record.ledger.reflected
    for ending in (".npz", ".exr"):
        record.save(tmp_path / f"klems{ending}")
        assert gonio.load(tmp_path / f"klems{ending}") == record
    collector = CollectorSphere(Klems())
    wo = direction(*np.random.default_rng(3).uniform(0, 1.57, (2, 10_000)))
    index = collector.patch_index(mi.Vector3f(wo.T.astype(np.float32))).numpy()
    assert (index != Klems().patch(wo)).sum() <= 1


def test_material_of_a_klems_record():
    record = gonio.measure(
        {"type": "roughconductor", "alpha": 0.3}, (0, 40), collector="klems", rays=2**16
    )
    theta, phi = (angle[:, 0] for angle in Klems().middles)
    material = resampling.Material(record)
    seen = material.values(40, 0, direction(theta, phi))
    brdf = record.brdf[1, :, 0]
    assert (np.abs(seen - brdf) <= 32 * EPS * brdf.max()).all()


def test_other_numbers_of_points_compile_nothing():
    """Of a material that is resampled; twin: the first of them do."""
    record = synthetic.record(theta_i=(0, 30, 60), phi_i=(0,) * 3)
    material, new = resampling.Material(record), []
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for n in (40, 41):
            dr.kernel_history_clear()
            material.values(20, 10, direction(np.linspace(0.1, 1, n), 1.0))
            history = dr.kernel_history([dr.KernelType.JIT])
            new.append({one["hash"] for one in history}.difference(*new))
    assert new[0]
    assert not new[1]


@pytest.mark.usefixtures("mono")
@pytest.mark.parametrize("basis", ["klems-quarter", "tensor3"])
def test_even_light_is_not_lost_in_coarse_files(tmp_path, monkeypatch, basis):
    """Read back in patches that are finer than the file's; twin: a lobe is lost."""
    for name, fewer in (("POINTS_OUT", 4), ("POINTS_IN", 1), ("TREE_SIZES", {3: 16})):
        monkeypatch.setattr(radiance_export, name, fewer)
    path, losses = tmp_path / "a.xml", []
    asked = "projected:24x48", (0, 30, 60), (0,) * 3
    for power in (0, 300):
        record = synthetic.record(*asked, power=power, rays=10**7)
        exporting.export(record, path, basis)
        losses.append(radiance_export.read_back([record], path))
        with open(path, "rb") as stream:
            written = RadianceBSDF(stream)
        if basis == "tensor3":
            continue  # whose cells goniometric divides among rings
        points = record.subdivision.points(8)
        areas = record.subdivision.projected_solid_angles.ravel()
        for one, lost in zip(record, losses[-1]):
            at = written.values("front", 0, lost.theta_i, 0, points.reshape(-1, 3))
            own = at.reshape(len(areas), -1).mean(axis=1) * areas
            flux = one.flux_fraction[0, ..., 0].ravel()
            most = max(own.sum(), flux.sum())
            found = np.abs(own - flux).sum() / 2 / most
            # light that points miss, of which the total is corrected
            assert abs(found - lost.misplaced) <= resampling.MAX_MISSED
    noise = max(lost.noise for lost in losses[0])
    assert max(lost.misplaced for lost in losses[0]) <= 2 * noise
    assert min(lost.misplaced for lost in losses[1]) > 10 * noise


# ------------------------------------------------------------------ Mitsuba's measured


@pytest.mark.usefixtures("rgb")
def test_measured_of_a_lambertian_converges(tmp_path, monkeypatch):
    """Second order of the grid in what the stock plugin reflects."""
    errors = []
    for grid in (16, 32):
        monkeypatch.setattr(measured_export, "GRID", grid)
        monkeypatch.setattr(measured_export, "READ_BACK_RAYS", 2**18)
        losses = exporting.export(synthetic.lambertian(), tmp_path / "lambertian.bsdf")
        errors.append([abs(loss.written - 0.5) for loss in losses])
    assert len(losses) == 3
    # 4, less what the first order has left at these grids
    assert (np.array(errors[0]) > 3 * np.array(errors[1])).all()


@pytest.mark.usefixtures("rgb")
def test_measured_of_an_anisotropic_colour_converges(tmp_path, monkeypatch):
    """First order in where the light goes: a bilinear grid has no patch borders."""
    angles = [(theta, phi) for theta in (10, 50) for phi in (0, 120, 240)]
    theta_i, phi_i = zip(*angles)
    record = synthetic.record(
        "projected:4x8",
        theta_i=theta_i,
        phi_i=phi_i,
        channels=("R", "G", "B"),
        power=2,
        rays=10**6,
    )
    misplaced = []
    for grid in (8, 16):
        monkeypatch.setattr(measured_export, "GRID", grid)
        monkeypatch.setattr(measured_export, "READ_BACK_RAYS", 2**16)
        losses = exporting.export(record, tmp_path / "colour.bsdf")
        misplaced.append([loss.misplaced for loss in losses])
    assert len(losses) == 6
    assert (np.array(misplaced[0]) > 1.7 * np.array(misplaced[1])).all()


@pytest.mark.usefixtures("rgb")
def test_light_that_measured_adds_is_a_loss_and_no_warning(tmp_path, monkeypatch):
    monkeypatch.setattr(measured_export, "GRID", 16)
    monkeypatch.setattr(measured_export, "READ_BACK_RAYS", 2**14)
    metal = {"type": "roughconductor", "alpha": 0.3}
    record = gonio.measure(metal, [0, 40, 80], collector="angle:16x24", rays=2**16)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        losses = exporting.export(record, tmp_path / "metal.bsdf")
    assert max(loss.written for loss in losses) > 1.002
    assert not [one for one in caught if "energy conserving" in str(one.message)]


@pytest.mark.filterwarnings("ignore:the BSDF is not energy conserving")
@pytest.mark.usefixtures("rgb")
def test_what_measured_holds_is_what_rays_find_in_it(tmp_path, monkeypatch, capsys):
    """Mitsuba's `sample` is asked in the end where points of patches do not suffice.

    Twin: light of the record turned by a sector.
    """
    metal = {"type": "roughconductor", "alpha_u": 0.3, "alpha_v": 0.2}
    angles = {"theta_i": [0, 60], "phi_i": [0, 90, 180, 270]}
    record = gonio.measure(metal, **angles, collector="projected:9x12", rays=2**14)
    monkeypatch.setattr(measured_export, "GRID", 16)
    monkeypatch.setattr(progress, "PAUSE", 0.0)
    by_points = exporting.export(record, tmp_path / "a.bsdf", progress=True)
    assert "read back" in capsys.readouterr().err
    apart = (
        measured_export.MAX_DIFFERENCE
    )  # what the points of a patch may leave unknown
    monkeypatch.setattr(measured_export, "MAX_DIFFERENCE", -1.0)
    monkeypatch.setattr(measured_export, "READ_BACK_RAYS", 2**16)
    by_rays = exporting.export(record, tmp_path / "a.bsdf")
    measured = {"type": "measured", "filename": str(tmp_path / "a.bsdf")}
    seen = gonio.measure(measured, **angles, collector="projected:9x12", rays=2**16)
    fractions = seen.flux_fraction[:, :1]
    # sums of 108 absolute errors are hardly ever twice as large as their mean
    noise = [2 * one.noise for one in loss.losses(seen, fractions)]
    for one, other, chance in zip(by_points, by_rays, noise, strict=True):
        assert abs(one.written / other.written - 1) < apart + chance
        assert abs(one.misplaced - other.misplaced) < apart + chance
    turned = loss.losses(record, np.roll(fractions, 1, axis=-2))
    for one, other, chance in zip(by_points, turned, noise, strict=True):
        assert abs(one.misplaced - other.misplaced) > apart + chance or not one.theta_i


@pytest.mark.usefixtures("rgb")
def test_a_material_at_measured_incidence_is_read_as_between():
    """To the rounding of directions in single precision; twin: a degree beside."""
    theta_i, phi_i = np.meshgrid([0, 36, 72], [0, 120, 240])
    angles = theta_i.ravel().tolist(), phi_i.ravel().tolist()
    record = synthetic.record("projected:8x16", *angles, power=6, both=True)
    material = resampling.Material(record)
    points = record.subdivision.points(2).reshape(-1, 3)
    wo = np.concatenate([points, points * [1, 1, -1]])
    for theta, phi in ((0, 120), (36, 0), (36, -120), (72, 240)):
        read = material.values(theta, phi, wo)
        moved = material.values(np.full(len(wo), theta), np.full(len(wo), phi), wo)
        same = np.isclose(read, moved, rtol=1e-4, atol=1e-5 * moved.max())
        assert same.all()
        beside = material.values(abs(theta - 1.0), phi, wo)
        assert not np.isclose(beside, moved, rtol=1e-4, atol=1e-5 * moved.max()).all()


def test_measured_needs_rgb(tmp_path):
    with pytest.raises(VariantError, match="needs a variant of rgb"):
        exporting.export(synthetic.lambertian(), tmp_path / "a.bsdf")


def test_tensor_files_agree_with_mitsubas_own(tmp_path):
    tensor_io = pytest.importorskip("mitsuba.python.tensor_io")
    fields = {
        "ramp": np.arange(12, dtype=np.float32).reshape(3, 4),
        "text": np.frombuffer(b"words", np.uint8),
        "one": np.array([1.5]),
    }
    with open(tmp_path / "ours", "wb") as stream:
        tensor_file.write(fields, stream)
    theirs = tensor_io.read(str(tmp_path / "ours"))
    tensor_io.write(str(tmp_path / "theirs"), **fields)
    with open(tmp_path / "theirs", "rb") as stream:
        ours = tensor_file.read(stream)
    for name, array in fields.items():
        assert np.array_equal(theirs[name], array)
        assert np.array_equal(ours[name], array)


def tensor_bytes(n_fields=1, kind=10, place=64, shape=(4,), version=1, cut=None):
    data = b"tensor_file\0" + bytes([version, 0]) + struct.pack("<I", n_fields)
    data += struct.pack("<H", 1) + b"a" + struct.pack("<HB", len(shape), kind)
    data += struct.pack(f"<Q{len(shape)}Q", place, *shape)
    return (data + bytes(100))[:cut]


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"PK", "truncated"),
        (b"something else", "not a tensor file"),
        (tensor_bytes(version=2), "unknown version 2.0"),
        (tensor_bytes(n_fields=2**31), "announces 2147483648 fields"),
        (tensor_bytes(kind=99), "unknown type 99"),
        (tensor_bytes(shape=(2**62, 2**62)), "does not fit into"),
        (tensor_bytes(place=2**63), "does not fit into"),
        (tensor_bytes(shape=(1,) * 40), "has 40 axes"),
        (tensor_bytes(cut=30), "truncated"),
    ],
)
def test_bad_tensor_files_are_refused(data, message):
    """Before anything of the announced size is allocated."""
    with pytest.raises(FileFormatError, match=message):
        tensor_file.read(io.BytesIO(data))


# ----------------------------------------------------------------------------- tables


def test_csv_is_what_compare_reads(tmp_path, glossy):
    losses = exporting.export(glossy, tmp_path / "run.csv")
    assert len(losses) == 6
    assert all(loss.misplaced <= np.finfo(float).eps for loss in losses)
    table = gonio.read_measured(tmp_path / "run.brdf.csv")
    assert len(table) == 3 * 128
    assert np.array_equal(table.value[:128].reshape(8, 16), glossy.brdf[0, ..., 0])
    known = np.isfinite(glossy.brdf_std_err[0, ..., 0]).ravel()
    sigma = glossy.brdf_std_err[0, ..., 0].ravel()
    assert np.array_equal(table.sigma[:128][known], sigma[known])
    assert (gonio.read_measured(tmp_path / "run.btdf.csv").theta_o > 90).all()
    middles = np.degrees(glossy.subdivision.middles[1].ravel())
    assert table.phi_o[:128].tolist() == np.round(middles, 10).tolist()
    assert f"patch means, {glossy.subdivision}" in str(table)


def astm(record):
    """Text after ASTM E1392 of a record's reflection."""
    theta, phi = (angle.ravel() for angle in record.subdivision.middles)
    lines = [f"VARS theta_i,phi_i,theta_s,phi_s,{','.join(record.channels)}"]
    for one in record:
        incident = np.radians([one.theta_i[0], one.phi_i[0]]).tolist()
        for angles, values in zip(
            np.stack([theta, phi], axis=-1).tolist(),
            one.brdf.reshape(len(theta), -1).tolist(),
        ):
            lines.append(",".join(map(repr, incident + angles + values)))
    keys = f"SEED 1\nSAMPLER independent\nNUM_POINTS {len(lines) - 1}\n"
    return keys + "\n".join(lines) + "\n"


def test_a_channel_of_an_astm_file_is_compared(tmp_path, capsys):
    three = synthetic.record(
        "projected:4x8", theta_i=(0, 30), phi_i=(0, 40), channels=("R", "G", "B")
    )
    record, path = tmp_path / "run.npz", tmp_path / "run.astm"
    three.save(record)
    path.write_text(astm(three))
    table = gonio.read_measured(path, "B")
    assert np.array_equal(table.value[32:], three.brdf[1, ..., -1].ravel())
    # degrees become radians and degrees again
    rounding = 4 * np.finfo(float).eps
    assert (np.abs(table.theta_i - np.repeat([0, 30], 32)) <= 30 * rounding).all()
    assert table.rays == {}  # of no seed that is said to be ours
    command = ["compare", str(record), str(path)]
    assert cli.main([*command, "--channel", "G"]) == 0
    assert cli.main(command) == 1
    assert "channel must be one of R, G, B" in capsys.readouterr().err
    assert cli.main(["compare", str(record), str(record), "--channel", "G"]) == 1
    assert "--channel applies to tables" in capsys.readouterr().err


def test_a_material_is_no_table(tmp_path):
    with pytest.raises(FileFormatError, match=r"goniometric:filename=.*a\.xml"):
        gonio.read_measured(tmp_path / "a.xml")


def test_netcdf_is_what_xarray_reads(tmp_path, glossy):
    xarray = pytest.importorskip("xarray")
    losses = exporting.export(glossy, tmp_path / "run.nc")
    assert all(loss.misplaced <= np.finfo(float).eps for loss in losses)
    with xarray.open_dataset(tmp_path / "run.nc", engine="scipy") as data:
        assert np.array_equal(data.bsdf.values[:, 0], glossy.brdf)
        assert np.array_equal(data.bsdf.values[:, 1], glossy.btdf)
        assert np.array_equal(data.counts.values, glossy.counts)
        assert data.bsdf.sel(hemisphere="reflection").isel(incident=1).size == 128
        assert data.theta_i.values.tolist() == [0, 30, 60]


def test_any_reader_of_hdf5_has_names_units_and_axes(tmp_path):
    """Exact, by h5py alone: nothing of the file needs xarray or us."""
    h5py = pytest.importorskip("h5py")
    pytest.importorskip("h5netcdf")
    # longer than the 64 KiB of an attribute that lies in the header of an object
    record = synthetic.record(channels=("400nm", "632.8nm")).with_settings(
        specimen="x" * 2**16
    )
    losses = exporting.export(record, tmp_path / "run.h5")
    assert all(loss.misplaced <= np.finfo(float).eps for loss in losses)
    with h5py.File(tmp_path / "run.h5") as file:
        bsdf = file["bsdf"]
        assert np.array_equal(bsdf[:, 0], record.brdf[None])
        assert np.array_equal(file["std_err"][:, 0], record.brdf_std_err[None], True)
        assert bsdf.attrs["units"] == "sr-1"
        names = [next(iter(axis.values())).name.strip("/") for axis in bsdf.dims]
        assert names == ["incident", "hemisphere", "ring", "sector", "channel"]
        assert file["channel"].asstr()[:].tolist() == ["400nm", "632.8nm"]
        assert file["theta"].attrs["units"] == "degree"
        middles = np.degrees(record.subdivision.middles[0])
        assert np.array_equal(file["theta"][:], middles)
        assert file["wavelength"][:].tolist() == [400, 632.8]
        assert json.loads(file.attrs["settings"])["specimen"] == "x" * 2**16


def test_without_h5netcdf_a_sentence(tmp_path, monkeypatch):
    from gonio_mi.files import netcdf

    pytest.importorskip("xarray")
    monkeypatch.setattr(netcdf, "find_spec", lambda _: None)
    with pytest.raises(ImportError, match=r'h5netcdf.*pip install "\.\[netcdf\]"'):
        exporting.export(synthetic.record(), tmp_path / "run.h5")
    assert not list(tmp_path.iterdir())


def test_netcdf_of_wavelengths_has_them_as_numbers():
    from gonio_mi.files import netcdf

    pytest.importorskip("xarray")
    data = netcdf.dataset(synthetic.record(channels=("400nm", "632.8nm")))
    assert data.wavelength.values.tolist() == [400, 632.8]
    assert data.wavelength.attrs == {"units": "nm"}
    nearest = data.swap_dims(channel="wavelength").sel(wavelength=630, method="nearest")
    assert np.array_equal(nearest.bsdf, data.bsdf[..., 1])
    assert "wavelength" not in netcdf.dataset(synthetic.record()).coords


def test_without_xarray_a_sentence(monkeypatch):
    from gonio_mi.files import netcdf

    monkeypatch.setitem(__import__("sys").modules, "xarray", None)
    with pytest.raises(ImportError, match=r'pip install "\.\[netcdf\]"'):
        netcdf.dataset(synthetic.record())


# ------------------------------------------------------------------------ command line


@pytest.mark.usefixtures("mono", "coarse")
def test_command_prints_what_was_lost(tmp_path, capsys, glossy, monkeypatch):
    # which tests of the command bsdf do in earnest
    back = [loss.Loss(0, 0, of, 0.5, 0, 0.5, 0.01, 0) for of in ("dhr", "dht")]
    monkeypatch.setattr(radiance_export, "read_back", lambda *_: back)
    for name, fewer in (("POINTS_OUT", 2), ("POINTS_IN", 1), ("TREE_SIZES", {3: 32})):
        monkeypatch.setattr(radiance_export, name, fewer)
    glossy.save(tmp_path / "run.npz")
    target = tmp_path / "run.xml"
    assert cli.main(["export", str(tmp_path / "run.npz"), "-o", str(target)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == str(target)
    # losses, those of the file measured back, blocks, and the finer basis
    assert len(lines) == 3 + 2 + 1 + 1
    assert "of the flux is in neighbouring patches, at worst" in lines[1]
    assert "--basis tensor3" in "".join(lines)
    finer = ["--basis", "tensor3"]
    assert (
        cli.main(["export", str(tmp_path / "run.npz"), "-o", str(target), *finer]) == 0
    )
    assert "--basis" not in capsys.readouterr().out
    target.unlink()
    words = "--every", "-o", str(target)
    assert cli.main(["export", str(tmp_path / "run.npz"), *words]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 7 + 2 + 1 + 1
    assert "of the flux is in other patches" in lines[1]
    assert target.exists()


@pytest.mark.parametrize("name", ["run.txt", "nowhere/run.csv"])
def test_command_refuses_before_it_works(tmp_path, capsys, name, glossy):
    glossy.save(tmp_path / "run.npz")
    code = cli.main(["export", str(tmp_path / "run.npz"), "-o", str(tmp_path / name)])
    assert code == 1
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_records_of_other_channels_are_refused(tmp_path):
    record = synthetic.record(channels=("a", "b"))
    with pytest.raises(ValueError, match="one channel, of R, G, B or of wavelengths"):
        exporting.export(record, tmp_path / "run.xml")


@pytest.mark.parametrize("both", [True, False])
def test_transmitted_light_that_a_file_cannot_hold_is_told(tmp_path, both, monkeypatch):
    """Twin: nothing is said where none was transmitted, or where the file holds it."""
    monkeypatch.setattr(merl, "CELLS", (9, 9, 18))
    record = synthetic.record(both=both)
    for name in ("all.csv", "reflected.binary"):
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            gonio.export(record, tmp_path / name)
        texts = [str(one.message) for one in said]
        told = [text for text in texts if "holds reflection only" in text]
        assert len(told) == (both and name.endswith(".binary"))
        if told:
            assert f"up to {record.dht.max():.2%} of the flux" in told[0]

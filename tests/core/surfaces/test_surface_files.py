"""Files of profilometers, images of heights, and what is done to them, are right."""

import io
import re
import zipfile
from pathlib import Path

import numpy as np
import pytest
import surface_files

import gonio_mi as gonio
from gonio_mi.cli import main
from gonio_mi.errors import FileFormatError, SpecimenError
from gonio_mi.surfaces import height_map_reader, height_maps
from gonio_mi.surfaces.height_maps import HeightMap
from gonio_mi.surfaces.heights import filled, gaussian_heights, without_form
from gonio_mi.surfaces.images import image_heights
from gonio_mi.surfaces.topography import Preparation, topography

# isort: split
import drjit as dr
import mitsuba as mi

REAL = Path(__file__).parents[4] / "shared" / "data"
EPS32, EPS = np.finfo(np.float32).eps, np.finfo(float).eps


@pytest.fixture(autouse=True)
def _here(monkeypatch):
    """Files are read in this process: the libraries take seconds to be imported."""
    monkeypatch.setattr(height_maps, "read_apart", height_map_reader.read)


def read(path):
    pytest.importorskip("SurfaceTopography")
    return height_maps.read_height_map(Path(path), None)


def grid(degree, n_y=30, n_x=20):
    """A polynomial of that total degree at the points of a grid, without tilt."""
    y, x = np.meshgrid(np.linspace(-1, 1, n_y), np.linspace(-1, 1, n_x), indexing="ij")
    return 3 * x**degree + 2 * x * y ** (degree - 1) - 0.5


# ------------------------------------------------------------------------------ files


def test_sur_is_read(tmp_path):
    """Rounding: the file's step and spacing are in single precision."""
    surface_files.write_sur(tmp_path / "a.sur", missing=[(1, 2)])
    found = read(tmp_path / "a.sur")
    expected = surface_files.codes() * surface_files.STEP
    expected[1, 2] = np.nan
    assert np.allclose(found.heights, expected, rtol=EPS32, atol=0, equal_nan=True)
    assert np.allclose(found.spacing, surface_files.SPACING, rtol=EPS32, atol=0)
    assert (found.unit, found.periodic, found.codes) == ("mm", False, None)
    assert "Digital Surf" in found.source


def test_x3p_is_read(tmp_path):
    """Rounding: metres in double precision."""
    surface_files.write_x3p(tmp_path / "a.x3p")
    found = read(tmp_path / "a.x3p")
    expected = surface_files.codes() * surface_files.STEP / 1000
    assert np.array_equal(found.heights, expected)
    spacing = np.array(surface_files.SPACING) / 1000
    assert np.allclose(found.spacing, spacing, rtol=4 * EPS, atol=0)
    assert found.unit == "m"


@pytest.mark.parametrize("pitch", [312.5, 312.5e-6])
def test_nms_is_in_nanometres(tmp_path, pitch):
    """Rounding; of a file in mm, as the library takes them all, the library's own."""
    surface_files.write_nms(tmp_path / "a.nms", pitch)
    found = read(tmp_path / "a.nms")
    assert found.unit == "µm"
    assert np.allclose(found.spacing, (0.3125, 0.625), rtol=4 * EPS, atol=0)
    assert (found.heights.min(), found.heights.max()) == (0, 2)


GRID = """NCOLS 3
nrows 2
xllcorner 500000.0
yllcorner -4.5
{}
NODATA_value -9999
1 2 3
4 -9999 6
"""


@pytest.mark.parametrize("cells", ["cellsize 2.0", "dx 2.0\ndy 2.0"])
def test_esri_grids_are_read(tmp_path, cells):
    """Exact: the first row is the northernmost, the largest y; NaN for no data."""
    (tmp_path / "a.asc").write_text(GRID.format(cells))
    found = read(tmp_path / "a.asc")
    assert np.array_equal(found.heights, [[4, np.nan, 6], [1, 2, 3]], equal_nan=True)
    assert (found.spacing, found.unit, found.periodic) == ((2, 2), None, False)
    assert found.source == "a.asc (ESRI ASCII grid, heights)"


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.asc", GRID.format("cellsize 2") + "7", "of 3 x 2 points .* got 7"),
        ("a.asc", GRID.format(""), "must state its cellsize"),
        ("a.stp", "ISO-10303-21;\nHEADER;\n", "it is a STEP model: export a mesh"),
        ("a.sdf", "aISO-2.0\n", "an SDF file of version 2.0 .* only 1.0 is read"),
        (
            "a.asc",
            "ncols x\n" + 3 * "1 2 3\n",
            "labels, such as ncols x, and not a grid",
        ),
    ],
)
def test_a_file_that_is_not_read_is_named(tmp_path, name, text, said):
    (tmp_path / name).write_text(text)
    with pytest.raises(FileFormatError, match=said):
        read(tmp_path / name)


@pytest.mark.skipif(not REAL.is_dir(), reason="the instruments' files are not here")
def test_files_of_instruments():
    """Against their bytes, which NumPy reads by itself; rounding of the scale."""
    found = read(REAL / "sur-2.sur")
    raw = np.frombuffer((REAL / "sur-2.sur").read_bytes()[512:], "<i4")
    raw = raw.reshape(484, 563)
    measured = np.isfinite(found.heights)
    assert np.count_nonzero(~measured) == 117
    low, high = raw[measured].min(), raw[measured].max()
    assert np.all(raw[~measured] == low - 2)
    assert (low, high) == (89120, 103880)
    assert np.allclose(found.heights[measured], raw[measured] * 1e-7, rtol=EPS32)
    found = read(REAL / "x3p-2.x3p")
    with zipfile.ZipFile(REAL / "x3p-2.x3p") as file:
        raw = np.frombuffer(file.read("bindata/data.bin"), "<f8").reshape(650, 650)
    assert np.array_equal(found.heights, raw)
    assert np.allclose(found.spacing, [1.27656509837346e-07, 3.14582113527746e-07])


@pytest.mark.parametrize(
    ("name", "content"),
    [("a.sur", b""), ("a.x3p", b"PK"), ("a.plu", b"x" * 2000), ("a.tif", b"II*\0")],
)
def test_damaged_file_is_one_sentence(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(FileFormatError, match=f"{name} cannot be read: ") as caught:
        read(tmp_path / name)
    assert "\n" not in str(caught.value)


def test_size_in_a_header_takes_no_memory(tmp_path):
    """A file of 1 kB that claims 2^31 points."""
    surface_files.write_sur(tmp_path / "a.sur")
    data = bytearray((tmp_path / "a.sur").read_bytes())
    data[108:120] = np.array([2**16, 2**15, 2**31], "<u4").tobytes()
    (tmp_path / "a.sur").write_bytes(data)
    with pytest.raises(FileFormatError, match="cannot hold the 65536 x 32768 points"):
        read(tmp_path / "a.sur")


def test_a_process_of_its_own_reads(tmp_path, monkeypatch):
    """Exact: the same heights; and if it dies, or says what is wrong, one sentence."""
    surface_files.write_sur(tmp_path / "a.sur")
    here = read(tmp_path / "a.sur")
    monkeypatch.undo()
    apart = read(tmp_path / "a.sur")
    assert np.array_equal(apart.heights, here.heights)
    assert (apart.spacing, apart.source) == (here.spacing, here.source)
    dying = tmp_path / "height_map_reader.py"
    dying.write_text("import os; os.abort()")
    monkeypatch.setattr("gonio_mi.surfaces.height_maps.__file__", str(dying))
    with pytest.raises(FileFormatError, match="its reader crashed"):
        read(tmp_path / "a.sur")


# ----------------------------------------------------------------------------- images


@pytest.fixture
def png(tmp_path):
    """16-bit image whose codes are those of a random surface, and these."""
    codes = (surface_files.codes() + 30000).astype(np.uint16)
    mi.Bitmap(codes[..., None]).write(str(tmp_path / "a.png"))
    return tmp_path / "a.png", codes


def measured(**properties):
    specimen = {"type": "heightfield", "size": 2.0, **properties}
    return gonio.measure(specimen, 30, rays=10_000).tallies


def test_codes_of_an_image_need_a_scale(png):
    """Exact: with a scale, or the range of all 16 bits, they are those heights."""
    path, codes = png
    with pytest.raises(SpecimenError, match=r"whole numbers from \d+ to .* be given"):
        measured(filename=str(path))
    with pytest.raises(SpecimenError, match=r"must be given .* range \(--range\)"):
        measured(filename=str(path), scale=1.0, range=2.0)
    expected = measured(heights=mi.TensorXf(codes * 2.0**-20))
    assert measured(filename=str(path), scale=2.0**-20) == expected
    assert measured(filename=str(path), range=65535 * 2.0**-20) == expected
    assert measured(filename=str(path), range=65535 * 2.0**-19) != expected
    with pytest.raises(SpecimenError, match="applies to images of integers"):
        measured(heights=mi.TensorXf(codes * 1.0), range=1.0)


def test_tiff_is_the_image(png, tmp_path):
    """Exact: the same codes in another format."""
    pytest.importorskip("SurfaceTopography")
    path, codes = png
    surface_files.write_tiff(tmp_path / "a.tif", codes)
    settings = {"range": 0.02, "size": 3.0}
    expected = measured(filename=str(path), **settings)
    assert measured(filename=str(tmp_path / "a.tif"), **settings) == expected


def test_an_image_needs_no_thread(tmp_path):
    """Exact: heights of an EXR file are read where Dr.Jit has one thread, and keeps it.

    Mitsuba alone waits for ever there, and who made threads in the constructor of a
    plugin would end them for whoever builds others.
    """
    path, heights = tmp_path / "a.exr", np.random.default_rng(3).random((5, 4))
    heights = heights.astype(np.float32)
    mi.Bitmap(heights[..., None]).write(str(path))
    before = dr.thread_count()
    dr.set_thread_count(1)
    try:
        found = image_heights(path)
        assert dr.thread_count() == 1
    finally:
        dr.set_thread_count(before)
    assert found.reshape(5, 4).tolist() == heights.tolist()


def test_absurd_slopes_are_warned_of(png):
    """An image of whole numbers, taken for heights; not one of sensible range."""
    specimen = {"type": "heightfield", "filename": str(png[0]), "size": 2.0}
    with pytest.warns(RuntimeWarning, match="absurdly steep, alpha .* in one unit"):
        mi.load_dict(specimen | {"scale": 1.0})
    mi.load_dict(specimen | {"range": 0.02})


def test_absurdly_flat_facets_are_warned_of():
    """2 um over 20 m: a millionth of a slope; twin: 2 um over 20 um, or over 20 mm."""
    x = np.arange(64)
    waves = np.tile(1e-6 * np.cos(2 * np.pi * x / 32), (64, 1))
    for unit in ("m", None):
        wide, *_ = topography(HeightMap(waves, "a", (20 / 63,) * 2, unit)).concerns()
        assert "absurdly flat" in wide
        of = "" if unit is None else " m"
        assert re.search(
            f"extent of 20.* x 20.*{of} and an rms height of 7.*{of}", wide
        )
        assert "give the extent by size (--size)" in wide
    for extent in (20e-3, 20e-6):
        surface = topography(HeightMap(waves, "a", (extent / 63,) * 2))
        assert not any("absurdly" in one for one in surface.concerns())


@pytest.mark.needs("analysis")
def test_nothing_is_computed_of_a_guessed_width(tmp_path, capfd):
    """What is known is printed; facets of a guess are not asked about."""
    path = tmp_path / "ramp.npy"
    np.save(path, RAMP)
    assert main(["surface", str(path)]) == 1
    out, err = capfd.readouterr()
    assert "heights   0 to 20 scene units" in out
    assert "G1" not in out
    assert "the width of ramp.npy is not known, and 2 was taken" in err
    assert err.count("\n") == 1


# ------------------------------------------------------------------------ preparation


@pytest.mark.parametrize(("form", "degree"), [("plane", 1), ("quadratic", 2)])
def test_form_is_removed(form, degree):
    """Rounding: a polynomial of its degree vanishes, and one above does not.

    Gaps change nothing. The sums have 600 terms of at most 5.5.
    """
    rounding = 600 * EPS * 5.5
    z = grid(degree)
    assert np.abs(without_form(z, form)).max() < rounding
    z[3:9, 4:8] = np.nan
    left = without_form(z, form)
    assert np.array_equal(np.isnan(left), np.isnan(z))
    assert np.nanmax(np.abs(left)) < rounding
    assert np.abs(without_form(grid(degree + 1), form)).max() > 0.1


def test_mean_and_nothing():
    z = grid(2)
    assert np.allclose(without_form(z, "mean"), z - z.mean(), rtol=0, atol=600 * EPS)
    assert without_form(z, "keep") is z


def test_gaps_are_filled():
    """Rounding: linear pieces follow a plane; the nearest point is one next to it."""
    z = grid(1)
    holes = z.copy()
    holes[5:9, 7:12] = holes[20, 3] = np.nan
    assert np.allclose(filled(holes, "linear"), z, rtol=0, atol=100 * EPS)
    nearest = filled(holes, "nearest")
    assert nearest[20, 3] in (z[19, 3], z[21, 3], z[20, 2], z[20, 4])
    assert np.array_equal(nearest[np.isfinite(holes)], z[np.isfinite(holes)])
    # a gap at the border lies beyond all triangles
    holes[:3] = np.nan
    assert np.array_equal(filled(holes, "linear")[0, :4], z[3, :4])
    with pytest.raises(ValueError, match=r"but 81 of 600 points .* --fill nearest"):
        filled(holes, "none")


def test_size_and_units():
    """Exact: the file's spacing, a size in its place, and what must not be both."""
    given = HeightMap(np.zeros((5, 9)), "a.x", (0.5, 0.25), "mm", False)
    assert topography(given).extent == (4, 1)
    assert topography(given, Preparation(size=8.0)).extent == (8, 2)
    assert topography(given, Preparation(size=8.0, size_y=1.0)).extent == (8, 1)
    assert topography(given, Preparation(periodic=True)).extent == (4.5, 1.25)
    assert topography(given, Preparation(size_y=3.0)).extent == (4, 3)
    with pytest.raises(ValueError, match=r"a.x is in mm, got nm"):
        topography(given, Preparation(unit="nm"))
    unknown = HeightMap(np.zeros((5, 9)), "a")
    assert topography(unknown, Preparation(unit="um")).unit == "um"


def test_waves_are_warned_of():
    """Facets and heights below visible light; none where they are not, or unknown."""
    x = np.arange(64)
    rough = np.tile(np.sin(2 * np.pi * x / 8), (64, 1))
    at_light = HeightMap(rough * 0.2, "a", (0.1, 0.1), "um", True)
    said = topography(at_light).concerns()
    assert any("smaller than the wavelength, 0.1 um" in one for one in said)
    # waves of 6.4 um, and a plane, have the same slopes over 0.55 um as over 0.1 um
    x = np.arange(256)
    wave, plane = np.sin(2 * np.pi * x / 64), 0.02 * x
    for heights, joined in ((wave, True), (wave, False), (plane, False)):
        fine = HeightMap(np.tile(heights, (256, 1)), "a", (0.1, 0.1), "um", joined)
        assert topography(fine).concerns() == []
    # nor has a grating any slope across, with or without a plane that was removed
    for form in ("keep", "plane"):
        grating = HeightMap(np.tile(wave, (256, 1)), "a", (0.3, 0.3), "um", False)
        assert topography(grating, Preparation(form=form)).concerns() == []
    # noise has not, however little larger than its facets the wavelength is
    noise = 0.5 * np.random.default_rng(2).standard_normal((64, 64))
    (one,) = topography(HeightMap(noise, "a", (0.5, 0.5), "um", True)).concerns()
    assert "smaller than the wavelength, 0.5 um" in one
    # waves leave exp(-(4 pi sigma / wavelength)^2) in the mirror's direction
    faint = HeightMap(rough * 0.02, "a", (1, 1), "um", True)
    share = 100 * np.exp(-((4 * np.pi * 0.02 / np.sqrt(2) / 0.55) ** 2))
    (one,) = topography(faint).concerns()
    assert f"waves would reflect {share:.3g} %" in one
    coarse = HeightMap(rough, "a", (10, 10), "um", True)
    assert topography(coarse).concerns() == []
    assert topography(HeightMap(rough * 0.01, "a", (0.1, 0.1))).concerns() == []


def test_a_width_that_nobody_told_is_warned_of():
    """Exact: 0.4 over the width of 2 that is taken, and the slope 0.1 over 4."""
    given = HeightMap(RAMP / 50, "a.npy")
    taken = {"periodic": False, "unit": "mm"}
    for height in ({}, {"size_y": 4.0}):
        surface = topography(given, Preparation(**taken, **height))
        (one,) = surface.concerns()
        assert one.startswith("the width of a.npy is not known, and 2 mm was taken")
        assert f"rms slopes {np.degrees(np.arctan(0.2)):.3g} x 0 degrees" in one
        assert surface.described.endswith("in mm; width not given, 2 mm taken")
    for known in (
        topography(given, Preparation(size=4.0, **taken)),
        topography(HeightMap(RAMP / 50, "a.sur", (0.04, 0.04)), Preparation(**taken)),
        topography(HeightMap(np.ones((9, 9)), "flat.npy")),
    ):
        assert known.concerns() == []
        assert "taken" not in known.described


def test_cells_need_not_be_square(tmp_path):
    """Exact: the mesh of a file has its extents, its unit and its heights."""
    pytest.importorskip("SurfaceTopography")
    surface_files.write_x3p(tmp_path / "a.x3p")
    z = surface_files.codes() * surface_files.STEP / 1000
    file = {"type": "heightfield", "filename": str(tmp_path / "a.x3p")}
    with pytest.warns(RuntimeWarning, match="absurdly steep"):
        shape = mi.load_dict(file)
    x, y, height = np.array(mi.traverse(shape)["vertex_positions"]).reshape(-1, 3).T
    extents = np.array([15, 11]) * surface_files.SPACING / 1000
    assert np.allclose([np.ptp(x), np.ptp(y)], extents, rtol=EPS32, atol=0)
    assert np.array_equal(height, z.astype(np.float32).ravel())


RAMP = 0.2 * np.tile(np.arange(101), (101, 1))


@pytest.fixture(params=["npy", "png"])
def ramp(tmp_path, request):
    """A plane of slope 0.2, of 101 x 101 points, and what makes it that."""
    path = tmp_path / f"ramp.{request.param}"
    if request.param == "npy":
        np.save(path, RAMP)
        return path, []
    mi.Bitmap(np.round(5 * RAMP).astype(np.uint8)[..., None]).write(str(path))
    return path, ["--scale", "0.2"]


@pytest.mark.needs("analysis")
def test_a_file_is_a_finite_specimen(ramp, capfd):
    """Exact, to the digits: over 100 mm a plane is one; twin: with a period it ends.

    101 points are 100 mm, and 100 mm / 101 apart in a period, whose step of 20 mm is
    as steep as 100 facets: a mean square slope of 0.202^2 * (100 + 100^2) / 101.
    """
    path, scale = ramp
    command = ["surface", str(path), "--size", "100", "--unit", "mm", *scale]
    command += ["--points", "1e3"]
    assert main(command) == 0
    said = capfd.readouterr().out
    assert "1 x 1 mm apart" in said
    assert "100 x 100 mm, not joined" in said
    assert f"alpha {np.sqrt(2) * 0.2:.4g} x 0\n" in said
    assert main([*command, "--period", "box"]) == 0
    said = capfd.readouterr().out
    assert "100 x 100 mm, joined" in said
    assert f"alpha {np.sqrt(2) * 0.202 * 10:.4g} x 0\n" in said


@pytest.mark.needs("analysis")
@pytest.mark.filterwarnings("ignore:the width of ramp.npy:RuntimeWarning")
def test_a_file_is_a_finite_specimen_when_it_is_measured(tmp_path, capfd):
    """Exact: as the shape that is not joined, and in a cell as the one that is."""
    path = str(tmp_path / "ramp.npy")
    np.save(path, RAMP / 50)
    shape = {"type": "heightfield", "filename": path, "bsdf": {"type": "conductor"}}
    for period in ("none", "box", (3, 3)):
        given = {"rays": 1000, "period": period}
        found = gonio.measure(path, 0, **given).tallies
        for joined in (True, False):
            other = gonio.measure(shape | {"periodic": joined}, 0, **given).tallies
            assert (found == other) == (joined == (period != "none"))
    for period in ("none", "box"):
        normals = gonio.micro_normals(path, period=period, points=1000)
        assert (normals.density > 0).sum() == (1 if period == "none" else 2)
    command = ["measure", path, "--theta-i", "0", "--rays", "1000", "--size", "2"]
    assert main(command[:-2]) == 0
    said = capfd.readouterr()
    width = "width of ramp.npy is not known, and 2 was taken"
    assert f"warning: the {width}, which makes its rms slopes 11.3 x 0" in said.err
    assert "width not given, 2 taken" in " ".join(said.out.split())
    assert main([*command, "-q", "-o", str(tmp_path / "a.npz")]) == 0
    (line,) = capfd.readouterr().err.splitlines()  # of the width nothing
    assert "rays left over the edge of the specimen" in line
    plain = gonio.load(tmp_path / "a.npz")
    # a mirror at atan(0.2) sends all light to one direction
    (ring,) = np.unique(np.nonzero(plain.counts[0])[0])
    edges = plain.subdivision.theta_edges
    assert edges[ring] <= 2 * np.arctan(0.2) < edges[ring + 1]
    assert plain.ledger.reflected == 1000 > plain.ledger.over_the_edge > 0


def archive():
    np.savez(stream := io.BytesIO(), RAMP)
    return stream.getvalue()


DAMAGED = {
    "braces": b"\x93NUMPY\x01\x00v\x00" + b"}" * 117 + b"\n",
    "brackets": b"\x93NUMPY\x01\x00v\x00" + b"(" * 117 + b"\n",
    "archive": b"PK\x03\x04",
    "empty archive": b"PK\x05\x06" + 18 * b"\0",
    "text": b"no array",
    "nothing": b"",
    "an archive of arrays": archive(),
}


@pytest.mark.parametrize("content", DAMAGED)
def test_a_damaged_array_is_a_sentence(tmp_path, content):
    path = tmp_path / "a.npy"
    path.write_bytes(DAMAGED[content])
    with pytest.raises(SpecimenError, match=r"a \.npy file or a file of a profilomet"):
        gonio.measure(path, 0)


@pytest.mark.needs("analysis")
def test_a_stack_of_arrays_is_no_map(tmp_path, capsys):
    """A third axis may have one element only."""
    path = str(tmp_path / "cube.npy")
    np.save(path, np.zeros((3, 4, 5)))
    assert main(["surface", path]) == 1
    error = capsys.readouterr().err
    assert "got an array of shape (3, 4, 5)" in error
    assert error.count("\n") == 1
    np.save(path, RAMP[..., None])
    given = height_maps.read_height_map(Path(path), None)
    assert np.array_equal(topography(given).heights, RAMP)


def test_one_command(tmp_path, capfd):
    """From a scan with tilt and gaps to a BRDF with error bars."""
    pytest.importorskip("SurfaceTopography")
    codes = surface_files.codes(40, 30) // 100 + 50 * np.arange(30)
    surface_files.write_sur(tmp_path / "scan.sur", codes, missing=[(4, 4), (7, 0)])
    scan = str(tmp_path / "scan.sur")
    command = ["measure", scan, "--theta-i", "30", "--rays", "1e5"]
    assert main(command) == 1
    assert "2 of 1200 points were not measured" in capfd.readouterr().err
    command += ["--form", "plane", "--fill", "linear", "--period", "box"]
    assert main([*command, "-o", str(tmp_path / "scan.npz")]) == 0
    said = " ".join(capfd.readouterr().out.split())
    assert "plane removed, 2 missing points filled (linear)" in said
    assert "in mm" in said
    record = gonio.load(tmp_path / "scan.npz")
    # a mirror that is joined at its borders reflects every ray
    assert record.ledger.reflected == record.ledger.emitted
    assert np.isfinite(record.brdf_std_err[record.counts[0] > 0]).all()


def test_all_orders_in_one_command(tmp_path):
    """Exact: a file for each, which add up to all rays, patch by patch."""
    command = ["measure", "heightfield:alpha=0.8,resolution=32", "--theta-i", "60"]
    command += ["--period", "box", "--rays", "1e4", "-q", "-o", str(tmp_path / "a.npz")]
    assert main([*command, "--order", "1,2,3+"]) == 0
    assert main(command) == 0
    parts = [gonio.load(tmp_path / f"a_order_{n}.npz") for n in ("1", "2", "3+")]
    assert [one.settings["order"] for one in parts] == ["1", "2", "3+"]
    whole = gonio.load(tmp_path / "a.npz")
    assert np.array_equal(sum(one.counts for one in parts), whole.counts)
    assert main([*command, "--order", "1,x"]) == 1


def test_text_is_told_from_heights_by_its_ending(tmp_path):
    """A table of measured values is no surface, whatever a reader would make of it."""
    np.savetxt(tmp_path / "a.txt", np.eye(8))
    with pytest.raises(SpecimenError, match=r"heights in text are known by .* \.asc"):
        gonio.measure(tmp_path / "a.txt", 0)


def test_a_flat_map_is_called_flat():
    """Nothing of it is a number that is none; twins: grooves, and a random surface."""
    flat = topography(HeightMap(np.zeros((9, 9)), "flat.npy"))
    assert "rms 0: the map is flat\n" in flat.summary()
    assert "nan" not in f"{flat.summary()} {flat.described}"
    assert "lengths" not in flat.summary()
    grooves = np.tile(np.sin(np.arange(32) * np.pi / 4), (32, 1))
    lines = topography(HeightMap(grooves, "grooves.npy"))
    assert " x none scene units" in lines.summary()
    assert " x none" in lines.described
    rough = gaussian_heights((32, 32), 1.0, (0.2, 0.2), 4.0)
    said = topography(HeightMap(rough, "rough.npy")).summary()
    assert "flat" not in said
    assert "none" not in said


def test_options_go_with_a_file_of_heights(capfd):
    assert main(["measure", "diffuse", "--theta-i", "0", "--form", "plane"]) == 1
    assert "--form applies to height maps, got diffuse\n" in capfd.readouterr().err
    assert main(["measure", "diffuse", "--theta-i", "0", "--bsdf", "diffuse"]) == 1
    said = capfd.readouterr().err
    assert "--bsdf applies to height maps and meshes, got diffuse\n" in said


def test_options_go_with_a_surface_in_one_word(tmp_path, capfd):
    """The record has the mirror, and the width; of nothing said the facets are matt."""
    word, path = "heightfield:alpha=0.2,resolution=16", str(tmp_path / "a.npz")
    command = ["measure", word, "--theta-i", "0", "--rays", "64", "-o", path]
    assert main([*command, "--bsdf", "conductor", "--size", "3"]) == 0
    surface = gonio.load(path).provenance.surface
    assert "with SmoothConductor" in surface
    assert "correlation_length 0.75" in surface
    assert main(command) == 0
    assert "with SmoothDiffuse" in gonio.load(path).provenance.surface
    capfd.readouterr()
    command[1] += ",size=2"
    assert main([*command, "--size", "3"]) == 1
    assert f"--size must not be given twice, got {command[1]}" in capfd.readouterr().err


def test_reader_says_what_is_wrong():
    """In its own process too, where the library's words are all there is."""
    pytest.importorskip("SurfaceTopography")
    with pytest.raises(ValueError, match="no format"):
        height_map_reader.read("absent", [])

"""Files hold a record exactly, appear whole or not at all, and are never trusted."""

import json
import os
import re
import struct
import tracemalloc
import zipfile
from dataclasses import replace

import numpy as np
import OpenEXR
import pytest
import synthetic

import gonio_mi as gonio
from gonio_mi import files
from gonio_mi.files import exr, npz
from gonio_mi.files.checks import PIECE
from gonio_mi.results.tally import Fate, Tally

NAN = float("nan")
ENDINGS = [".npz", ".exr"]
RECORDS = {
    "plain": synthetic.record(),
    "counted": synthetic.record("angle:5x7", analog=True),
    "rgb, both": synthetic.record("solid:3x4", channels=("R", "G", "B"), both=True),
    "wavelengths": synthetic.record(channels=("550nm", "380nm", "1064.5nm")),
    "same names": synthetic.record(channels=("550nm", "550nm")),
    "stack": synthetic.record(theta_i=(0, 30.1, 60), phi_i=(0, 1e-3, 359), both=True),
    "stack of one": synthetic.record(stacked=True),
    "no direction": synthetic.record(theta_i=(NAN,), phi_i=(NAN,)),
    "one patch, one batch": synthetic.record("angle:1x1", n_batches=1),
    "beyond 32 bits": synthetic.huge(),
}


@pytest.fixture(params=ENDINGS)
def ending(request):
    return request.param


def interrupted():
    """Stack whose last direction has fewer batches."""
    stack = RECORDS["stack"]
    last = stack.tallies[-1]
    sums = last.sums[:2]
    hits = sums[..., 0].sum(axis=0) // np.uint64(last.scale)  # all weights are 1
    short = Tally(hits, sums, last.incident[:2], last.fates[:2], last.scale)
    return replace(stack, tallies=(*stack.tallies[:-1], short))


def check_output(path):
    files.check_output(path, files.ENDINGS)


def saved(tmp_path, record, ending):
    path = tmp_path / f"record{ending}"
    record.save(path)
    return path


def refused(path):
    """The one sentence with which a file is refused."""
    with pytest.raises(gonio.FileFormatError) as caught:
        gonio.load(path)
    message = str(caught.value)
    assert message.startswith(f"cannot load {path}: ")
    assert "\n" not in message
    return message


# ------------------------------------------------------------------ exactness


def test_records_without_a_count_of_rays_over_the_edge(tmp_path, ending):
    """Exact: rays that were sideways in those days remain so."""
    record = synthetic.record(rays=1000).with_settings(rays=10**4)
    tally = synthetic.writeable(record.tallies[0])
    tally.fates[:, [Fate.SIDEWAYS, Fate.ABSORBED]] += np.uint64(5), np.uint64(3)
    old = replace(tally, fates=tally.fates[:, : Fate.OVER_THE_EDGE])
    path = saved(tmp_path, replace(record, tallies=(old,)), ending)
    loaded = gonio.load(path)
    assert loaded.tallies == (tally,)
    assert loaded.ledger.sideways == 5 * loaded.n_batches
    assert loaded.ledger.over_the_edge == 0


def test_writing_needs_no_second_copy(tmp_path):
    """Of a large stack's sums; twin: of one direction's, it does."""
    one, peaks = synthetic.record("projected:64x128"), []
    for n in (1, 32):
        stack = gonio.Record.stack(n * [one])
        tracemalloc.start()
        saved(tmp_path, stack, ".npz")
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    size = one.tallies[0].sums.nbytes
    assert size / 2 < peaks[0]
    assert peaks[1] < 32 / 2 * size


@pytest.mark.parametrize("name", [*RECORDS, "interrupted"])
def test_load_equals_save(tmp_path, ending, name):
    record = interrupted() if name == "interrupted" else RECORDS[name]
    loaded = gonio.load(saved(tmp_path, record, ending))
    assert loaded == record
    assert loaded.settings == record.settings
    np.testing.assert_array_equal(loaded.brdf, record.brdf)
    np.testing.assert_array_equal(loaded.brdf_std_err, record.brdf_std_err)
    assert [p.name for p in tmp_path.iterdir()] == [f"record{ending}"]


@pytest.mark.parametrize("name", ["hits", "sums", "incident", "fates"])
def test_one_more_count_is_another_record(tmp_path, ending, name):
    """Twin: equality of records sees a single unit, so the test above can fail."""
    record = gonio.load(saved(tmp_path, RECORDS["beyond 32 bits"], ending))
    tally = synthetic.writeable(record.tallies[0])
    getattr(tally, name).flat[-1] += 1
    assert replace(record, tallies=(tally,)) != RECORDS["beyond 32 bits"]


def test_same_record_same_bytes(tmp_path, ending):
    path = saved(tmp_path, RECORDS["stack"], ending)
    first = path.read_bytes()
    gonio.load(path).save(path)
    assert path.read_bytes() == first


def test_endings_ignore_case(tmp_path):
    record = RECORDS["plain"]
    assert gonio.load(saved(tmp_path, record, ".EXR")) == record


def test_text_that_is_no_unicode_is_kept(tmp_path, ending):
    """Names of specimens come from file names, which may hold any byte."""
    settings = {"specimen": "\udcff µ \x00 \n", "footprint": 0.1 + 0.2, "seed": 2**70}
    record = RECORDS["plain"].with_settings(**settings)
    assert gonio.load(saved(tmp_path, record, ending)) == record


# ------------------------------------------------------------------ writing


def test_failure_keeps_the_older_file(tmp_path, monkeypatch):
    path = saved(tmp_path, RECORDS["plain"], ".npz")
    before = path.read_bytes()

    def fail(_, stream):
        stream.write(b"half a file")
        raise OSError("no space left")

    monkeypatch.setattr(npz, "write", fail)
    with pytest.raises(OSError, match="no space left"):
        RECORDS["stack"].save(path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_settings_that_are_not_json_leave_nothing(tmp_path, ending):
    record = synthetic.telling(RECORDS["plain"], specimen=object())
    with pytest.raises(TypeError):
        record.save(tmp_path / f"record{ending}")
    assert list(tmp_path.iterdir()) == []


def test_a_link_is_written_through(tmp_path, ending):
    target, link = tmp_path / f"target{ending}", tmp_path / f"link{ending}"
    link.symlink_to(target)
    RECORDS["plain"].save(link)
    assert link.is_symlink()
    assert gonio.load(target) == RECORDS["plain"]


@pytest.mark.parametrize("name", ["map.tif", "map", "map.exr.gz", ".exr"])
@pytest.mark.parametrize("function", [check_output, RECORDS["plain"].save, gonio.load])
def test_unknown_ending(tmp_path, function, name):
    with pytest.raises(ValueError, match=r"end in \.exr or \.npz, got '.*map|\.exr'"):
        function(tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_check_output_accepts_and_leaves_no_trace(tmp_path, ending):
    check_output(tmp_path / f"new{ending}")
    assert list(tmp_path.iterdir()) == []
    path = saved(tmp_path, RECORDS["plain"], ending)
    before = path.read_bytes()
    check_output(path)
    assert path.read_bytes() == before


def test_check_output_refuses_places(tmp_path, monkeypatch, ending):
    with pytest.raises(FileNotFoundError, match=r"there is no folder .*absent"):
        check_output(tmp_path / "absent" / f"map{ending}")
    folder = tmp_path / f"folder{ending}"
    folder.mkdir()
    with pytest.raises(IsADirectoryError, match="is a folder, not a file"):
        check_output(folder)
    path = saved(tmp_path, RECORDS["plain"], ending)
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may write everywhere
    with pytest.raises(PermissionError, match="write-protected"):
        check_output(path)


def test_check_output_refuses_a_folder_without_permission(tmp_path, monkeypatch):
    def touch(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(type(tmp_path), "touch", touch)
    with pytest.raises(
        PermissionError, match="cannot be written to: Permission denied"
    ):
        check_output(tmp_path / "map.exr")


# ------------------------------------------------------------------ damaged files


def test_missing_file(tmp_path, ending):
    with pytest.raises(FileNotFoundError, match=r"there is no file .*absent"):
        gonio.load(tmp_path / f"absent{ending}")


def test_truncated(tmp_path, ending, capfd):
    """One sentence, to which the EXR library would add lines on standard error."""
    path = saved(tmp_path, RECORDS["stack"], ending)
    data = path.read_bytes()
    n = len(data)
    for length in [0, 1, 7, 100, n // 3, n // 2, n - 10_000, n - 100, n - 1]:
        path.write_bytes(data[:length])
        assert "truncated" in refused(path) or length < n // 3
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("part", "direction"), [("brdf", 0), ("btdf", 2), ("tally", 2)]
)
def test_one_more_count_does_not_agree_with_the_check_sum(tmp_path, part, direction):
    path = saved(tmp_path, RECORDS["stack"], ".exr")
    image = OpenEXR.File(str(path), separate_channels=True)
    (one,) = [p for p in image.parts if p.name() == f"{part}.{direction}"]
    layer = "sum.Y" if part == "tally" else "count"
    one.channels[layer].pixels[-1, -1] += 1
    OpenEXR.File(image.parts).write(str(path))
    assert "ends in no check sum" in refused(path)
    synthetic.seal_again(path)
    assert "check sum" in refused(path)


# ------------------------------------------------------------------ foreign files


@pytest.mark.parametrize("content", [b"", b"hello\n", b"\x89PNG\r\n\x1a\n" + bytes(99)])
def test_other_content(tmp_path, ending, content):
    path = tmp_path / f"other{ending}"
    path.write_bytes(content)
    refused(path)


def test_the_other_format(tmp_path):
    path = saved(tmp_path, RECORDS["plain"], ".npz").rename(tmp_path / "map.exr")
    assert "not an OpenEXR file" in refused(path)
    path = saved(tmp_path, RECORDS["plain"], ".exr").rename(tmp_path / "run.npz")
    assert "not a zip file" in refused(path)


def test_foreign_archives_and_images(tmp_path):
    path = tmp_path / "other.npz"
    np.savez(path, a=np.zeros(3))
    assert "not written by gonio-mi" in refused(path)
    path = tmp_path / "other.exr"
    pixels = {"Y": np.zeros((4, 4), np.float32)}
    for parts in (
        [OpenEXR.Part({}, pixels)],
        [OpenEXR.Part({}, dict(pixels), "a"), OpenEXR.Part({}, dict(pixels), "b")],
    ):
        OpenEXR.File(parts).write(str(path))
        assert "not written by gonio-mi" in refused(path)


def rewritten_npz(tmp_path, **changes):
    """File of a good record, some of whose arrays are replaced, or None to drop."""
    path = saved(tmp_path, RECORDS["plain"], ".npz")
    with np.load(path) as archive:
        arrays = dict(archive) | changes
    arrays = {name: array for name, array in arrays.items() if array is not None}
    np.savez(path, **arrays)
    synthetic.seal_again(path)
    return path


def rewritten_exr(tmp_path, **changes):
    """File of a good record, some entries of whose description are replaced."""
    path = saved(tmp_path, RECORDS["plain"], ".exr")
    parts = OpenEXR.File(str(path), separate_channels=True).parts
    header = json.loads(parts[0].header["gonio.record"]) | changes
    parts[0].header["gonio.record"] = json.dumps(header)
    OpenEXR.File(parts).write(str(path))
    synthetic.seal_again(path)
    return path


def test_tiled_images_are_read(tmp_path):
    """However the library that writes them lays out the parts."""
    path = saved(tmp_path, RECORDS["plain"], ".exr")
    parts = OpenEXR.File(str(path), separate_channels=True).parts
    for part in parts:
        part.header["type"] = OpenEXR.tiledimage
        part.header["tiles"] = OpenEXR.TileDescription()
    OpenEXR.File(parts).write(str(path))
    synthetic.seal_again(path)
    assert gonio.load(path) == RECORDS["plain"]


def test_a_direction_without_batches_is_refused(tmp_path):
    none = {name: getattr(TALLY, name)[:0] for name in ("sums", "incident", "fates")}
    path = rewritten_npz(tmp_path, n_batches=np.array([0]), **none)
    assert "numbers of batches" in refused(path)


def test_rewriting_alone_changes_nothing(tmp_path):
    assert gonio.load(rewritten_npz(tmp_path)) == RECORDS["plain"]
    assert gonio.load(rewritten_exr(tmp_path)) == RECORDS["plain"]


@pytest.mark.parametrize("rewritten", [rewritten_npz, rewritten_exr])
def test_other_versions(tmp_path, rewritten):
    message = refused(rewritten(tmp_path, version=7))
    assert "version 7" in message
    assert "newer gonio-mi" in message
    assert "version 0" in refused(rewritten(tmp_path, version=0))
    assert "not written by gonio-mi" in refused(rewritten(tmp_path, format="other"))


class Pickled:
    """Object whose unpickling leaves a trace."""

    def __init__(self, trace):
        self.trace = str(trace)

    def __reduce__(self):
        return open, (self.trace, "w")


@pytest.mark.parametrize("name", ["settings", "hits", "theta_i"])
def test_pickles_are_never_loaded(tmp_path, name):
    trace = tmp_path / "executed"
    path = rewritten_npz(tmp_path, **{name: np.array(Pickled(trace), dtype=object)})
    assert f"its array {name} is object" in refused(path)
    assert not trace.exists()


TALLY = RECORDS["plain"].tallies[0]


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("hits", None, "not those of a record"),
        ("hits", TALLY.hits.astype(float)[None], "float64"),
        ("hits", TALLY.hits, "4 axes"),
        ("hits", TALLY.hits[None, :, :-1], r"hits of shape \(1, 1, 5, 8\)"),
        ("sums", TALLY.sums[:, :0], "sums"),
        ("sums", TALLY.sums.astype(">u8"), "sums is >u8"),
        ("fates", TALLY.fates[:, :-2], "fates"),
        ("fates", TALLY.fates[:-1], "fates"),
        ("n_batches", np.array([2, 2]), "hits"),
        ("n_batches", np.array([-4]), "batches"),
        ("scales", np.array([0]), "scale 0"),
        ("scales", np.array([1, 1]), "2 scales"),
        ("theta_i", np.array([30.0, 40.0]), "theta_i"),
        ("theta_i", np.array([np.inf]), "theta_i"),
        ("theta_i", np.array([1 + 1j]), "complex"),
        ("channels", np.array(["R", "G"]), "sums"),
        ("channels", np.zeros(0, "U1"), "sums"),
        ("subdivision", "klems:9x9", "klems"),
        ("subdivision", "angle:6x9", "hits"),
        ("subdivision", "angle:4096x4096", "hits"),
        ("settings", "[1, 2", "not JSON"),
        ("settings", "[1, 2]", "settings"),
        ("settings", "[" * 100_000, "not JSON"),
        ("stacked", 1, "stacked is int64"),
    ],
)
def test_arrays_that_do_not_fit(tmp_path, name, value, reason):
    assert re.search(reason, refused(rewritten_npz(tmp_path, **{name: value})))


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("subdivision", "angle:4096x4096", "count"),
        ("subdivision", 5, "subdivision 5 is unknown"),
        ("channels", "Y", "not a list"),
        ("channels", ["R"], "missing"),
        ("channels", [1], "not a list"),
        ("theta_i", [30], "theta_i"),
        ("theta_i", [True], "theta_i"),
        ("theta_i", [31.0], "check sum"),
        ("phi_i", None, "phi_i"),
        ("stacked", None, "stacked"),
        ("stacked", True, "check sum"),
        ("settings", [], "settings"),
        ("scales", ["1"], "scales"),
        ("fates", [[[1] * 9]] * 2, "directions"),
        ("fates", [[[1] * 9]], "sum"),
        ("fates", [[[-1] * 9] * 4], "fates"),
        ("fates", [[[0.5] * 9] * 4], "fates"),
        ("fates", [[[2**64] * 9] * 4], "fates"),
        ("fates", {}, "fates"),
        ("incident", [[[2**20]] * 4], "check sum"),
    ],
)
def test_descriptions_that_do_not_fit(tmp_path, name, value, reason):
    assert reason in refused(rewritten_exr(tmp_path, **{name: value}))


# ------------------------------------------------------------------ absurd sizes


def test_npy_header_larger_than_its_content(tmp_path):
    path = saved(tmp_path, RECORDS["plain"], ".npz")
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    header = b"'shape': (1, 1, 6, 8), }"
    huge = b"'shape': (1, 1, 6, 8" + b"0" * 12 + b"), }"
    assert header in members["hits.npy"]
    grown = members["hits.npy"].replace(header + b" " * 12, huge)
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, grown if name == "hits.npy" else content)
    synthetic.seal_again(path)
    assert "does not fill" in refused(path)


def test_zip_directory_larger_than_the_file(tmp_path):
    path = rewritten_npz(tmp_path)
    data = bytearray(path.read_bytes())
    size_at = data.index(b"PK\x01\x02") + 24
    data[size_at : size_at + 4] = struct.pack("<I", 2**32 - 2)
    path.write_bytes(data)
    synthetic.seal_again(path)
    assert "more than" in refused(path)


@pytest.mark.parametrize("size", [(10**5, 10**5), (7, 10**9), (2**31 - 2, 2**31 - 2)])
def test_exr_window_larger_than_the_file(tmp_path, size):
    path = saved(tmp_path, RECORDS["plain"], ".exr")
    data = path.read_bytes()
    at = data.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
    window = struct.pack("<4i", 0, 0, *size)
    path.write_bytes(data[:at] + window + data[at + 16 :])
    refused(path)


# ------------------------------------------------------------------ what others see


def parts_of(path):
    image = OpenEXR.File(str(path), separate_channels=True)
    return {part.name(): part for part in image.parts}


def test_parts_and_layers(tmp_path):
    record = RECORDS["rgb, both"]
    parts = parts_of(saved(tmp_path, record, ".exr"))
    assert list(parts) == ["brdf", "btdf", "view", "tally"]
    for name, hemisphere in (("brdf", 0), ("btdf", 1)):
        layers = parts[name].channels
        value, std_err = getattr(record, name), getattr(record, f"{name}_std_err")
        for number, channel in enumerate("RGB"):
            # exact: float32 is the nearest to the float64 value
            for layer, expected in ((name, value), ("std_err", std_err)):
                np.testing.assert_array_equal(
                    layers[f"{layer}.{channel}"].pixels,
                    expected[..., number].astype(np.float32),
                )
        np.testing.assert_array_equal(layers["count"].pixels, record.counts[hemisphere])
        assert layers["count"].pixels.dtype == np.uint32
        assert set(layers) == {
            *(f"{layer}.{c}" for layer in (name, "std_err") for c in "RGB"),
            "count",
        }


def test_parts_of_a_stack_sort_by_number(tmp_path):
    record = synthetic.record("angle:2x2", theta_i=range(11), phi_i=[0] * 11)
    names = list(parts_of(saved(tmp_path, record, ".exr")))
    assert names[:4] == ["brdf.00", "view.00", "tally.00", "brdf.01"]
    numbers = [name for name in names if name.startswith("brdf")]
    assert len(numbers) == 11
    assert numbers == sorted(numbers)


def test_header_for_people(tmp_path):
    record = RECORDS["stack"]
    parts = parts_of(saved(tmp_path, record, ".exr"))
    header = parts["brdf.1"].header
    assert header["gonio.theta_i_deg"] == np.float32(30.1)
    assert header["gonio.collector"] == "projected:6x8"
    assert header["gonio.units"] == "1/sr"
    assert header["gonio.estimator"] == "weighted"
    assert header["gonio.sampler"] == "independent"
    assert header["gonio.seed"] == "1"
    assert header["gonio.ledger.emitted"] == str(record[1].ledger.emitted)
    assert json.loads(header["gonio.versions"]) == record.settings["versions"]
    assert "without cosine" in header["gonio.conventions"]
    for part in parts.values():
        assert part.header["gonio.meaning"]


@pytest.mark.parametrize("sector", range(4))
def test_view_is_seen_from_above(tmp_path, sector):
    """Sector k of four is quadrant k: phi = 0 to the right, counter-clockwise."""
    record = synthetic.record("projected:1x4", both=True)
    tally = synthetic.writeable(record.tallies[0])
    for hemisphere, k in ((0, sector), (1, (sector + 1) % 4)):
        tally.sums[:, hemisphere] = 0
        tally.sums[:, hemisphere, 0, k] = tally.scale
    record = replace(record, tallies=(tally,))
    layers = parts_of(saved(tmp_path, record, ".exr"))["view"].channels
    picture = {name: layers[name].pixels for name in "RGBA"}
    n = exr.VIEW_SIZE
    assert picture["A"].shape == (n, 2 * n)
    np.testing.assert_array_equal(picture["R"], picture["G"])
    np.testing.assert_array_equal(picture["R"], picture["B"])
    axis = np.arange(n) + 0.5 - n / 2
    right, up = np.meshgrid(axis, -axis)
    disk = right**2 + up**2 < (n / 2) ** 2
    quadrants = [right > 0, right < 0, right < 0, right > 0]
    halves = [up > 0, up > 0, up < 0, up < 0]
    for picture_half, k, values in (
        (slice(None, n), sector, record.brdf),
        (slice(n, None), (sector + 1) % 4, record.btdf),
    ):
        lit = disk & quadrants[k] & halves[k]
        expected = np.where(lit, values.max().astype(np.float32), 0)
        np.testing.assert_array_equal(picture["R"][:, picture_half], expected)
        np.testing.assert_array_equal(picture["A"][:, picture_half], disk)


@pytest.mark.parametrize(
    ("channels", "names"),
    [
        (["Y"], ["Y"]),
        (["R", "G", "B"], ["R", "G", "B"]),
        (["550nm", "1064.5nm"], ["0550,0nm", "1064,5nm"]),
        (["380nm", "1000.25nm", "550.5nm"], ["0380,00nm", "1000,25nm", "0550,50nm"]),
        (["550nm", "550nm"], ["0_550nm", "1_550nm"]),
        (["a.b"], ["a,b"]),
    ],
)
def test_layer_names(channels, names):
    assert exr.layer_names(channels) == names


def test_wavelengths_sort_as_numbers():
    nm = [100.0, 99.5, 380.0, 1064.5, 10000.0, 550.25]
    names = exr.layer_names([f"{x:g}nm" for x in nm])
    assert [nm[i] for i in np.argsort(names)] == sorted(nm)


def test_mitsuba_reads_the_map(tmp_path):
    import mitsuba as mi

    record = RECORDS["wavelengths"]
    bitmap = mi.Bitmap(str(saved(tmp_path, record, ".exr")))
    names = [field.name for field in bitmap.struct_()]
    pixels = np.array(bitmap)
    layers = exr.pixels(record)["brdf"]
    assert sorted(names) == sorted(layers)
    for number, name in enumerate(names):
        np.testing.assert_array_equal(pixels[..., number], layers[name])


def test_openimageio_reads_every_layer(tmp_path):
    oiio = pytest.importorskip("OpenImageIO")
    record = RECORDS["stack"]
    image = oiio.ImageInput.open(str(saved(tmp_path, record, ".exr")))
    expected = [layers for i in range(3) for layers in exr.pixels(record[i]).values()]
    for subimage, layers in enumerate(expected):
        assert image.seek_subimage(subimage, 0)
        spec = image.spec()
        assert sorted(spec.channelnames) == sorted(layers)
        for number, name in enumerate(spec.channelnames):
            kind = spec.channelformats[number] if spec.channelformats else spec.format
            pixels = image.read_image(subimage, 0, number, number + 1, kind)
            assert pixels.dtype == layers[name].dtype
            np.testing.assert_array_equal(pixels[..., 0], layers[name])
    image.close()


def even_stack(n):
    """Stack of `n` incident directions with the same sums in 16 batches."""
    rng = np.random.default_rng(1)
    sums = rng.integers(0, 2**20, (16, 1, 30, 30, 1)).astype(float)
    hits = np.full((1, 30, 30), 16, np.uint64)
    fates = np.zeros((16, len(Fate)), np.uint64)
    fates[:, Fate.REFLECTED] = 900
    incident = np.full((16, 1), 2.0**30)
    tally = Tally(hits, sums, incident, fates, scale=2**24)
    return replace(
        RECORDS["plain"],
        subdivision=gonio.EqualProjectedSolidAngle(30, 30),
        theta_i=np.linspace(0, 80, n),
        phi_i=np.zeros(n),
        channels=("Y",),
        tallies=(tally,) * n,
        stacked=True,
    )


@pytest.mark.parametrize("ending", [".npz", ".exr"])
def test_loading_takes_the_memory_that_is_kept(tmp_path, ending):
    """Up to a fifth more, and what is read at once; pictures alone are 30 times it."""
    stack = even_stack(24)
    path = saved(tmp_path, stack, ending)
    tracemalloc.start()
    loaded = gonio.load(path)
    kept, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert loaded == stack
    assert kept > sum(tally.sums.nbytes for tally in stack.tallies)
    assert most < 1.2 * kept + PIECE


@pytest.mark.parametrize("load", [gonio.load, files.load_added_up])
def test_memory_is_asked_for_what_is_kept(tmp_path, monkeypatch, load):
    """At least that of the arrays, and headers of a tenth; hits do not shrink."""
    path, asked = saved(tmp_path, even_stack(4), ".npz"), []
    monkeypatch.setattr(npz, "check_memory", lambda _, needed, __: asked.append(needed))
    tallies = load(path).tallies
    arrays = [getattr(one, name) for one in tallies for name in one.arrays]
    kept = sum(array.nbytes for array in arrays)
    assert kept <= asked[0] < 1.1 * kept


def test_the_patches_fill_their_display_window(tmp_path):
    """Which OpenEXR wants to be one for all parts."""
    record = synthetic.record()
    record.save(tmp_path / "map.exr")
    patches = OpenEXR.File(str(tmp_path / "map.exr")).parts[0].header
    n_theta, n_phi = record.subdivision.shape
    for window in ("displayWindow", "dataWindow"):
        assert np.array_equal(patches[window], [[0, 0], [n_phi - 1, n_theta - 1]])

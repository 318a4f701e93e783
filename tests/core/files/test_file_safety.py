"""What files must not do: lose a stream, fill the memory, contradict themselves.

Each test fails on the code before it was written, unless it says what its twin is.
"""

import errno
import os
import stat
import subprocess
import sys
import threading
import time
import zipfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import fuzz
import mitsuba as mi
import numpy as np
import OpenEXR
import pytest
import synthetic

import gonio_mi as gonio
from gonio_mi import cli, files
from gonio_mi.collector import subdivision
from gonio_mi.errors import FileFormatError, printable, shortened, shown
from gonio_mi.files import checks, npz, tensor_file, writing
from gonio_mi.results.summary import summarize
from gonio_mi.results.summary_text import summary_text
from gonio_mi.results.tally import Fate, Integrals
from gonio_mi.specimen.loading import load_specimen

RECORD = synthetic.record(channels=("R", "G", "B"), both=True)
POSIX = pytest.mark.skipif(os.name != "posix", reason="needs POSIX")


@pytest.fixture(params=[".npz", ".exr"])
def path(request, tmp_path):
    path = tmp_path / f"record{request.param}"
    RECORD.save(path)
    return path


def refused(path):
    with pytest.raises(FileFormatError) as caught:
        gonio.load(path)
    assert fuzz.bad_sentence(caught.value) is None
    return str(caught.value)


# --------------------------------------------------------------------------- check sum


def test_a_file_without_a_check_sum_is_refused(path):
    """Whether it was cut there or is another program's, nothing of it is read."""
    path.write_bytes(path.read_bytes()[: -checks.SEAL_LENGTH])
    assert "ends in no check sum" in refused(path)
    synthetic.seal_again(path)
    assert gonio.load(path) == RECORD


def test_every_flipped_bit_is_found(path):
    data = path.read_bytes()
    places = [*range(0, len(data), len(data) // 300), len(data) - 1]
    for place in places:
        damaged = bytearray(data)
        damaged[place] ^= 4
        path.write_bytes(damaged)
        assert "check sum" in refused(path) or place < 4


def test_another_subdivision_of_the_same_shape(tmp_path):
    """Rewritten by hand: the patches are not those that the settings name."""
    other = replace(RECORD, subdivision=subdivision("angle:6x8"))
    other = synthetic.telling(other, collector=str(RECORD.subdivision))
    other.save(tmp_path / "other.npz")
    assert "its setting collector" in refused(tmp_path / "other.npz")


def test_a_flipped_bit_in_the_name_of_a_member(tmp_path):
    """Errors of a quadrature record were dropped in silence."""
    base = synthetic.record()
    sampled = base.tallies[0]
    arrays = {name: getattr(sampled, name) for name in sampled.arrays}
    errors = np.ones((1, 6, 8, 1), np.uint64)
    tally = Integrals(**arrays, scale=sampled.scale, errors=errors)
    record = replace(base, tallies=(tally,)).with_settings(estimator="quadrature")
    path = tmp_path / "record.npz"
    record.save(path)
    assert gonio.load(path) == record
    data = path.read_bytes()
    assert data.count(b"errors.npy") == 2
    path.write_bytes(data.replace(b"errors.npy", b"erros\x72.npy"))
    synthetic.seal_again(path)
    assert "its arrays are not those of a record" in refused(path)


# ------------------------------------------------------------------ impossible numbers


def tampered(**changes):
    """Record whose one tally has other arrays."""
    tally = replace(RECORD.tallies[0], **changes)
    return replace(RECORD, tallies=(tally,))


def one_more(name, place):
    array = getattr(RECORD.tallies[0], name).copy()
    array[place] += np.uint64(1)
    return {name: array}


T = RECORD.tallies[0]
EMPTY = {"hits": T.hits * np.uint64(0), "fates": T.fates * np.uint64(0)}
EMPTY["fates"][:, Fate.ABSORBED] = 5


@pytest.mark.parametrize(
    ("record", "reason"),
    [
        (replace(RECORD, theta_i=np.array([91.0])), "theta_i is 91"),
        (replace(RECORD, theta_i=np.array([400.0])), "theta_i is 400"),
        (replace(RECORD, theta_i=np.array([1e300])), "theta_i is 1e"),
        (replace(RECORD, theta_i=np.array([-1.0])), "theta_i is -1"),
        (replace(RECORD, phi_i=np.array([1e300])), "phi_i is 1e"),
        (tampered(incident=T.incident * np.uint64(0)), "incident power of 0"),
        (tampered(**one_more("hits", (0, 0, 0))), "its ledger says"),
        (tampered(**one_more("hits", (1, 5, 7))), "its ledger says"),
        (tampered(**one_more("fates", (0, Fate.REFLECTED))), "its ledger says"),
        (tampered(**one_more("fates", (3, Fate.MISSED))), "asked for"),
        (tampered(sums=T.sums | np.uint64(2**63)), "more than 64 bits"),
        (tampered(**EMPTY), "without a hit received light"),
    ],
)
def test_impossible_numbers_are_refused(tmp_path, record, reason):
    record.save(tmp_path / "record.npz")
    assert reason in refused(tmp_path / "record.npz")


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("passes", -1),
        ("passes", 0),
        ("passes", "1"),
        ("passes", True),
        ("specimen", 5),
        ("specimen", ["a"]),
        ("surface", {"a": 1}),
        ("versions", "1.0"),
        ("versions", {"a": 1}),
        ("versions", [1]),
        ("estimator", "other"),
        ("estimator", "quadrature"),
        ("rays", -1),
        ("rel_err", "x"),
        ("collector_radius", float("nan")),
        ("collector", "projected:6x9"),
        ("side", "left"),
        ("seed", "one"),
    ],
)
def test_settings_of_another_kind_are_refused(path, key, value):
    synthetic.telling(RECORD, **{key: value}).save(path)
    assert f"{key}" in refused(path)
    assert cli.main(["show", str(path)]) == cli.USER_ERROR


@pytest.mark.parametrize("angle", ["theta_i", "phi_i"])
def test_parallel_light_from_nowhere_is_refused(path, angle):
    """Only of an environment no direction is known."""
    nowhere = replace(RECORD, **{angle: np.array([np.nan])})
    nowhere.with_provenance(emitter="ConstantBackgroundEmitter").save(path)
    assert np.isnan(getattr(gonio.load(path), angle)).all()
    nowhere.with_provenance(emitter="DirectionalEmitter").save(path)
    assert "its incident direction is NaN" in refused(path)


def test_a_name_of_any_length_is_told_in_short(path, capsys):
    """Exact: at most ten thousand characters of nine million, and their line breaks."""
    RECORD.with_settings(specimen="a b, c=1 " * 1_000_000).save(path)
    assert cli.main(["show", str(path)]) == 0
    assert len(capsys.readouterr().out) < 20_000


def test_a_pipe_by_the_name_of_a_temporary_file_is_left_alone(tmp_path):
    """It would wait for a writer, for ever."""
    pipe = tmp_path / f"{writing.PREFIX}a{writing.SUFFIX}"
    os.mkfifo(pipe)
    writing.remove_forgotten(tmp_path, 0)
    RECORD.save(tmp_path / "a.npz")
    assert pipe.exists()


def test_twin_the_same_record_untouched_is_read(path):
    """So that what refuses the records above is what was done to them."""
    for record in (RECORD, tampered(), replace(RECORD, theta_i=np.array([89.9]))):
        record.save(path)
        assert gonio.load(path) == record


@pytest.mark.usefixtures("rgb")
@pytest.mark.parametrize(
    ("specimen", "estimator"),
    [
        *(("dielectric", "analog"), ("dielectric", "quadrature")),
        *(("diffuse", "analog"), ("roughdielectric", "weighted")),
        *(("roughdielectric", "quadrature"), ("roughdielectric", "next_event")),
    ],
)
def test_what_is_measured_is_possible(tmp_path, estimator, specimen):
    """Records of the instrument keep what is asked of files, and files keep them."""
    settings = {"collector": "projected:4x6", "batches": 2, "estimator": estimator}
    if estimator != "quadrature":
        settings["rays"] = 2000
    record = gonio.measure(
        {"type": specimen}, (0, 60), trace=estimator == "next_event", **settings
    )
    record.save(tmp_path / "record.npz")
    assert gonio.load(tmp_path / "record.npz") == record


@pytest.mark.parametrize("hemispheres", ["upper", "both"])
def test_direct_light_is_possible(tmp_path, hemispheres):
    """What passed the openings is in a patch straight on and in a row of its own."""
    mi.set_variant("llvm_ad_mono")
    record = gonio.measure(
        str(Path(__file__).parents[3] / "scenes" / "crossed_threads.xml"),
        30,
        rays=2000,
        batches=2,
        collector="projected:4x6",
        hemispheres=hemispheres,
    )
    assert record.ledger.direct > 0
    record.save(tmp_path / "record.npz")
    assert gonio.load(tmp_path / "record.npz") == record
    tally = record.tallies[0]
    fates = tally.fates.copy()
    fates[0, [Fate.DIRECT, Fate.ABSORBED]] = fates[0, [Fate.ABSORBED, Fate.DIRECT]]
    other = replace(record, tallies=(replace(tally, fates=fates),))
    if hemispheres == "both":
        other.save(tmp_path / "record.npz")
        assert "its ledger says" in refused(tmp_path / "record.npz")


# ------------------------------------------------------------------------------ memory

PEAK = """
import resource, sys
import gonio_mi as gonio
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
try:
    gonio.load(sys.argv[1])
except ValueError as error:
    print(error)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


def peak(path):
    """What reading a file says, and the bytes that it takes besides."""
    done = subprocess.run(
        [sys.executable, "-c", PEAK, str(path)],
        capture_output=True,
        check=True,
        text=True,
    )
    *said, kib = done.stdout.splitlines()
    return "\n".join(said), int(kib) * 1024


def rewritten(path, **changes):
    """NPZ file with some other arrays, compressed."""
    with np.load(path) as archive:
        arrays = dict(archive) | changes
    np.savez_compressed(path, **arrays)
    synthetic.seal_again(path)


@pytest.mark.skipif(sys.platform != "linux", reason="peak memory in KiB")
def test_absurd_apertures_take_no_memory(tmp_path):
    """All pairs of overlapping cones took 16 bytes each: 20 000 cones, 3.2 GB."""
    path = tmp_path / "record.npz"
    synthetic.record("angle:20001x1").save(path)
    cones = ",".join(f"10/{i * 1e-3!r}" for i in range(20_000))
    rewritten(path, subdivision=f"apertures:5@{cones}")
    said, taken = peak(path)
    assert "its subdivision 'apertures:5@10/0.0" in said
    assert len(said) <= fuzz.MOST_CHARACTERS
    assert taken < fuzz.MOST_BYTES


@pytest.mark.skipif(sys.platform != "linux", reason="peak memory in KiB")
def test_a_small_file_with_large_arrays(tmp_path):
    """384 MiB of zeros in 0.4 MB, whose shape agrees with nothing."""
    path = tmp_path / "record.npz"
    RECORD.save(path)
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    shape = (1, 2, 4096, 2048, 3)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, content in members.items():
            if name != "sums.npy":
                archive.writestr(name, content)
        with archive.open("sums.npy", "w", force_zip64=True) as member:
            np.lib.format.write_array_header_1_0(
                member, {"descr": "<u8", "fortran_order": False, "shape": shape}
            )
            for _ in range(384 // 64):
                member.write(bytes(2**26))
    synthetic.seal_again(path)
    said, taken = peak(path)
    assert "its array sums of shape" in said
    assert taken < fuzz.MOST_BYTES // 4


def test_arrays_are_compared_before_they_are_read(tmp_path, monkeypatch):
    path = tmp_path / "record.npz"
    RECORD.save(path)
    rewritten(path, sums=np.zeros((4, 2, 60, 80, 3), np.uint64))
    read = []
    numbers = npz._numbers

    def noted(member, *shape_and_type):
        read.append(member.name)
        return numbers(member, *shape_and_type)

    monkeypatch.setattr(npz, "_numbers", noted)
    assert "its array sums of shape" in refused(path)
    assert "sums.npy" not in read
    assert "n_batches.npy" in read  # the twin: this is how arrays are read


# ----------------------------------------------------------------- threads and streams


def test_exr_is_read_in_threads(tmp_path, capfd):
    """The redirection of the whole process lost standard output for good."""
    path = tmp_path / "record.exr"
    RECORD.save(path)
    damaged = tmp_path / "damaged.exr"
    damaged.write_bytes(path.read_bytes()[:-3000])
    streams, numbers = (sys.stdout, sys.stderr), [os.fstat(n)[:3] for n in (1, 2)]

    def load(name):
        try:
            return gonio.load(name) == RECORD
        except FileFormatError:
            return "refused"

    with ThreadPoolExecutor(4) as executor:
        found = list(executor.map(load, [path] * 40 + [damaged] * 2))
    assert found == [True] * 40 + ["refused"] * 2
    assert (sys.stdout, sys.stderr) == streams
    assert [os.fstat(n)[:3] for n in (1, 2)] == numbers
    assert capfd.readouterr() == ("", "")


def test_the_exr_library_reads_nothing_that_is_damaged(tmp_path, capfd):
    """Twin: it prints, and gives back fewer parts, of a file that is truncated."""
    path = tmp_path / "record.exr"
    RECORD.save(path)
    path.write_bytes(path.read_bytes()[:-3000])
    n_parts = len(OpenEXR.File(str(path)).parts)
    assert n_parts < 4
    assert any(capfd.readouterr())
    assert "truncated" in refused(path)
    assert capfd.readouterr() == ("", "")


@POSIX
@pytest.mark.parametrize(
    ("words", "closed"),
    [
        ("show record.npz", "1>&-"),
        ("show absent.npz", "2>&-"),
        ("show absent.npz", "0<&- 1>&- 2>&-"),
    ],
)
def test_closed_streams(tmp_path, closed, words):
    """With standard error closed, errors went to standard output, or a file."""
    RECORD.save(tmp_path / "record.npz")
    source = "import sys; from gonio_mi.cli import main; sys.exit(main())"
    command = f'"{sys.executable}" -c "{source}" {words} {closed}'
    done = subprocess.run(
        ["sh", "-c", command], cwd=tmp_path, capture_output=True, check=False, text=True
    )
    assert done.returncode == ("absent" in words)
    assert "Traceback" not in done.stderr
    assert done.stdout == ""


class Gone:
    """A stream whose reader has left."""

    def write(self, _):
        raise BrokenPipeError(errno.EPIPE, "Broken pipe")

    def flush(self):
        pass

    def fileno(self):
        return os.open(os.devnull, os.O_WRONLY)


@POSIX
def test_a_reader_of_errors_that_has_left(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "stderr", Gone())
    assert cli.main(["show", str(tmp_path / "absent.npz")]) == cli.USER_ERROR


@POSIX
@pytest.mark.parametrize(
    "words",
    [
        "surface z.npy --size 2 --points 1e3 -o a.png",
        "fit run.npz diffuse -o a.png a.npz",
        "export run.npz -o a.csv a.nc",
        "compare run.npz diffuse --rays 1e4 -o a.png --budget a.csv",
        "measure diffuse --theta-i 0 --rays 1e4 --order 1,2+ -o a.npz",
    ],
)
def test_a_reader_that_has_left_costs_no_file(tmp_path, monkeypatch, words):
    """All of them are written before anything is printed."""
    pytest.importorskip("matplotlib")
    monkeypatch.chdir(tmp_path)
    mi.set_variant("llvm_ad_mono")
    np.save("z.npy", np.random.default_rng(1).random((8, 8)) / 100)
    gonio.measure({"type": "diffuse"}, 30, rays=10_000).save("run.npz")
    given = set(tmp_path.iterdir())
    monkeypatch.setattr(sys, "stdout", Gone())
    assert cli.main(words.split()) == cli.USER_ERROR
    written = {path.suffix for path in set(tmp_path.iterdir()) - given}
    assert written == {Path(word).suffix for word in words.split() if word[:2] == "a."}
    if "--order" in words:
        stems = {path.stem for path in tmp_path.glob("a*")}
        assert stems == {"a_order_1", "a_order_2+"}


# ----------------------------------------------------------------------------- writing


@POSIX
def test_a_pipe_is_written_through(tmp_path):
    """It was replaced by a file."""
    pipe = tmp_path / "pipe.npz"
    os.mkfifo(pipe)
    link = tmp_path / "link.npz"
    link.symlink_to(pipe)
    files.check_output(link, files.ENDINGS)
    writer = threading.Thread(target=RECORD.save, args=(link,), daemon=True)
    writer.start()
    content = pipe.read_bytes()
    writer.join(10)
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    copy = tmp_path / "copy.npz"
    copy.write_bytes(content)
    assert gonio.load(copy) == RECORD


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
@pytest.mark.parametrize("ending", files.ENDINGS)
def test_a_full_disk_is_named(tmp_path, monkeypatch, ending):
    """Nothing takes the place of a device: here not even if it should be tried.

    The EXR library itself does not report it.
    """
    monkeypatch.setattr(os, "replace", lambda *_: pytest.fail("the device would go"))
    link = tmp_path / f"link{ending}"
    link.symlink_to("/dev/full")
    with pytest.raises(OSError, match="No space left") as caught:
        RECORD.save(link)
    assert caught.value.filename == str(link)
    assert stat.S_ISCHR(os.stat("/dev/full").st_mode)


def test_a_file_of_a_full_disk_is_named(path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    before = path.read_bytes()
    with pytest.raises(OSError, match="No space left") as caught:
        RECORD.save(path)
    assert caught.value.filename == str(path)
    assert path.read_bytes() == before


@POSIX
def test_sockets_are_refused(tmp_path):
    import socket

    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(tmp_path / "s.npz"))
        for write in (RECORD.save, lambda p: files.check_output(p, files.ENDINGS)):
            with pytest.raises(OSError, match="neither a file nor a pipe"):
                write(tmp_path / "s.npz")


@POSIX
def test_permissions_are_kept(path):
    for mode in (0o600, 0o640, 0o666):
        path.chmod(mode)
        RECORD.save(path)
        assert stat.S_IMODE(path.stat().st_mode) == mode


def test_what_is_replaced_is_on_the_disk_before(path, monkeypatch):
    done = []
    monkeypatch.setattr(os, "fsync", lambda _: done.append("synced"))
    rename = os.replace
    monkeypatch.setattr(
        os, "replace", lambda *names: (done.append("named"), rename(*names))
    )
    RECORD.save(path)
    assert done[:2] == ["synced", "named"]


@POSIX
def test_what_a_kill_leaves_is_removed(tmp_path):
    """Once nobody writes it any more, and not at once; a fresh one is left alone."""
    fresh = tmp_path / ".gonio-00.partial"
    writer = files.replacing(tmp_path / "a.npz")
    stream = writer.__enter__()
    (partial,) = tmp_path.glob(".gonio-*.partial")
    long_ago = time.time() - 2 * writing.MAX_PARTIAL_AGE
    os.utime(partial, (long_ago, long_ago))
    fresh.touch()
    RECORD.save(tmp_path / "b.npz")
    assert partial.exists()  # it is locked
    stream.close()  # as the end of its process does
    RECORD.save(tmp_path / "b.npz")
    assert {*tmp_path.iterdir()} == {tmp_path / "b.npz", fresh}


@POSIX
def test_a_finished_file_is_not_taken_for_a_forgotten_one(tmp_path, monkeypatch):
    """By a campaign that ends just before it gets its name."""
    replace_file = os.replace

    def replaces(*names):
        writing.remove_forgotten(tmp_path, 0)
        replace_file(*names)

    monkeypatch.setattr(os, "replace", replaces)
    RECORD.save(tmp_path / "a.npz")
    assert gonio.load(tmp_path / "a.npz").tallies == RECORD.tallies


def test_a_folder_can_be_written_though_another_campaign_ends(tmp_path, monkeypatch):
    touch = Path.touch

    def touches(path, **ways):
        touch(path, **ways)
        writing.remove_forgotten(tmp_path, 0)
        path.unlink(missing_ok=True)  # also where files cannot be locked

    monkeypatch.setattr(Path, "touch", touches)
    files.check_output(tmp_path / "a.npz", (".npz",))
    assert not [*tmp_path.iterdir()]


# ------------------------------------------------------------------- text from others


def test_escapes_of_a_record_do_not_reach_the_terminal(tmp_path, capsys):
    settings = {"specimen": "\x1b[2Jgone\x07\u202e\udcff", "versions": {"a\x1b": "1"}}
    record = RECORD.with_settings(**settings)
    record.save(tmp_path / "record.npz")
    assert cli.main(["show", str(tmp_path / "record.npz")]) == 0
    shown_text = capsys.readouterr().out
    assert r"\x1b[2Jgone\x07\u202e\udcff" in shown_text
    assert not set(shown_text) & set("\x1b\x07\u202e\udcff")
    assert "\x1b" not in repr(record)
    assert "\x1b" in summary_text(summarize(record))  # the twin: it was there


def test_printable_keeps_what_can_be_read():
    assert printable("µ 30°\nü") == "µ 30°\nü"
    assert printable("a\r\tb\x9b") == r"a\r\tb\x9b"


@pytest.mark.parametrize("length", [1, 80, 399, 400, 401, 5134, 10**5])
def test_messages_are_short(length):
    """Exact: the limits of characters, and both ends of what is cut."""
    for text in ("x" * length, "x " * length, "\x1b" * length, f"a {'b' * length} c"):
        short = shortened(text)
        assert len(short) <= fuzz.MOST_CHARACTERS
        assert short[0] == (text[0] if text[0] != "\x1b" else "\\")
    assert len(shown("x" * length)) <= 80
    assert shortened("it is good") == "it is good"


@pytest.mark.parametrize(
    "words",
    [
        ["measure", "x" * 5000, "--theta-i", "0"],
        ["measure", "diffuse", "--collector", "y" * 5000],
        ["measure", "diffuse", "--theta-i", "9" * 5000],
        ["measure", "diffuse", "--phi-i", "9" * 400],
        ["measure", "diffuse", "-D", "z" * 5000],
        ["measure", "diffuse", "--theta-i", "0", "--trace", "--collector-radius=1e300"],
        ["show", "w" * 5000],
        ["show", "w/" * 3000 + "a.npz"],
        ["v" * 5000],
    ],
    ids=lambda words: "".join(words)[:20],
)
def test_arguments_are_not_repeated_whole(capsys, words):
    assert cli.main(words) == cli.USER_ERROR
    (line,) = capsys.readouterr().err.splitlines()
    assert len(line) <= fuzz.MOST_CHARACTERS


def test_values_are_not_repeated_whole():
    mi.set_variant("llvm_ad_mono")
    names = ("collector", "footprint", "period", "order", "rays", "estimator", "resume")
    values = [{name: "y" * 5000} for name in names]
    values += [{"collector": "apertures:" + "y" * 5000}]
    values += [{"emitter": ["y" * 5000]}, {"theta_i": 10**4000}]
    for value in values:
        with pytest.raises((TypeError, ValueError)) as caught:
            gonio.measure({"type": "diffuse"}, **({"theta_i": 0} | value))
        assert len(str(caught.value)) <= fuzz.MOST_CHARACTERS


@pytest.mark.parametrize("name", ["max_depth", "points", "batches", "collector_radius"])
def test_whole_numbers_beyond_64_bits_are_one_sentence(capfd, name):
    """Mitsuba's bindings printed lines of types that they had tried."""
    mi.set_variant("llvm_ad_mono")
    with pytest.raises(ValueError, match=name.removeprefix("collector_")):
        gonio.measure({"type": "diffuse"}, theta_i=0, **{name: 10**30})
    with pytest.raises(ValueError, match="reflectance must be below"):
        gonio.measure({"type": "diffuse", "reflectance": 10**30}, theta_i=0)
    assert capfd.readouterr() == ("", "")


# ------------------------------------------------------------------- formats of others

CSV = "# quantity: brdf\n{key}theta_i,phi_i,theta_o,phi_o,value\n45,0,30,180,{value}\n"


@pytest.mark.needs("exchange")
def test_what_a_table_cannot_hold(tmp_path):
    """Numbers that Python alone reads, absurd keys, and lines without an end."""
    path = tmp_path / "table.csv"
    path.write_text(CSV.format(key="", value="0.3"))
    assert gonio.read_measured(path).value.tolist() == [0.3]
    bad = []
    for value in ("0_3", "\u0663", "0x1p-2", "1e", "1" * 2000):
        bad.append((CSV.format(key="", value=value), "must be a number"))
    for key in ("scale_uncertainty", "uncertainty", "emitter_distance"):
        text = CSV.format(key=f"# {key}: 1e300\n", value="0.3")
        bad.append((text, f"{key} must be a finite"))
    for line in ("," * 10**6, '"' + "a" * 10**6, "a" * 10**6, "#" + "a:" * 10**6):
        bad += [(line, None), (CSV.format(key="", value=line), None)]
    for text, said in bad:
        path.write_text(text)
        with pytest.raises(FileFormatError, match=said) as caught:
            gonio.read_measured(path)
        assert fuzz.bad_sentence(caught.value) is None


@pytest.mark.needs("exchange")
@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        (b"0.25,", b"-0.25,", "negative"),
        (b"0.25,", b"0_25,", "must be a number"),
        (b"<Layer>", b"<Layer>{block}", "twice"),
    ],
)
def test_klems_files_that_contradict_themselves(tmp_path, old, new, reason):
    from gonio_mi.exchange.formats import radiance

    path = tmp_path / "klems.xml"
    blocks = {("Visible", "Reflection Back"): np.full((145, 145), 0.25)}
    with open(path, "wb") as stream:
        radiance.write(blocks, stream)
    data = path.read_bytes()
    assert old in data
    block = data[data.index(b"<WavelengthData>") : data.index(b"</Layer>")]
    path.write_bytes(data.replace(old, new.replace(b"{block}", block), 1))
    with (
        open(path, "rb") as stream,
        pytest.raises(FileFormatError, match=reason),
    ):
        radiance.read(stream)


# ---------------------------------------------------------------------- material files

FIELDS = fuzz.measured_fields()


@pytest.fixture
def material(tmp_path, rgb):
    """Writer of a file for Mitsuba's `measured`, some of whose fields are other."""
    del rgb

    def write(**changes):
        fields = {k: v for k, v in (FIELDS | changes).items() if v is not None}
        with open(tmp_path / "m.bsdf", "wb") as stream:
            tensor_file.write(fields, stream)
        return str(tmp_path / "m.bsdf")

    return write


def as_dict(name):
    return {"type": "twosided", "bsdf": {"type": "measured", "filename": name}}


def as_scene(name):
    path = Path(name).with_name("scene.xml")
    path.write_text(
        '<scene version="3.0.0"><default name="file" value="m.bsdf"/>'
        '<shape type="rectangle"><bsdf type="twosided"><bsdf type="measured">'
        '<string name="filename" value="$file"/></bsdf></bsdf></shape></scene>'
    )
    return path


def as_included(name):
    scene = as_scene(name)
    path = scene.with_name("outer.xml")
    path.write_text('<scene version="3.0.0"><include filename="scene.xml"/></scene>')
    return path


def test_the_variant_that_a_material_needs_is_named(material):
    path = material()
    mi.set_variant("llvm_ad_mono")
    with pytest.raises(gonio.SpecimenError, match=r"such as llvm_ad_\w+$") as refused:
        load_specimen(as_dict(path))
    mi.set_variant(str(refused.value).split()[-1])
    assert load_specimen(as_dict(path)).shapes()


def spectral_material(material):
    """Name of a file with data from 450 to 650 nm."""
    spectra = np.repeat(FIELDS["rgb"][:, :, :1], 2, axis=2)
    nm = np.array([450, 650], np.float32)
    return material(rgb=None, wavelengths=nm, spectra=spectra)


@pytest.mark.parametrize("form", [as_dict, as_scene, as_included])
def test_a_material_ends_with_its_wavelengths(material, form):
    """Mitsuba goes on with the last ones: 900 nm were measured as 650."""
    name = spectral_material(material)
    settings = {"theta_i": 30, "rays": 1000, "collector": "projected:3x3"}
    mi.set_variant("llvm_ad_spectral")
    inside = gonio.measure(form(name), wavelengths=[450, 550, 650], **settings)
    assert inside.channels == ("450nm", "550nm", "650nm")
    said = r"m\.bsdf covers the wavelengths from 450 to 650 nm, got 900 nm"
    with pytest.raises(gonio.SpecimenError, match=said):
        gonio.measure(form(name), wavelengths=[550, 900], **settings)


@pytest.mark.needs("analysis")
def test_a_profile_ends_with_the_wavelengths_of_a_material(material):
    """Like a measurement."""
    specimen = as_dict(spectral_material(material))
    mi.set_variant("llvm_ad_spectral")
    found = gonio.exit_profile(specimen, [0, 1], 30, wavelengths=[550], rays=1000)
    assert found.ledger.emitted == 1000
    with pytest.raises(gonio.SpecimenError, match="450 to 650 nm, got 900 nm"):
        gonio.exit_profile(specimen, [0, 1], 30, wavelengths=[550, 900], rays=1000)


BAD_FIELDS = [
    ({"ndf": None}, "its field ndf is missing"),
    ({"ndf": np.ones((1, 2), np.float32)}, "ndf of shape"),
    ({"rgb": np.ones((1, 3, 2, 4, 4), np.float32)}, "rgb of shape"),
    ({"vndf": np.ones((1, 2, 2, 2), np.float32)}, "vndf of shape"),
    ({"vndf": np.ones((1, 3, 2, 2))}, "vndf is float64"),
    ({"vndf": np.zeros((1, 3, 2, 2), np.float32)}, "is not a sampling density"),
    ({"luminance": np.full((1, 3, 4, 4), np.nan, np.float32)}, "not finite"),
    ({"theta_i": np.zeros(3, np.float32)}, "must ascend"),
    ({"jacobian": np.zeros(0, np.uint8)}, "jacobian of shape"),
]


@pytest.mark.parametrize("form", [as_dict, as_scene, as_included])
def test_bad_materials_never_reach_mitsuba(material, form):
    """In whatever form they are named; twin: a good one does."""
    assert load_specimen(form(material())).shapes()
    for changes, reason in BAD_FIELDS if form is as_dict else BAD_FIELDS[:1]:
        specimen = form(material(**changes))
        with pytest.raises(FileFormatError, match=reason):
            load_specimen(specimen)


@pytest.mark.parametrize("place", [2**20, 2**40, 2**63])
def test_a_material_that_points_beyond_itself(material, place):
    """Mitsuba maps the file and reads there: the process ended by a signal."""
    path = Path(material())
    data = bytearray(path.read_bytes())
    name = b"luminance"
    at = data.index(name) + len(name) + 3
    data[at : at + 8] = place.to_bytes(8, "little")
    path.write_bytes(data)
    with pytest.raises(FileFormatError, match="does not fit into"):
        load_specimen(as_dict(str(path)))


# ---------------------------------------------------------------------------- resuming


def test_resume_looks_at_the_hemispheres():
    mi.set_variant("llvm_ad_mono")
    settings = {"rays": 1000, "batches": 2, "collector": "angle:2x2", "theta_i": 0}
    upper = gonio.measure({"type": "roughdielectric"}, hemispheres="upper", **settings)
    with pytest.raises(ValueError, match="with hemispheres='upper' instead of 'both'"):
        gonio.measure({"type": "roughdielectric"}, resume=upper, **settings)
    again = gonio.measure(
        {"type": "roughdielectric"}, hemispheres="upper", resume=upper, **settings
    )
    assert again.tallies == upper.tallies  # the twin


@pytest.mark.needs("materials")
@pytest.mark.needs("exchange")
@pytest.mark.parametrize("command", ["measure", "bsdf"])
def test_an_output_is_no_file_of_the_specimen(command, tmp_path, capsys):
    """A scene, or the record of a material, is not written over."""
    ending = {"measure": "npz", "bsdf": "xml"}[command]
    path = tmp_path / f"mine.{ending}"
    path.write_text("mine")
    specimens = [str(path)] if ending == "xml" else []
    for specimen in (*specimens, f"goniometric:filename={path}"):
        assert cli.main([command, specimen, "-o", str(path)]) == 1
        assert "must not be a file of the specimen" in capsys.readouterr().err
        assert path.read_text() == "mine"

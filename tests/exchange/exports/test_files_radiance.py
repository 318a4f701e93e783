"""Radiance's files: read by Radiance itself, and by us when they are hostile."""

import io
import itertools
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import synthetic

from gonio_mi.collector import EqualProjectedSolidAngle
from gonio_mi.collector.directions import angles, direction
from gonio_mi.collector.klems import Klems
from gonio_mi.collector.shirley_chiu import directions_of, square_of
from gonio_mi.errors import FileFormatError
from gonio_mi.exchange.exports import exporting, radiance_export
from gonio_mi.exchange.formats import (
    radiance,
    radiance_basis,
    radiance_material,
    tensor_tree,
)
from gonio_mi.exchange.formats.radiance import OTHER, RadianceBSDF
from gonio_mi.exchange.formats.radiance_basis import blocks_of
from gonio_mi.exchange.formats.tensor_tree import TensorTree
from gonio_mi.materials.resampling import Material
from gonio_mi.results.record import XYZ

# Most records here are of one side, with lobes that are not reciprocal: files say so.
pytestmark = [
    pytest.mark.filterwarnings("ignore:the file describes light from"),
    pytest.mark.filterwarnings("ignore:the (front|back) is not reciprocal"),
]

EPS = float(np.finfo(np.float32).eps)

# Radiance perturbs its values by up to this, on purpose.
RADIANCE_NOISE = 3e-4

# By which Radiance multiplies XYZ.
LUMENS = 179.0

# Our trees have six digits.
DIGITS = 5e-6


@pytest.fixture
def coarse(monkeypatch):
    """Small files: average over fewer points of each Klems patch, in larger cells."""
    monkeypatch.setattr(radiance_export, "POINTS_OUT", 2)
    monkeypatch.setattr(radiance_export, "POINTS_IN", 1)
    monkeypatch.setattr(radiance_export, "TREE_SIZES", {3: 16, 4: 8})


@pytest.fixture
def glossy():
    return synthetic.record(
        "projected:8x16", theta_i=(0, 30, 60), phi_i=(0, 0, 0), power=6, both=True
    )


def loaded(path, of=RadianceBSDF):
    with open(path, "rb") as stream:
        return of(stream)


# --------------------------------------------------------------------- what is written


@pytest.mark.usefixtures("mono", "coarse")
def test_a_lambertian_is_one_value():
    """Of Klems patches, and of the cells of trees, which become one."""
    for basis in ("klems-quarter", "tensor3"):
        side = radiance_export.Side(synthetic.lambertian(), basis)
        block = side.blocks()["Visible", "Reflection Back"]
        if basis == "tensor3":
            block = block.root
            assert block.shape == (1,) * 3
        assert (np.abs(block - 0.5 / np.pi) <= 64 * EPS).all()


def test_finer_trees_lose_less(tmp_path, glossy, monkeypatch):
    """First order: cells that do not fit the record's patches."""
    lost = []
    for size in (16, 32):
        monkeypatch.setattr(radiance_export, "TREE_SIZES", {3: size})
        losses = exporting.export(glossy, tmp_path / "a.xml", "tensor3")
        lost.append(np.mean([loss.misplaced for loss in losses]))
    assert lost[0] > 1.5 * lost[1]


@pytest.mark.usefixtures("rgb", "coarse")
@pytest.mark.parametrize(
    ("phi_i", "channels", "message"),
    [
        ((0, 120, 240), ("Y",), "has 3 azimuths of incidence: take tensor4"),
        ((0, 0, 0), ("R", "G", "B"), "loses the colours"),
        ((0, 0, 0), ("400nm", "500nm"), "95% of visible light"),
        ((0, 0, 0), ("a", "b"), "one channel, of R, G, B or of wavelengths"),
    ],
)
def test_trees_of_rank_3_are_isotropic_and_grey(tmp_path, phi_i, channels, message):
    theta_i = (0, 30, 60) if len(set(phi_i)) == 1 else (30, 30, 30)
    record = synthetic.record(theta_i=theta_i, phi_i=phi_i, channels=channels)
    with pytest.raises(ValueError, match=message):
        exporting.export(record, tmp_path / "run.xml", "tensor3")


def test_squares_of_disks():
    """Both ways, and equal areas: of radius r there is the part r^2."""
    square = np.random.default_rng(2).random((10_000, 2))
    v = directions_of(square)
    rounding = 16 * np.finfo(float).eps
    assert (np.abs(square_of(v[:, 0], v[:, 1]) - square) <= rounding).all()
    # the part of the square around its middle of sides r
    side = 2 * np.abs(square - 0.5).max(axis=1)
    assert (np.abs(np.hypot(v[:, 0], v[:, 1]) - side) <= rounding).all()
    # its eight triangles have equal areas, and so have the octants of the disk
    turn = np.degrees(np.arctan2(v[:, 1], v[:, 0])) % 360
    a, b = (2 * square - 1).T
    triangle = np.degrees(np.arctan2(b, a)) % 360 // 45
    assert (turn // 45 == triangle).all()
    assert directions_of([0.5, 0.5]).tolist() == [0, 0, 1]


def test_trees_are_their_grids():
    """Exactly without merging, else within the spread that is allowed."""
    rng = np.random.default_rng(3)
    for shape in ((8,) * 3, (8,) * 4):
        values = 1 + rng.random(shape)
        values[: len(values) // 2] = 1 + 0.01 * rng.random(values[0].shape)
        points = rng.random((5000, len(shape)))
        truth = values[tuple((points * shape).astype(int).T)]
        exact, merged = TensorTree.of(values, flat=0), TensorTree.of(values, flat=0.5)
        assert np.array_equal(exact.at(points), truth)
        assert (np.abs(merged.at(points) - truth) <= 0.5 * truth.max()).all()
        assert len(merged.text()) < len(exact.text())
        again = TensorTree.parsed(exact.text(), len(shape)).at(points)
        assert (np.abs(again - truth) <= DIGITS * truth).all()


# ------------------------------------------------------------------ read by Radiance


def rtrace(folder, filename, wi, wo):
    """BSDF that Radiance's renderer sees on a lit plate, as XYZ, shape ``(n, 3)``.

    Parameters
    ----------
    filename : str
        In the folder.
    wi : ndarray, shape (3,)
        To the emitter.
    wo : ndarray, shape (n, 3)
        To the eye.
    """
    programs = Path(pytest.importorskip("pyradiance").__file__).parent / "bin"
    size, radiance = 0.02, 1e6
    to_emitter = " ".join(f"{x:.9g}" for x in [*wi, size])
    scene = f"""
void light glow 0 0 3 {radiance} {radiance} {radiance}
glow source emitter 0 0 4 {to_emitter}
void BSDF material 6 0 ./{filename} 0 1 0 . 0 0
material polygon plate 0 0 12 -1 -1 0 1 -1 0 1 1 0 -1 1 0
"""
    eyes = "\n".join(" ".join(f"{x:.9g}" for x in [*v, *-v]) for v in wo)

    def run(program, *options, data):
        command = [programs / program, *options]
        ran = subprocess.run(
            command, input=data.encode(), capture_output=True, cwd=folder, check=True
        )
        return ran.stdout

    (folder / "octree").write_bytes(run("oconv", "-", data=scene))
    options = ["-h", "-pXYZ", "-ab", "0", "-dj", "0", "-ss", "0", "octree"]
    seen = np.array(run("rtrace", *options, data=eyes).split(), float)
    solid_angle = 4 * np.pi * np.sin(np.radians(size / 2) / 2) ** 2
    return seen.reshape(-1, 3) / (radiance * solid_angle * np.abs(wi[2]) * LUMENS)


@pytest.mark.parametrize(
    ("basis", "side"), [*zip(radiance_basis.BASES, itertools.cycle(("front", "back")))]
)
@pytest.mark.usefixtures("rgb", "coarse")
def test_radiance_renders_what_was_written(tmp_path, glossy, basis, side):
    """100 eyes around a lit plate.

    For reflection Radiance takes the eye for an emitter.
    """
    if basis == "tensor4":
        glossy = synthetic.record(
            theta_i=(20, 60), phi_i=(0, 0), power=6, both=True, channels=("R", "G", "B")
        )
    glossy = glossy.with_settings(side=side)
    exporting.export(glossy, tmp_path / "plate.xml", basis)
    own = loaded(tmp_path / "plate.xml")
    rng = np.random.default_rng(5)
    theta_i, phi_i = 40.0, 75.0
    wi = direction(*np.radians([theta_i, phi_i]))
    theta_o = np.degrees(np.arcsin(np.sqrt(0.95 * rng.random(100))))
    phi_o = 360 * rng.random(100)
    wo = direction(np.radians(theta_o), np.radians(phi_o))
    up = 1 if side == "front" else -1
    signs = [1, 1, up]
    for hemisphere in (0, 1):
        if hemisphere:
            values = own.values(side, 1, theta_i, phi_i, wo)
        else:
            values = own.values(side, 0, theta_o, phi_o, np.tile(wi, (100, 1)))
        eyes = wo * signs * [[1, 1, 1], [1, 1, -1]][hemisphere]
        seen = rtrace(tmp_path, "plate.xml", wi * signs, eyes)
        colours = basis == "tensor4"
        expected = values @ XYZ.T if colours else values.repeat(3, axis=1)
        # of the radiance, and of the direct light that it comes from
        assert (np.abs(seen - expected) <= 2 * RADIANCE_NOISE * expected).all()


@pytest.mark.usefixtures("mono", "coarse")
def test_twin_radiance_would_notice_a_turned_emitter(tmp_path, glossy):
    exporting.export(glossy, tmp_path / "plate.xml", "tensor3")
    own = loaded(tmp_path / "plate.xml")
    wi, wo = direction(0.7, 1.3), direction(0.5, 4.0)
    (seen,) = rtrace(tmp_path, "plate.xml", wi, wo[None])
    for turned in (0, 90):
        angles = np.degrees(0.5), np.degrees(4.0) + turned
        expected = own.values("front", 0, *angles, wi[None]).item()
        agrees = abs(seen[1] - expected) <= 2 * RADIANCE_NOISE * expected
        assert agrees == (turned == 0)


def written(path, blocks):
    with open(path, "wb") as stream:
        radiance.write(blocks, stream)
    return loaded(path)


def random_block(basis, size=4, seed=8):
    rank = radiance_basis.RANKS.get(basis)
    values = np.random.default_rng(seed).uniform(
        0.1, 0.3, (41, 41) if rank is None else (size,) * rank
    )
    return values if rank is None else TensorTree.of(values, flat=0)


@pytest.mark.parametrize("basis", ["klems-quarter", "tensor3", "tensor4"])
@pytest.mark.parametrize("told", ["front", "back"])
def test_one_transmission_is_that_of_both_sides(tmp_path, basis, told):
    """As Radiance's renderer has it; twin: it is not the same matrix for both."""
    blocks = {("Visible", radiance.DIRECTIONS[told, 1]): random_block(basis)}
    own = written(tmp_path / "pane.xml", blocks)
    wo = direction(*np.random.default_rng(3).uniform(0.1, 1.4, (2, 30)))
    theta_i, phi_i = 40.0, 75.0
    wi = direction(*np.radians([theta_i, phi_i]))
    values = {}
    for side, up in (("front", 1), ("back", -1)):
        assert own.is_reciprocal(side, 1) == (side != told)
        values[side] = own.values(side, 1, theta_i, phi_i, wo)[:, 0]
        seen = rtrace(tmp_path, "pane.xml", wi * [1, 1, up], wo * [1, 1, -up])[:, 1]
        assert (np.abs(seen - values[side]) <= 2 * RADIANCE_NOISE * seen).all()
    assert not np.allclose(values["front"], values["back"], rtol=0.1)


@pytest.mark.parametrize("basis", ["klems-quarter", "tensor3", "tensor4"])
@pytest.mark.parametrize("value", [0.0, 0.05])
def test_placeholders_of_a_transmission_do_not_count(tmp_path, basis, value):
    """As if the file did not hold them, and the transmittances of both are told."""
    names = [radiance.DIRECTIONS[side, 1] for side in ("front", "back")]
    block = random_block(basis)
    dummy = value * np.ones_like(block if basis == "klems-quarter" else block.root)
    dummy = dummy if basis == "klems-quarter" else TensorTree.of(dummy)
    files = ([None, block], [dummy, block], [block, block], [block, scaled(block)])
    found = []
    for number, blocks in enumerate(files):
        path = tmp_path / f"{number}.xml"
        some = {("Visible", n): b for n, b in zip(names, blocks) if b is not None}
        written(path, some)
        with open(path, "rb") as stream:
            found.append(radiance_material.material(stream, "front"))
    alone, with_dummy, alike, unlike = found
    assert np.array_equal(with_dummy.flux_fraction, alone.flux_fraction)
    (note,) = with_dummy.notes
    # a mean of 0.2 in 1/sr, within the standard deviation of as few cells as 32
    total, lower = (float(re.search(rf"(\S+) from the {s}", note)[1]) for s in OTHER)
    assert total == pytest.approx(value * np.pi, rel=1e-3)
    assert abs(lower / np.pi - 0.2) < 0.2 / np.sqrt(12 * 32) * 3
    assert note.endswith("taken from that of the back, by reciprocity")
    assert not alike.notes
    assert unlike.notes[0].endswith("each is taken as it is")  # twin
    assert not np.allclose(alike.flux_fraction, alone.flux_fraction, rtol=0.1)


def scaled(block):
    """Block of nine tenths of the values."""
    if isinstance(block, TensorTree):
        return TensorTree.of(0.9 * block.root, flat=0)
    return 0.9 * block


def test_text_before_the_declaration_is_passed_over():
    stream = io.BytesIO()
    block = random_block("klems-quarter")
    radiance.write({("Visible", "Reflection Back"): block}, stream)
    data = b"Recover using: genBSDF -recover x\n" + stream.getvalue()
    blocks, again = (radiance.read(io.BytesIO(d)) for d in (data, stream.getvalue()))
    for key, block in blocks.items():
        assert np.array_equal(block, again[key])


@pytest.mark.parametrize(("basis", "size"), [("tensor3", 8), ("tensor4", 8)])
def test_every_incident_cell_keeps_its_light(tmp_path, basis, size):
    """As `goniometric` reads a tree of random cells: the sums over cells of exit.

    At the middle of each incident cell, and along the normal the mean of those that
    touch it: exact, up to single precision of the direction.
    """
    tree = random_block(basis, size)
    written(tmp_path / "tree.xml", {("Visible", "Transmission Back"): tree})
    with open(tmp_path / "tree.xml", "rb") as stream:
        material = Material(radiance_material.material(stream, "front"))
    totals = tree.root.sum(axis=(-2, -1)) * np.pi / size**2
    half, middles = size // 2, (np.arange(size) + 0.5) / size
    if basis == "tensor3":
        theta, phi = np.arcsin(1 - 2 * middles[:half]), np.full(half, np.pi)
        totals, around = totals[:half], totals[half - 1]
    else:
        square = np.stack(np.meshgrid(middles, middles, indexing="ij"), axis=-1)
        theta, phi = angles(directions_of(square.reshape(-1, 2)) * [-1, -1, 1])
        around = totals[half - 1 : half + 1, half - 1 : half + 1].mean()
        totals = totals.ravel()
    theta, phi = np.degrees([np.append(0, theta), np.append(0, phi)])
    expected = np.append(around, totals)
    found = material.totals(1, theta, phi)[0][:, 0]
    assert np.allclose(found, expected, rtol=64 * DIGITS)
    assert not np.allclose(found[1:], np.roll(expected[1:], 1), rtol=0.01)  # twin


def test_a_window_transmits_alike_from_everywhere(tmp_path):
    """Light goes straight on in one cell: 0.8, as Radiance has it, and no lobe less."""
    size, t = 16, 0.8
    values = np.zeros((size,) * 4)
    i, j = np.indices((size, size))
    values[i, j, i, j] = t / (np.pi / size**2)
    tree = TensorTree.of(values)
    names = ("Transmission Front", "Transmission Back")
    written(tmp_path / "pane.xml", {("Visible", name): tree for name in names})
    theta = np.array([0, 5, 10, 20, 30, 45, 60, 85.0])
    phi = 37 * np.arange(8)
    path = tmp_path / "pane.xml"
    seen = radiance_totals(path, np.stack([theta, phi], 1).tolist())
    assert np.allclose(seen, t, rtol=2 * RADIANCE_NOISE)
    with open(tmp_path / "pane.xml", "rb") as stream:
        means = radiance_material.material(stream, "back")
    assert np.allclose(means.flux_fraction[:, 1].sum(axis=(1, 2)), t, rtol=DIGITS)
    assert not means.flux_fraction[:, 0].any()
    # twin: 3 x 3 points in patches 10 degrees wide
    wo = EqualProjectedSolidAngle(32, 64).points(3).reshape(-1, 3)
    coarse = loaded(path).values("back", 1, 0.0, 0.0, wo)
    assert abs(coarse.mean() * np.pi / t - 1) > 0.2


def test_a_reader_of_windows_reads_matrices(tmp_path):
    """LBNL's pyWinCalc: in the rows and columns of the file, to its seven digits."""
    pywincalc = pytest.importorskip("pywincalc")
    block = random_block("klems-quarter")
    path = tmp_path / "pane.xml"
    names = radiance.DIRECTIONS.values()
    written(path, {(of, name): block for of in ("Visible", "Solar") for name in names})
    solid = pywincalc.parse_bsdf_xml_file(str(path))
    for part in (solid.measurements.visible, solid.measurements.solar):
        for data in (part.transmittance_front, part.reflectance_back):
            assert np.allclose(data.data, block, rtol=1e-6)
    # twin: without a thickness there is nothing to read
    text = path.read_text().replace('<Thickness unit="meter">0</Thickness>', "")
    path.write_text(text)
    with pytest.raises(Exception, match="null"):
        pywincalc.parse_bsdf_xml_file(str(path))


def radiance_totals(path, angles):
    """Radiance's directional-hemispherical totals, each at theta and phi in degrees.

    In a process of its own: Radiance's reader crashes at the second file of a process.
    """
    pytest.importorskip("pyradiance")
    script = """
import json, sys
from pyradiance import bsdf
theirs = bsdf.load_file(sys.argv[1])
angles = json.loads(sys.argv[2])
print(json.dumps([bsdf.direct_hemi(theirs, *one, bsdf.SAMPLE_ALL) for one in angles]))
"""
    done = subprocess.run(
        [sys.executable, "-c", script, str(path), json.dumps(angles)],
        capture_output=True,
        text=True,
        check=True,
    )
    return json.loads(done.stdout)


@pytest.mark.parametrize("basis", ["klems", "tensor3"])
@pytest.mark.usefixtures("mono", "coarse")
def test_what_is_not_reciprocal_is_told_with_its_figure(tmp_path, basis):
    """An albedo of 0.2 + 0.6 sin(theta_i): closed forms, and Radiance's own total.

    Sines of directions that are even in projected solid angle have the density 2 s: the
    light of pairs of rings of the coarsest Klems patches, with their mean albedos.
    """
    theta_i = np.array([0, 30, 60, 89.999])
    albedo = 0.2 + 0.6 * np.sin(np.radians(theta_i))
    share = synthetic.lambertian(reflectance=1.0).flux_fraction[0, 0, ..., 0]
    weights = albedo[:, None, None, None] * share
    record = synthetic.exact(weights, theta_i, "projected:9x16")
    path = tmp_path / "dim.xml"
    with pytest.warns(RuntimeWarning, match="is not reciprocal") as told:
        exporting.export(record, path, basis)
    (text,) = [str(one.message) for one in told if "reciprocal" in str(one.message)]
    edges = np.sin(np.radians(Klems("quarter").theta_deg))
    parts = np.diff(edges**2)
    rings = 0.2 + 0.6 * np.diff(edges**3) * 2 / 3 / parts
    pairs = np.abs(rings[:, None] - rings) * parts[:, None] * parts
    share = float(re.findall("shows (.*)% of the reflected flux", text)[0]) / 100
    # whole per cents; patches of 15 degrees, and cells, round the rings
    assert abs(share - pairs.sum() / 2 / 0.6) < 0.005 + 0.015
    shown, true, theta = map(
        float, re.findall("sky (.*) for (.*) as seen from theta (.*), phi", text)[0]
    )
    assert abs(true - 0.6) < 0.01  # the same roundings
    assert theta == 0  # of the middle of a patch
    x, y, z = Klems("quarter").points(3)[0].T
    angles = np.degrees([np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)]).T
    seen = radiance_totals(path, angles.tolist())
    assert abs(shown - np.mean(seen)) < 5e-4 + 2 * RADIANCE_NOISE  # three digits
    assert abs(shown - true) > 0.3
    assert "lit from the front, the face to +z: Reflection Back" in path.read_text()


@pytest.mark.usefixtures("mono", "coarse")
def test_twin_what_is_reciprocal_is_not_told_of(tmp_path, recwarn):
    for number, basis in enumerate(("klems-quarter", "tensor3", "tensor4")):
        exporting.export(synthetic.lambertian(), tmp_path / f"{number}.xml", basis)
    assert not [one for one in recwarn if "reciprocal" in str(one.message)]


# ------------------------------------------------------------------------ read by us


@pytest.mark.parametrize("kind", ["klems", "tensor3", "tensor4"])
def test_colours_come_back(kind):
    """Of values that are whole in the file; matrices have seven digits, trees six."""
    rng = np.random.default_rng(6)
    shape = {"klems": (145, 145), "tensor3": (4,) * 3, "tensor4": (4,) * 4}[kind]
    values = 0.1 + rng.random((*shape, 3))
    name = "Transmission Front"
    stream = io.BytesIO()
    radiance.write(blocks_of(values, name), stream)
    stream.seek(0)
    own = RadianceBSDF(stream)
    assert own.channels == ("R", "G", "B")
    assert own.holds("back", 1)
    assert own.is_reciprocal("front", 1)
    assert not own.holds("back", 0)
    v = direction(*rng.uniform(0, 1.57, (2, 500)))
    theta_i, phi_i = rng.uniform(0, 89, 500), rng.uniform(0, 360, 500)
    seen = own.values("back", 1, theta_i, phi_i, v)
    if kind == "klems":
        index = Klems().patch(v), own.basis.incident_patch(theta_i, phi_i)
    else:
        points = tensor_tree.coordinates(len(shape), theta_i, phi_i, v)
        index = tuple((points * 4).astype(int).T)
    # rounding of three components times the condition of the matrix to RGB, 4.3
    assert (np.abs(seen - values[index]) <= 20 * DIGITS * values.max()).all()


def test_radiance_matrices_come_back():
    rng = np.random.default_rng(4)
    blocks = {
        (wavelength, direction): rng.random((41, 41))
        for wavelength in radiance.DETECTORS
        for direction in radiance.DIRECTIONS.values()
    }
    stream = io.BytesIO()
    radiance.write(blocks, stream, radiance.Product("<a & b>"))
    again = radiance.read(io.BytesIO(stream.getvalue()))
    assert again.keys() == blocks.keys()
    for key, matrix in blocks.items():
        assert (np.abs(again[key] - matrix) <= 1e-6 * matrix).all()  # seven digits


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_entities_are_not_expanded(encoding):
    """Nor even declared, whatever the encoding hides them in."""
    bomb = '<!DOCTYPE x [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;">]><x>&b;</x>'
    bomb = f'<?xml version="1.0" encoding="{encoding}"?>{bomb}'
    with pytest.raises(FileFormatError, match="it has a DTD"):
        radiance.read(io.BytesIO(bomb.encode(encoding)))


def test_a_colour_that_lacks_a_component_is_refused():
    blocks = blocks_of(np.ones((145, 145, 3)), "Reflection Back")
    del blocks["Visible", "Reflection Back"]
    blocks["Visible", "Transmission Back"] = np.ones((145, 145))
    stream = io.BytesIO()
    radiance.write(blocks, stream)
    stream.seek(0)
    with pytest.raises(FileFormatError, match="lacks Visible"):
        RadianceBSDF(stream)

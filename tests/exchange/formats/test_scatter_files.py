"""Scatter files of Zemax, Speos, FRED, OpenMATERIAL and MERL: tables and materials.

Real ones, where they are present, against each other and against what they state; own
ones against closed forms, and through the BSDF `goniometric`.
"""

import io
import json
from dataclasses import replace

import mitsuba as mi
import numpy as np
import pytest
import synthetic
from budget import Verdict, agree, disagree, normal_scores
from lobes import AZIMUTH, POLAR, VIAVI, lobes, phong
from scipy import stats
from scipy.spatial.transform import Rotation
from shared_data import DATA, real

import gonio_mi as gonio
from gonio_mi.cli import main
from gonio_mi.collector.directions import direction
from gonio_mi.errors import FileFormatError
from gonio_mi.exchange.exports import exporting
from gonio_mi.exchange.formats import (
    format as room,
    merl,
    open_material,
    reading,
    scatter,
    speos,
    zemax,
)
from gonio_mi.exchange.formats.format import Format
from gonio_mi.exchange.formats.reading import load_material, read_scatter
from gonio_mi.exchange.formats.scatter import Block, Scatter, total_of
from gonio_mi.results.prediction_error import prediction_error

EPS = np.finfo(float).eps


def again(scatter, write, path):
    with open(path, "wb") as stream:
        write(scatter, stream, "made for a test")
    return read_scatter(path)


# ------------------------------------------------------------------ angles and values


@pytest.mark.parametrize("specular", [False, True])
def test_blocks_know_where_their_directions_are(specular):
    """At the nodes, exact but for rounding; between them to second order."""
    for block in lobes(specular).blocks:
        theta, phi, values = block.nodes()
        wo = direction(np.radians(theta), np.radians(phi))
        assert (np.abs(phong(block.theta_i, wo) - values[:, 0]) <= 64 * EPS).all()
        # curvature of the lobe, 4 per square radian, over steps of 5 and 15 degrees
        inside = direction(*np.radians(np.meshgrid([12.0, 33.0], [7.0, 100.0])))
        error = np.abs(block.at(inside)[..., 0] - phong(block.theta_i, inside))
        assert error.max() <= 4 / 8 * np.radians([5, 15]) @ np.radians([5, 15])


def test_azimuths_of_zemax_count_from_the_side_of_the_normal():
    """10 degrees off the specular direction of 30, azimuth 0: 20 from the normal."""
    polar, values = np.array([0.0, 10.0]), np.arange(8.0).reshape(2, 4, 1)
    block = Block(30.0, 0.0, 0, polar, np.arange(4) * 90.0, values, specular=True)
    theta, phi, at = block.nodes()
    assert theta[[0, 1, 3]] == pytest.approx([30, 20, 40], abs=1e-9)
    assert phi[[0, 1, 3]] == pytest.approx([180, 180, 180])
    assert at[:, 0].tolist() == [0, 4, 5, 6, 7]
    # counter-clockwise, seen against the axis: who looks from -x has +y on the left
    assert phi[2] < 180 < phi[4]


def test_the_total_of_a_lambertian_is_its_albedo():
    values = np.full((len(POLAR), len(AZIMUTH), 1), 0.5 / np.pi)
    for specular in (False, True):
        block = Block(30.0, 0.0, 0, POLAR, AZIMUTH, values, specular)
        assert total_of(block)[0] == pytest.approx(0.5, rel=1e3 * EPS)


# ------------------------------------------------------------------------- round trips


def test_wavelengths_of_speos_each_have_a_total(tmp_path):
    names = ("450nm", "650nm")
    scatter = lobes(channels=names)
    read = again(scatter, speos.write_spectral, tmp_path / "a.brdf")
    assert read.channels == names
    assert read.blocks[1].values == pytest.approx(scatter.blocks[1].values, rel=2e-5)
    # one distribution: its mean, with the spectrum of the first incidence
    read = again(scatter, speos.write_anisotropic, tmp_path / "a.anisotropicbsdf")
    assert read.blocks[2].values == pytest.approx(scatter.blocks[2].values, rel=2e-5)
    with pytest.raises(ValueError, match="channel must be one of 450nm, 650nm"):
        gonio.read_measured(tmp_path / "a.brdf")
    assert gonio.read_measured(tmp_path / "a.brdf", "650").channel == "650nm"


def test_intensities_of_speos_are_divided_by_the_cosine(tmp_path):
    """A Lambertian of 40 % at 0 degrees, as intensity on any scale."""
    cosine = np.cos(np.radians(POLAR))
    rows = [[angle, *([7 * c] * 3)] for angle, c in zip(POLAR, cosine)]
    text = ["OPTIS - Anisotropic BSDF surface file v8.0", "0", "", "0", "", "0 1 0"]
    text += ["1 0", "0", "1", "0", "2", "0 45", "0 0", "", "2", "400 40", "700 20"]
    for _ in range(2):
        text += [f"{len(POLAR)} 3", "0 180 360"]
        text += ["\t".join(map(repr, map(float, row))) for row in rows]
    path = tmp_path / "a.anisotropicbsdf"
    path.write_text("\n".join([*text, "End of file"]))
    read = read_scatter(path)
    assert read.channels == ("400nm", "700nm")
    expected = np.broadcast_to([0.4 / np.pi, 0.2 / np.pi], (len(POLAR), 3, 2))
    assert read.blocks[1].values == pytest.approx(expected, rel=1e3 * EPS)


def test_merl_is_a_table_of_half_and_difference_angles():
    """Its reader's own formula for the cell, at some pairs of directions."""

    def value(theta_i, wo):
        mirror = direction(np.radians(theta_i), np.pi)
        lobe = np.maximum(np.sum(mirror * wo, axis=1), 0) ** 8
        return (0.1 + 0.5 * lobe)[:, None] * [1, 0.5, 0.25]

    stream = io.BytesIO()
    merl.write(value, stream)
    content = stream.getvalue()
    assert np.frombuffer(content[:12], "<i4").tolist() == [90, 90, 180]
    cells = np.frombuffer(content[12:], "<f8").reshape(3, 90, 90, 180)
    # half angle 22.5, difference angle 30.5 degrees in the plane of incidence
    row = int(np.sqrt(22.5 / 90) * 90)
    seen = cells[:, row, 30, 0] * [1 / 1500, 1.15 / 1500, 1.66 / 1500]
    centre = ((row + 0.5) / 90) ** 2 * 90
    expected = 0.1 + 0.5 * np.cos(np.radians(2 * centre)) ** 8
    assert seen == pytest.approx(expected * np.array([1, 0.5, 0.25]), rel=1e-4)
    stream.seek(0)
    read = merl.read(stream, (0, 50))
    wo = direction(*np.radians(np.meshgrid([10.0, 40.0, 70.0], [0.0, 130.0, 180.0])))
    for block in read.blocks:
        # cells are a degree wide, and the lobe changes by 2 per radian at most
        error = np.abs(block.at(wo)[..., 0] - phong(block.theta_i, wo))
        assert error.max() <= 2 * np.radians(1)
    assert read.channels == ("R", "G", "B")


def test_open_material_is_as_its_schema_asks(tmp_path):
    """Which its reader checks; the schema itself says so too where it is present."""
    scatter = lobes(channels=("550nm", "450nm"))
    read = again(scatter, open_material.write, tmp_path / "a.json")
    assert read.channels == ("450nm", "550nm")
    for one, two in zip(scatter.blocks, read.blocks):
        # angles have six digits in radians
        wo = two.directions()
        assert two.values[..., 1] == pytest.approx(phong(one.theta_i, wo), abs=1e-4)
    content = json.loads((tmp_path / "a.json").read_text())
    rows = content["brdf"]["lookupTable"]
    assert rows == sorted(rows)
    schema = DATA / "material_brdf_schema.json"
    if schema.exists():
        jsonschema = pytest.importorskip("jsonschema")
        jsonschema.validate(content, json.loads(schema.read_text()))


def look_up_table(tmp_path, wavelengths, rows):
    """File of OpenMATERIAL."""
    metadata = dict.fromkeys(("name", "uuid", *open_material.METADATA), "1.0.0")
    metadata["uuid"] = "42e8da0f-ba1d-4cc8-b07a-178819c894c0"
    brdf = {"wavelengths": wavelengths, "lookupTable": rows}
    path = tmp_path / "a.xompt"
    path.write_text(json.dumps({"metadata": metadata, "brdf": brdf}))
    return path


def test_rows_of_open_material_in_the_plane_are_a_table_only(tmp_path):
    rows = [[9.05e-7, 0.5, 0.1, 0.0, 0.2], [9.05e-7, 0.5, 0.1, 3.141592, 0.3]]
    path = look_up_table(tmp_path, [9.05e-7], rows)
    read = gonio.read_measured(path)
    assert read.channel == "905nm"
    assert read.phi_o == pytest.approx([0, 180], abs=1e-3)
    # and a pole that is told for one of two wavelengths
    both = [[nm, 0.5, 0.1, phi, 0.2] for nm in (5e-7, 6e-7) for phi in (0, 2, 4)]
    both.append([5e-7, 0.5, 0, 0, 0.2])
    for wavelengths, table in (([9.05e-7], rows), ([5e-7, 6e-7], both)):
        with pytest.raises(FileFormatError, match="no grid over the hemisphere"):
            read_scatter(look_up_table(tmp_path, wavelengths, table))


# --------------------------------------------------------------- records there and back

RAYS = 2**17
ENDINGS = (".zemax.bsdf", ".brdf", ".anisotropicbsdf", ".json", ".binary")


def check_what_comes_back(one, recorded, loss):
    """A material's record is that of its file, but for twice the `loss` that was told.

    Once by the export, once by the patches of the material. Twin: a record turned by
    one sector.
    """
    assert abs(one.dhr[0] / loss.written - 1) <= loss.misplaced
    turned = np.roll(recorded, 1, axis=-2)
    for expected, passes in ((recorded, agree), (turned, disagree)):
        error = prediction_error(one, expected)
        t = (error.total_variation - 2 * loss.misplaced) / error.std_err
        p = stats.norm.sf(normal_scores(t, one.n_batches - 1))
        passes(Verdict({"light": float(p)}))


def recorded(theta_i, rays=4_000_000, phi_i=20.0):
    """Record of `phong`, which is reciprocal, in four batches of so many rays."""
    blank = synthetic.record("projected:12x24", theta_i, [phi_i] * len(theta_i))
    patches, rng = blank.subdivision, np.random.default_rng(1)
    cosine, sine = np.cos(np.radians(phi_i)), np.sin(np.radians(phi_i))
    # as seen where light comes from +x
    wo = patches.points(4) @ [[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]]
    tallies = []
    for theta in theta_i:
        means = phong(theta, wo).mean(axis=1).reshape(patches.shape)
        light = means * patches.projected_solid_angles
        tallies.append(synthetic.tally(patches, light[None], rays, rng))
    return replace(blank, tallies=tuple(tallies))


def blurred(one, specular):
    """Part of the light that the grid of a file carries into other patches, at most.

    In a direction it says what patches say of points of cells of the grid, linear in
    between: of a place that is off by three uniform deviates, of a step each. Of their
    mean absolute value, 13/32 of a step, half goes either way over a border, and takes
    along by how much one patch is brighter; to first order in the steps.
    """
    patches, f = one.subdivision, one.brdf[..., 0]
    theta, phi = patches.theta_edges, patches.phi_edges
    middles = [(edges[1:] + edges[:-1]) / 2 for edges in (theta, phi)]
    mirror = direction(*np.radians([one.theta_i[0], one.phi_i[0] + 180]))

    def steps(*angles):
        """Steps along the polar angle and along the azimuth, in radians."""
        theta, phi = np.meshgrid(*angles, indexing="ij")
        if not specular:
            polar, azimuth = (np.radians(a[1]) for a in scatter._grid(one))
            return polar, azimuth * np.sin(theta)
        radial = np.radians(scatter.RADIAL)
        off = np.arccos(np.clip(direction(theta, phi) @ mirror, -1, 1))
        step = np.hypot(
            np.interp(off, radial[1:], np.diff(radial)),
            np.radians(scatter.AROUND[1]) * np.sin(off),
        )
        return step, step

    rings = np.abs(np.diff(f, axis=0)) * np.diff(phi)
    rings *= (np.sin(theta) * np.cos(theta))[1:-1, None]
    sectors = np.abs(f - np.roll(f, 1, axis=1)) * np.diff(np.sin(theta))[:, None]
    flow = (rings * steps(theta[1:-1], middles[1])[0]).sum()
    flow += (sectors * steps(middles[0], phi[:-1])[1]).sum()
    return 13 / 64 * flow / one.dhr[0]


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_record_goes_there_and_comes_back_as_a_material(
    tmp_path, ending, monkeypatch
):
    """The loss that is told, and through `goniometric` no more than twice of it.

    Twin: a file that is turned by a sector has lost more than its grid explains.
    """
    monkeypatch.setattr(merl, "CELLS", (45, 45, 30))
    path, record = tmp_path / f"run{ending}", recorded((0, 30, 60))
    losses = exporting.export(record, path)
    assert [loss.theta_i for loss in losses] == [0, 30, 60]
    specular = ending == ".zemax.bsdf"
    for loss, one in zip(losses, record):
        if ending != ".binary":
            most, turned = (
                blurred(one, specular),
                np.roll(one.flux_fraction, 1, axis=-2),
            )
            assert loss.misplaced <= most
            assert (
                loss.theta_i == 0
                or prediction_error(one, turned).total_variation > most
            )
        # exact: sums differ by no more than what they are sums of
        assert abs(loss.written / loss.recorded - 1) <= 2 * loss.misplaced
    material = {"type": "goniometric", "filename": str(path)}
    # files of one azimuth of incidence are isotropic
    one = gonio.measure(
        material, 30, 20, collector=record.subdivision, rays=RAYS, seed=1
    )
    check_what_comes_back(one, record.flux_fraction[1], losses[1])


def test_merl_loses_what_is_between_incidences(tmp_path, monkeypatch):
    """Which a table of half and difference angles asks for: to first order at least."""
    monkeypatch.setattr(merl, "CELLS", (45, 45, 30))
    lost = []
    for step in (30, 15):
        record = recorded(tuple(range(0, 90, step)), rays=10**9)
        losses = exporting.export(record, tmp_path / "run.binary")
        lost.append([x.misplaced for x in losses if x.theta_i in (30, 60)])
    assert (np.array(lost[1]) <= np.array(lost[0]) / 2).all()


def test_each_quantity_and_channel_has_a_file_of_zemax(tmp_path):
    record = synthetic.record(
        "projected:4x8", theta_i=(0, 30), phi_i=(0, 0), both=True,
        channels=("450nm", "550nm"),
    )  # fmt: skip
    losses = exporting.export(record, tmp_path / "run.zemax.bsdf")
    assert len(losses) == 4
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == [
        f"run.{quantity}{nm}nm.zemax.bsdf"
        for quantity in ("brdf", "btdf")
        for nm in (450, 550)
    ]
    assert read_scatter(tmp_path / names[2]).of(1)


def test_records_that_a_format_cannot_hold(tmp_path):
    coloured = synthetic.record("projected:4x8", channels=("R", "G", "B"))
    for name, message in (
        ("a.brdf", "takes records of one channel or of wavelengths, got R, G, B"),
        ("a.anisotropicbsdf", "takes records of one channel or of wavelengths"),
        ("a.json", "takes records of one channel or of wavelengths"),
    ):
        with pytest.raises(ValueError, match=message):
            exporting.export(coloured, tmp_path / name)
    grey = synthetic.record("projected:4x8")
    with pytest.raises(ValueError, match="at least 2 angles of incidence, got 1"):
        exporting.export(grey, tmp_path / "a.brdf")
    turned = synthetic.record("projected:4x8", theta_i=(30, 30), phi_i=(0, 180))
    with pytest.raises(ValueError, match=r"holds one azimuth of incidence, .* got 2"):
        exporting.export(turned, tmp_path / "a.json")
    cones = gonio.measure(
        {"type": "diffuse"}, 0, collector="apertures:5.0@0.0/0.0,45.0/180.0", rays=10**5
    )
    with pytest.raises(ValueError, match=r"or write a \.csv"):
        exporting.export(cones, tmp_path / "a.zemax.bsdf")
    exporting.export(cones, tmp_path / "a.csv")
    table = gonio.read_measured(tmp_path / "a.csv")
    assert table.aperture_half_angle == 5
    assert gonio.compare(cones, table).passed


@pytest.mark.filterwarnings("ignore:the file describes light from the front only")
@pytest.mark.filterwarnings("ignore:the front is not reciprocal")  # made-up lobes
def test_tensor_trees_are_materials(tmp_path, monkeypatch):
    from gonio_mi.exchange.exports import radiance_export
    from gonio_mi.exchange.formats import radiance_material

    monkeypatch.setattr(radiance_export, "TREE_SIZES", {3: 32, 4: 16})
    monkeypatch.setattr(radiance_export, "CELL_POINTS", 1)
    monkeypatch.setattr(radiance_material, "MAX_INCIDENT", 48)
    record = synthetic.record(
        "projected:12x24", theta_i=(0, 20, 40, 60, 80), phi_i=(0,) * 5, power=3,
        rays=1_000_000,
    )  # fmt: skip
    for basis in ("tensor3", "tensor4"):
        path = tmp_path / f"{basis}.xml"
        losses = exporting.export(record, path, basis)
        material = {"type": "goniometric", "filename": str(path)}
        one = gonio.measure(material, 40, collector=record.subdivision, rays=RAYS)
        check_what_comes_back(one, record.flux_fraction[2], losses[2])


def test_commands_export_and_measure(tmp_path, capsys):
    synthetic.record("projected:4x8", theta_i=(0, 40), phi_i=(0, 0)).save(
        tmp_path / "run.npz"
    )
    out = str(tmp_path / "run.zemax.bsdf")
    assert main(["export", str(tmp_path / "run.npz"), "-o", out]) == 0
    assert "% of the flux is in neighbouring patches" in capsys.readouterr().out
    word = f"goniometric:filename={out}"
    assert main(["measure", word, "--theta-i", "40", "--rays", "1e4"]) == 0
    mi.set_variant("llvm_ad_mono")


# --------------------------------------------------------------------------- real files


def test_one_measurement_in_files_of_zemax_and_speos():
    """One shape in both; the totals that Zemax's states are those of Speos's values.

    The file of Speos was made from the other, with each incidence scaled to its stated
    total, and interpolated on another grid. Within 60 degrees of the specular direction
    that is less, in the middle and between the outer 5 percent, than leaving out every
    other angle of Zemax's grid makes.
    """
    one = read_scatter(real("planesymmetric.zemax.bsdf"))
    two = read_scatter(real("planesymmetric.speos.anisotropicbsdf"))
    assert [b.theta_i for b in one.blocks] == [b.theta_i for b in two.blocks]
    for first, second in zip(one.blocks, two.blocks):
        fewer = every_other_angle(first)
        lost = np.abs(total_of(first) / total_of(fewer) - 1)[0]
        assert total_of(second)[0] == pytest.approx(first.total[0], rel=lost)
        frame = Block(
            first.theta_i, 0.0, 0, np.zeros(1), np.zeros(1), np.zeros((1, 1, 1)), True
        )
        wo = frame.directions(np.arange(2.5, 60, 5), np.arange(0, 360, 15.0))
        # far from the horizon, where the converter put zeros
        wo = wo[wo[..., 2] > 0.2]
        typical, widest, middle = differences(second.at(wo), first.at(wo))
        typical_of_fewer, widest_of_fewer, _ = differences(fewer.at(wo), first.at(wo))
        assert typical < typical_of_fewer
        assert widest < widest_of_fewer
        mirrored = second.at(wo * [-1, 1, 1])[:, 0] / middle / first.at(wo)[:, 0]
        if first.theta_i > 15:  # the twin: azimuths counted from the other side
            assert np.median(np.abs(mirrored - 1)) > typical_of_fewer
        # the stated totals leave out what lies beyond the measured angles
        assert middle > 1


def every_other_angle(block):
    """The block with every other polar angle and azimuth, and the last ones."""
    polar, azimuth = (
        np.unique([*range(0, len(angles), 2), len(angles) - 1])
        for angles in (block.polar, block.azimuth)
    )
    values = block.values[np.ix_(polar, azimuth)]
    some = block.polar[polar], block.azimuth[azimuth]
    return replace(block, polar=some[0], azimuth=some[1], values=values)


def uniform_projected(n):
    """Directions of equal projected solid angles, shape (2 n**2, 3)."""
    sine = np.sqrt((np.arange(n) + 0.5) / n)
    azimuth = (np.arange(2 * n) + 0.5) * np.pi / n
    return direction(np.arcsin(sine)[:, None], azimuth).reshape(-1, 3)


def differences(values, others):
    """Median difference and that of the outer 5 percent, of a median of the ratios."""
    ratio = (values / others)[:, 0]
    low, middle, high = np.quantile(ratio, [0.05, 0.5, 0.95])
    return np.median(np.abs(ratio / middle - 1)), high / low - 1, middle


def test_stated_totals_are_those_of_the_values():
    """Of an Imaging Sphere, within what lies beyond the angles that it measured."""
    scatter = read_scatter(real("planesymmetric.zemax.bsdf"))
    for block in scatter.blocks:
        most = np.cos(np.radians(block.polar[-1]))
        mirror = direction(np.radians(block.theta_i), np.pi)
        light = block.at(wo := uniform_projected(200))[:, 0] * np.pi / len(wo)
        beyond = light[wo @ mirror < most].sum()
        assert block.total[0] < light.sum() < block.total[0] + beyond
    notes = gonio.read_measured(real("planesymmetric.zemax.bsdf")).notes
    assert any("1.01 to 1.073 of the stated totals" in note for note in notes)


def test_a_total_that_leaves_out_the_cosine_is_told():
    """bsdf-tools states half the integral of the BRDF alone: its own sum is found."""
    path = real("AnoBlackEC1onAlum.zemax.bsdf")
    scatter = read_scatter(path)
    for block in scatter.blocks:
        radial, azimuth = np.radians(block.polar), np.radians(block.azimuth)
        v = block.values[..., 0]
        means = (v[1:, 1:] + v[1:, :-1] + v[:-1, 1:] + v[:-1, :-1]) / 4
        sine = (np.sin(radial[1:]) + np.sin(radial[:-1])) / 2
        sum_of = means * (sine * np.diff(radial))[:, None] * np.diff(azimuth)
        # values have four digits
        assert sum_of.sum() == pytest.approx(block.total[0], rel=5e-4)
    notes = gonio.read_measured(path).notes
    assert any("0.8282 to 1.312 of the stated totals" in note for note in notes)


def test_one_measurement_in_files_of_zemax_and_fred():
    """Points of FRED's table against the grid of Zemax's: interpolated, and shifted.

    The maker averaged and moved the data for Zemax alone: by less than a step of the
    grid, of 5 degrees, would make.
    """
    scatter = read_scatter(real("AnoBlackEC1onAlum.zemax.bsdf"))
    table = gonio.read_measured(real("AnoBlackEC1onAlum.fred.txt"))
    assert len(table) == 1144
    assert [theta for theta, _ in table.incident] == [10, 30, 50, 70]
    for block in scatter.blocks:
        here = (table.theta_i == block.theta_i) & (table.theta_o <= 60)
        wo = direction(np.radians(table.theta_o[here]), np.radians(table.phi_o[here]))
        within = np.zeros(len(wo), bool)
        within[:] = wo @ direction(np.radians(block.theta_i), np.pi) > np.cos(1.2)
        seen, said = block.at(wo[within])[:, 0], table.value[here][within]
        a_step = min(
            np.median(np.abs(block.at(tilted(wo[within], angle))[:, 0] / seen - 1))
            for angle in (-5, 5)
        )
        assert np.median(np.abs(seen / said - 1)) < a_step
        if block.theta_i > 10:  # the twin: light on the other side
            turned = block.at(wo[within] * [-1, 1, 1])[:, 0]
            assert np.median(np.abs(turned / said - 1)) > a_step
    # the specular direction is a point of both
    mirror = (table.theta_i == 10) & (table.theta_o == 10) & (table.phi_o == 180)
    assert table.value[mirror][0] == scatter.blocks[0].values[0, 0, 0]


def tilted(wo, angle):
    """Directions turned about the y axis by an angle in degrees."""
    return wo @ Rotation.from_euler("y", angle, degrees=True).as_matrix().T


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("rt300s_speos.rtd", "version 1.0: save it anew"),
        ("rt300s_lighttools.txt", "a scan of a REFLET goniophotometer"),
    ],
)
def test_raw_exports_of_an_instrument_are_refused(name, message):
    with pytest.raises(FileFormatError, match=message):
        gonio.read_measured(real(name))


def test_a_real_material_is_measured():
    path = real("planesymmetric.speos.anisotropicbsdf")
    material = {"type": "goniometric", "filename": str(path)}
    record = gonio.measure(material, [15, 45], rays=2**14)
    blocks = [one for one in read_scatter(path).blocks if one.theta_i in (15, 45)]
    fine, coarse = (np.array([total_of(b, n)[0] for b in blocks]) for n in (200, 50))
    rule_error = np.abs(coarse - fine).max()
    assert record.dhr[:, 0] == pytest.approx(fine, abs=rule_error)
    assert record.dhr[::-1, 0] != pytest.approx(fine, abs=rule_error)  # the twin


# ------------------------------------------------------- other texts of such programs


def text_of(tmp_path, text, name="a.txt", mark=b""):
    path = tmp_path / name
    path.write_bytes(mark + text.encode())
    return path


def test_diffusers_of_viavi(tmp_path):
    """Light from 10 degrees at the azimuth 0 flies on to 0: straight on is a peak."""
    path = text_of(tmp_path, VIAVI)
    with pytest.raises(ValueError, match=r"a\.txt: .* say --quantity brdf or btdf"):
        gonio.read_measured(path)
    table = gonio.read_measured(path, quantity="btdf")
    assert table.incident == [(10, 0)]
    assert table.theta_o.tolist() == [180, 165, 165]
    assert (table.phi_o % 360).tolist() == [180, 180, 270]
    assert table.bsdf.tolist() == [0.6099, 26.66, 0.5]
    assert gonio.read_measured(path, quantity="brdf").theta_o.tolist() == [0, 15, 15]


def test_texts_of_fred_say_angles_and_values_in_two_ways(tmp_path):
    """In the plane, signed; as direction cosines; as logarithms; scaled."""
    head = "type bsdf_data\nformat angles={} bsdf={} scale={}\n"
    degrees = "30 0\n-60 0 0.01\n0 0 0.1\n60,0,1\n"
    sine = np.sin(np.radians([30, 60])).tolist()
    cosines = f"0 {sine[0]!r}\n0 -{sine[1]!r} -2\n0 0 -1\n0 {sine[1]!r} 0\n"
    one, two = (
        gonio.read_measured(text_of(tmp_path, head.format(*of) + rows))
        for of, rows in (
            (("deg", "value", 1), degrees),
            (("sin", "log", 2), cosines),
        )
    )
    assert one.theta_o.tolist() == [60, 0, 60]
    assert (one.phi_o % 360).tolist() == [0, 180, 180]
    assert one.value.tolist() == [0.01, 0.1, 1]
    # arcsines of sines, at worst 1 / cos(60) times their rounding, a few times
    assert two.theta_i == pytest.approx(one.theta_i, rel=16 * EPS)
    assert two.theta_o == pytest.approx(one.theta_o, rel=16 * EPS)
    assert (two.phi_o % 360)[[0, 2]].tolist() == [0, 180]
    assert two.value == pytest.approx(2 * one.value, rel=16 * EPS)


def test_a_text_of_fred_that_may_be_cut(tmp_path):
    text = "type bsdf_data\nformat angles=deg\n10 0\n5 0 0.1\n9 0 0.1\n20 0\n5 0 0.1\n"
    notes = gonio.read_measured(text_of(tmp_path, text)).notes
    assert any("1 of 2 directions: the file may be cut" in note for note in notes)


def test_an_azimuth_of_360_is_that_of_0(tmp_path):
    """The first counts; one that says otherwise is told; and it is a material."""
    first = lobes(specular=True)
    turned = [
        replace(b, phi_i=phi) for phi in (0, 90, 180, 270, 360) for b in first.blocks
    ]
    turned[-1] = replace(turned[-1], values=2 * turned[-1].values)
    stream = io.BytesIO()
    everything = Scatter.__new__(Scatter)  # as others write it, with both
    object.__setattr__(everything, "blocks", turned)
    object.__setattr__(everything, "channels", first.channels)
    zemax.write(everything, stream, "a")
    path = tmp_path / "a.bsdf"
    path.write_bytes(stream.getvalue())
    read = read_scatter(path)
    assert {b.phi_i for b in read.blocks} == {0, 90, 180, 270}
    assert len(read.blocks) == 4 * len(first.blocks)
    assert read.blocks[len(first.blocks) - 1].values == pytest.approx(
        turned[len(first.blocks) - 1].values, rel=1e-5
    )
    note = "3 incidences are there a full turn on again, 1 of them with other values"
    assert any(note in one for one in read.notes)
    means = load_material(path)
    assert sorted(set(means.phi_i.tolist())) == [0, 90, 180, 270]


def test_rows_of_open_material_at_90_degrees_are_counted(tmp_path):
    rows = [[5e-7, 0.5, theta, 0.0, 0.2] for theta in (0.1, 0.2, 1.570796)]
    table = gonio.read_measured(look_up_table(tmp_path, [5e-7], rows))
    assert len(table) == 2
    assert "1 of 3 rows, at 90 degrees, are left out" in table.notes


WRITTEN_OTHERWISE = {
    "indented": lambda text: "\n".join(f" \t{line}" for line in text.split("\n")),
    "carriage returns": lambda text: text.replace("\n", "\r"),
    "long comments": lambda text: "# of the instrument\n" * 10_000 + text,
}


@pytest.mark.parametrize("change", WRITTEN_OTHERWISE)
def test_a_file_of_zemax_is_none_of_mitsuba(tmp_path, change):
    """Whatever its reader takes is read by its name, too."""
    first = lobes(True)
    stream = io.BytesIO()
    zemax.write(first, stream, "x")
    text = WRITTEN_OTHERWISE[change](stream.getvalue().decode())
    read = read_scatter(text_of(tmp_path, text, "a.bsdf"))
    assert len(read.blocks) == len(first.blocks)
    if change != "long comments":
        assert reading.format_of(text_of(tmp_path, text)).program == "Zemax OpticStudio"


@pytest.mark.parametrize("comment", ["# ALTA's export", "# DIM light", "# PARAM_INS"])
def test_comments_make_no_file_of_alta(tmp_path, comment):
    text = f"{comment}\ntheta_i,phi_i,theta_o,phi_o,value\n45,0,30,180,0.4\n"
    assert gonio.read_measured(text_of(tmp_path, text)).value.tolist() == [0.4]


def test_a_format_that_is_added_is_read_written_and_named(tmp_path, monkeypatch):
    """By one list, of one module: a table, a material and an export of it."""

    def write(scatter, stream, _):
        stream.write(f"plain {scatter.blocks[0].values.mean():.9g}".encode())

    def read(stream):
        value = float(stream.read().split()[1])
        flat = [
            replace(b, values=np.full_like(b.values, value)) for b in lobes().blocks
        ]
        return Scatter(flat, ("Y",))

    plain = Format(
        *("Plain", (".plain",)),
        scatter=read,
        writes=(".plain",),
        write=write,
        loses="all else",
    )
    monkeypatch.setattr(room, "FORMATS", (*room.FORMATS, plain))
    reading._all.cache_clear()
    try:
        path = tmp_path / "a.plain"
        record = synthetic.record("projected:4x8", theta_i=(0, 30, 60), phi_i=(0,) * 3)
        losses = exporting.export(record, path)
        assert [loss.theta_i for loss in losses] == [0, 30, 60]
        table = gonio.read_measured(path)
        assert np.ptp(table.value) == 0
        assert f"plain {table.value[0]:.9g}" == path.read_text()
        assert load_material(path).theta_i.tolist() == [0, 30, 60]
        assert "  .plain             Plain: all else" in reading.lost_in_each()
    finally:
        monkeypatch.undo()
        reading._all.cache_clear()


# ------------------------------------------------------------------------ damaged files


def test_files_of_others_by_these_names(tmp_path):
    for name, content, message in (
        ("a.binary", b"\0" * 12, "12 bytes instead of 34992012"),
        ("a.json", b"[1, 2]", "not a JSON object"),
        ("a.json", b"[" * 100_000, "not JSON"),
        ("a.bsdf", b"type bsdf_data\nformat\n", "not a material"),
    ):
        path = tmp_path / name
        path.write_bytes(content)
        with pytest.raises(FileFormatError, match=message):
            read_scatter(path)


def test_what_the_table_of_fred_cannot_be(tmp_path):
    """Rows below the horizon are told; another quantity is refused, as of ASTM."""
    path = tmp_path / "a.txt"
    text = "type bsdf_data\nformat angles=deg\n0 0\n10 0 0.3\n100 0 0.2\n"
    path.write_text(text)
    table = gonio.read_measured(path, quantity="brdf")
    assert table.theta_o.tolist() == [10]
    assert "1 row at or below the horizon left out" in table.notes
    through = gonio.read_measured(path, quantity="btdf")
    assert (through.quantity, through.theta_o.tolist()) == ("btdf", [170])
    for name in ("a.json", "a.astm"):
        (tmp_path / name).write_text(text)
        with pytest.raises(ValueError, match=r"holds brdf, got the quantity 'btdf'"):
            gonio.read_measured(tmp_path / name, quantity="btdf")


def test_tables_of_others_without_a_row(tmp_path):
    empty = "NUM_POINTS 0\nVARS theta_i,phi_i,theta_s,phi_s,R\n"
    with pytest.raises(FileFormatError, match="has no rows of values"):
        gonio.read_measured(text_of(tmp_path, empty, "a.astm"))
    below = "type bsdf_data\nformat angles=deg bsdf=value scale=1\n30 0\n120 0 0.4\n"
    for quantity in ("brdf", "btdf"):
        with pytest.raises(FileFormatError, match="all its directions are at or below"):
            gonio.read_measured(text_of(tmp_path, below), quantity=quantity)


def test_a_logarithm_of_fred_that_is_too_large(tmp_path, recwarn):
    text = "type bsdf_data\nformat angles=deg bsdf=log scale=0\n30 0\n20 0 400\n"
    with pytest.raises(FileFormatError, match=r"value .*finite"):
        gonio.read_measured(text_of(tmp_path, text))
    assert not recwarn

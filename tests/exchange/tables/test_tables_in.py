"""Tables of measured values as people write them; real ones where they are present.

``GONIO_DATA`` names the folder of the real files of instruments and programs, by
default ``shared/data`` beside the checkout; without it their tests are skipped.
"""

import numpy as np
import pytest
from shared_data import real

import gonio_mi as gonio
from gonio_mi.cli import main
from gonio_mi.exchange.tables.names import recognised

EPS = np.finfo(float).eps


def written(tmp_path, text, name="table.txt", encoding="utf-8"):
    path = tmp_path / name
    path.write_bytes(text.encode(encoding))
    return path


# --------------------------------------------------------------------- names of columns


# Names, roles, units and coverage factors; a dash where there is none.
NAMES = """
theta_i/deg              | theta_i    | deg
θi (°)                   | theta_i    | deg
Incident_angle           | theta_i    | -
AOI                      | theta_i    | -
src_z                    | theta_i    | -
src_a                    | phi_i      | -
Viewing Zenith [deg]     | theta_o    | deg
thetaOut                 | theta_o    | -
theta_r_rad              | theta_o    | rad
phi_s                    | phi_o      | -
phi_r - phi_i            | delta_phi  | -
Relative Azimuth         | delta_phi  | -
BRDF (1/sr)              | value      | 1/sr
f_r/sr^-1                | value      | 1/sr
f_r 550 nm               | value      | -
frame                    | -          | -
theta_det                | theta_o    | -
Panel BRF                | value      | -
550nm                    | value      | -
u(BRDF) / %              | sigma      | %
uncertainty (k=2)        | sigma      | -
Wavelength [nm]          | wavelength | nm
Shifted Relative Azimuth | -          | -
Elevation                | -          | -
weight                   | -          | -
cos * BRDF               | value      | -
BRDF_1/sr                | value      | 1/sr
BRDF 1000 nm             | value      | -
BRDF [1/sr] 1000 nm      | value      | 1/sr
BRDF sample 2            | -          | -
log10 BRDF               | -          | -
ln(BRDF)                 | -          | -
BRDF (dB)                | -          | -
BRDF [mSr-1]             | value      | 1/msr
BRDF [1/msr]             | value      | 1/msr
BRDF [1/µsr]             | -          | -
BRDF - dark              | -          | -
BRDF/sigma               | -          | -
thetas_o                 | theta_o    | -
1000*BRDF                | -          | -
BRDF x 1e3               | -          | -
BRDF x 1000              | -          | -
500 x BRDF               | -          | -
BRDF·10⁻³                | -          | -
BRDF/1000                | -          | -
1/BRDF                   | -          | -
-BRDF                    | -          | -
BRDF^2                   | -          | -
BRDF (arb. units)        | -          | -
normalised BRDF          | -          | -
U95                      | sigma      | -    | 1.96
U_95                     | sigma      | -    | 1.96
U95(BRDF)                | sigma      | -    | 1.96
U_99                     | sigma      | -    | 2.576
2.5 sigma                | sigma      | -    | 2.5
1,96 σ                   | sigma      | -    | 1.96
2 std                    | sigma      | -    | 2
2SD                      | sigma      | -    | 2
2*std                    | sigma      | -    | 2
2 u(BRDF)                | sigma      | -    | 2
uncertainty k 2          | sigma      | -    | 2
uncertainty (k:2)        | sigma      | -    | 2
sigma_k2                 | sigma      | -    | 2
uncertainty (68 %)       | sigma      | -    | 1
uncertainty (95 %)       | sigma      | -    | 1.96
uncertainty (95.45 %)    | sigma      | -    | 2
uncertainty (99 %)       | sigma      | -    | 2.576
uncertainty (99.7 %)     | sigma      | -    | 3
uncertainty (99,73 %)    | sigma      | -    | 3
uncertainty [1/sr]       | sigma      | 1/sr | 1
u(550nm)                 | sigma      | -    | 1
"""


@pytest.mark.parametrize("line", NAMES.strip().splitlines())
def test_names_that_people_write(line):
    name, role, unit, *k = (part.strip() for part in line.split("|"))
    column = recognised(name)
    assert (column.role if column else "-") == role
    assert ((column and column.unit) or "-") == unit
    assert not k or column.coverage == float(*k)


# ------------------------------------------------------------------------ small tables

SAME = """theta_i/deg{0}phi_i/deg{0}theta_r/deg{0}phi_r/deg{0}BRDF [1/sr]
45{0}0{0}30{0}180{0}0{1}25
45{0}0{0}60{0}90{0}0{1}5
"""


@pytest.mark.parametrize(
    ("delimiter", "point"),
    [("\t", "."), ("\t", ","), (";", "."), (";", ","), (",", "."), ("  ", ".")],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
@pytest.mark.parametrize("title", ["", "BRF Values\nby hand – 20 °C\n"])
def test_one_table_in_many_writings(tmp_path, delimiter, point, encoding, title):
    text = SAME.format(delimiter, point)
    if delimiter == "  ":  # names of a table with blanks have none
        text = text.replace(" [1/sr]", "")
    path = written(tmp_path, title + text, encoding=encoding)
    table = gonio.read_measured(path)
    assert table.quantity == "brdf"
    assert table.value.tolist() == [0.25, 0.5]
    assert table.theta_o.tolist() == [30, 60]
    assert table.phi_o.tolist() == [180, 90]
    assert any("theta_o is 'theta_r/deg' in deg" in note for note in table.notes)


def test_columns_can_be_said(tmp_path):
    path = written(tmp_path, "a,b,c,x\n0.5,0.25,7,0.25\n1,0.5,8,0.5\n")
    with pytest.raises(gonio.FileFormatError, match="must name the columns"):
        gonio.read_measured(path)
    columns = {"theta_i": "a:rad", "theta_o": "b:rad", "value": "x", "phi_i": "0"}
    table = gonio.read_measured(
        path, quantity="brdf", columns=columns | {"phi_o": "180"}
    )
    assert np.array_equal(table.theta_i, np.degrees([0.5, 1]))
    assert table.phi_o.tolist() == [180, 180]
    for said, message in (
        ({"theta": "a"}, "columns must name theta_i"),
        ({"theta_i": "z"}, r"columns of .*table.txt \(a, b, c, x\), got 'z'"),
        ({"theta_i": "a:grad"}, "a unit such as deg or um, .*, got 'a:grad'"),
        ({"theta_i": "a:um"}, "theta_i must be in deg or rad"),
        ({"value": "x:nm"}, "value must be in 1/sr or 1/msr or % or %/sr or 1"),
        ({"sigma": "c:k="}, "of sigma rel, abs or k=2, got 'c:k='"),
    ):
        with pytest.raises(ValueError, match=message):
            gonio.read_measured(path, quantity="brdf", columns=columns | said)


def test_the_kind_of_an_uncertainty_is_noted(tmp_path):
    head = "theta_i,phi_i,theta_o,phi_o,brdf,"
    for name, kind in (("uncertainty [%]", "relative"), ("u", "absolute")):
        path = written(tmp_path, f"{head}{name}\n45,0,30,180,0.4,0.01\n")
        notes = gonio.read_measured(path).notes
        assert any(f": {kind} uncertainty" in note for note in notes)
    both = "# uncertainty: 0.02\n" + path.read_text()
    table = gonio.read_measured(written(tmp_path, both))
    assert table.bsdf_std_err[0] == pytest.approx(np.hypot(0.01, 0.008), rel=4 * EPS)
    assert "of sigma and 0.02 of each value in quadrature" in str(table)


def test_gaps_degrees_and_an_unsaid_quantity_in_our_own_columns(tmp_path):
    text = "theta_i,phi_i,theta_o,phi_o,value\n45°,0,30 °,180,0.4\n45,0,31,180,NaN\n"
    table = gonio.read_measured(written(tmp_path, text + "45,0,32,180,\n"))
    assert (table.theta_i.tolist(), table.theta_o.tolist()) == ([45], [30])
    assert "2 rows without a value left out" in table.notes
    assert any("taken as brdf in 1/sr" in note for note in table.notes)
    said = gonio.read_measured(written(tmp_path, f"# quantity: brdf\n{text}"))
    assert said.notes == ("1 row without a value left out",)


@pytest.mark.parametrize(
    ("before", "after", "got"),
    [
        ("30 °", "30°°", "column theta_o: must be a number, got '30°°'"),
        ("0.4", "0.4°", "column value: must be a number, got '0.4°'"),
        (",0.1", ",0.1 °", "column sigma: must be a number, got '0.1 °'"),
        ("y: 0.1", "y: 0.1°", "uncertainty must be a finite number .* got '0.1°'"),
    ],
)
def test_degrees_are_signs_of_angles_alone(tmp_path, before, after, got):
    """Twin: that of the angles is read, in a column and in a key."""
    text = "# aperture_half_angle: 2 °\n# scale_uncertainty: 0.1\n"
    text += "theta_i,phi_i,theta_o,phi_o,value,sigma\n45°,0,30 °,180,0.4,0.1\n"
    table = gonio.read_measured(written(tmp_path, text))
    assert (table.theta_o[0], table.value[0], table.aperture_half_angle) == (30, 0.4, 2)
    with pytest.raises(gonio.FileFormatError, match=got):
        gonio.read_measured(written(tmp_path, text.replace(before, after)))


def test_what_is_said_against_a_name_is_noted(tmp_path):
    text = "theta_i,phi_i,theta_o,phi_o,BRDF*cos\n45,0,60,180,0.2\n"
    path = written(tmp_path, text)
    assert gonio.read_measured(path).bsdf[0] == pytest.approx(0.4, rel=4 * EPS)
    table = gonio.read_measured(path, quantity="brdf")
    assert table.bsdf[0] == 0.2
    assert any(
        "are brdf, as specified" in note and "brdf_cos" in note for note in table.notes
    )


def test_a_reflectance_factor_is_saved_as_one(tmp_path):
    path = written(tmp_path, SAME.format(",", ".").replace("BRDF [1/sr]", "BRF [%]"))
    table = gonio.read_measured(path)
    table.save(tmp_path / "saved.csv")
    again = gonio.read_measured(tmp_path / "saved.csv")
    assert again.quantity == table.quantity == "reflectance_factor"
    assert again.bsdf.tolist() == table.bsdf.tolist()


def test_units_below_the_names_colours_and_gaps(tmp_path):
    text = "theta_i,phi_i,theta_t,phi_t,R,G,B\nrad,deg,deg,deg,1/sr,1/sr,1/sr\n"
    path = written(tmp_path, text + "0.5,0,150,180,1,2,3\n0.5,0,160,180,1,nan,3\n")
    table = gonio.read_measured(path, "G", quantity="btdf")
    assert table.theta_i.tolist() == [np.degrees(0.5)]
    assert (table.value.tolist(), table.channel) == ([2], "G")
    assert "1 row without a value left out" in table.notes
    with pytest.raises(ValueError, match=r"one of R, G, B: say --channel"):
        gonio.read_measured(path, quantity="btdf")
    with pytest.raises(ValueError, match=r"one of R, G, B for .*, got 'K'"):
        gonio.read_measured(path, "K", quantity="btdf")
    rows = "theta_i,phi_i,theta_r,phi_r,lambda/um,brdf\n45,0,30,180,0.45,0.1\n"
    assert gonio.read_measured(written(tmp_path, rows)).channel == "450nm"


def test_commands_take_what_the_table_leaves_open(tmp_path, capsys):
    path = written(tmp_path, "a;b;550nm\n30;30;1,0\n30;-40;1,0\n")
    command = ["compare", "diffuse:reflectance=1", str(path), "--rays", "1e5"]
    columns = ["--columns", "theta_i=a", "theta_o=b", "--azimuth", "mirror"]
    rest = ["--quantity", "reflectance_factor", "--aperture-half-angle", "5"]
    assert main([*command, *columns, *rest, "--uncertainty", "0.01"]) == 0
    said = capsys.readouterr().out
    assert "note: columns: theta_i is 'a' in deg" in said
    assert "note: numbers have decimal commas" in said
    # the same values as a BRDF are pi times as bright
    rest[1] = "brdf"
    assert main([*command, *columns, *rest, "--uncertainty", "0.01"]) == 3


def test_what_was_asked_for_can_be_said(tmp_path, capsys):
    """The answers that the questions name are enough; --theta-i leads to them."""
    path = written(tmp_path, "theta_r,phi_r,brdf\n30,0,0.3183\n40,90,0.3183\n")
    command = ["compare", "diffuse:reflectance=1", str(path), "--rays", "1e5"]
    assert main([*command, "--theta-i", "30"]) == 1
    assert "say --columns theta_i=30" in capsys.readouterr().err
    assert main(command) == 1
    said = capsys.readouterr().err
    for word in ("theta_i=30", "phi_i=0", "--azimuth", "--aperture-half-angle"):
        assert word in said
    answers = ["--columns", "theta_i=30", "phi_i=0", "--aperture-half-angle", "5"]
    assert main([*command, *answers, "--uncertainty", "0.01"]) == 0


def test_show_says_how_a_table_is_understood(tmp_path, capsys):
    path = str(written(tmp_path, SAME.format(";", ",")))
    assert main(["show", path]) == 0
    said = capsys.readouterr().out
    assert "2 of brdf" in said
    assert "aperture    not stated" in said
    assert "BSDF        0.25 to 0.5 1/sr, mean 0.375" in said
    assert "note: columns: theta_i is 'theta_i/deg' in deg" in said
    assert main(["show", path, "--json"]) == 1
    assert main(["show", f"{path}.no"]) == 1
    assert "there is no file" in capsys.readouterr().err
    assert main(["show", str(tmp_path / "a.npz"), "--channel", "x"]) == 1
    assert "--channel applies to tables" in capsys.readouterr().err


@pytest.mark.usefixtures("spectral")
def test_the_channel_of_a_table_is_the_wavelength(tmp_path):
    names = "theta_i,phi_i,theta_r,phi_r,451.5nm"
    path = written(tmp_path, f"{names}\n45,0,30,180,0.16\n")
    table = gonio.read_measured(path, quantity="brdf")
    (record,) = gonio.measure_like(
        {"type": "diffuse"}, table, aperture_half_angle=5, rays=20_000
    )
    assert record.channels == ("451.5nm",)
    assert set(gonio.compare(record, table).channel.tolist()) == {"451.5nm"}


# --------------------------------------------------------------------------- real files


def test_spectralon_as_it_was_measured():
    """Reflectance factors, referenced to NIST: 19 geometries, 11 wavelengths."""
    path = real("Spectralon_S7_BRF.txt")
    with pytest.raises(ValueError, match=r"one of 385\.65nm, 413\.91nm"):
        gonio.read_measured(path)
    table = gonio.read_measured(path, "806.19nm")
    assert (len(table), table.quantity) == (19, "reflectance_factor")
    assert (table.theta_i[0], table.theta_o[0], table.phi_o[0]) == (0, 45, 180)
    assert table.bsdf[0] == 1.019303 / np.pi
    # a published model of another panel, whose azimuths the reader asks for
    model = real("spectralon_model_BRFs.csv")
    with pytest.raises(ValueError, match="say --azimuth source"):
        gonio.read_measured(model, "800nm")
    other = gonio.read_measured(model, "800nm", azimuth="source")
    assert other.quantity == "reflectance_factor"
    assert (other.theta_i[0], other.theta_o[0], other.phi_o[0]) == (22.2, 13.7, 52.5)
    assert other.bsdf[0] == 1.09 / np.pi


def test_an_in_plane_goniometer():
    path = real("brdf_viewer_2D_data.csv")
    with pytest.raises(ValueError, match="say --quantity"):
        gonio.read_measured(path, "550nm")
    table = gonio.read_measured(path, "550", quantity="brdf", azimuth="mirror")
    assert len(table) == 329
    assert len(table.incident) == 5
    assert set((table.phi_o % 360).tolist()) == {0, 180}

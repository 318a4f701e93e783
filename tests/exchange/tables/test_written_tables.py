"""Tables as people write them, and what must be understood of each: by hand.

Each has one or two rows; what is expected is the first: incidence, exit (in degrees),
BSDF in 1/sr and its standard uncertainty. The others must be asked about.
"""

import re

import numpy as np
import pytest

import gonio_mi as gonio

EPS = np.finfo(float).eps
PI = np.pi

# The plane of incidence that most of them share: 45 degrees in, 30 out, as mirrors do.
PLANE = (45, 0, 30, 180)
HEAD = "theta_i;phi_i;theta_o;phi_o;"
ROW = "45;0;30;180;"

# Roles of which the user says the column.
SAID = "sigma", "value", "wavelength"

# Columns behind those of the plane, or, between commas, all of them, below a title and
# //; rows, where .. is the plane; what the user says; the directions, if they are
# others, BSDF and standard uncertainty.
COLUMNS = """
BRDF;uncertainty [%] (k=2) | ..0.4;5 | | 0.4, 0.01
BRDF;u(brdf) [%] (k=2) | ..0.4;5 | | 0.4, 0.01
BRDF;uncertainty (k=2, %) | ..0.4;5 | | 0.4, 0.01
BRDF;U [%] k=2 | ..0.4;5 | | 0.4, 0.01
BRDF;uncertainty, % (k=2) | ..0.4;5 | | 0.4, 0.01
BRDF;U (k = 2) / % | ..0.4;5 | | 0.4, 0.01
BRDF;k=2 uncertainty in % | ..0.4;5 | | 0.4, 0.01
BRDF;unc. [%] (k=1,96) | ..0.49;4 | | 0.49, 0.01
BRDF;uncertainty k=3 [1/sr] | ..0.4;0.03 | | 0.4, 0.01
BRDF;percent uncertainty | ..0.4;5 | | 0.4, 0.02
BRDF;uncertainty % | ..0.4;5 | | 0.4, 0.02
BRDF;uncertainty (95 %) | ..0.4;0.0196 | | 0.4, 0.01
BRDF;2 sigma | ..0.4;0.02 | | 0.4, 0.01
BRDF;BRDF 2σ [1/sr] | ..0.4;0.02 | | 0.4, 0.01
BRDF;expanded uncertainty | ..0.4;0.02 | sigma=expanded uncertainty:k=2 | 0.4, 0.01
BRDF;RSD [%] | ..0.4;5 | | 0.4, 0.02
BRDF;rel. unc. | ..0.4;0.05 | | 0.4, 0.02
BRDF;u_c / sr^-1 | ..0.4;0.02 | | 0.4, 0.02
BRDF;±BRDF | ..0.4;0.02 | | 0.4, 0.02
BRDF;std. dev. [1/sr] | ..0.4;0.02 | | 0.4, 0.02
BRDF;sigma/BRDF | ..0.4;0.05 | | 0.4, 0.02
BRDF;U(BRDF)/BRDF [%] (k=2) | ..0.4;5 | | 0.4, 0.01
BRDF;1σ [% of value] | ..0.4;5 | | 0.4, 0.02
mean BRDF;std BRDF;N | ..0.4;0.02;4 | | 0.4, 0.02
brdf [%/sr] | ..40 | | 0.4
brdf (% sr^-1) | ..40 | | 0.4
brdf [%/sr];u(brdf) [%/sr] | ..40;1 | | 0.4, 0.01
brdf [%/sr];u(brdf) [%] | ..40;5 | | 0.4, 0.02
brdf [%/sr];sigma | ..40;1 | | 0.4, 0.01
BRDF [msr^-1] | ..4e-4 | | 0.4
f_r / sr⁻¹ | ..0.4 | | 0.4
BRDF [sr^{-1}] | ..0.4 | | 0.4
BRDF [1/sr] @ 550 nm | ..0.4 | | 0.4
BRF / % | ..95 | | 0.95 / PI
BRF [1] | ..0.95 | | 0.95 / PI
550nm [%] | ..95 | quantity=reflectance_factor | 0.95 / PI
BRF [%];u(BRF) [%] | ..50;4 | sigma=u(BRF) [%]:rel | 0.5 / PI, 0.02 / PI
BRF [%];u(BRF) [%] | ..50;4 | sigma=u(BRF) [%]:abs | 0.5 / PI, 0.04 / PI
Messwert [msr^-1];u | ..4e-4;1e-5 | value=Messwert [msr^-1]; quantity=brdf | 0.4, 0.01
BRF [%];U95% | ..50;1.96 | sigma=U95%:rel | 0.5 / PI, 0.005 / PI
BRF [%];U95% | ..50;1.96 | sigma=U95%:abs | 0.5 / PI, 0.01 / PI
BRDF;U95% | ..0.4;0.0196 | sigma=U95%:abs | 0.4, 0.01
BRF | ..0.5 | panel_reflectance=0.98 | 0.49 / PI
450nm;550nm;u(450nm) [%];u(550nm) [%] (k=2) | ..0.1;0.4;1;5 | \
    channel=550nm; quantity=brdf | 0.4, 0.01
reference panel: reflectance 0.98 // BRF;u | ..0.5;0.1 | \
    panel_reflectance=0.98 | 0.49 / PI, 0.098 / PI
reference panel: reflectance 0.98 // BRF | ..0.5 | panel_reflectance=1 | 0.5 / PI
reference panel: reflectance 0.98 // BRDF | ..0.5 | | 0.5
Reflectance factors to reference panel 2, 8 deg // BRF | ..0.5 | | 0.5 / PI
all k=2 // BRDF;u_rel [%] (k=1) | ..0.4;5 | | 0.4, 0.02
Unsicherheit k=2;;;;; // BRDF;U [%] | ..0,4;5 | sigma=U [%]:k=2 | 0.4, 0.01
BRDF;U | ..0.4;0.02 | sigma=U | 0.4, 0.02
BRDF;U_90 | ..0.4;0.0329 | sigma=U_90:k=1.645 | 0.4, 0.02
BRDF;spread | ..0.4;5 | sigma=spread:% | 0.4, 0.02
Messwert | ..40 | value=Messwert:%/sr; quantity=brdf | 0.4
Spectralon 99% tile // BRDF;u | ..0.4;0.02 | | 0.4, 0.02
Reflectance factor at 633 nm // value | ..0.95 | | 0.95 / PI
brdf | 45;0;10;-999;0.1 / -99;0;10;0;0.1 / ..0.4 | | 0.4
brdf | 0;-999;30;180;0.4 | | 0, 0, 30, 180, 0.4
brdf | 45;0;30;-99;0.4 / 45;0;30;-98;0.4 | | 45, 0, 30, 261, 0.4
BRDF | 45;0;90;180;7 / 90;0;30;180;7 / ..0.4 | | 0.4
BRDF*cos(theta) | 45;0;60;180;0.2 | | 45, 0, 60, 180, 0.4
brdf | 1;0;2;3;0.4 | | 1, 0, 2, 3, 0.4
BRDF | 4.5E+01;0;3e1;1.8E2;4.0E-01 | | 0.4
BRDF [1/sr] | 45,0;0,0;30,0;180,0;0,4 | | 0.4
BRDF | 45;0;30;−180;0.4 | | 0.4
brf | 45;0;10;180;-999 / ..0.95 | | 0.95 / PI
brf | 45;0;10;180;n/a / ..0.95 | | 0.95 / PI
wavelength [µm];BRDF | ..0.55;0.4 / ..0.65;0.2 | channel=550 | 0.4
wavelength;BRDF | ..0.55;0.4 / ..0.65;0.2 | \
    channel=550nm; wavelength=wavelength:um | 0.4
wavelength;BRDF | ..550;0.4 / ..650;0.2 | channel=550nm | 0.4
BTDF | ..0.4 | | 45, 0, 150, 180, 0.4
BTDF | 45;0;150;180;0.4 | | 45, 0, 150, 180, 0.4
BRDF | 45;180;-30;180;0.4 / 45;180;30;0;0.3 | azimuth=specimen | 45, 180, 30, 0, 0.4
SZA,VZA,RAA,BRDF | 45,30,10,0.4 | azimuth=mirror | 45, 0, 30, 190, 0.4
theta_i,theta_r,phi_r - phi_i,BRDF | 45,30,170,.4 | azimuth=source | 45, 0, 30, 170, .4
theta_i,theta_o,brdf | 45,-30,0.4 / 45,30,0.1 | azimuth=source | 0.4
theta_i,theta_o,brdf | 45,-30,0.1 / 45,30,0.4 | azimuth=mirror | 45, 0, 30, 0, 0.1
theta_i,phi_i,theta_o,phi_o,value | 45,0,-30,0,0.4 / 45,0,30,0,0.1 | azimuth=source | .4
theta_i,phi_i,theta_o,phi_o,value | 45,0,-30,10,0.4 / 45,0,30,170,0.1 | | \
    45, 0, 30, 190, 0.4
theta_i,theta_r,brdf | -45,30,0.4 / -45,-30,0.1 | azimuth=mirror | 0.4
theta_i,phi_i,theta_o,phi_o,value | 45,0,9,180,-999 / 45,0,30,180,0.4 | | 0.4
theta_i,theta_r,brdf | 30,0,1 | | 30, 0, 0, 0, 1
SZA,VZA,RAA,brdf | 30,40,90,2 | azimuth=source | 30, 0, 40, 90, 2
value | 1;1;1;1;1 / 45;0;30;180;2 | | 1, 1, 1, 1, 1
BRDF;U (k=2) / % | ..0.4;2 | | 0.4, 0.004
BRDF;relative uncertainty | ..0.4;0.01 | | 0.4, 0.004
BRDF;sigma (k=1.2.3) | ..0.4;0.5 | sigma=sigma (k=1.2.3) | 0.4, 0.5
BRDF;u 2 | ..0.4;0.1 | sigma=u 2 | 0.4, 0.1
450;0.55 um | ..0.1;0.2 | channel=550nm; quantity=brdf | 0.2
"""

# Other texts, what the user says, what is understood.
MORE = [
    # a matrix
    (
        "BRDF of a tile\ntheta_o,0,45\n-30,0.1,0.4\n0,0.2,0.3\n",
        {"azimuth": "source"},
        (0, 0, 30, 180, 0.1, None),
    ),
    (
        "BRDF\ntheta_i [deg];30,0;0,5\n45,0;0,4;\n",
        {"azimuth": "mirror"},
        (*PLANE, 0.4, None),
    ),
    (
        "BRDF\ntheta_o/phi_o\t180\t270\n30\t0.4\t0.1\n",
        {"columns": {"theta_i": "45", "phi_i": "0"}},
        (*PLANE, 0.4, None),
    ),
    # radians
    (
        "theta_i [deg];phi_i [deg];theta_o [rad];phi_o [deg];BRDF\n"
        f"45;0;1.5708;180;7\n45;0;{PI / 6};180;0.4\n",
        {},
        (*PLANE, 0.4, None),
    ),
    *(
        (text, {}, (np.degrees(0.5), 0, np.degrees(1.2), np.degrees(3.1), 0.4, None))
        for text in (
            f"{HEAD.replace(';', ' [rad];')}brdf\n0.5;0;1.2;3.1;0.4\n",
            f"{HEAD}brdf\nrad;rad;rad;rad;1/sr\n0.5;0;1.2;3.1;0.4\n",
            "theta_i_rad,phi_i_rad,theta_r_rad,phi_r_rad,brdf\n0.5,0,1.2,3.1,0.4\n",
        )
    ),
    (
        "AOI,AOR,brdf\n0.5,1.2,0.4\n",
        {"columns": {"theta_i": "AOI:rad", "theta_o": "AOR:rad"}, "azimuth": "mirror"},
        (np.degrees(0.5), 0, np.degrees(1.2), 180, 0.4, None),
    ),
    (
        "theta_i [deg],phi_i [deg],theta_o [deg],phi_o [deg],brdf\n0.5,0,1.2,3.1,0.4\n",
        {},
        (0.5, 0, 1.2, 3.1, 0.4, None),
    ),
    # names of angles, in any order; cells and their separators
    *(
        (text, {}, (*PLANE, 0.4, None))
        for text in (
            "Solar Zenith [deg]\tSolar Azimuth [deg]\tViewing Zenith [deg]\t"
            "Viewing Azimuth [deg]\tBRDF (1/sr)\n45\t0\t30\t180\t0.4\n",
            f"θi (°);φi (°);θr (°);φr (°);BRDF\n{ROW}0.4\n",
            "thetaIn,phiIn,thetaOut,phiOut,BRDF\n45,0,30,180,0.4\n",
            "Angle of incidence (deg),Incident azimuth (deg),Scatter angle (deg),"
            "Scatter azimuth (deg),BRDF\n45,0,30,180,0.4\n",
            "SZA SAA VZA VAA BRDF\n45 0 30 180 0.4\n",
            "BRDF;φ_r/deg;θ_r/deg;φ_i/deg;θ_i/deg\n0.4;180;30;0;45\n",
            "#theta_i phi_i theta_o phi_o brdf\n45 0 30 180 0.4\n\n60 0 30 180 0.2\n",
            '"theta_i","phi_i","theta_o","phi_o","BRDF"\n"45","0","30","180","0.4"\n',
            "theta_i\u00a0[°];phi_i\u00a0[°];theta_o\u00a0[°];phi_o\u00a0[°];"
            f"BRDF\u00a0[1/sr]\n{ROW}0.4\n",
        )
    ),
    (
        "src_z src_a view_z view_a BRF\n45 0 30 180 0.95\n",
        {},
        (*PLANE, 0.95 / PI, None),
    ),
    *(
        (text, {}, (*PLANE, 0.4, std_err))
        for text, std_err in (
            (
                "theta_i,phi_i,theta_o,phi_o,BRDF,"
                '"uncertainty, % (k=2)"\n45,0,30,180,0.4,5\n',
                0.01,
            ),
            (
                "theta_i\tphi_i\ttheta_o\tphi_o\tbrdf\tu [%]\n45\t0\t30\t180\t0,4\t2,5",
                0.01,
            ),
            (
                "Illumination polar angle (deg);Illumination azimuth (deg);Detection "
                "polar angle (deg);Detection azimuth (deg);BRDF (sr^-1);Expanded "
                f"uncertainty (k=2) (sr^-1)\n{ROW}0.4;0.02\n",
                0.01,
            ),
            (
                "theta_i phi_i theta_r phi_r BRDF u\n(deg) (deg) (deg) (deg) (1/sr) (%)"
                "\n45 0 30 180 0.4 5\n",
                0.02,
            ),
        )
    ),
]

# The same of columns about which something is asked, and the question.
OPEN = """
BRDF;U;k | ..0.4;0.02;3 | 'U' may be expanded
BRDF_s;BRDF_p | ..0.4;0.3 | must be value .*'BRDF_s', 'BRDF_p'
BRDF;U_90 | ..0.4;0.1 | \
    'U_90' may be expanded: say --columns sigma='U_90:k=2', or sigma='U_90' if it is st
BRDF;U | ..0.4;0.02 | 'U' may be expanded: say --columns sigma='U:k=2'
BRDF;expanded uncertainty | ..0.4;0.02 | may be expanded
Unsicherheit k=2;;;;; // BRDF;U [%] | ..0,4;5 | may be expanded
wavelength;BRDF | ..0.55;0.4 / ..0.65;0.2 | \
    wavelengths up to 0.65 have no unit: say --columns wavelength=NAME:um
BRDF;u 2 | ..0.4;0.1 | 'u 2' may be expanded
BRDF;u(BRDF)*2 | ..0.4;0.1 | may be expanded
BRDF;u(BRDF)*2 (k=3) | ..0.4;0.1 | may be expanded
BRF [%];U95% | ..50;4 | sigma='U95%:rel' if it is rel
BRDF;U95% | ..0.4;4 | 'U95%' may be in %: say
BRF [%];u(BRF) [%] | ..50;4 | 'u.BRF. ...:rel' if it is rel
ΔBRDF | ..0.01 | one column must be value
u(theta_i) | ..0.01 | one column must be value
BRDF sample 2 | ..0.4 | it has 'BRDF sample 2'.: say --columns value=
GGX;Beckmann | ..0.4;0.3 | be value .it has 'GGX', 'Beckmann'.: say --columns value=NAME
550nm | ..1 | say --quantity brdf,
uncertainties with k=2 // BRDF;uncertainty | ..0.4;0.02 | \
    'uncertainty' may be expanded: .* or sigma='uncertainty' if it is standard
# k: 3 // BRDF;U | ..0.4;0.02 | 'U' may be expanded
Reflectance of the reference panel: 98,0 % // BRF;u | ..0.4;0.02 | say --panel-refl
# panel reflectance at 550 nm = 0.98 // BRF;u | ..0.4;0.02 | 1 if the values hold
value | 0.5;0;1.2;3.14159;1 | \
    polar angles up to 1.2 may be .*: say --columns theta_i='thet.* azimuths up to 3.142
theta_i,theta_r,brdf | 0.5,0,1 | say --columns theta_i='theta_i:rad'
brdf | 45;0;30;3.14159;1 | azimuths up to 3.142 may be degrees or rad
theta_i,theta_o,brdf | 45,-30,1 | angles are relative
value | 45;0;-30;0;0.4 | say --azimuth source or
theta_i,theta_r,brf,brdf | 45,0,1,1 | must be value .* say --columns value=NAM
theta_i,phi_i,brdf | 45,0,1 | say --columns theta_o=NAME
theta_i,phi_i,delta_phi,b,c | 45,0,0,0,1 | \
    open: .1. .* theta_o, one value .* theta_o=NAME value=NAME; .2. .* --quantity brdf,
theta_r,phi_r,brdf | 30,0,1 | \
    must be theta_i:.* such as theta_i=30; .2. its azimuths .* --azimuth so.* phi_i=0
theta_i,b,450nm,550nm | 45,0,1,2 | \
    channel must be one of 450nm, 550nm: .*must be theta_o .*--quantity
theta_i,theta_r,raa,550nm | 0.5,0.4,0,1 | \
    be degrees or radians: .* --quantity b.* --azimuth source
BRDF;sigma (k=1.2.3) | ..0.4;0.5 | may be expanded
450;0.55 um | ..0.1;0.2 | channel must be one of 450nm, 550nm
wavelength [um];brdf | ..0.45;1 / ..0.55;2 | channel must be one of 450nm, 550nm
SZA,VZA,RAA,brdf | 30,30,0,1 | say --azimuth source or
theta_i [%],theta_r,brdf | 45,0,1 | theta_i must be in deg or rad, got
theta_i [rad],theta_r [deg],brdf | 1°,0,1 | must be a number, got '1°'
brdf | 45;0;90;0;0.1 | has no row but those at 90 degrees
value | ..-999 | has no row but those without a value
brdf | ..0.1 / ..0.9 | theta_i 45, .* values 0.1 and 0.9: one is
brdf | 45;0;30;-180;0.1 / ..0.9 | 0.1 and 0.9: one is wrong
theta_i ['],phi_i ['],theta_o ['],phi_o ['],BRDF | 27,0,18,80,0.4 | \
    must name the columns
theta_i [mrad],theta_r,brdf | 45,0,1 | one column must be theta_i
"""

# Texts, and what the sentence says that refuses or asks.
ASKED = [
    (
        "source elevation;source azimuth;elevation out;azimuth out;BRDF\n45;0;30;180;1",
        "must be theta_i, one theta_o",
    ),
    (
        "cos(theta_i);phi_i;cos(theta_o);phi_o;BRDF\n0.7;0;0.8;180;0.4\n",
        "must be theta_i, one theta_o",
    ),
    ("a,b,c\n45,0,1\n", "say each: --columns theta_i=NAME theta_o=NAME value"),
    ("Theta measure end :\t30\nTheta Lighting\t0\n-30\t0\t0\n", "of a REFLET"),
    ("theta_i;theta_r;brdf\n45;0;x\n", "line 2, column brdf: must be a number"),
    ("theta_i;theta_r;brdf\n45;0\n", "must have 3 values separated by semicolons"),
    (
        "theta_i;theta_r;brdf;raa;phi_i\n95;0;1;0;0\n",
        "line 2, column theta_i: must be an angle in degrees",
    ),
    (
        "BRDF;0;30\n0;0.1;0.1\n",
        "line 1: the first cell of a matrix must name .* theta_o/theta_i, got 'BRDF'",
    ),
    (
        "BRDF\ntheta_o;0;30\n0;0.1;0.1\n10;0.1\n",
        "line 4: must have 3 values separated by semicolons, got 2",
    ),
    (
        "theta_i (0.1 deg);theta_r (0.1 deg);brdf;phi_i;phi_r\n45;30;1;0;180\n",
        "must be theta_i, one theta_o",
    ),
]


def read(tmp_path, text, **said):
    path = tmp_path / "table.txt"
    path.write_text(text, encoding="utf-8")
    return gonio.read_measured(path, **said)


def check(tmp_path, text, said, expected):
    """To a few roundings: conversions of units are a product or two."""
    table = read(tmp_path, text, **said)
    found = table.theta_i[0], table.phi_i[0], table.theta_o[0], table.phi_o[0] % 360
    assert found == pytest.approx(expected[:4], rel=8 * EPS)
    assert table.bsdf[0] == pytest.approx(expected[4], rel=8 * EPS)
    if expected[5] is None:
        assert table.sigma is None
    else:
        assert table.bsdf_std_err[0] == pytest.approx(expected[5], rel=8 * EPS)


def written(columns, rows):
    """Text of columns, behind those of the plane unless commas separate them."""
    *title, names = columns.split(" // ")
    head = "" if re.search("theta_.*,|SZA", names) else HEAD
    rows = rows.replace("..", ROW).split(" / ")
    return "\n".join([*title, f"{head}{names}", *rows]) + "\n"


@pytest.mark.parametrize("line", COLUMNS.strip().splitlines())
def test_what_is_understood_of_a_column(tmp_path, line):
    columns, rows, words, expected = (part.strip() for part in line.split("|"))
    said = dict(word.split("=", 1) for word in words.split("; ") if word)
    roles = {role: said.pop(role) for role in SAID if role in said}
    said |= {"columns": roles} if roles else {}
    if panel := said.get("panel_reflectance"):
        said["panel_reflectance"] = float(panel)
    numbers = [part.partition(" / PI") for part in expected.split(", ")]
    numbers = [float(one) / (PI if pi else 1) for one, pi, _ in numbers]
    if len(numbers) < 5:
        numbers = [*PLANE, *numbers]
    check(tmp_path, written(columns, rows), said, [*numbers, None][:6])


@pytest.mark.parametrize(("text", "said", "expected"), MORE)
def test_what_is_understood_of_a_table(tmp_path, text, said, expected):
    check(tmp_path, text, said, expected)


@pytest.mark.parametrize("line", OPEN.strip().splitlines())
def test_what_is_asked_about_a_column(tmp_path, line):
    columns, rows, message = (part.strip() for part in line.split("|"))
    with pytest.raises(gonio.FileFormatError, match=message):
        read(tmp_path, written(columns, rows))


@pytest.mark.parametrize(("text", "message"), ASKED)
def test_what_is_asked_about_a_table_or_refused(tmp_path, text, message):
    with pytest.raises(gonio.FileFormatError, match=message) as caught:
        read(tmp_path, text)
    assert "table.txt" in str(caught.value)


def test_repeated_directions_are_noted(tmp_path):
    """Twin of the refusal: values that agree, or whose uncertainty explains them."""
    text = f"{HEAD}brdf\n{ROW}0.50\n{ROW}0.51\n45;0;40;180;0.4\n"
    notes = read(tmp_path, text).notes
    assert any("1 direction with several values" in note for note in notes)
    text = f"{HEAD}brdf;sigma\n{ROW}0.1;0.2\n{ROW}0.9;0.2\n"
    assert len(read(tmp_path, text)) == 2


def test_rows_without_an_angle_are_counted(tmp_path):
    text = f"{HEAD}brdf\n45;0;10;-999;0.1\n45;0;10;-9999;0.1\n{ROW}0.4\n"
    note = "2 rows without another number than the value left out: -999, -9999"
    assert any(one.startswith(note) for one in read(tmp_path, text).notes)
    with pytest.raises(ValueError, match="no row but those without another number"):
        read(tmp_path, f"{HEAD}brdf\n45;0;10;-999;0.1\n")


def test_rows_at_90_degrees_are_counted(tmp_path):
    """Twin: 89.99 degrees is no horizon, and 91 is refused."""
    rows = f"45;0;90;0;0.1\n45;0;89.99;0;0.1\n{ROW}0.4\n"
    table = read(tmp_path, f"{HEAD}brdf\n{rows}")
    assert table.theta_o.tolist() == [89.99, 30]
    assert "1 row at 90 degrees left out" in table.notes
    with pytest.raises(ValueError, match=r"line 2, column theta_o: .* got 91"):
        read(tmp_path, f"{HEAD}brdf\n{rows.replace('90', '91')}")


def test_every_value_of_a_matrix_has_its_angles(tmp_path):
    """Value 10 row + column; twin: turned round, both are exchanged."""
    text = "BRDF\ntheta_{},10,20,30\n40,41,42,43\n50,51,,53\n"
    for corner, down, across in (
        ("o", "theta_o", "theta_i"),
        ("i", "theta_i", "theta_o"),
    ):
        table = read(tmp_path, text.format(corner), azimuth="mirror")
        expected = getattr(table, down) + getattr(table, across) / 10
        assert table.value.tolist() == expected.tolist() == [41, 42, 43, 51, 53]


def test_a_panel_is_counted_once_in_a_saved_table(tmp_path):
    text = f"# panel_reflectance: 0.98\n{HEAD}BRF\n{ROW}0.5\n"
    table = read(tmp_path, text, panel_reflectance=0.98)
    assert any("times 0.98" in note for note in table.notes)
    table.save(tmp_path / "saved.csv")
    again = gonio.read_measured(tmp_path / "saved.csv")
    assert again.value.tolist() == table.value.tolist() == [0.5 * 0.98]
    for panel in (0, -1, 3):
        with pytest.raises(ValueError, match="panel_reflectance must be a number"):
            read(tmp_path, f"{HEAD}BRF\n{ROW}0.5\n", panel_reflectance=panel)

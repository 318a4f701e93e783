"""Tables as people write them, and what must be understood of each: by hand.

Each has one or two rows; what is expected is the first: incidence, exit (in degrees),
BSDF in 1/sr and its standard uncertainty. The others must be asked about.
"""

import numpy as np
import pytest

import gonio_mi as gonio
from gonio_mi.exchange.tables.names import recognised

EPS = np.finfo(float).eps
PI = np.pi

# The plane of incidence that most of them share: 45 degrees in, 30 out, as mirrors do.
PLANE = (45, 0, 30, 180)
HEAD = "theta_i;phi_i;theta_o;phi_o;"
ROW = "45;0;30;180;"

# name: text, what the user says, what is understood
UNDERSTOOD = {
    # per cent, coverage, order of words
    "% then k": (
        f"{HEAD}BRDF;uncertainty [%] (k=2)\n{ROW}0.4;5\n",
        {},
        (*PLANE, 0.4, 0.01),
    ),
    "u of brdf": (
        f"{HEAD}BRDF;u(brdf) [%] (k=2)\n{ROW}0.4;5\n",
        {},
        (*PLANE, 0.4, 0.01),
    ),
    "k then %": (
        f"{HEAD}BRDF;uncertainty (k=2, %)\n{ROW}0.4;5\n",
        {},
        (*PLANE, 0.4, 0.01),
    ),
    "k behind": (f"{HEAD}BRDF;U [%] k=2\n{ROW}0.4;5\n", {}, (*PLANE, 0.4, 0.01)),
    "comma": (
        f"{HEAD}BRDF;uncertainty, % (k=2)\n{ROW}0.4;5\n",
        {},
        (*PLANE, 0.4, 0.01),
    ),
    "quoted comma": (
        'theta_i,phi_i,theta_o,phi_o,BRDF,"uncertainty, % (k=2)"\n45,0,30,180,0.4,5\n',
        {},
        (*PLANE, 0.4, 0.01),
    ),
    "k with blanks": (
        f"{HEAD}BRDF;U (k = 2) / %\n{ROW}0.4;5\n",
        {},
        (*PLANE, 0.4, 0.01),
    ),
    "k first": (
        f"{HEAD}BRDF;k=2 uncertainty in %\n{ROW}0.4;5\n",
        {},
        (*PLANE, 0.4, 0.01),
    ),
    "k of 1.96": (
        f"{HEAD}BRDF;unc. [%] (k=1,96)\n{ROW}0.49;4\n",
        {},
        (*PLANE, 0.49, 0.01),
    ),
    "k = 3": (
        f"{HEAD}BRDF;uncertainty k=3 [1/sr]\n{ROW}0.4;0.03\n",
        {},
        (*PLANE, 0.4, 0.01),
    ),
    "percent, a word": (
        f"{HEAD}BRDF;percent uncertainty\n{ROW}0.4;5\n",
        {},
        (*PLANE, 0.4, 0.02),
    ),
    "% alone": (f"{HEAD}BRDF;uncertainty %\n{ROW}0.4;5\n", {}, (*PLANE, 0.4, 0.02)),
    "level, no unit": (
        f"{HEAD}BRDF;uncertainty (95 %)\n{ROW}0.4;0.0196\n",
        {},
        (*PLANE, 0.4, 0.01),
    ),
    "two sigma": (f"{HEAD}BRDF;2 sigma\n{ROW}0.4;0.02\n", {}, (*PLANE, 0.4, 0.01)),
    "two σ in 1/sr": (
        f"{HEAD}BRDF;BRDF 2σ [1/sr]\n{ROW}0.4;0.02\n",
        {},
        (*PLANE, 0.4, 0.01),
    ),
    "expanded": (
        f"{HEAD}BRDF;expanded uncertainty\n{ROW}0.4;0.02\n",
        {},
        (*PLANE, 0.4, 0.01),
    ),
    "no value of an angle": (
        f"{HEAD}brdf\n45;0;10;-999;0.1\n-99;0;10;0;0.1\n{ROW}0.4\n",
        {},
        (*PLANE, 0.4, None),
    ),
    "no azimuth at the normal": (
        f"{HEAD}brdf\n0;-999;30;180;0.4\n",
        {},
        (0, 0, 30, 180, 0.4, None),
    ),
    "-99 among negative azimuths": (
        f"{HEAD}brdf\n45;0;30;-99;0.4\n45;0;30;-98;0.4\n",
        {},
        (45, 0, 30, 261, 0.4, None),
    ),
    "rsd": (f"{HEAD}BRDF;RSD [%]\n{ROW}0.4;5\n", {}, (*PLANE, 0.4, 0.02)),
    "relative, no unit": (
        f"{HEAD}BRDF;rel. unc.\n{ROW}0.4;0.05\n",
        {},
        (*PLANE, 0.4, 0.02),
    ),
    "absolute in 1/sr": (
        f"{HEAD}BRDF;u_c / sr^-1\n{ROW}0.4;0.02\n",
        {},
        (*PLANE, 0.4, 0.02),
    ),
    "plus minus": (f"{HEAD}BRDF;±BRDF\n{ROW}0.4;0.02\n", {}, (*PLANE, 0.4, 0.02)),
    "std dev": (
        f"{HEAD}BRDF;std. dev. [1/sr]\n{ROW}0.4;0.02\n",
        {},
        (*PLANE, 0.4, 0.02),
    ),
    # values
    "% per sr": (f"{HEAD}brdf [%/sr]\n{ROW}40\n", {}, (*PLANE, 0.4, None)),
    "% sr^-1": (f"{HEAD}brdf (% sr^-1)\n{ROW}40\n", {}, (*PLANE, 0.4, None)),
    "% per sr, and its u": (
        f"{HEAD}brdf [%/sr];u(brdf) [%/sr]\n{ROW}40;1\n",
        {},
        (*PLANE, 0.4, 0.01),
    ),
    "% per sr, and u in %": (
        f"{HEAD}brdf [%/sr];u(brdf) [%]\n{ROW}40;5\n",
        {},
        (*PLANE, 0.4, 0.02),
    ),
    "% per sr, and a bare u": (
        f"{HEAD}brdf [%/sr];sigma\n{ROW}40;1\n",
        {},
        (*PLANE, 0.4, 0.01),
    ),
    "wavelength in %": (
        f"{HEAD}550nm [%]\n{ROW}95\n",
        {"quantity": "reflectance_factor"},
        (*PLANE, 0.95 / PI, None),
    ),
    "BRF %": (f"{HEAD}BRF / %\n{ROW}95\n", {}, (*PLANE, 0.95 / PI, None)),
    "BRF of one": (f"{HEAD}BRF [1]\n{ROW}0.95\n", {}, (*PLANE, 0.95 / PI, None)),
    "relative of both %": (
        f"{HEAD}BRF [%];u(BRF) [%]\n{ROW}50;4\n",
        {"columns": {"sigma": "u(BRF) [%]:rel"}},
        (*PLANE, 0.5 / PI, 0.02 / PI),
    ),
    "absolute of both %": (
        f"{HEAD}BRF [%];u(BRF) [%]\n{ROW}50;4\n",
        {"columns": {"sigma": "u(BRF) [%]:abs"}},
        (*PLANE, 0.5 / PI, 0.04 / PI),
    ),
    "per millisteradian": (
        f"{HEAD}BRDF [msr^-1]\n{ROW}4e-4\n",
        {},
        (*PLANE, 0.4, None),
    ),
    "per millisteradian, as said": (
        f"{HEAD}Messwert [msr^-1];u\n{ROW}4e-4;1e-5\n",
        {"columns": {"value": "Messwert [msr^-1]"}, "quantity": "brdf"},
        (*PLANE, 0.4, 0.01),
    ),
    "a level in %, relative": (
        f"{HEAD}BRF [%];U95%\n{ROW}50;1.96\n",
        {"columns": {"sigma": "U95%:rel"}},
        (*PLANE, 0.5 / PI, 0.005 / PI),
    ),
    "a level in %, absolute": (
        f"{HEAD}BRF [%];U95%\n{ROW}50;1.96\n",
        {"columns": {"sigma": "U95%:abs"}},
        (*PLANE, 0.5 / PI, 0.01 / PI),
    ),
    "a level in %, absolute of 1/sr": (
        f"{HEAD}BRDF;U95%\n{ROW}0.4;0.0196\n",
        {"columns": {"sigma": "U95%:abs"}},
        (*PLANE, 0.4, 0.01),
    ),
    "at 90 degrees": (
        f"{HEAD}BRDF\n45;0;90;180;7\n90;0;30;180;7\n{ROW}0.4\n",
        {},
        (*PLANE, 0.4, None),
    ),
    "at 1.5708 rad": (
        "theta_i [deg];phi_i [deg];theta_o [rad];phi_o [deg];BRDF\n"
        f"45;0;1.5708;180;7\n45;0;{PI / 6};180;0.4\n",
        {},
        (*PLANE, 0.4, None),
    ),
    "a panel that is said": (
        f"{HEAD}BRF\n{ROW}0.5\n",
        {"panel_reflectance": 0.98},
        (*PLANE, 0.49 / PI, None),
    ),
    "a panel in the title": (
        f"Reflectance of the reference panel: 98,0 %\n{HEAD}BRF;u\n{ROW}0.5;0.1\n",
        {},
        (*PLANE, 0.49 / PI, 0.098 / PI),
    ),
    "a panel in a comment, at a wavelength": (
        f"# panel reflectance at 550 nm = 0.98\n{HEAD}BRF\n{ROW}0.5\n",
        {},
        (*PLANE, 0.49 / PI, None),
    ),
    "a panel in the title, counted already": (
        f"reference panel: reflectance 0.98\n{HEAD}BRF\n{ROW}0.5\n",
        {"panel_reflectance": 1},
        (*PLANE, 0.5 / PI, None),
    ),
    "a BRDF needs no panel": (
        f"reference panel: reflectance 0.98\n{HEAD}BRDF\n{ROW}0.5\n",
        {},
        (*PLANE, 0.5, None),
    ),
    "a panel of a number": (
        f"Reflectance factors to reference panel 2, 8 deg\n{HEAD}BRF\n{ROW}0.5\n",
        {},
        (*PLANE, 0.5 / PI, None),
    ),
    "a matrix": (
        "BRDF of a tile\ntheta_o,0,45\n-30,0.1,0.4\n0,0.2,0.3\n",
        {"azimuth": "source"},
        (0, 0, 30, 180, 0.1, None),
    ),
    "a matrix of rows of incidence": (
        "BRDF\ntheta_i [deg];30,0;0,5\n45,0;0,4;\n",
        {"azimuth": "mirror"},
        (45, 0, 30, 180, 0.4, None),
    ),
    "a matrix of both names": (
        "BRDF\ntheta_o/phi_o\t180\t270\n30\t0.4\t0.1\n",
        {"columns": {"theta_i": "45", "phi_i": "0"}},
        (*PLANE, 0.4, None),
    ),
    "cosine": (
        f"{HEAD}BRDF*cos(theta)\n45;0;60;180;0.2\n",
        {},
        (45, 0, 60, 180, 0.4, None),
    ),
    "f_r": (f"{HEAD}f_r / sr⁻¹\n{ROW}0.4\n", {}, (*PLANE, 0.4, None)),
    "braces": (f"{HEAD}BRDF [sr^{{-1}}]\n{ROW}0.4\n", {}, (*PLANE, 0.4, None)),
    # radians
    "rad in brackets": (
        "theta_i [rad];phi_i [rad];theta_o [rad];phi_o [rad];brdf\n"
        "0.5;0;1.2;3.14159;0.4\n",
        {},
        (np.degrees(0.5), 0, np.degrees(1.2), np.degrees(3.14159), 0.4, None),
    ),
    "rad below": (
        "theta_i;phi_i;theta_o;phi_o;brdf\nrad;rad;rad;rad;1/sr\n0.5;0;1.2;3.14159;0.4\n",
        {},
        (np.degrees(0.5), 0, np.degrees(1.2), np.degrees(3.14159), 0.4, None),
    ),
    "rad behind": (
        "theta_i_rad,phi_i_rad,theta_r_rad,phi_r_rad,brdf\n0.5,0,1.2,3.14159,0.4\n",
        {},
        (np.degrees(0.5), 0, np.degrees(1.2), np.degrees(3.14159), 0.4, None),
    ),
    "rad as said": (
        "AOI,AOR,brdf\n0.5,1.2,0.4\n",
        {"columns": {"theta_i": "AOI:rad", "theta_o": "AOR:rad"}, "azimuth": "mirror"},
        (np.degrees(0.5), 0, np.degrees(1.2), 180, 0.4, None),
    ),
    "small degrees": (
        "theta_i [deg],phi_i [deg],theta_o [deg],phi_o [deg],brdf\n"
        "0.5,0,1.2,3.14159,0.4\n",
        {},
        (0.5, 0, 1.2, 3.14159, 0.4, None),
    ),
    "whole degrees": (f"{HEAD}brdf\n1;0;2;3;0.4\n", {}, (1, 0, 2, 3, 0.4, None)),
    # names of angles
    "zenith": (
        "Solar Zenith [deg]\tSolar Azimuth [deg]\tViewing Zenith [deg]\t"
        "Viewing Azimuth [deg]\tBRDF (1/sr)\n45\t0\t30\t180\t0.4\n",
        {},
        (*PLANE, 0.4, None),
    ),
    "letters": (
        "src_z src_a view_z view_a BRF\n45 0 30 180 0.95\n",
        {},
        (*PLANE, 0.95 / PI, None),
    ),
    "greek": (
        "θi (°);φi (°);θr (°);φr (°);BRDF\n45;0;30;180;0.4\n",
        {},
        (*PLANE, 0.4, None),
    ),
    "camel": (
        "thetaIn,phiIn,thetaOut,phiOut,BRDF\n45,0,30,180,0.4\n",
        {},
        (*PLANE, 0.4, None),
    ),
    "words": (
        "Angle of incidence (deg),Incident azimuth (deg),Scatter angle (deg),"
        "Scatter azimuth (deg),BRDF\n45,0,30,180,0.4\n",
        {},
        (*PLANE, 0.4, None),
    ),
    "satellites": ("SZA SAA VZA VAA BRDF\n45 0 30 180 0.4\n", {}, (*PLANE, 0.4, None)),
    "any order": (
        "BRDF;φ_r/deg;θ_r/deg;φ_i/deg;θ_i/deg\n0.4;180;30;0;45\n",
        {},
        (*PLANE, 0.4, None),
    ),
    "relative azimuth": (
        "SZA,VZA,RAA,BRDF\n45,30,10,0.4\n",
        {"azimuth": "mirror"},
        (45, 0, 30, 190, 0.4, None),
    ),
    "difference of azimuths": (
        "theta_i,theta_r,phi_r - phi_i,BRDF\n45,30,170,0.4\n",
        {"azimuth": "source"},
        (45, 0, 30, 170, 0.4, None),
    ),
    # signs
    "signed in the plane": (
        "theta_i,theta_o,brdf\n45,-30,0.4\n45,30,0.1\n",
        {"azimuth": "source"},
        (45, 0, 30, 180, 0.4, None),
    ),
    "signed, mirror positive": (
        "theta_i,theta_o,brdf\n45,-30,0.1\n45,30,0.4\n",
        {"azimuth": "mirror"},
        (45, 0, 30, 0, 0.1, None),
    ),
    "signed with azimuths of nought": (
        "theta_i,phi_i,theta_o,phi_o,value\n45,0,-30,0,0.4\n45,0,30,0,0.1\n",
        {"azimuth": "source"},
        (45, 0, 30, 180, 0.4, None),
    ),
    "signed with azimuths": (
        "theta_i,phi_i,theta_o,phi_o,value\n45,0,-30,10,0.4\n45,0,30,170,0.1\n",
        {},
        (45, 0, 30, 190, 0.4, None),
    ),
    "the source has the minus": (
        "theta_i,theta_r,brdf\n-45,30,0.4\n-45,-30,0.1\n",
        {"azimuth": "mirror"},
        (45, 0, 30, 180, 0.4, None),
    ),
    # numbers
    "decimal commas": (
        f"{HEAD}BRDF [1/sr]\n45,0;0,0;30,0;180,0;0,4\n",
        {},
        (*PLANE, 0.4, None),
    ),
    "commas and tabs": (
        "theta_i\tphi_i\ttheta_o\tphi_o\tbrdf\tu [%]\n45\t0\t30\t180\t0,4\t2,5\n",
        {},
        (*PLANE, 0.4, 0.01),
    ),
    "exponents": (
        f"{HEAD}BRDF\n4.5E+01;0;3e1;1.8E2;4.0E-01\n",
        {},
        (*PLANE, 0.4, None),
    ),
    "gaps": (
        f"{HEAD}brf\n45;0;10;180;-999\n{ROW}0.95\n",
        {},
        (*PLANE, 0.95 / PI, None),
    ),
    "gaps among ours": (
        "theta_i,phi_i,theta_o,phi_o,value\n45,0,9,180,-999\n45,0,30,180,0.4\n",
        {},
        (*PLANE, 0.4, None),
    ),
    "more gaps": (
        f"{HEAD}brf\n45;0;10;180;n/a\n{ROW}0.95\n",
        {},
        (*PLANE, 0.95 / PI, None),
    ),
    # wavelengths, transmission
    "channel and its u": (
        f"{HEAD}450nm;550nm;u(450nm) [%];u(550nm) [%] (k=2)\n{ROW}0.1;0.4;1;5\n",
        {"channel": "550nm", "quantity": "brdf"},
        (*PLANE, 0.4, 0.01),
    ),
    "BRDF at nm": (f"{HEAD}BRDF [1/sr] @ 550 nm\n{ROW}0.4\n", {}, (*PLANE, 0.4, None)),
    "micrometres": (
        f"{HEAD}wavelength [µm];BRDF\n{ROW}0.55;0.4\n{ROW}0.65;0.2\n",
        {"channel": "550"},
        (*PLANE, 0.4, None),
    ),
    "BTDF from its own normal": (
        f"{HEAD}BTDF\n{ROW}0.4\n",
        {},
        (45, 0, 150, 180, 0.4, None),
    ),
    "BTDF from the lit normal": (
        f"{HEAD}BTDF\n45;0;150;180;0.4\n",
        {},
        (45, 0, 150, 180, 0.4, None),
    ),
    # of standards laboratories, spreadsheets, programs
    "u per value": (f"{HEAD}BRDF;sigma/BRDF\n{ROW}0.4;0.05\n", {}, (*PLANE, 0.4, 0.02)),
    "u per value in %": (
        f"{HEAD}BRDF;U(BRDF)/BRDF [%] (k=2)\n{ROW}0.4;5\n",
        {},
        (*PLANE, 0.4, 0.01),
    ),
    "% of value": (
        f"{HEAD}BRDF;1σ [% of value]\n{ROW}0.4;5\n",
        {},
        (*PLANE, 0.4, 0.02),
    ),
    "k in the title and in the name": (
        f"all k=2\n{HEAD}BRDF;u_rel [%] (k=1)\n{ROW}0.4;5\n",
        {},
        (*PLANE, 0.4, 0.02),
    ),
    "k in the title as of U": (
        f"Unsicherheit k=2;;;;;\n{HEAD}BRDF;U [%]\n45;0;30;180;0,4;5\n",
        {},
        (*PLANE, 0.4, 0.01),
    ),
    "a reflectance in the title is no level": (
        f"Spectralon 99% tile\n{HEAD}BRDF;u\n{ROW}0.4;0.02\n",
        {},
        (*PLANE, 0.4, 0.02),
    ),
    "whole words": (
        "Illumination polar angle (deg);Illumination azimuth (deg);Detection polar "
        "angle (deg);Detection azimuth (deg);BRDF (sr^-1);Expanded uncertainty (k=2) "
        f"(sr^-1)\n{ROW}0.4;0.02\n",
        {},
        (*PLANE, 0.4, 0.01),
    ),
    "mean and std": (
        f"{HEAD}mean BRDF;std BRDF;N\n{ROW}0.4;0.02;4\n",
        {},
        (*PLANE, 0.4, 0.02),
    ),
    "degrees and radians": (
        f"theta_i [deg],phi_i [deg],theta_o [rad],phi_o [rad],BRDF\n"
        f"45,0,{PI / 6},{PI},0.4\n",
        {},
        (*PLANE, 0.4, None),
    ),
    "units below in brackets": (
        "theta_i phi_i theta_r phi_r BRDF u\n(deg) (deg) (deg) (deg) (1/sr) (%)\n"
        "45 0 30 180 0.4 5\n",
        {},
        (*PLANE, 0.4, 0.02),
    ),
    "names in a comment, blocks": (
        "#theta_i phi_i theta_o phi_o brdf\n45 0 30 180 0.4\n\n60 0 30 180 0.2\n",
        {},
        (*PLANE, 0.4, None),
    ),
    "quoted cells": (
        '"theta_i","phi_i","theta_o","phi_o","BRDF"\n"45","0","30","180","0.4"\n',
        {},
        (*PLANE, 0.4, None),
    ),
    "blanks that do not break": (
        "theta_i\u00a0[°];phi_i\u00a0[°];theta_o\u00a0[°];phi_o\u00a0[°];"
        f"BRDF\u00a0[1/sr]\n{ROW}0.4\n",
        {},
        (*PLANE, 0.4, None),
    ),
    "a minus sign": (f"{HEAD}BRDF\n45;0;30;\u2212180;0.4\n", {}, (*PLANE, 0.4, None)),
    "signs and azimuths of both sides": (
        f"{HEAD}BRDF\n45;180;-30;180;0.4\n45;180;30;0;0.3\n",
        {"azimuth": "specimen"},
        (45, 180, 30, 0, 0.4, None),
    ),
    "micrometres without a unit": (
        f"{HEAD}wavelength;BRDF\n{ROW}0.55;0.4\n{ROW}0.65;0.2\n",
        {"channel": "550nm"},
        (*PLANE, 0.4, None),
    ),
    "our names, another title": (
        "Reflectance factor at 633 nm\ntheta_i,phi_i,theta_o,phi_o,value\n"
        "45,0,30,180,0.95\n",
        {},
        (*PLANE, 0.95 / PI, None),
    ),
}

ASKED = {
    "k in the title": (
        f"uncertainties with k=2\n{HEAD}BRDF;uncertainty\n{ROW}0.4;0.02\n",
        "'uncertainty' may be expanded: .* say --columns sigma='uncertainty' if it is",
    ),
    "another k in the title": (
        f"# k: 3\n{HEAD}BRDF;U\n{ROW}0.4;0.03\n",
        "'U' may be expanded",
    ),
    "a column of k": (f"{HEAD}BRDF;U;k\n{ROW}0.4;0.02;3\n", "'U' may be expanded"),
    "polarisation": (
        f"{HEAD}BRDF_s;BRDF_p\n{ROW}0.4;0.3\n",
        "must be value .*'BRDF_s', 'BRDF_p'",
    ),
    "elevations": (
        "source elevation;source azimuth;detector elevation;detector azimuth;BRDF\n"
        f"{ROW}0.4\n",
        "must be theta_i, one theta_o",
    ),
    "cosines": (
        "cos(theta_i);phi_i;cos(theta_o);phi_o;BRDF\n0.7;0;0.8;180;0.4\n",
        "must be theta_i, one theta_o",
    ),
    "radians without a unit": (
        "theta_i,phi_i,theta_o,phi_o,value\n0.5,0,1.2,3.14159\n".replace(
            "59\n", "59,1\n"
        ),
        "angles up to 3.142 may be degrees or radians: say --columns theta_i='theta_i:",
    ),
    "radians, one of them": (
        "theta_i,theta_r,brdf\n0.5,0,1\n",
        "polar angles up to 0.5 may be degrees or",
    ),
    "azimuths in radians": (
        f"{HEAD}brdf\n45;0;30;3.14159;1\n",
        "azimuths up to 3.142 may be degrees or rad",
    ),
    "a level that is unknown": (
        f"{HEAD}BRDF;U_90\n{ROW}0.4;0.1\n",
        "'U_90' may be expanded: .* such as k=2, or say --columns sigma='U_90' if",
    ),
    "a number beside u": (f"{HEAD}BRDF;u 2\n{ROW}0.4;0.1\n", "'u 2' may be expand"),
    "U95% of %": (f"{HEAD}BRF [%];U95%\n{ROW}50;4\n", "sigma='U95%:rel' if it is rel"),
    "U95% of a BRDF": (f"{HEAD}BRDF;U95%\n{ROW}0.4;4\n", "'U95%' may be in %: say"),
    "% of %": (
        f"{HEAD}BRF [%];u(BRF) [%]\n{ROW}50;4\n",
        "'u.BRF. ...:rel' if it is rel",
    ),
    "signs without a side": ("theta_i,theta_o,brdf\n45,-30,1\n", "angles are relative"),
    "signs, azimuths of nought": (
        "theta_i,phi_i,theta_o,phi_o,value\n45,0,-30,0,0.4\n",
        "say --azimuth source or",
    ),
    "a difference beside": (f"{HEAD}ΔBRDF\n{ROW}0.01\n", "one column must be value"),
    "u of an angle": (f"{HEAD}u(theta_i)\n{ROW}0.01\n", "one column must be value"),
    "one column per model": (
        "theta_i,phi_i,theta_o,phi_o,GGX,Beckmann\n45,0,30,180,0.4,0.3\n",
        "be value .it has 'GGX', 'Beckmann'.: say --columns value=NAME",
    ),
    "values of no name": ("theta_i,theta_r,550nm\n45,0,1\n", "say --quantity brdf,"),
}

REFUSED = {
    "90 degrees alone": (
        f"{HEAD}brdf\n45;0;90;0;0.1\n",
        "no row below 90 degrees",
    ),
    "a matrix of nothing": (
        "BRDF;0;30\n0;0.1;0.1\n",
        "line 1: the first cell of a matrix must name .* theta_o/theta_i, got 'BRDF'",
    ),
    "a matrix with a short row": (
        "BRDF\ntheta_o;0;30\n0;0.1;0.1\n10;0.1\n",
        "line 4: must have 3 values separated by semicolons, got 2",
    ),
    "no value among ours": (
        "theta_i,phi_i,theta_o,phi_o,value\n45,0,30,180,-999\n",
        "has no row with a value",
    ),
    "twice, and not alike": (
        f"{HEAD}brdf\n{ROW}0.1\n{ROW}0.9\n",
        "theta_i 45, .* the values 0.1 and 0.9: one is",
    ),
    "twice, in another turn": (
        f"{HEAD}brdf\n45;0;30;-180;0.1\n{ROW}0.9\n",
        "0.1 and 0.9: one is wrong",
    ),
    "arc minutes": (
        "theta_i ['],phi_i ['],theta_o ['],phi_o ['],BRDF\n27,0,18,80,0.4\n",
        "must name the columns",
    ),
    "tenths of a degree": (
        "theta_i (0.1 deg);theta_r (0.1 deg);brdf;phi_i;phi_r\n45;30;1;0;180\n",
        "must be theta_i, one theta_o",
    ),
    "milliradians": (
        "theta_i [mrad],theta_r,brdf\n45,0,1\n",
        "one column must be theta_i",
    ),
}


def read(tmp_path, text, **said):
    path = tmp_path / "table.txt"
    path.write_text(text, encoding="utf-8")
    return gonio.read_measured(path, **said)


@pytest.mark.parametrize("name", UNDERSTOOD)
def test_what_is_understood_of_a_table(tmp_path, name):
    """To a few roundings: conversions of units are a product or two."""
    text, said, expected = UNDERSTOOD[name]
    table = read(tmp_path, text, **said)
    found = table.theta_i[0], table.phi_i[0], table.theta_o[0], table.phi_o[0] % 360
    assert found == pytest.approx(expected[:4], rel=8 * EPS)
    assert table.bsdf[0] == pytest.approx(expected[4], rel=8 * EPS)
    if expected[5] is None:
        assert table.sigma is None
    else:
        assert table.bsdf_std_err[0] == pytest.approx(expected[5], rel=8 * EPS)


@pytest.mark.parametrize("name", ASKED)
def test_what_is_asked_about_a_table(tmp_path, name):
    text, question = ASKED[name]
    with pytest.raises(gonio.FileFormatError, match=question):
        read(tmp_path, text)


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_refused_of_a_table(tmp_path, name):
    text, message = REFUSED[name]
    with pytest.raises(gonio.FileFormatError, match=message):
        read(tmp_path, text)


def test_there_are_seventy_tables():
    assert len(UNDERSTOOD) >= 70


def test_repeated_directions_are_noted(tmp_path):
    """Twin of the refusal: values that agree, or whose uncertainty explains them."""
    text = f"{HEAD}brdf\n{ROW}0.50\n{ROW}0.51\n45;0;40;180;0.4\n"
    notes = read(tmp_path, text).notes
    assert any("1 direction with several values" in note for note in notes)
    text = f"{HEAD}brdf;sigma\n{ROW}0.1;0.2\n{ROW}0.9;0.2\n"
    assert len(read(tmp_path, text)) == 2


@pytest.mark.parametrize(
    ("name", "k"),
    [
        ("U95", 1.96),
        ("U_95", 1.96),
        ("U95(BRDF)", 1.96),
        ("U_99", 2.576),
        ("2.5 sigma", 2.5),
        ("1,96 σ", 1.96),
        ("2 std", 2),
        ("2SD", 2),
        ("2*std", 2),
        ("2 u(BRDF)", 2),
        ("u(BRDF)*2", 2),
        ("u(BRDF) × 2 [1/sr]", 2),
        ("uncertainty k 2", 2),
        ("uncertainty (k:2)", 2),
        ("sigma_k2", 2),
        ("uncertainty (68 %)", 1),
        ("uncertainty (95 %)", 1.96),
        ("uncertainty (95.45 %)", 2),
        ("uncertainty (99 %)", 2.576),
        ("uncertainty (99.7 %)", 3),
        ("uncertainty (99,73 %)", 3),
        ("uncertainty [1/sr]", 1),
        ("u(550nm)", 1),
    ],
)
def test_coverage_in_names_of_uncertainties(name, k):
    column = recognised(name)
    assert (column.role, column.coverage) == ("sigma", k)


def test_a_number_in_a_name_that_is_said_to_be_standard(tmp_path):
    text = f"{HEAD}BRDF;u 2\n{ROW}0.4;0.1\n"
    assert read(tmp_path, text, columns={"sigma": "u 2"}).sigma.tolist() == [0.1]


def test_rows_without_an_angle_are_counted(tmp_path):
    text = f"{HEAD}brdf\n45;0;10;-999;0.1\n45;0;10;-9999;0.1\n{ROW}0.4\n"
    note = "2 rows without another number than the value left out: -999, -9999"
    assert any(one.startswith(note) for one in read(tmp_path, text).notes)
    with pytest.raises(ValueError, match="no row without a missing number"):
        read(tmp_path, f"{HEAD}brdf\n45;0;10;-999;0.1\n")


def test_rows_at_90_degrees_are_counted(tmp_path):
    """Twin: 89.99 degrees is no horizon, and 91 is refused."""
    rows = f"45;0;90;0;0.1\n45;0;89.99;0;0.1\n{ROW}0.4\n"
    table = read(tmp_path, f"{HEAD}brdf\n{rows}")
    assert table.theta_o.tolist() == [89.99, 30]
    assert "1 of 3 rows, at 90 degrees, left out" in table.notes
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
    table = read(tmp_path, f"# panel_reflectance: 0.98\n{HEAD}BRF\n{ROW}0.5\n")
    assert any("times 0.98" in note for note in table.notes)
    table.save(tmp_path / "saved.csv")
    again = gonio.read_measured(tmp_path / "saved.csv")
    assert again.value.tolist() == table.value.tolist() == [0.5 * 0.98]
    for panel in (0, -1, 3):
        with pytest.raises(ValueError, match="panel_reflectance must be a number"):
            read(tmp_path, f"{HEAD}BRF\n{ROW}0.5\n", panel_reflectance=panel)

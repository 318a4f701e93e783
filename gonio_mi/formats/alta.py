"""Data files of ALTA, which are recognised and refused."""

import re

from .format import Format

FORMATS = (
    Format(
        "ALTA",
        (),
        begins=re.compile(
            r"^#[ \t]*(DIM[ \t]+\d+[ \t]+\d+|PARAM_(IN|OUT)[ \t])", re.MULTILINE
        ),
        refused="it is a data file of ALTA, whose parametrisations of directions have "
        "no reader here: write it as a table of theta_i, phi_i, theta_o, phi_o, value",
    ),
)

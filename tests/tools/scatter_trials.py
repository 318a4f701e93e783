"""Damaged tables and scatter files of others, for the trials of `fuzz`."""

import io

import numpy as np

SCATTER = (
    *("foreign table", "zemax", "speos brdf", "speos anisotropic", "fred"),
    *("open material", "merl"),
)

FOREIGN = """Reflectance of a plate\tBRF
measured by hand\t2025
theta_i/deg\tphi_i/deg\ttheta_r/deg\tphi_r/deg\t450nm\tu(450nm) [%]
45,0\t0,0\t30,0\t180,0\t0,95\t0,5
45,0\t0,0\t60,0\t180,0\t0,85\t0,5
"""

FRED = """type bsdf_data
format angles=deg bsdf=value scale=1
10 0
0 0 0.031984
5 10 0.033851
30 0
0 0 0.027
"""

SMALL = 9, 9, 18


def scatter_kinds(kind):
    """Kinds of trials by name; `kind` is the class of files that are damaged."""
    from gonio_mi.exchange.formats import open_material, speos, zemax

    def grid(write, specular):
        return lambda path: path.write_bytes(_written(write, specular))

    return {
        "foreign table": kind("f.txt", lambda p: p.write_text(FOREIGN), _table),
        "zemax": kind("f.bsdf", grid(zemax.write, True), _material),
        "speos brdf": kind("f.brdf", grid(speos.write_spectral, False), _material),
        "speos anisotropic": kind(
            "f.anisotropicbsdf",
            grid(speos.write_anisotropic, False),
            _material,
        ),
        "fred": kind("f.txt", lambda p: p.write_text(FRED), _table),
        "open material": kind("f.json", grid(open_material.write, False), _material),
        "merl": kind("f.binary", _write_merl, _material),
    }


def _written(write, specular):
    """Bytes of a small file of two incidences."""
    from gonio_mi.exchange.formats.scatter import Block, Scatter

    polar, azimuth = np.linspace(0, 90, 4), np.arange(0, 361, 60.0)
    values = np.random.default_rng(0).uniform(0.1, 0.3, (4, len(azimuth), 1))
    blocks = [Block(t, 0.0, 0, polar, azimuth, values, specular) for t in (0.0, 40.0)]
    stream = io.BytesIO()
    write(Scatter(blocks, ("Y",)), stream, "a trial")
    return stream.getvalue()


def _write_merl(path):
    from gonio_mi.exchange.formats import merl

    merl.CELLS = SMALL
    with open(path, "wb") as stream:
        merl.write(lambda theta_i, _: np.full((len(theta_i), 3), 0.3), stream)


def _table(path):
    from gonio_mi.exchange.formats.reading import read_measured

    return read_measured(path)


def _material(path):
    """What a file says as a material, and as a table."""
    from gonio_mi.collector import EqualAngle
    from gonio_mi.exchange.formats.reading import read_measured, read_scatter
    from gonio_mi.exchange.formats.scatter import scatter_means

    scatter = read_scatter(path)
    scatter_means(scatter, EqualAngle(2, 4))
    return read_measured(path, scatter.channels[0])

"""Bases of Radiance's files say of what is read what they say of what is written."""

import numpy as np
import pytest

from gonio_mi.exchange.formats.radiance_basis import (
    BASES,
    WHITE,
    Basis,
    xyz_of,
    yuv_of,
)

EPS = np.finfo(float).eps
CELLS = 8


def turned(basis, degrees):
    """Incident directions of a basis, with other azimuths."""
    theta_i, phi_i = basis.incident_points(1)
    return theta_i[:, 0], phi_i[:, 0] + degrees


@pytest.mark.parametrize("name", BASES)
def test_points_of_an_incident_patch_are_in_it(name):
    """Exact; twin: turned by a third of a circle they are in others, if it has any."""
    basis = Basis.named(name, CELLS)
    theta_i, phi_i = basis.incident_points(3)
    numbers = np.arange(len(theta_i))
    for angles in zip(theta_i.T, phi_i.T):
        assert np.array_equal(basis.incident_patch(*angles), numbers)
    others = basis.incident_patch(*turned(basis, 120))
    assert np.array_equal(others, numbers) == (name == "tensor3")


@pytest.mark.parametrize("n_channels", [1, 3])
@pytest.mark.parametrize("name", BASES)
def test_values_come_back_from_blocks(name, n_channels):
    """In the middle of each patch, to a few roundings; twin: turned they do not.

    Colours go to XYZ and back, by a matrix whose condition is 4.3.
    """
    basis = Basis.named(name, CELLS)
    wo = basis.patches.points(1)[:, 0]
    n_incident = len(basis.incident_points(1)[0])
    values = np.random.default_rng(3).uniform(0.1, 1, (n_incident, len(wo), n_channels))
    blocks = [*basis.blocks(values, "Reflection Back").values()]
    assert {Basis.of(block) for block in blocks} == {basis}
    for degrees in (0, 120):
        seen = [basis.values(blocks, *one, wo) for one in zip(*turned(basis, degrees))]
        same = np.abs(np.array(seen) - values) <= 64 * EPS * values.max()
        assert same.all() == (degrees == 0)


def test_chromaticity_of_black_is_white():
    """Twin: light has its own, and comes back to a few roundings."""
    y, u, v = yuv_of(*np.zeros((3, 1)))
    assert (y[0], u[0], v[0]) == (0, *WHITE)
    xyz = np.random.default_rng(1).uniform(0.1, 1, (3, 100))
    assert not np.isclose(yuv_of(*xyz)[1], WHITE[0]).all()
    assert np.abs(np.array(xyz_of(*yuv_of(*xyz))) - xyz).max() <= 64 * EPS

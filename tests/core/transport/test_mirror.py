"""A smooth mirror: every ray in its one patch, also on borders and at the pole."""

import numpy as np
import pytest
from specimens import MIRROR

import gonio_mi as gonio
from gonio_mi.collector.directions import direction

RAYS = 1001  # no multiple of the number of batches


def mirror_patch(subdivision, theta_i, phi_i):
    """Patch of ideal reflection."""
    v = direction(np.radians(theta_i), np.radians(phi_i + 180))
    return int(subdivision.patch(v))


def measured(theta_i, phi_i, **settings):
    return gonio.measure(MIRROR, theta_i, phi_i, rays=RAYS, batches=2, **settings)


def assert_one_patch(record, expected):
    """All rays in one patch: exact, for a mirror of reflectance 1."""
    assert record.ledger.emitted == RAYS
    assert record.ledger.reflected == RAYS
    np.testing.assert_array_equal(np.flatnonzero(record.counts[0]), [expected])
    # rounding: the Fresnel term is 1 to an ulp of single precision or two
    assert abs(record.dhr[0] - 1) <= 2.0**-22
    assert record.dhr_std_err[0] <= 2.0**-22
    omega = record.subdivision.projected_solid_angles.ravel()[expected]
    assert abs(record.brdf.ravel()[expected] * omega - 1) <= 2.0**-22


@pytest.mark.parametrize(
    ("kind", "trace", "side", "footprint"),
    [
        *(("angle", True, "front", "point"), ("angle", False, "back", "full")),
        *(("solid", True, "back", "full"), ("solid", False, "front", "point")),
        *(("projected", True, "back", "point"), ("projected", False, "front", "full")),
    ],
)
def test_all_rays_in_the_mirror_patch(kind, trace, side, footprint):
    theta_i = (0, 1e-3, 45, 60, 89.9, 89.99)
    phi_i = (0, 12, 90, 180, 270, 301.5)
    settings = {"trace": trace, "side": side, "footprint": footprint}
    settings |= {"collector": f"{kind}:30x30", "sampler": "independent"}
    stack = measured(theta_i, phi_i, **settings)
    for i in range(len(stack)):
        theta, phi = theta_i[i // len(phi_i)], phi_i[i % len(phi_i)]
        patch = mirror_patch(stack.subdivision, theta, phi)
        assert patch == 0 or theta > 0  # that of the pole
        assert_one_patch(stack[i], patch)


@pytest.mark.parametrize(
    ("kind", "theta_i", "n", "trace"),
    [
        ("angle", 45, 2, True),
        ("angle", 45, 30, False),
        ("angle", 60, 30, False),
        ("projected", 45, 2, False),
        ("projected", 45, 30, False),
        ("projected", 30, 4, True),
        ("solid", 60, 2, False),
        ("solid", 60, 30, True),
    ],
)
def test_on_ring_and_sector_borders(kind, theta_i, n, trace):
    """A direction on a border is in the patch that begins there."""
    fraction = {
        "angle": theta_i / 90,
        "solid": 1 - np.cos(np.radians(theta_i)),
        "projected": np.sin(np.radians(theta_i)) ** 2,
    }[kind]
    azimuths = [30 * sector for sector in range(12)]
    stack = measured(theta_i, azimuths, collector=f"{kind}:{n}x12", trace=trace)
    for sector, record in enumerate(stack):
        assert_one_patch(record, round(fraction * n) * 12 + (sector + 6) % 12)


def test_twin_turned_by_a_patch():
    """The border test can fail: turned by a tenth of a degree, the sector changes."""
    for record, sector in zip(
        measured(45, [29.9, 30.1], collector="angle:2x12"), (6, 7)
    ):
        assert_one_patch(record, 12 + sector)

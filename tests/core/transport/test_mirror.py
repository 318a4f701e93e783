"""A smooth mirror: every ray in its one patch, also on borders and at the pole."""

import numpy as np
import pytest

import gonio_mi as gonio
from gonio_mi.collector.directions import direction

pytestmark = pytest.mark.usefixtures("mono")

MIRROR = {"type": "twosided", "bsdf": {"type": "conductor"}}
RAYS = 1001  # no multiple of the number of batches


def mirror_patch(subdivision, theta_i, phi_i):
    """Patch of ideal reflection."""
    v = direction(np.radians(theta_i), np.radians(phi_i + 180))
    return int(subdivision.patch(v))


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
    stack = gonio.measure(
        MIRROR,
        theta_i,
        phi_i,
        collector=f"{kind}:30x30",
        rays=RAYS,
        batches=2,
        trace=trace,
        side=side,
        footprint=footprint,
        sampler="independent",
    )
    for i in range(len(stack)):
        theta, phi = theta_i[i // len(phi_i)], phi_i[i % len(phi_i)]
        assert_one_patch(stack[i], mirror_patch(stack.subdivision, theta, phi))


def test_pole_is_patch_zero():
    for phi_i in (0, 90, 180, 270):
        record = gonio.measure(MIRROR, 0, phi_i, rays=RAYS, batches=2)
        assert_one_patch(record, 0)


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
    for sector in range(12):
        record = gonio.measure(
            MIRROR,
            theta_i,
            30 * sector,
            collector=f"{kind}:{n}x12",
            rays=RAYS,
            batches=2,
            trace=trace,
        )
        fraction = {
            "angle": theta_i / 90,
            "solid": 1 - np.cos(np.radians(theta_i)),
            "projected": np.sin(np.radians(theta_i)) ** 2,
        }[kind]
        ring = round(fraction * n)
        assert_one_patch(record, ring * 12 + (sector + 6) % 12)


def test_twin_turned_by_a_patch():
    """The border test can fail: turned by a tenth of a degree, the sector changes."""
    record = gonio.measure(
        MIRROR, 45, 29.9, collector="angle:2x12", rays=RAYS, batches=2
    )
    assert_one_patch(record, 12 + 6)
    record = gonio.measure(
        MIRROR, 45, 30.1, collector="angle:2x12", rays=RAYS, batches=2
    )
    assert_one_patch(record, 12 + 7)

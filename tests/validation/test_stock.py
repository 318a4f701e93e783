"""What `notebooks/stock_plugins.md` says of Mitsuba's own BSDFs, by plain calls.

Its defects are shown by the scripts of `notebooks/reproducers`, see
test_reproducers.py; here is what has no script.
"""

import drjit as dr
import mitsuba as mi
import mueller
import numpy as np
import pytest
from benchmark.stock import coloured

from gonio_mi.files import tensor_file
from gonio_mi.single_precision import BSDF_ROUNDING


def lit_from(theta, side=1, phi=0.0):
    si = dr.zeros(mi.SurfaceInteraction3f)
    sine = np.sin(theta)
    x, y, z = sine * np.cos(phi), sine * np.sin(phi), side * np.cos(theta)
    si.wi = mi.Vector3f(float(x), float(y), float(z))
    # with literals, Dr.Jit would skip what it knows to be inactive
    dr.make_opaque(si.wi)
    si.n = mi.Normal3f(0, 0, 1)
    si.sh_frame = mi.Frame3f(si.n)
    return si


def only(value):
    return float(np.ravel(np.array(value))[0])


def test_beckmann_roughplastic_has_it_too():
    bsdf = mi.load_dict({"type": "roughplastic", "alpha": 0.3})
    below = mi.Vector3f(-0.995, 0, -0.0999)
    dr.make_opaque(below)
    assert only(bsdf.pdf(mi.BSDFContext(), lit_from(1.3), below)) > 0
    assert only(bsdf.eval(mi.BSDFContext(), lit_from(1.3), below)) == 0


def test_principled_has_a_density_and_no_samples_from_behind():
    bsdf, behind = mi.load_dict({"type": "principled"}), lit_from(0.5, -1)
    down = mi.Vector3f(0.6, 0, -0.8)
    assert only(bsdf.pdf(mi.BSDFContext(), behind, down)) > 0
    weight = bsdf.sample(
        mi.BSDFContext(), behind, mi.Float([0.5]), mi.Point2f(0.3, 0.6)
    )[1]
    assert only(weight) == 0


@pytest.mark.parametrize(
    "specimen",
    [
        {"type": "hair", "sigma_a": 0.0},
        {"type": "principled", "clearcoat": 1.0, "sheen": 0.5},
    ],
    ids=["hair", "principled"],
)
def test_rounding_is_that_of_so_many_operations(specimen):
    """The largest of Mitsuba's own functions have fewer than a tolerance allows for."""
    bsdf = mi.load_dict(specimen)
    wo = mi.Vector3f([0.1, 0.2], [0.3, -0.1], [0.9, 0.8])
    dr.eval(wo)
    allowed = BSDF_ROUNDING / 2.0**-24
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for function in (bsdf.eval, bsdf.pdf):
            dr.kernel_history_clear()
            dr.eval(function(mi.BSDFContext(), lit_from(0.5), wo))
            n = sum(k.get("operation_count", 0) for k in dr.kernel_history())
            assert 100 < n < allowed


def test_measured_is_as_reciprocal_as_its_table(rgb):
    assert mi.variant() == rgb
    bsdf = next(mi.load_dict(d) for name, d in coloured() if name == "measured")
    one, other = lit_from(0.5), lit_from(1.2, phi=2.0)
    there = only(bsdf.eval(mi.BSDFContext(), one, other.wi)) / np.cos(1.2)
    back = only(bsdf.eval(mi.BSDFContext(), other, one.wi)) / np.cos(0.5)
    assert abs(there / back - 1) > 0.01


# ------------------------------------------------------------------ polarised variants

# Single precision, after some dozens of operations on elements up to 1.
ROUNDING = 4e-6
INDEX = 0.2 + 3j


def directions(seed, n=512):
    rng = np.random.default_rng(seed)
    theta, phi = np.radians(5 + 75 * rng.random(n)), 2 * np.pi * rng.random(n)
    x, y = np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi)
    return np.stack([x, y, np.cos(theta)], axis=1)


def lit_by(wi):
    si = dr.zeros(mi.SurfaceInteraction3f, len(wi))
    si.wi = vectors(wi)
    dr.make_opaque(si.wi)
    si.n = mi.Normal3f(0, 0, 1)
    si.sh_frame, si.uv = mi.Frame3f(si.n), mi.Point2f(0.5, 0.5)
    si.dp_du, si.dp_dv = mi.Vector3f(2, 0, 0), mi.Vector3f(0, 2, 0)
    return si


def vectors(rows):
    return mi.Vector3f(np.ascontiguousarray(rows.T, dtype=np.float32))


def per_light(matrix, wi, wo):
    """Elements over the first, (n, 4, 4), in frames of s = k x h, and lit lanes.

    In radiance mode light arrives along -wo and leaves along wi.
    """
    h = wi + wo
    frames = []
    for k in (-wo, wi):
        s = np.cross(k, h)
        s /= np.linalg.norm(s, axis=1, keepdims=True)
        frames += [vectors(k), mi.mueller.stokes_basis(vectors(k)), vectors(s)]
    turned = mi.mueller.rotate_mueller_basis(matrix, *frames)
    rows = [[np.ravel(turned[i, j]) for j in range(4)] for i in range(4)]
    m = np.moveaxis(np.array(rows), -1, 0)
    lit = m[:, 0, 0] > 0
    return m / np.where(lit, m[:, 0, 0], 1)[:, None, None], lit


def fresnel(wi, wo):
    h = (wi + wo) / np.linalg.norm(wi + wo, axis=1, keepdims=True)
    m = mueller.reflection(np.sum(wi * h, axis=1), INDEX)
    return m / m[:, :1, :1]


@pytest.mark.usefixtures("polarised")
def test_measured_polarized_is_its_table(tmp_path):
    """But for light straight back. The table is linear between Fresnel's matrices."""
    theta_d, ends = np.radians(np.arange(91.0)), np.array([[0, np.pi / 2]])
    table = 0.1 * mueller.reflection(np.cos(theta_d), INDEX)
    fields = {
        "M": np.broadcast_to(table[None, :, None, None], (2, 91, 2, 5, 4, 4)),
        "theta_h": ends,
        "theta_d": theta_d[None],
        "phi_d": np.array([[-np.pi, np.pi]]),
    }
    fields = {name: x.astype(np.float32) for name, x in fields.items()}
    fields["wvls"] = np.arange(450, 651, 50).astype(np.uint16)
    with (tmp_path / "mirror.pbsdf").open("wb") as stream:
        tensor_file.write(fields, stream)
    settings = {"filename": str(tmp_path / "mirror.pbsdf"), "wavelength": 550.0}
    bsdf = mi.load_dict({"type": "measured_polarized"} | settings)
    wi, wo = directions(1), directions(2)
    back = np.concatenate([wi[:1], wo[1:]])  # the first one straight
    value = bsdf.eval(mi.BSDFContext(), lit_by(wi), vectors(back))
    m, lit = (x[1:] for x in per_light(value, wi, wo))
    assert lit.all()
    # an eighth of the second difference, of values and of the first element
    bound = np.abs(np.diff(table[:82], 2, axis=0)).max() / 8 / table[:, 0, 0].min()
    assert np.abs(m - fresnel(wi[1:], wo[1:])).max() < 2 * bound + ROUNDING
    assert np.isnan(np.ravel(value[1, 1])[0])
    assert np.ravel(value[0, 0])[0] > 0

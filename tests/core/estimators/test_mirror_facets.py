"""The first order of mirror facets: a sum, and rays for what it leaves open."""

import functools
import warnings

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from budget import agree, difference_scores, disagree, often_enough, single, verdict
from specimens import MIRROR, both_sided, heightfield, mesh, with_faces

import gonio_mi as gonio
from gonio_mi.collector.directions import direction
from gonio_mi.estimators.mirror_facets import MirrorFacets
from gonio_mi.instrument.launcher import Launcher
from gonio_mi.instrument.setup import set_up
from gonio_mi.mitsuba_compat import triangles_of
from gonio_mi.settings import MeasurementSettings
from gonio_mi.specimen.specimen import Specimen

HOW = {"period": "box", "collector": "projected:8x12"}
RAYS = 2**17


def field(alpha, resolution=32, **settings):
    return heightfield(alpha=alpha, resolution=resolution, **settings)


def measured(shape, theta_i, estimator="next_event", **settings):
    return gonio.measure(
        shape, theta_i, **{"rays": RAYS, "estimator": estimator, **HOW, **settings}
    )


def plates(*places):
    """Mesh of horizontal mirrors ``(x from, x to, z)``, all of the cell in y."""
    corners = [[(a, -1, z), (b, -1, z), (b, 1, z), (a, 1, z)] for a, b, z in places]
    first = 4 * np.arange(len(places))[:, None, None]
    faces = (first + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    return mesh(corners, faces, mi.load_dict(MIRROR))


def known(shape, theta_i=30.0, phi_i=0.0, **settings):
    """First order of a specimen, None where it is not known."""
    is_scene = isinstance(shape, dict) and shape["type"] == "scene"
    scene = mi.load_dict(shape if is_scene else {"type": "scene", "shape": shape})
    how = {"estimator": "next_event", **HOW, **settings}
    settings = MeasurementSettings().changed(**how)
    specimen = Specimen(scene, settings.period)
    (setup,) = set_up(specimen, settings, [(theta_i, phi_i)])
    return setup.method.control(setup, mi.Color0f())


def test_faint_slopes_send_what_facets_send():
    """Rounding: where light meets the surface once, rays change nothing of the sum.

    It is that of NumPy, in double precision: areas seen from the emitter, and the patch
    of the mirror direction. Facets within single precision of a border are few: at most
    one for each patch is left to either side. Twin: another direction's.
    """
    shape = mi.load_dict(field(0.05))
    (tally,) = measured(shape, 40).tallies
    shares = tally.sums[:, 0, ..., 0] / tally.incident[:, None]
    rounding = 2 * np.finfo(np.float32).eps
    assert np.ptp(shares, axis=0).max() <= rounding * shares.max()
    points, faces = triangles_of(mi.traverse(shape))
    a, b, c = (points[faces[:, i]].astype(float) for i in range(3))
    normals = np.cross(b - a, c - a) / 2

    def expected(theta_i):
        wi = direction(np.radians(theta_i), 0.0)
        units = normals / np.linalg.norm(normals, axis=1)[:, None]
        wo = 2 * (units @ wi)[:, None] * units - wi
        patches = gonio.EqualProjectedSolidAngle(8, 12)
        share = normals @ wi / (4 * wi[2])
        found = np.bincount(patches.patch(wo), share, patches.n_patches)
        return found.reshape(patches.shape), share.max()

    flux, one_facet = expected(40)
    assert abs(shares[0] - flux).max() <= one_facet
    assert abs(shares[0] - expected(41)[0]).max() > 10 * one_facet


SPECIMENS = {
    "closed": (lambda: field(0.5), 30, True),
    "lit at an angle": (lambda: field(0.5), 75, False),
    "from the back": (lambda: field(0.5), 30, True),
}


@pytest.mark.parametrize("name", SPECIMENS)
def test_agrees_with_weighted(name, monkeypatch):
    """All patches, of other rays; and whether lines enter one facet only.

    Twin: facets in shadow beyond the cell's first side are left in the sum, and never
    taken off; or patches are taken for their neighbours.
    """
    make, theta_i, once = SPECIMENS[name]
    shape = make()
    shape = mi.load_dict(shape) if isinstance(shape, dict) else shape
    side = "back" if name == "from the back" else "front"
    first = known(shape, theta_i, side=side)
    assert first.once == once
    assert first.flux.sum() > 0.5
    weighted = measured(shape, theta_i, "weighted", seed=2, side=side)
    record = measured(shape, theta_i, side=side)
    assert record.provenance.transport == "facets"
    assert record.ledger == measured(shape, theta_i, "weighted", side=side).ledger
    agree(verdict(difference_scores(weighted, record)))
    if once:
        make_flux = MirrorFacets.__init__

        def turned(self, *given):
            make_flux(self, *given)
            self.flux = np.roll(self.flux, 1, axis=0)

        monkeypatch.setattr(MirrorFacets, "__init__", turned)
    else:
        nowhere = mi.Float64(np.inf), mi.Vector3d(0)
        monkeypatch.setattr(MirrorFacets, "_side", lambda *_: nowhere)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of created light
        wrong = measured(shape, theta_i, side=side)
    disagree(verdict(difference_scores(weighted, wrong)))


def groove(slope, x0):
    """V-groove of mirrors `slope` degrees steep, 1 wide, from `x0` on."""
    height = np.tan(np.radians(slope)) / 2
    points = [
        (x0 + x, y, z) for y in (0, 1) for x, z in ((0, 0), (0.5, height), (1, 0))
    ]
    faces = [(0, 1, 4), (0, 4, 3), (1, 2, 5), (1, 5, 4)]
    return mesh(points, faces, mi.load_dict(MIRROR))


@pytest.mark.parametrize("slope", [50, 75])
@pytest.mark.parametrize("x0", [0, 30])
@pytest.mark.promise("Surfaces and volumes")
def test_grooves_lose_nothing(slope, x0, monkeypatch):
    """Exact: all light of a lossless groove leaves it, grazing and far from the origin.

    Lines cross many cells, in the specimen itself or in a copy. Twin: they are moved by
    a little at each side, which adds up.
    """
    theta_i = 85 if slope > 60 else 60

    def score():
        record = measured(groove(slope, x0), theta_i, phi_i=152, rays=2**14)
        return single((record.dhr.item() - 1) / record.dhr_std_err.item())

    assert known(groove(slope, x0), theta_i, 152) is not None
    agree(score())
    if slope > 60:
        side = MirrorFacets._side

        def moved(self, o, d):
            t, step = side(self, o, d)
            return t, (1 - 2.0**-10) * step

        monkeypatch.setattr(MirrorFacets, "_side", moved)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of created light
            disagree(score())


@pytest.mark.parametrize("theta_i", [85, 89])
def test_no_line_enters_a_wall_in_two_cells(theta_i):
    """Exact: lines that meet a wall at the very side of a cell enter it once at most.

    A few of a hundred slip through, by rounding. Counted in double precision: a line
    enters the walls at which it is between bottom and top.
    """
    slope, n, phi_i = 80, 2**11, 20
    scene = mi.load_dict({"type": "scene", "shape": groove(slope, 0)})
    how = MeasurementSettings().changed(estimator="next_event", **HOW)
    (setup,) = set_up(Specimen(scene, how.period), how, [(theta_i, phi_i)])
    facets, d = (
        MirrorFacets(setup, mi.Color0f()),
        -np.ravel(setup.beam.wi).astype(float),
    )
    height = np.tan(np.radians(slope)) / 2
    top, z = (
        float(np.float32(1.001 * height)),
        height * np.random.default_rng(1).random(n),
    )
    t = (z - top) / d[2]
    x, y = (1 - z / (2 * height) - d[0] * t) % 1, -d[1] * t % 1
    ray = mi.Ray3f(mi.Point3f(mi.Float(x), mi.Float(y), top), mi.Vector3f(*d.tolist()))
    found, lane = dr.zeros(mi.UInt32, n), dr.arange(mi.UInt32, n)
    facets.along(
        ray, lane < n, lambda _, entered: dr.scatter_add(found, 1, lane, entered)
    )
    # from one wall to the next it falls by `step`, and it is at `z` at the first
    way = -d[0] - d[2] / (2 * height)
    z, step = top + d[2] * (top / (2 * height) - (1 - x)) / way, -d[2] / way
    entered = np.ceil(z / step) - np.floor((z - height) / step) - 1
    more = np.array(found) - entered
    assert more.max() <= 0
    assert more.mean() > -0.25


def test_the_error_falls():
    """A third of that of `weighted` at most, of as many rays; measured: a tenth.

    Exact: all of a lossless field leaves, and its interval says so.
    """
    shape = mi.load_dict(field(0.3, 64))
    record, weighted = (measured(shape, 30, e) for e in ("next_event", "weighted"))
    assert record.brdf_std_err.mean() < np.nanmean(weighted.brdf_std_err) / 3
    assert weighted.dhr == 1
    low, high = record.interval(0.9999, of="dhr")
    assert low < 1 < high
    assert 0 < high - low < 0.02


@functools.cache
def truth():
    """A long run of `weighted`."""
    return measured(field(0.5), 30, "weighted", rays=2**21, seed=99)


@pytest.mark.parametrize("rays", [500, 8000])
def test_coverage(rays):
    """Of patches and of the total; twin: intervals of half the width.

    Of few rays, that by Student's t alone: few of them change a patch.
    """
    shape, brdf = mi.load_dict(field(0.5)), truth().brdf
    covered, halved, totals, students = [], [], [], []
    for seed in range(40):
        record = measured(shape, 30, rays=rays, seed=seed)
        low, high = record.interval(0.95)
        covered.append(((low <= brdf) & (brdf <= high)).mean())
        off = abs(record.brdf - brdf)
        halved.append((off <= (high - low) / 4).mean())
        (tally,) = record.tallies
        scatter = (tally.sums[:, 0] / tally.incident[:, None, None]).std(0, ddof=1)
        solid = record.subdivision.projected_solid_angles[..., None]
        students.append((off <= 2.13 * scatter / 4 / solid).mean())
        low, high = record.interval(0.95, of="dhr")
        totals.append(bool(low <= 1 <= high))
    agree(often_enough(covered))
    agree(often_enough(totals))
    disagree(often_enough(students if rays == 500 else halved))


@pytest.mark.needs("materials")
@pytest.mark.needs("exchange")
def test_negative_sums_are_told_as_no_light(tmp_path):
    """Exact: in files too; their interval reaches above, and the total is of all."""
    from gonio_mi.materials.interpolation.lobes import MeasuredLobes

    record = measured(
        mi.load_dict(field(0.5)), 30, rays=256, collector="projected:20x20"
    )
    sums = record.tallies[0].sums.sum(axis=0)[0]
    assert (sums < 0).any()
    assert (record.brdf[sums < 0] == 0).all()
    assert (record.brdf_std_err > 0).all()
    low, high = record.interval(0.95)
    assert (low >= 0).all()
    assert (high > low).all()
    assert not record.without_hit.any()
    for name in ("map.exr", "run.npz"):
        record.save(tmp_path / name)
        again = gonio.load(tmp_path / name)
        assert again == record
        assert np.array_equal(again.interval(0.95), (low, high))
    stack = measured(mi.load_dict(field(0.5)), [0, 30], rays=256)
    assert (stack.flux_fraction < 0).any()
    assert (MeasuredLobes(stack).whole().brdf >= 0).all()
    gonio.export(stack, tmp_path / "lobes.json")  # whose reader refuses negative ones


def test_where_it_is_not_known():
    """Other specimens, beams and orders are measured as before."""
    shape = mi.load_dict(field(0.3, 16, correlation_length=0.4))
    rough = both_sided({"type": "roughconductor"})
    assert known(shape) is not None
    for other in (
        {"period": "none"},
        {"divergence": 1.0},
        {"order": 2},
        {"footprint": 0.1},
        {"incident": "klems"},
        {"estimator": "weighted"},
    ):
        assert known(shape, **other) is None, other
    for bsdf in (rough, {"type": "dielectric"}, {"type": "mask", "bsdf": MIRROR}):
        assert known(mi.load_dict(field(0.3, bsdf=bsdf))) is None
    assert known(mi.load_dict(field(0.3, face_normals=False))) is None


def test_other_meshes_than_heights():
    """Of triangles that may coincide a line meets one, and a sum has both.

    The plates have as much area as the cell: a gap as wide as what overlaps.
    """
    flat = field(0.3)
    assert known(with_faces(flat, lambda faces: faces[:, [1, 2, 0]])) is not None
    assert known(with_faces(flat, lambda faces: faces[:, ::-1])) is not None
    for change in (
        lambda faces: np.concatenate([faces, faces]),
        lambda faces: np.concatenate([faces, faces[:9], faces[:9, ::-1]]),
        lambda faces: faces[1:],
        lambda faces: np.concatenate([faces[:9, ::-1], faces[9:]]),
    ):
        assert known(with_faces(flat, change)) is None
    assert known(plates((-1, 0, 0), (-0.5, 0, -0.4), (0.5, 1, 0))) is None
    bump = {"type": "cube", "to_world": mi.ScalarTransform4f().scale(0.1)}
    bodies = {"type": "scene", "field": flat, "bump": {**bump, "bsdf": MIRROR}}
    assert known(bodies) is None


def test_colours_stacks_and_launches(rgb):  # noqa: ARG001
    """Exact: a direction alone and in a stack; statistics: each channel has its own."""
    gold = both_sided({"type": "conductor", "material": "Au"})
    shape = mi.load_dict(field(0.5, bsdf=gold))
    stack = measured(shape, [0, 10, 20, 30, 40, 50, 60, 70], rays=5000)
    assert stack[7].tallies == measured(shape, 70, rays=5000).tallies
    weighted = measured(shape, 70, "weighted", seed=1)
    record = measured(shape, 70)
    for channel in range(3):
        agree(verdict(difference_scores(weighted, record, channel=channel)))
    half = measured(shape, 70, rays=2**21 + 32)
    assert half.ledger.emitted == 2**21 + 32
    assert np.allclose(half.dhr, record.dhr, rtol=0.02)


def test_facets_are_found_once_in_all_rounds(monkeypatch):
    """Exact; a measurement of a precision takes several rounds."""
    calls = {"rounds": 0, "tables": 0}

    def counted(kind, name, what):
        plain = getattr(kind, name)

        def count(*given):
            calls[what] += 1
            return plain(*given)

        monkeypatch.setattr(kind, name, count)

    counted(Launcher, "tallies", "rounds")
    counted(MirrorFacets, "__init__", "tables")
    measured(mi.load_dict(field(0.5)), 30, rays=None, noise=4e-4)
    assert calls["rounds"] > calls["tables"] == 1

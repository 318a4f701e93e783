"""Height fields have the statistics they say, and light meets the facets they have."""

import numpy as np
import pytest
from budget import agree, disagree, normal_scores, single

import gonio_mi as gonio
from gonio_mi.errors import SpecimenError
from gonio_mi.specimen.loading import load_specimen
from gonio_mi.specimen.specimen import Specimen
from gonio_mi.surfaces.heights import gaussian_heights, height_statistics

# isort: split
import mitsuba as mi

SPACING = 0.01


def fields(alpha_u, alpha_v, length, correlation, n):
    """Independent surfaces of 128 x 192 points."""
    how = (128, 192), SPACING, (alpha_u, alpha_v), length
    return [gaussian_heights(*how, correlation=correlation, seed=i) for i in range(n)]


def mean_scores(samples, expected):
    """Normal scores of the means of the rows' columns."""
    samples = np.asarray(samples)
    n = len(samples)
    t = (samples.mean(axis=0) - expected) / (samples.std(axis=0, ddof=1) / np.sqrt(n))
    return normal_scores(t, n - 1)


@pytest.mark.parametrize(
    ("alphas", "correlation"),
    [
        *(((0.3,) * 2, c) for c in ("gaussian", "exponential")),
        ((0.2, 0.45), "gaussian"),
    ],
)
def test_slopes_are_those_asked_for(alphas, correlation):
    """In the mean over surfaces: the facets' slopes have the variance alpha^2 / 2.

    One scale serves both axes: their product is exact, their ratio that of the
    difference quotients of the autocorrelation.
    """
    length = 0.08
    expected = np.square(alphas)
    if correlation == "gaussian":
        lengths = length * np.sqrt(np.array(alphas)[::-1] / alphas)
        quotients = -np.expm1(-((SPACING / lengths) ** 2))
        expected = quotients * np.prod(alphas) / np.sqrt(np.prod(quotients))
    samples = []
    for z in fields(*alphas, length, correlation, n=96):
        statistics = height_statistics(z, SPACING)
        samples.append([statistics.alpha_u**2, statistics.alpha_v**2])
    for right, wrong in zip(
        mean_scores(samples, expected), mean_scores(samples, 1.1 * expected)
    ):
        agree(single(right))
        disagree(single(wrong))


def test_gaussian_autocorrelation():
    """The mean autocorrelation along x is exp(-r^2), with the height that goes with it.

    For Gaussian autocorrelation alpha is twice the rms height over the length.
    """
    length, alpha = 0.08, 0.3
    lags = np.array([4, 8, 12])
    samples = [
        [np.mean(z**2)] + [np.mean(z * np.roll(z, lag, axis=1)) for lag in lags]
        for z in fields(alpha, alpha, length, "gaussian", n=48)
    ]
    r = np.array([0, *lags]) * SPACING / length
    # difference quotients are that much gentler than the slopes they stand for
    h = SPACING / length
    variance = (alpha * SPACING) ** 2 / (4 * (1 - np.exp(-(h**2))))
    expected = variance * np.exp(-(r**2))
    z = mean_scores(samples, expected)
    for score, other in zip(z, mean_scores(samples, variance * np.exp(-r))):
        agree(single(score))
        if score != other:
            disagree(single(other))


def test_statistics_of_known_surfaces():
    """Rounding: a sine wave's height, slope and correlation length."""
    n, n_waves, amplitude = 1024, 8, 0.3
    x = np.arange(n) / n
    z = np.tile(amplitude * np.sin(2 * np.pi * n_waves * x), (4, 1))
    s = height_statistics(z, 1 / n)
    # as many units of 2^-52 as there are terms in the sums
    rounding = z.size * np.finfo(float).eps
    assert np.isclose(s.rms_height, amplitude / np.sqrt(2), rtol=rounding)
    # difference quotient of a sine, times its amplitude, in the mean of squares
    slope = amplitude * 2 * n * np.sin(np.pi * n_waves / n)
    assert np.isclose(s.alpha_u, slope, rtol=rounding)
    assert s.alpha_v == 0
    assert np.isnan(s.correlation_length_v)
    # the cosine's 1/e, by linear interpolation on a grid of steps 1/n
    exact = np.arccos(np.exp(-1)) / (2 * np.pi * n_waves)
    error = (2 * np.pi * n_waves / n) ** 2 / 8 / (2 * np.pi * n_waves)
    assert abs(s.correlation_length_u - exact) < error


def test_heights_repeat_and_differ():
    """Exact: the same seed, the same bits; a band limit leaves no shorter wave."""
    a, b = (gaussian_heights((32, 64), 0.1, (0.2, 0.2), 0.4, seed=3) for _ in range(2))
    assert np.array_equal(a, b)
    assert a.shape == (64, 32)
    other = gaussian_heights((32, 64), 0.1, (0.2, 0.2), 0.4, seed=4)
    assert not np.array_equal(a, other)
    band = {"correlation": "exponential", "shortest": 0.8}
    limited = gaussian_heights((64, 64), 0.1, (0.2, 0.2), 0.4, **band)
    k = np.hypot(*np.meshgrid(np.fft.fftfreq(64, 0.1), np.fft.fftfreq(64, 0.1)))
    power = np.abs(np.fft.fft2(limited)) ** 2
    # rounding: of amplitudes one unit for each row, squared; and of the wave numbers
    eps = np.finfo(float).eps
    shorter = k > (1 + 4 * eps) / 0.8
    assert power[shorter].max() < (64 * eps) ** 2 * power.max()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"heights": np.full((4, 4), 1e20, np.float32)}, "below 1e.18, got 16 of 16"),
        ({"size": 1e-30}, "heightfield.size must be a positive number from 1e-18"),
        ({"alpha": -0.1}, "heightfield.alpha must be a positive number"),
        ({"resolution": 2}, "heightfield.resolution must be at least 4"),
        ({"resolution": 300_000}, "must fit into the .* lower its resolution"),
        ({"correlation": "linear"}, "must be one of gaussian, exponential"),
        ({"correlation_length": 1.5}, "from two grid spacings to a quarter"),
        ({"shortest": 3.0}, "shortest must leave wavelengths"),
        ({"filename": "nowhere.exr"}, "heightfield.filename: there is no file"),
        ({"heights": np.zeros((0, 4))}, "at least 2 x 2"),
        ({"heights": np.zeros(16)}, "at least 2 x 2"),
        ({"heights": np.full((4, 4), np.inf)}, "must be finite and below"),
        ({"heights": np.full((4, 4), np.nan)}, "must hold measured points"),
        ({"heights": np.zeros((4, 4)), "alpha": 0.2}, "from one source"),
    ],
    ids=lambda x: next(iter(x)) if isinstance(x, dict) else "",
)
def test_bad_input_is_one_sentence(settings, message):
    if "heights" in settings:
        settings = settings | {"heights": mi.TensorXf(settings["heights"])}
    with pytest.raises(SpecimenError, match=message) as caught:
        gonio.measure({"type": "heightfield"} | settings, 30)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("periodic", [True, False])
def test_mesh_is_the_grid(periodic):
    """Exact: vertices are the grid's points, and the borders of a period are equal."""
    z = np.arange(12.0).reshape(3, 4)
    how = {"heights": mi.TensorXf(z), "scale": 0.5, "size": 8.0, "periodic": periodic}
    how["to_world"] = mi.ScalarTransform4f().translate([0, 0, 1])
    shape = mi.load_dict({"type": "heightfield", **how})
    points = np.array(mi.traverse(shape)["vertex_positions"]).reshape(-1, 3)
    n_y, n_x = (3 + periodic, 4 + periodic)
    assert len(points) == n_x * n_y
    x, y, height = points.T.reshape(3, n_y, n_x)
    assert x[0, 0] == -4
    assert x[0, -1] == 4
    assert y[-1, 0] == -y[0, 0]
    # rounding: of two points of at most 4, by half a unit of 2^-22 each
    rounding = 2.0**-22
    assert np.allclose(np.diff(y[:, 0]), np.diff(x[0])[0], rtol=0, atol=rounding)
    expected = z / 2 + 1
    if periodic:
        expected = np.pad(expected, ((0, 1), (0, 1)), mode="wrap")
    assert np.array_equal(height, expected)


def test_files(tmp_path):
    """Exact: array, .npy and EXR give the same measurement."""
    z = 0.1 * np.random.default_rng(0).standard_normal((8, 8)).astype(np.float32)
    np.save(tmp_path / "z.npy", z)
    mi.Bitmap(z[..., None]).write(str(tmp_path / "z.exr"))
    sources = [
        {"heights": mi.TensorXf(z)},
        {"filename": str(tmp_path / "z.npy")},
        {"filename": str(tmp_path / "z.exr")},
    ]
    records = [
        gonio.measure({"type": "heightfield", "size": 2.0, **source}, 30, rays=10_000)
        for source in sources
    ]
    assert records[0].tallies == records[1].tallies == records[2].tallies
    assert "z.exr" in records[2].settings["surface"]


def test_record_tells_the_statistics():
    record = gonio.measure({"type": "heightfield", "alpha": 0.3}, 0, rays=1000)
    z = gaussian_heights((256, 256), 2 / 256, (0.3, 0.3), 2 / 32)
    has = str(height_statistics(z, 2 / 256))
    assert has in record.settings["surface"]
    assert "asked alpha_u 0.3" in record.settings["surface"]


def test_smooth_normals_follow_the_surface():
    """Convergence: interpolated normals approach those of a sine at second order."""
    errors = []
    for n in (64, 128, 256):
        x = np.arange(n) / n
        z = np.tile(0.1 * np.sin(2 * np.pi * x), (n, 1))
        how = {"heights": mi.TensorXf(z), "size": 1.0, "face_normals": False}
        shape = mi.load_dict({"type": "heightfield", **how})
        scene = mi.load_dict({"type": "scene", "shape": shape})
        at = np.linspace(-0.49, 0.49, 501)
        ray = mi.Ray3f(mi.Point3f(at, 0.0123, 1.0), mi.Vector3f(0, 0, -1))
        normal = np.array(scene.ray_intersect(ray).sh_frame.n)
        slope = 0.2 * np.pi * np.cos(2 * np.pi * (at + 0.5))
        errors.append(np.abs(-normal[0] / normal[2] - slope).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    # nearer to second order than to first
    assert np.all(orders > 1.5), f"errors {errors}"


def test_a_scene_is_built_once():
    """Its acceleration structure is most of a large surface's memory, and time."""
    field = {"type": "heightfield", "resolution": 16}
    light = {"type": "directional"}
    scene = load_specimen({"type": "scene", "field": field, "light": light})
    assert Specimen(scene).scene is scene
    # not one with what is no part of the specimen
    lamp = {"type": "rectangle", "emitter": {"type": "area"}}
    scene = load_specimen({"type": "scene", "field": field, "lamp": lamp})
    assert Specimen(scene).scene is not scene
    # nor one that is not watertight
    assert Specimen(mi.load_dict({"type": "scene", "field": field})).scene is not scene

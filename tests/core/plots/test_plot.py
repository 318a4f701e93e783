"""The figure shows the numbers of the record: each patch, its interval, its limits."""

import sys
from dataclasses import replace

import numpy as np
import pytest
import synthetic

pytest.importorskip("matplotlib")

from matplotlib.colors import LogNorm, Normalize, to_hex
from matplotlib.figure import Figure

from gonio_mi.plots import plot
from gonio_mi.plots.profile import GREY, MAX_POINTS, profile

NAN = float("nan")


def panels(figure):
    """Maps and profile of a figure."""
    above, below = figure.subfigs
    return above.axes, below.axes[0]


def labels(axes):
    return [text.get_text() for text in axes.get_legend().get_texts()]


def points(axes, marker):
    """Coordinates of all points with that marker, legend entries aside."""
    lines = [line.get_xydata() for line in axes.lines if line.get_marker() == marker]
    return np.concatenate(lines)


# ------------------------------------------------------------------ profile


def test_profile_follows_the_sectors_of_the_plane_of_incidence():
    """Of 8 sectors, phi_i = 20 is in number 0 and the mirror azimuth in number 4."""
    record = synthetic.record(both=True)
    low, high = record.interval(0.95, of="btdf")
    cut = profile(record, "btdf")
    for array, expected in ((cut.value, record.btdf), (cut.low, low), (cut.high, high)):
        np.testing.assert_array_equal(array[:6], expected[::-1, 0])
        np.testing.assert_array_equal(array[6:], expected[:, 4])
    np.testing.assert_array_equal(cut.empty[6:, 0], record.counts[1, :, 4] == 0)
    edges = np.degrees(record.subdivision.theta_edges)
    np.testing.assert_array_equal(cut.edges, [*-edges[:0:-1], *edges])
    assert np.all((cut.edges[:-1] < cut.theta) & (cut.theta < cut.edges[1:]))


@pytest.mark.parametrize(
    ("phi_i", "towards", "beyond"), [(0, 0, 4), (359, 7, 3), (-10, 7, 3), (NAN, 0, 4)]
)
def test_profile_at_borders(phi_i, towards, beyond):
    record = synthetic.record(phi_i=(phi_i,))
    cut = profile(record)
    np.testing.assert_array_equal(cut.value[:6], record.brdf[::-1, towards])
    np.testing.assert_array_equal(cut.value[6:], record.brdf[:, beyond])


def test_other_plane_other_profile():
    """Twin: a profile taken across the plane would differ."""
    record = synthetic.record()
    turned = replace(record, phi_i=record.phi_i + 90)
    assert not np.array_equal(profile(record).value, profile(turned).value)


# ------------------------------------------------------------------ map


@pytest.mark.parametrize(
    "collector",
    ["angle:5x4", "solid:3x7", "projected:2x400", "klems", "borders:0,40,90x0,80,360"],
)
def test_map_draws_every_patch_in_its_place(collector):
    """Centres of the drawn pieces hit the patch whose value they have."""
    record = synthetic.record(collector, channels=("R", "G", "B"), power=1)
    patches = record.subdivision
    rings, _ = patches.in_rings(record.brdf)
    maps, _ = panels(plot(record))
    mesh = maps[0].collections[0]
    corners = mesh.get_coordinates()
    # sin(theta) of the borders, to a few roundings of sine, cosine and root
    np.testing.assert_allclose(
        np.hypot(corners[..., 0], corners[..., 1]),
        np.broadcast_to(np.sin(rings.theta_edges)[:, None], corners.shape[:2]),
        rtol=4 * np.finfo(float).eps,
    )
    middles = (corners[:-1] + corners[1:]) / 2
    middles = (middles[:, :-1] + middles[:, 1:]) / 2
    x, y = np.moveaxis(middles, -1, 0)
    hit = patches.patch(np.stack([x, y, np.sqrt(1 - x**2 - y**2)], axis=-1))
    expected = record.brdf.mean(axis=-1).ravel()[hit]
    drawn = mesh.get_array().reshape(hit.shape)
    np.testing.assert_array_equal(drawn.filled(0), expected)
    np.testing.assert_array_equal(drawn.mask, record.counts[0].ravel()[hit] == 0)


@pytest.mark.parametrize(
    ("ratio", "norm", "axis"),
    [(19, Normalize, "linear"), (21, LogNorm, "linear"), (101, LogNorm, "log")],
)
def test_colours_are_logarithmic_for_a_wide_range(ratio, norm, axis):
    record = synthetic.record(power=0)
    tally = synthetic.writeable(record.tallies[0])
    tally.sums[:] = 1
    tally.sums[:, 0, 2, 4] = ratio  # in the plane of incidence
    record = replace(record, tallies=(tally,))
    maps, axes = panels(plot(record))
    mesh = maps[0].collections[0]
    assert type(mesh.norm) is norm
    assert axes.get_yscale() == axis
    if norm is Normalize:
        assert mesh.norm.vmin == 0


def test_transmission_is_drawn_where_there_is_any():
    record = synthetic.record(both=True)
    maps, axes = panels(plot(record))
    assert [a.get_title() for a in maps] == ["Reflection", "Transmission"]
    assert {"reflection", "transmission"} <= set(labels(axes))
    tally = synthetic.writeable(record.tallies[0])
    tally.hits[1] = 0
    tally.sums[:, 1] = 0
    assert len(panels(plot(replace(record, tallies=(tally,))))[0]) == 1


def test_directions_are_marked():
    maps, axes = panels(plot(synthetic.record(theta_i=(30,), phi_i=(90,))))
    # sin 30 degrees towards +y and back, to the rounding of sine and cosine
    tolerance = {"rtol": 0, "atol": np.finfo(float).eps}
    np.testing.assert_allclose(points(maps[0], "o"), [[0, 0.5]], **tolerance)
    np.testing.assert_allclose(points(maps[0], "D"), [[0, -0.5]], **tolerance)
    assert "mirror direction" in labels(axes)
    maps, axes = panels(plot(synthetic.record(theta_i=(NAN,), phi_i=(NAN,))))
    assert maps[0].get_legend() is None or labels(maps[0]) == ["no hit"]
    assert "mirror direction" not in labels(axes)


# ------------------------------------------------------------------ profile as drawn


def test_empty_patches_are_drawn_at_their_upper_limit():
    record = synthetic.record("projected:10x8", rays=40, power=50)
    cut = profile(record)
    assert cut.empty.any()
    _, axes = panels(plot(record))
    empty = cut.empty[:, 0]
    expected = np.stack([cut.theta, cut.high[:, 0]], axis=-1)[empty]
    np.testing.assert_array_equal(points(axes, "v"), expected)
    expected = np.stack([cut.theta, cut.value[:, 0]], axis=-1)[~empty]
    np.testing.assert_array_equal(points(axes, "o"), expected)
    assert "upper limit, no hit" in labels(axes)


def test_no_upper_limit_hides_another():
    """Exact: what one channel lacks in its colour, what all lack in grey."""
    channels = ("R", "G", "B")
    record = synthetic.record("projected:10x8", rays=40, power=50, channels=channels)
    ring = int(record.counts[:, 4].argmax())
    tally = synthetic.writeable(record.tallies[0])
    tally.sums[:, 0, ring, 4, 2] = 0  # no blue in the brightest patch of the profile
    record = replace(record, tallies=(tally,))
    cut = profile(record)
    in_all = cut.empty.all(axis=1)
    assert in_all.any()
    np.testing.assert_array_equal(
        np.argwhere(cut.empty & ~in_all[:, None]), [[10 + ring, 2]]
    )
    assert np.isnan(record.brdf_std_err[ring, 4]).tolist() == [False, False, True]
    _, axes = panels(plot(record))
    drawn = {
        line.get_color(): line.get_xydata()
        for line in axes.lines
        if line.get_marker() == "v" and len(line.get_xydata())
    }
    limits = np.stack([cut.theta, cut.high[:, 2]], axis=-1)
    assert set(drawn) == {GREY, to_hex("tab:blue")}
    np.testing.assert_array_equal(drawn[GREY], limits[in_all])
    np.testing.assert_array_equal(drawn[to_hex("tab:blue")], limits[[10 + ring]])


def test_error_bars_are_the_intervals():
    record = synthetic.record("projected:10x8", power=1)
    cut = profile(record)
    assert not cut.empty.any()
    _, axes = panels(plot(record))
    (bars,) = [c for c in axes.collections if hasattr(c, "get_segments")]
    drawn = np.array([segment[:, 1] for segment in bars.get_segments()])
    expected = np.concatenate([cut.low, cut.high], axis=1)
    # value - (value - low): two roundings of the largest of the three
    rounding = 2 * np.finfo(float).eps * expected.max()
    np.testing.assert_allclose(drawn, expected, rtol=0, atol=rounding)


def test_a_single_batch_has_no_error_bars():
    record = synthetic.record(n_batches=1, power=1).with_settings(sampler="sobol")
    _, axes = panels(plot(record))
    assert "95 % interval" not in labels(axes)


def test_many_patches_are_drawn_as_a_band():
    n = MAX_POINTS // 2 + 1
    _, axes = panels(plot(synthetic.record(f"projected:{n}x2")))
    assert not axes.containers


def test_one_curve_per_channel_or_direction():
    _, axes = panels(plot(synthetic.record(channels=("R", "G", "B"))))
    assert labels(axes)[:3] == ["R", "G", "B"]
    stack = synthetic.record(theta_i=(0, 30, 60), phi_i=(0, 0, 0))
    _, axes = panels(plot(stack))
    assert [label.split("= ")[1] for label in labels(axes)[:3]] == ["0°", "30°", "60°"]
    assert len(axes.containers) == 3
    long = synthetic.record("angle:3x4", theta_i=range(9), phi_i=[0] * 9)
    _, axes = panels(plot(long, index=8))
    assert len(axes.containers) == 1


# ------------------------------------------------------------------ figure and file


def test_title_says_what_was_measured():
    record = synthetic.record(theta_i=(0, 30.5), phi_i=(0, 20))
    title = plot(record, index=1).get_suptitle()
    for words in (
        "synthetic gloss",
        "θᵢ = 30.5°, φᵢ = 20° (2 of 2 directions)",
        "projected:6x8",
        "80 000 rays",
        "weighted estimator",
        "independent sampler",
        "dhr 0.60",
        " % at worst (± std_err)",
    ):
        assert words in title.replace("\N{NO-BREAK SPACE}", " ")


def test_the_title_says_once_that_it_has_means():
    """And its last line may be broken between items only; of one channel none are."""
    record = synthetic.record(channels=("R", "G", "B"), both=True)
    last = plot(record).get_suptitle().split("\n")[3]
    assert last.startswith(
        "means of 3 channels: dhr ".replace(" ", "\N{NO-BREAK SPACE}")
    )
    assert last.count("channels") == 1
    assert all(item.endswith(",") for item in last.split(" ")[:-1])
    assert "channels" not in plot(synthetic.record()).get_suptitle()


def test_no_title_is_wider_than_its_figure():
    """Twin: as it was, of a name that is longer than its figure is wide."""
    record = synthetic.record().with_settings(specimen="W" * 79, period="1.0,1.0")
    figure = plot(record)
    title = figure._suptitle
    figure.draw_without_rendering()
    assert title.get_window_extent().width < figure.bbox.width
    assert figure.get_suptitle().replace("\n", "").startswith("W" * 79)
    figure.suptitle("W" * 79)
    assert figure._suptitle.get_window_extent().width > figure.bbox.width


@pytest.mark.parametrize(
    ("theta_i", "phi_i", "on_border", "sectors"),
    [
        (30, 0, True, "0° to 45° and 180° to 225°"),
        (30, 270, True, "270° to 315° and 90° to 135°"),
        (20, 20, False, None),
        (90 / 6, 20, True, None),
        (0, 0, False, "0° to 45° and 180° to 225°"),
    ],
)
def test_borders_of_patches_are_told(theta_i, phi_i, on_border, sectors):
    """Of 8 sectors; with 6 rings of equal angle a border is at 15 degrees."""
    record = synthetic.record("angle:6x8", theta_i=(theta_i,), phi_i=(phi_i,))
    (reflection,), axes = panels(plot(record))
    assert ("mirror direction, on a border of patches" in labels(reflection)) == (
        on_border
    )
    told = axes.get_xlabel().split("\n")
    assert len(told) == (1 if sectors is None else 2)
    assert sectors is None or told[1].endswith(f" = {sectors}")


def test_integrals_are_drawn_without_their_rounding():
    figure = plot(synthetic.integrals().with_settings(sampler="sobol"))
    title = figure.get_suptitle().replace("\N{NO-BREAK SPACE}", " ")
    assert "integrals, quadrature estimator" in title
    assert "std_err" not in title
    assert title.endswith("(± largest error)")
    assert "ray" not in title
    assert "sampler" not in title
    _, axes = panels(figure)
    low, high = axes.get_ylim()
    value = synthetic.integrals().brdf.max()
    assert high - low >= 0.01 * value
    assert low > 0.9 * value


def test_any_name_of_a_specimen_can_be_drawn(tmp_path):
    name = "a $b_{ \\frac \udcff\n" + "long " * 99
    plot(synthetic.record().with_settings(specimen=name), tmp_path / "figure.png")


@pytest.mark.parametrize(
    ("ending", "magic"), [("png", b"\x89PNG"), ("pdf", b"%PDF"), ("svg", b"<?xml")]
)
def test_file(tmp_path, ending, magic):
    path = tmp_path / f"figure.{ending}"
    figure = plot(synthetic.record(both=True), path)
    assert isinstance(figure, Figure)
    assert path.read_bytes().startswith(magic)
    assert list(tmp_path.iterdir()) == [path]


def test_notebooks_show_it():
    assert plot(synthetic.record())._repr_png_().startswith(b"\x89PNG")


def test_pyplot_keeps_nothing():
    from matplotlib import pyplot

    plot(synthetic.record())
    assert pyplot.get_fignums() == []


def test_bad_arguments(tmp_path):
    record = synthetic.record()
    with pytest.raises(ValueError, match=r"index must be below 1, .* got 1"):
        plot(record, index=1)
    with pytest.raises(TypeError, match="index"):
        plot(record, index="first")
    with pytest.raises(ValueError, match=r"end in \.pdf or \.png or \.svg"):
        plot(record, tmp_path / "figure.bmp")
    with pytest.raises(FileNotFoundError, match="no folder"):
        plot(record, tmp_path / "absent" / "figure.png")


def test_without_matplotlib_one_sentence_says_what_to_install(monkeypatch):
    for name in list(sys.modules):
        if name == "gonio_mi.plots.polar_map":
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(ImportError, match=r'pip install "\.\[plot\]" in a'):
        plot(synthetic.record())

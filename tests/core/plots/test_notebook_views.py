"""Records, comparisons, plans and verdicts show themselves in notebooks."""

import sys

import numpy as np
import pytest
import synthetic

import gonio_mi as gonio
from gonio_mi.cli import main
from gonio_mi.errors import SettingError
from gonio_mi.plots import animation, sheet
from gonio_mi.plots.plot import MAX_MAPS

pytest.importorskip("matplotlib")


def stack(n=3, **settings):
    angles = tuple(np.linspace(0, 80, n))
    return synthetic.record(theta_i=angles, phi_i=(20.0,) * n, **settings)


@pytest.mark.parametrize("n", [1, 3])
def test_record_shows_picture_numbers_and_name(n):
    record = stack(n).with_settings(specimen="<b>&")
    shown = record._repr_html_()
    assert 'src="data:image/png;base64,' in shown
    assert "&lt;b&gt;&amp;" in shown
    assert "<b>&" not in shown
    assert f"{record.dhr.ravel()[0]:.3f}" in shown


def test_without_matplotlib_numbers_alone(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    shown = synthetic.record()._repr_html_()
    assert "<img" not in shown
    assert "reflected" in shown


def test_warnings_stand_above_the_picture():
    record = synthetic.record().with_settings(processors=["one", "another"])
    shown = record._repr_html_()
    assert shown.index("Warning: ") < shown.index("<img")


@pytest.mark.needs("analysis")
@pytest.mark.needs("validation")
def test_comparison_plan_and_verdict():
    comparison = gonio.compare(synthetic.record(), synthetic.record(power=29))
    assert "<img" in comparison._repr_html_()
    assert "chi-square" in comparison._repr_html_()
    assert "|error| &lt; " in gonio.plan()._repr_html_()


@pytest.mark.needs("analysis")
@pytest.mark.needs("exchange")
def test_fit_and_table(tmp_path):
    """A table shows what the command does; a name cannot be markup."""
    path = tmp_path / "<b>.csv"
    path.write_text("theta_i,phi_i,theta_o,phi_o,brdf\n" + "30,0,10,180,0.2\n" * 1)
    table = gonio.read_measured(path)
    assert "values      1 of brdf" in str(table)
    assert "&lt;b&gt;.csv" in table._repr_html_()
    assert "<b>" not in table._repr_html_()
    fields = {"bsdf": {"type": "diffuse"}, "names": ("reflectance",), "dof": 9}
    values = {"values": np.array([0.5]), "covariance": np.array([[1e-4]]), "chi2": 9.0}
    fit = gonio.Fit(synthetic.record(), **fields, **values, misplaced=0, predicted=[])
    shown = fit._repr_html_()
    assert "reflectance  0.5 +- 0.01" in shown


def test_record_plots_and_labels_itself():
    record = synthetic.record()
    assert record.plot().get_suptitle() == gonio.plot(record).get_suptitle()
    data = pytest.importorskip("xarray") and record.to_xarray()
    np.testing.assert_array_equal(data.bsdf[0, 0], record.brdf)


# ------------------------------------------------------------------------ stacks


def meshes(figure):
    return [
        axes.collections[0]
        for block in figure.subfigs
        for axes in block.axes
        if axes.collections and axes.get_title()
    ]


def test_sheet_has_one_scale_and_all_directions():
    record = stack(8, both=True)
    drawn = meshes(sheet(record))
    assert len(drawn) == 2 * 8
    limits = {(mesh.norm.vmin, mesh.norm.vmax) for mesh in drawn[:8]}
    least = record.brdf[record.brdf > 0].min()  # the scale is logarithmic
    assert limits == {(least, record.brdf.max())}
    assert (least, record.brdf[0].max()) not in limits  # twin: a scale of one map


def test_marks_at_the_horizon_are_within_a_sheet():
    figure = sheet(synthetic.record(theta_i=(89, 89), phi_i=(0, 90)))
    figure.draw_without_rendering()
    for place in (mesh.axes for mesh in meshes(figure)):
        marks = [line for line in place.lines if line.get_marker() in "oD"]
        assert len(marks) == 2
        for mark in marks:
            x, y = place.transData.transform(mark.get_xydata()[0])
            radius = mark.get_markersize() / 2 * figure.dpi / 72
            assert figure.bbox.x0 + radius < x < figure.bbox.x1 - radius
            assert figure.bbox.y0 + radius < y < figure.bbox.y1 - radius


@pytest.mark.parametrize(("n", "rows"), [(6, [6]), (7, [4, 3]), (13, [5, 5, 3])])
def test_rows_of_a_sheet_are_balanced(n, rows):
    """Exact: as few rows of up to six as hold all, and as narrow as these may be."""
    figure = sheet(stack(n))
    figure.draw_without_rendering()
    heights = [round(mesh.axes.get_position().y0, 6) for mesh in meshes(figure)]
    assert [heights.count(y) for y in dict.fromkeys(heights)] == rows


def test_large_sheet_is_thinned_and_says_so():
    figure = sheet(stack(MAX_MAPS + 5))
    assert len(meshes(figure)) == MAX_MAPS
    assert f"{MAX_MAPS} of {MAX_MAPS + 5} incident directions" in figure.get_suptitle()


def test_animation_has_a_frame_for_each_direction(tmp_path):
    from PIL import Image

    path = tmp_path / "lobe.gif"
    animation(stack(4), path)
    with Image.open(path) as image:
        assert image.n_frames == 4
    with pytest.raises(SettingError, match=r"must end in \.gif"):
        animation(stack(4), tmp_path / "lobe.png")


def test_command_draws_stacks(tmp_path, capsys):
    stack(3).save(tmp_path / "stack.npz")
    record = str(tmp_path / "stack.npz")
    for name, options in (("a.png", []), ("b.png", ["--index", "1"]), ("c.gif", [])):
        assert main(["plot", record, "-o", str(tmp_path / name), *options]) == 0
    sizes = {(tmp_path / name).stat().st_size for name in ("a.png", "b.png")}
    assert len(sizes) == 2
    assert main(["plot", record, "-o", str(tmp_path / "d.gif"), "--index", "1"]) == 1
    assert "--index must not be given" in capsys.readouterr().err

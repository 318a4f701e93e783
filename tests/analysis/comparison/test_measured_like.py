"""Specimens measured like tables and records, and what a comparison is uncertain by."""

from dataclasses import replace

import budget as alarms
import mitsuba as mi
import numpy as np
import pytest
from budget import of_comparison

import gonio_mi as gonio
from gonio_mi.analysis.comparison import (
    aperture_effect,
    compare,
    measure_like,
    uncertainty_budget,
)
from gonio_mi.cli import main
from gonio_mi.files.measured_table import MeasuredTable
from gonio_mi.settings import Estimator

DIFFUSE = {"type": "diffuse", "reflectance": {"type": "spectrum", "value": 0.7}}
ROUGH = {"type": "roughconductor", "alpha": 0.2, "distribution": "ggx"}
RAYS = 50_000


def table(theta_o, values, **settings):
    n = len(theta_o)
    zero = np.zeros(n)
    return MeasuredTable(zero + 30, zero, theta_o, zero + 180, values, **settings)


# ------------------------------------------------------------------------- like a table


def test_narrow_apertures_have_rays_enough_by_themselves():
    """A hundredth of a degree squared: 1e6 rays would hit each 30 times.

    Statistics: against the albedo over pi; the twin is 1 per cent off.
    """
    theta_o = np.array([0.0, 20, 40, 60])
    exact = table(theta_o, np.full(4, 0.7 / np.pi), aperture_half_angle=0.3)
    (record,) = measure_like(DIFFUSE, exact)
    assert record.settings["estimator"] == "next_event"
    relative = record.brdf_std_err[:-1] / record.brdf[:-1]
    assert relative.max() <= 0.01
    alarms.agree(of_comparison(compare(record, exact)))
    wrong = table(theta_o, np.full(4, 0.707 / np.pi), aperture_half_angle=0.3)
    alarms.disagree(of_comparison(compare(record, wrong)))
    # what is asked for is done as it is asked for
    (asked,) = measure_like(DIFFUSE, exact, rays=RAYS)
    assert asked.settings["estimator"] == "weighted"
    assert asked.ledger.emitted == RAYS


def test_apertures_on_a_flat_specimen_need_no_rays():
    """Integrals of `eval` to a part of the table's uncertainty, and the output says so.

    The twin is off by 1 %, all points the same way; exact values keep their rays.
    """
    theta_o = np.array([0.0, 20, 40, 60])
    stated = {"aperture_half_angle": 5.0, "uncertainty": 0.003}
    values = np.full(4, 0.7 / np.pi)
    (record,) = measure_like(DIFFUSE, table(theta_o, values, **stated))
    assert record.settings["estimator"] == "quadrature"
    assert record.ledger.emitted == 0
    found = compare(record, table(theta_o, values, **stated))
    assert found.passed
    assert np.all(np.abs(found.z) < 1e-2)
    assert any("integrals of eval" in note for note in found.notes)
    off = compare(record, table(theta_o, 1.01 * values, **stated))
    assert off.p_values["total"] < 1e-6
    # few rays of delta components meet an aperture: they keep what was taken before
    (coated,) = measure_like({"type": "plastic"}, table(theta_o, values, **stated))
    assert coated.settings["estimator"] == "next_event"


def test_a_table_in_patches_is_measured_as_well_as_it_is_known(tmp_path):
    """Not much better in its dim patches, which took a hundred times its rays.

    Four times smaller errors are 16 times as many rays, or twice that by doubling.
    """
    settings = {"collector": "projected:12x24", "sampler": "independent"}
    known = gonio.measure(ROUGH, 45, rays=2**17, **settings)
    gonio.export(known, tmp_path / "known.csv")
    known_like = gonio.read_measured(tmp_path / "known.csv")
    (record,) = measure_like(ROUGH, known_like, sampler="independent")
    assert record.ledger.emitted <= 2 * 16 * known.ledger.emitted
    noise = [
        np.nansum(one.brdf_std_err * one.flux_fraction[0] / one.brdf)
        for one in (record, known)
    ]
    assert noise[0] <= 0.3 * noise[1]
    alarms.agree(of_comparison(compare(record, known_like)))
    off = gonio.measure({"type": "roughconductor", "alpha": 0.25}, 45, **settings)
    alarms.disagree(of_comparison(compare(off, known_like)))


def test_divergence_of_the_beam_belongs_to_the_comparison():
    """A mirror sends the cone of the beam on: the share of a smaller one within it.

    Statistics: 5 standard errors; the twin is a beam half a degree wider.
    """
    half_angle, divergence = 2.0, 4.0
    point = table(np.array([30.0]), [1.0], aperture_half_angle=half_angle)
    mirror = {"type": "conductor", "material": "none"}
    (record,) = measure_like(mirror, point, divergence=divergence)

    def expected(beam):
        inside, whole = (1 - np.cos(np.radians(a)) for a in (half_angle, beam))
        projected = np.sin(np.radians(half_angle)) ** 2 * np.cos(np.radians(30))
        return inside / whole / (np.pi * projected)

    error = record.brdf_std_err[0, 0, 0]
    assert abs(record.brdf[0, 0, 0] - expected(divergence)) < 5 * error
    assert abs(record.brdf[0, 0, 0] - expected(divergence + 0.5)) > 5 * error
    lamp = table(np.array([30.0]), [1.0], aperture_half_angle=0.5, emitter_half_angle=1)
    with pytest.raises(ValueError, match="divergence applies to a collimated beam"):
        measure_like(DIFFUSE, lamp, divergence=2)


# ------------------------------------------------------------------------ like a record


def test_a_specimen_is_measured_as_a_record_was():
    settings = {"collector": "projected:4x8", "rays": RAYS, "sampler": "independent"}
    record = gonio.measure(ROUGH, [0, 40], 20, divergence=1.0, side="front", **settings)
    (again,) = measure_like(ROUGH, record)
    for name in ("rays", "estimator", "sampler", "divergence", "side"):
        assert again.settings[name] == record.settings[name]
    assert again.settings["seed"] == record.settings["seed"] + 1
    assert again.subdivision == record.subdivision
    assert np.array_equal(again.theta_i, record.theta_i)
    alarms.agree(of_comparison(compare(again, record)))
    (other,) = measure_like({**ROUGH, "alpha": 0.25}, record)
    alarms.disagree(of_comparison(compare(other, record)))
    filled = gonio.measure(ROUGH, 40, 20, incident="angle:3x4", **settings)
    (again,) = measure_like(ROUGH, filled)
    assert again.settings["incident"] == "angle:3x4"
    (again,) = measure_like(DIFFUSE, record[0], noise=0.1)
    assert again.settings["noise"] == 0.1
    with pytest.raises(TypeError, match="collector must come from the record"):
        measure_like(ROUGH, record, collector="angle:2x2")
    with pytest.raises(ValueError, match="aperture_half_angle applies to tables"):
        measure_like(ROUGH, record, aperture_half_angle=1)
    above = mi.ScalarTransform4f().translate([0, 0, 5]).rotate([1, 0, 0], 180)
    lamp = {"type": "disk", "to_world": above, "emitter": {"type": "area"}}
    lit = gonio.measure(DIFFUSE, 0, emitter=lamp, footprint=0.1, **settings)
    with pytest.raises(ValueError, match="measure the specimen under that emitter"):
        measure_like(DIFFUSE, lit)


def test_directions_that_split_refused_are_compared_with_rays_alone(tmp_path):
    """A campaign says `split` of all its directions; a flat BSDF has no facets."""
    rays = gonio.measure(ROUGH, [0, 40], collector="projected:4x8", rays=RAYS)
    as_split = replace(rays.asked, estimator=Estimator.SPLIT)
    record = replace(rays, asked=as_split)
    (again,) = measure_like(ROUGH, record, folder=tmp_path / "kept")
    assert again.settings["estimator"] == "weighted"
    assert list((tmp_path / "kept_weighted").glob("*.npz"))
    alarms.agree(of_comparison(compare(again, rays)))
    with pytest.raises(gonio.SpecimenError, match="split"):
        measure_like(ROUGH, record, estimator="split")


def test_directions_of_a_table_in_patches_are_a_stack(tmp_path):
    """Each has its own rays, the same ones as alone."""
    known = gonio.measure(ROUGH, [0, 40], collector="projected:4x8", rays=RAYS)
    gonio.export(known, tmp_path / "known.csv")
    table = gonio.read_measured(tmp_path / "known.csv")
    first, second = measure_like(ROUGH, table, rays=RAYS)
    assert (first.theta_i, second.theta_i) == (0, 40)
    seed = second.settings["seed"]
    assert seed not in known.provenance.seeds
    alone = gonio.measure(ROUGH, 40, collector=table.patches, rays=RAYS, seed=seed)
    assert np.array_equal(second.flux_fraction, alone.flux_fraction)
    alarms.agree(of_comparison(compare((first, second), table)))


def test_commands_compare_a_record_with_a_specimen(tmp_path, capsys):
    path = str(tmp_path / "run.npz")
    gonio.measure(ROUGH, 40, collector="projected:4x8", rays=RAYS).save(path)
    word = "roughconductor:alpha={},distribution=ggx"
    assert main(["compare", path, word.format(0.2)]) == 0
    assert main(["compare", path, word.format(0.25)]) == 3
    assert main(["compare", word.format(0.2), path]) == 1
    assert "RECORD must be an .exr or .npz file" in capsys.readouterr().err
    assert main(["compare", path, "absent.csv"]) == 1
    assert "there is no file" in capsys.readouterr().err


# --------------------------------------------------------------------------- the budget


def test_the_budget_is_what_z_is_made_of():
    theta_o = np.array([10.0, 30, 50])
    values = np.full(3, 0.7 / np.pi)
    measured = table(
        theta_o, values, aperture_half_angle=2, uncertainty=0.003,
        scale_uncertainty=0.01, sigma=[0.001, 0, 0.002],
    )  # fmt: skip
    comparison = compare(measure_like(DIFFUSE, measured), measured)
    parts = uncertainty_budget(comparison, 0.01)
    eps = np.finfo(float).eps
    assert parts.instrument == pytest.approx(
        np.hypot([0.001, 0, 0.002], 0.003 * values), rel=1e6 * eps
    )
    assert parts.calibration == pytest.approx(0.01 * values, rel=4 * eps)
    assert np.array_equal(parts.rays, comparison.std_err)
    assert parts.single_precision == pytest.approx(values * 2.0**-20, rel=1e-3)
    total = np.hypot(comparison.other_std_err, comparison.std_err)
    # the two but for single precision, whose square is nothing beside theirs
    assert parts.total == pytest.approx(total, rel=1e-6)


def test_the_aperture_is_told_to_second_order():
    """cos(theta)^n about the normal: its mean over a cone in closed form.

    Weighted by the cosine it is 2 (1 - c^(n + 2)) / ((n + 2) (1 - c^2)) for a
    half-angle whose cosine is c. Statistics: 5 standard errors of both measurements.
    """
    n, half_angle = 30, 5.0
    lobe = {"type": "cosinelobe", "exponent": n, "normalisation": "modified_phong"}
    top = (n + 2) / (2 * np.pi)

    def mean(a):
        c = np.cos(np.radians(a))
        return top * 2 * (1 - c ** (n + 2)) / ((n + 2) * (1 - c**2))

    measured = MeasuredTable(
        *np.zeros((4, 1)), [top], aperture_half_angle=half_angle, uncertainty=0.02
    )
    few = {"rays": RAYS, "estimator": "next_event", "trace": True}
    comparison = compare(measure_like(lobe, measured, **few), measured)
    effect = aperture_effect(lobe, measured, comparison, **few)
    noise = 5 * 2 * comparison.std_err
    expected = 4 / 3 * (mean(half_angle) - mean(half_angle / 2))
    assert abs(effect[0] - expected) < noise
    assert abs(effect[0]) > 3 * noise  # the twin: no effect
    # of the fourth order of the half-angle: n (n - 2) / 24 a^4, and less than that
    rest = n**2 / 24 * np.radians(half_angle) ** 4 * top
    assert abs(effect[0] - (mean(half_angle) - top)) < rest + noise


def test_commands_write_the_budget(tmp_path, capsys):
    path, out = tmp_path / "table.csv", tmp_path / "budget.csv"
    table(np.array([10.0, 30]), [0.2, 0.2], aperture_half_angle=3).save(path)
    command = ["compare", "diffuse:reflectance=0.6283", str(path), "--budget", str(out)]
    assert main([*command, "--uncertainty", "0.01", "--divergence", "1"]) == 0
    assert "share of the variance" in capsys.readouterr().out
    names, *rows = out.read_text().splitlines()
    assert names.split(",")[7:] == [
        *("rays", "single_precision", "instrument", "calibration", "total", "z"),
        "aperture",
    ]
    assert len(rows) == 2
    instrument = float(rows[0].split(",")[9])
    assert instrument == pytest.approx(0.002, rel=1e-9)


def test_a_cell_of_its_own_for_the_other_specimen(tmp_path, capsys):
    """A cell is the specimen's, and that of a record of the other one's as well.

    A plate that is wider than the record's cell has no edges either.

    Alpha: 1e-3, that of the command.
    """
    cell = {"type": "rectangle", "bsdf": {"type": "twosided", "bsdf": DIFFUSE}}
    cell["to_world"] = mi.ScalarTransform4f().scale([0.5, 0.5, 1])
    file, settings = tmp_path / "cell.npz", {"rays": RAYS, "collector": "angle:8x24"}
    gonio.measure(cell, 30, period="1,1", **settings).save(file)
    command = ["compare", str(file), "diffuse:reflectance=0.7"]
    assert main(command) == 0
    assert main([*command, "--period", "box"]) == 0
    assert main(["compare", str(file), str(file), "--period", "box"]) == 1
    assert "--period applies to a specimen" in capsys.readouterr().err

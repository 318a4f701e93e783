"""A record and a table of the same seed have the same rays: their agreement is none."""

import numpy as np
import synthetic

import gonio_mi as gonio
from gonio_mi import cli, read_measured
from gonio_mi.analysis.comparison import compare, measure_like
from gonio_mi.collector.apertures import Apertures
from gonio_mi.results.provenance import shared_seeds

DIFFUSE = {"type": "diffuse"}
SHARED = "have the seed {}: their rays are not independent"


def measured(specimen=DIFFUSE, **settings):
    how = {"theta_i": 45, "collector": "projected:4x4", "rays": 2**14}
    return gonio.measure(specimen, **(how | settings))


def noted(record, other, seed):
    return any(SHARED.format(seed) in note for note in compare(record, other).notes)


def exported(record, path):
    gonio.export(record, path)
    return read_measured(path)


def test_a_table_of_the_same_rays_is_told(tmp_path):
    """Of the same seed values are the same, exactly; the twin has another seed."""
    record, other = measured(seed=3), measured(seed=4)
    table = exported(record, tmp_path / "run.csv")
    assert table.rays == {"seed": "3", "sampler": "sobol"}
    assert np.array_equal(table.value, measured(seed=3).brdf.ravel())
    assert noted(record, table, 3)
    assert not noted(other, table, 3)
    assert noted(record, measured(seed=3), 3)
    assert not noted(record, other, 3)
    dark = measured({"type": "diffuse", "reflectance": 0.2}, seed=3)
    assert not noted(record, dark, 3)  # which differs


def test_the_command_tells(tmp_path, capsys):
    record, path = tmp_path / "run.npz", tmp_path / "run.csv"
    measured(seed=5).save(record)
    exported(gonio.load(record), path)
    assert cli.main(["compare", str(record), str(path)]) == 0
    said = f"{path} and the record {SHARED.format(5)}"
    assert said in capsys.readouterr().out
    # an older file, which is read as ever, and no other program's
    lines = path.read_text().splitlines(keepends=True)
    for key in ("# seed", "# collector"):
        path.write_text("".join(line for line in lines if not line.startswith(key)))
        assert read_measured(path).rays == {}
        assert cli.main(["compare", str(record), str(path)]) != 1
        assert said not in capsys.readouterr().out


def test_seeds_of_merged_records_and_other_samplers(tmp_path):
    record = measured(seed=3)
    merged = record.merge(measured(seed=4))
    table = exported(merged, tmp_path / "merged.csv")
    assert table.rays["seed"] == "3, 4"
    assert noted(record, table, 3)
    assert noted(merged, measured(seed=4), 4)
    assert not noted(measured(seed=5), table, 5)
    # other rays of the same seed
    assert not noted(measured(seed=3, sampler="independent"), table, 3)
    integral = measured(seed=3, estimator="quadrature", rays=None)
    assert exported(integral, tmp_path / "integral.csv").rays == {}


def test_apertures_of_a_table_get_rays_of_their_own(tmp_path):
    """Exact; the twin does not say its seed, and has the same bits as the record."""
    apertures = Apertures(5.0, ((30.0, 0.0), (30.0, 120.0)))
    how = {"seed": 3, "rays": 2**14}
    table = exported(measured(collector=apertures, **how), tmp_path / "run.csv")
    for known, same in ((True, False), (False, True)):
        if not known:
            table.header.pop("seed")
        (anew,) = measure_like(DIFFUSE, table, **how)
        # the last detector is all the rest
        assert np.array_equal(anew.brdf.ravel()[:-1], table.value) == same


def test_what_is_shared():
    assert shared_seeds({"seed": "1, 2"}, {"seed": "2, 3"}) == "2"
    assert shared_seeds({"seed": "1"}, {"seed": "12"}) == ""
    assert shared_seeds({}, {}) == ""
    assert shared_seeds({"seed": "1", "sampler": "sobol"}, {"seed": "1"}) == "1"
    assert synthetic.record().with_provenance(seeds=()).ray_keys == {}

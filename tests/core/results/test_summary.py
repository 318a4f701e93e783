"""The numbers of a record and their text, on records made by hand."""

import json
from dataclasses import replace

import numpy as np
import pytest
import synthetic

from gonio_mi.cli import main
from gonio_mi.files.exr import attributes
from gonio_mi.results.campaign_outcome import CampaignOutcome, PredictionError
from gonio_mi.results.planning import precision
from gonio_mi.results.record import Record
from gonio_mi.results.summary import Total, summarize
from gonio_mi.results.summary_text import summary_text, total_cells
from gonio_mi.results.tally import Fate, Integrals


def moved(record, row, n):
    """Record `n` of whose absorbed rays have another fate, in the first batch."""
    (tally,) = record.tallies
    fates = tally.fates.copy()
    fates[0, Fate.ABSORBED] -= np.uint64(n)
    fates[0, row] += np.uint64(n)
    return replace(record, tallies=(replace(tally, fates=fates),))


def line(record, word):
    """The first line of a record's text that begins with `word`."""
    lines = summary_text(summarize(record)).splitlines()
    return next(line for line in lines if line.startswith(word))


@pytest.mark.parametrize(
    ("n", "share"),
    [
        (0, None),
        (1, "<0.0001"),
        (40, "0.0010"),
        (3_999_999, ">99.9999"),
        (4_000_000, "100.0000"),
    ],
)
def test_shares_are_0_or_100_of_nothing_and_all_only(n, share):
    record = synthetic.record(rays=10**6)
    tally = synthetic.writeable(record.tallies[0])
    tally.fates[:] = 0
    tally.fates[0, Fate.SIDEWAYS] = n
    tally.fates[0, Fate.ABSORBED] = 4 * 10**6 - n
    record = replace(record, tallies=(tally,))
    if share is None:
        assert "sideways" not in summary_text(summarize(record))
    else:
        assert line(record, "sideways").split()[-1] == share


@pytest.mark.parametrize("both", [False, True])
def test_light_that_nothing_collected_is_told(both):
    """Exact: of 80 000 rays 4000 are transmitted, or collected there."""
    record = moved(synthetic.record(both=both), Fate.TRANSMITTED, 4000 * (not both))
    said = summary_text(summarize(record))
    told = "5.0000 % of the rays left on the other side, where nothing was collected\n"
    assert (told in said) == ("nothing was collected" in said) == (not both)


@pytest.mark.parametrize("weighted", [True, False])
def test_fates_without_light_are_explained_where_rays_have_weights(weighted):
    (tally,) = synthetic.record().tallies
    counted = tally if weighted else replace(tally, scale=1)
    record = replace(synthetic.record(), tallies=(counted,))
    said = summary_text(summarize(moved(record, Fate.REJECTED, 1)))
    assert ("absorbed: weight 0" in said) == weighted
    assert ("; rejected: `sample` failed (zero density)\n" in said) == weighted
    assert "rejected:" not in summary_text(summarize(record))


def test_standard_errors_have_two_digits():
    record = synthetic.record()
    (total,) = summarize(record).directions[0].dhr
    std_err = line(record, "30 ").split()[5]
    assert len(std_err.lstrip("0.")) == 2
    # rounded to the last of its digits
    assert abs(float(std_err) - total.std_err) <= 10.0 ** -(len(std_err) - 2) / 2


def test_no_more_digits_than_single_precision_has():
    total = Total("Y", value=0.8, std_err=3e-11, low=0.8 - 6e-11, high=0.8 + 6e-11)
    # 2^-24 of the value
    assert total_cells(total) == ["0.800000000", "<0.000000048", *["0.800000000"] * 2]


def test_a_rounding_in_place_of_an_error_is_explained():
    """Where the batches agree to the last digit of single precision."""
    note = "<: below single-precision rounding"
    assert note not in summary_text(summarize(synthetic.record()))
    alike = synthetic.record()
    tally = synthetic.writeable(alike.tallies[0])
    tally.sums[:] = tally.sums[:1]
    tally.sums[0, 0, 0, 0] += np.uint64(1)
    said = summary_text(summarize(replace(alike, tallies=(tally,))))
    assert note in said


def test_an_interval_for_light_that_no_ray_found_is_explained():
    """Where batches hardly scatter.

    Twin: those of independent rays scatter by far more.
    """
    note = "leaves room for light so rare that no ray may have met it"
    assert "no ray may have" not in summary_text(summarize(synthetic.record()))
    alike = synthetic.record()
    tally = synthetic.writeable(alike.tallies[0])
    tally.sums[:] = tally.sums[:1]
    said = summary_text(summarize(replace(alike, tallies=(tally,))))
    assert note in " ".join(said.split())


@pytest.mark.parametrize("of", ["brdf", "btdf"])
def test_theta_o_counts_from_one_pole_in_both_hemispheres(of):
    record = synthetic.record(both=of == "btdf")
    theta, phi = (np.degrees(a) for a in record.subdivision.middles)
    if of == "btdf":
        theta = 180 - theta
    worst = summarize(record).worst_patches
    found = [patch for patch in worst if patch.of == of]
    assert found
    for patch in found:
        here = getattr(record, of)[..., 0] == patch.value
        here &= record.counts[int(of == "btdf")] == patch.hits
        assert (patch.theta_o, patch.phi_o) in zip(theta[here], phi[here])


@pytest.mark.parametrize("both", [False, True])
def test_what_is_outside_of_apertures_has_a_name(tmp_path, capsys, both):
    """Exact: one patch, the only one without angles, in the text and in JSON."""
    apertures = "apertures:5@30/200"
    record = synthetic.record(apertures, power=1, both=both, channels=("Y",))
    text = summary_text(summarize(record))
    assert "theta_o -: all directions outside of the apertures" in text
    assert "nan" not in text
    assert "outside" not in summary_text(summarize(synthetic.record()))
    record.save(path := str(tmp_path / "a.npz"))
    assert main(["show", path, "--json"]) == 0
    worst = json.loads(capsys.readouterr().out)["worst_patches"]
    rest = [one for one in worst if one["theta_o"] is None]
    assert len(rest) == 1 + both
    assert all(one["phi_o"] is None for one in rest)


@pytest.mark.parametrize("share", [1, 100])
def test_faint_patches_are_not_worth_reporting(share):
    """However little is known of them; the twin has as much light as the others."""
    record = synthetic.record()
    tally = synthetic.writeable(record.tallies[0])
    tally.sums[:] = 100
    tally.sums[::2, 0, 0, 0], tally.sums[1::2, 0, 0, 0] = 0, 2 * share
    uneven = replace(record, tallies=(tally,))
    worst = summarize(uneven).worst_patches[0]
    assert (worst.value == uneven.brdf[0, 0, 0]) == (share == 100)


def test_rays_of_all_passes_are_asked_for():
    """An interrupted record of two passes says how many there should be."""
    record = synthetic.record()
    assert "80 000, batches" in line(record, "rays")
    passes = record.with_provenance(passes=2)
    assert "80 000 of 160 000 asked for" in line(passes, "rays")


@pytest.mark.parametrize(("n", "warned"), [(1, False), (2, True)])
def test_a_ray_in_a_million_is_rounding(n, warned):
    """Where batches agree to the bit, as even points may."""
    record = synthetic.record(rays=250_000).with_settings(sampler="sobol")
    tally = synthetic.writeable(record.tallies[0])
    tally.fates[:] = 0
    tally.fates[:, Fate.REFLECTED] = 250_000
    tally.hits[:] = 0
    tally.hits[0, 0, 0] = 10**6
    tally.sums[:] = 0
    tally.sums[:, 0, 0, 0] = tally.incident
    even = replace(record, tallies=(tally,))
    assert even.dhr_std_err == 0
    low, high = even.interval(of="dhr")
    assert (high - low) / 2 < 2e-6
    stray = synthetic.writeable(tally)
    stray.fates[0, Fate.REFLECTED] -= np.uint64(n)
    stray.fates[0, Fate.SIDEWAYS] += np.uint64(n)
    warnings = summarize(replace(record, tallies=(stray,))).warnings
    assert bool(warnings) == warned


@pytest.mark.parametrize(
    ("fates", "transmission", "words"),
    [
        ({"rejected": 3}, "none", []),
        ({"invalid": 1}, "none", ["are invalid"]),
        ({"truncated": 1}, "none", ["were truncated by max_depth"]),
        ({"sideways": 600}, "none", ["left sideways"]),
        ({"missed": 600}, "none", ["missed the specimen"]),
        ({"invalid": 1, "sideways": 600}, "none", ["are invalid", "left sideways"]),
        ({"transmitted": 600}, "none", ["leaked to the other side"]),
        ({"transmitted": 600}, "declared", []),
    ],
)
def test_warnings(fates, transmission, words):
    record = synthetic.record().with_settings(transmission=transmission)
    for name, n in fates.items():
        record = moved(record, Fate[name.upper()], n)
    sentences = summarize(record).warnings
    assert len(sentences) == len(words)
    assert all(word in one for one, word in zip(sentences, words))


def test_text_fits_and_holds_the_ledger():
    record = moved(synthetic.record(), Fate.INVALID, 4)
    text = summary_text(summarize(record))
    assert max(map(len, text.splitlines())) <= 88
    words = [line.split() for line in text.splitlines()]
    for name, n in (record.ledger.rows | {"sum": 80_000}).items():
        row = [name, *f"{n:,}".split(","), f"{n / 800:.4f}"]
        assert (row in words) == (n > 0 or name == "transmitted")


@pytest.mark.parametrize("row", [Fate.SIDEWAYS, Fate.MISSED])
def test_losses_beyond_the_statistical_error_are_warned_of(row):
    record = synthetic.record()
    low, high = record.interval(of="dhr")
    few, many = (round(f * (high - low)[0] / 2 * 80_000) for f in (0.9, 1.1))
    assert not summarize(moved(record, row, few)).warnings
    (warning,) = summarize(moved(record, row, many)).warnings
    assert "more than the statistical error" in warning


def test_what_is_not_known_is_none():
    """No standard error, and so no precision, of a single batch of even rays."""
    record = synthetic.record(n_batches=1).with_settings(sampler="sobol")
    assert precision(record) == (np.inf, precision(synthetic.record())[1])
    (direction,) = summarize(record).directions
    assert direction.rel_err_lobe is None
    assert direction.dhr[0].std_err is None
    assert summarize(record).worst_patches == []
    text = " ".join(summary_text(summarize(record)).split())
    assert "their standard errors are not known" in text
    assert " - - - " in text
    numbers = summarize(record).as_mapping()
    assert json.loads(json.dumps(numbers, allow_nan=False)) == numbers


def test_integrals_say_what_stands_for_rays():
    record = synthetic.integrals()
    numbers = summarize(record)
    text = summary_text(numbers)
    assert "none: the BSDF is integrated over each patch, rel_err 0.0001" in text
    header = line(record, "theta_i").split()
    assert header[4:] == ["value", "error", "low", "high"]
    assert "95%" not in text
    assert "std_err" not in text
    assert "no standard error" in " ".join(text.split())
    assert "hit" not in text
    assert numbers.worst_patches[0].hits is None
    assert "integrals" in repr(record)
    assert "ray" not in repr(record)
    maps = attributes(record, 0, "brdf")
    assert "counted" not in maps["gonio.meaning"]
    assert maps["gonio.ledger"] == "empty: quadrature traces no rays"


def test_rays_beside_integrals_are_of_delta_components():
    (sampled,) = synthetic.record().tallies
    flux = np.full((*sampled.hits.shape, 1), 0.01)
    both = Integrals.beside(sampled, flux, 1e-7 * flux)
    record = replace(synthetic.record(), tallies=(both,))
    assert "80 000 for delta components, all else integrated" in line(record, "rays")
    assert "integrals and 80 000 rays" in repr(record)
    assert line(record, "sum").split()[1:3] == ["80", "000"]


@pytest.mark.parametrize("n", [1, 3, 4])
def test_a_line_on_a_record_does_not_grow_with_its_directions(n):
    record = replace(
        Record.stack([synthetic.record()] * n), theta_i=np.arange(n) * 10.0
    )
    text = repr(record)
    assert "\n" not in text
    assert text.count("(") == 1 + min(n, 3)  # (theta_i, phi_i)
    lowest = f"{record.dhr.min():.5g}"
    assert (f"dhr {lowest} to {lowest}>" in text) == (n > 3)


def test_totals_of_many_directions_are_left_out_in_the_middle(tmp_path, capsys):
    """Half of the rows from both ends; all are asked for by an option."""
    one = synthetic.record()
    many = Record.stack([one] * 50)
    path = tmp_path / "many.npz"
    many.save(path)
    whole = []
    for record, options in ((one, []), (many, []), (many, ["--all"])):
        record.save(path)
        assert main(["show", str(path), *options]) == 0
        rows = capsys.readouterr().out.splitlines()
        whole.append(sum("  dhr  " in row for row in rows))
        left = [row for row in rows if "rows are left out" in row]
        assert left == [row for row in left if row.startswith("... 10 rows")]
        assert len(left) == (len(record) == 50 and not options)
    assert whole == [1, 40, 50]


def test_of_chosen_directions_extremes_are_shown():
    """The lowest, the highest and the least certain total; twin: of others all."""
    one, tallies = synthetic.record(), []
    for seed in range(8):
        tallies += synthetic.record(seed=seed).tallies
    record = replace(Record.stack([one] * 8), theta_i=np.arange(0.0, 80, 10))
    record = replace(record, tallies=tuple(tallies))
    errors = (PredictionError(30, 20, 0.01, 0.001, 0, 0),)
    chosen = CampaignOutcome(0.1, 80, True, 1, None, (), 8, 0, 1.0, errors)
    summary = summarize(record.with_provenance(campaign=chosen))
    dhr, std_err = record.dhr[:, 0], record.dhr_std_err[:, 0]
    of_text = {int(np.argmin(dhr)), int(np.argmax(dhr)), int(np.argmax(std_err))}
    assert len({*dhr}) == 8
    for text, kept in (
        (summary_text(summary), of_text),
        (summary_text(summary, 40), range(8)),
        (summary_text(summarize(record)), range(8)),
    ):
        rows = [line.split() for line in text.splitlines() if "  dhr  " in line]
        assert [float(row[0]) for row in rows] == [10.0 * n for n in sorted(kept)]
        assert (f"... {8 - len(kept)} rows are left out" in text) == (len(kept) < 8)


def test_nothing_is_0():
    total = Total("Y", value=0.0, std_err=3e-15, low=0.0, high=6e-15)
    assert total_cells(total) == ["0", "3e-15", "0", "6e-15"]


def test_patches_with_too_few_heavy_hits_are_counted():
    """One heavy hit on one patch of many alike, whose uncertainty all others share."""
    record = synthetic.record(n_batches=16)
    tally = synthetic.writeable(record.tallies[0])
    assert not record.pooled.any()
    assert "bright hits" not in summary_text(summarize(record))
    tally.sums[:, 0] = tally.hits[0][..., None] * 1e3
    tally.sums[1, 0, 2, 3] += tally.scale
    tally.hits[0, 2, 3] += np.uint64(1)
    record = replace(record, tallies=(tally,))
    assert record.pooled.shape == record.counts.shape
    n = np.count_nonzero(record.counts)
    assert record.pooled.sum() == n == summarize(record).directions[0].n_pooled
    text = " ".join(summary_text(summarize(record)).split())
    assert f"{n} with too few bright hits" in text

"""Ctrl-C amid long batches: what whole rounds have sent is kept, and carried on.

Everything here is exact: rays, ledgers and bits.
"""

import signal
import warnings
from dataclasses import replace
from types import SimpleNamespace

import mitsuba as mi
import numpy as np
import pytest

import gonio_mi as gonio
from gonio_mi import cli
from gonio_mi.campaigns.measure import measure_whole
from gonio_mi.instrument import launcher, recording
from gonio_mi.instrument.schedule import rounds

MATT = {"type": "diffuse"}
LONG = {"theta_i": 40, "rays": 40_003, "batches": 4, "collector": "projected:6x8"}


@pytest.fixture(autouse=True)
def short_rounds(monkeypatch):
    """Rounds of 1024 rays of each batch, on machines where launches hold as many."""
    for name in ("ROUND_TRACED", "ROUND_PLANE", "ROUND_SHARED"):
        monkeypatch.setattr(launcher, name, 2**10)
    for name in ("FUSED_RAYS", "FIRST_TRACED", "FIRST_PLANE"):
        monkeypatch.setattr(launcher, name, 2**11)
    monkeypatch.setattr(launcher, "LAUNCH_SECONDS", 1e-9)


@pytest.fixture
def ctrl_c(monkeypatch):
    """Function that lets Ctrl-C come at a launch, by its number from 1.

    As Python takes it, even if a shell in the background ignores it.
    """
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    send = launcher.launch

    def press(at):
        number = iter(range(1, 10**9))

        def pressed(*arguments):
            if next(number) == at:
                signal.raise_signal(signal.SIGINT)
            return send(*arguments)

        monkeypatch.setattr(launcher, "launch", pressed)

    yield press
    signal.signal(signal.SIGINT, before)


def interrupted(*args, **settings):
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "interrupted: ", RuntimeWarning)
        record = gonio.measure(*args, **settings)
    assert record.settings["interrupted"]
    return record


def rays_of(record):
    """Rays of each batch."""
    return record.tallies[0].fates.sum(axis=1).tolist()


# ----------------------------------------------------------------------- rounds


def test_only_rays_that_are_soon_traced_have_long_rounds(monkeypatch):
    """Through surfaces; twins: in media, and of rays that look at points."""
    monkeypatch.setattr(launcher, "ROUND_SHARED", 2**14)

    def rays(media=(), n_looks=1, batches=3):
        specimen = SimpleNamespace(media=media, plane=None)
        settings = SimpleNamespace(batches=batches, n_looks=n_looks, trace=True)
        sampler = mi.load_dict({"type": "sobol"})
        setup = SimpleNamespace(specimen=specimen, settings=settings, sampler=sampler)
        return launcher.rays_per_round(setup)

    assert [rays(batches=n) for n in (1, 3, 4, 64)] == [2**14, 2**12, 2**12, 2**10]
    assert rays(media=("fog",)) == rays(n_looks=900) == 2**10


@pytest.mark.parametrize("plan", [[1], [7, 6], [1024] * 3, [10**9] * 16])
def test_rounds_lead_to_the_plan(plan):
    ends = rounds(plan, 1024)
    assert ends[-1] == plan
    each = [0, *(end[0] for end in ends)]
    lengths = np.diff(each)
    assert (lengths > 0).all()
    # what may be lost: an eighth, but for the first ones and a last one put to it
    before = np.array(each[:-1])
    assert (lengths[:-1] <= np.maximum(1024, before[:-1] / 8)).all()
    assert lengths[-1] <= 1.5 * max(1024, before[-1] / 8)
    for end, length in zip(each[1:-1], lengths):
        assert end % length == length & (length - 1) == 0
        # the same ones from there on
        following = ends[each.index(end) :]
        assert rounds(plan, 1024, start=end) == following


# ------------------------------------------------------------------ interruption


@pytest.mark.parametrize(
    ("trace", "cuts"),
    [
        (False, ((2, 2, 1024), (7, 4, 1024), (30, 4, 7168))),
        (True, ((3, 2, 1024), (7, 4, 1024), (31, 4, 7168))),
    ],
)
def test_ctrl_c_amid_long_batches(ctrl_c, trace, cuts):
    """The record is that of a measurement of fewer rays, and goes on to all of them.

    In the first round it holds the batches that have finished it.
    """
    settings = LONG | {"trace": trace}
    whole = gonio.measure(MATT, **settings)
    for at, batches, each in cuts:
        ctrl_c(at)
        part = interrupted(MATT, **settings)
        assert rays_of(part) == [each] * batches
        assert part.ledger.emitted == each * batches
        ctrl_c(0)
        if batches == 4:
            fewer = gonio.measure(MATT, **settings | {"rays": 4 * each})
            assert part.tallies == fewer.tallies
        assert gonio.measure(MATT, **settings, resume=part).tallies == whole.tallies


def test_late_ctrl_c_loses_an_eighth(ctrl_c, monkeypatch):
    """Of the rays that were sent, or the launches of the first rounds."""
    sent = []
    count = launcher.launch

    def counted(one):
        sent.append(sum(one.sizes))
        return count(one)

    monkeypatch.setattr(launcher, "launch", counted)
    gonio.measure(MATT, **LONG)
    for at in (len(sent) // 2, len(sent)):
        monkeypatch.setattr(launcher, "launch", count)
        ctrl_c(at)
        part = interrupted(MATT, **LONG)
        lost = sum(sent[: at - 1]) - part.ledger.emitted
        assert 0 <= lost <= max(4 * 1024, part.ledger.emitted / 8)


def test_bits_hold_where_sums_are_rounded(ctrl_c, monkeypatch):
    """Beyond 53 bits; the twin rounds elsewhere, which half of the sums show."""
    metal = {"type": "roughconductor", "alpha": 0.3}
    settings = {"theta_i": 60, "collector": "projected:1x1", "batches": 4}
    settings["rays"] = 4 * (2**20 + 2**18)
    monkeypatch.setattr(launcher, "LAUNCH_SECONDS", 1.0)
    monkeypatch.setattr(launcher, "ROUND_PLANE", 2**16)
    whole = gonio.measure(metal, **settings)
    ctrl_c(10)
    part = interrupted(metal, **settings)
    ctrl_c(0)
    assert gonio.measure(metal, **settings, resume=part).tallies == whole.tallies
    monkeypatch.setattr(launcher, "ROUND_PLANE", 2**22)
    other = gonio.measure(metal, **settings)
    assert other.tallies != whole.tallies
    np.testing.assert_allclose(other.dhr, whole.dhr, rtol=1e-14)


@pytest.mark.usefixtures("spectral")
def test_ctrl_c_in_a_stack_of_passes(ctrl_c):
    """Five wavelengths, which the rays of two passes carry."""
    settings = LONG | {"theta_i": [0, 50], "wavelengths": [450, 500, 550, 600, 650]}
    whole = gonio.measure(MATT, **settings)
    ctrl_c(110)
    part = interrupted(MATT, **settings)
    ctrl_c(0)
    assert [t.n_batches for t in part.tallies] == [4, 4]
    assert gonio.measure(MATT, **settings, resume=part).tallies == whole.tallies


def interrupted_once(function):
    """Function in whose first call Ctrl-C is pressed."""
    calls = []

    def pressed(*arguments):
        calls.append(arguments)
        if len(calls) == 1:
            raise KeyboardInterrupt
        return function(*arguments)

    return pressed


@pytest.mark.parametrize("at", [0, 25])
def test_ctrl_c_after_the_last_ray(ctrl_c, at, monkeypatch):
    """While the record is made: it holds all rays that were sent, and is not lost.

    Also if it is pressed for the second time.
    """
    ctrl_c(at)
    expected = interrupted(MATT, **LONG) if at else gonio.measure(MATT, **LONG)
    makes = recording._records
    monkeypatch.setattr(recording, "_records", interrupted_once(makes))
    ctrl_c(at)
    part = interrupted(MATT, **LONG)
    assert part.tallies == expected.tallies
    monkeypatch.setattr(recording, "_records", interrupted_once(makes))
    ctrl_c(at)
    with pytest.raises(KeyboardInterrupt):  # who wants a whole is not told that it is
        measure_whole(MATT, **LONG)
    ctrl_c(0)
    rest = gonio.measure(MATT, **LONG, resume=part)
    assert rest.ledger.emitted == LONG["rays"]


def test_ctrl_c_before_the_precision_asked_for(ctrl_c):
    settings = {"theta_i": 40, "rel_err": 1e-3, "max_rays": 10**7}
    ctrl_c(25)
    part = interrupted(MATT, **settings)
    assert len(set(rays_of(part))) == 1
    assert part.settings["reached"] > 1e-3


@pytest.mark.parametrize(("at", "each"), [(20, {5120}), (0, {10_000, 10_001})])
def test_ctrl_c_while_rendering(ctrl_c, at, each, monkeypatch):
    """It ends the script, and the film keeps what was measured.

    Also if it is pressed when all rays are there.
    """
    parts = {
        "integrator": {"type": "goniophotometer", "rays": 40_003, "batches": 4},
        "sensor": {"type": "collector", "film": {"type": "patches"}},
        "emitter": {"type": "directional", "direction": [0, 0, -1]},
        "specimen": {"type": "rectangle"},
    }
    scene = mi.load_dict({"type": "scene", **parts})
    if not at:
        makes = interrupted_once(recording._records)
        monkeypatch.setattr(recording, "_records", makes)
    ctrl_c(at)
    with pytest.raises(RuntimeError) as caught:
        mi.render(scene)
    assert isinstance(caught.value.__cause__, KeyboardInterrupt)  # Dr.Jit wraps it
    record = scene.sensors()[0].film().record
    assert record.settings["interrupted"]
    assert set(rays_of(record)) == each


@pytest.mark.parametrize(("batches", "each"), [(3, 10_001), (4, 2000)])
def test_other_batches_are_refused(batches, each):
    """Rounds send all batches alike."""
    whole = gonio.measure(MATT, **LONG)
    fewer = LONG | {"rays": batches * each, "batches": batches}
    other = replace(whole, tallies=gonio.measure(MATT, **fewer).tallies)
    said = f"{batches} batches of up to {each} rays instead of 4"
    with pytest.raises(ValueError, match=said):
        gonio.measure(MATT, **LONG, resume=other)


def test_command_keeps_whole_rounds(ctrl_c, tmp_path, capsys):
    command = ["measure", "diffuse", "--theta-i", "40", "-q"]
    command += ["--rays", str(LONG["rays"]), "--collector", LONG["collector"]]
    command += ["--batches", "4"]
    part, rest = (str(tmp_path / f"{name}.npz") for name in ("part", "rest"))
    ctrl_c(25)
    assert cli.main([*command, "-o", part]) == 2
    emitted = gonio.load(part).ledger.emitted
    assert emitted % (4 * 1024) == 0
    said = capsys.readouterr().err
    assert f"{emitted:,} rays; --resume".replace(",", " ") in said
    ctrl_c(0)
    assert cli.main([*command, "--resume", part, "-o", rest]) == 0
    assert gonio.load(rest).tallies == gonio.measure(MATT, **LONG).tallies


def test_other_wavelengths_are_refused(spectral):  # noqa: ARG001
    """Twin: the same ones are carried on."""
    few = {"theta_i": 40, "rays": 2000, "batches": 2, "collector": "projected:2x2"}
    part = gonio.measure(MATT, **few, wavelengths=[500, 600])
    for nm in ([510, 700], [500], [500, 600, 700]):
        said = r"made with channels=.*500nm.* instead of"
        with pytest.raises(ValueError, match=said):
            gonio.measure(MATT, **few, wavelengths=nm, resume=part)
    again = gonio.measure(MATT, **few, wavelengths=[500, 600], resume=part)
    assert again.tallies == part.tallies

"""Phase functions are asked whether `sample` and `eval` agree, before rays are sent.

Their answers are the same at each call: these tests are exact, but for those that say
so. A right phase function is said to be wrong with a probability of `FALSE_ALARM`.
"""

import re
import warnings
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from budget import agree, disagree, single
from slabs import medium, stack

import gonio_mi as gonio
from gonio_mi import cli
from gonio_mi.specimen import media, specimen
from gonio_mi.specimen.media import ask_phase_function, phase_defect
from gonio_mi.specimen.wavelengths import wavelength_lanes

TABLE = Path(__file__).parents[3] / "notebooks" / "reliability.md"
COSINES = np.linspace(-1, 1, 101)
BOX = (-1, -1, -1), (0, 1, 2)


def flakes(*diagonal, rest=(0, 0, 0)):
    """Mirror flakes of a matrix S, in the order xx, yy, zz, xy, xz, yz."""
    grid = mi.VolumeGrid(np.float32([*diagonal, *rest]).reshape(1, 1, 1, 6))
    return {"type": "sggx", "S": {"type": "gridvolume", "grid": grid, "raw": True}}


def table():
    values = (1 - 0.36) / (4 * np.pi * (1.36 - 1.2 * COSINES) ** 1.5)
    return {"type": "tabphase", "values": ",".join(f"{v:.9g}" for v in values)}


def phase(name):
    """Phase function of a row of the handbook's table."""
    if name.startswith("hg"):
        return {"type": "hg", "g": float(name.rpartition(" ")[2])}
    if name.startswith("sggx"):
        return flakes(*map(float, name.split("diag ")[1].split()))
    parts = {"a": {"type": "hg", "g": -0.4}, "b": {"type": "hg", "g": 0.7}}
    others = {
        "tabphase": table,
        "blendphase": lambda: {"type": "blendphase", "weight": 0.7, **parts},
    }
    return others.get(name, lambda: {"type": name})()


def lanes():
    return wavelength_lanes((550.0,) if mi.is_spectral else None)


ROWS = re.findall(
    r"^\| `?([a-z]\w+)`?([^|]*)\| ([0-9.]+) \| (\w+)", TABLE.read_text(), re.M
)
ROWS = [(name + more.rstrip(), float(x), told) for name, more, x, told in ROWS]
ROWS = [row for row in ROWS if row[2] in ("yes", "no")]


@pytest.mark.parametrize("variant", ["mono", "spectral"])
def test_the_table_of_the_handbook(request, variant, monkeypatch):
    """All stock phase functions; the last digit may be rounded elsewhere.

    In one variant: in another, a right one and a wrong one.
    """
    request.getfixturevalue(variant)
    answers = []

    def asked_once(*arguments):
        answers.append(ask_phase_function(*arguments))
        return answers[-1]

    monkeypatch.setattr(media, "ask_phase_function", asked_once)
    monkeypatch.setattr(media, "is_sound", lambda _: False)
    assert {re.split(" ", name)[0] for name, *_ in ROWS} == {
        *("isotropic", "rayleigh", "hg", "tabphase", "blendphase", "sggx")
    }
    rows = ROWS
    if variant == "spectral":
        rows = [next(row for row in ROWS if row[2] == told) for told in ("yes", "no")]
    for name, misplaced, told in rows:
        sentence = phase_defect(mi.load_dict(phase(name)), lanes(), *BOX)
        found = answers.pop()
        if not found.nonsense:
            assert abs(found.misplaced.max() - misplaced) <= 0.01, name
        assert (sentence is not None) == (told == "yes"), name


@pytest.mark.parametrize("g", [-0.99, -0.5, 1e-4, 0.9, 0.95])
def test_no_false_alarm(g, monkeypatch):
    """Nor is one asked at all; twin: a peak too narrow to take it for sound."""
    sound = mi.load_dict({"type": "hg", "g": g})
    assert media.is_sound(sound)
    assert not media.is_sound(mi.load_dict({"type": "hg", "g": 0.995}))
    monkeypatch.setattr(media, "is_sound", lambda _: False)
    assert phase_defect(sound, lanes(), *BOX) is None


def isotropic(*, density=1 / (4 * np.pi), weight=1.0, fails=False):
    """Phase function in Python, which need not be right."""

    class Isotropic(mi.PhaseFunction):
        def __init__(self, props):
            mi.PhaseFunction.__init__(self, props)
            self.m_flags = mi.PhaseFunctionFlags.Isotropic

        def sample(self, ctx, mei, u1, u2, active=True):
            del ctx, mei, u1, active
            wo = mi.warp.square_to_uniform_sphere(u2)
            return wo, mi.Spectrum(weight), mi.Float(density)

        def eval_pdf(self, ctx, mei, wo, active=True):
            del ctx, mei, active
            if fails:
                raise NotImplementedError
            return mi.Spectrum(density) + 0 * wo.x, mi.Float(density)

        def to_string(self):
            return "Isotropic[]"

    mi.register_phase("isotropic_in_python", Isotropic)
    return mi.load_dict({"type": "isotropic_in_python"})


def test_phase_functions_in_python():
    """Right ones, one without `eval_pdf`, and a few that lose or create light."""
    assert phase_defect(isotropic(), lanes(), *BOX) is None
    assert phase_defect(isotropic(fails=True), lanes(), *BOX) is None
    assert "Isotropic disagree" in phase_defect(isotropic(weight=0.8), lanes(), *BOX)
    assert "disagree" in phase_defect(isotropic(density=1 / (3 * np.pi)), lanes(), *BOX)
    assert "infinite, NaN or" in phase_defect(isotropic(density=-1.0), lanes(), *BOX)


def test_ctrl_c_is_no_failure(monkeypatch):
    """Neither is it where a loop of Dr.Jit has wrapped it."""

    def pressed(*_):
        raise RuntimeError from KeyboardInterrupt()

    phase = isotropic()
    monkeypatch.setattr(type(phase), "eval_pdf", pressed)
    with pytest.raises(RuntimeError):
        phase_defect(phase, lanes(), *BOX)


def share_up(diagonal, theta_i, n=1500):
    """Light that mirror flakes scatter up, once, of what comes from `theta_i` degrees.

    Heitz et al. 2015, *The SGGX Microflake Distribution*: the density of normals seen
    from wi, over four times their cosine.
    """
    wi = np.array([np.sin(np.radians(theta_i)), 0, np.cos(np.radians(theta_i))])
    z = (np.arange(n) + 0.5) / n
    phi = 2 * np.pi * (np.arange(2 * n) + 0.5) / (2 * n)
    sine = np.sqrt(1 - z**2)[:, None]
    wo = np.array([sine * np.cos(phi), sine * np.sin(phi), z[:, None] + 0 * phi])
    half = wo + wi[:, None, None]
    half /= np.linalg.norm(half, axis=0)
    s = np.array(diagonal)
    normals = 1 / (
        np.pi * np.sqrt(s.prod()) * np.einsum("ijk,i->jk", half**2, 1 / s) ** 2
    )
    return 2 * np.pi * np.mean(normals / 4) / np.sqrt(wi**2 @ s)


# Single scattering, in a kernel that tests share.
ONCE = {"collector": "projected:1x1", "period": "box"}
ONCE |= {"sampler": "independent", "order": 1}


@pytest.mark.parametrize(
    ("diagonal", "right"), [((1.0, 1.0, 1.0), True), ((0.02, 0.02, 1.0), False)]
)
def test_a_thin_slab_of_flakes(tmp_path, capsys, diagonal, right):
    """Single scattering of 5e5 rays, within statistics and the optical depth of 1e-3.

    What the warning says is so: `eval` is right, and `sample` is not.
    """
    expected = share_up(diagonal, 60.0)
    assert abs(expected - (0.5 if right else 0.957)) < 1e-3
    scene = stack(medium(1e-3, 1.0, flakes(*diagonal)))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        record = gonio.measure(scene, 60, **ONCE, rays=500_000)
    up, down = record.dhr[0], record.dht[0]
    n = up * 500_000 + down * 500_000
    share = up / (up + down)
    score = (share - expected) / np.sqrt(expected * (1 - expected) / n)
    (agree if right else disagree)(single(score))
    told = [str(w.message) for w in caught if "sample() and eval()" in str(w.message)]
    assert len(told) == (not right)
    assert record.settings.get("defects", []) == told
    record.save(tmp_path / "slab.npz")
    assert cli.main(["show", str(tmp_path / "slab.npz")]) == 0
    assert ("SGGXPhaseFunction disagree" in capsys.readouterr().out) == (not right)


def campaign_of_one(scene, theta_i, **settings):
    return gonio.campaign({"slab": scene}, theta_i, **settings)["slab"]


def test_a_specimen_is_asked_once(monkeypatch):
    """Once for all directions of a measurement, a campaign's too; all records tell."""
    asked = []

    def counted(*args):
        asked.append(args)
        return phase_defect(*args)

    monkeypatch.setattr(specimen, "phase_defect", counted)
    told = []
    for measure in (gonio.measure, campaign_of_one):
        for share in (0.02, 1.0):
            scene = stack(medium(1e-3, 1.0, flakes(share, share, 1.0)))
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                stacked = measure(scene, [0, 40], **ONCE, rays=10_000)
            for record in stacked:
                found = record.settings.get("defects", [])
                assert len(found) == (share < 1)
            told += [w for w in caught if str(w.message) in found]
    assert (len(asked), len(told)) == (4, 2)

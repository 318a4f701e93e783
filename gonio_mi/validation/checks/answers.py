"""Answers of each function: finite, non-negative and repeatable."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from functools import cache
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...array_types import Flags, Floats, Numbers
from ...collector.directions import direction
from ..conditions import POSITION, TURN
from ..evidence import BIAS, INTERFACE, Evidence
from ..kinds import Kind
from ..probe import Probe, random_numbers, spectral, vectors
from ..samples import Samples, beyond_rounding, unequal

# Properties that hold unless two functions contradict each other.
AGREEMENTS = (
    "directions",
    "sampling",
    "weights",
    "sampled_pdf",
    "sampled_weight",
    "eval_pdf",
    "eval_pdf_sample",
)

# Directions of the lattice on the sphere.
N_LATTICE = 2**12

# What a function does whose answers change for no reason that is known.
MIXED = "mixes local and world coordinates"
OF_WORLD = "depends on where the surface is in the world"

# Properties that are lacking if two functions depend differently on the place.
OF_PLACE = {"sampled_weight": ("eval", "sample"), "sampled_pdf": ("pdf", "sample")}

# What a lobe can be: names as in mi.BSDFFlags.
LOBES = (
    "Null",
    "DiffuseReflection",
    "DiffuseTransmission",
    "GlossyReflection",
    "GlossyTransmission",
    "DeltaReflection",
    "DeltaTransmission",
)

# Relative difference of a reflectance that is the same.
MAX_ALBEDO_OFF = 1e-3

# Distance of two directions that are the same, however they round.
MAX_DISPLACEMENT = 1e-3


def check_samples(evidence: Evidence, samples: Samples) -> None:
    """Check that all answers about samples are finite and at least 0."""
    given = samples.given
    smooth = given & ~samples.delta
    everywhere = np.ones_like(given)
    cases: list[tuple[str, str, Floats, Flags]] = [
        ("sample", "weight", samples.weight, everywhere),
        ("sample", "pdf", samples.sampled_pdf, given),
        # components of a vector may be negative
        ("sample", "direction", np.abs(samples.wo), given),
        ("eval", "value", samples.eval, smooth),
        ("eval", "value", samples.reverse, smooth),
        ("pdf", "value", samples.pdf, smooth),
    ]
    for name in ("eval_pdf", "eval_pdf_sample"):
        cases += [(name, "value", x, smooth) for x in samples.joint[name]]
    for function, what, value, where in cases:
        wrong = improper(value) & where
        if wrong.any():
            evidence.breach(
                "answers",
                function,
                samples.fraction(wrong),
                f"the {what} of `{function}` is {example(value[wrong])} in places",
                samples.condition.middle(wrong),
                size=float(wrong.mean()),
                off=float(wrong.mean()),
                about=what,
            )


@cache
def lattice() -> Floats:
    """Directions on the sphere, evenly spread, shape (n, 3)."""
    z = (np.arange(N_LATTICE) + 0.5) / N_LATTICE * 2 - 1
    return direction(np.arccos(z), np.arange(N_LATTICE) * np.pi * (5**0.5 - 1))


def check_lattice(evidence: Evidence, probe: Probe) -> None:
    """Check the same on a lattice of directions on the sphere, sampled or not."""
    wo = lattice()
    value, density = probe.values(wo), probe.densities(wo)
    for function, answer in (("eval", value), ("pdf", density)):
        wrong = improper(answer)
        if wrong.any():
            i = int(wrong.argmax())
            x, y, z = wo[i]
            theta, phi = np.degrees([np.arccos(z), np.arctan2(y, x)])
            black = np.isfinite(answer[wrong]).all() and not value[wrong].any()
            evidence.breach(
                "answers",
                function,
                f"{wrong.mean():.3g} of all directions at {probe.condition}, such as "
                f"theta_o {theta:.0f}, phi_o {phi % 360:.0f}",
                f"the value of `{function}` is {example(answer[wrong])} in places",
                probe.condition,
                size=float(wrong.mean()),
                off=float(wrong.mean()),
                effect=INTERFACE if black else "",
            )


def check_frames(evidence: Evidence) -> None:
    """Check that local answers do not depend on the surface's rotation in the world.

    A model may depend on its place in the world as long as its functions agree. It is a
    mistake only if they contradict each other on a turned surface and on no other, or
    if a transform that is applied once too often explains all differences. A turned
    surface is moved, too: where that alone changes the answers, one function has
    forgotten the place, or another has it without reason.
    """
    flat, turned = (
        {
            (b.name, b.function)
            for b in evidence.breaches
            if b.name in AGREEMENTS and b.effect == BIAS
            if b.condition is not None and b.condition.turned == is_turned
        }
        for is_turned in (False, True)
    )
    for samples in evidence.whole:
        found = None
        if samples.condition.turned and samples.usable.any():
            found = _turned_answer(evidence.bsdf, samples)
        if found is None:
            continue
        function, wrong, mistake = found
        if _turned_answer(evidence.bsdf, samples, moved=True) is None:
            _add_place(evidence, samples, function, {name for name, _ in turned - flat})
        elif turned - flat or not mistake.startswith(MIXED):
            evidence.breach(
                "answers",
                function,
                f"{samples.fraction(wrong)}, where the surface is turned",
                f"`{function}` {mistake}",
                samples.condition.middle(wrong),
                size=2.0,
                kind=Kind.OTHER_IN_THE_WORLD,
            )
        else:
            evidence.remark("answers", f"`{function}` {OF_WORLD}")
        return


def _add_place(
    evidence: Evidence, samples: Samples, function: str, names: Collection[str]
) -> None:
    """Add what depends on the place alone: properties `names` are lacking there."""
    evidence.remark("answers", f"`{function}` {OF_WORLD}")
    for name in filter(names.__contains__, OF_PLACE):
        both = OF_PLACE[name]
        text = "` and `".join(both)
        evidence.breach(
            "answers",
            " or ".join(both),
            f"{samples.condition}, where the surface is moved",
            f"`{text}` depend differently on the place in the world, si.p",
            samples.condition,
            size=2.0,
            kind=Kind[name.upper()],
        )
        return


def _turned_answer(
    bsdf: mi.BSDF, samples: Samples, moved: bool = False
) -> tuple[str, Flags, str] | None:
    """Function whose answers change with the surface's rotation, or None.

    With the samples that show it, and the mistake. `sample` comes last, for its answers
    may follow from those of the others. Unless the surface is `moved` in both cases,
    its place changes, too.
    """
    probe = Probe(bsdf, replace(samples.condition, turned=False))
    if moved:
        probe.p = mi.Point3f(POSITION.tolist())
    usable, wo = samples.usable, samples.wo
    mixed = MIXED
    for function, ask, here, slack in (
        ("eval", probe.values, samples.eval, samples.eval_slack),
        ("pdf", probe.densities, samples.pdf, samples.pdf_slack),
    ):
        wrong = unequal(ask(wo), here, slack) & usable
        if beyond_rounding(wrong):
            for name, axes in (("to_local", TURN), ("to_world", TURN.T)):
                # a mask may ask for the side of either
                alike = usable & ((wo @ axes)[:, 2] * wo[:, 2] > 0)
                other = unequal(ask(wo @ axes), here, slack)
                if beyond_rounding(alike & wrong) and not beyond_rounding(
                    other & alike
                ):
                    return function, wrong, f"applies `{name}` to wo, which is local"
            return function, wrong, mixed
    bs, weight = probe.sample(*samples.random)
    flat = spectral(bs.wo, samples.n)
    wrong = _displaced(flat, wo) & samples.smooth
    if beyond_rounding(wrong):
        if not beyond_rounding(_displaced(flat @ TURN.T, wo) & samples.smooth):
            mixed = "returns directions in world coordinates, where local ones are due"
        return "sample", wrong, mixed
    wrong = unequal(spectral(weight, samples.n), samples.weight, 0.0) & samples.smooth
    return (
        ("sample", wrong, f"{mixed} in its weight") if beyond_rounding(wrong) else None
    )


def _displaced(a: Floats, b: Floats) -> Flags:
    """Mask of directions that differ by more than rounding, even at the horizon."""
    return np.abs(a - b).max(axis=1) > MAX_DISPLACEMENT


def check_order(evidence: Evidence, samples: Samples) -> None:
    """Check that answers do not depend on the place of a ray in the array."""
    # of a sweep, so that incident directions and places are reversed, too
    probe = Probe(evidence.bsdf, samples.condition)
    i = samples.n - 1 - dr.arange(mi.UInt32, samples.n)
    probe.uv = dr.gather(mi.Point2f, probe.uv, i)
    if mi.is_spectral:
        kind = type(probe.wavelengths)
        probe.wavelengths = dr.gather(kind, probe.wavelengths, i)
    wo, wi = samples.wo[::-1], vectors(samples.wi[::-1])
    _, weight = probe.sample(*random_numbers(samples.u[::-1]), wi=wi)
    n = samples.n
    for function, answer, due, slack in (
        ("eval", probe.values(wo, samples.wi[::-1]), samples.eval, samples.eval_slack),
        ("pdf", probe.densities(wo, samples.wi[::-1]), samples.pdf, samples.pdf_slack),
        ("sample", spectral(weight, n), samples.weight, 0.0),
    ):
        wrong = unequal(answer[::-1], due, slack) & samples.usable
        if beyond_rounding(wrong):
            evidence.breach(
                "answers",
                function,
                samples.fraction(wrong),
                f"`{function}` depends on the place of a ray in the array",
                samples.condition.middle(wrong),
                size=2.0,
                off=float(wrong.mean()),
                kind=Kind.OTHER_IN_ANOTHER_PLACE,
            )
            return


def check_albedo(evidence: Evidence) -> None:
    """Check range of ``eval_diffuse_reflectance``, and its value if Lambertian."""
    samples = evidence.whole[0]
    name, all_flags = "eval_diffuse_reflectance", int(evidence.bsdf.flags())
    probe = Probe(evidence.bsdf, samples.condition)
    reported = probe.of_surface(name)
    mistake = ""
    if improper(reported[None]).any():
        mistake = f"the value of `{name}` is {example(reported[None])}"
    usable = samples.usable & samples.reflected & (samples.wo[:, 2] != 0)
    lobes = sum(int(getattr(mi.BSDFFlags, lobe)) for lobe in LOBES)
    if all_flags & lobes == int(mi.BSDFFlags.DiffuseReflection) and usable.any():
        value = np.pi * samples.eval[usable] / np.abs(samples.wo[usable, 2:])
        due = np.median(value, axis=0)
        even = np.ptp(value, axis=0).max() < MAX_ALBEDO_OFF * due.max()
        if even and np.abs(reported - due).max() > MAX_ALBEDO_OFF * due.max():
            mistake = f"`{name}` is not the reflectance of `eval`, {due.max():.4g}"
    if mistake:
        text = f"{reported.max():.4g} at {samples.condition}"
        evidence.breach(
            "answers",
            name,
            text,
            mistake,
            samples.condition,
            effect=INTERFACE,
            kind=Kind.ALBEDO,
        )


def improper(value: Numbers) -> Flags:
    """Mask of rows that are negative or not finite, shape ``(n,)``."""
    wrong: Any = ~np.isfinite(value) | (value < 0)
    return wrong if wrong.ndim == 1 else wrong.any(axis=1)


def example(improper_rows: Numbers) -> str:
    """The first number of the first row that is negative or not finite."""
    row = np.ravel(improper_rows[0])
    return f"{row[improper(row)][0]:g}"


def check_memory(
    evidence: Evidence,
    first: Samples,
    after: tuple[Floats, Floats],
    again: Samples,
) -> None:
    """Check that answers about the first samples do not depend on earlier calls.

    `after` are answers of ``eval`` and ``pdf`` that were asked for in between.
    """
    for function, before, after_all in (
        ("eval", first.eval, after[0]),
        ("pdf", first.pdf, after[1]),
        ("sample", first.weight, again.weight),
        ("sample", first.sampled_pdf, again.sampled_pdf),
        ("eval", first.eval, again.eval),
        ("pdf", first.pdf, again.pdf),
    ):
        usable: Any = np.isfinite(before) & np.isfinite(after_all)
        usable = usable if usable.ndim == 1 else usable.all(axis=1)
        wrong = unequal(before, after_all, 0.0) & usable
        if beyond_rounding(wrong):
            evidence.breach(
                "answers",
                function,
                first.fraction(wrong),
                f"`{function}` returns different values when called again",
                first.condition,
                kind=Kind.OTHER_WHEN_CALLED_AGAIN,
            )
            return

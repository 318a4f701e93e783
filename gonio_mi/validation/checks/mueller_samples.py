"""`sample`, `eval`, `pdf` and `eval_pdf` agree in all elements of their matrices."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...array_types import Flags, Floats
from ...collector.stokes import UPRIGHT
from ..evidence import Evidence
from ..kinds import Kind, MatrixKind
from ..mueller import (
    Lobes,
    Matrices,
    condition_of,
    is_depolarised,
    off,
    other_mode,
    per_light,
    readings,
)
from ..samples import beyond_rounding

# Properties that are judged here, of each transport mode.
AGREEMENTS = ("sampled_pdf", "sampled_weight", "eval_pdf")

# Relative difference of densities that is no rounding.
ROUNDING = 2e-3

# Fraction of the difference that a reading leaves which explains it.
EXPLAINED = 0.05


def check_finite(evidence: Evidence, matrices: Matrices) -> None:
    """Check that all elements are finite and that the first is not negative."""
    function, raw = matrices.function, matrices.raw
    bad = ~np.isfinite(raw).all(axis=(-1, -2, -3))
    negative = (np.nan_to_num(matrices.light) < 0).any(axis=-1)
    for wrong, what in (
        (bad, "elements that are not finite"),
        (negative, "a negative first element"),
    ):
        if (wrong := np.asarray(wrong)).any():
            condition = condition_of(matrices, tuple(np.argwhere(wrong)[0]))
            evidence.breach(
                "answers",
                function,
                f"{what} for {100 * wrong.mean():.3g} % of the matrices, as at "
                f"{condition}{matrices.place(wrong)}",
                f"`{function}` returns matrices with {what}",
                condition,
                size=float(wrong.mean()),
                off=float(wrong.mean()),
            )


def check_weights(
    evidence: Evidence, lobes: Lobes, values: Matrices, pdf: Floats, slack: Floats
) -> None:
    """Check that weight times pdf is `eval`, and that the pdf is that of `pdf`."""
    usable = lobes.smooth & values.finite & np.isfinite(pdf)
    if not usable.any():
        return
    density = lobes.pdf
    wrong = usable & (np.abs(density - pdf) > ROUNDING * np.maximum(density, pdf))
    if beyond_rounding(wrong):
        ratio = density[wrong] / np.maximum(pdf[wrong], 1e-30)
        low, high = np.quantile(ratio, [0.05, 0.95])
        condition = condition_of(lobes.weights, tuple(np.argwhere(wrong)[0]))
        statistic = (
            f"the pdf of `sample` is {low:.4g} to {high:.4g} times that of `pdf` for "
            f"{100 * wrong.mean():.3g} % of the samples, as at {condition}"
            f"{values.place(wrong)}"
        )
        mistake = f"`sample` or `pdf`: their densities differ{values.in_mode}"
        evidence.breach(
            "sampled_pdf", "sample or pdf", statistic, mistake, condition,
            size=float(wrong.mean()),
        )  # fmt: skip
    flux = lobes.flux
    light = np.maximum(values.light, flux.light)[..., None, None]
    difference = np.where(light > 0, flux.raw - values.raw, 0)
    difference = np.abs(difference / np.where(light > 0, light, 1))
    size = difference.max(axis=(-1, -2, -3))
    wrong = usable & (size > ROUNDING + slack)
    if not beyond_rounding(wrong):
        return
    suspects: tuple[str, ...] = ("sample", "eval")
    if values.mode == "radiance":
        # importance mode tells which answers of `eval` are due
        suspects = ("eval",) if evidence.of("adjoint") else ("sample",)
    function, mistake = _difference_guess(
        flux.take(wrong), values.take(wrong), suspects
    )
    worst = tuple(np.argwhere(wrong)[np.argmax(size[wrong])])
    condition = condition_of(flux, worst)
    place = np.unravel_index(np.argmax(difference[worst].max(axis=0)), (4, 4))
    evidence.breach(
        "sampled_weight",
        function,
        f"weight times pdf is off `eval` by up to {size[worst]:.3g} of the first "
        f"element, in element {place[0]}{place[1]} at {condition}, for "
        f"{100 * wrong.mean():.3g} % of the samples{values.place(wrong)}",
        f"{mistake}{values.in_mode}",
        condition,
        size=float(wrong.mean()),
        off=float(wrong.mean()),
    )


def _difference_guess(
    flux: Matrices, values: Matrices, suspects: Sequence[str]
) -> tuple[str, str]:
    """Guilty function and mistake, where weight times pdf is not `eval`."""
    m_flux, m_eval = per_light(flux.raw), per_light(values.raw)
    light = np.maximum(flux.light, values.light)
    if (np.abs(flux.light - values.light) > ROUNDING * light).mean() > 0.5:
        return "eval or sample", (
            "`eval` or `sample`: weight times pdf is another first element than that "
            "of `eval`; the unpolarised variant tells more"
        )
    if is_depolarised(m_eval) and not is_depolarised(m_flux):
        return "eval", "`eval` depolarises where `sample` does not"
    if is_depolarised(m_flux) and not is_depolarised(m_eval):
        return "sample", "`sample` depolarises where `eval` does not"
    misfit = off(m_flux, m_eval)
    for function in suspects:
        matrices, right = (flux, values) if function == "sample" else (values, flux)
        due = per_light(right.in_plane())
        for mistake, read in (*readings(matrices, UPRIGHT), *other_mode(matrices)):
            left = off(per_light(read), due)
            if np.mean(left) < EXPLAINED * np.mean(misfit):
                return function, f"`{function}` {mistake}"
    names = [
        f"{i}{j}"
        for i, j in np.ndindex(4, 4)
        if np.abs(m_flux - m_eval)[..., i, j].max() > ROUNDING
    ]
    function = " or ".join(sorted(suspects))
    return function, (
        f"{function.replace('eval', '`eval`').replace('sample', '`sample`')}: weight "
        f"times pdf differs from `eval` in {len(names)} elements "
        f"({', '.join(names[:6])}{', ...' if len(names) > 6 else ''}) but the first"
    )


def check_eval_pdf(
    evidence: Evidence,
    values: Matrices,
    pdf: Floats,
    joint: Matrices,
    joint_pdf: Floats,
    asked: Flags,
) -> None:
    """Check that ``eval_pdf`` answers as ``eval`` and ``pdf``, in all elements."""
    light = np.where(values.light > 0, values.light, 1)[..., None, None]
    change = (np.abs(joint.raw - values.raw) / light).max(axis=(-1, -2, -3))
    density = np.abs(joint_pdf - pdf) / np.maximum(np.maximum(joint_pdf, pdf), 1e-30)
    for what, wrong, kind in (
        ("values", asked & (change > ROUNDING), MatrixKind.EVAL_PDF),
        ("densities", asked & (density > ROUNDING), Kind.EVAL_PDF),
    ):
        if beyond_rounding(wrong):
            condition = condition_of(values, tuple(np.argwhere(wrong)[0]))
            evidence.breach(
                "eval_pdf",
                "eval_pdf",
                f"its {what} differ for {100 * wrong.mean():.3g} % of the pairs, as at "
                f"{condition}{values.place(wrong)}",
                f"`eval_pdf` gives other {what} than `eval` and `pdf`{values.in_mode}",
                condition,
                size=float(wrong.mean()),
                kind=kind,
                about="pdf",
            )

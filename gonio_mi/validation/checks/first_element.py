"""The first element of a matrix is the answer of the unpolarised variant."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from ...array_types import Flags, Floats, Integers
from ...errors import SettingError
from ...transport.bsdf_trial import PluginFault
from ...transport.variants import unpolarised
from ..conditions import Condition
from ..evidence import Evidence
from ..mueller import Lobes, Matrices, condition_of
from ..probe import Probe, numbers, random_numbers, spectral, vectors
from ..samples import is_many

# Relative difference of two ways to compute one value, in single precision.
ROUNDING = 2e-3


@dataclass(frozen=True)
class _Unpolarised:
    """Answers of the variant without polarisation."""

    value: Floats
    flux: Floats
    type: Integers


def check_first_element(
    evidence: Evidence,
    load: Callable[[], mi.BSDF] | None,
    values: Matrices,
    lobes: Lobes,
    random: Floats,
) -> None:
    """Compare ``eval``, and shares of discrete lobes, with the other variant's.

    `load` loads the plugin there; None if nobody knows how.
    """
    variant = unpolarised(mi.variant())
    if load is None or variant not in mi.variants():
        evidence.undecided["first_element"] = (
            f"it takes a dictionary or a file, to load the plugin in {variant} too"
        )
        return
    try:
        with _variant(variant):
            plain = _ask(load(), values, lobes, random)
    except (SettingError, PluginFault, ImportError, RuntimeError) as error:
        text = f"the plugin is not to be had in {variant}: {error}"
        evidence.undecided["first_element"] = text
        return
    light = values.light
    wrong = _differs(light, plain.value) & values.finite
    if is_many(wrong):
        _breach(evidence, values, light, plain.value, wrong)
    shares = lobes.flux.light
    wrong = _differs(shares, plain.flux) & lobes.delta & (lobes.type == plain.type)
    if is_many(wrong):
        _breach(evidence, lobes.flux, shares, plain.flux, wrong)


def _breach(
    evidence: Evidence, matrices: Matrices, light: Floats, plain: Floats, wrong: Flags
) -> None:
    ratio = light[wrong].sum(-1) / np.maximum(plain[wrong].sum(-1), 1e-30)
    low, high = np.quantile(ratio, [0.05, 0.95])
    factor = f"{low:.4g}"
    if not np.isclose(low, high, rtol=1e-3):
        factor = f"{low:.4g} to {high:.4g}"
    function = matrices.function
    condition = condition_of(matrices, tuple(np.argwhere(wrong)[0]))
    evidence.breach(
        "first_element",
        function,
        f"it is {factor} times the unpolarised answer for {100 * wrong.mean():.3g} % "
        "of the directions",
        f"`{function}` reflects or transmits {factor} times what it does without "
        "polarisation: a factor of one of its two branches is missing",
        condition,
        size=float(wrong.mean()),
        off=float(min(1.0, np.abs(ratio - 1).mean()) * wrong.mean()),
    )


def _differs(a: Floats, b: Floats) -> Flags:
    size = np.maximum(np.abs(a), np.abs(b))
    return np.asarray((np.abs(a - b) > ROUNDING * size + 1e-9).any(axis=-1))


def _ask(bsdf: mi.BSDF, values: Matrices, lobes: Lobes, random: Floats) -> _Unpolarised:
    probe, n = Probe(bsdf, Condition(0.0)), values.wi[..., 0].size
    value = spectral(probe.eval(vectors(values.wo), wi=vectors(values.wi)), n)
    wi = lobes.weights.wi
    n_lobes = wi[..., 0].size
    bs, weight = probe.sample(*random_numbers(random), wi=vectors(wi))
    flux = spectral(weight, n_lobes) * numbers(bs.pdf, n_lobes)[:, None]
    return _Unpolarised(
        value.reshape(values.light.shape),
        flux.reshape(lobes.weights.light.shape),
        numbers(bs.sampled_type, n_lobes).astype(np.int64).reshape(lobes.type.shape),
    )


@contextlib.contextmanager
def _variant(name: str) -> Iterator[None]:
    """Another variant of Mitsuba's until the end of the block."""
    before = mi.variant()
    mi.set_variant(name)
    try:
        yield
    finally:
        mi.set_variant(before)

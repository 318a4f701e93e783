"""Findings of the checks: certain breaches, and statistical tests with p-values."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, field, replace
from typing import Any

import mitsuba as mi
import numpy as np

from ..array_types import Flags, Floats
from ..single_precision import BSDF_ROUNDING
from .conditions import Condition
from .kinds import Kind, MatrixKind
from .maps import FourMaps
from .samples import Samples, beyond_rounding

# What a failure does to an image, the worst first.
BIAS = "biases images"
BREAKS = "breaks some integrators"
NOISE = "adds noise"
MODEL = "a property of the model"
INTERFACE = "interface only (no effect on images)"
COST = "adds cost"  # never a failure
EFFECTS = (BIAS, BREAKS, NOISE, MODEL, INTERFACE)

# What a BSDF should have, in the order of a verdict.
PROPERTIES = {
    "answers": "all functions answer, with finite values of at least 0",
    "directions": "sampled directions are unit vectors on the side of their type",
    "sampling": "directions are drawn with the density of `pdf`",
    "weights": "the mean of sampled weights is the integral of `eval`",
    "sampled_pdf": "the pdf that `sample` returns is that of `pdf`",
    "sampled_weight": "weight times pdf is `eval`",
    "eval_pdf": "`eval_pdf` answers as `eval` and `pdf`",
    "eval_pdf_sample": "`eval_pdf_sample` answers as the separate functions",
    "energy": "no more flux leaves than arrives",
    "continuity": "no jump at normal incidence, nothing black before the horizon",
    "reciprocity": "source and detector can be exchanged, with a factor eta^2",
    "adjoint": "radiance and importance mode are adjoint to each other",
    "delta": "discrete lobes have one direction, weight and probability",
    "flags": "flags declare the observed behaviour",
    "components": "components add up to the whole",
    "masks": "inactive rays carry no light, active ones the same as without a mask",
    "ends": "finite at the ends: horizon, normal, random numbers, roughness",
    "parameters": "`traverse` answers; gradients of `eval` are its changes",
    "cost": "repeated calls compile no kernel",
}

# The same in polarised variants, of all elements of Mueller matrices.
POLARISED = {
    "answers": "all functions answer, with finite matrices",
    "first_element": "the first element is the answer without polarisation",
    "sampled_pdf": PROPERTIES["sampled_pdf"],
    "sampled_weight": "weight times pdf is `eval`, in all elements",
    "eval_pdf": PROPERTIES["eval_pdf"],
    "realisable": "each matrix is that of a real surface (Cloude)",
    "energy": "no more flux leaves than arrives, of any polarisation",
    "frames": "matrices turn with the directions, without jumps",
    "reciprocity": "source and detector can be exchanged, in all elements",
    "adjoint": "radiance and importance mode are adjoint, in all elements",
}

# The same of phase functions, whose `eval_pdf` answers what is called `eval` and `pdf`.
PHASE = {
    name: PROPERTIES[name]
    for name in ("answers", "directions", "sampling", "weights", "sampled_pdf")
    + ("sampled_weight", "energy", "reciprocity", "flags", "components", "masks")
    + ("ends", "parameters", "cost")
} | {
    "answers": "both functions answer, with finite values of at least 0; `eval` and "
    "`pdf` are the answers of `eval_pdf`",
    "directions": "sampled directions are unit vectors",
    "masks": "active rays get the same as without a mask",
    "energy": "`eval` integrates to 1",
    "reciprocity": "source and detector can be exchanged",
}

# Mitsuba's integrators that a failure reaches, by what they call.
_COMBINED = "path, direct, volpathmis, prb: light and BSDF sampling are combined"
_SAMPLED = "all integrators that sample the BSDF"

# Effect of a failure, unless its breach says otherwise, and integrators that it
# reaches if that biases images or breaks integrators.
_EFFECTS_OF = {
    "answers": (BIAS, "all integrators"),
    "directions": (BIAS, _SAMPLED),
    "sampling": (BIAS, _COMBINED),
    "weights": (BIAS, _SAMPLED),
    "sampled_pdf": (BIAS, _COMBINED),
    "sampled_weight": (BIAS, _SAMPLED),
    "eval_pdf": (BIAS, "path, direct, volpathmis, prb"),
    "eval_pdf_sample": (BIAS, "path"),
    "energy": (MODEL, None),
    "continuity": (MODEL, None),
    "reciprocity": (MODEL, "all integrators"),
    "adjoint": (BREAKS, "ptracer and all that trace light from its source"),
    "delta": (BIAS, _SAMPLED),
    "flags": (
        INTERFACE,
        "path, direct, volpath, prb: no light is sampled without a smooth lobe",
    ),
    "components": (INTERFACE, None),
    "masks": (INTERFACE, None),
    "ends": (BIAS, "all integrators, in single pixels"),
    "parameters": (BREAKS, "prb and all that change or differentiate parameters"),
    "cost": (INTERFACE, None),
    "first_element": (BIAS, "all integrators, in polarised variants"),
    "realisable": (BIAS, "all integrators, in polarised variants"),
    "frames": (BIAS, "all integrators, in polarised variants"),
}

# Probability by chance below which a single test says by itself that something is
# wrong: above the level of a test, so that whatever fails is looked at.
MAX_P = 1e-4

# A larger ratio has a denominator of 0.
MAX_RATIO = 1e20

# If importance mode is right and radiance mode is not.
_FROM_SENSORS = "path and all that trace rays from the sensor"


def integrators(name: str, effect: str | None) -> str | None:
    """Integrators that a failure of a property reaches by its effect, if known."""
    if name == "adjoint" and effect == BIAS:
        return _FROM_SENSORS
    if name == "reciprocity" and effect == BREAKS:
        name = "adjoint"
    return _EFFECTS_OF[name][1] if effect in (BIAS, BREAKS) else None


@dataclass(frozen=True)
class Finding:
    """A failed check, or the result of a statistical test.

    Attributes
    ----------
    name : str
        Property, a key of `PROPERTIES`.
    statistic : str
        How much and where.
    condition : Condition or None
        Where; None for one over all conditions.
    off : float, optional
        Fraction of the light, or of the samples, that is wrong; None if not known.
    effect : str
        On an image, one of `EFFECTS`; that of its property by default.
    kind : Kind or MatrixKind
        What it is about, by which its reproducer is chosen; its property by default.
    about : str
        More of that: what of an answer, another function, a parameter, a component, a
        normal, or pairs of directions.
    """

    name: str
    statistic: str
    condition: Condition | None = None
    off: float | None = None
    effect: str = ""
    kind: Kind | MatrixKind | None = None
    about: str = ""

    def __post_init__(self) -> None:
        kinds: dict[str, Any] = dict(Kind.__members__)
        if mi.is_polarized:
            kinds |= MatrixKind.__members__
        own = kinds.get(self.name.upper(), Kind.RAISES)
        object.__setattr__(self, "kind", self.kind or own)
        object.__setattr__(self, "effect", self.effect or _EFFECTS_OF[self.name][0])

    @property
    def share(self) -> float | None:
        """Fraction of the light of a lit surface that is affected; None if not known.

        The wrong fraction times the cosine of the angle of incidence, to which the
        irradiance is proportional: next to nothing at 89 degrees.
        """
        if self.off is None:
            return None
        theta_i = 0.0 if self.condition is None else self.condition.theta_i
        return self.off * math.cos(math.radians(theta_i))


@dataclass(frozen=True)
class Breach(Finding):
    """A property that a BSDF certainly lacks.

    Attributes
    ----------
    function : str
        Of the plugin, the likely culprit.
    mistake : str
        What is likely wrong, as a sentence about the function.
    size : float
        Severity: the worst breach of a property is shown.
    """

    function: str = ""
    mistake: str = ""
    size: float = 1.0


@dataclass(frozen=True)
class Test(Finding):
    """A statistical test of a property, with its p-value `p`."""

    p: float = 1.0

    __test__ = False  # no test of pytest's


@dataclass
class Evidence:
    """All findings about a BSDF.

    Attributes
    ----------
    bsdf : mi.BSDF
    seed : int
    properties : dict of str
        Questions by name: `PROPERTIES`, `POLARISED` in polarised variants, or `PHASE`
        of a phase function.
    breaches, tests : list
    undecided : dict of str
        By property, why it could not be decided and what it would take.
    downgraded : dict of str
        By property, its effect though it does not fail: adds noise, or cost.
    remarks : dict of str
        By property, remarks on one that holds.
    declared : dict of str
        By property, why it is lacking with the plugin's own declaration.
    maps : list of FourMaps
    samples : list of Samples
    suspects : dict
        By property, the guilty function and mistake of a test that tells them.
    sweeps : list of Samples
        Of many incident directions, one for each sample.
    in_radiance_mode : list of Samples
        Of conditions under which it is not importance mode over eta^2.
    """

    bsdf: mi.BSDF = None
    seed: int = 0
    properties: dict[str, str] = field(default_factory=lambda: PROPERTIES)
    breaches: list[Breach] = field(default_factory=list)
    tests: list[Test] = field(default_factory=list)
    undecided: dict[str, str] = field(default_factory=dict)
    downgraded: dict[str, str] = field(default_factory=dict)
    remarks: dict[str, str] = field(default_factory=dict)
    declared: dict[str, str] = field(default_factory=dict)
    maps: list[FourMaps] = field(default_factory=list)
    samples: list[Samples] = field(default_factory=list)
    suspects: dict[str, tuple[str, str]] = field(default_factory=dict)
    sweeps: list[Samples] = field(default_factory=list)
    in_radiance_mode: list[Samples] = field(default_factory=list)

    @property
    def whole(self) -> list[Samples]:
        """Samples of all components together."""
        return [one for one in self.samples if one.condition.component is None]

    def breach(
        self,
        name: str,
        function: str,
        statistic: str,
        mistake: str,
        condition: Condition | None = None,
        **others: Any,
    ) -> None:
        """Add a :class:`Breach`.

        One of a single component concerns the interface: no integrator asks for one.
        """
        others |= {"function": function, "mistake": mistake}
        if condition is not None and condition.component is not None:
            others["effect"] = INTERFACE
        self.breaches.append(Breach(name, statistic, condition, **others))

    def breach_of_ratio(
        self,
        name: str,
        function: str,
        samples: Samples,
        wrong: Flags,
        ratio: Floats,
        what: str,
        mistake: str,
        **others: Any,
    ) -> None:
        """Add a breach on how far a ratio is from 1, if many samples are `wrong`."""
        if not beyond_rounding(wrong):
            return
        usable = wrong & (np.abs(ratio) < MAX_RATIO)
        spread = "infinite"
        if usable.any():
            low, middle, high = np.quantile(ratio[usable], [0.05, 0.5, 0.95])
            spread = f"{low:.4g} to {high:.4g}, median {middle:.4g}"
        off = np.mean(np.where(usable, np.minimum(np.abs(ratio - 1), 1), wrong))
        self.breach(
            name,
            function,
            f"{what} is {spread} for {samples.fraction(wrong)}",
            mistake,
            samples.condition.middle(wrong),
            size=float(wrong.mean()),
            off=float(off),
            **others,
        )

    def change(self, some: Collection[Breach], **changes: Any) -> None:
        """Give these very breaches other attributes."""
        chosen = set(map(id, some))
        self.breaches[:] = [
            replace(one, **changes) if id(one) in chosen else one
            for one in self.breaches
        ]

    def of(self, name: str) -> list[Breach]:
        """Breaches of a property."""
        return [one for one in self.breaches if one.name == name]

    def worst(self, name: str) -> Breach | None:
        """The worst breach of a property, of equal ones the first; None without."""
        found = self.of(name)
        worst = max(found, key=lambda one: one.size, default=None)
        if worst is None:
            return None
        equal = worst.size * (1 - BSDF_ROUNDING)  # the same mistake in two functions
        return next((one for one in found if one.size >= equal), worst)

    def remark(self, name: str, text: str) -> None:
        """Note something that does not make a property fail."""
        known = self.remarks.get(name)
        if known is None or text not in known:
            self.remarks[name] = f"{known}; {text}" if known else text

    def test(
        self,
        name: str,
        p: float,
        statistic: str,
        condition: Condition | None = None,
        off: float | None = None,
        **others: Any,
    ) -> None:
        """Add a :class:`Test`.

        One of a single component concerns the interface, too.
        """
        component = None if condition is None else condition.component
        effect = "" if component is None else INTERFACE
        self.tests.append(Test(name, statistic, condition, off, effect, p=p, **others))

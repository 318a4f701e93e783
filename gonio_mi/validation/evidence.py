"""What the checks find: certain breaches, and tests that chance takes part in."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from .collecting import Drawn
from .conditions import Condition
from .maps import FourMaps

__all__ = [
    "BIAS",
    "BREAKS",
    "COST",
    "EFFECTS",
    "HARM",
    "INTERFACE",
    "MODEL",
    "NOISE",
    "PROPERTIES",
    "Breach",
    "Evidence",
    "Test",
    "harm",
    "share",
    "where",
]

# What a failure does to an image, the worst first.
BIAS = "biases images"
BREAKS = "breaks some integrators"
NOISE = "adds noise"
MODEL = "a property of the model"
INTERFACE = "a nicety of the interface"
COST = "adds cost"  # never a failure
EFFECTS = (BIAS, BREAKS, NOISE, MODEL, INTERFACE)

# What a BSDF should have, in the order of a verdict.
PROPERTIES = {
    "answers": "all functions answer, with finite values of at least 0",
    "directions": "sampled directions are unit vectors on the side of their type",
    "sampling": "directions are drawn with the density of `pdf`",
    "weights": "sampled weights sum up to the integral of `eval`",
    "sampled_pdf": "the pdf that `sample` returns is that of `pdf`",
    "sampled_weight": "weight times pdf is `eval`",
    "eval_pdf": "`eval_pdf` answers as `eval` and `pdf`",
    "eval_pdf_sample": "`eval_pdf_sample` answers as the separate functions",
    "energy": "no more light leaves than came",
    "continuity": "no jump at normal incidence, nothing black before the horizon",
    "reciprocity": "exchanging source and detector changes nothing, but by eta^2",
    "adjoint": "radiance and importance mode are adjoint to each other",
    "delta": "discrete lobes have one direction, weight and probability",
    "flags": "flags declare what is observed",
    "components": "components add up to the whole",
    "masks": "inactive rays get 0, active ones what they get anyway",
    "ends": "finite at the ends: horizon, normal, random numbers, roughness",
    "parameters": "`traverse` answers; gradients of `eval` are its changes",
    "cost": "what is asked again compiles nothing",
}

# What a failure of each does, if its breach does not say otherwise; and to which of
# Mitsuba's integrators, by what they call.
HARM = {
    "answers": BIAS,
    "directions": BIAS,
    "sampling": BIAS,
    "weights": BIAS,
    "sampled_pdf": BIAS,
    "sampled_weight": BIAS,
    "eval_pdf": BIAS,
    "eval_pdf_sample": BIAS,
    "energy": MODEL,
    "continuity": MODEL,
    "reciprocity": MODEL,
    "adjoint": BREAKS,
    "delta": BIAS,
    "flags": INTERFACE,
    "components": INTERFACE,
    "masks": INTERFACE,
    "ends": BIAS,
    "parameters": BREAKS,
    "cost": INTERFACE,
}
COMBINED = "path, direct, volpathmis, prb: light and BSDF sampling are combined"
SAMPLED = "all that sample the BSDF"
WHERE = {
    "answers": "all",
    "directions": SAMPLED,
    "sampling": COMBINED,
    "weights": SAMPLED,
    "sampled_pdf": COMBINED,
    "sampled_weight": SAMPLED,
    "eval_pdf": "path, direct, volpathmis, prb",
    "eval_pdf_sample": "path",
    "reciprocity": "all",
    "adjoint": "ptracer and all that trace light from its source",
    "delta": SAMPLED,
    "flags": "path, direct, volpath, prb: no light is sampled without a smooth lobe",
    "ends": "all, in single pixels",
    "parameters": "prb and all that change or differentiate parameters",
}

# Where a mode is wrong that cannot be that of light, it is that of sensors.
WHERE_OF_SENSORS = "path and all that trace rays from the sensor"


def where(name: str, effect: str | None) -> str | None:
    """Integrators that a failure of a property reaches by its effect, if known."""
    if name == "adjoint" and effect == BIAS:
        return WHERE_OF_SENSORS
    return WHERE.get(name) if effect in (BIAS, BREAKS) else None


@dataclass(frozen=True)
class Breach:
    """A property that a BSDF certainly lacks.

    Attributes
    ----------
    property : str
        Key of `PROPERTIES`.
    function : str
        Of the plugin, the likely culprit.
    statistic : str
        How much and where.
    mistake : str
        What is likely wrong, as a sentence about the function.
    size : float
        The larger, the more it says: the worst breach of a property is shown.
    effect : str, optional
        One of `EFFECTS`; that of its property by default.
    off : float, optional
        Part of the light, or of the samples, that it is about; None if not known.
    theta_i : float
        Where that is, in degrees.
    """

    property: str
    function: str
    statistic: str
    mistake: str
    size: float = 1.0
    effect: str | None = None
    off: float | None = None
    theta_i: float = 0.0


def harm(breach: Breach) -> str:
    """What a breach does to an image."""
    return breach.effect or HARM[breach.property]


@dataclass(frozen=True)
class Test:
    """A statistical test of a property, with its p-value.

    Attributes
    ----------
    property : str
    p : float
        Probability of so much by chance.
    statistic : str
    condition : Condition or None
        None for one over all conditions.
    off : float, optional
        Part of the light, or of the samples, that is not where it should be.
    """

    property: str
    p: float
    statistic: str
    condition: Condition | None = None
    off: float | None = None

    __test__ = False  # no test of pytest's


def share(found: Breach | Test) -> float | None:
    """How much of the light of a lit surface a finding is about; None if not known.

    What is off, times the cosine of the angle of incidence: so much of the light of a
    source a surface gets. At 89 degrees a hundredth is off of next to nothing.
    """
    if found.off is None:
        return None
    if isinstance(found, Breach):
        theta_i = found.theta_i
    else:
        theta_i = 0.0 if found.condition is None else found.condition.theta_i
    return found.off * math.cos(math.radians(theta_i))


@dataclass
class Evidence:
    """All that was found about a BSDF.

    Attributes
    ----------
    breaches, tests : list
    undecided : dict of str
        By property, why it could not be decided and what it would take.
    lesser : dict of str
        By property, what it does though it does not fail: adds noise, or cost.
    remarks : dict of str
        By property, what is worth knowing though it holds.
    declared : dict of str
        By property, why it is lacking with the plugin's own declaration.
    maps : list of FourMaps
    drawn : list of Drawn
    """

    breaches: list[Breach] = field(default_factory=list)
    tests: list[Test] = field(default_factory=list)
    undecided: dict[str, str] = field(default_factory=dict)
    lesser: dict[str, str] = field(default_factory=dict)
    remarks: dict[str, str] = field(default_factory=dict)
    declared: dict[str, str] = field(default_factory=dict)
    maps: list[FourMaps] = field(default_factory=list)
    drawn: list[Drawn] = field(default_factory=list)

    def breach(self, *args: Any, **kwargs: Any) -> None:
        """Add a :class:`Breach`."""
        self.breaches.append(Breach(*args, **kwargs))

    def remark(self, name: str, text: str) -> None:
        """Note what says nothing against a property."""
        known = self.remarks.get(name)
        self.remarks[name] = f"{known}; {text}" if known else text

    def test(self, *args: Any, **kwargs: Any) -> None:
        """Add a :class:`Test`."""
        self.tests.append(Test(*args, **kwargs))

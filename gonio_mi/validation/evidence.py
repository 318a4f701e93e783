"""Findings of the checks: certain breaches, and statistical tests with p-values."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

import mitsuba as mi
import numpy as np

from ..array_types import Flags, Floats
from ..single_precision import BSDF_ROUNDING
from ..specimen.bsdf_trial import PluginFault
from .arrays import drawn, parameters
from .conditions import Condition, Effort
from .judgements import same
from .maps import FourMaps, four_maps
from .mistakes import Claim, Function, Guess, Mistake
from .probe import Probe
from .samples import Samples, beyond_rounding, means_differ, unequal

# What a failure does to an image, the worst first.
BIAS = "biases images"
BREAKS = "breaks some integrators"
NOISE = "adds noise"
MODEL = "a property of the model"
INTERFACE = "interface only (no effect on images)"
COST = "adds cost"  # never a failure
EFFECTS = (BIAS, BREAKS, NOISE, MODEL, INTERFACE)

# Mitsuba's integrators that a failure reaches, by what they call.
ALL = "all integrators"
COMBINED = "path, direct, volpathmis, prb: light and BSDF sampling are combined"
SAMPLED = "all integrators that sample the BSDF"
POLARISING = "all integrators, in polarised variants"
FROM_LIGHTS = "ptracer and all that trace light from its source"

# No other text than that about BSDFs.
SAME = ""

Check = TypeVar("Check", bound=Callable[..., None])

# Probability by chance below which a single test says by itself that something is
# wrong: above the level of a test, so that whatever fails is looked at.
MAX_P = 1e-4

# Fraction of the light of an illuminated surface below which a bias is minor.
MINOR = 1e-4

# Fraction of the answers that differ at each call where that is for chance.
MIN_RANDOM = 0.01

# A larger ratio has a denominator of 0.
MAX_RATIO = 1e20


def answered(bsdf: Any, ctx: Any, si: Any, u: Any, function: str) -> tuple[str, str]:
    """Whether a function answers."""
    bs, _ = drawn(bsdf, ctx, si, u)
    if function in ("eval", "pdf", "eval_pdf"):
        print(getattr(bsdf, function)(ctx, si, bs.wo, True))
    print(parameters(bsdf), bsdf)
    return "an answer", "an answer"


class Fault(Mistake):
    """How a function fails to answer."""

    NO_ANSWER = "`{name}` {what}"


@dataclass(frozen=True)
class Question:
    """A property that a verdict prints, as the module of its check declares it.

    Attributes
    ----------
    name : str
    text : str
        What a BSDF should have: the first sentence of the module's docstring.
    effect : str
        Of a failure, unless its breach says otherwise: one of `EFFECTS`.
    integrators : str or dict of str
        That a failure reaches if it biases images or breaks integrators, or those by
        its effect; empty if that is not known.
    volumes, matrices : str or None
        What a phase function, and all elements of a Mueller matrix, should have:
        nothing, or what is no other text than that of BSDFs if it is `SAME`.
    alone : bool
        Whether only matrices are asked, in polarised variants.
    rank : int
        The less, the more of the other failures it explains; of equal ones, what is
        printed first does.
    identity : bool
        Whether it compares two functions: which is wrong, all of these tell together.
    needed : bool
        Whether nothing passes where it is undecided.
    shown : Claim, optional
        Judgement by which a script shows the fault, unless a breach names another.
    checks : dict of list
        Functions that take the evidence, by when :meth:`Evidence.ask` calls them:
        ``"samples"`` of each condition (angles, sides, modes and components) and of the
        sweep; ``"matrices"``, the same of all elements, in polarised variants;
        ``"sweep"``, of samples of many conditions at once, with its name; ``"maps"`` of
        each condition that is mapped; ``"bsdf"``, once; and after these, about other
        ``"parameters"``, to which some plugins do not return.
    """

    name: str
    text: str | None
    effect: str = BIAS
    integrators: str | Mapping[str, str] = ""
    volumes: str | None = None
    matrices: str | None = None
    alone: bool = False
    rank: int = 1
    identity: bool = False
    needed: bool = False
    shown: Claim | None = None
    checks: dict[str, list[Callable[..., None]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        text = str(self.text).partition("\n")[0].removesuffix(".")
        object.__setattr__(self, "text", text[:1].lower() + text[1:])

    def asks(self, about: str) -> Callable[[Check], Check]:
        """Decorate one of its `checks`."""

        def added(check: Check) -> Check:
            self.checks.setdefault(about, []).append(check)
            return check

        return added

    def reached(self, effect: str | None) -> str:
        """Integrators that a failure of that effect reaches; empty if not known."""
        if effect not in (BIAS, BREAKS):
            return ""
        known = self.integrators
        return known if isinstance(known, str) else known.get(effect, "")


@dataclass(frozen=True)
class Finding:
    """A failed check, or the result of a statistical test.

    Attributes
    ----------
    question : Question
        Which is answered.
    statistic : str
        How much and where.
    condition : Condition or None
        Where; None for one over all conditions.
    off : float, optional
        Fraction of the light, or of the samples, that is wrong; None if not known.
    effect : str
        On an image, one of `EFFECTS`; that of its question by default.
    shown : Claim
        By which its script shows it; that of its question by default.
    guess : Guess or None
        Guilty functions and mistake; None of a test that does not tell them.
    of_flux : bool
        Whether `off` bounds a fraction of the light, as a fraction of samples does not:
        few of them may be bright.
    """

    question: Question
    statistic: str
    condition: Condition | None = None
    off: float | None = None
    effect: str = ""
    shown: Claim | None = None
    guess: Guess | None = None
    of_flux: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "shown", self.shown or self.question.shown)
        object.__setattr__(self, "effect", self.effect or self.question.effect)

    @property
    def name(self) -> str:
        """Name of the property."""
        return self.question.name

    @property
    def share(self) -> float | None:
        """Fraction of the reflected and transmitted light that is affected, or None.

        The wrong fraction times the cosine of the angle of incidence, to which the
        irradiance is proportional: next to nothing at 89 degrees.
        """
        if self.off is None:
            return None
        theta_i = 0.0 if self.condition is None else self.condition.theta_i
        return self.off * math.cos(math.radians(theta_i))

    @property
    def minor(self) -> bool:
        """Whether it is known to be about next to no light."""
        return self.of_flux and self.share is not None and self.share < MINOR


@dataclass(frozen=True)
class Breach(Finding):
    """A property that a BSDF certainly lacks.

    Of a property, the one of the largest `size` is shown. Each has a guess.
    """

    guess: Guess = None  # type: ignore[assignment]
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
    questions : sequence of Question
        In the order of a verdict.
    breaches, tests : list
    undecided : dict of str
        By property, why it could not be decided and what it would take.
    downgraded : dict of str
        By property, its effect though it does not fail: adds noise, or cost.
    remarks : dict of list
        By property, remarks on one that holds.
    declared : dict of str
        By property, why it is lacking with the plugin's own declaration.
    maps : list of FourMaps
    samples : list of Samples
    sweeps : list of Samples
        Of many incident directions, one for each sample.
    in_radiance_mode : list of Samples
        Of conditions under which it is not importance mode over eta^2.
    note : str
        What a verdict adds to its headline if nothing fails.
    load : callable or None
        Loads the same plugin again, in the variant that is set; None if nobody knows.
    """

    bsdf: mi.BSDF = None
    seed: int = 0
    questions: Sequence[Question] = ()
    breaches: list[Breach] = field(default_factory=list)
    tests: list[Test] = field(default_factory=list)
    undecided: dict[str, str] = field(default_factory=dict)
    downgraded: dict[str, str] = field(default_factory=dict)
    remarks: dict[str, list[str]] = field(default_factory=dict)
    declared: dict[str, str] = field(default_factory=dict)
    maps: list[FourMaps] = field(default_factory=list)
    samples: list[Samples] = field(default_factory=list)
    sweeps: list[Samples] = field(default_factory=list)
    in_radiance_mode: list[Samples] = field(default_factory=list)
    note: str = ""
    load: Callable[[], mi.BSDF] | None = None

    @property
    def of_volumes(self) -> bool:
        """Whether it is about a phase function."""
        return hasattr(self.bsdf, "phase_function")

    def ask(self, about: str, *given: Any) -> None:
        """Call all checks about something, by order of questions."""
        for question in self.questions:
            for check in question.checks.get(about, ()):
                check(self, *given)

    def add_maps(
        self, plan: Effort, condition: Condition, *key: int
    ) -> FourMaps | None:
        """Draw maps and keep them; None if their integrals do not converge."""
        each = plan.patches, plan.samples, (self.seed, *key)
        maps = four_maps(self.bsdf, condition, *each)
        self.maps += [] if maps is None else [maps]
        return maps

    @cached_property
    def noisy(self) -> bool:
        """Whether ``eval`` draws numbers of its own: others at each call, of one mean.

        Of many samples, or a few that are wrong by another cause would be chance.
        """
        first = next(iter([*self.samples, *self.sweeps]), None)
        if first is None:
            return False
        again = Probe(self.bsdf, first.condition).values(first.wo)
        usable = first.usable & np.isfinite(again).all(axis=1)
        many = unequal(again, first.eval, 0)[usable].sum() > MIN_RANDOM * first.n
        answers = first.eval[usable], again[usable], first.wo[usable]
        return bool(many) and not means_differ(*answers)

    def by_chance(self, a: Floats, b: Floats, wo: Floats) -> bool:
        """Whether answers of ``eval`` differ because it draws numbers of its own."""
        return self.noisy and not means_differ(a, b, wo)

    @property
    def whole(self) -> list[Samples]:
        """Samples of all components together."""
        return [one for one in self.samples if one.condition.component is None]

    @property
    def whole_maps(self) -> list[FourMaps]:
        """Maps of all components together."""
        return [one for one in self.maps if one.condition.component is None]

    def breach(
        self,
        question: Question,
        guess: Guess,
        at: Any = None,
        wrong: Flags | None = None,
        /,
        **others: Any,
    ) -> None:
        """Add a :class:`Breach` at a condition, or at what was asked and is `wrong`.

        Samples, and matrices of pairs of directions, tell where those are that are
        wrong and how many. One of a single component concerns the interface: no
        integrator asks for one.

        Parameters
        ----------
        question : Question
        guess : Guess
        at : Condition or Samples or Matrices, optional
            The latter with `wrong`, a mask.
        **others
            Of the breach; `size` and `off` are the fraction that is wrong. With what
            was `found` its statistic begins.
        """
        found = others.pop("found", "")
        if wrong is not None:
            share = float(wrong.mean())
            others = {"size": share, "off": share} | others
            text, at = at.fraction(wrong), at.middle(wrong)
            found = f"{found} for {text}" if found else text
        elif at is not None:
            found = f"{found} at {at}"
        if at is not None and at.component is not None:
            others["effect"] = INTERFACE
        others = {"statistic": found, "condition": at, "guess": guess} | others
        self.breaches.append(Breach(question, **others))

    def breach_of_fault(
        self, question: Question, fault: PluginFault, **others: Any
    ) -> None:
        """Add a breach by which a function gives no usable answer."""
        fields = {"name": fault.function, "what": fault.what}
        guess = Fault.NO_ANSWER(Function.named(fault.function), **fields)
        raises = Claim(answered, same, (fault.function,))
        others = {"found": str(fault), "shown": raises} | others
        self.breach(question, guess, **others)

    def breach_of_ratio(
        self,
        question: Question,
        guess: Guess,
        samples: Samples,
        wrong: Flags,
        ratio: Floats,
        what: str,
        **others: Any,
    ) -> None:
        """Add a breach on how far a ratio is from 1, if many samples are `wrong`.

        The fraction that is wrong is that of the light, of which each sample has its
        weight, unless `others` have it as `off`.
        """
        if not beyond_rounding(wrong):
            return
        usable = wrong & (np.abs(ratio) < MAX_RATIO)
        spread = "infinite"
        if usable.any():
            low, middle, high = np.quantile(ratio[usable], [0.05, 0.5, 0.95])
            spread = f"{low:.4g} to {high:.4g}, median {middle:.4g}"
        off = np.where(usable, np.minimum(np.abs(ratio - 1), 1), wrong)
        others = {"off": samples.share(off), "found": f"{what} is {spread}"} | others
        self.breach(question, guess, samples, wrong, **others)

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
        """The worst breach of a property, of equal ones the first; None without.

        By effect, then by size.
        """
        found = self.of(name)
        effect = min((EFFECTS.index(one.effect) for one in found), default=0)
        found = [one for one in found if one.effect == EFFECTS[effect]]
        worst = max(found, key=lambda one: one.size, default=None)
        if worst is None:
            return None
        equal = worst.size * (1 - BSDF_ROUNDING)  # the same mistake in two functions
        return next((one for one in found if one.size >= equal), worst)

    def guess(self, name: str) -> Guess | None:
        """What the worst breach of a property tells; None without."""
        worst = self.worst(name)
        return worst.guess if worst else None

    def suspect(self, name: str) -> Guess | None:
        """What the worst test tells of those that tell something; None without."""
        told = [one for one in self.tests if one.name == name and one.guess]
        return min(told, key=lambda one: one.p).guess if told else None

    def remark(self, name: str, text: str) -> None:
        """Note something that does not make a property fail."""
        known = self.remarks.setdefault(name, [])
        if text not in known:
            known.append(text)

    def test(
        self,
        question: Question,
        p: float,
        statistic: str,
        condition: Condition | None = None,
        /,
        **others: Any,
    ) -> None:
        """Add a :class:`Test`.

        One of a single component concerns the interface, too.
        """
        if condition is not None and condition.component is not None:
            others["effect"] = INTERFACE
        self.tests.append(Test(question, statistic, condition, p=p, **others))

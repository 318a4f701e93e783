"""The verdict on a BSDF: one line for each property, and the likely mistake."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..annexes import ask
from .conditions import Condition
from .evidence import BIAS, BREAKS, COST, EFFECTS, NOISE, Evidence, Question, Test
from .maps import FourMaps
from .mistakes import Claim, Guess

# Places of a failure that are kept.
MAX_PLACES = 10

# Times the level of a test, up to which a p-value is near it: of right plugins so many
# times the false-alarm probability are.
MAX_NEAR = 10

# What decides where a p-value is near its level.
DECIDED_BY = {
    "quick": "effort normal looks closer",
    "normal": "effort thorough looks closer",
    "thorough": "another seed decides",
}

# Attributes of a property as they stand in JSON.
REPORTED = (
    *("question", "name", "status", "statistic", "mistake", "function", "p_value"),
    *("effect", "share", "minor", "places"),
)

HOLDS, FAILS, UNDECIDED, LACKS = "holds", "fails", "undecided", "lacks"


@dataclass(frozen=True)
class Property:
    """One line of a verdict.

    Attributes
    ----------
    name : str
        Key of :data:`gonio_mi.validation.PROPERTIES` or, in polarised variants, of
        :data:`gonio_mi.validation.POLARISED`.
    status : {"holds", "fails", "undecided", "lacks"}
        ``lacks`` is a failure that was allowed, or declared by the plugin's flags.
    statistic : str
        By what that was decided, in numbers; for ``undecided`` what it would take.
    mistake : str or None
        What is likely wrong, if it fails.
    function : str or None
        Of the plugin, where that is; as of :class:`Verdict`.
    p_value : float or None
        The smallest of its statistical tests, times the number of these; None without.
    effect : str or None
        What a failure does to an image, one of :data:`EFFECTS`; ``adds cost``, or
        ``adds noise``, of what does not fail; else None.
    places : tuple of str
        How much and where else it fails, sample by sample, the worst first.
    near : str
        The smallest p-value and its level, if it does not fail but is near that.
    share : float or None
        How much of an illuminated surface's light a failure is about: of its worst
        finding the wrong fraction, times the cosine of the angle of incidence, or None.
    minor : bool
        Whether all that fails is known to be below 1e-4 of that light.
    question : str
        What the property is.
    condition : Condition or None
        Where its worst finding is; None without, or of one over all conditions.
    shown : Claim or None
        Of its worst finding, by which its reproducer shows it.
    of_volumes : bool
        Whether it is one of a phase function.
    needed : bool
        Whether a verdict is undecided without it.
    integrators : str
        That a failure reaches, by its effect; may be empty.
    guess : Guess or None
        Of which `function` and `mistake` are the text.
    conditions : tuple of Condition
        Of all that fails.
    """

    name: str
    status: str
    statistic: str
    mistake: str | None = None
    function: str | None = None
    p_value: float | None = None
    effect: str | None = None
    places: tuple[str, ...] = ()
    near: str = ""
    share: float | None = None
    minor: bool = False
    question: str = ""
    condition: Condition | None = field(default=None, repr=False)
    shown: Claim | None = field(default=None, repr=False)
    of_volumes: bool = False
    needed: bool = field(default=False, repr=False)
    integrators: str = field(default="", repr=False)
    guess: Guess | None = field(default=None, repr=False)
    conditions: tuple[Condition | None, ...] = field(default=(), repr=False)

    @property
    def reach(self) -> str:
        """Text on integrators that the effect reaches and its size; may be empty."""
        known = self.share is not None and self.name != "ends"
        if not (self.integrators and known) or self.of_volumes:
            return self.integrators
        size = f"{self.share:.2g} of the flux from an illuminated surface is wrong"
        return f"{self.integrators}; {size}"

    @property
    def consequence(self) -> str | None:
        """The effect and its reach."""
        return f"{self.harm} ({self.reach})" if self.reach else self.harm

    @property
    def harm(self) -> str | None:
        """The effect, and that it is minor."""
        return f"{self.effect}, but next to nothing" if self.minor else self.effect

    @property
    def counts(self) -> bool:
        """Whether it makes a verdict fail that is not strict."""
        harms = self.effect in (BIAS, BREAKS) and not self.minor
        return self.status == FAILS and harms

    def __str__(self) -> str:
        line = f"{self.status:<10}{self.name:<16} {self.question}"
        details: list[str | None] = [self.statistic] if self.statistic else []
        if self.status == FAILS:
            details.insert(0, self.consequence)
        if self.mistake and self.status == FAILS and self.mistake != self.statistic:
            details.append(self.mistake)
        return "\n".join([line, *(f"{'':<27}{text}" for text in details)])


@dataclass(frozen=True)
class Verdict:
    """Whether a BSDF plugin is right, and which of its functions is wrong.

    Attributes
    ----------
    name : str
        Of the BSDF.
    properties : tuple of Property
    function : str or None
        The function that is most likely guilty, or two of which nothing tells which,
        as ``"eval or sample"``; None if nothing fails.
    mistake : str or None
        What is likely wrong with it.
    settings : dict
        Effort, seed, false-alarm probability, numbers of samples and of tests.
    maps : tuple of FourMaps
        By incident direction.
    source : str or None
        Statements that load the BSDF as ``bsdf``; None of an object.
    guess : Guess or None
        Of which `function` and `mistake` are the text.
    note : str
        What the headline adds if nothing fails.
    """

    name: str
    properties: tuple[Property, ...]
    function: str | None
    mistake: str | None
    settings: dict[str, Any]
    maps: tuple[FourMaps, ...] = field(default=(), repr=False)
    source: str | None = field(default=None, repr=False)
    guess: Guess | None = field(default=None, repr=False)
    note: str = ""

    @property
    def passed(self) -> bool:
        """Whether it is decided that nothing biases images or breaks integrators.

        By 1e-4 of the light at least. If it is strict, whether nothing fails at all.
        """
        return not (self._failed or self.undecided)

    @property
    def undecided(self) -> str:
        """Why a verdict without failures is undecided; empty if it is decided.

        Light that is merely too rare to judge adds noise, and leaves it decided.
        """
        needed = (p for p in self.properties if p.needed and p.effect != NOISE)
        why = (p.statistic for p in needed if p.status == UNDECIDED)
        return "" if self._failed else next(why, "")

    @property
    def _failed(self) -> bool:
        """Whether there is a failure that counts."""
        strict = self.settings["strict"]
        return any(strict or one.counts for one in self.failures)

    @property
    def answered(self) -> bool:
        """Whether all functions gave answers of the right form."""
        others = (p for p in self.properties if p.name != "answers")
        return any(p.status != UNDECIDED for p in others)

    @property
    def failures(self) -> tuple[Property, ...]:
        """Properties that fail, the worst effect first, and what counts before all.

        Within an effect, the property that explains the others comes first, then those
        of an unknown share of the light, then the rest by decreasing share.
        """

        def rank(one: Property) -> tuple[bool, int, bool, float]:
            share = np.inf if one.share is None else one.share
            explains = one.guess is not None and one.guess == self.guess
            effect = EFFECTS.index(str(one.effect))
            return not one.counts, effect, not explains, -share

        failed = [one for one in self.properties if one.status == FAILS]
        return tuple(sorted(failed, key=rank))

    @property
    def headline(self) -> str:
        """The verdict in one sentence."""
        failed = self.failures
        if self.undecided:
            return f"{self.name}: UNDECIDED: {self.undecided}"
        if not failed:
            undecided = sum(p.status == UNDECIDED for p in self.properties)
            rest = f", {undecided} could not be decided" if undecided else ""
            if any(p.effect == COST for p in self.properties):
                rest += ", but it adds cost"
            rest += self.note and f", {self.note}"
            return f"{self.name}: nothing wrong was found{rest}{self.near}"
        word = "passes, with a remark" if self.passed else "FAILS"
        # the mistake first: a summary shows the beginning only
        worst = failed[0]
        text = f"{self.name}: {word}: {worst.harm}. Most likely: {self.mistake}"
        return f"{text}. Affects {worst.reach}" if worst.reach else text

    @property
    def near(self) -> str:
        """End of a sentence on what is near its limit and what would decide it."""
        closer = DECIDED_BY[self.settings["effort"]]
        found = [f"{p.name} ({p.near})" for p in self.properties if p.near]
        return f"; near the limit: {', '.join(found)}, {closer}" if found else ""

    def fails_at(self, maps: FourMaps) -> bool:
        """Whether statistics of the maps fail, or a failure is at their condition."""
        level = self.settings["alpha"] / max(self.settings["n_tests"], 1)
        p_values = [
            p
            for scores in (maps.count_scores, maps.weight_scores)
            for p in scores.p_values.values()
        ]
        places = {str(at) for one in self.failures for at in one.conditions}
        return min(p_values, default=1.0) < level or str(maps.condition) in places

    def _repr_html_(self) -> str:
        """Headline and properties, for notebooks."""
        shown: str = ask("validation", "verdict_view")(self)
        return shown

    def __getitem__(self, name: str) -> Property:
        return {one.name: one for one in self.properties}[name]

    def __str__(self) -> str:
        failed = self.failures
        rest = [one for one in self.properties if one not in failed]
        lines = [str(one) for one in (*failed, *(rest if self.answered else rest[:0]))]
        if not self.answered and rest:
            # all for the same reason
            lines.append(f"{UNDECIDED:<10}all else: {rest[0].statistic}")
        s = self.settings
        lines.append("")
        if failed and s["tints"]:
            tints = ", ".join(f"{name} {tint}" for name, tint in s["tints"].items())
            lines.append(f"grey parameters were given colours: {tints}")
        lines.append(
            f"{s['n_tests']} statistical tests share a false-alarm probability of "
            f"{s['alpha']:g}; {s['n_samples']:.3g} samples, seed {s['seed']}, "
            f"effort {s['effort']}, {s['variant']}"
        )
        lines.append(self.headline)
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """Everything but the maps, for JSON.

        Returns
        -------
        dict
            ``name``, ``passed`` (whether the exit code is 0), ``undecided`` (why
            nothing is known, else empty), ``function`` and ``mistake`` (what is most
            likely wrong), ``effect`` (the worst), ``settings`` (effort, seed, alpha,
            allow, strict, variant, colours that grey parameters were given, numbers of
            tests and samples), and ``properties``: a list with ``name``, ``question``,
            ``status``, ``statistic``, ``mistake``, ``function``, ``p_value``,
            ``effect``, ``share``, ``minor`` (whether that is known to be below 1e-4)
            and ``places`` of each. The command adds ``others``, the same of other
            variants, and ``skipped``, by variant why it was not judged there.
        """
        return {
            "name": self.name,
            "passed": self.passed,
            "undecided": self.undecided,
            "function": self.function,
            "mistake": self.mistake,
            "effect": self.failures[0].effect if self.failures else None,
            "properties": [
                {key: getattr(p, key) for key in REPORTED} for p in self.properties
            ],
            "settings": dict(self.settings),
        }


def properties_of(
    evidence: Evidence, alpha: float, allow: Collection[str] = ()
) -> list[Property]:
    """Properties from evidence.

    Parameters
    ----------
    evidence : Evidence
    alpha : float
        False-alarm probability that all statistical tests share (Bonferroni).
    allow : collection of str
        Names of properties that may be lacking.

    Returns
    -------
    list of Property
    """
    level = alpha / max(len(evidence.tests), 1)
    found = []
    for question in evidence.questions:
        one = _property(evidence, question, level, question.name in allow)
        reached = question.reached(one.effect)
        one = replace(one, question=str(question.text), needed=question.needed)
        found.append(replace(one, of_volumes=evidence.of_volumes, integrators=reached))
    return found


def _property(
    evidence: Evidence, question: Question, level: float, allowed: bool
) -> Property:
    name, breaches = question.name, evidence.of(question.name)
    tests = [t for t in evidence.tests if t.name == name]
    smallest = min((t.p for t in tests), default=None)
    p_value = None if smallest is None else float(min(1.0, smallest * len(tests)))
    beyond = [t for t in tests if t.p < level]
    if beyond or breaches:
        found = [*breaches, *beyond]
        effect = min((one.effect for one in found), key=EFFECTS.index)
        worst_ones = [one for one in found if one.effect == effect]
        shares = [one.share for one in worst_ones]
        # what does most harm, and of that what says most
        breaches = [b for b in breaches if b.effect == effect] or breaches
        breaches = sorted(breaches, key=lambda b: -b.size)
        worst = breaches[0] if breaches else None
        text = worst.statistic if worst and not beyond else _worst_statistic(beyond)
        if not beyond and len(breaches) > 1:
            text += f"; {len(breaches) - 1} more like it"
        shown, guess = worst or _worst(beyond), worst.guess if worst else None
        return Property(
            name,
            LACKS if allowed else FAILS,
            text,
            str(guess) if guess else None,
            str(guess.functions) if guess else None,
            p_value,
            effect,
            tuple(b.statistic for b in breaches[:MAX_PLACES]),
            share=max((x for x in shares if x is not None), default=None),
            minor=all(one.minor for one in worst_ones),
            condition=shown.condition,
            shown=shown.shown,
            guess=guess,
            conditions=(shown.condition, *(b.condition for b in breaches)),
        )
    if name in evidence.declared:
        return Property(name, LACKS, evidence.declared[name], p_value=p_value)
    downgraded = evidence.downgraded.get(name)
    if name in evidence.undecided:
        text = evidence.undecided[name]
        return Property(name, UNDECIDED, text, p_value=p_value, effect=downgraded)
    text, near = "; ".join(evidence.remarks.get(name, [])), ""
    if smallest is not None:
        least = f"smallest p of {len(tests)} tests {smallest:.2g}"
        text = f"{text}; {least}" if text else least
        if smallest < MAX_NEAR * level:
            near = f"p = {smallest:.2g}, fails below {level:.2g}"
    return Property(name, HOLDS, text, p_value=p_value, effect=downgraded, near=near)


def _worst(beyond: Sequence[Test]) -> Test:
    """The worst test: by effect, then by share of the light, then by p-value."""
    return min(beyond, key=lambda t: (EFFECTS.index(t.effect), -(t.share or 0.0), t.p))


def _worst_statistic(beyond: Sequence[Test]) -> str:
    """Statistic of the worst test that chance does not explain, and where it is."""
    worst = _worst(beyond)
    places = {str(t.condition) for t in beyond}
    place = "" if worst.condition is None else f" at {worst.condition}"
    more = f", and under {len(places) - 1} more conditions" if len(places) > 1 else ""
    return f"{worst.statistic}{place}{more}, p = {worst.p:.2g}"

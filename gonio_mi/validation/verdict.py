"""The verdict on a BSDF: one line for each property, and the likely mistake."""

from dataclasses import dataclass, field

import numpy as np

from .evidence import PROPERTIES

__all__ = ["FAILS", "HOLDS", "LACKS", "UNDECIDED", "Property", "Verdict", "judge"]

HOLDS, FAILS, UNDECIDED, LACKS = "holds", "fails", "undecided", "lacks"


@dataclass(frozen=True)
class Property:
    """One line of a verdict.

    Attributes
    ----------
    name : str
        Key of :data:`gonio_mi.validation.PROPERTIES`.
    status : {"holds", "fails", "undecided", "lacks"}
        ``lacks`` is a failure that was allowed, or declared by the plugin's flags.
    statistic : str
        By what that was decided, in numbers; for ``undecided`` what it would take.
    mistake : str or None
        What is likely wrong, if it fails.
    function : str or None
        Of the plugin, where that is.
    p_value : float or None
        The smallest of its statistical tests, times the number of these; None without.
    """

    name: str
    status: str
    statistic: str
    mistake: str | None = None
    function: str | None = None
    p_value: float | None = None

    @property
    def question(self):
        """What the property is."""
        return PROPERTIES[self.name]

    def __str__(self):
        line = f"{self.status:<10}{self.name:<16} {self.question}"
        details = [self.statistic] if self.statistic else []
        if self.mistake and self.status == FAILS:
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
        The function that is most likely guilty; None if nothing fails.
    mistake : str or None
        What is likely wrong with it.
    settings : dict
        Effort, seed, false-alarm probability, numbers of samples and of tests.
    maps : tuple of FourMaps
        By incident direction.
    """

    name: str
    properties: tuple
    function: str | None
    mistake: str | None
    settings: dict
    maps: tuple = field(default=(), repr=False)

    @property
    def passed(self):
        """Whether no property fails."""
        return not self.failures

    @property
    def failures(self):
        """Properties that fail."""
        return tuple(p for p in self.properties if p.status == FAILS)

    def __getitem__(self, name):
        for one in self.properties:
            if one.name == name:
                return one
        raise KeyError(name)

    def __str__(self):
        lines = [str(one) for one in self.properties]
        s = self.settings
        lines.append("")
        lines.append(
            f"{s['n_tests']} statistical tests share a false-alarm probability of "
            f"{s['alpha']:g}; {s['n_samples']:.3g} samples, seed {s['seed']}, "
            f"effort {s['effort']}"
        )
        if self.passed:
            undecided = sum(p.status == UNDECIDED for p in self.properties)
            rest = f", {undecided} could not be decided" if undecided else ""
            lines.append(f"{self.name}: nothing wrong was found{rest}")
        else:
            lines.append(f"{self.name}: FAILS. Most likely: {self.mistake}")
        return "\n".join(lines)

    def to_dict(self):
        """Everything but the maps, for JSON."""
        return {
            "name": self.name,
            "passed": self.passed,
            "function": self.function,
            "mistake": self.mistake,
            "properties": [
                {
                    "name": p.name,
                    "question": p.question,
                    "status": p.status,
                    "statistic": p.statistic,
                    "mistake": p.mistake,
                    "function": p.function,
                    "p_value": p.p_value,
                }
                for p in self.properties
            ],
            "settings": dict(self.settings),
        }


def judge(evidence, alpha, allow=()):
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
    return [_property(evidence, name, level, name in allow) for name in PROPERTIES]


def _property(evidence, name, level, allowed):
    breaches = [b for b in evidence.breaches if b.property == name]
    tests = [t for t in evidence.tests if t.property == name]
    worst = min(tests, key=lambda t: t.p, default=None)
    p_value = None if worst is None else float(min(1.0, worst.p * len(tests)))
    failure = LACKS if allowed else FAILS
    # the tests of a property in one view that chance would not explain
    if worst is not None and worst.p < level:
        places = {str(t.condition) for t in tests if t.p < level}
        where = "" if worst.condition is None else f" at {worst.condition}"
        more = f", and at {len(places) - 1} more" if len(places) > 1 else ""
        text = f"{worst.statistic}{where}{more}, p = {worst.p:.2g}"
        function = breaches[0].function if breaches else None
        mistake = breaches[0].mistake if breaches else None
        return Property(name, failure, text, mistake, function, p_value)
    if breaches:
        worst = max(breaches, key=lambda b: b.size)
        places = len(breaches) - 1
        more = f"; {places} more like it" if places else ""
        return Property(
            name,
            failure,
            worst.statistic + more,
            worst.mistake,
            worst.function,
            p_value,
        )
    if name in evidence.declared:
        return Property(name, LACKS, evidence.declared[name], p_value=p_value)
    if name in evidence.undecided:
        return Property(name, UNDECIDED, evidence.undecided[name], p_value=p_value)
    text = evidence.remarks.get(name, "")
    if worst is not None:
        smallest = (
            f"smallest p of {len(tests)} tests {np.min([t.p for t in tests]):.2g}"
        )
        text = f"{text}; {smallest}" if text else smallest
    return Property(name, HOLDS, text, p_value=p_value)

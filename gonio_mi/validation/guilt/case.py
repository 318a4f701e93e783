"""Facts about a failing plugin, which decide what hypotheses apply."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import mitsuba as mi

from ..checks.components import Alone, alone, are_apart
from ..checks.weights import Weights
from ..evidence import MODEL, Breach, Evidence
from ..maps import FourMaps
from ..mistakes import EVAL, Mistake
from ..samples import Samples
from .ratios import DENSITY, SAMPLED_PDF, VALUE, WEIGHT, Ratios


class Diagnosis(Mistake):
    """Mistakes diagnosed from all failures together."""

    ANY = "`sample` or `eval` is wrong"
    NOT_DIVIDED_BY_CHANCE = """{who} weight lacks division by the probability with which
        a direction is not rejected"""
    SLIGHTLY = """{who}: one of their densities is wrong by {off:.2g} on average, less
        than counts of directions tell at this effort"""
    OTHER_MEAN = "{who}: the mean weight is not the integral of `eval`"
    ONE_COMPONENT = "{who} is that of component {component} alone"
    PLAIN_SUM = "{who} is the sum of its components', without the probability of each"


# Misfit of counts that chance explains.
MAX_CHANCE = 16


@dataclass(frozen=True)
class Case:
    """All that hypotheses look at.

    Attributes
    ----------
    evidence : Evidence
    failed : dict of str
        Effect by name of property, of the failures that need an explanation.
    single : FourMaps, optional
        Map of one component, if nothing but its counts shall be looked at.
    """

    evidence: Evidence
    failed: Mapping[str, str] = field(default_factory=dict)
    single: FourMaps | None = None

    # ------------------------------------------------------------------------- when

    def is_asymmetric(self) -> bool:
        """``eval`` of the whole is not reciprocal."""
        return bool(self.asymmetries)

    def is_often_asymmetric(self) -> bool:
        """So it is for more than one incident direction."""
        return len(self.asymmetries) > 1

    def components_tell(self) -> bool:
        """There are several components, which add up to the whole."""
        several = self.evidence.bsdf.component_count() > 1
        return several and not self.evidence.of("components")

    def is_asymmetric_as_one(self) -> bool:
        """``eval`` is not reciprocal, and no component can be asked alone."""
        return self.is_asymmetric() and not self.components_tell()

    def is_symmetric(self) -> bool:
        """No law is declared that is not reciprocal."""
        flags = int(self.evidence.bsdf.flags())
        return not flags & int(mi.BSDFFlags.NonSymmetric)

    def is_dark(self) -> bool:
        """``eval`` and ``pdf`` are 0 where `sample` scatters light."""
        guess = self.evidence.guess("weights")
        return guess is not None and guess.mistake is Weights.DARK_AND_IMPOSSIBLE

    def has_no_light(self) -> bool:
        """No sample has a weight and a value to compare."""
        return not self.light.each

    def components_differ(self) -> bool:
        """Weights of single components alone are not ``eval`` over ``pdf``."""
        at = [one.condition for one in self.evidence.of("sampled_weight")]
        return bool(at) and all(one and one.component is not None for one in at)

    def has_several_components(self) -> bool:
        """Several components, of which some have a density."""
        several = self.evidence.bsdf.component_count() > 1
        return several and bool(self.evidence.whole[0].smooth.any())

    def weights_are_right(self) -> bool:
        """Weights are those of the true density, as far as is known."""
        # those that are `eval` over a wrong `pdf` are wrong, too
        by_pdf = not any(map(self.evidence.of, ("sampled_weight", "sampled_pdf")))
        return not by_pdf and "weights" not in self.failed

    def chance_explains_counts(self) -> bool:
        """Directions are wrong in a band of incidence only, that no map has met."""
        return not self.maps or self.worst.misfit < MAX_CHANCE

    def is_not_counted(self) -> bool:
        """There are no maps of directions."""
        return not self.maps

    # ------------------------------------------------------------------------- facts

    @cached_property
    def asymmetries(self) -> list[Breach]:
        """Breaches of reciprocity by ``eval`` of all components."""
        found = self.evidence.of("reciprocity")
        return [b for b in found if b.guess.functions is EVAL and b.effect == MODEL]

    @cached_property
    def light(self) -> Ratios:
        """Weight times pdf over ``eval``."""
        return Ratios.of(self.evidence, WEIGHT, VALUE)

    @cached_property
    def densities(self) -> Ratios:
        """The pdf of `sample` over ``pdf``."""
        return Ratios.of(self.evidence, SAMPLED_PDF, DENSITY)

    @cached_property
    def maps(self) -> Sequence[FourMaps]:
        """Maps of all components together, or the `single` one."""
        return [self.single] if self.single else self.evidence.whole_maps

    @cached_property
    def worst(self) -> FourMaps:
        """The map whose counts are most off.

        One of a component says less, unless it is all that is wrong.
        """
        worst = max(self.maps, key=lambda one: one.misfit)
        if self.single or worst.misfit >= MAX_CHANCE:
            return worst
        return max(self.evidence.maps, key=lambda one: one.misfit)

    @cached_property
    def apart(self) -> Alone | None:
        """Answers of each component about samples of the whole.

        None if they cannot be asked alone.
        """
        samples: Samples = self.evidence.whole[0]
        each = alone(self.evidence, samples)
        return each if are_apart(self.evidence.bsdf, samples, each) else None

    @cached_property
    def only_component(self) -> Case | None:
        """The case of the only component whose counts are wrong; None without."""
        alike = [m for m in self.evidence.maps if m.condition.component is not None]
        wrong = [m for m in alike if m.misfit > MAX_CHANCE]
        if len(wrong) != 1 or self.worst in wrong or self.apart is None:
            return None
        return replace(self, single=wrong[0])

"""The settings of a measurement: one line of declaration each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

from ..collector import EqualProjectedSolidAngle, Subdivision, subdivision
from ..errors import SettingTypeError, checked_choice, did_you_mean
from .declaration import Kind, declarations, setting
from .values import (
    ALL_ORDERS,
    Order,
    Period,
    checked_flag,
    checked_footprint,
    checked_incident,
    checked_names,
    checked_period,
    checked_wavelengths,
    choice,
    count,
    joined,
    number,
)

# Mitsuba plugins that have settings as their properties.
INTEGRATOR, COLLECTOR, FILM = "goniophotometer", "collector", "patches"

MAX_RAYS = 10**15
MAX_BATCHES = 65536
# In scene units: the square of larger ones is no number in single precision.
MAX_RADIUS = 1e15
# Directions in which a ray of the estimator `split` goes on from its second event: a
# whole packet of rays, which is then the same however they are shared among launches.
BRANCHES = 16
# Rays before the first look at the precision.
PILOT_RAYS = 2**18
# More points would only repeat what a further ray tells better.
MAX_POINTS = 1024
# Relative error of each patch to which `quadrature` integrates, if none is asked for.
INTEGRAL_ERR = 1e-4

# Arguments of `measure` that are no settings.
ARGUMENTS = (
    *("specimen", "theta_i", "phi_i", "emitter", "parameters"),
    *("resume", "executor", "folder", "progress"),
)

LIGHT, PATCHES, METHOD, EVENTS = (
    "light",
    "collector",
    "method",
    "events on the surface",
)


def _sampler(label: str, value: object) -> Any:  # noqa: ARG001
    """Plugin of a sampler: its name, a dictionary or an object."""
    if isinstance(value, str):
        return {"type": value}
    return value


class Estimator(str, Enum):
    """How rays and events are summed over patches."""

    WEIGHTED = "weighted"
    ANALOG = "analog"
    QUADRATURE = "quadrature"
    NEXT_EVENT = "next_event"
    SPLIT = "split"
    AUTO = "auto"

    @classmethod
    def parse(cls, label: str, value: Any) -> Estimator:
        """The estimator of a name; ValueError for any other."""
        return cls(checked_choice(label, value, [str(one) for one in cls]))

    def __str__(self) -> str:
        return self.value

    def __repr__(self) -> str:
        return repr(self.value)


# The estimator that applies to whatever can be measured.
ANY_SPECIMEN = Estimator.WEIGHTED


@dataclass(frozen=True, kw_only=True)
class MeasurementSettings:
    """How a specimen is measured: parsed values, whatever form they were given in.

    Raises
    ------
    TypeError, ValueError
        If a value is out of its range; the message begins with the setting's name.
    """

    # ------------------------------------------------------------------- how many rays

    rays: int = setting(
        10**6,
        count(1, MAX_RAYS),
        Kind.COUNT,
        "Rays for each incident direction. In spectral variants, as many for every "
        "four wavelengths. At most 1e15.",
        group=METHOD,
        shown_default="1e6",
    )
    rel_err: float | None = setting(
        None,
        number(1e-9, 1, "a number in (0, 1)"),
        Kind.NUMBER,
        "Instead of `rays`: continue until the relative standard error of every patch "
        "whose BRDF is at least 10 % of the mean is at most this, for each incident "
        "direction. For ``quadrature``, the tolerance of each patch, relative to its "
        "value or, if larger, to this fraction (at least 1e-6) of the mean patch.",
        group=METHOD,
        metavar="X",
        shown_default="none; 1e-4 for quadrature",
    )
    noise: float | None = setting(
        None,
        number(1e-6, 1, "a number from 1e-6 to below 1"),
        Kind.NUMBER,
        "Instead of `rays`: continue until the expected total variation distance from "
        "the true distribution of scattered flux is at most this, for each incident "
        "direction: half the sum of the expected absolute errors of all patches, over "
        "``dhr + dht``.",
        shown_default="none",
        plugin=None,
    )
    max_rays: int = setting(
        10**9,
        count(PILOT_RAYS, MAX_RAYS, "the rays that show what precision needs"),
        Kind.COUNT,
        "Upper limit of rays for `rel_err` and `noise`; warns if reached.",
        group=METHOD,
        shown_default="1e9",
        plugin=None,
    )
    floor: float = setting(
        0.1,
        number(0, 1, "a fraction in [0, 1)"),
        Kind.NUMBER,
        "Patches whose BRDF (or BTDF) is below this fraction of the mean over the "
        "collector do not count for `rel_err`.",
        plugin=None,
    )
    batches: int = setting(
        16,
        count(1, MAX_BATCHES),
        Kind.COUNT,
        "Number of independent batches, whose scatter gives the standard errors. With "
        "``sobol``, each doubling lowers the precision of the same rays by a fifth.",
        group=METHOD,
    )

    # -------------------------------------------------------------------------- method

    estimator: Estimator = setting(
        Estimator.WEIGHTED,
        Estimator.parse,
        Kind.WORD,
        "``weighted`` sums throughput, ``analog`` counts rays that survive, "
        "``quadrature`` integrates ``eval``, ``next_event`` deposits it. With "
        "``analog``, a ray survives or ends at each event (equation 5 of the paper). "
        "``quadrature`` applies to a flat, homogeneous specimen in a collimated beam, "
        "and samples delta components only. ``next_event`` deposits ``eval`` at every "
        "event on geometry towards visible points in random patches and counts the "
        "rays as well, weighted by the balance heuristic: for narrow apertures and for "
        "patches far from the lobes, not for totals. For mirror facets in a periodic "
        "cell that a collimated beam fills, it sums the first order over the facets "
        "and traces rays for the others. ``split`` integrates ``eval`` over periodic, "
        "opaque geometry for single scattering, jointly for all incident directions, "
        "and sums throughput for multiple scattering, with rays that branch in "
        f"{BRANCHES} directions where they meet a surface again: for stacks of maps of "
        "rough facets. ``auto`` takes the cheapest of all but ``analog`` and "
        "``split``; the record states which, and why.",
        group=METHOD,
        metavar="E",
        form='{"weighted", "analog", "quadrature", "next_event", "split", "auto"}',
        text=str,
    )
    points: int = setting(
        1,
        count(1, MAX_POINTS),
        Kind.COUNT,
        "Points per event for the estimator ``next_event``, spread over all patches; "
        "each costs a fraction of a ray. For maps of diffuse facets, use as many as "
        "there are patches, and few rays.",
        group=METHOD,
    )
    gradients: tuple[str, ...] = setting(
        (),
        checked_names,
        Kind.WORDS,
        "Parameters of BSDFs and textures to differentiate with respect to, as "
        "`mi.traverse` names them, with at most 8 components each. Each component "
        "takes about as long as the measurement.",
        group=METHOD,
        metavar="NAME",
        text=list,
        shown_default="none",
        plugin=None,
    )
    sampler: Any = setting(
        None,
        _sampler,
        Kind.WORD,
        "Mitsuba sampler, such as ``sobol`` (one scrambled low-discrepancy sequence "
        "per batch) or ``independent``. A name or a dictionary.",
        group=METHOD,
        metavar="S",
        form="str or dict",
        shown_default="sobol",
        plugin=None,
    )
    seed: int = setting(
        0,
        count(0),
        Kind.COUNT,
        "Seed of the random numbers. The same seed gives the same bits on the same "
        "kind of processor, whatever the number of threads.",
        group=METHOD,
        metavar="S",
        plugin=None,
    )

    # --------------------------------------------------------------------------- light

    side: str = setting(
        "front",
        choice("front", "back"),
        Kind.WORD,
        "Side of the specimen that faces the emitter: ``front`` (+z) or ``back`` (-z). "
        "Reflection is always to that side.",
        group=LIGHT,
        metavar="front|back",
        form='{"front", "back"}',
        plugin=None,
    )
    footprint: str | float = setting(
        "full",
        checked_footprint,
        Kind.WORD_OR_NUMBER,
        "Where light lands on the top of the specimen: ``full`` (all over it; of a "
        "solid without a period, its whole outline as seen from the emitter), "
        "``point`` (in its middle), or the radius of a disk about the middle, in scene "
        "units.",
        group=LIGHT,
        metavar="full|point|R",
    )
    divergence: float = setting(
        0.0,
        number(0, 90, "an angle in [0, 90) degrees"),
        Kind.NUMBER,
        "Half angle in degrees of the cone of directions that a collimated beam fills, "
        "uniformly in solid angle.",
        group=LIGHT,
        metavar="DEG",
    )
    incident: Subdivision | None = setting(
        None,
        checked_incident,
        Kind.WORD,
        "Subdivision of the hemisphere of incidence, named like a collector: the "
        "directions of a collimated beam fill the patch that contains the incident "
        "direction, uniformly in projected solid angle. Without `theta_i` every patch "
        "is measured, in order.",
        group=LIGHT,
        metavar="klems|KIND:NTxNP",
        form="str or Subdivision",
        text=lambda value: "none" if value is None else str(value),
        shown_default="none",
    )
    emission: str = setting(
        "radiometric",
        choice("radiometric", "equal_power"),
        Kind.WORD,
        "Weight of the rays of an emitter of finite size: ``radiometric`` (by "
        "radiance, cosines and distance) or ``equal_power`` (the same power for "
        "uniform points on emitter and specimen: the paper's section 2.2).",
        group=LIGHT,
        metavar="E",
        form='{"radiometric", "equal_power"}',
    )
    wavelengths: tuple[float, ...] = setting(
        (550.0,),
        checked_wavelengths,
        Kind.NUMBERS,
        "Wavelengths in nm: the channels of spectral variants. The data of specimen "
        "and emitter must cover them.",
        group=LIGHT,
        metavar="NM",
        text=joined,
        shown_default="550",
    )

    # ----------------------------------------------------------------------- collector

    collector: Subdivision = setting(
        EqualProjectedSolidAngle(30, 30),
        lambda label, value: subdivision(value),  # noqa: ARG005
        Kind.WORD,
        "Patches: ``projected`` (of equal projected solid angle), ``solid``, ``angle`` "
        "or ``sine`` with rings x sectors per hemisphere. The others are ``klems``, "
        "``borders:0,30,90x0,180,360`` or ``apertures:HALF_ANGLE@THETA/PHI,...``.",
        group=PATCHES,
        metavar="KIND:NTxNP",
        form="str or Subdivision",
        plugin=FILM,
        key="subdivision",
        text=str,
        shown_default="projected:30x30",
    )
    collector_radius: float = setting(
        0.0,
        number(0, MAX_RADIUS, "a finite radius of 0 or more"),
        Kind.NUMBER,
        "Radius in scene units of the sphere about the origin on which the exit "
        "*position* decides the patch; 0 is the far field, where the exit *direction* "
        "does.",
        group=PATCHES,
        metavar="R",
        plugin=COLLECTOR,
        key="radius",
        shown_default="0",
    )
    hemispheres: str = setting(
        "auto",
        choice("auto", "upper", "both"),
        Kind.WORD,
        "``both``, ``upper`` (the emitter's side only), or ``auto``: ``upper`` for a "
        "flat specimen whose BSDF declares no transmission.",
        group=PATCHES,
        metavar="H",
        form='{"auto", "upper", "both"}',
        plugin=FILM,
    )

    # -------------------------------------------------------------------------- events

    max_depth: int = setting(
        1000,
        count(1, 2**31),
        Kind.COUNT,
        "Number of surface events after which a ray is truncated.",
        group=EVENTS,
    )
    max_scatterings: int = setting(
        10**7,
        count(1, 2**31),
        Kind.COUNT,
        "Number of scattering events in media after which a ray is truncated.",
        group=EVENTS,
        shown_default="1e7",
    )
    rr_depth: int = setting(
        -1,
        count(-1, 2**31),
        Kind.COUNT,
        "Number of events after which Russian roulette starts, for the weighted "
        "estimator; -1 for never. In media, -1 lets a ray whose weight is below 1/16 "
        "survive with probability 1/4 and four times the weight.",
        group=EVENTS,
    )
    period: Period = setting(
        "none",
        checked_period,
        Kind.WORD_OR_NUMBER,
        "``box`` makes the specimen's bounding box one cell of an infinite surface, "
        "without edges. Numbers such as ``2,3`` are the extents of that cell in x and "
        "y, about the middle of the box; geometry that is wider than its cell, as the "
        "slats of a closed blind, reaches into the next ones. The cell is the "
        "specimen: light that "
        "passes its openings is incident and transmitted, straight on; beside a finite "
        "specimen, light is ``missed`` and not incident.",
        group=EVENTS,
        metavar="box|PX,PY",
        form='{"none", "box"}, float or (float, float)',
        text=joined,
    )
    order: Order = setting(
        ALL_ORDERS,
        Order.parse,
        Kind.WORD,
        "Collect only rays with N surface interactions, or at least N (``N+``). ``0`` "
        "is the direct light that passes a periodic specimen; rays of other orders are "
        "in the ledger. In a specimen with media, scattering events inside the media "
        "count instead of surface interactions: ``1`` is single scattering. "
        "With one seed, orders 0, 1, 2 and ``3+`` add up to ``all``, to the bit.",
        group=EVENTS,
        metavar="N|N+",
        form="int or str",
        text=str,
        shown_default="all",
    )
    trace: bool = setting(
        False,
        checked_flag,
        Kind.FLAG,
        "Trace rays even where a flat specimen does not need it.",
        group=EVENTS,
        shown_default="false",
    )

    def __post_init__(self) -> None:
        for name, declared in declarations(type(self)).items():
            value = getattr(self, name)
            if value is not declared.default:
                object.__setattr__(self, name, declared.check(name, value))

    @classmethod
    def from_properties(cls, props: Any, plugin: str) -> MeasurementSettings:
        """Settings that are properties of a Mitsuba plugin; defaults for the others.

        Parameters
        ----------
        props : mi.Properties
        plugin : str
            Whose properties are declared, under which name errors speak of them.
        """
        given = {}
        for name, declared in declarations(cls).items():
            if declared.plugin == plugin and declared.key in props:
                label = f"{plugin}.{declared.key}"
                given[name] = declared.check(label, props[declared.key])
        return cls(**given)

    @classmethod
    def among(cls, arguments: Mapping[str, Any]) -> MeasurementSettings:
        """Settings among the arguments of a measurement; defaults for the others."""
        names = declarations(cls).keys()
        return DEFAULTS.changed(**{k: v for k, v in arguments.items() if k in names})

    def of_plugin(self, plugin: str) -> dict[str, Any]:
        """Values of the settings that are properties of `plugin`, by name."""
        return {
            name: getattr(self, name)
            for name, declared in declarations(type(self)).items()
            if declared.plugin == plugin
        }

    # What a user may ask for has one word each inside: `precision` and `noise` of rays,
    # `integral_err` of integrals, and the `tolerance` of a material, which a campaign
    # has. The option `rel_err` is the first of rays and the third of integrals.

    @property
    def precision(self) -> float | None:
        """Relative standard error of the patches worth reporting at which rays end."""
        return None if self.integrates else self.rel_err

    @property
    def integral_err(self) -> float:
        """Relative error of each patch to which ``quadrature`` converges."""
        return INTEGRAL_ERR if self.rel_err is None else self.rel_err

    @property
    def integrates(self) -> bool:
        """Whether `eval` is integrated, and rays are for delta components only."""
        return self.estimator is Estimator.QUADRATURE

    @property
    def sends_points(self) -> bool:
        """Whether events deposit `eval` towards `points`."""
        return self.estimator is Estimator.NEXT_EVENT

    @property
    def joins_points(self) -> bool:
        """Whether points of the surface tell the light of one event."""
        return self.estimator is Estimator.SPLIT

    @property
    def n_looks(self) -> int:
        """Directions that a ray looks into at each event, or goes on in."""
        if self.joins_points:
            return BRANCHES
        return self.points if self.sends_points else 1

    def changed(self, **given: Any) -> MeasurementSettings:
        """Copy of these settings with the `given` ones changed; None keeps a value.

        Raises
        ------
        TypeError
            For a name that is none of a setting.
        """
        names = declarations(type(self)).keys()
        for name in given.keys() - names:
            known = ", ".join(names)
            raise SettingTypeError(
                f"measure has no setting {name!r}: take one of {known}"
                f"{did_you_mean(name, (*ARGUMENTS, *names))}"
            )
        return replace(self, **{k: v for k, v in given.items() if v is not None})


# Settings of which nobody says anything.
DEFAULTS = MeasurementSettings()

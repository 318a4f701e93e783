"""The provenance of a record, and what becomes of it when records are put together.

Records of the same rays' conditions are merged; those of one specimen that are lit from
several directions are stacked. Files and users have it as settings: a dictionary.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from numbers import Integral, Real
from typing import Any, NoReturn

from ..errors import SettingError, SettingTypeError, abridged, shown
from ..settings import MeasurementSettings, declarations
from .campaign_outcome import CampaignOutcome

Settings = Mapping[str, Any]

# Specified settings that a record reports. It knows the others better: by its patches,
# channels and batches, and by its provenance.
REPORTED = (
    *("estimator", "points", "footprint", "divergence", "incident", "emission"),
    *("max_depth", "max_scatterings", "rr_depth", "period", "order", "side"),
    *("collector_radius", "rel_err", "noise", "floor", "gradients"),
)

# Settings in which records may differ and still be stacked or merged. An emitter that
# was moved, not turned, has another digest.
FREE_WHEN_STACKED = {
    *("created", "processors", "batches", "defects", "emitter_digest", "task"),
    *("reached", "n_lobe"),  # of the worst direction
    "choice",
}
FREE_WHEN_MERGED = {
    *("rays", "batches", "seed", "created", "versions", "specimen"),
    *("defects", "interrupted", "task", "processors", "choice"),
}

# Characters of a name that are told: in a file it may have any number.
MAX_NAME = 1000

# Processor of records that do not report it.
UNKNOWN = "unknown"

# Transport of rays beside a sum over mirror facets, which is their first order.
FACETS = "facets"


def _refuse(*_: object, **__: object) -> NoReturn:
    raise TypeError(
        "settings of a record cannot be changed: Record.with_settings returns another"
    )


_refused: Any = _refuse


class ReadOnlyDict(dict[str, Any]):
    """Dictionary that cannot change; equal to any dictionary of the same content."""

    __setitem__ = __delitem__ = __ior__ = _refused
    clear = pop = popitem = setdefault = update = _refused

    def __reduce__(self) -> tuple[Any, ...]:
        return ReadOnlyDict, (dict(self),)


class ReadOnlyList(list[Any]):
    """List that cannot change; equal to any list of the same content."""

    __setitem__ = __delitem__ = __iadd__ = __imul__ = _refused
    append = extend = insert = remove = pop = clear = sort = reverse = _refused

    def __reduce__(self) -> tuple[Any, ...]:
        return ReadOnlyList, (list(self),)


def read_only(value: Any) -> Any:
    """Copy of a value of JSON's types whose dictionaries and lists cannot change."""
    if isinstance(value, Mapping):
        return ReadOnlyDict({key: read_only(one) for key, one in value.items()})
    if isinstance(value, list):
        return ReadOnlyList(map(read_only, value))
    return value


def _each(kind: type, values: Any) -> bool:
    """Whether it is a list or tuple of values of a kind."""
    return isinstance(values, (list, tuple)) and all(
        isinstance(value, kind) and not isinstance(value, bool) for value in values
    )


# Types that need no look at all that a number may be, which takes longer.
PLAIN = (str, int, float, bool, type(None))


def _plain(value: Any) -> Any:
    """Number as JSON knows it, of NumPy's too; anything else as it is."""
    if type(value) in PLAIN or not isinstance(value, Real):
        return value
    return int(value) if isinstance(value, Integral) else float(value)


# Types of what is known, in words, and whether a value is of them: files may say
# anything.
KINDS: dict[str, tuple[str, Callable[[Any], bool]]] = {
    "str | None": ("a text", lambda value: isinstance(value, str)),
    "int": ("a positive count", lambda value: _each(Integral, [value]) and value > 0),
    "int | None": (
        "a count",
        lambda value: _each(Integral, [value]) and 0 <= value < 2**63,
    ),
    "float | None": ("a number", lambda value: _each(Real, [value]) and value == value),
    "bool": ("true or false", lambda value: isinstance(value, bool)),
    "tuple[str, ...]": ("a list of texts", partial(_each, str)),
    "tuple[int, ...]": (
        "a list of whole numbers of at least 0",
        lambda value: _each(Integral, value) and all(one >= 0 for one in value),
    ),
    "Mapping[str, str]": (
        "a dictionary of texts",
        lambda value: isinstance(value, Mapping) and _each(str, [*value.values()]),
    ),
    "CampaignOutcome | None": (
        "the outcome of a campaign",
        lambda value: isinstance(value, CampaignOutcome),
    ),
    "Mapping[str, Any] | None": (
        "a dictionary",
        lambda value: isinstance(value, Mapping),
    ),
}


@dataclass(frozen=True, kw_only=True)
class Provenance:
    """How a record came about; None where it is not known.

    Attributes
    ----------
    specimen, surface : str
        Name of the specimen, and what its surface is.
    media : tuple of str
        A line on each.
    defects : tuple of str
        Sentences on what is wrong with functions or surfaces of the specimen.
    digest, emitter_digest, plugin_digest : str
        Of the specimen; of its emitter, None for a collimated beam; and of the text of
        what is written in Python of both.
    transmission : str
        What the specimen lets through, as far as its BSDFs and straight rays tell.
    edges : str
        Of geometry without a period: ``open`` if it may stand for a larger surface, or
        ``closed``. Light that leaves over its edges counts by its direction.
    emitter : str
        Class of the emitter.
    transport : str
        How rays were followed: on a ``plane``, through ``layers``, or ``traced``; of
        mirror ``facets``, for what a sum over these leaves open.
    choice : str
        Why this estimator, where it was ``auto`` that was asked for.
    sampler : str
    seeds : tuple of int
        Several of a record that was merged.
    rays : int
        Asked for at each incident direction, and in each pass; 0 for integrals.
    batches : int
    passes : int
        How often the rays were sent: once for every four wavelengths.
    variant : str
    versions : mapping of str to str
    processors : tuple of str
        That sent the rays; see :func:`gonio_mi.variants.processor`.
    created : str
        Date and time.
    interrupted : bool
    reached : float
        Of the precision that was asked for, in the worst incident direction.
    n_lobe, paper_rays : int
        Patches worth reporting, and the rays that the paper's bound asks for.
    columns : tuple of str
        Numbers of parameters by which values were differentiated, ``name`` or
        ``name[i]``.
    campaign : CampaignOutcome
        How the directions were chosen, and how right the material is.
    task : mapping
        What a campaign's folder asked for.
    """

    specimen: str | None = None
    surface: str | None = None
    media: tuple[str, ...] = ()
    defects: tuple[str, ...] = ()
    digest: str | None = None
    emitter_digest: str | None = None
    plugin_digest: str | None = None
    transmission: str | None = None
    edges: str | None = None
    emitter: str | None = None
    transport: str | None = None
    choice: str | None = None
    sampler: str | None = None
    seeds: tuple[int, ...] = ()
    rays: int | None = None
    batches: int | None = None
    passes: int = 1
    variant: str | None = None
    versions: Mapping[str, str] = field(default_factory=dict)
    processors: tuple[str, ...] = ()
    created: str | None = None
    interrupted: bool = False
    reached: float | None = None
    n_lobe: int | None = None
    paper_rays: int | None = None
    columns: tuple[str, ...] = ()
    campaign: CampaignOutcome | None = None
    task: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        for one in fields(self):
            value = getattr(self, one.name)
            if value is one.default:
                continue
            kind, holds = KINDS[str(one.type)]
            if not (value is None and "None" in str(one.type)) and not holds(value):
                raise SettingTypeError(f"{one.name} must be {kind}, got {shown(value)}")
            if isinstance(value, Mapping):
                object.__setattr__(self, one.name, read_only(value))
            elif isinstance(value, (list, tuple)):
                object.__setattr__(self, one.name, tuple(map(_plain, value)))
            else:
                object.__setattr__(self, one.name, _plain(value))

    @property
    def name(self) -> str:
        """Name of the specimen, shortened if it is very long, or ``a record``."""
        return abridged(self.specimen or "a record", MAX_NAME)

    @property
    def each_processor(self) -> tuple[str, ...]:
        """Processors, or that none is known."""
        return self.processors or (UNKNOWN,)

    def joined(self, parts: Iterable[Provenance]) -> Provenance:
        """Return it with the processors and defects of all parts, each once.

        A number in a defect may be rounded otherwise on another processor.
        """
        parts = list(parts)
        found = dict.fromkeys(text for part in parts for text in part.defects)
        both = replace(self, defects=tuple(found))
        if not any(part.processors for part in parts):
            return both
        each = (name for part in parts for name in part.each_processor)
        return replace(both, processors=tuple(dict.fromkeys(each)))

    @classmethod
    def stacked(cls, parts: Sequence[Provenance]) -> Provenance:
        """Of a stack of records."""
        worst: dict[str, Any] = {}
        for name in ("reached", "n_lobe"):
            if getattr(parts[0], name) is not None:
                worst[name] = max(getattr(part, name) for part in parts)
        return replace(parts[0], task=None, **worst).joined(parts)

    def merged(self, other: Provenance) -> Provenance:
        """Of a record of the rays of two, or ValueError unless seeds are unlike."""
        if not (self.seeds and other.seeds):
            raise SettingError("records must know their seeds to be merged, got none")
        seeds = (*self.seeds, *other.seeds)
        if len(set(seeds)) < len(seeds):
            raise SettingError(
                f"records must have different seeds to be merged, got {list(seeds)}"
            )
        sums: dict[str, Any] = {}
        for name in ("rays", "batches"):
            each = getattr(self, name), getattr(other, name)
            sums[name] = None if None in each else sum(each)
        sums["interrupted"] = self.interrupted or other.interrupted
        both = replace(self, seeds=seeds, task=None, **sums)
        return both.joined([self, other])


# What digests are of.
DIGESTS = {
    "digest": "the specimen",
    "emitter_digest": "the emitter",
    "plugin_digest": "the Python code",
}


def check_alike(a: Settings, b: Settings, free: Collection[str], purpose: str) -> None:
    """Raise ValueError unless all settings agree, but for those that are `free`."""
    for key in sorted((a.keys() | b.keys()) - set(free)):
        if a.get(key) != b.get(key):
            if key in DIGESTS:
                raise SettingError(
                    f"records must agree in {DIGESTS[key]} to be {purpose}, but theirs "
                    f"differ (edited, or another one): {key} {shown(a.get(key))} and "
                    f"{shown(b.get(key))}"
                )
            raise SettingError(
                f"records must agree in {key} to be {purpose}, got "
                f"{shown(a.get(key))} and {shown(b.get(key))}"
            )


def shared_seeds(one: Mapping[str, str], other: Mapping[str, str]) -> str:
    """Seeds that both have, of their `ray_keys`, as text; empty if none.

    Different samplers make other rays of the same seed.
    """
    samplers = {keys["sampler"] for keys in (one, other) if "sampler" in keys}
    if len(samplers) > 1:
        return ""
    mine, theirs = (
        [seed.strip() for seed in keys.get("seed", "").split(",")]
        for keys in (one, other)
    )
    return ", ".join(seed for seed in mine if seed and seed in theirs)


# ---------------------------------------------------------------- the border of files


def reported_names(asked: MeasurementSettings, provenance: Provenance) -> list[str]:
    """Names of the specified settings that a record reports: those with an effect."""
    without_effect = {
        "points": not asked.sends_points,
        "max_scatterings": not provenance.media,
        "rel_err": asked.rel_err is None,
        "noise": asked.noise is None,
        "gradients": not asked.gradients,
        "floor": provenance.n_lobe is None,
    }
    return [name for name in REPORTED if not without_effect.get(name)]


def settings_mapping(
    asked: MeasurementSettings, provenance: Provenance
) -> dict[str, Any]:
    """Settings and provenance as files and users have them, in JSON's types.

    `points`, `rel_err` and `noise` are among them where they mean something,
    `max_scatterings` where there are media; what is not known is left out.
    """
    declared = declarations(MeasurementSettings)
    mapping = {
        name: declared[name].text(getattr(asked, name))
        for name in reported_names(asked, provenance)
    }
    own = {one.name: getattr(provenance, one.name) for one in fields(provenance)}
    seeds = own.pop("seeds")
    if seeds:
        own["seed"] = seeds[0] if len(seeds) == 1 else list(seeds)
    for name in ("media", "defects", "processors", "columns"):
        own[name] = list(own[name])
    if provenance.campaign is not None:
        own["campaign"] = provenance.campaign.as_mapping()
    known = {"passes"}
    if own["digest"] is not None:
        known |= {"emitter_digest", "plugin_digest"}
    for name, value in own.items():
        empty = value is None or value is False or value in ([], {})
        if name in known or not empty:
            mapping[name] = value
    return mapping


def read_settings(mapping: Settings) -> tuple[MeasurementSettings, Provenance]:
    """What :func:`settings_mapping` wrote; other keys are ignored.

    Raises
    ------
    TypeError, ValueError
        If a setting is out of its range.
    """
    asked = {name: mapping[name] for name in REPORTED if mapping.get(name) is not None}
    names = {one.name for one in fields(Provenance)} - {"seeds"}
    own = {name: mapping[name] for name in names if mapping.get(name) is not None}
    seed = mapping.get("seed")
    if seed is not None:
        own["seeds"] = tuple(seed) if isinstance(seed, (list, tuple)) else (seed,)
    if "campaign" in own:
        own["campaign"] = CampaignOutcome.from_mapping(own["campaign"])
    return MeasurementSettings(**asked), Provenance(**own)


def with_settings(
    asked: MeasurementSettings, provenance: Provenance, changes: Settings
) -> tuple[MeasurementSettings, Provenance]:
    """Both with other values of some settings.

    Raises
    ------
    TypeError
        For a name that no record reports.
    """
    known = {*REPORTED, "seed", *(one.name for one in fields(Provenance))} - {"seeds"}
    for name in sorted(changes.keys() - known):
        raise SettingTypeError(f"a record has no setting {name!r}")
    return read_settings({**settings_mapping(asked, provenance), **changes})

"""What the names that people give to the columns of a table mean."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

__all__ = ["ANGLES", "COLOURS", "ROLES", "Column", "is_unit", "recognised", "unit_of"]

ANGLES = ("theta_i", "phi_i", "theta_o", "phi_o", "delta_phi")
ROLES = (*ANGLES, "value", "sigma", "wavelength")

# Units as they are written, and as they are called here.
UNITS = {
    "deg": ("deg", "degree", "degrees", "°", "º"),
    "rad": ("rad", "radian", "radians"),
    "1/sr": ("1/sr", "sr^-1", "sr-1", "/sr", "sr^{-1}", "sr⁻¹", "sr**-1"),
    "%": ("%", "percent"),
    "1": ("1", "-", "none", "unitless"),
    "nm": ("nm", "nanometer", "nanometers", "nanometre", "nanometres"),
    "um": ("um", "µm", "μm", "micron", "microns"),
    "m": ("m", "meter", "meters", "metre", "metres"),
}
UNIT_OF = {written: unit for unit, names in UNITS.items() for written in names}
GREEK = {"θ": " theta ", "ϑ": " theta ", "φ": " phi ", "ϕ": " phi ", "λ": " lambda "}
GREEK |= {"Δ": " delta ", "σ": " sigma "}

POLAR = {"theta", "polar", "zenith", "zen", "z"}
AZIMUTH = {"phi", "azimuth", "azimuthal", "azi", "az", "a"}
INCOMING = {
    *("i", "in", "inc", "incident", "incidence", "incoming", "illumination", "input"),
    *("illuminating", "source", "src", "sun", "solar", "light", "lighting"),
}
OUTGOING = {
    *("o", "out", "r", "s", "v", "view", "viewing", "exit", "exitant", "outgoing"),
    *("measure", "measured", "measurement", "detector", "receiver", "scatter"),
    *("scattered", "scattering", "reflected", "observation", "observer", "sensor"),
    *("emergent", "output", "receive", "detection", "det"),
    *("t", "transmitted", "transmission"),
}
RELATIVE = {"relative", "rel", "delta", "d", "difference", "diff"}
FILLING = {"angle", "angles", "of", "the", "direction", "deg", "degrees"}
WAVELENGTH = {"wavelength", "wavelengths", "lambda", "wl", "wvl"}
UNCERTAIN = {
    *("sigma", "uncertainty", "uncert", "unc", "std", "stdev", "error", "err", "u"),
    *("sd", "uc", "expanded"),
}
ABBREVIATED = {
    "sza": "theta_i",
    "aoi": "theta_i",
    "saa": "phi_i",
    "vza": "theta_o",
    "vaa": "phi_o",
    "raa": "delta_phi",
    "dphi": "delta_phi",
}
QUANTITY_OF = {
    "btdf": "btdf",
    "brdf": "brdf",
    "ccbrdf": "brdf_cos",
    "brf": "reflectance_factor",
    "hcrf": "reflectance_factor",
}
# Nicodemus's symbols f_r and f_t, alone.
SYMBOLS = {"fr": "brdf", "ft": "btdf"}
VALUES = {"value", "values", "bsdf", *QUANTITY_OF}

# Channels that columns of values may have for their whole name.
COLOURS = ("R", "G", "B")

# Wavelengths in nm that a column may be named by without a unit.
SHORTEST, LONGEST = 150, 20_000

# A number that may be a wavelength, and one that values are multiplied with.
WITH_UNIT = re.compile(
    r"(?<![\w.])([0-9]+(?:\.[0-9]+)?)\s*(nm|um|µm|μm)?(?![\w.])", re.IGNORECASE
)
TIMES = re.compile(r"[*x·×⋅]\s*\d|\d\s*[*x·×⋅](?!\w)", re.IGNORECASE)

# Words of values that are something of a quantity, and not the quantity itself; and
# the like in signs, where cosines and units are none.
CHANGED = {
    *("log", "lg", "ln", "db", "decibel", "decibels", "sqrt", "root", "square"),
    *("squared", "inverse", "reciprocal", "ratio", "difference", "residual"),
    *("relative", "rel", "normalised", "normalized", "scaled", "arb", "arbitrary"),
    *("au", "counts", "msr", "flag", "index"),
}
COSINE = re.compile(r"[*x·×⋅]\s*\(?cos\w*.*$|^\s*cos\w*\s*[*x·×⋅]", re.IGNORECASE)
PER_SR = re.compile(
    r"(1\s*)?/\s*sr\b|\bsr\s*(\^|\*\*)?[{(]?[-−⁻][1¹][})]?", re.IGNORECASE
)
CHANGES = re.compile(
    r"[*^×·⋅]|\b(db\b|[munk]sr)|(?<!\w)1e-?\d|(?<![\d.])10+(?![\d.])"
    r"|^\s*[-−]|/\s*\d|(?<![\w.])1\s*/|(b[rst]df|brf)\s*/|/\s*(b[rst]df|brf)",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class Column:
    """What a column of a table holds.

    One whose name says that it holds a multiple or a logarithm of a quantity, as
    `CHANGED` and `CHANGES` have it, is none of these.

    Attributes
    ----------
    name : str
        As it is written.
    role : str
        One of :data:`ROLES`; ``delta_phi`` is an azimuth relative to the plane of
        incidence.
    unit : str
        A key of :data:`UNITS`; empty if the name does not say it.
    quantity : str
        Of values, if the name says it.
    channel : str
        Of values and uncertainties, such as ``"550nm"``, if the name says it.
    coverage : float
        By which uncertainties are divided: 2 for an expanded one of k = 2.
    relative : bool
        Whether uncertainties are relative to the values.
    """

    name: str
    role: str
    unit: str = ""
    quantity: str = ""
    channel: str = ""
    coverage: float = 1.0
    relative: bool = False


def recognised(name: str) -> Column | None:
    """Return what a column of this name holds, or None if nothing is known of it."""
    text, unit = _without_unit(name)
    words = _words(text)
    role = _angle(words)
    if role:
        return Column(name, role, unit)
    if words and set(words) <= WAVELENGTH:
        return Column(name, "wavelength", unit)
    text, channel = _without_wavelength(text if unit not in ("nm", "um") else name)
    words = _words(text)
    if set(words) & UNCERTAIN:
        coverage = re.search(r"k\s*=\s*([0-9]+(?:\.[0-9]*)?)(?![\w.])", name)
        factor = 2.0 if "expanded" in words or "U" in re.findall(r"\w+", name) else 1.0
        relative = unit == "%" or bool(set(words) & {"relative", "rel"})
        factor = float(coverage[1]) if coverage else factor
        return Column(name, "sigma", unit, "", channel, factor or 1.0, relative)
    quantity = _quantity(words)
    if _is_changed(text, words):
        return None
    if quantity or set(words) & VALUES or (channel and not words):
        return Column(name, "value", unit if not channel else "", quantity, channel)
    return None


def is_unit(text: str) -> bool:
    """Whether a text is a unit, in brackets or not."""
    return text.strip().strip("[]()").strip().lower() in UNIT_OF


def unit_of(name: str) -> str:
    """Unit that a name ends with, as a key of :data:`UNITS`; empty if with none."""
    return _without_unit(name)[1]


def _without_unit(name: str) -> tuple[str, str]:
    """Name without the unit that it ends with, and the unit."""
    text = " ".join(name.replace("\ufeff", "").split())
    for pattern in (
        r"^(.*?)\s*[\[(]([^\[\]()]*|1/sr)[\])]\s*$",
        r"^(.*?)\s*/\s*\(?(1/sr|[^/()]+?)\)?\s*$",
        r"^(.+?)[ _](deg|degrees?|rad|radians?|nm|percent|%|°)$",
    ):
        match = re.match(pattern, text, re.IGNORECASE)
        if match and match[2].strip().lower() in UNIT_OF:
            return match[1], UNIT_OF[match[2].strip().lower()]
    return text, ""


def _words(text: str) -> list[str]:
    """Words of a name in small letters, without those that only fill it."""
    for letter, word in GREEK.items():
        text = text.replace(letter, word)
    text = re.sub(r"([a-z])([A-Z])", r"\1 \2", text).lower()
    words: list[str] = []
    for word in re.findall(r"[a-z]+", text):
        split = re.fullmatch(r"(theta|phi)([a-z]+)", word)
        words += split.groups() if split else [word]
    if len(words) > 1 or words[:1] != ["angle"]:
        angle = "angle" in words or "angles" in words
        words = [w for w in words if w not in FILLING]
        # "incident angle" is a polar angle
        if angle and not set(words) & (POLAR | AZIMUTH | RELATIVE):
            words.append("theta")
    return words


def _angle(words: Sequence[str]) -> str:
    """Role of an angle, or nothing."""
    if len(words) == 1 and words[0] in ABBREVIATED:
        return ABBREVIATED[words[0]]
    kinds = [w for w in words if w in POLAR | AZIMUTH]
    # the letters a and z are angles beside a side only
    rest = [w for w in words if w not in POLAR | AZIMUTH]
    sides = [w for w in rest if w in INCOMING | OUTGOING]
    relative = [w for w in rest if w in RELATIVE]
    if kinds in (["phi"] * 2, ["azimuth"] * 2) and len(rest) == len(sides) == 2:
        return "delta_phi"
    if len(kinds) != 1 or len(sides) + len(relative) != len(rest):
        return ""
    azimuth = kinds[0] in AZIMUTH
    if relative:
        return "delta_phi" if azimuth else ""
    if len(sides) != 1:
        return ""
    stem = "phi" if azimuth else "theta"
    return f"{stem}_{'i' if sides[0] in INCOMING else 'o'}"


def _without_wavelength(text: str) -> tuple[str, str]:
    """Name without a wavelength in it, and its channel such as ``"550nm"``."""
    spaced = text.replace("_", " ")
    for match in WITH_UNIT.finditer(spaced):
        nm = float(match[1]) * (1 if (match[2] or "nm").lower() == "nm" else 1000)
        before, after = spaced[: match.start()], spaced[match.end() :]
        multiple = TIMES.search(f"{before[-3:]}0{after[:3]}")
        if SHORTEST <= nm <= LONGEST and not multiple:
            return f"{before} {after}", f"{nm:.10g}nm"
    return text, ""


def _is_changed(text: str, words: Sequence[str]) -> bool:
    """Whether a name is that of values times a number, their logarithm or the like."""
    bare = PER_SR.sub(" ", COSINE.sub(" ", text))
    changed = CHANGES.search(bare) or TIMES.search(bare)
    return bool(CHANGED & set(words) or changed)


def _quantity(words: Sequence[str]) -> str:
    """Quantity that a name of values says, or nothing."""
    if "factor" in words and {"reflectance", "radiance"} & set(words):
        return "reflectance_factor"
    for word in words:
        if word in QUANTITY_OF:
            cosine = QUANTITY_OF[word] == "brdf" and {"cos", "cosine"} & set(words)
            return "brdf_cos" if cosine else QUANTITY_OF[word]
    return SYMBOLS.get("".join(words), "")

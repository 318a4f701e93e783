"""Aliases of column names in measured tables, and their meaning."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from scipy import special

ANGLES = ("theta_i", "phi_i", "theta_o", "phi_o", "delta_phi")
ROLES = (*ANGLES, "value", "sigma", "wavelength")

# Units as they are written, in small letters without blanks, and as they are called.
PERCENT = "% percent pct"
PER_SR = "1/sr sr^-1 sr-1 /sr sr^{-1} sr⁻¹ sr**-1 sr−1 sr^(-1)"
UNITS = {
    "deg": "deg degree degrees ° º",
    "rad": "rad radian radians",
    "1/sr": PER_SR,
    "%": PERCENT,
    "%/sr": " ".join(
        f"{part}{dot}{sr}"
        for part in PERCENT.split()
        for dot in ("", "·", "*")
        for sr in PER_SR.split()
    ),
    "1": "1 - none unitless",
    "nm": "nm nanometer nanometers nanometre nanometres",
    "um": "um µm μm micron microns",
    "m": "m meter meters metre metres",
}
UNIT_OF = {written: unit for unit, words in UNITS.items() for written in words.split()}
GREEK = {"θ": " theta ", "ϑ": " theta ", "φ": " phi ", "ϕ": " phi ", "λ": " lambda "}
GREEK |= {"Δ": " delta ", "σ": " sigma ", "±": " uncertainty "}


def _listed(words: str) -> set[str]:
    """Words between blanks."""
    return set(words.split())


POLAR = _listed("theta polar zenith zen z")
AZIMUTH = _listed("phi azimuth azimuthal azi az a")
INCOMING = _listed(
    "i in inc incident incidence incoming illumination input illuminating source src "
    "sun solar light lighting"
)
OUTGOING = _listed(
    "o out r s v view viewing exit exitant outgoing measure measured measurement "
    "detector receiver scatter scattered scattering reflected observation observer "
    "sensor emergent output receive detection det t transmitted transmission"
)
RELATIVE = _listed("relative rel delta d difference diff")
FILLING = _listed("angle angles of the direction deg degrees")
WAVELENGTH = _listed("wavelength wavelengths lambda wl wvl")
ABBREVIATED = {"sza": "theta_i", "aoi": "theta_i", "saa": "phi_i", "vza": "theta_o"}
ABBREVIATED |= {"vaa": "phi_o", "raa": "delta_phi", "dphi": "delta_phi"}
QUANTITY_OF = {"btdf": "btdf", "brdf": "brdf", "ccbrdf": "brdf_cos"}
QUANTITY_OF |= dict.fromkeys(("brf", "hcrf"), "reflectance_factor")
# Nicodemus's symbols f_r and f_t, alone.
SYMBOLS = {"fr": "brdf", "ft": "btdf"}
VALUES = {"value", "values", "bsdf", *QUANTITY_OF}

UNCERTAIN = _listed(
    "sigma uncertainty uncertainties uncert unc std stdev error err u sd uc expanded "
    "stddev deviation rsd"
)
# Uncertainties that are relative to the value, or not, and other words beside them.
RELATIVE_WORDS = {"relative", "rel", "rsd", "fractional"}
ABSOLUTE_WORDS = {"absolute", "abs"}
OTHER_WORDS = RELATIVE_WORDS | ABSOLUTE_WORDS
OTHER_WORDS |= _listed(
    "standard combined total measurement random reflectance factor radiance f r dev "
    "percent pct cos in type b statistical cosine s c k"
)

# Channels that columns of values may have for their whole name.
COLOURS = ("R", "G", "B")

# Wavelengths in nm that a column may be named by without a unit.
MIN_NM, MAX_NM = 150, 20_000

# A number that may be a wavelength, and one that values are multiplied with.
WITH_UNIT = re.compile(
    r"(?<![\w.])([0-9]+(?:\.[0-9]+)?)\s*(nm|um|µm|μm)?(?![\w.])", re.IGNORECASE
)
TIMES = re.compile(r"[*x·×⋅]\s*\d|\d\s*[*x·×⋅](?!\w)", re.IGNORECASE)

# Words of values that are something of a quantity, and not the quantity itself; and
# the like in signs, where cosines and units are none.
CHANGING_WORDS = _listed(
    "log lg ln db decibel decibels sqrt root square squared inverse reciprocal ratio "
    "difference residual relative rel normalised normalized scaled arb arbitrary au "
    "counts msr flag index delta number n"
)
COSINE = re.compile(r"[*x·×⋅]\s*\(?cos\w*.*$|^\s*cos\w*\s*[*x·×⋅]", re.IGNORECASE)
STERADIANS = re.compile(
    r"(1\s*)?/\s*sr\b|\bsr\s*(\^|\*\*)?[{(]?[-−⁻][1¹][})]?", re.IGNORECASE
)
CHANGING_SIGNS = re.compile(
    r"[*^×·⋅]|\b(db\b|[munk]sr)|(?<!\w)1e-?\d|(?<![\d.])10+(?![\d.])"
    r"|^\s*[-−]|/\s*\d|(?<![\w.])1\s*/|(b[rst]df|brf)\s*/|/\s*(b[rst]df|brf)",
    re.IGNORECASE,
)

# Uncertainties that are divided by the values; angles in units that are no words, as
# arc minutes, or that are numbers themselves.
PER_VALUE = re.compile(r"/\s*(b[rst]df|h?c?brf|hcrf|values?|f_?[rt])\b", re.IGNORECASE)
NO_ANGLE = re.compile(r"[\d'\"\u2032\u2033=*×^]")

# Coverage of uncertainties: a factor k, so many sigma, or a level in per cent, which
# may stand behind U; and a factor behind.
NUMBER = r"([0-9]+(?:[.,][0-9]+)?)"
FACTOR = re.compile(
    r"(?<![^\W_])k[\s_]*[=:]?[\s_]*([0-9.]+(?:,[0-9]+)?)", re.IGNORECASE
)
SIGMAS = re.compile(
    rf"(?<![\w.,]){NUMBER}[\s*x·×⋅-]*(?:σ|(?i:sigma|std|stdev|stddev|sd)|u)(?![^\W_])"
)
LEVEL = re.compile(r"(?<![\w.,])((?:68|95|99)(?:[.,][0-9]+)?)\s*%")
EXPANDED = re.compile(
    r"(?<![^\W_])[Uu][\s_]?((?:68|95|99)(?:[.,][0-9]+)?)\s*%?(?![\w.])"
)
BEHIND = re.compile(rf"[*x·×⋅]\s*{NUMBER}\s*$")

# Levels that stand for one sigma and three.
SIGMAS_OF_LEVEL = {68.0: 1.0, 99.7: 3.0}


@dataclass(frozen=True)
class Column:
    """What a column of a table holds.

    One whose name says that it holds a multiple or a logarithm of a quantity, as
    :data:`CHANGING_WORDS` and :data:`CHANGING_SIGNS` tell, is none of these.

    Attributes
    ----------
    name : str
        As it is written.
    role : str
        One of :data:`ROLES`; ``delta_phi`` is an azimuth relative to the plane of
        incidence.
    unit : str
        A key of :data:`UNITS`; empty if the name has none.
    quantity : str
        Of values, if the name has it.
    channel : str
        Of values and uncertainties, such as ``"550nm"``, if the name has it.
    coverage : float
        By which uncertainties are divided: 2 for an expanded one of k = 2; NaN if a
        number in the name leaves it open.
    kind : str
        Of uncertainties ``"rel"``, relative to the values, or ``"abs"``; empty if the
        name has neither.
    """

    name: str
    role: str
    unit: str = ""
    quantity: str = ""
    channel: str = ""
    coverage: float = 1.0
    kind: str = ""


def recognised(name: str) -> Column | None:
    """Return what a column of this name holds, or None if nothing is known of it."""
    bare, coverage = _without_coverage(name)
    text, unit = _without_unit(bare)
    words = _words(text)
    role = _angle(words)
    if role:
        return None if NO_ANGLE.search(text) else Column(name, role, unit)
    if words and set(words) <= WAVELENGTH:
        return Column(name, "wavelength", unit)
    length = unit in ("nm", "um")
    text, channel = _without_wavelength(bare if length else text)
    words = _words(text)
    if length:
        unit = ""
    if not unit and set(words) & {"percent", "pct"}:
        unit = "%"
    if set(words) & UNCERTAIN:
        if set(words) - UNCERTAIN - VALUES - OTHER_WORDS:
            return None  # of an angle, a wavelength, a temperature
        if not coverage:
            expanded = "expanded" in words or "U" in re.findall(r"\w+", name)
            coverage = _coverage_left(text) or (2.0 if expanded else 1.0)
        kind = "abs" if set(words) & ABSOLUTE_WORDS else ""
        if set(words) & RELATIVE_WORDS or PER_VALUE.search(text):
            kind = "rel"
        if unit in ("1/sr", "%/sr"):
            kind = "abs"
        return Column(name, "sigma", unit, "", channel, coverage, kind)
    if _is_changed(text, words) or unit not in ("", "1/sr", "%", "%/sr", "1"):
        return None
    quantity = _quantity(words)
    if quantity or set(words) & VALUES or (channel and not words):
        unit = "" if channel and unit == "1/sr" else unit
        return Column(name, "value", unit, quantity, channel)
    return None


def coverage_of(name: str) -> float:
    """Coverage factor in a name, from a factor, a level or a number of sigmas, or 0."""
    return _without_coverage(name)[1]


def is_unit(text: str) -> bool:
    """Whether a text is a unit, in brackets or not."""
    return text.strip().strip("[]()").strip().lower() in UNIT_OF


def unit_of(name: str) -> str:
    """Unit in a name, as a key of :data:`UNITS`; empty if there is none."""
    return _without_unit(_without_coverage(name)[0])[1]


def _without_coverage(name: str) -> tuple[str, float]:
    """Name without its coverage factor, and the factor; 0 if there is none."""
    text = " ".join(name.replace("\ufeff", "").split())
    for pattern in (FACTOR, EXPANDED, LEVEL, SIGMAS):
        match = pattern.search(text)
        if match:
            rest = f"{text[: match.start()]}{text[match.end() :]}"
            if pattern in (EXPANDED, SIGMAS):  # these words mark an uncertainty, too
                rest += " sigma"
            try:
                number = float(match[1].replace(",", "."))
            except ValueError:
                number = 1.0
            if pattern in (EXPANDED, LEVEL):
                sigmas = round(float(special.ndtri((1 + number / 100) / 2)), 3)
                return rest, SIGMAS_OF_LEVEL.get(number, sigmas)
            return rest, number or 1.0
    return text, 0.0


def _coverage_left(text: str) -> float:
    """Factor behind a name without its unit; NaN for other numbers, 0 if none is."""
    behind = BEHIND.search(text)
    if behind:
        return float(behind[1].replace(",", ".")) or math.nan
    numbers = [float(number) for number in re.findall(r"[0-9]+(?:\.[0-9]+)?", text)]
    return 0.0 if all(MIN_NM <= one <= MAX_NM for one in numbers) else math.nan


def _without_unit(text: str) -> tuple[str, str]:
    """Name without its unit: in brackets, after a slash, a comma or at the end."""
    found = ""
    for group in re.findall(r"[\[(][^\[\]()]*(?:\([^()]*\)[^\[\]()]*)?[\])]", text):
        parts = [_unit(part) for part in re.split("[,;]", group[1:-1]) if part.strip()]
        if all(parts):
            text = text.replace(group, " ", 1)
            found = found or "".join(parts[:1])
    for pattern in (
        r"^(.*?)\s*/\s*\(?(1/sr|[^/()]+?)\)?\s*$",
        r"^(.+?)[ _,]+(deg|degrees?|rad|radians?|nm|percent|%|°|%/sr)\s*$",
    ):
        match = re.match(pattern, text, re.IGNORECASE)
        if not found and match and _unit(match[2]):
            text, found = match[1], _unit(match[2])
    if not found and "%" in text:
        text, found = text.replace("%", " "), "%"
    return text, found


def _unit(text: str) -> str:
    """Unit as it is called; empty if it is none."""
    return UNIT_OF.get(text.replace(" ", "").lower(), "")


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
        if MIN_NM <= nm <= MAX_NM and not multiple:
            return f"{before} {after}", f"{nm:.10g}nm"
    return text, ""


def _is_changed(text: str, words: Sequence[str]) -> bool:
    """Whether a name is that of values times a number, their logarithm or the like."""
    bare = STERADIANS.sub(" ", COSINE.sub(" ", text))
    changed = CHANGING_SIGNS.search(bare) or TIMES.search(bare)
    return bool(CHANGING_WORDS & set(words) or changed)


def _quantity(words: Sequence[str]) -> str:
    """Quantity that a name of values says, or nothing."""
    if "factor" in words and {"reflectance", "radiance"} & set(words):
        return "reflectance_factor"
    for word in words:
        if word in QUANTITY_OF:
            cosine = QUANTITY_OF[word] == "brdf" and {"cos", "cosine"} & set(words)
            return "brdf_cos" if cosine else QUANTITY_OF[word]
    return SYMBOLS.get("".join(words), "")

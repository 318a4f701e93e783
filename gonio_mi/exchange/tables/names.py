"""Names of columns in measured tables: units, coverage factors, and a list of words.

A name is known if all of its words are; any other column is asked for.
"""

import math
import re
from dataclasses import dataclass

from scipy import special

ANGLES = ("theta_i", "phi_i", "theta_o", "phi_o", "delta_phi")
ROLES = (*ANGLES, "value", "sigma", "wavelength")

# Units as they are written, in small letters without blanks, and as they are called.
PERCENT = "% percent pct"
PER_SR = "1/{0} {0}^-1 {0}-1 /{0} {0}^{{-1}} {0}⁻¹ {0}**-1 {0}−1 {0}^(-1)"
UNITS = {
    "deg": "deg degree degrees ° º",
    "rad": "rad radian radians",
    "1/sr": PER_SR.format("sr"),
    "1/msr": PER_SR.format("msr"),
    "%": PERCENT,
    "%/sr": " ".join(
        f"{part}{dot}{sr}"
        for part in PERCENT.split()
        for dot in ("", "·", "*")
        for sr in PER_SR.format("sr").split()
    ),
    "1": "1 - none unitless",
    "nm": "nm nanometer nanometers nanometre nanometres",
    "um": "um µm μm micron microns",
    "m": "m meter meters metre metres",
}
UNIT_OF = {written: unit for unit, words in UNITS.items() for written in words.split()}
VALUE_UNITS = ("", "1/sr", "1/msr", "%", "%/sr", "1")

# A unit at the end of a name without brackets; 1 and m are none there.
AT_END = re.compile(
    r"^(.*?)(?:\s*/\s*\(?|[ _,]+(?:in )?)("
    + "|".join(re.escape(one) for one in sorted(UNIT_OF, key=len)[::-1] if one[1:])
    + r"|%|°)\)?\s*$",
    re.IGNORECASE,
)

# Words of one meaning, and what is written for several words.
WORDS = {
    "theta": "polar zenith zen z",
    "phi": "azimuth azimuths azimuthal azi az a",
    "i": "in inc incident incidence incoming illumination input illuminating source "
    "src sun solar light lighting",
    "o": "out r s v view viewing exit exitant outgoing measure measured measurement "
    "detector receiver scatter scattered scattering reflected observation observer "
    "sensor emergent output receive detection det t transmitted transmission",
    "rel": "relative delta d difference diff fractional",
    "lambda": "wavelength wavelengths wl wvl",
    "value": "values bsdf",
    "cos": "cosine",
    "u": "sigma uncertainty uncertainties uncert unc std stdev error err sd uc "
    "expanded stddev deviation",
    "abs": "absolute",
    "angle": "angles",
    "": "of the direction deg degrees",
    "beside": "standard combined total random dev type b statistical c k f percent pct "
    "reflectance factor radiance mean average averaged panel bidirectional",
}
MEANING = {word: one for one, words in WORDS.items() for word in words.split()}
WRITTEN = {
    "±": "u", "σ": "u", "θ": "theta", "ϑ": "theta", "φ": "phi", "ϕ": "phi",
    "λ": "lambda", "Δ": "rel",
}  # fmt: skip
SHORT = {
    "sza": "theta i", "aoi": "theta i", "saa": "phi i", "vza": "theta o",
    "vaa": "phi o", "raa": "phi rel", "dphi": "phi rel", "rsd": "u rel",
    "ccbrdf": "brdf cos", "hcrf": "brf",
}  # fmt: skip
PHRASES = (
    # two words in one, plurals, numbers of samples
    (r"([a-z])([A-Z])", r"\1 \2"),
    (r"(?i)\b(theta|phi)s(?=[ _]\w)", r"\1"),
    (r"(?i)(?<![a-z])(theta|phi)(?=[a-z])", r"\1 "),
    (r"(?i)(?<![a-z])(?:sample|specimen)[ _#]*[0-9]*(?![a-z0-9])", " "),
    # uncertainties over values, factors, Nicodemus's symbols, hyphens
    (r"(?i)/\s*(?=(?:b[rst]df|h?c?brf|hcrf|values?|f_?[rt])\b)", " rel "),
    (r"(?i)(?:reflectance|radiance)[ _]factors?", " brf "),
    (r"(?i)(?<![a-z])f[_ ]?r(?![a-z])", " brdf "),
    (r"(?i)(?<![a-z])f[_ ]?t(?![a-z])", " btdf "),
    (r"(?<=\w)\s*[-–]\s*(?=[A-Za-z])", " "),
)
ROLE_OF = {
    "i theta": "theta_i", "i phi": "phi_i", "o theta": "theta_o", "o phi": "phi_o",
    "phi rel": "delta_phi", "i o phi": "delta_phi", "lambda": "wavelength",
}  # fmt: skip
QUANTITY_OF = {"brdf": "brdf", "btdf": "btdf", "brf": "reflectance_factor"}
IN_VALUES = {"value", "beside", *QUANTITY_OF}
IN_COSINES = {"cos", "theta", "o", "*", "x", "·"}
IN_SIGMAS = IN_VALUES | {"u", "rel", "abs", "cos", "o"}

# Wavelengths in nm that a column may be named by.
MIN_NM, MAX_NM = 150, 20_000
WAVELENGTH = re.compile(
    r"(?<![\w.])([0-9]+(?:\.[0-9]+)?)\s*(nm|um|µm|μm)?(?![\w.])", re.IGNORECASE
)

# Coverage of uncertainties: a level in per cent, also behind U; k or so many sigma.
NUMBER = r"([0-9]+(?:[.,][0-9]+)?)(?![.,]?[0-9])"
LEVELS = r"((?:68|95|99)(?:[.,][0-9]+)?)"
FACTOR = re.compile(
    rf"(?<![^\W_])k[\s_]*[=:]?[\s_]*{NUMBER}|[*x·×⋅]\s*{NUMBER}(?=\s*(?:[\[(]|$))"
    rf"|(?<![\w.,]){NUMBER}[\s*x·×⋅-]*(?=(?:σ|sigma|std|stdev|stddev|sd|u)(?![^\W_]))",
    re.IGNORECASE,
)
EXPANDED = re.compile(rf"(?<![^\W_])[Uu][\s_]?{LEVELS}\s*(%?)(?![\w.])")
LEVEL = re.compile(rf"(?<![\w.,]){LEVELS}\s*(%)")
SIGMAS_OF_LEVEL = {68.0: 1.0, 99.7: 3.0}


@dataclass(frozen=True)
class Column:
    """What a column of a table holds.

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
        name has neither; ``"?"`` if its % may be that of a level.
    """

    name: str
    role: str
    unit: str = ""
    quantity: str = ""
    channel: str = ""
    coverage: float = 1.0
    kind: str = ""


def recognised(name: str) -> Column | None:
    """Return what a column of this name holds, or None if a word in it is unknown."""
    text, coverage, level = _without_coverage(name)
    text, channel = _without_wavelength(text)
    text, unit = _without_unit(text)
    words = _words(text)
    role = ROLE_OF.get(" ".join(sorted(words)))
    if role:
        return None if channel or coverage else Column(name, role, unit)
    unit = unit or ("%" if re.search(r"(?i)percent|pct", text) else "")
    numbers = {word for word in words if word[0].isdigit()}
    if "u" in words and words - numbers <= IN_SIGMAS:
        expanded = re.search(r"(?i:expanded)|\bU(?![^\W_])", name)
        coverage = coverage or (math.nan if numbers else 2.0 if expanded else 1.0)
        kind = "abs" if "abs" in words or unit in ("1/sr", "1/msr", "%/sr") else level
        kind = "rel" if "rel" in words else kind
        return Column(name, "sigma", unit, "", channel, coverage, kind)
    quantities = words & {*QUANTITY_OF}
    cosine = "cos" in words and "brdf" in words
    known = words <= IN_VALUES | (IN_COSINES if cosine else set())
    if coverage or not known or len(quantities) > 1 or unit not in VALUE_UNITS:
        return None
    if quantities or "value" in words or (channel and not words):
        quantity = QUANTITY_OF[min(quantities)] if quantities else ""
        return Column(name, "value", unit, f"{quantity}{'_cos' * cosine}", channel)
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


def _without_coverage(name: str) -> tuple[str, float, str]:
    """Name without its coverage factor, the factor or 0, and "?" beside an unclear %.

    The % of a level in brackets, as in "uncertainty (95 %)", is no unit.
    """
    text = " ".join(name.replace("\ufeff", "").split())
    coverage, unclear = 0.0, ""
    for pattern, rest in ((FACTOR, " "), (EXPANDED, " U "), (LEVEL, " ")):
        match = pattern.search(text)
        if match:
            before, after = text[: match.start()], text[match.end() :]
            number = float(next(filter(None, match.groups())).replace(",", "."))
            if pattern is not FACTOR:
                sigmas = round(float(special.ndtri((1 + number / 100) / 2)), 3)
                number = SIGMAS_OF_LEVEL.get(number, sigmas)
                if match[2] and not re.search(r"[\[(]", before):
                    rest, unclear = f"{rest}%", "?"
            text, coverage = f"{before}{rest}{after}", coverage or number or 1.0
            if unclear:
                break
    return text, coverage, unclear


def _without_unit(text: str) -> tuple[str, str]:
    """Name without its unit: in brackets, after a slash, a comma or at the end."""
    found = ""
    for group in re.findall(r"[\[(][^\[\]()]*(?:\([^()]*\)[^\[\]()]*)?[\])]", text):
        parts = [_unit(part) for part in re.split("[,;]", group[1:-1]) if part.strip()]
        if all(parts):
            text = text.replace(group, " ", 1).rstrip()
            found = found or "".join(parts[:1])
    match = None if found else AT_END.match(text)
    if match:
        return match[1], _unit(match[2])
    if not found and "%" in text:
        return text.replace("%", " "), "%"
    return text, found


def _unit(text: str) -> str:
    """Unit as it is called; empty if it is none."""
    return UNIT_OF.get(text.replace(" ", "").lower(), "")


def _words(text: str) -> frozenset[str]:
    """Meanings of the words of a name, and its signs and unknown words as they are."""
    for letter, name in WRITTEN.items():
        text = text.replace(letter, f" {name} ")
    for pattern, phrase in PHRASES:
        text = re.sub(pattern, phrase, text)
    found = re.findall(r"[^\W\d_]+|[0-9][0-9.]*|[^\w\s.,;:=@()\[\]{}]", text.lower())
    found = " ".join(SHORT.get(word, word) for word in found).split()
    words = {MEANING.get(word, word) for word in found} - {""}
    if "angle" in words:  # "incident angle" is a polar angle
        words = words - {"angle"} | (set() if words & {"theta", "phi"} else {"theta"})
    return frozenset(words)


def _without_wavelength(text: str) -> tuple[str, str]:
    """Name without a wavelength in it, and its channel such as ``"550nm"``."""
    spaced = text.replace("_", " ")
    for match in WAVELENGTH.finditer(spaced):
        nm = float(match[1]) * (1 if (match[2] or "nm").lower() == "nm" else 1000)
        if MIN_NM <= nm <= MAX_NM:
            rest = f"{spaced[: match.start()]} {spaced[match.end() :]}"
            return rest, f"{nm:.10g}nm"
    return text, ""

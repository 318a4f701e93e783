"""Names of columns in measured tables: a table of aliases, units, coverage factors.

A name is known if all of its words are; any other column is asked for.
"""

import math
import re
from dataclasses import dataclass

ANGLES = ("theta_i", "phi_i", "theta_o", "phi_o", "delta_phi")
ROLES = (*ANGLES, "value", "sigma", "wavelength")

# Factor of each unit to ours, and how it is written, in small letters without blanks,
# powers and brackets.
UNITS = {
    "deg": (1.0, "deg degree degrees ° º"),
    "rad": (math.degrees(1.0), "rad radian radians"),
    "1/sr": (1.0, "1/sr sr-1 /sr"),
    "1/msr": (1e3, "1/msr msr-1 /msr"),
    "%": (0.01, "% percent pct"),
    "%/sr": (0.01, "%/sr %sr-1 percent/sr percentsr-1 pct/sr pctsr-1"),
    "1": (1.0, "1 - none unitless"),
    "nm": (1.0, "nm nanometer nanometers nanometre nanometres"),
    "um": (1e3, "um µm μm micron microns"),
    "m": (1e9, "m meter meters metre metres"),
}
UNIT_OF = {word: unit for unit, (_, words) in UNITS.items() for word in words.split()}
FACTOR_OF = {"": 1.0} | {unit: factor for unit, (factor, _) in UNITS.items()}

# Units that a column may have, by its role.
UNITS_OF = {
    **dict.fromkeys(ANGLES, ("deg", "rad")),
    **dict.fromkeys(("value", "sigma"), ("1/sr", "1/msr", "%", "%/sr", "1")),
    "wavelength": ("nm", "um", "m"),
}

# Words by their meaning, of which there may be two.
ALIASES = {
    "theta": "polar zenith zen z θ ϑ",
    "phi": "azimuth azimuths azimuthal azi az a φ ϕ",
    "i": "in inc incident incidence incoming illumination input illuminating source "
    "src sun solar light lighting",
    "o": "out r s v view viewing exit exitant outgoing measure measured measurement "
    "detector receiver scatter scattered scattering reflected observation observer "
    "sensor emergent output receive detection det t transmitted transmission",
    "theta i": "sza aoi",
    "phi i": "saa",
    "theta o": "vza",
    "phi o": "vaa",
    "rel": "relative delta d difference diff fractional δ",
    "phi rel": "raa dphi",
    "lambda": "wavelength wavelengths wl wvl λ",
    "value": "values bsdf",
    "brf": "hcrf",
    "brdf cos": "ccbrdf",
    "cos": "cosine",
    "u": "sigma uncertainty uncertainties uncert unc std stdev error err sd uc "
    "expanded stddev deviation ± σ",
    "u rel": "rsd",
    "abs": "absolute",
    "angle": "angles",
    "": "of the direction deg degrees",
    "beside": "standard combined total random dev type b statistical c k f percent pct "
    "reflectance factor radiance mean average averaged panel bidirectional",
}
MEANING = {word: one for one, words in ALIASES.items() for word in words.split()}
PHRASES = (
    # words and letters in one, plurals
    (r"([a-z])([A-Z])", r"\1 \2"),
    (r"(?i)\b(theta|phi)s(?=[ _]\w)", r"\1"),
    (r"(?i)(?<![a-z])(theta|phi)(?=[a-z])", r"\1 "),
    (r"([θϑφϕλΔσ±])", r" \1 "),
    # uncertainties over values, factors, Nicodemus's symbols, hyphens
    (r"(?i)/\s*(?=(?:b[rst]df|brf|hcrf|values?|f_?[rt])\b)", " rel "),
    (r"(?i)(?:reflectance|radiance)[ _]factors?", " brf "),
    (r"(?i)(?<![a-z])f[_ ]?r(?![a-z])", " brdf "),
    (r"(?i)(?<![a-z])f[_ ]?t(?![a-z])", " btdf "),
    (r"(?<=\w)\s*[-–]\s*(?=[A-Za-z])", " "),
)
ROLE_OF = {
    frozenset(words.split()): role
    for role, words in (
        *(("theta_i", "i theta"), ("phi_i", "i phi")),
        *(("theta_o", "o theta"), ("phi_o", "o phi")),
        *(("delta_phi", "phi rel"), ("delta_phi", "i o phi")),
        ("wavelength", "lambda"),
    )
}
QUANTITY_OF = {"brdf": "brdf", "btdf": "btdf", "brf": "reflectance_factor"}
IN_VALUES = {"value", "beside", *QUANTITY_OF}
IN_COSINES = IN_VALUES | {"cos", "theta", "o", "*", "x", "·"}
IN_SIGMAS = IN_VALUES | {"u", "rel", "abs", "cos", "o", "*", "x", "·", "×"}

# Wavelengths in nm that a column may be named by.
MIN_NM, MAX_NM = 150, 20_000
WAVELENGTH = re.compile(
    r"(?<![\w.])([0-9]+(?:\.[0-9]+)?)\s*(nm|um|µm|μm)?(?![\w.])", re.IGNORECASE
)

# Coverage of uncertainties: k = 2, 2 sigma, U95, 95 %. Other numbers are asked about.
COVERAGE = re.compile(
    r"(?<![^\W_])k[\s_]*[=:]?[\s_]*(?P<k>[0-9]+(?:[.,][0-9]+)?)(?![.,]?[0-9])"
    r"|(?<![\w.,])(?P<n>[0-9]+(?:[.,][0-9]+)?)[\s*x·×-]*"
    r"(?=(?:σ|sigma|std|stdev|stddev|sd|u)(?![^\W_]))"
    r"|(?<![^\W_])U[\s_]?(?P<U>[0-9.,]+)(?P<U_percent>\s*%)?(?![\w.])"
    r"|(?<![\w.,])(?P<level>[0-9.,]+)(?P<percent>\s*%)",
    re.IGNORECASE,
)
SIGMAS_OF_LEVEL = {
    "68": 1.0, "95": 1.96, "95.45": 2.0, "99": 2.576, "99.7": 3.0, "99.73": 3.0,
}  # fmt: skip


@dataclass(frozen=True)
class Column:
    """Meaning of a column of a table.

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
        By which uncertainties are divided: 2 for an expanded one of k = 2; NaN if the
        name leaves it open, as ``U`` and ``U_90`` do.
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
    """Column of this name, or None if a word in it is unknown."""
    text, coverage, level = _without_coverage(name)
    text, channel = _without_wavelength(text)
    text, unit = _without_unit(text)
    words = _words(text)
    if role := ROLE_OF.get(words):
        return None if channel or coverage else Column(name, role, unit)
    unit = unit or ("%" if re.search(r"(?i)percent|pct", text) else "")
    numbers = {word for word in words if word[0].isdigit()}
    if "u" in words and words - numbers <= IN_SIGMAS:
        expanded = re.search(r"(?i:expanded)|\bU(?![^\W_])", name)
        is_open = numbers or (expanded and not coverage)
        coverage = math.nan if is_open else coverage or 1.0
        kind = "abs" if "abs" in words or unit in ("1/sr", "1/msr", "%/sr") else level
        kind = "rel" if "rel" in words else kind
        return Column(name, "sigma", unit, "", channel, coverage, kind)
    quantities = [QUANTITY_OF[word] for word in words & {*QUANTITY_OF}]
    cosine = {"cos", "brdf"} <= words
    value_units = "", *UNITS_OF["value"]
    known = words <= (IN_COSINES if cosine else IN_VALUES)
    if coverage or not known or len(quantities) > 1 or unit not in value_units:
        return None
    if quantities or "value" in words or (channel and not words):
        quantity = "brdf_cos" if cosine else "".join(quantities)
        return Column(name, "value", unit, quantity, channel)
    return None


def coverage_of(name: str) -> float:
    """Coverage factor in a name, from a factor, a level or a number of sigmas, or 0."""
    return _without_coverage(name)[1]


def unit_of(text: str) -> str:
    """Unit that a text is, as a key of :data:`UNITS`; empty if it is none."""
    bare = re.sub(r"[\s^*·(){}\[\]]", "", text.lower())
    return UNIT_OF.get(bare.replace("⁻¹", "-1").replace("\N{MINUS SIGN}", "-"), "")


def unit_in(name: str) -> str:
    """Unit in a name, as a key of :data:`UNITS`; empty if there is none."""
    return _without_unit(_without_coverage(name)[0])[1]


def _without_coverage(name: str) -> tuple[str, float, str]:
    """Name without its coverage factor, the factor or 0, and "?" beside an unclear %.

    The % of a level in brackets, as in "uncertainty (95 %)", is no unit.
    """
    text = " ".join(name.replace("\ufeff", "").split())
    coverage, unclear = 0.0, ""
    for match in [*COVERAGE.finditer(text)][::-1]:
        level = match["U"] or match["level"]
        number = (level or match["k"] or match["n"]).replace(",", ".")
        if level and number not in SIGMAS_OF_LEVEL:
            continue
        before, after = text[: match.start()], text[match.end() :]
        rest = " U " if match["U"] else " "
        percent = match["U_percent"] or match["percent"]
        if percent and not re.search(r"[\[(]", before):
            rest, unclear = f"{rest}% ", "?"
        text = f"{before}{rest}{after}"
        if not (level and coverage):
            coverage = SIGMAS_OF_LEVEL[number] if level else float(number)
    return text, coverage, unclear


def _without_unit(text: str) -> tuple[str, str]:
    """Name without its unit: in brackets, after a slash, a comma or at the end."""
    found = ""
    for group in re.findall(r"[\[(][^\[\]()]*(?:\([^()]*\)[^\[\]()]*)?[\])]", text):
        words = filter(lambda x: x.strip("[()] "), re.split("[,;]", group))
        parts = [*map(unit_of, words)]
        if all(parts):
            text = text.replace(group, " ", 1).rstrip()
            found = found or "".join(parts[:1])
    for match in re.finditer(r"\s*/\s*|[ _,]+(?:in )?", text) if not found else ():
        end = text[match.end() :]
        if unit_of(end) and (len(end) > 1 or end in "%°"):
            return text[: match.start()], unit_of(end)
    if not found and "%" in text:
        return text.replace("%", " "), "%"
    return text, found


def _words(text: str) -> frozenset[str]:
    """Meanings of the words of a name, and its signs and unknown words as they are."""
    for pattern, phrase in PHRASES:
        text = re.sub(pattern, phrase, text)
    found = re.findall(r"[^\W\d_]+|[0-9][0-9.]*|[^\w\s.,;:=@()\[\]{}]", text.lower())
    meanings = " ".join(MEANING.get(word, word) for word in found)
    words = {*meanings.split()}
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

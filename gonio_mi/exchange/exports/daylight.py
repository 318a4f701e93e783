"""Records of wavelengths as what daylight makes of them: visible, and all sunlight.

As WINDOW does after NFRC 300: the specimen's spectrum is a line between any two of the
wavelengths that were measured, and is read where the table of the light has its own.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import mitsuba as mi
import numpy as np

from ...array_types import Floats, Numbers
from ...errors import SettingError, warn
from ...results.record import XYZ, Record, wavelengths_nm

# Wavelengths that are measured for visible light where none are asked for.
VISIBLE_NM = tuple(range(400, 701, 20))

# Fractions of the illuminant that must at least be within the wavelengths, and may at
# most be between two of them.
MIN_HELD, MAX_GAP = 0.95, 0.5


class Light(NamedTuple):
    """An illuminant: the fraction of it that each wavelength of a table stands for.

    Attributes
    ----------
    name : str
    nm : ndarray, shape (n,)
        Wavelengths in nm, ascending.
    parts : ndarray, shape (n,)
        Their parts of the light; the sum is 1.
    """

    name: str
    nm: Floats
    parts: Floats

    def weights(self, nm: Floats) -> Floats:
        """Weights of values at the measured wavelengths `nm`; their sum is 1.

        Beyond the first and the last wavelength the specimen is what it is there.
        One that comes twice shares its weight.
        """
        known, numbers, times = np.unique(nm, return_inverse=True, return_counts=True)
        lines = [np.interp(self.nm, known, one) for one in np.eye(len(known))]
        weights = np.array(lines) @ self.parts / times
        return np.asarray(weights[numbers], dtype=float)

    def check(self, nm: Floats) -> None:
        """Raise ValueError if wavelengths do not stand for the light."""
        known = np.unique(nm)
        ends = f"from {known[0]:g} to {known[-1]:g} nm"
        within = (self.nm >= known[0]) & (self.nm <= known[-1])
        held = self.parts[within].sum()
        wanted = f"{MIN_HELD:.0%} of {self.name} light"
        if held < MIN_HELD:
            got = f"{held:.1%} {ends}"
            raise SettingError(f"wavelengths must hold at least {wanted}, got {got}")
        between = ~np.isin(self.nm, known)  # measured wavelengths are in no gap
        gaps = np.searchsorted(known, self.nm[between])
        parts = np.bincount(gaps, self.parts[between], len(known) + 1)[1:-1]
        if parts.max(initial=0) > MAX_GAP:
            low, high = known[parts.argmax() :][:2]
            raise SettingError(
                f"wavelengths must leave at most {MAX_GAP:.0%} of {self.name} light "
                f"between two of them, got {parts.max():.1%} between {low:g} and "
                f"{high:g} nm"
            )


def of_daylight(
    records: Sequence[Record], solar: Sequence[Record] = ()
) -> tuple[list[Record], list[Record]]:
    """Records of visible light, and of all sunlight, of records of wavelengths.

    Others are as they are, and have no sunlight but that of `solar`. A warning tells
    of wavelengths that do not stand for sunlight, which is then left out.

    Raises
    ------
    ValueError
        If the wavelengths of `records` do not stand for visible light, or those of
        `solar` for sunlight.
    """
    visible = [lit_by(VISIBLE, record) for record in records]
    as_they_were = all(one is other for one, other in zip(visible, records))
    if solar or as_they_were:
        return visible, [lit_by(SOLAR, record) for record in solar]
    try:
        return visible, [lit_by(SOLAR, record) for record in records]
    except SettingError as error:
        warn(f"the file has no block Solar: {error}")
        return visible, []


def lit_by(light: Light, record: Record) -> Record:
    """Record of one channel, of one of several wavelengths; any other as it is."""
    nm = wavelengths_nm(record.channels)
    if nm is None or len(nm) == 1:
        return record
    light.check(nm)
    return weighted(record, light.weights(nm))


def luminous(record: Record) -> Record:
    """Record of the luminance of R, G and B; any other as it is."""
    return weighted(record, XYZ[1]) if len(record.channels) == 3 else record


def seen(record: Record, illuminant: str = "D65") -> Record:
    """Record of the luminance of several channels; any other as it is.

    Wavelengths are lit by the illuminant, D65 or A; R, G and B are those of D65.
    """
    return lit_by(incandescent() if illuminant == "A" else VISIBLE, luminous(record))


def weighted(record: Record, weights: Floats) -> Record:
    """Record of the weighted sum of all channels.

    Its errors are those of the sums of each batch, and so know that channels share
    their rays.
    """
    tallies = []
    for tally in record.tallies:
        # an emitter may send more of one channel than of another
        came = tally.incident.sum(axis=0, dtype=float)
        parts = weights * came.mean() / np.where(came > 0, came, np.inf)

        def one(array: Numbers, parts: Floats = parts) -> Numbers:
            return array @ parts[:, None]

        tallies.append(tally.of_each_channel(one))
    return replace(record, channels=("Y",), tallies=tuple(tallies))


@cache
def incandescent() -> Light:
    """Illuminant A (ISO/CIE 11664-2) times the photopic observer V."""
    nm = np.arange(380.0, 781)
    parts = np.array(mi.cie1931_xyz(mi.Float(nm.tolist())))[1]
    parts /= nm**5 * np.expm1(1.435e7 / (2848 * nm))
    return Light("visible", nm, parts / parts.sum())


# Illuminant D65 times the photopic observer's V: of each 10 nm from 380 to 780, in per
# cent (ISO 9050:1990, table 1, and EN 410).
_SEEN = """
0 0.0005 0.003 0.0103 0.0352 0.0948 0.2274 0.4192 0.6663 0.985 1.5189 2.1336 3.3491
5.1393 7.0523 8.799 9.4427 9.8077 9.4306 8.6891 7.8994 6.3306 5.3542 4.2491 3.1502
2.0812 1.381 0.807 0.4612 0.2485 0.1255 0.0536 0.0276 0.0146 0.0057 0.0035 0.0021
0.0008 0.0001 0 0
"""

# Direct normal sunlight of air mass 1.5: nm and W/(m2 um), up to the 2500 nm of NFRC
# 300 (ASTM E891-87, table 1, which is ISO 9845-1:1992, table 1, column 2).
_SUN = """
300 0  305 3.4  310 15.6  315 41.1  320 71.2  325 100.2  330 152.4  335 155.6
340 179.4  345 186.7  350 212  360 240.5  370 324  380 362.4  390 381.7  400 556
410 656.3  420 690.8  430 641.9  440 798.5  450 956.6  460 990  470 998
480 1046.1  490 1005.1  500 1026.7  510 1066.7  520 1011.5  530 1084.9  540 1082.4
550 1102.2  570 1087.4  590 1024.3  610 1088.8  630 1062.1  650 1061.7  670 1046.2
690 859.2  710 1002.4  718 816.9  724.4 842.8  740 971  752.5 956.3  757.5 942.2
762.5 524.8  767.5 830.7  780 908.9  800 873.4  816 712
823.7 660.2  831.5 765.5  840 799.8  860 815.2  880 778.3  905 630.4
915 565.2  925 586.4  930 348.1  937 224.2  948 271.4  965 451.2  980 549.7
993.5 630.1  1040 582.9  1070 539.7  1100 366.2  1120 98.1  1130 169.5
1137 118.7  1161 301.9  1180 406.8  1200 375.2  1235 423.6  1290 365.7  1320 223.4
1350 30.1  1395 1.4  1442.5 51.6  1462.5 97  1477 97.3  1497 167.1  1520 239.3
1539 248.8  1558 249.3  1578 222.3  1592 227.3  1610 210.5  1630 224.7  1646 215.9
1678 202.8  1740 158.2  1800 28.6  1860 1.8
1920 1.1  1960 19.7  1985 84.9  2005 25  2035 92.5  2065 56.3
2100 82.7  2148 76.2  2198 66.4  2270 65  2360 57.6  2450 19.8
2494 17
"""


_parts = np.array(_SEEN.split(), dtype=float)
VISIBLE = Light("visible", np.arange(380.0, 781, 10), _parts / _parts.sum())

# Sunlight by the trapezoidal rule.
_nm, _power = np.array(_SUN.split(), dtype=float).reshape(-1, 2).T
_steps = np.diff(_nm, prepend=_nm[0]) + np.diff(_nm, append=_nm[-1])
SOLAR = Light("solar", _nm, _power * _steps / (_power @ _steps))

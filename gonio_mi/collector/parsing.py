"""Subdivisions of the collector hemisphere by name, such as ``projected:30x30``."""

from collections.abc import Callable

from ..errors import SettingError, SettingTypeError, shortened, shown
from .apertures import Apertures
from .borders import Borders
from .equal_steps import (
    EqualAngle,
    EqualProjectedSolidAngle,
    EqualSine,
    EqualSolidAngle,
)
from .hemisphere import Subdivision
from .klems import KLEMS
from .receptors import Receptors
from .shirley_chiu import ShirleyChiu

_KINDS: dict[str, Callable[[int, int], Subdivision]] = {
    kind.name: kind
    for kind in (EqualAngle, EqualSolidAngle, EqualProjectedSolidAngle, EqualSine)
}


def subdivision(text: str | Subdivision) -> Subdivision:
    """Build the subdivision that a name such as ``"projected:30x30"`` describes.

    Parameters
    ----------
    text : str or Subdivision
        ``angle``, ``solid``, ``projected`` or ``sine``, a colon, rings, ``x``, sectors;
        or ``borders:`` and the edges in degrees, ``borders:0,30,90x0,180,360``;
        or ``apertures:`` and cones, see
        :class:`~gonio_mi.collector.apertures.Apertures`; or ``receptors:`` and windows,
        see :class:`~gonio_mi.collector.receptors.Receptors`; or ``klems``,
        ``klems-half`` or ``klems-quarter``, see
        :class:`~gonio_mi.collector.klems.Klems`. A subdivision is returned as it is.
        ``shirley-chiu:16`` are the cells of tensor trees, see
        :class:`~gonio_mi.collector.shirley_chiu.ShirleyChiu`.

    Raises
    ------
    TypeError, ValueError
        If the name is not of that form, or a number is out of range.
    """
    if isinstance(text, Subdivision):
        return text
    form = (
        f"collector must look like projected:30x30 (one of {', '.join(_KINDS)}), "
        "borders:0,30,90x0,180,360, apertures:5@10/0,45/90, or klems"
    )
    if not isinstance(text, str):
        raise SettingTypeError(f"{form}, got {shown(text)}")
    name, _, size = text.partition(":")
    rings, _, sectors = size.partition("x")
    try:
        if name == Borders.name:
            return Borders(_numbers(rings), _numbers(sectors))
        if name in (Apertures.name, Receptors.name):
            return (Apertures if name == Apertures.name else Receptors).parse(size)
    except SettingError as error:
        raise SettingError(shortened(f"collector {shown(text)}: {error}")) from None
    except ValueError:  # of a word that is no number, or lacks one
        raise SettingError(shortened(f"{form}, got {shown(text)}")) from None
    if text in KLEMS:
        return KLEMS[text]
    if name == ShirleyChiu.name and _is_integer(size):
        return ShirleyChiu(int(size))
    if name not in _KINDS or not (_is_integer(rings) and _is_integer(sectors)):
        raise SettingError(f"{form}, got {shown(text)}")
    return _KINDS[name](int(rings), int(sectors))


def _numbers(text: str) -> tuple[float, ...]:
    return tuple(float(word) for word in text.split(","))


def _is_integer(text: str) -> bool:
    return text.removeprefix("-").isascii() and text.removeprefix("-").isdigit()

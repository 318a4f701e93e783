"""Reading reflectances: numbers, colours or textures between 0 and 1."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from ..errors import SettingError, SettingTypeError

__all__ = ["mean", "reflectance"]


def reflectance(props: mi.Properties, name: str, default: float) -> mi.Texture:
    """Return the texture property `name`, whose mean must lie in [0, 1]."""
    try:
        texture = props.get_texture(name, default)
    except RuntimeError:
        texture = None
    label = f"{props.plugin_name()}.{name}"
    if texture is None:
        raise SettingTypeError(
            f"{label} must be a number, a colour or a texture, got {props.get(name)!r}"
        )
    value = mean(texture)
    if not 0 <= value <= 1:
        raise SettingError(f"{label} must be a reflectance from 0 to 1, got {value:g}")
    return texture


def mean(texture: mi.Texture) -> float:
    """Mean of a texture over its surface and channels, as a float."""
    return float(np.mean(np.asarray(texture.mean())))

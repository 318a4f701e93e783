"""What the names of a record's channels say."""

import re
from collections.abc import Sequence

import numpy as np

from ..array_types import Floats

__all__ = ["wavelengths_nm"]


def wavelengths_nm(channels: Sequence[str]) -> Floats | None:
    """Wavelengths of channels such as ``"550nm"``, shape (n,); None for any others."""
    matches = [re.fullmatch(r"([0-9]+(?:\.[0-9]+)?)nm", name) for name in channels]
    found = [match[1] for match in matches if match]
    return np.array(found, dtype=float) if len(found) == len(channels) else None

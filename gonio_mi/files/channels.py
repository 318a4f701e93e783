"""What the names of a record's channels say."""

import re

import numpy as np

__all__ = ["wavelengths_nm"]


def wavelengths_nm(channels):
    """Wavelengths of channels such as ``"550nm"``, shape (n,); None for any others."""
    matches = [re.fullmatch(r"([0-9]+(?:\.[0-9]+)?)nm", name) for name in channels]
    if not all(matches):
        return None
    return np.array([float(match[1]) for match in matches])

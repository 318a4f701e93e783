"""Interpolation of measured lobes between incident directions."""

"""Surfaces: heights, their statistics, micro-normals, masking and shadowing."""

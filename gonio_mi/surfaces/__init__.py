"""Surfaces: height maps, meshes, heights and their statistics."""

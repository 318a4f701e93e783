"""Surfaces made of shape, as arrays of heights."""

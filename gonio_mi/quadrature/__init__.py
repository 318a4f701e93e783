"""Integrals of ``eval`` over the collector's patches, to an error of their own."""

from .integrate import integrate, integrate_each

__all__ = ["integrate", "integrate_each"]

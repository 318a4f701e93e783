"""Integrals of ``eval`` over the collector's patches, to an error of their own."""

from .rule import integrate

__all__ = ["integrate"]

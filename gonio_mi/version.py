"""The version of this package, where the build reads it, too."""

__version__ = "1.0.0rc1"

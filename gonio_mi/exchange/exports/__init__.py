"""Records as files of other programs, some of which need new measurements."""

from ..formats.radiance import Product
from .bsdf_file import bsdf
from .exporting import export
from .loss import Loss

__all__ = ["Loss", "Product", "bsdf", "export"]

"""What a surface says of itself: its micro-normals, its masking and shadowing."""

from .micro_normals import MicroNormals, micro_normals

__all__ = ["MicroNormals", "micro_normals"]

"""Commands of this annex, each a module: bsdf, export."""

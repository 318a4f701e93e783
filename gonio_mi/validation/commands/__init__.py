"""Commands of this annex, each a module: validate, diff, conformance."""

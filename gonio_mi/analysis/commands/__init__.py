"""Commands of this annex, each a module: compare, fit, chart."""

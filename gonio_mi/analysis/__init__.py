"""Conclusions from records: comparison, parameters of models, charts, micro-normals."""

COMMANDS = {
    "quantity": "State gloss, haze, reflectance factors or retroreflection.",
    "compare": "Compare a record with another one or with measured values.",
    "fit": "Find the parameters of a BSDF from a record or a measured table.",
    "chart": "Chart speed against accuracy for a specimen.",
}
PLUGINS: dict[str, str] = {}
OFFERS = {
    "chart_view": "charts.figure",
    "micro_normals": "micro_normals",
    "record_quantity": "quantities.quantity",
    "covariance": "quantities.functionals",
}

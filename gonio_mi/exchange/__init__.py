"""Files of other programs and instruments, and tables of measured values."""

COMMANDS = {
    "bsdf": "Write the BSDF file of a window layer, blind or film.",
    "export": "Write a record for other tools.",
}
PLUGINS: dict[str, str] = {}
OFFERS = {
    "VISIBLE_NM": "exports.daylight",
    "seen": "exports.daylight",
    "export": "exports.exporting",
    "endings_of": "formats.reading",
    "format_of": "formats.reading",
    "has_back": "formats.radiance",
    "load_material": "formats.reading",
    "read_measured": "formats.reading",
}

"""Materials: one Mitsuba BSDF plugin per file, file name = plugin name."""

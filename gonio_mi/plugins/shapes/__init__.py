"""Shapes, one Mitsuba plugin per file; the file's name is the plugin's."""

"""From a record to a BSDF: between its directions, and which ones to measure."""

COMMANDS: dict[str, str] = {}
PLUGINS = {"goniometric": "bsdf"}
OFFERS = {"chosen_directions": "whole_bsdf"}

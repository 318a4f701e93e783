"""A module for each property, named after it; `consistency` asks for several."""

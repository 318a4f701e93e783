"""A module for each property of a verdict, named after it; `consistency` asks several."""

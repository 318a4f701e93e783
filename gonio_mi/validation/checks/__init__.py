"""A module for each property of a verdict, named after it; `agreement` asks several."""

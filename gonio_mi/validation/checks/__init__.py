"""One module for each property of a verdict, named after it."""

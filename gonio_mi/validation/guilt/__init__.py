"""Which function is guilty, and of what: hypotheses that are tried in turn."""

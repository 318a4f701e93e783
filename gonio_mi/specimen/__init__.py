"""The specimen: loaded from a word, file, dict or object, described, tried, hashed."""

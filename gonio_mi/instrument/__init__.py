"""The instrument: loads a specimen, runs batches, returns records; campaigns."""

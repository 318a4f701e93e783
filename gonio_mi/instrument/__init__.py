"""The instrument: set-up, schedule, launcher, and the record of a measurement."""

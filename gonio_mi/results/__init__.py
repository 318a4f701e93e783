"""Results of a measurement: tallies, estimates, statistics, records, ray density."""

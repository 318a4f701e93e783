"""What a measurement gives: tallies, estimates, statistics, records, ray density."""

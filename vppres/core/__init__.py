"""What everything stands on: typed errors, units, read-only arrays, HTML for notebooks."""

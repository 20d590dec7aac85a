"""What studies and benchmarks share: made-up days, runs over seeds, tables and pages."""

"""A first scenario on an imported feeder."""

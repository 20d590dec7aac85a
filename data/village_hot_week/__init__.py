"""Two made-up days on the CIGRE medium-voltage feeder."""

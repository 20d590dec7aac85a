"""OpenDSS circuits: checked, read, and solved again with all phases."""

"""Physical functions that know no scenario run: AC power flow, heating, cold-load pickup."""

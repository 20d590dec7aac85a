"""Forecasts of load and PV power from what was measured, as joint paths, and their scores."""

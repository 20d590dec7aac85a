"""A feeder of 17 real homes: a year of demand and PV power, and what they are connected by."""

"""Simulation of the real day: true demand, batteries, islands, collapse."""

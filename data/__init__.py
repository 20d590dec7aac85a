"""Builders of the packaged scenarios: one folder for each, with the public figures it uses."""

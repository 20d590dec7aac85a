"""Tests of ``vppres.forecasts``."""

"""Tests of ``vppres.scenario``."""

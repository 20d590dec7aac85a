"""Tests of ``vppres.report``."""

"""Tests of ``vppres.cli``."""

"""Tests of ``vppres.physics``."""

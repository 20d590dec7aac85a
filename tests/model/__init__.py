"""Tests of ``vppres.model``."""

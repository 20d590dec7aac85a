"""Tests of ``vppres.day``."""

"""Tests of ``vppres.solve``."""

"""Tests of ``vppres.live``."""

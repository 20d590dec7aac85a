"""Tests of ``vppres.plant``."""

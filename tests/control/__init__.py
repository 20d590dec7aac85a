"""Tests of ``vppres.control``."""

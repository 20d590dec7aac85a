"""Tests of ``vppres.core``."""

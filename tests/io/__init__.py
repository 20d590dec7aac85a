"""Tests of ``vppres.io``."""

"""Tests of ``vppres.explain``."""

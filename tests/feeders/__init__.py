"""Tests of ``vppres.feeders``."""

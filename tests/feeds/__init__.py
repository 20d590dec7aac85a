"""Tests of ``vppres.feeds``."""

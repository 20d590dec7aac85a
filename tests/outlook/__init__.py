"""Tests of ``vppres.outlook``."""

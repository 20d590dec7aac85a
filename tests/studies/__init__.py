"""Tests of ``vppres.studies``."""

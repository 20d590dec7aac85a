"""Tests of ``vppres.service``."""

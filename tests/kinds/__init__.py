"""Tests of kinds of assets and rules."""

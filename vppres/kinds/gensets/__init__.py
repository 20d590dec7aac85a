"""Generating sets, which burn fuel, start and stop, and may form the grid."""

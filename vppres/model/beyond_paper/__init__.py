"""Additions to the paper's problem: losses and islands, switching rules."""

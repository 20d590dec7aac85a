"""Stored plans played again: exports, what happened within a step, explanations."""

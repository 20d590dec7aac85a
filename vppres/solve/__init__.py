"""Solving a window: solvers, statuses, levels of precision, certificates."""

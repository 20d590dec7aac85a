"""Helpers of several test modules: small days, made-up runs, set-points, an independent check."""

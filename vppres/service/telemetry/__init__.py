"""Readings: what is known at a step, what is lost or new, what is learned."""

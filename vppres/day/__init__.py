"""A day in the closed loop, its record and its figures of merit."""

"""Rooms and tanks that a machine cools or heats, within a comfort band."""

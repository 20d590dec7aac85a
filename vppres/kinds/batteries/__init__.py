"""Batteries: powers that they can have, and the charge that these leave."""

"""Probabilities of outages ahead, and what stored energy is worth under them."""

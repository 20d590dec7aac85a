"""What is believed of outages ahead, and what stored energy is worth under it."""

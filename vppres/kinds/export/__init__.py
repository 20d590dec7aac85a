"""Connection to the grid where it takes power back: limit, price, limiter."""

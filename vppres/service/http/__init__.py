"""The service at its address: application, perimeter, connections, and a client of it."""

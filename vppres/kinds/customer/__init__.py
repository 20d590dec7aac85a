"""Customers: switching rules, longest times off, cold load, shares of a demand."""

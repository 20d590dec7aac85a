"""The operator's page, and what it shows."""

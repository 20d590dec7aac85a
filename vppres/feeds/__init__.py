"""Public feeds of outages: what network operators say, as events of the service."""

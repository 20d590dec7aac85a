"""Alarms: conditions, acknowledgements and notifications."""

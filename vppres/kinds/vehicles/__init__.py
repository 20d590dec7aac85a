"""Electric vehicles at chargers, which leave at a time with what they need."""

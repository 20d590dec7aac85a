"""What the day really does with a decision: the true demand, batteries, islands, collapse."""

"""The service step by step: its clockwork, modes, and what an operator asks."""

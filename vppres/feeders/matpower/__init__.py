"""MATPOWER cases: their text, their arithmetic, their tables."""

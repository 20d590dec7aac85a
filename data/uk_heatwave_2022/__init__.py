"""The day of the paper, rebuilt from public figures and the paper's published aggregates."""

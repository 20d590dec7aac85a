"""Studies that the documentation quotes: ``python -m experiments.studies.NAME``."""

"""The paper's figures and tables, reproduced: ``python -m experiments``."""

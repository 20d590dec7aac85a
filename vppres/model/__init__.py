"""The paper's optimisation problem as parametrised cvxpy."""

"""Solving a window: solvers, statuses, levels of precision, certificates."""

# The model loads cvxpy without what nothing here uses.
from vppres.model import cvxpy as cvxpy

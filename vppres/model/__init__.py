"""The paper's optimisation problem as parametrised cvxpy.

cvxpy takes one function of SciPy's statistics, for quantum states, which nothing here uses: loading
them takes a quarter of the time of all imports of a run.
"""

from vppres.core.deferred import deferred

with deferred("scipy.stats", "entropy"):
    import cvxpy as cvxpy

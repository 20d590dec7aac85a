"""Every method and solver on every instance, in one run."""

from __future__ import annotations

import time
from collections.abc import Iterable
from contextlib import closing
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
from joblib import Parallel, delayed, parallel_config
from rich.progress import Progress

from benchmarks.frame.store import Row, Store
from benchmarks.instances import Instance, packaged, window_data
from benchmarks.licensed import ALL_SOLVERS, LICENSED
from vppres.core.errors import SolveError
from vppres.model.numerics import objective_scale
from vppres.model.site import Site
from vppres.solve.cache import ModelCache
from vppres.solve.forms import Form, form_problem
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import SolveLimits, Status
from vppres.solve.selection import Selected, Sheet
from vppres.solve.solvers import run

NOT_ADMITTED = "not_admitted"
FAST_REFUSAL_S = 1.0
LONG_WINDOW_STEPS = 6


@dataclass(frozen=True)
class Method:
    """One way to solve a window."""

    #: The package's default method with all its levels, or one solve of the whole problem.
    approach: str
    solver: str  #: name in the package's table of solvers
    #: Sides of the inverters' polygons in a monolithic solve; 0 is cones. The decomposed method
    #: always answers with true discs.
    sides: int = 0
    max_steps: int = 24  #: longest window that it is tried on

    @property
    def label(self) -> str:
        """Name in tables."""
        if self.approach == "decomposed":
            return f"decomposed/{self.solver}"
        return f"monolithic/{self.solver}/{f'{self.sides}-gon' if self.sides else 'cones'}"


# Other forms than 16-gons are for the licences: cones and squares make smaller problems.
METHODS = (
    Method("decomposed", "highs"),
    Method("decomposed", "scip"),
    *(Method("monolithic", solver, 16) for solver in ("highs", "scip")),
    *(Method("monolithic", solver, 16, 3) for solver in LICENSED),
    *(Method("monolithic", solver, 4, 3) for solver in ("highs", "scip", *LICENSED)),
    *(Method("monolithic", solver, 0, 3) for solver in ("scip", "copt")),
)
BASE = METHODS[0].label


@dataclass(frozen=True)
class Limits:
    """Time limits in s: of a window, and of the monolith beyond six steps, which seldom ends."""

    time_s: float = 60.0
    long_monolith_s: float = 10.0

    def of(self, method: Method, steps: int) -> SolveLimits:
        """Gaps and time limit of one solve."""
        long = method.approach == "monolithic" and steps > LONG_WINDOW_STEPS
        return SolveLimits(time_s=min(self.time_s, self.long_monolith_s) if long else self.time_s)


@dataclass
class Bench:
    """Compiled problems of one process, apart for each method.

    cvxpy keeps one compiled form of a problem: two solvers on one problem would compile it in turn.
    """

    site: Site
    solvers: dict[Method, WindowSolver] = field(default_factory=dict)
    warm: set[tuple[Method, int, str]] = field(default_factory=set)
    models: dict[tuple[Method, int], Selected] = field(default_factory=dict)

    def measure(self, instance: Instance, method: Method, limits: SolveLimits) -> Row:
        """Solve an instance by a method; compilation is not part of ``solve_s``."""
        if method.approach == "decomposed":
            return self._decomposed(instance, method, limits)
        return self._monolithic(instance, method, limits)

    def _decomposed(self, instance: Instance, method: Method, limits: SolveLimits) -> Row:
        """All levels: service, cost, tie-breakers; solved twice where something was compiled."""
        if method not in self.solvers:
            self.solvers[method] = WindowSolver(self.site, "decomposed", method.solver)
            self.solvers[method].cache = ModelCache(self.site)
        solver = self.solvers[method]
        data = window_data(instance)
        solver.limits = limits
        compiled = solver.cache.compilations
        begin = time.perf_counter()
        try:
            answer = solver.solve(data)
            first_s = answer.solve_s
            used = {(method, instance.steps, stage.partition(":")[0]) for stage in answer.stages}
            if solver.cache.compilations > compiled or not used <= self.warm:
                self.warm |= used
                answer = solver.solve(data)
        except SolveError as error:
            return {"status": type(error).__name__, "solve_s": time.perf_counter() - begin}
        return {
            "status": str(answer.status),
            "solve_s": answer.solve_s,
            "compile_s": max(first_s - answer.solve_s, 0.0),
            "value": answer.terms.upper_levels(self.site.weights),
            "bound": answer.bound,
            "gap": answer.gap,
            "gap_abs": answer.gap_abs,
            "cost_gbp": answer.terms.f2,
            "cost_gap_gbp": answer.cost_gap_gbp,
            "curtailed_kwh": answer.terms.f3,
            "v_min_pu": float(answer.dispatch.v_pu[:, 1:].min()),
            "stages": " ".join(answer.stages),
        }

    def _monolithic(self, instance: Instance, method: Method, limits: SolveLimits) -> Row:
        """One solve of service, cost and curtailment as weighted, to the same gap."""
        model = self._model(method, instance.steps)
        spec = ALL_SOLVERS[method.solver]
        data = window_data(instance)
        model.fill(data)
        begin = time.perf_counter()
        model.compile()
        compile_s = time.perf_counter() - begin
        whole = self.site.customers.weight.sum() * self.site.dt_h * instance.steps
        begin = time.perf_counter()
        try:
            outcome = run(
                model,
                spec,
                limits.absolute(whole),
                limits.time_s,
                scale=objective_scale(self.site),
            )
        except Exception as error:  # a licensed solver's own class, which may not be installed
            if method.solver not in LICENSED:
                raise
            return {
                "status": NOT_ADMITTED,
                "solve_s": time.perf_counter() - begin,
                "reason": str(error),
            }
        refused = (
            method.solver in LICENSED
            and outcome.solve_s < FAST_REFUSAL_S
            and outcome.status == Status.NUMERICAL
        )
        return {
            "status": NOT_ADMITTED if refused else str(outcome.status),
            "solve_s": outcome.solve_s,
            "compile_s": compile_s,
            "value": outcome.value,
            "bound": outcome.bound,
            "gap_abs": max(outcome.bound - outcome.value, 0.0),
            "gap": max(outcome.bound - outcome.value, 0.0) / max(abs(outcome.value), 1e-9),
        }

    def _model(self, method: Method, steps: int) -> Selected:
        """The monolithic problem; only the last length of a method is kept, to save memory."""
        if (method, steps) not in self.models:
            self.models = {key: m for key, m in self.models.items() if key[1] == steps}
            form = Form(polygon_sides=method.sides)
            sheet = Sheet(self.site, steps)
            self.models[method, steps] = form_problem(self.site, sheet, form, conic=False)
        return self.models[method, steps]


def installed_methods() -> list[Method]:
    """Methods whose solver is installed."""
    return [method for method in METHODS if ALL_SOLVERS[method.solver].installed]


_BENCH: list[Bench] = []


def measure_all(
    instance: Instance, methods: Iterable[Method], limits: Limits, folder: Path
) -> list[Row]:
    """All methods on one instance, one after the other, so that they share what disturbs them."""
    if not _BENCH:
        _BENCH.append(Bench(Site.of(packaged())))
    rows = []
    for method in methods:
        if instance.steps > method.max_steps:
            continue
        solve = limits.of(method, instance.steps)
        key = {"instance": instance.name, "method": method.label, "limit_s": solve.time_s}
        row = Store(folder).row(key, partial(_BENCH[0].measure, instance, method, solve))
        rows.append(
            {**row, "group": instance.group, "steps": instance.steps, "place": instance.place}
        )
    return rows


def run_windows(
    instances: list[Instance], limits: Limits, folder: Path, processes: int, bar: Progress
) -> pd.DataFrame:
    """One row for each instance and method that is installed; finished rows are not run again."""
    methods = installed_methods()
    # Equal lengths follow each other: a process then keeps few problems compiled.
    ordered = sorted(instances, key=lambda instance: instance.steps)
    task = bar.add_task("windows", total=len(ordered))
    rows: list[Row] = []
    with parallel_config("loky", inner_max_num_threads=1):
        parallel = Parallel(n_jobs=processes, return_as="generator_unordered", batch_size=1)
        work = (delayed(measure_all)(i, methods, limits, folder / "rows") for i in ordered)
        with closing(parallel(work)) as finished:
            for found in finished:
                rows += found
                bar.advance(task)
    table = pd.DataFrame(rows).sort_values(["instance", "method"], ignore_index=True)
    for name in ("value", "bound", "gap", "gap_abs", "solve_s"):
        table[name] = pd.to_numeric(table[name], errors="coerce").fillna(np.nan)
    return table

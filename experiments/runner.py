"""Runs jobs on all cores, keeps every finished day, and goes on where it was interrupted."""

from __future__ import annotations

import builtins
from collections.abc import Iterable, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from joblib import cpu_count

from benchmarks.frame.terminal import bar_of
from experiments.jobs import Job, scenario
from experiments.results import DayResult
from experiments.shorten import shorten
from experiments.weighted import WeightedSolver
from vppres.core.errors import SolveError, SolverLostError
from vppres.day.assembly import make_controller
from vppres.day.simulate import Day, run_day
from vppres.day.trajectory import Trajectory
from vppres.io.atomic import atomic_write_text
from vppres.model.site import Site
from vppres.scenario.scenario import Scenario
from vppres.studies.side_by_side import FailedJob, Where, map_unordered

Results = Mapping[Job, DayResult]


@dataclass(frozen=True)
class Cache:
    """Finished days by the digest of their inputs, one JSON file each."""

    folder: Path

    def get(self, job: Job) -> DayResult | None:
        """The job's result, None if it is yet to be run."""
        file = self._file(job)
        return DayResult.from_json(file.read_text(encoding="utf-8")) if file.is_file() else None

    def put(self, job: Job, result: DayResult) -> None:
        """Keep a result."""
        atomic_write_text(self._file(job), result.to_json())

    def _file(self, job: Job) -> Path:
        return self.folder / f"{job.digest()}.json"


def run_jobs(
    jobs: Iterable[Job], folder: Path, processes: int = -1, scheduler: str | None = None
) -> tuple[dict[Job, DayResult], int]:
    """Results of all jobs, from the cache where it has them.

    Parameters
    ----------
    jobs : iterable of Job
        What to run; repeated jobs are run once.
    folder : Path
        Folder of the cache, made if missing.
    processes : int
        How many at a time; -1 is one for each core that this process may use.
    scheduler : str, optional
        Of the Dask cluster that runs them, in place of this machine.

    Returns
    -------
    dict
        By job, in the order of the jobs.
    int
        How many were not in the cache.

    Raises
    ------
    VppresError
        If a day fails, once the days that finished before it are kept.
    """
    wanted = list(dict.fromkeys(jobs))
    folder.mkdir(parents=True, exist_ok=True)
    cache = Cache(folder)
    known = {job: result for job in wanted if (result := cache.get(job)) is not None}
    missing = sorted((job for job in wanted if job not in known), key=_expected_s, reverse=True)
    for job, result in _compute(missing, cache, Where(processes, scheduler)):
        known[job] = result
    return {job: known[job] for job in wanted}, len(missing)


def processes_for(wanted: int) -> int:
    """How many processes run at a time."""
    return int(cpu_count()) if wanted == -1 else wanted


def simulate(job: Job) -> tuple[Job, DayResult]:
    """Run one job."""
    day = scenario(job.day)
    run = run_day(day, job.options) if job.weighted is None else _weighted(job, day)
    if mistake := _mistake(run):
        raise SolveError(f"{job.text()}: a step fell back for a mistake in the code. {mistake}")
    return job, shorten(run)


def _mistake(run: Trajectory) -> str | None:
    """The first reason of a fallback that is an exception of Python's own, if any.

    The guard answers whatever is raised. A row must not rest on what hides a mistake.
    """
    for reason in run.steps["fallback_reason"]:
        kind = getattr(builtins, str(reason).partition(":")[0], None)
        if isinstance(kind, type) and issubclass(kind, Exception):
            return str(reason)
    return None


def _weighted(job: Job, day: Scenario) -> Trajectory:
    """A day whose windows are each solved by one weighted objective."""
    options = job.options.on(day)

    def make_solver(site: Site) -> WeightedSolver:
        return WeightedSolver(site, options.solver, options.limits, job.weighted)

    return Day(day, options).run(make_controller(day, options, make_solver=make_solver))


def _compute(jobs: list[Job], cache: Cache, where: Where) -> Iterable[tuple[Job, DayResult]]:
    """Run jobs and keep each result as soon as it is there."""
    if not jobs:
        return
    lost = []
    with (
        bar_of("days", len(jobs), sum(map(_expected_s, jobs))) as advance,
        closing(map_unordered(simulate, jobs, where)) as outcomes,
    ):
        for outcome in outcomes:
            advance(1, _expected_s(outcome.job))
            if isinstance(outcome, FailedJob):
                lost.append(f"{outcome.job.text()}: {outcome.reason}")
                continue
            job, result = outcome.result
            cache.put(job, result)
            yield job, result
    if lost:
        raise SolverLostError("Days without a result, all others are kept: " + " ".join(lost))


def _expected_s(job: Job) -> float:
    """Expected time of a job in s, as measured on one core.

    The longest come first, so that no core waits at the end, and the time left follows from it.
    """
    options = job.options
    if job.weighted is not None:
        return 100.0
    if options.controller == "full-horizon":
        return 0.6
    return 0.5 + 0.35 * options.horizon_h

"""Days on a Dask cluster beside loky: the same tables, at what speed, and with a worker killed.

``python -m experiments.studies.cluster --days 100`` wants the extra ``cluster`` and takes two
workers each: loky's, those of a ``LocalCluster``, and two that are started by command line as
``docs/studies.md`` says. It shows that nothing but the place differs, so its days look one hour
ahead only.
"""

from __future__ import annotations

import os
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import pandas as pd
import typer

from benchmarks.pages import markdown_table, write_pages
from benchmarks.terminal import bar_of, plain_errors, show_report
from experiments.report import machine
from experiments.studies.same import NOT_COMPARED
from experiments.studies.seeds import STUDIES, Days, FirstSeed, Results, by_name
from vppres.contract.forecast import ForecastErrors
from vppres.core.parent import command
from vppres.day.metrics import versions
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.io.find import load_scenario
from vppres.studies.side_by_side import FailedJob, Where, map_unordered

WORKERS = 2
BLOCKS = 2
"""Parts in which days are timed, loky and cluster in turn: a machine that gets busy slows both."""

LEAST_SHARE = 0.95
"""Of loky's speed that a cluster must have."""

START_S = 120.0
"""In which workers must have come, on a machine that does other things too."""


@dataclass(frozen=True)
class Pass:
    """Some days at one place."""

    digests: dict[int, str]  #: of all tables of a day, by its seed
    wall_s: float  #: from the first job to the last result
    cpu_s: float  #: time of a processor of all processes together, scheduler and command included
    lost: int  #: days without a result

    def and_then(self, other: Pass) -> Pass:
        """Both together."""
        return Pass(
            self.digests | other.digests,
            self.wall_s + other.wall_s,
            self.cpu_s + other.cpu_s,
            self.lost + other.lost,
        )


def day_digest(seed: int) -> str:
    """Run the packaged day with forecast errors of a seed; a digest of all its tables."""
    # Without any horizon no forecast is wrong, and all days are one.
    options = RunOptions(
        horizon_h=1.0, errors=ForecastErrors(load_alpha_per_h=0.05, pv_alpha_per_h=0.1), seed=seed
    )
    run = run_day(load_scenario("uk-heatwave-2022"), options)
    return tables_digest(run.tables)


def tables_digest(tables: dict[str, pd.DataFrame]) -> str:
    """SHA-256 of tables to the last bit, without what only tells how long something took."""
    found = sha256()
    for name, table in sorted(tables.items()):
        kept = table[[column for column in table if column not in NOT_COMPARED]]
        rows = pd.util.hash_pandas_object(kept, index=False)
        found.update(name.encode() + rows.to_numpy().tobytes())
    return found.hexdigest()


def play(seeds: Sequence[int], where: Where, victim: int | None = None) -> Pass:
    """Run days at a place; a process is killed when a third of them is done.

    Parameters
    ----------
    seeds : sequence of int
        Days.
    where : Where
        The place.
    victim : int, optional
        Number of the process that is killed.
    """
    digests: dict[int, str] = {}
    lost = 0
    begin_s, begin_cpu_s = time.perf_counter(), tree_cpu_s()
    with closing(map_unordered(by_name(day_digest), seeds, where)) as outcomes:
        for outcome in outcomes:
            if isinstance(outcome, FailedJob):
                lost += 1
            else:
                digests[outcome.job] = outcome.result
            if victim is not None and 3 * len(digests) >= len(seeds):
                os.kill(victim, signal.SIGKILL)
                victim = None
    cpu_s = tree_cpu_s() - begin_cpu_s
    return Pass(digests, time.perf_counter() - begin_s, cpu_s, lost)


def tree_cpu_s() -> float:
    """Time of a processor that this process and all that it started have taken so far."""
    import psutil  # type: ignore[import-untyped]  # comes with Dask

    def spent_s(process: Any) -> float:
        try:
            times = process.cpu_times()
        except psutil.NoSuchProcess:
            return 0.0
        return float(times.user + times.system + times.children_user + times.children_system)

    me = psutil.Process()
    return sum(spent_s(process) for process in [me, *me.children(recursive=True)])


# Places.


@contextmanager
def local_cluster() -> Iterator[Where]:
    """A cluster of this process's own, with two worker processes."""
    import dask
    from distributed import LocalCluster

    # On a busy machine a nanny takes longer to start than a local cluster waits.
    with (
        dask.config.set({"distributed.deploy.lost-worker-timeout": "5 minutes"}),
        LocalCluster(
            n_workers=WORKERS, threads_per_worker=1, processes=True, dashboard_address=":0"
        ) as cluster,
    ):
        yield Where(scheduler=cluster.scheduler_address)


@contextmanager
def by_command_line() -> Iterator[Where]:
    """A scheduler and two workers, each started as the documentation says."""
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        file = Path(folder, "cluster.json")

        def start(*words: str) -> None:
            process = subprocess.Popen(
                command("dask", *words, "--scheduler-file", str(file)),
                env={**os.environ, "PYTHONPATH": os.getcwd()},
                cwd=folder,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            stack.callback(process.wait)
            stack.callback(process.terminate)

        start("scheduler", "--port", "0", "--dashboard-address", ":0")
        for _ in range(WORKERS):
            start("worker", "--nthreads", "1")
        due = time.monotonic() + START_S
        while not file.is_file() and time.monotonic() < due:
            time.sleep(0.1)
        yield Where(scheduler=str(file))


def worker_pids(where: Where) -> list[int]:
    """Processes of a cluster's workers, once all of them have come."""
    from distributed import Client

    assert where.scheduler is not None
    place = {"scheduler_file" if "://" not in where.scheduler else "address": where.scheduler}
    with Client(**place, timeout=START_S, set_as_default=False) as client:
        client.wait_for_workers(WORKERS, timeout=START_S)
        return list(client.run(os.getpid).values())


# The study.


def beside_loky(seeds: Sequence[int], where: Where) -> tuple[Pass, Pass]:
    """The same days by loky and on a cluster, in blocks that take turns.

    Both have warmed up before each block: loky replaces processes that had nothing to do for five
    minutes, which a slow machine takes for a block.
    """
    here = Where(WORKERS)
    worker_pids(where)
    warm = [max(seeds) + 1 + n for n in range(2 * WORKERS)]
    size = -(-len(seeds) // BLOCKS)
    passes: dict[Where, Pass] = {}
    for number in range(0, len(seeds), size):
        # A B, B A: what drifts, drifts for both.
        for place in (here, where) if number // size % 2 == 0 else (where, here):
            play(warm, place)
            done = play(seeds[number : number + size], place)
            passes[place] = passes[place].and_then(done) if place in passes else done
    return passes[here], passes[where]


def with_a_worker_killed(seeds: Sequence[int], where: Where) -> Pass:
    """The days on a cluster of which one worker is killed in the middle."""
    return play(seeds, where, victim=worker_pids(where)[0])


def row(name: str, done: Pass, loky: Pass) -> tuple[object, ...]:
    """A row of the report."""
    count = max(len(done.digests), 1)
    equal = sum(done.digests.get(seed) == digest for seed, digest in loky.digests.items())
    return (
        name,
        f"{equal} of {len(loky.digests)}",
        done.lost,
        f"{60.0 * count / done.wall_s:.0f}",
        f"{done.cpu_s / count:.3f}",
    )


def main(days: Days = 100, seed: FirstSeed = 0, results: Results = STUDIES) -> None:
    """Run the same days by loky, on a local cluster, and on workers started by command line."""
    seeds = range(seed, seed + days)
    places = {"LocalCluster": local_cluster, "dask worker": by_command_line}
    rows = []
    shares = {}
    sound = True
    with plain_errors("No results"), bar_of("places", 2 * len(places)) as advance:
        for name, place in places.items():
            with place() as where:
                loky, cluster = beside_loky(seeds, where)
                advance(1)
                killed = with_a_worker_killed(seeds, where)
                advance(1)
            shares[name] = (loky.wall_s / cluster.wall_s, loky.cpu_s / cluster.cpu_s)
            rows += [
                row("loky", loky, loky),
                row(name, cluster, loky),
                row(f"{name}, one worker killed", killed, loky),
            ]
            different = len(set(loky.digests.values())) == days
            sound &= loky.digests == cluster.digests == killed.digests and different
    text = markdown_table(
        ("place", "days equal to loky's", "lost", "days per minute", "s of a processor per day"),
        rows,
    )
    for name, (wall, cpu) in shares.items():
        text += f"\n\n{name}: {wall:.1%} of loky's speed by the wall's clock, {cpu:.1%} by the "
        text += "processor's (all processes together)."
    record = {"rows": rows, "shares": shares, "sound": sound, "versions": versions()}
    page = write_pages(results, "cluster", "Days on a cluster", f"{text}\n\n{machine()}.", record)
    show_report(page)
    if not sound or min(cpu for _, cpu in shares.values()) < LEAST_SHARE:
        raise typer.Exit(1)


if __name__ == "__main__":
    typer.run(main)

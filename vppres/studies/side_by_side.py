"""Jobs side by side: in processes of this machine, or on the machines of a Dask cluster.

``map_unordered`` is the one seam under sweeps, experiments and studies. On this machine joblib's
loky runs the jobs, one thread each. On a cluster every job is a task with a key of its own, so that
a job that is asked for twice is run once, and a job whose worker dies is run again elsewhere.
"""

from __future__ import annotations

import importlib.util
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any, Generic, TypeVar

import joblib

from vppres.core.errors import InputError, Problem, first_line
from vppres.core.parent import end_with, me
from vppres.day.metrics import versions

J = TypeVar("J")
R = TypeVar("R")
C = TypeVar("C")

RETRIES = 2
"""Times that a cluster runs a failed job again before its error counts."""

LOCAL = "local"
"""Scheduler that is started on this machine, and ends with the work."""

PATIENCE_S = 30.0
"""In which a scheduler must answer and have a worker."""


@dataclass(frozen=True)
class Where:
    """Processes or cluster on which jobs run.

    Examples
    --------
    >>> Where(3).count
    3
    """

    #: Jobs at a time on this machine; -1 or nothing is one for each core.
    processes: int | None = None
    #: Address (``tcp://...``) or scheduler file of a Dask cluster, which is then used instead of
    #: joblib; ``local`` starts one on this machine, with as many workers as ``processes`` says.
    scheduler: str | None = None

    @property
    def count(self) -> int:
        """Jobs at a time on this machine."""
        return int(joblib.cpu_count()) if self.processes in (None, -1) else int(self.processes)


@dataclass(frozen=True, eq=False)
class Done(Generic[J, R]):
    """A job and its result."""

    job: J
    result: R


@dataclass(frozen=True, eq=False)
class FailedJob(Generic[J]):
    """A job whose process died each time that it was tried, and what is known of it."""

    job: J
    reason: str


def map_unordered(
    function: Callable[[J], R], jobs: Sequence[J], where: Where | None = None
) -> Generator[Done[J, R] | FailedJob[J], None, None]:
    """Results of all jobs, each as soon as it is there.

    Function and jobs can be pickled. Close the iterator (``contextlib.closing``) to stop what still
    runs. An exception that the function raises ends it and is raised here; a process that dies
    costs no job but its own. A cluster that cannot be reached, or whose workers have other versions
    or several threads, is an InputError.

    Examples
    --------
    >>> [done.result for done in map_unordered(abs, [-3, 2], Where(1))]
    [3, 2]
    """
    where = where or Where()
    if jobs and where.scheduler:
        yield from _on_cluster(function, jobs, where)
    elif jobs:
        yield from _on_this_machine(function, jobs, min(where.count, len(jobs)))


# This machine.


def _on_this_machine(
    function: Callable[[J], R], jobs: Sequence[J], processes: int
) -> Generator[Done[J, R] | FailedJob[J], None, None]:
    """Jobs in loky's processes; where one dies, those that may have killed it go on alone.

    All jobs that were running are lost with it, and which of them is to blame is not known. They
    are among the first that have no result, since jobs are begun in their order.
    """
    left = dict(enumerate(jobs))
    suspects: list[int] = []
    while left:
        numbers = suspects[:1] or list(left)
        try:
            with closing(_loky(function, [left[n] for n in numbers], processes)) as results:
                for position, result in results:
                    yield Done(left.pop(numbers[position]), result)
            suspects = suspects[1:]
        except BrokenProcessPool as error:
            if suspects:
                yield FailedJob(
                    left.pop(suspects.pop(0)), f"Its process died twice. {first_line(error)}"
                )
            else:
                suspects = list(left)[: 2 * processes]


def _loky(
    function: Callable[[J], R], jobs: Sequence[J], processes: int
) -> Generator[tuple[int, R], None, None]:
    """Results with the positions of their jobs; a single process is this one."""
    # One thread each: solvers and linear algebra would only fight for the cores. The processes end
    # with this one, which the system does not see to by itself.
    with joblib.parallel_config(
        "loky", inner_max_num_threads=1, initializer=end_with, initargs=me()
    ):
        parallel = joblib.Parallel(n_jobs=processes, return_as="generator_unordered", batch_size=1)
        work = (joblib.delayed(_numbered)(function, *one) for one in enumerate(jobs))
        # Closing the generator stops the workers, whatever ends the loop.
        with closing(parallel(work)) as results:
            yield from results


def _numbered(function: Callable[[J], R], number: int, job: J) -> tuple[int, R]:
    return number, function(job)


# A cluster.


def _on_cluster(
    function: Callable[[J], R], jobs: Sequence[J], where: Where
) -> Generator[Done[J, R] | FailedJob[J], None, None]:
    """Jobs as tasks of a Dask cluster, keyed by what they depend on.

    With a worker die the tasks that wait on it, and the scheduler gives all of them up after some
    deaths. So those that it gave up go on alone, and the one to blame is found.
    """
    with _client(where) as client:
        from distributed import KilledWorker, as_completed

        expected = identity(_package(function))
        _check_workers(client, expected, _package(function))
        by_key: dict[str, list[J]] = {}
        for job in jobs:
            by_key.setdefault(_key(function, job, expected), []).append(job)

        def submitted(key: str, suffix: str = "") -> Any:
            return client.submit(
                _on_worker,
                function,
                by_key[key][0],
                expected,
                key=key + suffix,
                pure=True,
                retries=RETRIES,
            )

        futures = {key: submitted(key) for key in by_key}
        suspects: list[str] = []
        try:
            for future in as_completed(futures.values(), loop=client.loop):
                error = future.exception()
                if isinstance(error, KilledWorker):
                    suspects.append(future.key)
                elif error is not None:
                    raise error
                else:
                    yield from (Done(job, future.result()) for job in by_key[future.key])
                future.release()
            for key in suspects:
                futures[key] = submitted(key, "-alone")
                error = futures[key].exception()
                if error is not None and not isinstance(error, KilledWorker):
                    raise error
                for job in by_key[key]:
                    if error is None:
                        yield Done(job, futures[key].result())
                    else:
                        yield FailedJob(
                            job, f"Its worker died each time, alone too. {first_line(error)}"
                        )
        finally:
            client.cancel(list(futures.values()))


def _on_worker(function: Callable[[J], R], job: J, expected: dict[str, str | None]) -> R:
    """A job on a worker, which may have come after the versions of the others were compared."""
    odd = _differences(identity(_package(function)), expected)
    if odd:
        raise InputError(_other_versions("a worker", odd))
    return function(job)


@contextmanager
def _client(where: Where) -> Iterator[Any]:
    """A connection to a scheduler: by its address, by its file, or to one that is started here."""
    scheduler = str(where.scheduler)
    if not _dask_is_there():
        raise InputError(
            _problem(
                "scheduler",
                scheduler,
                "needs Dask, which is not installed",
                'Install it: pip install "vppres[cluster]".',
            )
        )
    if scheduler == LOCAL:
        with _local_client(where.count) as client:
            yield client
        return
    from distributed import Client

    place = {"scheduler_file": scheduler} if "://" not in scheduler else {"address": scheduler}
    try:
        if "://" not in scheduler and not Path(scheduler).is_file():
            raise FileNotFoundError("there is no such file")
        client = _within_patience(lambda: Client(**place, timeout=PATIENCE_S, set_as_default=False))
    # Any program may listen there, and a file may hold anything.
    except Exception as error:
        raise InputError(
            _problem(
                "scheduler",
                scheduler,
                f"cannot be reached ({first_line(error)})",
                "Give the address that `dask scheduler` prints (tcp://host:8786), its "
                "--scheduler-file, or local.",
            )
        ) from error
    with client:
        yield client


@contextmanager
def _local_client(workers: int) -> Iterator[Any]:
    """A cluster of this machine's processes, which ends with the work."""
    import dask.config
    from distributed import Client, LocalCluster

    # Workers of a busy machine take longer to begin than Dask waits by itself.
    with (
        dask.config.set({"distributed.deploy.lost-worker-timeout": f"{10.0 * PATIENCE_S:g} s"}),
        LocalCluster(
            n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=None
        ) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        yield client


def _within_patience(connect: Callable[[], C]) -> C:
    """A connection, in the time for it: Dask waits for ever for what is not its scheduler."""
    found: list[C] = []
    failed: list[Exception] = []

    def attempt() -> None:
        try:
            found.append(connect())
        except Exception as error:
            failed.append(error)

    thread = threading.Thread(target=attempt, name="vppres-scheduler", daemon=True)
    thread.start()
    thread.join(2.0 * PATIENCE_S)
    if failed:
        raise failed.pop()
    if not found:
        raise TimeoutError("what listens there does not answer as a Dask scheduler")
    return found[0]


def _dask_is_there() -> bool:
    return importlib.util.find_spec("distributed") is not None


def _check_workers(client: Any, expected: dict[str, str | None], package: str) -> None:
    """Refuse workers with other versions, or with several threads."""
    try:
        client.wait_for_workers(1, timeout=PATIENCE_S)
        found: dict[str, dict[str, str | None]] = client.run(identity, package)
    except TimeoutError as error:
        raise InputError(
            _problem("scheduler", None, "has no worker", "Start some with `dask worker`.")
        ) from error
    except ImportError as error:
        raise InputError(
            _problem(
                "worker", None, f"lacks a module ({error})", "Install the same vppres everywhere."
            )
        ) from error
    problems = [
        _other_versions(name, odd)
        for name, about in found.items()
        if (odd := _differences(about, expected))
    ]
    problems += [
        _problem("worker", name, f"has {count} threads", "Start workers with --nthreads 1.")
        for name, count in client.nthreads().items()
        if count != 1
    ]
    if problems:
        raise InputError(problems)


def identity(package: str = "vppres") -> dict[str, str | None]:
    """Versions of what results depend on, and digests of the sources of vppres and of a package."""
    return {**versions(), **{name: _sources(name) for name in sorted({"vppres", package})}}


@cache
def _sources(package: str) -> str | None:
    """SHA-256 of a package's Python files, None for what is none."""
    spec = importlib.util.find_spec(package) if package != "__main__" else None
    if spec is None or not spec.submodule_search_locations:
        return None
    folder = Path(next(iter(spec.submodule_search_locations)))
    digest = sha256()
    for file in sorted(folder.rglob("*.py")):
        digest.update(file.relative_to(folder).as_posix().encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()[:12]


def _package(function: Callable[..., Any]) -> str:
    """Top-level package of a function, or of what is called with some arguments given."""
    function = getattr(function, "func", function)
    return str(getattr(function, "__module__", None) or "vppres").partition(".")[0]


def _key(function: Callable[[J], R], job: J, expected: dict[str, str | None]) -> str:
    """Name of a job: equal ones have equal results."""
    name = getattr(getattr(function, "func", function), "__name__", "job")
    digest = joblib.hash((function, job, expected), hash_name="sha1")
    return f"{name}-{digest}"


def _differences(found: dict[str, str | None], expected: dict[str, str | None]) -> list[str]:
    """Differences of another installation, in words."""
    return [
        f"{name} {found.get(name)} in place of {wanted}"
        for name, wanted in expected.items()
        if found.get(name) != wanted
    ]


def _other_versions(worker: str, odd: Sequence[str]) -> Problem:
    return _problem(
        "worker",
        worker,
        f"has {', '.join(odd)}",
        "Install the same versions on all machines, and restart it.",
    )


def _problem(field: str, value: str | None, what: str, cure: str) -> Problem:
    return Problem("cluster", what, cure, field=field, value=value)

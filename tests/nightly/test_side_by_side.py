"""Jobs side by side: loky and a Dask cluster give the same; a process that dies costs one job."""

from __future__ import annotations

import os
import signal
import socket
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from benchmarks.frame.seeds import Kept, Span, run_seeds
from vppres.core.errors import InputError, SolveError
from vppres.studies import side_by_side
from vppres.studies.side_by_side import Done, FailedJob, Where, identity, map_unordered

distributed = pytest.importorskip("distributed")
dask = pytest.importorskip("dask")


@dataclass(frozen=True)
class Squared:
    """An outcome of a study."""

    seed: int
    value: float
    words: list[str]


def square(number: int) -> int:
    return number * number


def squared(seed: int) -> Squared:
    """A day that counts how often it was run, in the folder that the environment names."""
    if folder := os.environ.get("RUN_LOG"):
        (Path(folder) / f"{seed}-{os.getpid()}").touch()
    return Squared(seed, float("nan") if seed == 0 else float(seed * seed), [str(seed)])


def deadly(number: int) -> int:
    """The number 3 kills its process, whoever runs it."""
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return number * number


def deadly_once(job: tuple[int, str]) -> int:
    """The number 3 kills its process the first time."""
    number, folder = job
    mark = Path(folder) / "killed"
    if number == 3 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number * number


def refused(number: int) -> int:
    raise SolveError(f"{number} has no dispatch")


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Two worker processes of one thread each, whose nannies replace them.

    On a busy machine that takes longer than the 15 s after which a local cluster gives a nanny up.
    """
    with (
        dask.config.set({"distributed.deploy.lost-worker-timeout": "5 minutes"}),
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0"
        ) as found,
        distributed.Client(found, set_as_default=False) as client,
    ):
        client.wait_for_workers(2)
        yield found


@pytest.fixture(params=["loky", pytest.param("cluster", marks=pytest.mark.nightly)])
def where(request: pytest.FixtureRequest) -> Where:
    if request.param == "loky":
        return Where(2)
    return Where(scheduler=request.getfixturevalue("cluster").scheduler_address)


def results(function: Any, jobs: Any, where: Where) -> tuple[dict[Any, Any], list[Any]]:
    """Results by job, and jobs that were lost."""
    found = {}
    lost = []
    with closing(map_unordered(function, jobs, where)) as outcomes:
        for outcome in outcomes:
            if isinstance(outcome, FailedJob):
                lost.append(outcome)
            else:
                assert isinstance(outcome, Done)
                found[outcome.job] = outcome.result
    return found, lost


@pytest.mark.nightly
def test_every_job_has_its_result(cluster: Any) -> None:
    for where in (Where(1), Where(scheduler=cluster.scheduler_address)):
        assert results(square, range(8), where) == ({n: n * n for n in range(8)}, [])
        assert results(square, [], where) == ({}, [])


def test_a_process_that_is_killed_once_costs_nothing(where: Where, tmp_path: Path) -> None:
    jobs = [(number, str(tmp_path)) for number in range(6)]
    found, lost = results(deadly_once, jobs, where)
    assert [found[job] for job in jobs] == [0, 1, 4, 9, 16, 25]
    assert lost == []


@pytest.mark.nightly
def test_an_error_of_a_job_is_raised_here(cluster: Any) -> None:
    where = Where(scheduler=cluster.scheduler_address)
    with pytest.raises(SolveError, match="has no dispatch"):
        results(refused, [1, 2], where)


@pytest.mark.nightly
def test_a_cluster_of_this_machine_is_started_and_ends() -> None:
    where = Where(2, scheduler="local")
    assert results(square, range(4), where) == ({n: n * n for n in range(4)}, [])


@pytest.mark.nightly
def test_equal_jobs_are_all_answered(cluster: Any) -> None:
    where = Where(scheduler=cluster.scheduler_address)
    with closing(map_unordered(square, [2, 2, 3], where)) as outcomes:
        assert sorted(outcome.result for outcome in outcomes) == [4, 4, 9]


# A study.


def test_a_study_goes_on_where_it_stopped(
    where: Where, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, lost = run_seeds(squared, Span(0, 3), where, tmp_path / "days")
    assert [outcome.seed for outcome in first] == [0, 1, 2]
    assert first[0].value != first[0].value  # NaN comes back as it was
    assert lost == []

    def only_new(function: Any, jobs: list[int], where: Where) -> Any:
        assert jobs == [3]
        yield from map_unordered(function, jobs, where)

    monkeypatch.setattr("benchmarks.frame.seeds.map_unordered", only_new)
    again, _ = run_seeds(squared, Span(0, 4), where, tmp_path / "days")
    assert again[1:] == [Squared(seed, float(seed * seed), [str(seed)]) for seed in (1, 2, 3)]


@pytest.mark.nightly
def test_a_job_that_kills_its_process_costs_no_other(where: Where, tmp_path: Path) -> None:
    found, lost = run_seeds(deadly, Span(2, 3), where, tmp_path)
    assert found == [4, 16]
    (day,) = lost
    assert day.job == 3
    assert day.reason.startswith("Its ") and " died " in day.reason


def test_other_sources_are_another_day(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = Kept(squared, tmp_path)
    kept.put(2, squared(2))
    assert kept.get(2) == squared(2)
    monkeypatch.setattr("benchmarks.frame.seeds.identity", lambda package: {"vppres": "other"})
    assert kept.get(2) is None


# A cluster.


@pytest.mark.nightly
def test_workers_of_other_versions_are_refused(
    cluster: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    mine = {**identity("tests"), "cvxpy": "0.1"}
    monkeypatch.setattr(side_by_side, "identity", lambda package="vppres": mine)
    with pytest.raises(InputError) as caught:
        results(square, [1], Where(scheduler=cluster.scheduler_address))
    # The monkeypatch is ours alone: workers have the function by name.
    assert "in place of 0.1" in str(caught.value)
    assert "Install the same versions on all machines" in str(caught.value)


@pytest.mark.parametrize("scheduler", ["tcp://127.0.0.1:9", "no-such-file.json", "nonsense://x"])
def test_a_scheduler_that_is_not_there_is_refused_by_name(
    scheduler: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(side_by_side, "PATIENCE_S", 1.0)
    with pytest.raises(InputError) as caught:
        results(square, [1], Where(scheduler=scheduler))
    assert f"cluster, scheduler = {scheduler}: cannot be reached" in str(caught.value)
    assert "dask scheduler" in str(caught.value)


def test_who_listens_and_is_no_scheduler_is_refused_by_name(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(side_by_side, "PATIENCE_S", 0.5)
    empty = tmp_path / "scheduler.json"
    empty.write_text("[]", encoding="utf-8")
    with socket.create_server(("127.0.0.1", 0)) as silent:
        for scheduler in (f"tcp://127.0.0.1:{silent.getsockname()[1]}", str(empty)):
            with pytest.raises(InputError, match="cannot be reached"):
                results(square, [1], Where(scheduler=scheduler))


@pytest.mark.nightly
def test_without_dask_it_is_said_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(side_by_side, "_dask_is_there", lambda: False)
    with pytest.raises(InputError, match=r'pip install "vppres\[cluster\]"'):
        results(square, [1], Where(scheduler="tcp://127.0.0.1:9"))

"""One parameter over several values: a run each, in parallel, with a table and a page of all."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

import pandas as pd

from vppres.core.errors import ReportError, SolveError, StorageError, VerificationError
from vppres.core.plain import flattened
from vppres.day.options import RunOptions
from vppres.day.simulate import Progress, run_day
from vppres.io.atomic import RUN_MARK, atomic_folder, atomic_write_text
from vppres.report.key_figures import KEY_FIGURES, OF_TIERS
from vppres.report.run_folder import write_run
from vppres.scenario.scenario import Scenario
from vppres.studies.side_by_side import FailedJob, Where, map_unordered
from vppres.studies.sweep_parameters import Parameter, Value, changed, value_text

_LONGEST_FOLDER = 60  # characters of up to four bytes; a name has at most 255 bytes
SUMMARY_TABLE = "summary.csv"


@dataclass(frozen=True, eq=False)
class Case:
    """One value of the parameter and the run that it means."""

    value: Value
    folder: str
    scenario: Scenario
    options: RunOptions


@dataclass(frozen=True, eq=False)
class SweepRow:
    """Outcome of a case: its run folder below that of the sweep.

    Without a summary the run failed, and the error says why.
    """

    value: Value
    folder: str
    summary: dict[str, Any] | None
    error: str | None


Finish = Callable[[Sequence[SweepRow], Path], None]


def cases_of(
    parameter: Parameter, values: Sequence[Value], scenario: Scenario, options: RunOptions
) -> list[Case]:
    """The runs of a sweep, all of them checked."""
    cases = []
    for value in values:
        day, chosen = changed(parameter, value, scenario, options)
        cases.append(Case(value, folder_name(parameter.name, value), day, chosen))
    return cases


def run_cases(
    cases: Sequence[Case],
    folder: Path,
    where: Where | None = None,
    progress: Progress | None = None,
    finish: Finish | None = None,
) -> list[SweepRow]:
    """Run all cases and write their folders into one, which is whole or absent.

    ``progress`` is called as ``progress(runs done, runs in all)`` after every run, and ``finish``
    as ``finish(outcomes, folder)`` to write more, before the folder takes its name. A run that has
    no answer does not end the others.
    """
    with atomic_folder(folder) as aside:
        outcomes = _outcomes(cases, aside, where or Where(), progress)
        outcome_table(outcomes).to_csv(aside / SUMMARY_TABLE, index=False, lineterminator="\n")
        atomic_write_text(
            aside / RUN_MARK,
            json.dumps(outcome_records(outcomes), indent=2, allow_nan=False) + "\n",
        )
        if finish:
            finish(outcomes, aside)
    return outcomes


def folder_name(parameter: str, value: Value) -> str:
    """The run folder of a value: characters that mean something in paths are replaced.

    A digest keeps names apart that would be the same then, or are too long for a file system.

    >>> folder_name("horizon", 2.0)
    'horizon=2'
    >>> folder_name("tiers.../../x", 0.5)
    'tiers.....x=0.5-acf269ce'
    """
    text = f"{parameter}={value_text(value)}"
    name = "".join(c for c in text if c.isalnum() or c in "._=+-")[:_LONGEST_FOLDER]
    return name if name == text else f"{name}-{sha256(text.encode()).hexdigest()[:8]}"


def run_case(numbered: tuple[int, Case], folder: Path) -> SweepRow:
    """Run one case and write its run folder below ``folder``."""
    _, case = numbered
    try:
        summary = write_run(
            run_day(case.scenario, case.options), folder / case.folder
        )  # many reports: leave out 5 MB of scripts each
    except (SolveError, VerificationError, StorageError, ReportError) as error:
        return SweepRow(case.value, case.folder, None, str(error))
    return SweepRow(case.value, case.folder, summary, None)


def outcome_table(outcomes: Sequence[SweepRow]) -> pd.DataFrame:
    """One row per value: value, folder, error, and the key figures; empty where not defined."""
    rows = []
    for outcome in outcomes:
        figures = flattened(outcome.summary or {})
        keys = [key for key in figures if key in _KEYS or key.startswith(_PREFIXES)]
        rows.append(
            {
                "value": outcome.value,
                "folder": outcome.folder,
                "error": outcome.error,
                **{key: figures[key] for key in keys},
            }
        )
    return pd.DataFrame(rows)


def outcome_records(outcomes: Sequence[SweepRow]) -> dict[str, Any]:
    """The outcomes as JSON can hold them."""
    return {
        "runs": [
            {"value": o.value, "folder": o.folder, "error": o.error, "summary": o.summary}
            for o in outcomes
        ]
    }


_KEYS = tuple(key for key, *_ in KEY_FIGURES)
_PREFIXES = (*(f"{key}." for key, *_ in OF_TIERS), "solve_s.")


def _outcomes(
    cases: Sequence[Case], folder: Path, where: Where, progress: Progress | None
) -> list[SweepRow]:
    found: dict[int, SweepRow] = {}
    # Other machines see the same folder, but may stand somewhere else.
    work = partial(run_case, folder=folder.absolute())
    with closing(map_unordered(work, list(enumerate(cases)), where)) as outcomes:
        for outcome in outcomes:
            position, case = outcome.job
            if isinstance(outcome, FailedJob):
                found[position] = SweepRow(case.value, case.folder, None, outcome.reason)
            else:
                found[position] = outcome.result
            if progress:
                progress(len(found), len(cases))
    return [found[position] for position in range(len(cases))]

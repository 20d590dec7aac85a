"""Two or more runs of the same day side by side: figures, differences, one HTML page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vppres.core.errors import InputError, Problem
from vppres.core.plain import flattened
from vppres.day.metrics import service_by_customer
from vppres.day.trajectory import OPTIONS
from vppres.report.answer import answer
from vppres.report.assumptions import value_words
from vppres.report.clock import Clock
from vppres.report.findings import findings
from vppres.report.finished import FinishedRun, in_zone, read_finished
from vppres.report.key_figures import KEY_FIGURES, OF_TIERS, number
from vppres.report.pages import page
from vppres.report.plots.drawing import RUN_STYLES
from vppres.report.plots.figures import FIGURE_TEXTS, FIGURES
from vppres.report.sections.base import figure_of

COMPARISON_FILE = "comparison.html"
TEMPLATE = "comparison.html.j2"
MAX_RUNS = len(RUN_STYLES)
_TIMES = (
    ("solve_s.total", "Time for all decisions", "s", ".2f"),
    ("solve_s.max", "Longest decision", "s", ".3f"),
)

Runs = Mapping[str, FinishedRun]


@dataclass(frozen=True)
class ComparedFigure:
    """One figure of every run in words, with its unit and format; None where it is not defined.

    The key is that of the summary, nested ones with a dot.
    """

    key: str
    words: str
    unit: str
    form: str
    values: tuple[float | None, ...]

    @property
    def differences(self) -> tuple[float | None, ...]:
        """Each run's value minus that of the first run."""
        first = self.values[0]
        return tuple(
            None if first is None or value is None else value - first for value in self.values
        )

    @property
    def differs(self) -> bool:
        """Whether any run's value is written otherwise than that of the first."""
        return len({value for value, _ in self.texts}) > 1

    @property
    def texts(self) -> list[tuple[str, str]]:
        """Value and signed difference of each run as text."""
        return [
            (number(value, self.form), number(change, f"+{self.form}"))
            for value, change in zip(self.values, self.differences, strict=True)
        ]


def read_runs(folders: Sequence[Path]) -> dict[str, FinishedRun]:
    """Run folders by label: the folder's name, or its path as given where names repeat."""
    problems = _problems_of(folders)
    if problems:
        raise InputError(problems)
    names = Counter(folder.resolve().name for folder in folders)
    runs: dict[str, FinishedRun] = {}
    for folder in folders:
        name = folder.resolve().name
        label = name if names[name] == 1 else str(folder)
        run = read_finished(folder)
        first = next(iter(runs.values()), run)
        # One page has one clock; the steps are the same whatever clock they are read on.
        runs[label] = in_zone(run, first.trajectory.scenario.grid.zone)
    problems = _problems_of_days(list(runs.values()))
    if problems:
        raise InputError(problems)
    return runs


def compared_figures(runs: Runs) -> list[ComparedFigure]:
    """Key figures, served shares of all tiers and solve times of every run."""
    tiers = [
        (f"{key}.{tier}", f"{words}, {tier}", unit, form)
        for key, words, unit, form in OF_TIERS
        for tier in _tiers(runs)
    ]
    flat = [flattened(run.summary) for run in runs.values()]
    rows = [
        ComparedFigure(key, words, unit, form, tuple(summary.get(key) for summary in flat))
        for key, words, unit, form in (*KEY_FIGURES, *tiers, *_TIMES)
    ]
    return [row for row in rows if any(value is not None for value in row.values)]


def differing_options(runs: Runs) -> list[tuple[str, list[str]]]:
    """Options that are not the same in all runs: name in words, and each run's value."""
    options = [
        flattened({**{name: run.summary[name] for name in OPTIONS}, **run.summary["options"]})
        for run in runs.values()
    ]
    names = dict.fromkeys(name for record in options for name in record)
    rows = [
        (name.replace("_", " ").replace(".", ", "), [value_words(r.get(name)) for r in options])
        for name in names
    ]
    return [(words, values) for words, values in rows if len(set(values)) > 1]


def differing_customers(runs: Runs) -> list[dict[str, Any]]:
    """Customers whose hours without supply differ: identifier, tier and each run's hours."""
    hours: dict[tuple[str, str], list[float | None]] = {}
    for position, run in enumerate(runs.values()):
        for row in service_by_customer(run.trajectory).to_dict("records"):
            key = (str(row["id"]), str(row["tier"]))
            hours.setdefault(key, [None] * len(runs))[position] = float(row["unserved_h"])
    return [
        {"id": name, "tier": tier, "unserved_h": values}
        for (name, tier), values in hours.items()
        if len(set(values)) > 1
    ]


def comparison_record(runs: Runs) -> dict[str, Any]:
    """The comparison as JSON can hold it."""
    return {
        "runs": [
            {"label": label, "folder": str(run.folder), "summary": dict(run.summary)}
            for label, run in runs.items()
        ],
        "figures": [
            {
                "key": row.key,
                "words": row.words,
                "unit": row.unit,
                "values": list(row.values),
                "differences": list(row.differences),
            }
            for row in compared_figures(runs)
        ],
        "same_scenario": same_scenario(runs),
    }


def render_comparison(runs: Runs) -> str:
    """The comparison as one HTML page that needs nothing beside it."""
    first = next(iter(runs.values()))
    trajectories = {label: run.trajectory for label, run in runs.items()}
    return page(
        TEMPLATE,
        {
            "title": first.trajectory.scenario.title,
            "runs": runs,
            "figures": [row for row in compared_figures(runs) if row.differs],
            "equal": [row.words for row in compared_figures(runs) if not row.differs],
            "clock_note": Clock.of(first.trajectory).note,
            "options": differing_options(runs),
            "customers": differing_customers(runs),
            "answers": {label: answer(run.trajectory, run.summary) for label, run in runs.items()},
            "findings": {label: findings(run.trajectory) for label, run in runs.items()},
            "same_scenario": same_scenario(runs),
            "images": [
                figure_of(draw(trajectories), FIGURE_TEXTS[name]) for name, draw in FIGURES.items()
            ],
            "number": number,
        },
    )


def same_scenario(runs: Runs) -> bool:
    """Whether all runs had the same input."""
    return len({run.summary["input_digest"] for run in runs.values()}) == 1


def _problems_of(folders: Sequence[Path]) -> list[Problem]:
    """Too few, too many or repeated runs."""
    if len(folders) < 2:
        return [Problem("compare", "needs two runs or more", "Give another run folder.")]
    if len(folders) > MAX_RUNS:
        return [
            Problem(
                "compare",
                f"can tell {MAX_RUNS} runs apart in a figure, and was given {len(folders)}",
                "Leave some out, or compare them in parts.",
            )
        ]
    count = Counter(folder.resolve() for folder in folders)
    return [
        Problem(str(folder), "is given more than once", "Give each run folder once.")
        for folder in dict.fromkeys(folders)
        if count.pop(folder.resolve(), 1) > 1
    ]


def _problems_of_days(runs: Sequence[FinishedRun]) -> list[Problem]:
    """Runs whose steps are not those of the first run: nothing can be laid over each other."""
    grids = [run.trajectory.scenario.grid for run in runs]
    return [
        Problem(
            str(run.folder),
            f"has {grid.n_steps} steps of {grid.step_minutes:g} min from {grid.start}, "
            f"{runs[0].folder} has {grids[0].n_steps} of {grids[0].step_minutes:g} min "
            f"from {grids[0].start}",
            "Compare runs of the same day.",
        )
        for run, grid in zip(runs, grids, strict=True)
        if grid != grids[0]
    ]


def _tiers(runs: Runs) -> list[str]:
    """Tiers of all runs, in the order of the first run that has them."""
    return list(
        dict.fromkeys(tier for run in runs.values() for tier in run.trajectory.scenario.tiers)
    )

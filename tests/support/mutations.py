"""Mutated scenario folders: each is read or refused with reasons, and what is read can be run."""

from __future__ import annotations

import random
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from experiments.studies.random_days import small_day
from vppres.core.errors import InputError, VppresError
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.day.trajectory import Trajectory
from vppres.io import read_scenario, write_scenario
from vppres.scenario.scenario import Scenario

FILES = (
    "scenario.toml", "lines.csv", "customers.csv", "pv.csv", "batteries.csv", "load_kw.csv",
    "pv_kw.csv", "system.csv",
)  # fmt: skip
SNIPPETS = (
    "", ",", "\n", '"', "'", "=", "[", "]", "-", "0", "1e400", "1e308", "-1e308", "1e-300", "nan",
    "inf", "-1", "9" * 400, "é", "\x00", "\x1b[2J", "\r", "\t", " ", "2022-07-19T10:00:00Z",
    "2022-02-30T10:00:00Z", "now", "time", "id", "true", "1_0", "[[outages]]\n", "[time]\n",
    "\u2028", "\u202e", ";", "hospital", "{", "}", "#", "$\\frac{$", "[/x]", "../../x", "<script>",
    "=1+1", "x" * 300, "\ufeff", "1e6", "-0.5", "0.999999999", "٣",
)  # fmt: skip
ROW_EDITS = ("drop", "repeat", "exchange")
MOST_CUT = 12  # characters that a snippet replaces
SLOW_S = 10.0
# Rounding of the plant's arithmetic and of the power flow; readings have fewer digits.
TOLERANCE_SOC = 1e-6
TOLERANCE_PU = 1e-6


@dataclass
class Tally:
    """Count of the changed folders and their verdicts.

    Parameters
    ----------
    accepted, refused : int
        Folders read, and folders refused with reasons.
    tracebacks, broken_runs : list of str
        What must not happen: other exceptions when reading, and runs that failed or lied.
    slowest_s : float
        Longest reading, in seconds of computing.
    runs : dict
        Endings of the runs.
    """

    accepted: int = 0
    refused: int = 0
    tracebacks: list[str] = field(default_factory=list)
    broken_runs: list[str] = field(default_factory=list)
    slowest_s: float = 0.0
    runs: dict[str, int] = field(default_factory=dict)

    def count(self, ending: str) -> None:
        """Count the ending of a run."""
        self.runs[ending] = self.runs.get(ending, 0) + 1

    @property
    def sound(self) -> bool:
        """Whether nothing happened that must not happen."""
        return not self.tracebacks and not self.broken_runs and self.slowest_s <= SLOW_S


def small_folder(folder: Path) -> Path:
    """The folder of a small random day."""
    write_scenario(small_day(np.random.default_rng(1), 1), folder)
    return folder


def mutated(texts: Mapping[str, str], draw: random.Random) -> dict[str, str]:
    """The files of a folder with one to three random edits of characters, cells or rows."""
    edited = dict(texts)
    for _ in range(draw.randint(1, 3)):
        file = draw.choice(FILES)
        edit = draw.choice((_characters, _cell, _cell, _row))
        edited[file] = edit(edited[file], draw)
    return edited


def with_snippet(text: str, at: int, cut: int, snippet: str) -> str:
    """The text with some characters from a place on replaced."""
    return text[:at] + snippet + text[at + cut :]


def with_row(text: str, one: int, other: int, kind: str) -> str:
    """The text with a row dropped, repeated or exchanged with another (``ROW_EDITS``)."""
    rows = text.splitlines(keepends=True)
    if kind == "exchange":
        rows[one], rows[other] = rows[other], rows[one]
    else:
        rows[one : one + 1] = [] if kind == "drop" else [rows[one]] * 2
    return "".join(rows)


def _characters(text: str, draw: random.Random) -> str:
    """Some characters replaced, anywhere."""
    at = draw.randint(0, len(text))
    snippet = draw.choice(SNIPPETS)
    return with_snippet(text, at, draw.randint(0, MOST_CUT), snippet)


def _cell(text: str, draw: random.Random) -> str:
    """One cell, or the value of a key, replaced: numbers mostly by another number."""
    mark = "=" if " = " in text else ","
    rows = text.split("\n")
    row = draw.randrange(len(rows))
    cells = rows[row].split(mark)
    place = draw.randrange(len(cells))
    try:
        value = float(cells[place])
        other = draw.choice(
            (
                value * draw.choice((-1, 0, 0.1, 0.5, 0.9, 1.1, 2, 10, 1e3, 1e9)),
                draw.uniform(0, 2),
                round(value),
            )
        )
        cells[place] = f" {other!r}" if mark == "=" else repr(other)
    except (ValueError, OverflowError):  # no number, or an infinite one
        cells[place] = draw.choice(SNIPPETS)
    rows[row] = mark.join(cells)
    return "\n".join(rows)


def _row(text: str, draw: random.Random) -> str:
    """A row dropped, repeated or exchanged with another."""
    count = len(text.splitlines())
    if not count:
        return text
    one = draw.randrange(count)
    other = draw.randrange(count)
    return with_row(text, one, other, draw.choice(ROW_EDITS))


def read_mutated(source: Path, count: int, seed: int, tally: Tally) -> Iterator[Scenario]:
    """Read mutated copies of a folder; what is accepted comes out."""
    draw = random.Random(seed)
    texts = {file: (source / file).read_text(encoding="utf-8") for file in FILES}
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for _ in range(count):
            for file, text in mutated(texts, draw).items():
                (folder / file).write_text(text, encoding="utf-8", newline="")
            scenario = None
            begin = time.process_time()  # a loaded machine must not count
            try:
                scenario = read_scenario(folder)
            except InputError as error:
                tally.refused += 1
                if not all(
                    getattr(p, "cure", p) and getattr(p, "where", p) for p in error.problems
                ):
                    tally.tracebacks.append(f"no cure: {error}")
            except Exception as error:
                tally.tracebacks.append(f"{type(error).__name__}: {error}")
            tally.slowest_s = max(tally.slowest_s, time.process_time() - begin)
            if scenario is not None:
                tally.accepted += 1
                yield scenario


def run_accepted(scenario: Scenario, mode: str, tally: Tally) -> None:
    """Run a day to its end, and let an independent check look at what it claims."""
    options = RunOptions(horizon_h=3.0, mode=mode)
    try:
        run = run_day(scenario, options)
    except VppresError as error:
        tally.count(type(error).__name__)
        if isinstance(error, InputError):
            return  # refused by name, which is an answer
        tally.broken_runs.append(f"{mode}: {type(error).__name__}: {error}")
    except Exception as error:
        tally.broken_runs.append(f"{mode}: {type(error).__name__}: {error}")
    else:
        claims = refuted(run)
        tally.count("finished")
        tally.broken_runs += [f"{mode}: {claim}" for claim in claims]


def refuted(run: Trajectory) -> list[str]:
    """Claims of a run's record that its own AC power flow, or arithmetic, refutes."""
    net = run.scenario.network
    found = [
        f"{name}.{column} is not finite"
        for name, columns in (
            ("steps", ["p_grid_kw"]),
            ("batteries", ["soc_start", "soc_end"]),
            ("pv", ["curtailed_kw"]),
        )
        for column in columns
        if not np.isfinite(run.tables[name][column].to_numpy(float)).all()
    ]
    found += _voltages_where_there_are_none(run)
    solved = run.steps["fallback"].eq("none").to_numpy()  # a fallback has no objective
    if not np.isfinite(run.steps["objective"].to_numpy(float)[solved]).all():
        found.append("steps.objective is not finite")
    batteries = run.scenario.batteries
    soc = run.batteries["soc_end"].to_numpy(float).reshape(len(run.steps), -1)
    if (soc < batteries.soc_min - TOLERANCE_SOC).any() or (
        soc > batteries.soc_max + TOLERANCE_SOC
    ).any():
        found.append("a state of charge is outside its limits")
    v = run.buses["v_ac_pu"].to_numpy(float).reshape(len(run.steps), -1)
    within = (v.min(axis=1) >= net.v_min_ac_pu - TOLERANCE_PU) & (
        v.max(axis=1) <= net.v_max_ac_pu + TOLERANCE_PU
    )
    if (run.steps["v_within_ac"].to_numpy(bool) & ~within).any():
        found.append("a voltage is said to be within its limits, and is not")
    return found


def _voltages_where_there_are_none(run: Trajectory) -> list[str]:
    """Steps with voltages although the island is dark, or without although it is not."""
    dark = run.steps["dark"].to_numpy(bool)
    by_step = {
        "steps.v_min_ac_pu": run.steps["v_min_ac_pu"].to_numpy(float),
        "steps.v_max_ac_pu": run.steps["v_max_ac_pu"].to_numpy(float),
        "buses.v_ac_pu": run.buses["v_ac_pu"].to_numpy(float).reshape(len(dark), -1).T,
    }
    found = []
    for name, values in by_step.items():
        if not np.isfinite(values[..., ~dark]).all():
            found.append(f"{name} is not finite")
        if not np.isnan(values[..., dark]).all():
            found.append(f"{name} has a value in a dark island")
    if run.steps["dark_reason"].to_numpy(str)[dark].tolist().count(""):
        found.append("a dark island has no reason")
    return found


def study(source: Path, folders: int, runs: int, seed: int = 0) -> Tally:
    """Read many mutated folders, and run some of the accepted ones that differ.

    Parameters
    ----------
    source : Path
        A sound scenario folder.
    folders, runs : int
        How many are read, and how many of the accepted ones are run.
    """
    tally = Tally()
    done = 0
    for scenario in read_mutated(source, folders, seed, tally):
        if done < runs:
            run_accepted(scenario, ("paper", "physical")[done % 2], tally)
            done += 1
    return tally

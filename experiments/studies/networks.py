"""Published networks from import to report: which run, how close to their source, and which do not.

``python -m experiments.studies.networks --folder ../shared/networks --page docs/networks.md``
"""

from __future__ import annotations

import re
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from benchmarks.frame.seeds import STUDIES
from benchmarks.frame.tried import Kept, Only, Page, tried, write_table
from vppres.core.errors import InputError, VppresError
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.feeders import import_network
from vppres.feeders.new.options import NewScenarioOptions, parse_outage
from vppres.feeders.new.scenario import write_new_scenario
from vppres.io.scenario_folder import read_scenario
from vppres.report.run_folder import write_run
from vppres.scenario.source import SourceDeviation

CIRCUIT = re.compile(r"^\s*new\s+(object=)?circuit\.", re.IGNORECASE | re.MULTILINE)
BEGIN, END = "<!-- networks: begin -->", "<!-- networks: end -->"
HEAD = ("network", "buses", "needs", "no load", "as given", "worst hour", "a day")
STEP_MINUTES = 240.0
OUTAGE = "12:00..16:00"
HORIZON_H = 8.0

# Word of an option in a refusal, the argument that it stands for, and how it is written.
CURES: tuple[tuple[str, dict[str, Any], str], ...] = (
    ("--balance", {"balance": True}, "`--balance`"),
    ("--slack", {"slack": "all"}, "`--slack all`"),
    ("--open-loops", {"open_loops": True}, "`--open-loops`"),
)
ACCEPT = "`--accept-deviation`"

PANDAPOWER = {
    "CIGRE MV, all generators": ("create_cigre_network_mv", {"with_der": "all"}),
    "MV Oberrhein": ("mv_oberrhein", {}),
    "Kerber Landnetz Freileitung 1": ("create_kerber_landnetz_freileitung_1", {}),
    "Kerber Landnetz Freileitung 2": ("create_kerber_landnetz_freileitung_2", {}),
    "Kerber Landnetz Kabel 1": ("create_kerber_landnetz_kabel_1", {}),
    "Kerber Landnetz Kabel 2": ("create_kerber_landnetz_kabel_2", {}),
    "Kerber Dorfnetz": ("create_kerber_dorfnetz", {}),
    "Kerber Vorstadtnetz 1": ("create_kerber_vorstadtnetz_kabel_1", {}),
    "Kerber Vorstadtnetz 2": ("create_kerber_vorstadtnetz_kabel_2", {}),
    "Four loads, one feeder": ("panda_four_load_branch", {}),
    "Four loads, branches out": ("four_loads_with_branches_out", {}),
    "Illinois 200": ("case_illinois200", {}),
    "IEEE European LV": ("ieee_european_lv_asymmetric", {}),
}
SIMBENCH = ("1-LV-rural1--0-sw", "1-LV-semiurb4--0-sw", "1-MV-rural--0-sw")


@dataclass(frozen=True)
class Candidate:
    """A network to try, and what makes it."""

    label: str
    make: Callable[[], Any]
    source: Any = None


@dataclass(frozen=True)
class Outcome:
    """How far a network came."""

    label: str  #: the network
    options: tuple[str, ...]  #: what it needed
    buses: int | None  #: buses of the feeder
    #: Largest differences of a voltage from the source's own power flow.
    no_load_pu: float | None
    as_given_pu: float | None
    worst_hour_pu: float | None
    words: str  #: what came out: the share of the demand that was met, or why there is no run
    seconds: float  #: from import to report


def candidates(folder: Path) -> Iterator[Candidate]:
    """The networks of a folder, of pandapower and of SimBench."""
    for file in sorted(folder.glob("opendss/*/*.dss")):
        if re.search(
            r"^\s*new\s+(object=)?circuit\.", file.read_text("utf-8", "replace"), re.I | re.M
        ):
            yield Candidate(file.name, partial(_itself, file))
    for file in sorted(folder.glob("matpower/*.m")):
        yield Candidate(file.name, partial(_itself, file))
    for label, (name, arguments) in PANDAPOWER.items():
        yield Candidate(label, partial(_net, name, arguments))
    for code in SIMBENCH:
        yield Candidate(f"SimBench {code}", partial(_itself, code), "simbench")


def _itself(source: Path | str) -> Path | str:
    return source


def _net(name: str, arguments: dict[str, Any]) -> Any:
    import pandapower.networks as networks

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return getattr(networks, name)(**arguments)


def attempt(candidate: Candidate, folder: Path) -> Outcome:
    """Import, new, run and report; the options that the refusals name are given one by one."""
    start = time.perf_counter()
    chosen: dict[str, Any] = {}
    options: list[str] = []
    accept = False
    state: dict[str, Any] = {}
    while True:
        try:
            words = _run(candidate, folder, chosen, accept, state)
        except InputError as error:
            text = str(error).splitlines()[0]
            cure = next(
                (c for c in CURES if c[0] in text and not c[1].keys() & chosen.keys()), None
            )
            if cure is not None:
                chosen |= cure[1]
                options.append(cure[2])
                continue
            if "--accept-deviation" in text and not accept:
                accept = True
                state["apart"] = text.partition("Causes: ")[2].partition(". Accept")[0]
                options.append(ACCEPT)
                continue
            words = f"no: {text.removeprefix(f'{candidate.label}: ')}"
        except VppresError as error:
            words = f"no: {str(error).splitlines()[0]}"
        known = state.get("deviation", SourceDeviation())
        return Outcome(
            candidate.label,
            tuple(options),
            state.get("buses"),
            known.no_load_pu,
            known.as_given_pu,
            known.worst_hour_pu,
            words,
            time.perf_counter() - start,
        )


def _run(
    candidate: Candidate, folder: Path, chosen: dict[str, Any], accept: bool, state: dict[str, Any]
) -> str:
    """All the way; what is known on it is left in the state."""
    feeder = import_network(candidate.make(), candidate.source, **chosen)
    state["buses"] = feeder.network.n_buses
    rules = NewScenarioOptions(
        step_minutes=STEP_MINUTES,
        outages=(parse_outage(OUTAGE, NewScenarioOptions.start),),
        accept_deviation=accept,
    )
    with tempfile.TemporaryDirectory(dir=folder) as place:
        write_new_scenario(feeder, rules, Path(place) / "scenario")
        scenario = read_scenario(Path(place) / "scenario")
        state["deviation"] = scenario.source.deviation
        options = RunOptions(horizon_h=HORIZON_H, mode=scenario.controller.mode)
        done = run_day(scenario, options)
        write_run(done, Path(place) / "run")
    rows = done.customers[~done.customers["time"].map(_outage_of(done)).astype(bool)]
    met = float((rows["p_load_kw"] * rows["served"]).sum() / rows["p_load_kw"].sum())
    v_min = float(done.steps["v_min_ac_pu"].min())
    causes = f"; apart by {state['apart']}" if "apart" in state else ""
    return f"runs; {met:.0%} of the demand met with grid, lowest voltage {v_min:.3f} pu{causes}"


def _outage_of(done: Any) -> dict[Any, bool]:
    return dict(zip(done.steps["time"], done.steps["outage"], strict=True))


def row_of(outcome: Outcome) -> tuple[str, ...]:
    """An outcome as cells of the table."""
    differences = (outcome.no_load_pu, outcome.as_given_pu, outcome.worst_hour_pu)
    return (
        outcome.label,
        "" if outcome.buses is None else str(outcome.buses),
        ", ".join(outcome.options),
        *("" if value is None else in_pu(value) for value in differences),
        outcome.words.replace("|", "/"),
    )


def in_pu(value: float) -> str:
    """A difference in pu; what is nothing but rounding is said to be."""
    return "< 1e-6" if value < 1e-6 else f"{value:.1g}" if value < 1e-3 else f"{value:.4f}"


def main(
    folder: Annotated[Path, typer.Option(help="Folder of opendss/ and matpower/.")] = Path(
        "../shared/networks"
    ),
    page: Page = None,
    results: Kept = STUDIES,
    only: Only = "",
) -> None:
    """Try all networks, and write the table."""
    kept = results / "networks"

    def shown(outcome: Outcome) -> tuple[str, ...]:
        return (*row_of(outcome), f"{outcome.seconds:.0f} s")

    outcomes = tried(
        candidates(folder), lambda each: attempt(each, kept), Outcome, shown, kept, only
    )
    rows = [row_of(outcome) for outcome in outcomes]
    write_table(HEAD, rows, outcomes, kept, "Published networks", page, (BEGIN, END))


if __name__ == "__main__":
    typer.run(main)

"""The golden set: runs of every mode, kind and door, each written as a folder of tables.

What a change of the inside must leave equal. ``python -m tests.support.golden FOLDER`` writes them, in two
checkouts with the same environment, and ``python -m experiments.studies.same`` compares the two folders to
the last bit. With ``--keep`` their figures are taken for right: ``golden.csv``, for the nightly test.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pandas as pd

from benchmarks.hard import read_hard
from benchmarks.instances import packaged, read_instances, window_data
from tests.support.asgi import Caller
from tests.support.live_service import HERE, client
from tests.support.phased_feeder import CIRCUIT, phased_day
from tests.support.played_service import Here
from vppres.contract.forecast import ForecastErrors
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.day.trajectory import Trajectory
from vppres.explain.day import explain_day
from vppres.io import find_scenario, read_scenario
from vppres.live.controller import Controller
from vppres.live.measurement import Measurement
from vppres.model.site import Site
from vppres.report.run_folder import write_run
from vppres.scenario.scenario import Scenario
from vppres.service.http.client import Answer
from vppres.service.operation.site import Service
from vppres.service.plans.world import World
from vppres.service.simulate import Play, Player
from vppres.solve.ladder import WindowSolver

HEAT_WAVE = "uk-heatwave-2022"
TWO_OUTAGES = "two-outages-cigre-mv"
VILLAGE = "village-hot-week"
ERRORS = ForecastErrors(load_alpha_per_h=0.05, pv_alpha_per_h=0.1)
FIGURES = Path(__file__).with_suffix(".csv")
STEPS_LIVE = 48
PLANNED = ("customers", "batteries", "pv", "buses", "chargers", "thermal_loads", "gensets")
"""Tables of the set-points of a live step."""
KEY_FIGURES = ("resilience", "cost_gbp", "import_kwh")
DECIDED = ("served", "running", "objective")
EVERY = 8
"""Of the benchmark's windows every eighth is golden."""


def site(name: str) -> Scenario:
    """A packaged scenario."""
    return read_scenario(find_scenario(name))


def day(folder: Path, scenario: str, **options: Any) -> None:
    """A day in the closed loop with its reasons."""
    of_folder(explain_day(run_day(site(scenario), RunOptions(**options))), folder)


def of_folder(run: Trajectory, folder: Path) -> None:
    """Tables and figures of a run."""
    write_run(run, folder, figures=False)


def phased(folder: Path) -> None:
    """A day of a small unbalanced feeder that OpenDSS reads."""
    script = folder.parent / "small.dss"
    script.write_text(CIRCUIT, encoding="utf-8")
    run = run_day(phased_day(script), RunOptions(horizon_h=3.0, mode="physical"))
    of_folder(run, folder)


def live(folder: Path) -> None:
    """Set-points of a controller that lacks every third state of charge, and some temperatures."""
    village = site(VILLAGE)
    controller = Controller.of(village, RunOptions(horizon_h=4.0))
    tables: dict[str, list[pd.DataFrame]] = {name: [] for name in PLANNED}
    for t in range(STEPS_LIVE):
        share = 0.2 + 0.1 * (t % 7)
        now = Measurement(
            village.grid.times[t],
            soc=None if t % 3 == 1 else dict.fromkeys(village.batteries.id, share),
            load_kw=dict(zip(village.customers.id, 1.02 * village.load_kw[t], strict=True)),
            grid_limit_kw=float(village.grid_limit_kw[t]),
            indoor_c=dict.fromkeys(village.thermal_loads.id, 20.0 + t % 5) if t % 4 else None,
        )
        plan = controller.step(now)
        for name, rows in tables.items():
            rows.append(getattr(plan, name).reset_index())
    for name, rows in tables.items():
        put(folder, name, pd.concat(rows))


class Heard(Here):
    """A client that keeps the set-points that it was told."""

    def __init__(self, http: Caller) -> None:
        super().__init__(http)
        self.set_points: list[dict[str, Any]] = []

    def ask(self, method: str, path: str, body: Any = None) -> Answer:
        answer = super().ask(method, path, body)
        if path == "/v1/setpoints":
            self.set_points += answer.body["setpoints"]
        return answer


def service(folder: Path) -> None:
    """Set-points that a service publishes on a day whose plant obeys it."""
    scenario = site(HEAT_WAVE)
    run = Service(scenario, replace(HERE, horizon_h=5.0), rehearsal=True)
    with TemporaryDirectory() as state, client(run, state) as http:
        heard = Heard(http)
        Player(World(scenario, run.options), heard, Play(notice_h=6.0)).play()
    put(folder, "set_points", pd.DataFrame(heard.set_points))


def windows(folder: Path) -> None:
    """Status, objective and bound of windows of the benchmark."""
    solver = WindowSolver(Site.of(packaged()))
    found = {one.name: solver.solve(window_data(one)) for one in read_instances()[::EVERY]}
    for hard in read_hard()[::EVERY]:
        found[hard.name] = WindowSolver(hard.window.site).solve(hard.window.data)
    rows = [(name, one.status, one.objective, one.bound) for name, one in found.items()]
    put(folder, "windows", pd.DataFrame(rows, columns=["window", "status", "objective", "bound"]))


def put(folder: Path, name: str, table: pd.DataFrame) -> None:
    """A table of what is no run."""
    folder.mkdir(exist_ok=True)
    table.to_parquet(folder / f"{name}.parquet")


RUNS: dict[str, Callable[[Path], None]] = {
    "mpc": partial(day, scenario=HEAT_WAVE, horizon_h=5.0),
    "full-horizon": partial(day, scenario=HEAT_WAVE, controller="full-horizon"),
    "perfect": partial(day, scenario=HEAT_WAVE, controller="perfect"),
    "physical": partial(day, scenario=HEAT_WAVE, horizon_h=3.0, mode="physical", thermal="exact"),
    "errors": partial(day, scenario=HEAT_WAVE, horizon_h=3.0, errors=ERRORS, seed=3),
    "strict": partial(day, scenario=HEAT_WAVE, horizon_h=3.0, priority="strict"),
    "rotation": partial(day, scenario=HEAT_WAVE, horizon_h=3.0, rotation=0.5, turn_h=2.0),
    "belief": partial(day, scenario=TWO_OUTAGES, horizon_h=4.0, outages="belief"),
    "reserve": partial(day, scenario=HEAT_WAVE, controller="reserve", mode="physical"),
    "two-outages": partial(day, scenario=TWO_OUTAGES, horizon_h=4.0),
    "village": partial(day, scenario=VILLAGE, horizon_h=4.0),
    "phased": phased,
    "live": live,
    "service": service,
    "windows": windows,
}


def figures(folder: Path) -> dict[str, float]:
    """Figures of a run: its key figures, or sums over its tables of decisions."""
    if (summary := folder / "summary.json").exists():
        told = json.loads(summary.read_text(encoding="utf-8"))
        return {name: told[name] for name in KEY_FIGURES if told.get(name) is not None}
    found = {}
    for name in DECIDED:
        for file in sorted(folder.glob("*.parquet")):
            table = pd.read_parquet(file)
            if name in table:
                found[f"{file.stem}.{name}"] = float(table[name].astype(float).sum())
    return found


def main() -> None:
    """Write runs into a folder; with ``--keep`` their sums for the test as well."""
    parser = argparse.ArgumentParser(prog="python -m tests.support.golden")
    parser.add_argument("folder", type=Path)
    parser.add_argument(
        "--keep", action="store_true", help="take the figures of all runs for right"
    )
    parser.add_argument("runs", nargs="*", metavar="RUN", help=f"of {', '.join(RUNS)}")
    asked = parser.parse_args()
    asked.folder.mkdir(parents=True, exist_ok=True)
    for name in asked.runs or RUNS:
        if not (asked.folder / name).exists():
            RUNS[name](asked.folder / name)
    if asked.keep:
        found = {name: figures(asked.folder / name) for name in RUNS}
        pd.DataFrame(found).rename_axis("figure").T.rename_axis("run").to_csv(FIGURES)


if __name__ == "__main__":
    main()

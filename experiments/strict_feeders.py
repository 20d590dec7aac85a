"""Strict priority on foreign feeders: ``python -m experiments.strict_feeders``.

Each feeder of pandapower gets drawn tiers, sized PV and batteries, and an outage of six hours. Each
customer off supply whose demand lower tiers would have left energy and power for is solved for
again: the window of its step from the recorded state, that customer before all others. The
inversion could have been avoided if that plan supplies more of its tier, and no less of those
above.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import typer

from benchmarks.pages import markdown_table, write_pages
from experiments.seeds import PATIENT, STUDIES, Results
from vppres import new_scenario
from vppres.control.converged import ConvergedPlanner
from vppres.core.errors import VppresError
from vppres.day.inversions import Inversion, inversions
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.day.trajectory import Trajectory
from vppres.explain.recorded import Recorded
from vppres.feeders import import_network
from vppres.feeders.new.options import NewScenarioOptions, parse_outage
from vppres.solve.ladder import WindowSolver

OUTAGE = "12:00..18:00"
NETS: dict[str, dict[str, Any]] = {
    "create_cigre_network_mv": {"with_der": "all"},
    "create_cigre_network_lv": {},
    "create_kerber_landnetz_freileitung_1": {},
    "create_kerber_landnetz_freileitung_2": {},
    "create_kerber_landnetz_kabel_1": {},
    "create_kerber_landnetz_kabel_2": {},
    "create_kerber_dorfnetz": {},
    "create_kerber_vorstadtnetz_kabel_1": {},
    "create_kerber_vorstadtnetz_kabel_2": {},
    "mv_oberrhein": {},
    "panda_four_load_branch": {},
    "four_loads_with_branches_out": {},
    "simple_four_bus_system": {},
    "example_simple": {},
    "case_illinois200": {},
}
NAMED = ("case33bw", "case69", "cigre-mv")
DICKERT = (
    ("short", "cable", "multiple", "good"),
    ("short", "cable", "multiple", "average"),
    ("short", "cable", "multiple", "bad"),
    ("short", "cable", "single", "good"),
    ("middle", "cable", "multiple", "good"),
    ("middle", "cable", "multiple", "average"),
    ("middle", "cable", "multiple", "bad"),
    ("middle", "C&OHL", "multiple", "good"),
    ("middle", "C&OHL", "multiple", "average"),
    ("middle", "C&OHL", "multiple", "bad"),
    ("long", "cable", "multiple", "good"),
    ("long", "C&OHL", "multiple", "good"),
)
CURES: dict[str, dict[str, Any]] = {
    "--open-loops": {"open_loops": True},
    "--slack": {"slack": "all"},
    "--balance": {"balance": True},
}


@dataclass(frozen=True)
class Outcome:
    """What became of a feeder."""

    feeder: str
    customers: int
    first_tier: float
    off: int
    inversions: int
    avoidable: int
    gap: str
    seconds: float
    words: str = ""


def sources() -> Iterator[tuple[str, Callable[[], Any]]]:
    """Labels, and what makes the net or its name."""
    for name in NAMED:
        yield name, partial(str, name)
    for name, arguments in NETS.items():
        yield name, partial(_net, name, **arguments)
    for length, line, customer, case in DICKERT:
        arguments = {
            "feeders_range": length,
            "linetype": line,
            "customer": customer,
            "case": case,
        }
        label = f"dickert {length} {line} {customer} {case}"
        yield label, partial(_net, "create_dickert_lv_network", **arguments)


def _net(name: str, **arguments: Any) -> Any:
    import pandapower.networks as networks

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return getattr(networks, name)(**arguments)


def play(source: Callable[[], Any], seed: int) -> Trajectory:
    """A day of a feeder in strict order."""
    chosen: dict[str, Any] = {}
    while True:
        try:
            feeder = import_network(source(), **chosen)
            break
        except VppresError as error:
            text = str(error).splitlines()[0]
            cure = next((CURES[word] for word in CURES if word in text), None)
            if cure is None or cure.keys() <= chosen.keys():
                raise
            chosen |= cure
    options = NewScenarioOptions(
        draw_tiers=True,
        seed=seed,
        pv="sized",
        add_batteries=True,
        outages=(parse_outage(OUTAGE, NewScenarioOptions.start),),
        accept_deviation=True,
    )
    return run_day(new_scenario(feeder, options), RunOptions(seed=seed, limits=PATIENT))


def avoidable(run: Trajectory, one: Inversion) -> bool:
    """Whether a plan with that customer before all others supplies more of its tier.

    It must supply no less of the tiers above than the plan of the run did.
    """
    recorded = Recorded(run)
    ranks = recorded.site.ranks
    assert ranks is not None
    weight = recorded.site.customers.weight.copy()
    weight[one.customer] = weight.sum() * run.scenario.grid.n_steps
    first = replace(
        recorded.site, customers=replace(recorded.site.customers, weight=weight), ranks=None
    )
    planner = ConvergedPlanner(WindowSolver(first, limits=PATIENT), float(run.options["headroom"]))
    try:
        plan = planner.plan(recorded.observation(one.t)).dispatch
    except VppresError:
        return False
    upto = int(ranks.tier[one.customer]) + 1
    levels = str(run.steps["levels"].iloc[one.t]).split(", ")
    before = [int(level.rsplit(" ", 1)[1].split("/")[0]) for level in levels]
    after = ranks.supplied(plan.served).tolist()
    return bool(plan.served[0, one.customer]) and after[:upto] > before[:upto]


def outcome(label: str, source: Callable[[], Any], seed: int) -> Outcome:
    """A feeder from its source to the re-solves."""
    begin = time.process_time()
    try:
        run = play(source, seed)
    except (VppresError, ValueError) as error:  # a net that pandapower does not have
        words = str(error).splitlines()[0]
        return Outcome(label, 0, float("nan"), 0, 0, 0, "", time.process_time() - begin, words)
    found = inversions(run)
    out = run.customers["time"].isin(run.steps.loc[run.steps["outage"], "time"])
    first = run.customers["tier"] == run.scenario.tiers[0]
    return Outcome(
        feeder=label,
        customers=len(run.scenario.customers),
        first_tier=float(run.customers.loc[out & first, "served"].mean()),
        off=int((~run.customers.loc[out, "served"].astype(bool)).sum()),
        inversions=len(found),
        avoidable=sum(avoidable(run, one) for one in found),
        gap=_open_levels(run),
        seconds=time.process_time() - begin,
    )


def _open_levels(run: Trajectory) -> str:
    """Steps in which a level's bound and supply differ, and the largest difference."""
    gaps = []
    for text in run.steps["levels"]:
        pairs = [level.rsplit(" ", 1)[1].split("/") for level in str(text).split(", ") if level]
        gaps.append(max((int(most) - int(units) for units, most in pairs), default=0))
    steps = sum(gap > 0 for gap in gaps)
    return f"{steps} steps, at most {max(gaps)}" if steps else "none"


def main(results: Results = STUDIES, seed: int = 0, only: str = "") -> None:
    """Strict priority on the feeders of pandapower: inversions, and whether they are avoidable."""
    rows = []
    for label, source in sources():
        if only in label:
            rows.append(outcome(label, source, seed))
            typer.echo(rows[-1])
    page = write_table(results, rows)
    typer.echo(page.read_text(encoding="utf-8"))
    raise typer.Exit(int(any(row.avoidable for row in rows)))


def write_table(results: Path, rows: list[Outcome]) -> Path:
    """The table of the feeders as pages."""
    head = ("feeder", "customers", "first tier", "off", "inversions", "avoidable", "open levels")
    text = markdown_table(
        head,
        [
            (
                row.feeder,
                str(row.customers),
                f"{row.first_tier:.1%}",
                str(row.off),
                str(row.inversions),
                str(row.avoidable),
                row.words or row.gap,
            )
            for row in rows
        ],
    )
    record = {"feeders": [asdict(row) for row in rows]}
    return write_pages(
        results, "strict_feeders", "Strict priority on foreign feeders", text, record
    )


if __name__ == "__main__":
    typer.run(main)

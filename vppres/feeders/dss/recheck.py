"""A run's set-points on the original, unbalanced feeder: voltages per phase beside the plan's.

The circuit is built from the script as it was written, in the process that reads such files. What
was served, fed in, charged and discharged (vehicles, machines and sets too) is set in every step,
and OpenDSS solves it. Regulators stay at the taps that they find with the loads of the file, as in
the plan.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats
from vppres.core.errors import InputError
from vppres.core.text import named
from vppres.feeders.dss import text as dss_text
from vppres.feeders.dss.circuit import located, read_opendss
from vppres.feeders.net.changes import Changes, changed
from vppres.feeders.net.reduce import feeder_of
from vppres.feeders.strangers.confined import TIME_LIMIT_S, confined
from vppres.scenario.network import BusId

PHASE_NAMES = {"1": "a", "2": "b", "3": "c"}
STEPS_PER_S = 10.0
"""Steps that OpenDSS is given a second for, beside the time to read the file."""

SMALL_PU = 0.005
"""Differences below it need no cause."""


# Tables of a finished run by name, as `Trajectory.tables`.
Tables = Mapping[str, pd.DataFrame]


@dataclass(frozen=True, eq=False)
class Recheck:
    """What the original feeder says to a run.

    Parameters
    ----------
    voltages : DataFrame
        ``time``, ``outage``, ``bus`` (of the source), ``phase``, ``v_pu`` (of the source),
        ``v_plan_pu`` (of the run's AC power flow) and ``difference_pu``, the former less the
        latter; empty where either has no voltage.
    steps : DataFrame
        ``time``, ``outage``, ``import_kw`` of the source, ``import_plan_kw`` and
        ``difference_max_pu``.
    cause : str
        Where the largest difference with grid comes from, measured.
    notes : tuple of str
        What the comparison assumes.
    """

    voltages: pd.DataFrame
    steps: pd.DataFrame
    cause: str
    notes: tuple[str, ...]

    @property
    def worst(self) -> pd.Series[Any] | None:
        """The row of the largest difference in steps with grid; None without any."""
        return _worst(self.voltages)

    def by_phase(self) -> pd.DataFrame:
        """Of each phase in steps with grid: largest and mean difference, lowest voltages."""
        with_grid = self.voltages[~self.voltages["outage"]]
        return with_grid.groupby("phase").agg(
            buses=("bus", "nunique"),
            difference_max_pu=("difference_pu", lambda d: d.abs().max()),
            difference_mean_pu=("difference_pu", lambda d: d.abs().mean()),
            v_min_pu=("v_pu", "min"),
            v_min_plan_pu=("v_plan_pu", "min"),
        )


def recheck_opendss(
    run: Tables, source: Path, island_bus: BusId | None = None, opened: Sequence[BusId] = ()
) -> Recheck:
    """Solve the steps of a run on the circuit of an OpenDSS script.

    Parameters
    ----------
    run : mapping of DataFrame
        Tables of a finished run, of a scenario that was made from the script.
    source : Path
        The script.
    island_bus : int or str, optional
        Bus of the battery that holds the voltage without the grid; in those steps a source stands
        there with the plan's voltage. Without it the circuit's own source holds islands too.
    opened : sequence of int or str, optional
        Buses whose capacitors are off in islands.

    Returns
    -------
    Recheck

    Raises
    ------
    InputError
        If the script cannot be read, or has no load where the run has a customer.
    """
    if source.suffix.lower() != ".dss":
        raise InputError.of(
            source.name,
            "is not a .dss file",
            "Recheck reads OpenDSS; into a pandapower net Trajectory.apply_to puts each step.",
        )
    script = dss_text.read_script(source)
    group_of = _groups(source)
    job = {
        "commands": [command.text for command in script.commands],
        "group_of": group_of,
        "steps": _steps(run, island_bus),
        "island_bus": None if island_bus is None else str(island_bus),
        "open": [str(bus) for bus in opened],
        "constant_power": False,
    }
    found = solved_steps("dss/day", job, script, source.name)
    _check_loads(run, found["nominal_kw"], source.name)
    voltages = _voltages(run, found, group_of)
    steps = step_table(run, found, voltages)
    stiff = solved_steps("dss/day", {**job, "constant_power": True}, script, source.name)
    cause = _cause(voltages, _voltages(run, stiff, group_of))
    return Recheck(voltages, steps, cause, tuple(_notes(found, steps, voltages, island_bus)))


def _groups(source: Path) -> dict[str, str]:
    """The feeder's bus for each bus of the circuit that has supply, both as words."""
    net, ids, *_ = read_opendss(source)
    # Which line opens a loop says nothing of which buses are one.
    net, _ = changed(net, source.name, Changes(open_loops=True), ids)
    bus_of = feeder_of(net, source.name, bus_ids=ids).bus_of
    return {str(ids[i]): str(bus) for i, bus in bus_of.items()}


def solved_steps(
    engine: str, job: dict[str, Any], script: dss_text.Script, name: str
) -> dict[str, Any]:
    """The answer of an engine to a job with steps; what is wrong with the script is raised."""
    limit_s = TIME_LIMIT_S + len(job["steps"]) / STEPS_PER_S
    found = confined(engine, job, name, limit_s)
    if found["problems"]:
        raise InputError([located(problem, script, name) for problem in found["problems"]])
    return found


def _steps(run: Tables, island_bus: BusId | None) -> list[dict[str, Any]]:
    """Demand that is served and power that is fed in, by bus, of every step."""
    customers, pv, batteries = run["customers"], run["pv"], run["batteries"]
    served = customers.get("share", customers["served"]).astype(float)
    load = _by_bus(customers, customers["p_load_kw"] * served, customers["q_load_kvar"] * served)
    fed = _by_bus(pv, pv["self_kw"] + pv["export_kw"], pv["q_kvar"])
    discharged_kw = batteries["discharge_kw"] - batteries["charge_kw"]
    stored = _by_bus(batteries, discharged_kw, batteries["q_kvar"])
    given = [fed, stored]
    for name, sign in (("vehicles", -1.0), ("thermal_loads", -1.0), ("gensets", 1.0)):
        if name in run:
            p_kw = run[name]["p_kw"]
            given.append(_by_bus(run[name], sign * p_kw, 0.0 * p_kw))
    feed = pd.concat(given).groupby(level=["time", "bus"]).sum()
    held = _held(run, island_bus)
    return [
        {"load": _at(load, time), "feed": _at(feed, time), "held_pu": held.get(time)}
        for time in run["steps"]["time"]
    ]


def _held(run: Tables, island_bus: BusId | None) -> dict[Any, float]:
    """Voltage that the plan has at the island's bus, of the steps without grid that have one."""
    outages = run["steps"].loc[run["steps"]["outage"].astype(bool), "time"]
    buses = run["buses"][run["buses"]["bus"].astype(str) == str(island_bus)]
    v_pu = buses.set_index("time")["v_ac_pu"].reindex(outages).dropna()
    return {time: float(value) for time, value in v_pu.items()}


def _by_bus(table: pd.DataFrame, p_kw: pd.Series[float], q_kvar: pd.Series[float]) -> pd.DataFrame:
    """Powers by time and bus, the latter as a word."""
    frame = pd.DataFrame(
        {"time": table["time"], "bus": table["bus"].astype(str), "p": p_kw, "q": q_kvar}
    )
    return frame.groupby(["time", "bus"])[["p", "q"]].sum()


def _at(powers: pd.DataFrame, time: pd.Timestamp) -> dict[str, tuple[float, float]]:
    """Active and reactive power by bus, of one step."""
    if time not in powers.index.get_level_values("time"):
        return {}
    step = powers.xs(time, level="time")
    return {
        str(bus): (float(p), float(q))
        for bus, p, q in zip(step.index, step["p"], step["q"], strict=True)
    }


def _check_loads(run: Tables, nominal_kw: Mapping[str, float], name: str) -> None:
    """Every customer needs loads to stand for it."""
    missing = sorted({str(bus) for bus in run["customers"]["bus"]} - {*nominal_kw})
    if missing:
        raise InputError.of(
            name,
            f"has no load at the buses of {len(missing)} customers: bus {named(missing)}",
            "Give the file that the run's scenario was made from.",
        )


def _voltages(run: Tables, found: dict[str, Any], group_of: Mapping[str, str]) -> pd.DataFrame:
    """Voltages of both, step by step and node by node."""
    nodes = [node.lower().rpartition(".") for node in found["nodes"]]
    kept = [i for i, (bus, _, node) in enumerate(nodes) if node in PHASE_NAMES and bus in group_of]
    plan = run["buses"].assign(bus=run["buses"]["bus"].astype(str))
    plan = plan.pivot_table(index="time", columns="bus", values="v_ac_pu", dropna=False)
    buses = [group_of[nodes[i][0]] for i in kept]
    v_plan_pu = plan.reindex(index=run["steps"]["time"], columns=buses).to_numpy(float)
    lost = [np.nan] * len(nodes)
    v_pu = np.array([lost if step["v_pu"] is None else step["v_pu"] for step in found["steps"]])
    labels = [(nodes[i][0], PHASE_NAMES[nodes[i][2]]) for i in kept]
    # A feeder that is blacked out in the plan has no voltage, whatever stands in for its source.
    dark = run["steps"]["outage"].to_numpy(bool)[:, None] & np.isnan(v_plan_pu)
    return side_by_side(run, labels, np.where(dark, np.nan, v_pu[:, kept]), v_plan_pu)


def side_by_side(
    run: Tables, labels: Sequence[tuple[str, str]], v_pu: Floats, v_plan_pu: Floats
) -> pd.DataFrame:
    """Voltages of the source and of the plan by step, (T, m), with bus and phase of each."""
    steps = run["steps"]
    return pd.DataFrame(
        {
            "time": steps["time"].repeat(len(labels)).array,
            "outage": steps["outage"].to_numpy(bool).repeat(len(labels)),
            "bus": [bus for bus, _ in labels] * len(steps),
            "phase": [phase for _, phase in labels] * len(steps),
            "v_pu": v_pu.ravel(),
            "v_plan_pu": v_plan_pu.ravel(),
            "difference_pu": (v_pu - v_plan_pu).ravel(),
        }
    )


def step_table(run: Tables, found: dict[str, Any], voltages: pd.DataFrame) -> pd.DataFrame:
    """Import of both and the largest difference, by step."""
    largest = voltages["difference_pu"].abs().groupby(voltages["time"]).max()
    imported = [np.nan if s["import_kw"] is None else s["import_kw"] for s in found["steps"]]
    return pd.DataFrame(
        {
            "time": run["steps"]["time"].to_numpy(),
            "outage": run["steps"]["outage"].to_numpy(bool),
            "import_kw": np.array(imported, dtype=float),
            "import_plan_kw": run["steps"]["p_grid_kw"].to_numpy(float),
            "difference_max_pu": largest.reindex(run["steps"]["time"]).to_numpy(),
        }
    )


def _worst(voltages: pd.DataFrame) -> pd.Series[Any] | None:
    """The row of the largest difference in steps with grid; None without any."""
    apart = voltages["difference_pu"].abs().where(~voltages["outage"])
    return voltages.iloc[int(np.nanargmax(apart))] if apart.notna().any() else None


def _cause(voltages: pd.DataFrame, stiff: pd.DataFrame) -> str:
    """Where the largest difference with grid comes from.

    The mean of a bus's phases, less the plan, is what the balanced model misses; a phase less the
    mean is unbalance. A bus without all three phases has no such mean.
    """
    worst = _worst(voltages)
    if worst is None:
        return "No step with grid has voltages on both sides."
    if abs(worst["difference_pu"]) < SMALL_PU:
        return f"All differences are below {SMALL_PU:g} pu."
    at = (voltages["time"] == worst["time"]) & (voltages["bus"] == worst["bus"])
    phases = voltages[at]
    if len(phases) < len(PHASE_NAMES):
        return (
            f"Bus {worst['bus']} has {len(phases)} of three phases: what the plan spreads over "
            "three flows there in the conductors that are present."
        )
    mean = float(phases["difference_pu"].mean())
    apart = float(worst["difference_pu"]) - mean
    same = stiff[at]["difference_pu"].mean()
    words = (
        f"At this bus the mean of the phases differs by {mean:+.4f} pu from the plan, and phase "
        f"{worst['phase']} by {apart:+.4f} pu from the mean: "
    )
    if abs(apart) >= abs(mean):
        return words + "the unbalance of loads and lines, which the plan does not know."
    if abs(same) < abs(mean) / 2:
        return words + (
            "loads that follow the voltage; with all of them as constant power the mean differs "
            f"by {same:+.4f} pu."
        )
    return words + (
        "what the balanced equivalent leaves out or averages, as the notes of the import say; with "
        f"all loads as constant power the mean differs by {same:+.4f} pu."
    )


def _notes(
    found: dict[str, Any], steps: pd.DataFrame, voltages: pd.DataFrame, island_bus: BusId | None
) -> Iterator[str]:
    """What the comparison assumes."""
    yield (
        "Regulators and capacitors stay as OpenDSS's controls leave them with the loads of the "
        "file, as in the plan."
    )
    if found["switched_off"]:
        yield (
            f"Switched off, as the run has its own in their place: {named(found['switched_off'])}."
        )
    lit = voltages[voltages["outage"] & voltages["v_plan_pu"].notna()]["time"].nunique()
    dark = int(steps["outage"].sum()) - lit
    if dark:
        yield f"Dark in the plan, and not compared: {dark} steps without grid."
    if lit:
        carried: Floats = steps.loc[steps["outage"], "import_kw"].abs().to_numpy(float)
        holder = (
            f"a source at bus {island_bus} holds the voltage that the plan has there"
            if found["island"]
            else "the circuit's own source holds the voltage: no battery has three phases for it"
        )
        yield (
            f"Islands of {lit} steps: {holder}, and carries at most {np.nanmax(carried):.1f} kW "
            "that the plan's batteries do not. They are in the tables, and not in the largest "
            "difference."
        )
    lost = steps["import_kw"].isna()
    if lost.any():
        yield f"OpenDSS finds no solution in {int(lost.sum())} steps."

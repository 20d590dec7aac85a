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
from vppres.core.units import V_PER_KV
from vppres.feeders.dss import script as dss_script
from vppres.feeders.dss.circuit import OWN_SOURCES, located, read_opendss, solved_job
from vppres.feeders.net.changes import PermittedChanges, changed
from vppres.feeders.net.reduce import feeder_of
from vppres.kinds.table import KINDS
from vppres.scenario.network import BusId

PHASE_NAMES = {"1": "a", "2": "b", "3": "c"}
SMALL_PU = 0.005
"""Differences below it need no cause."""


# Tables of a finished run by name, as `Trajectory.tables`.
Tables = Mapping[str, pd.DataFrame]


@dataclass(frozen=True, eq=False)
class Recheck:
    """Check of a run by the original feeder."""

    #: ``time``, ``outage``, ``bus`` (of the source), ``phase``, ``v_pu`` (of the source),
    #: ``v_plan_pu`` (of the run's AC power flow) and ``difference_pu``, the former less the latter;
    #: empty where either has no voltage.
    voltages: pd.DataFrame
    #: ``time``, ``outage``, ``import_kw`` of the source, ``import_plan_kw`` and
    #: ``difference_max_pu``.
    steps: pd.DataFrame
    cause: str  #: where the largest difference with grid comes from, measured
    notes: tuple[str, ...]  #: what the comparison assumes

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
    """Solve the steps of a run on the circuit of the script that its scenario was made from.

    In steps without grid a source stands at ``island_bus``, with the plan's voltage; without it the
    circuit's own source holds islands too. Capacitors at the buses of ``opened`` are off in
    islands. A script without a load where the run has a customer is an InputError.
    """
    if source.suffix.lower() != ".dss":
        raise InputError.of(
            source.name,
            "is not a .dss file",
            "Recheck reads OpenDSS; into a pandapower net Trajectory.apply_to puts each step.",
        )
    circuit = _Circuit.of(source)
    job = {
        **_steps(run, circuit, island_bus, source.name),
        "off": OWN_SOURCES,
        "open_deltas": False,
        "island_bus": None if island_bus is None else str(island_bus),
        "open": [bus for bus, group in circuit.group_of.items() if group in map(str, opened)],
    }
    found = solved_steps(job, source)
    voltages = _voltages(run, found, circuit)
    steps = step_table(run, found, voltages)
    stiff = solved_steps({**job, "constant_power": True}, source)
    cause = _cause(voltages, _voltages(run, stiff, circuit))
    return Recheck(voltages, steps, cause, tuple(_notes(found, steps, voltages, island_bus)))


@dataclass(frozen=True, eq=False)
class _Circuit:
    """The buses of a circuit that have supply, as words, and its loads.

    ``group_of`` has the feeder's bus for each, ``base_v`` their nominal volts to ground; ``loads``
    the columns ``name``, ``group``, ``p`` and ``q``.
    """

    group_of: dict[str, str]
    base_v: dict[str, float]
    loads: pd.DataFrame

    @classmethod
    def of(cls, source: Path) -> _Circuit:
        """The circuit of a script."""
        net, ids, *_ = read_opendss(source)
        # Which line opens a loop says nothing of which buses are one.
        radial, _ = changed(net, source.name, PermittedChanges(open_loops=True), ids)
        bus_of = feeder_of(radial, source.name, bus_ids=ids).bus_of
        group_of = {str(ids[i]): str(bus) for i, bus in bus_of.items()}
        base_v = {str(ids[i]): kv * V_PER_KV / np.sqrt(3) for i, kv in net.bus["vn_kv"].items()}
        group = [group_of.get(str(ids[i]), "") for i in net.load["bus"]]
        power = {"p": net.load["p_mw"], "q": net.load["q_mvar"]}
        return cls(
            group_of, base_v, pd.DataFrame({"name": net.load["name"], "group": group} | power)
        )


def solved_steps(job: dict[str, Any], source: Path) -> dict[str, Any]:
    """The steps of a job in OpenDSS, with ``v`` (T, nodes) in V, NaN where there is no solution."""
    script = dss_script.read_script(source)
    found = solved_job({**job, **script.job()}, source.name)
    if found["problems"]:
        raise InputError(located(found["problems"], script, source.name))
    return found


ITEMS = {kind.item: "id" for kind in KINDS.values()}
"""Columns of units, of all kinds."""


def drawn(run: Tables) -> pd.DataFrame:
    """Power of a run's assets: columns ``time``, ``bus``, ``id``, ``table``, ``p``, ``q``."""
    customers, pv, batteries = run["customers"], run["pv"], run["batteries"]
    served = customers.get("share", customers["served"]).astype(float)
    parts = {
        "customers": (customers["p_load_kw"] * served, customers["q_load_kvar"] * served),
        "pv": (-(pv["self_kw"] + pv["export_kw"]), -pv["q_kvar"]),
        "batteries": (batteries["charge_kw"] - batteries["discharge_kw"], -batteries["q_kvar"]),
    }
    for kind in KINDS.values():
        if kind.table in run:
            p_kw = run[kind.table]["p_kw"]
            parts[kind.table] = (-p_kw if kind.gives else p_kw, 0.0 * p_kw)
    frames = [
        run[name]
        .rename(columns=ITEMS)
        .reindex(columns=["time", "bus", "id"])
        .assign(table=name, p=p_kw, q=q_kvar)
        for name, (p_kw, q_kvar) in parts.items()
        if len(run[name])
    ]
    return pd.concat(frames)


def step_jobs(
    times: pd.Series[Any], p_kw: Any, q_kvar: Any, held_v: pd.Series[float]
) -> list[dict[str, Any]]:
    """Steps as the engine gets them: powers by time and asset, and volts that a battery holds."""
    powers = (frame.reindex(times).to_numpy(float).tolist() for frame in (p_kw, q_kvar))
    volts = [None if np.isnan(v) else float(v) for v in held_v.reindex(times)]
    return [{"p_kw": p, "q_kvar": q, "held_v": v} for p, q, v in zip(*powers, volts, strict=True)]


def _steps(run: Tables, circuit: _Circuit, island_bus: BusId | None, name: str) -> dict[str, Any]:
    """Assets and steps for the engine.

    The circuit's loads share what is served at their bus as they share its nominal power; a load of
    its own at each bus gives or takes everything else.
    """
    table = drawn(run)
    served = table["table"] == "customers"
    table["bus"] = table["bus"].astype(str)
    loads = circuit.loads[circuit.loads["group"].isin(table.loc[served, "bus"])]
    missing = sorted({*table.loc[served, "bus"]} - {*loads["group"]})
    if missing:
        raise InputError.of(
            name,
            f"has no load at the buses of {len(missing)} customers: bus {named(missing)}",
            "Give the file that the run's scenario was made from.",
        )
    nominal = loads.groupby("group")[["p", "q"]].transform("sum")
    of_p = (loads["p"] / nominal["p"]).where(nominal["p"] != 0, 0.0)
    shares = {"p": of_p, "q": (loads["q"] / nominal["q"]).where(nominal["q"] != 0, of_p)}
    feeds = sorted({*table.loc[~served, "bus"]})
    powers = []
    for power, share in shares.items():
        wide = table.assign(served=served).pivot_table(
            power, "time", ["served", "bus"], "sum", fill_value=0.0
        )
        at_loads = wide[True][loads["group"]].to_numpy() * share.to_numpy()
        at_feeds = wide[False][feeds].to_numpy() if feeds else at_loads[:, :0]
        powers.append(pd.DataFrame(np.hstack([at_loads, at_feeds]), wide.index))
    assets = [{"load": each} for each in loads["name"]] + [{"bus": bus} for bus in feeds]
    held = held_v(run, "buses", island_bus, circuit.base_v.get(str(island_bus), np.nan))
    return {
        "assets": assets,
        "steps": step_jobs(run["steps"]["time"], powers[0], powers[1], held),
    }


def held_v(run: Tables, table: str, bus: object, base_v: float) -> pd.Series[float]:
    """Volts that the plan has at the bus that holds islands in steps without grid; NaN in others.

    ``table`` has the plan's voltages; ``base_v`` are its nominal volts.
    """
    steps, nodes = run["steps"].set_index("time"), run[table]
    own = nodes[nodes["bus"].astype(str) == str(bus)].groupby("time")["v_ac_pu"].first()
    volts: pd.Series[float] = base_v * own.reindex(steps.index).where(steps["outage"].astype(bool))
    return volts


def _voltages(run: Tables, found: dict[str, Any], circuit: _Circuit) -> pd.DataFrame:
    """Voltages of both, step by step and node by node."""
    group_of = circuit.group_of
    nodes = [node.rpartition(".") for node in found["nodes"]]
    kept = [i for i, (bus, _, node) in enumerate(nodes) if node in PHASE_NAMES and bus in group_of]
    plan = run["buses"].assign(bus=run["buses"]["bus"].astype(str))
    plan = plan.pivot_table(index="time", columns="bus", values="v_ac_pu", dropna=False)
    buses = [group_of[nodes[i][0]] for i in kept]
    v_plan_pu = plan.reindex(index=run["steps"]["time"], columns=buses).to_numpy(float)
    v_pu = np.abs(found["v"][:, kept]) / [circuit.base_v[nodes[i][0]] for i in kept]
    labels = [(nodes[i][0], PHASE_NAMES[nodes[i][2]]) for i in kept]
    # A feeder that is blacked out in the plan has no voltage, whatever stands in for its source.
    dark = run["steps"]["outage"].to_numpy(bool)[:, None] & np.isnan(v_plan_pu)
    return side_by_side(run, labels, np.where(dark, np.nan, v_pu), v_plan_pu)


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
    """Cause of the largest difference with grid.

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
    """Assumptions of the comparison."""
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

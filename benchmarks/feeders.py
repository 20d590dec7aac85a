"""Scenarios on other feeders, at the density of PV, batteries and tiers of the packaged day."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pandapower.networks
import pandas as pd
from numpy.random import Generator

import vppres
from benchmarks.frame.random_feeders import names
from benchmarks.instances import packaged
from vppres.core.arrays import Floats, Wholes
from vppres.core.errors import InputError, Problem
from vppres.core.units import mw_to_kw
from vppres.scenario.assets import Batteries, Customers, PVSystems
from vppres.scenario.network import Network
from vppres.scenario.scenario import Scenario
from vppres.scenario.timegrid import TimeGrid

CASE69 = Path(vppres.__file__).parent / "feeders" / "data" / "case69.csv"
BASE_KV = 12.66
FEEDERS = {
    33: ("33", 1),
    69: ("69", 1),
    115: ("115", 1),
    273: ("69", 4),
    545: ("69", 8),
    1021: ("69", 15),
    2993: ("69", 44),
    9997: ("69", 147),
}
"""Feeder and number of its copies, joined at the slack bus, by number of buses."""
SIZE_SCATTER = 0.3
"""Standard deviation of the logarithm of device sizes around their share of the load."""


@dataclass(frozen=True)
class Feeder:
    """Lines and nominal loads; buses are numbers, the slack bus is 1."""

    lines: pd.DataFrame
    load_kw: pd.Series[float]

    def joined(self, copies: int) -> Feeder:
        """Copies of the feeder that share the slack bus."""
        width = int(self.lines[["from_bus", "to_bus"]].to_numpy().max())

        def moved(bus: pd.Series[int], copy: int) -> pd.Series[int]:
            return bus.where(bus == 1, bus + copy * width)

        lines = [
            self.lines.assign(
                from_bus=moved(self.lines["from_bus"], i), to_bus=moved(self.lines["to_bus"], i)
            )
            for i in range(copies)
        ]
        loads = [self.load_kw.set_axis(self.load_kw.index + i * width) for i in range(copies)]
        return Feeder(pd.concat(lines, ignore_index=True), pd.concat(loads))


@cache
def feeder_scenario(n_buses: int, seed: int = 0) -> Scenario:
    """The packaged day on another feeder.

    Load and PV have the packaged day's shapes and shares of the nominal load; devices are drawn
    around their share of each customer's load. Impedances are scaled so that the lowest voltage at
    the peak, with everybody served and no devices, is the packaged day's.

    Parameters
    ----------
    n_buses : int
        One of :data:`FEEDERS`.
    seed : int
        Seed of tiers, power factors and devices.

    Raises
    ------
    InputError
        If there is no feeder of that size.
    """
    if n_buses not in FEEDERS:
        raise InputError(
            Problem(
                "feeders",
                "has no feeder",
                f"Use one of: {', '.join(map(str, FEEDERS))}.",
                field="buses",
                value=n_buses,
            )
        )
    name, copies = FEEDERS[n_buses]
    feeder = base_feeder(name).joined(copies)
    day = packaged()
    rng = np.random.default_rng([seed, n_buses])
    nominal_kw = np.asarray(feeder.load_kw, dtype=np.float64)
    customers = _customers(rng, feeder, day)
    pv = _pv(rng, nominal_kw, customers, day)
    load_kw = day.load_kw.sum(axis=1)[:, None] * nominal_kw / _nominal_kw()
    return replace(
        day,
        name=f"feeder-{n_buses}",
        title=f"The packaged day on {n_buses} buses",
        network=_network(feeder, customers, load_kw.max(axis=0), day.network.v_min_pu),
        customers=customers,
        pv=pv,
        batteries=_batteries(rng, nominal_kw, customers, day),
        load_kw=load_kw,
        pv_kw=day.pv_kw.sum(axis=1)[:, None] / day.pv.p_max_kw.sum() * pv.p_max_kw,
    )


@cache
def base_feeder(name: str) -> Feeder:
    """The feeder ``33`` (Baran and Wu), ``69`` (Baran and Wu) or ``115`` (Kerber, village).

    Of the village network at low voltage only the tree and the loads' proportions are taken.
    """
    if name == "69":
        table = pd.read_csv(CASE69, comment="#")
        return Feeder(
            table[["from_bus", "to_bus", "r_ohm", "x_ohm"]],
            table[table["p_kw"] > 0].set_index("to_bus")["p_kw"],
        )
    net = (
        pandapower.networks.case33bw()
        if name == "33"
        else pandapower.networks.create_kerber_dorfnetz()
    )
    line = net.line[net.line["in_service"]]
    # The slack bus of the village is the low-voltage side of its transformer.
    slack = int(net.trafo["lv_bus"].iloc[0]) if len(net.trafo) else 0
    buses = np.unique([slack, *line["from_bus"], *line["to_bus"]])
    number = {int(bus): i + 2 for i, bus in enumerate(b for b in buses if b != slack)} | {slack: 1}
    load_kw = mw_to_kw(net.load.groupby("bus")["p_mw"].sum())
    load = pd.Series(
        load_kw * (_nominal_kw() / 32 * len(load_kw) / load_kw.sum()),
        index=[number[b] for b in net.load.groupby("bus")["p_mw"].sum().index],
    )
    lines = pd.DataFrame(
        {
            "from_bus": line["from_bus"].map(number),
            "to_bus": line["to_bus"].map(number),
            "r_ohm": line["r_ohm_per_km"] * line["length_km"],
            "x_ohm": line["x_ohm_per_km"] * line["length_km"],
        }
    )
    return Feeder(lines.reset_index(drop=True), load)


@cache
def _nominal_kw() -> float:
    """Nominal load of the 33-bus feeder, to which the packaged day's shares refer."""
    return float(mw_to_kw(pandapower.networks.case33bw().load["p_mw"].sum()))


def _network(feeder: Feeder, customers: Customers, peak_kw: Floats, v_min_pu: float) -> Network:
    """The feeder with impedances that give the packaged day's lowest voltage at the peak."""
    day = packaged()
    wanted = _largest_drop_pu2(day.network, day.customers, day.load_kw.max(axis=0))
    lines = feeder.lines

    def scaled(factor: float) -> Network:
        return Network(
            lines["from_bus"].to_numpy(),
            lines["to_bus"].to_numpy(),
            (lines["r_ohm"] * factor).to_numpy(),
            (lines["x_ohm"] * factor).to_numpy(),
            slack_bus=1,
            base_kv=BASE_KV,
            v_min_pu=v_min_pu,
        )

    return scaled(wanted / _largest_drop_pu2(scaled(1.0), customers, peak_kw))


def _largest_drop_pu2(network: Network, customers: Customers, load_kw: Floats) -> float:
    """Largest drop of the squared voltage, lossless, with everybody served."""
    at = network.place(customers.bus)
    p, q = (network.downstream @ (at @ power) for power in (load_kw, load_kw * customers.q_per_p))
    drop = 2 * (network.r_pu2_per_kw * p + network.x_pu2_per_kvar * q)
    total = np.zeros(network.n_buses)
    for line, parent in enumerate(network.parent):
        total[line + 1] = total[parent] + drop[line]
    return float(total.max())


def _customers(rng: Generator, feeder: Feeder, day: Scenario) -> Customers:
    """One customer for each load; tiers in the packaged day's proportions."""
    count = len(feeder.load_kw)
    weights = dict(zip(day.customers.tier, day.customers.weight, strict=True))
    tier = rng.permutation(np.resize(rng.permutation(day.customers.tier), count))
    return Customers(
        id=names("c", range(count)),
        bus=feeder.load_kw.index.to_numpy(object),
        tier=tier,
        weight=np.array([weights[t] for t in tier]),
        power_factor=rng.choice(day.customers.power_factor, count),
    )


def _sizes(rng: Generator, nominal_kw: Floats, total: float) -> Floats:
    """Sizes around their share of the load, with a given total."""
    drawn = nominal_kw * rng.lognormal(0.0, SIZE_SCATTER, len(nominal_kw))
    return np.asarray(drawn * total / drawn.sum())


def _pv(rng: Generator, nominal_kw: Floats, customers: Customers, day: Scenario) -> PVSystems:
    """The packaged day's share of owners and PV power per nominal load."""
    count = len(nominal_kw)
    owners = np.sort(
        rng.choice(count, round(count * len(day.pv) / len(day.customers)), replace=False)
    )
    total = day.pv.p_max_kw.sum() * nominal_kw.sum() / _nominal_kw()
    p_max_kw = _sizes(rng, nominal_kw[owners], total)
    return PVSystems(
        id=names("p", owners),
        customer=customers.id[owners],
        p_max_kw=p_max_kw,
        s_max_kva=p_max_kw * rng.uniform(1.0, 1.3, len(owners)),
    )


def _batteries(
    rng: Generator, nominal_kw: Floats, customers: Customers, day: Scenario
) -> Batteries:
    """A battery for each customer with the packaged day's energy and power per nominal load."""
    b = day.batteries
    count = len(nominal_kw)
    energy = _sizes(rng, nominal_kw, b.energy_kwh.sum() * nominal_kw.sum() / _nominal_kw())
    power = energy * b.p_max_kw.sum() / b.energy_kwh.sum()
    alike = np.resize(np.arange(len(b)), count)
    columns = (
        "soc_min",
        "soc_max",
        "soc_initial",
        "eta_charge",
        "eta_discharge",
        "r_theta_c_per_kw",
        "c_theta_kwh_per_c",
        "alpha_charge_per_c2",
        "alpha_discharge_per_c2",
        "r_int_ohm",
        "beta_per_c",
        "u_batt_v",
        "t_ref_c",
        "t_initial_c",
    )
    return Batteries(
        id=names("b", range(count)),
        bus=customers.bus,
        energy_kwh=energy,
        p_max_kw=power,
        s_max_kva=power * rng.uniform(1.05, 1.4, count),
        **{name: getattr(b, name)[alike] for name in columns},
    )


def with_days(day: Scenario, days: int) -> Scenario:
    """The same day several times in a row, each with its outage."""
    rows = np.tile(np.arange(day.grid.n_steps), days)
    return _with_rows(day, TimeGrid(day.grid.start, day.grid.step_minutes, len(rows)), rows)


def with_step(day: Scenario, step_minutes: float) -> Scenario:
    """The same day in finer steps; every series is held over the coarser step."""
    parts = round(day.grid.step_minutes / step_minutes)
    rows = np.repeat(np.arange(day.grid.n_steps), parts)
    return _with_rows(day, TimeGrid(day.grid.start, step_minutes, len(rows)), rows)


def _with_rows(day: Scenario, grid: TimeGrid, rows: Wholes) -> Scenario:
    """The day's steps in another order or number."""
    return replace(
        day,
        grid=grid,
        load_kw=day.load_kw[rows],
        pv_kw=day.pv_kw[rows],
        price_gbp_per_kwh=day.price_gbp_per_kwh[rows],
        temperature_c=day.temperature_c[rows],
        grid_limit_kw=day.grid_limit_kw[rows],
    )

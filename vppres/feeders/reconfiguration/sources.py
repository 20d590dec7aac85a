"""Feeders to be reconfigured: of a network by its own loads, or of a scenario at a time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from vppres.core.arrays import Floats
from vppres.core.errors import InputError
from vppres.core.text import iso
from vppres.feeders.new.low_voltage import limits_of
from vppres.feeders.reconfiguration.by_phase import FlowInStates
from vppres.feeders.reconfiguration.folder import injection_at, step_of
from vppres.feeders.reconfiguration.loops import SwitchedNetwork
from vppres.feeders.reconfiguration.search import Configuration, ConfigurationLimits
from vppres.feeders.reconfiguration.sequence import SwitchingOrder, safe_order
from vppres.feeders.reconfiguration.states import Formers, SwitchedFeeder
from vppres.feeders.sources import import_network
from vppres.io.times import option_time
from vppres.physics.phased_sources import assets_of, drawn_uncontrolled
from vppres.scenario.configuration import Branches, out_of_branches
from vppres.scenario.formers import forming_batteries, named_units
from vppres.scenario.network import Network
from vppres.scenario.scenario import Scenario
from vppres.scenario.switches import Switches

KEEPS_PHASES = "keeps its phases, which a reconfiguration does not model"


@dataclass(frozen=True, eq=False)
class Reconfigurable:
    """A feeder with its switches, its loads and its limits."""

    name: str  #: name of the network or scenario
    network: Network  #: the feeder as it is
    switches: Switches  #: its switches
    injection: tuple[Floats, Floats]  #: net injection of every bus in kW and kvar
    limits_pu: tuple[float, float]  #: lowest and highest voltage
    words: str = ""  #: sentence on the loads; empty for those of a network
    record: Mapping[str, Any] = field(default_factory=dict)  #: the same for machines
    #: Faults, cold load and customers of a scenario, for the order of operations.
    of_the_day: Mapping[str, Any] = field(default_factory=dict)

    def order_to(
        self, feeder: SwitchedNetwork, best: Configuration, limits: ConfigurationLimits
    ) -> SwitchingOrder:
        """Order of the operations from the present configuration to the best one."""
        moving = SwitchedFeeder(
            self.network, self.switches, *self.injection, limits, **self.of_the_day
        )
        branches = moving.branches
        # The search knows those open switches alone that may move.
        ties = np.isin(branches.ties.id, feeder.ties.id)
        at = np.append(np.flatnonzero(branches.closed), self.network.n_lines + np.flatnonzero(ties))
        now = branches.closed
        then = now.copy()
        then[at] = True
        then[at[[*best.opened]]] = False
        return safe_order(moving, now, then)


def feeder_of_network(
    name: str, importing: Mapping[str, Any], of_scenarios: Mapping[str, object]
) -> Reconfigurable:
    """The feeder of a network; ``of_scenarios`` are options that it has no use for.

    Raises
    ------
    InputError
        If it keeps its phases, or an option is for scenarios alone.
    """
    for option, value in of_scenarios.items():
        if value is not None:
            cure = "Make a scenario of the network with vppres new, and give its folder."
            raise InputError.of(
                "options", "is for a scenario alone", cure, field=option, value=str(value)
            )
    feeder = import_network(name, **importing)
    if feeder.phased is not None:
        raise InputError.of(name, KEEPS_PHASES, "Add --balance for its balanced equivalent.")
    own = limits_of(feeder.network, None)
    limits = own.v_min_ac_pu, own.v_max_ac_pu
    return Reconfigurable(feeder.name, feeder.network, feeder.switches, feeder.injection, limits)


def feeder_of_scenario(
    day: Scenario, at: str | None, importing: Mapping[str, Any]
) -> Reconfigurable:
    """The feeder of a scenario with the loads of a step; ``importing`` are options of an import.

    Raises
    ------
    InputError
        If it has phases, the time lies outside its day, or an option is for networks alone.
    """
    for option, value in importing.items():
        if value:
            cure = "Leave it out: a scenario is read as it is."
            raise InputError.of("options", "is for a network alone", cure, field=option)
    if day.phases:
        cure = "Make a balanced scenario of its source with vppres new --balance."
        raise InputError.of(day.name, KEEPS_PHASES, cure)
    step = step_of(day, None if at is None else option_time(at, day.grid.zone))
    net, time = day.network, iso(day.grid.times[step])
    chosen = "" if at is not None else ", the step of the largest demand"
    return Reconfigurable(
        day.name,
        net,
        day.switches,
        injection_at(day, step),
        (net.v_min_ac_pu, net.v_max_ac_pu),
        f"All customers and PV power of {time}{chosen}; batteries and other assets rest.",
        {"at": time},
        of_the_day(day, step),
    )


def of_the_day(
    day: Scenario,
    step: int,
    soc: Floats | None = None,
    drawn: tuple[Floats, Floats] | None = None,
) -> dict[str, Any]:
    """Faults and cold load of a step, devices that can hold islands, customers of each bus.

    With phases also the power flow of its states, with what all devices draw in kW and kvar; what
    they do without control if it is not given.
    """
    net, customers = day.network, day.customers
    out = day.out_of_service(range(step, step + 1))
    formers = _at_rest(day, soc)
    found: dict[str, Any] = {
        "customers": customers.by_bus,
        "formers": formers,
        "faulted": out_of_branches(out, Branches.of(day).ends)[0],
        "bus_out": out.buses[0],
    }
    if day.switching.cold:
        more = (day.switching.cold_load_factor - 1.0) * net.place(customers.bus)
        found["cold_kw"] = more @ day.load_kw[step]
        found["cold_kvar"] = more @ day.load_kvar[step]
    if day.phases:
        if drawn is None:
            series = day.load_kw[step], day.load_kvar[step], day.pv_kw[step]
            drawn = drawn_uncontrolled(*series, len(assets_of(day)))
        found["by_phase"] = FlowInStates(day, map(str, formers.id), *drawn)
    return found


def _at_rest(day: Scenario, soc: Floats | None) -> Formers:
    """Devices that can hold an island, and rest; batteries do with any energy.

    Where none is named, it is the largest battery of a part: each is one that can.
    """
    b = day.batteries
    named = forming_batteries(day)
    anyone = named.any() and not b.grid_forming.any()
    able = np.where(anyone, b.active_max_kw > 0.0, named)
    able &= b.holds_energy(b.soc_initial if soc is None else soc)
    tables = [(b.id[able], b.bus[able], b.s_max_kva[able])]
    for kind, which in named_units(day).items():
        units = getattr(day, kind)
        buses = np.asarray(units.buses(day.customers), dtype=object)
        tables.append((units.id[which], buses[which], units.s_max_kva[which]))
    names, buses, ratings = (np.concatenate(column) for column in zip(*tables, strict=True))
    none = np.zeros(len(names))
    return Formers(names, buses, ratings, -ratings, ratings, none, none)

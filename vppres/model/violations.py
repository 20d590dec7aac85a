"""How far a dispatch is from what its window asks for: every row again, in numpy, apart from cvxpy.

A solver's status says that it is content. This says whether the dispatch can be had: an answer is
one only if it breaks no row of its window by more than the tolerances here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Floats, Wholes
from vppres.kinds.batteries.physics import power_beyond_kw
from vppres.kinds.kind import UnitPlan
from vppres.kinds.table import KINDS
from vppres.model.beyond_paper.lines_out import places_of
from vppres.model.beyond_paper.losses import injections
from vppres.model.beyond_paper.physical import taken_by_network
from vppres.model.data import WindowData
from vppres.model.formulas import lossless_flows, voltage_drop_pu2
from vppres.model.parts import at_items
from vppres.model.phases import phased_model
from vppres.model.site import Site
from vppres.scenario.assets import SOC_ROUNDING

POWER_TOLERANCE_KW = 1e-3
POWER_TOLERANCE_REL = 1e-5
"""By how much a power may miss a limit or a balance: a watt, or this share of the largest demand or
rating, which is far below what a meter reads and ten times what the solvers leave."""

VOLTAGE_TOLERANCE_PU2 = 1e-5
"""By how much a squared voltage may miss a limit, in pu²: about 5e-6 pu."""

RATING_TOLERANCE = 1e-5
"""Tolerance of a current by phase, as a share of its rating."""

Excess = dict[str, float]
"""Largest excess of each family of rows, as a multiple of its tolerance."""


def broken(site: Site, data: WindowData, dispatch: Dispatch) -> list[str]:
    """Families of rows that a dispatch in the network breaks, empty if it is one of the window.

    The window has the demand that the service brings about (``WindowData.for_service``).
    """
    found = excesses(site, data, dispatch)
    return [name for name, excess in found.items() if not excess <= 1.0]


def excesses(site: Site, data: WindowData, dispatch: Dispatch) -> Excess:
    """Worst excess over each family of rows as a multiple of its tolerance; NaN exceeds all."""
    families: tuple[Callable[[Site, WindowData, Dispatch], Excess], ...] = (
        _batteries,
        _energy,
        _pv,
        _grid,
        _balances,
        _voltages,
        _ratings,
        _lines_out,
        _phases,
        _kinds,
    )
    rules = 0.0 if data.switching is None else float(data.switching.broken(dispatch.served).sum())
    found = {"switching rules": 2.0 * rules}
    for family in families:
        found |= family(site, data, dispatch)
    return found


def _most(tolerance: float, *over: Floats) -> float:
    """Largest of some excesses in the unit of a tolerance, NaN where there is any."""
    return float(np.max([np.max(each, initial=0.0) for each in over])) / tolerance


def power_tolerance_kw(site: Site, data: WindowData) -> float:
    """Tolerance of powers in kW."""
    ratings = (site.batteries.s_max_kva, site.pv.s_max_kva, data.load_kw)
    largest = max(float(np.max(each, initial=0.0)) for each in ratings)
    return POWER_TOLERANCE_KW + POWER_TOLERANCE_REL * largest


def _batteries(site: Site, data: WindowData, d: Dispatch) -> Excess:
    """Powers of the batteries: ratings, one direction at a time, inverters, headroom."""
    b = site.batteries
    tolerance = power_tolerance_kw(site, data)
    net_kw = d.charge_kw - d.discharge_kw
    kept_kw = data.physics.headroom_kw if data.physics else 0.0
    room_kw = data.active_max_kw(b) if data.physics else b.p_max_kw
    beyond = power_beyond_kw(b, d.charge_kw, d.discharge_kw, d.batt_q_kvar)
    return {
        "battery power": _most(tolerance, beyond["power"]),
        "battery modes": _most(tolerance, beyond["modes"]),
        "battery inverter": _most(tolerance, beyond["inverter"] + kept_kw),
        "battery headroom": _most(tolerance, np.abs(net_kw) - room_kw),
    }


def _energy(site: Site, data: WindowData, d: Dispatch) -> Excess:
    """States of charge: where they begin, how they move, their limits."""
    b = site.batteries
    moved = data.soc_path(site, d.charge_kw, d.discharge_kw)[1:]
    reserve = data.physics.soc_reserve if data.physics else 0.0
    return {
        "state of charge": _most(
            SOC_ROUNDING, np.abs(d.soc[0] - data.soc), np.abs(d.soc[1:] - moved)
        ),
        "lowest state of charge": _most(SOC_ROUNDING, b.soc_min + reserve - moved),
        "highest state of charge": _most(SOC_ROUNDING, moved - b.soc_max),
    }


def _pv(site: Site, data: WindowData, d: Dispatch) -> Excess:
    """PV power: its balance, self-consumption, inverters."""
    tolerance = power_tolerance_kw(site, data)
    served = np.where(site.alone, False, d.served[:, site.owner])
    own_kw = data.self_limit_kw(site) * served
    through_kw = d.pv_self_kw + d.pv_export_kw
    return {
        "pv power": _most(tolerance, -d.pv_self_kw, -d.pv_export_kw, -d.pv_curtailed_kw),
        "pv balance": _most(tolerance, np.abs(through_kw + d.pv_curtailed_kw - data.pv_kw)),
        "self-consumption": _most(tolerance, np.abs(d.pv_self_kw - own_kw)),
        "pv inverter": _most(tolerance, np.hypot(through_kw, d.pv_q_kvar) - site.pv.s_max_kva),
    }


def _grid(site: Site, data: WindowData, d: Dispatch) -> Excess:
    """Exchange with the grid, and what batteries charge from."""
    tolerance = power_tolerance_kw(site, data)
    imported_kw = np.maximum(d.p_grid_kw, 0.0)
    charged_kw = d.charge_kw.sum(axis=1)
    fed_kw = imported_kw + d.pv_export_kw.sum(axis=1) + data.network_gives_kw
    for kind, units in site.kinds.items():
        if KINDS[kind].gives:
            fed_kw = fed_kw - d.taken_by(kind, units).sum(axis=1)
    return {
        "import": _most(tolerance, d.p_grid_kw - np.maximum(data.grid_limit_kw, 0.0)),
        "export": _most(tolerance, -d.p_grid_kw - data.export_max_kw(site) - data.beyond_limit_kw),
        "reactive exchange": _most(tolerance, np.abs(d.q_grid_kvar)[data.dark]),
        "circular charging": _most(tolerance, charged_kw - fed_kw),
    }


def _balances(site: Site, data: WindowData, d: Dispatch) -> Excess:
    """Active and reactive balance at every bus."""
    tolerance = power_tolerance_kw(site, data)
    p, q = _injected(site, data, d)
    p[:, 0] += d.p_grid_kw
    q[:, 0] += d.q_grid_kvar
    incidence = site.network.incidence
    return {
        "active balance": _most(tolerance, np.abs(p + (incidence @ d.p_flow_kw.T).T)),
        "reactive balance": _most(tolerance, np.abs(q + (incidence @ d.q_flow_kvar.T).T)),
    }


def _injected(site: Site, data: WindowData, d: Dispatch) -> tuple[Floats, Floats]:
    """Net injections at all buses without the grid's supply, what the network takes left out."""
    p, q = injections(site, data, d)
    taken = taken_by_network(site, data)
    return p - taken.kw, q - taken.kvar


def _flows(site: Site, data: WindowData, d: Dispatch) -> tuple[Floats, Floats]:
    """Flows of the lines that follow from a dispatch's powers, (W, L) each."""
    p, q = (lossless_flows(site.network, each) for each in _injected(site, data, d))
    return p, q


def _held(site: Site, data: WindowData) -> tuple[Wholes, Floats]:
    """Bus that holds the voltage in each step, and its squared voltage, (W,) each."""
    net = site.network
    held = data.physics.reference if data.physics else np.zeros(data.n_steps, dtype=int)
    return held, net.u_pu2(net.held_pu)[held]


def _u_of(site: Site, data: WindowData, p_kw: Floats, q_kvar: Floats) -> Floats:
    """Squared voltages that follow from flows, referred to the slack bus, (W, N)."""
    net = site.network
    held, held_pu2 = _held(site, data)
    u = (data.delta_pu2 - voltage_drop_pu2(net, p_kw, q_kvar)) @ net.downstream
    return np.asarray(u + (held_pu2 - u[np.arange(len(u)), held])[:, None])


def with_flows(site: Site, data: WindowData, dispatch: Dispatch) -> Dispatch:
    """A dispatch with the flows and voltages of the lines that follow from its powers."""
    p_kw, q_kvar = _flows(site, data, dispatch)
    v_pu = site.network.v_pu(_u_of(site, data, p_kw, q_kvar))
    return replace(dispatch, p_flow_kw=p_kw, q_flow_kvar=q_kvar, v_pu=v_pu)


def _voltages(site: Site, data: WindowData, d: Dispatch) -> Excess:
    """Voltage drop along every line, the voltage that is held, limits; referred to the slack.

    What has to be within the limits are the voltages that follow from the powers: those that a
    solver reports may miss each line's drop by a little, and these sum up along a feeder.
    """
    net = site.network
    u = net.u_pu2(d.v_pu)
    steps = np.arange(d.n_steps)
    held, held_pu2 = _held(site, data)
    drop = voltage_drop_pu2(net, d.p_flow_kw, d.q_flow_kvar)
    expected = u[:, net.parent] - drop + data.delta_pu2
    by_powers = _u_of(site, data, *_flows(site, data, d))
    lowest, highest = data.u_limits_pu2(net)
    limited = np.ones_like(u, dtype=bool)
    limited[:, 0] = held > 0  # the grid's own voltage has no limit
    return {
        "voltage held": _most(VOLTAGE_TOLERANCE_PU2, np.abs(u[steps, held] - held_pu2)),
        "voltage drop": _most(VOLTAGE_TOLERANCE_PU2, np.abs(u[:, 1:] - expected)),
        "lowest voltage": _most(VOLTAGE_TOLERANCE_PU2, (lowest - by_powers)[limited]),
        "highest voltage": _most(VOLTAGE_TOLERANCE_PU2, (by_powers - highest)[limited]),
    }


def _ratings(site: Site, data: WindowData, d: Dispatch) -> Excess:
    """Flows of the lines, as they follow from the powers."""
    if not len(data.flow_max_kva):
        return {}
    over_kva = np.hypot(*_flows(site, data, d)) - data.flow_max_kva
    return {"line rating": _most(power_tolerance_kw(site, data), over_kva)}


def _lines_out(site: Site, data: WindowData, d: Dispatch) -> Excess:
    """Flows over lines that are out, and what dead parts serve, give or take."""
    parts = data.parts
    if parts.whole:
        return {}
    tolerance = power_tolerance_kw(site, data)
    dead = {name: at_items(parts.dead, place) for name, place in places_of(site)}
    flows = np.hypot(d.p_flow_kw, d.q_flow_kvar)
    return {
        "lines that are out": _most(tolerance, flows[parts.lines]),
        "dead parts": _most(
            tolerance,
            (d.pv_self_kw + d.pv_export_kw)[dead["pv"]],
            (d.charge_kw + d.discharge_kw)[dead["batteries"]],
        ),
        "service of dead parts": 2.0 * float(d.served[dead["customers"]].sum()),
    }


def _phases(site: Site, data: WindowData, d: Dispatch) -> Excess:
    """Voltages by phase, and the former's phases."""
    phased = data.phased
    if not phased:
        return {}
    model = phased_model(site)
    p_kw, q_kvar = model.drawn(data, d)
    u, former = model.linear(data, p_kw, q_kvar)
    u = phased.u_offset + u
    currents = np.abs(phased.current_offset + model.currents(data, p_kw, q_kvar))
    every = np.ones(data.n_steps, dtype=bool)
    limited = model.limits_at(data, every)
    over_kva = np.abs(phased.former_offset + former) - phased.room_kva
    over_kva = over_kva[model.formed(data)]
    return {
        "lowest voltage of a phase": _most(VOLTAGE_TOLERANCE_PU2, (phased.u_min - u)[limited]),
        "highest voltage of a phase": _most(VOLTAGE_TOLERANCE_PU2, (u - phased.u_max)[limited]),
        "phase of the former": _most(power_tolerance_kw(site, data), over_kva),
        "rating of a phase": _most(RATING_TOLERANCE, currents - phased.current_max),
    }


def _kinds(site: Site, data: WindowData, d: Dispatch) -> Excess:
    """Flexible power of each kind: what its units can do, what they hold, rules of switching."""
    tolerance = power_tolerance_kw(site, data)
    found: Excess = {}
    for kind, known in data.ahead.by_kind.items():
        units, word = site.kinds[kind], KINDS[kind].word
        on = units.connected(site.customers, d.served)
        taken_kw, running = d.taken_by(kind, units), d.running_of(kind, units)
        plan = UnitPlan(taken_kw, running, on)
        found[f"{word} power"] = _most(tolerance, known.power_beyond_kw(plan))
        found[f"{word} energy"] = _most(tolerance, known.stored_beyond_kw(plan))
        outage = at_items(data.in_island, site.unit_bus[kind])
        wrong = known.wrongly_switched(running, outage)
        found[f"{word} switching"] = 2.0 * wrong.sum()
        over_kvar = np.abs(d.given_kvar.get(kind, 0.0 * taken_kw)) - known.q_most_kvar()
        found[f"{word} reactive power"] = _most(tolerance, over_kvar)
    return found

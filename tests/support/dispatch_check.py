"""An independent check of a dispatch: every equation of the paper again, in plain numpy.

It shares data classes with the package and no function: network sums are loops over the lines, and
limits are read from the assets' tables.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Floats
from vppres.kinds.customer.physics import SwitchingState
from vppres.model.data import WindowData
from vppres.scenario.scenario import Scenario


class Check(NamedTuple):
    """Worst violation of every equation, scaled to numbers near 1, and the paper's objective F."""

    violations: dict[str, float]
    objective: float

    @property
    def worst(self) -> tuple[str, float]:
        """The equation that is violated most, and by how much."""
        name = max(self.violations, key=lambda equation: self.violations[equation])
        return name, self.violations[name]


class Items(NamedTuple):
    """Positions of buses and owners, looked up apart from the package's matrices."""

    customer_bus: list[int]
    battery_bus: list[int]
    owner: list[int]
    pv_bus: list[int]


def check_dispatch(
    scenario: Scenario, data: WindowData, dispatch: Dispatch, state: SwitchingState | None = None
) -> Check:
    """Violations and objective of a dispatch of W steps.

    Powers are scaled by the largest demand of a customer (at least 1 kW), inverters and battery
    powers by their rating; SoC and squared voltages are near 1 by nature. With the state that the
    switching rules start from, the rules are checked too, and demand is what restorations make it.
    """
    rules: dict[str, float] = {}
    price = 0.0
    if state is not None:
        rules, cold, price = _switching(state, dispatch)
        data = replace(data, load_kw=data.load_kw * cold)
    scale_kw = max(1.0, float(data.load_kw.max(initial=0.0)))
    items = _items(scenario)
    families = (
        _signs(dispatch, scale_kw),
        _batteries(scenario, data, dispatch),
        _pv(scenario, data, dispatch, items),
        _grid(data, dispatch, scale_kw),
        _balances(scenario, data, dispatch, items, scale_kw),
        _voltages(scenario, data, dispatch),
        rules,
    )
    violations = {name: value for family in families for name, value in family.items()}
    return Check(violations, _objective(scenario, data, dispatch) - price)


def _items(scenario: Scenario) -> Items:
    bus = list(scenario.network.buses)
    customer = list(scenario.customers.id)
    customer_bus = [bus.index(b) for b in scenario.customers.bus]
    owner = [customer.index(c) for c in scenario.pv.customer]
    return Items(
        customer_bus,
        [bus.index(b) for b in scenario.batteries.bus],
        owner,
        [customer_bus[c] for c in owner],
    )


def _most(*excess: Floats | float) -> float:
    """Largest excess of any of the arrays, not below 0."""
    return max(0.0, *(float(np.max(e, initial=0.0)) for e in excess))


def _signs(d: Dispatch, scale_kw: float) -> dict[str, float]:
    parts = (
        d.pv_self_kw,
        d.pv_export_kw,
        d.pv_curtailed_kw,
        d.charge_kw,
        d.discharge_kw,
    )
    return {"not negative": _most(*(-part / scale_kw for part in parts))}


def _batteries(s: Scenario, data: WindowData, d: Dispatch) -> dict[str, float]:
    b, dt_h = s.batteries, s.grid.step_minutes / 60.0
    charged_kwh = dt_h * (data.eta_charge * d.charge_kw - d.discharge_kw / data.eta_discharge)
    apparent = np.hypot(d.charge_kw - d.discharge_kw, d.batt_q_kvar)
    reserve, kept_kva = (
        (data.physics.soc_reserve, data.physics.headroom_kw) if data.physics else (0.0, 0.0)
    )
    return {
        "charge rating": _most(d.charge_kw / b.p_max_kw - 1.0),
        "discharge rating": _most(d.discharge_kw / b.p_max_kw - 1.0),
        "exclusivity": _most(np.minimum(d.charge_kw, d.discharge_kw) / b.p_max_kw),
        "soc start": _most(np.abs(d.soc[0] - data.soc)),
        "soc dynamics": _most(np.abs(np.diff(d.soc, axis=0) - charged_kwh / b.energy_kwh)),
        "soc limits": _most(b.soc_min + reserve - d.soc[1:], d.soc[1:] - b.soc_max),
        "battery disc": _most((apparent + kept_kva) / b.s_max_kva - 1.0),
        "headroom": _most((np.abs(d.charge_kw - d.discharge_kw) + kept_kva) / b.p_max_kw - 1.0),
        # The limits once more by energy alone, in case the stored SoC were made up.
        "energy limits": _energy_limits(s, data, np.cumsum(charged_kwh, axis=0)),
    }


def _energy_limits(s: Scenario, data: WindowData, charged_kwh: Floats) -> float:
    b = s.batteries
    held = data.soc + charged_kwh / b.energy_kwh
    return _most(b.soc_min - held, held - b.soc_max)


def _pv(s: Scenario, data: WindowData, d: Dispatch, items: Items) -> dict[str, float]:
    rating, owner = s.pv.s_max_kva, items.owner
    own_kw = np.minimum(data.load_kw[:, owner], data.pv_kw) * d.served[:, owner]
    through = d.pv_self_kw + d.pv_export_kw
    return {
        "pv balance": _most(np.abs(through + d.pv_curtailed_kw - data.pv_kw) / rating),
        "self-consumption": _most(np.abs(d.pv_self_kw - own_kw) / rating),
        "pv disc": _most(np.hypot(through, d.pv_q_kvar) / rating - 1.0),
    }


def _grid(data: WindowData, d: Dispatch, scale_kw: float) -> dict[str, float]:
    dark = data.grid_limit_kw <= 0.0
    imported_kw, exported_kw = np.maximum(d.p_grid_kw, 0.0), np.maximum(-d.p_grid_kw, 0.0)
    from_outside = imported_kw + d.pv_export_kw.sum(axis=1)
    if data.drawn:  # a fixed demand may be negative
        from_outside = from_outside - np.minimum(data.drawn.kw.sum(axis=1), 0.0)
    taken_kw = data.export.limit_kw * ~dark if data.export else np.zeros(d.n_steps)
    return {
        "export limit": _most((exported_kw - taken_kw) / scale_kw),
        "grid limit": _most((d.p_grid_kw - data.grid_limit_kw) / scale_kw),
        "no reactive power in the dark": _most(np.abs(d.q_grid_kvar[dark]) / scale_kw),
        "circular charging": _most((d.charge_kw.sum(axis=1) - from_outside) / scale_kw),
    }


def _balances(
    s: Scenario, data: WindowData, d: Dispatch, items: Items, scale_kw: float
) -> dict[str, float]:
    """Kirchhoff at every bus: what arrives and is made there, less what leaves and is used."""
    tan_phi = np.sqrt(1.0 - s.customers.power_factor**2) / s.customers.power_factor
    left_p = np.zeros((d.n_steps, s.network.n_buses))
    left_q = np.zeros_like(left_p)
    left_p[:, 0], left_q[:, 0] = d.p_grid_kw, d.q_grid_kvar
    for c, n in enumerate(items.customer_bus):
        left_p[:, n] -= data.load_kw[:, c] * d.served[:, c]
        left_q[:, n] -= data.load_kw[:, c] * d.served[:, c] * tan_phi[c]
    for p, n in enumerate(items.pv_bus):
        left_p[:, n] += d.pv_self_kw[:, p] + d.pv_export_kw[:, p]
        left_q[:, n] += d.pv_q_kvar[:, p]
    for b, n in enumerate(items.battery_bus):
        left_p[:, n] += d.discharge_kw[:, b] - d.charge_kw[:, b]
        left_q[:, n] += d.batt_q_kvar[:, b]
    if data.drawn:
        left_p -= data.drawn.kw
        left_q -= data.drawn.kvar
    for line, upstream in enumerate(s.network.parent):
        for left, flow in ((left_p, d.p_flow_kw), (left_q, d.q_flow_kvar)):
            left[:, upstream] -= flow[:, line]
            left[:, line + 1] += flow[:, line]
        if data.physics:
            left_p[:, line + 1] -= data.physics.loss_kw[:, line]
            left_q[:, line + 1] -= data.physics.loss_kvar[:, line]
    return {
        "active balance": _most(np.abs(left_p) / scale_kw),
        "reactive balance": _most(np.abs(left_q) / scale_kw),
    }


def _voltages(s: Scenario, data: WindowData, d: Dispatch) -> dict[str, float]:
    net, u = s.network, d.v_pu**2
    base = 1000.0 * net.base_kv**2
    worst = 0.0
    to_slack = [1.0]  # the offset refers to the slack bus: the product of the ratios on the way
    for line, upstream in enumerate(net.parent):
        to_slack.append(to_slack[upstream] * float(net.ratio[line]))
    for line, upstream in enumerate(net.parent):
        drop = (
            2.0
            * (net.r_ohm[line] * d.p_flow_kw[:, line] + net.x_ohm[line] * d.q_flow_kvar[:, line])
            / base
        )
        behind_tap = u[:, upstream] / net.ratio[line] ** 2
        expected = behind_tap - drop + data.delta_pu2[:, line] / to_slack[line + 1] ** 2
        worst = max(worst, _most(np.abs(u[:, line + 1] - expected)))
    held = list(data.physics.reference) if data.physics else [0] * d.n_steps
    reference = np.array([u[t, n] for t, n in enumerate(held)])
    alone = u[[n != 0 for n in held]]
    return {
        "slack voltage": _most(np.abs(reference - net.v_slack_pu**2)),
        "voltage drop": worst,
        "voltage limits": _most(
            *(
                excess
                for part in (u[:, 1:], alone)
                for excess in (net.v_min_pu**2 - part, part - net.v_max_pu**2)
            )
        ),
    }


def _objective(s: Scenario, data: WindowData, d: Dispatch) -> float:
    """F = sum of f1 - lambda_grid f2 - lambda_curt f3 - lambda_l f4 - lambda_q f5."""
    dt_h, w = s.grid.step_minutes / 60.0, s.objective
    total = 0.0
    for t in range(d.n_steps):
        service = sum(s.customers.weight[c] for c in range(len(s.customers)) if d.served[t, c])
        exports = data.export and d.p_grid_kw[t] < 0.0
        price = data.export.price_gbp_per_kwh[t] if exports else data.price_gbp_per_kwh[t]
        cost_gbp = price * d.p_grid_kw[t] * dt_h
        flows = sum(
            r * (p**2 + q**2)
            for r, p, q in zip(s.network.r_ohm, d.p_flow_kw[t], d.q_flow_kvar[t], strict=True)
        )
        use = sum(
            (q / rating) ** 2
            for q, rating in zip(
                [*d.pv_q_kvar[t], *d.batt_q_kvar[t]],
                [*s.pv.s_max_kva, *s.batteries.s_max_kva],
                strict=True,
            )
        )
        total += (
            dt_h * (service - w.lambda_curt * d.pv_curtailed_kw[t].sum())
            - w.lambda_grid * cost_gbp
            - w.lambda_l * flows
            - w.lambda_q * use
        )
    return float(total)


def _switching(state: SwitchingState, d: Dispatch) -> tuple[dict[str, float], Floats, float]:
    """Rules that are broken, demand factors (W, C), and price, walking along the window.

    Each count is of customers and steps in which a rule is broken.
    """
    rules, dt_h = state.rules, state.dt_h
    count = {"min served": 0, "min unserved": 0, "stay restored": 0, "actions": 0}
    cold = np.ones((d.n_steps, len(state.served)))
    price = 0.0
    for c in range(len(state.served)):
        was_on, since_h, actions = bool(state.served[c]), state.since_h[c], state.actions[c]
        for t in range(d.n_steps):
            on = bool(d.served[t, c])
            if t > 0 and round((state.step + t) * dt_h, 6) % 24.0 < dt_h - 1e-6:
                actions = 0.0  # another day has begun
            if on != was_on:
                late = since_h < (rules.min_served_h if was_on else rules.min_unserved_h) - 1e-9
                count["min served" if was_on else "min unserved"] += late
                count["stay restored"] += was_on and rules.stay_restored and np.isfinite(since_h)
                price += 2 * rules.price_per_action * was_on
                since_h, actions = 0.0, actions + 1
                most = rules.max_actions_per_customer
                count["actions"] += most is not None and actions > most
            cold_h = max(rules.cold_load_h, dt_h) if rules.cold_load_factor > 1 else 0.0
            if on and since_h < cold_h - 1e-9:
                cold[t, c] = rules.cold_load_factor
            was_on, since_h = on, since_h + dt_h
    return {name: float(n) for name, n in count.items()}, cold, price

"""Set-points and battery states for the plant, written down instead of optimised."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from vppres.contract.decision import Decision
from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Floats
from vppres.kinds.table import units_of
from vppres.plant.plant import BatteryState
from vppres.scenario.scenario import Scenario


def decision(
    scenario: Scenario,
    served: ArrayLike = True,
    curtailed_kw: ArrayLike = 0.0,
    battery_kw: ArrayLike = 0.0,
    pv_q_kvar: ArrayLike = 0.0,
    batt_q_kvar: ArrayLike = 0.0,
) -> Decision:
    """Set-points of one step; ``battery_kw`` is positive when charging."""
    C, P, B = len(scenario.customers), len(scenario.pv), len(scenario.batteries)
    net = np.broadcast_to(np.asarray(battery_kw, float), (1, B))
    buses, lines = scenario.network.n_buses, scenario.network.n_lines
    return Decision(
        Dispatch(
            served=np.broadcast_to(np.asarray(served, bool), (1, C)),
            pv_self_kw=np.zeros((1, P)),
            pv_export_kw=np.zeros((1, P)),
            pv_curtailed_kw=np.broadcast_to(np.asarray(curtailed_kw, float), (1, P)),
            pv_q_kvar=np.broadcast_to(np.asarray(pv_q_kvar, float), (1, P)),
            charge_kw=np.maximum(net, 0.0),
            discharge_kw=np.maximum(-net, 0.0),
            batt_q_kvar=np.broadcast_to(np.asarray(batt_q_kvar, float), (1, B)),
            soc=np.zeros((2, B)),
            p_grid_kw=np.zeros(1),
            q_grid_kvar=np.zeros(1),
            v_pu=np.ones((1, buses)),
            p_flow_kw=np.zeros((1, lines)),
            q_flow_kvar=np.zeros((1, lines)),
        )
    )


def asked(day: Scenario, kw: Mapping[str, Floats | float], **set_points: Any) -> Decision:
    """Set-points of a step with what the units of each kind take; all sets run."""
    plan = decision(day, **set_points)
    taken_kw = {
        kind: np.broadcast_to(kw.get(kind, 0.0), (1, len(units)))
        for kind, units in units_of(day).items()
    }
    running = {"gensets": np.ones((1, len(day.gensets)), dtype=bool)} if len(day.gensets) else {}
    return replace(plan, dispatch=replace(plan.dispatch, taken_kw=taken_kw, running=running))


def state(soc: ArrayLike, eta: float = 0.95) -> BatteryState:
    """Two batteries at a state of charge."""
    values = np.broadcast_to(np.asarray(soc, float), 2)
    return BatteryState(values, np.full(2, eta), np.full(2, eta), np.full(2, 25.0))

"""What happens where the AC power flow has no solution: the lowest tier is shed until it has."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from vppres.contract.decision import Decision
from vppres.core.arrays import Flags, Floats
from vppres.core.errors import VerificationError
from vppres.physics.powerflow import ACPowerFlow
from vppres.plant.island import Settled
from vppres.plant.plant import BatteryState, Plant
from vppres.scenario.scenario import Scenario


def realise(plant: Plant, flow: ACPowerFlow, t: int, decision: Decision,
            state: BatteryState) -> Settled:
    """Carry out a decision; where its power flow diverges, shed tiers from the lowest up.

    A feeder whose power flow has no solution loses its voltage, and undervoltage relays drop load.
    If not even the empty feeder has a solution with PV and batteries running, they stop too.

    Parameters
    ----------
    plant : Plant
        The actual day.
    flow : ACPowerFlow
        Power flow of its network.
    t : int
        Step.
    decision : Decision
        What was decided.
    state : BatteryState
        State at the beginning of the step.
    """
    failed = ""
    for shed, tried in _reduced(plant.scenario, t, decision):
        realised = plant.apply(t, tried, state)
        try:
            result = flow.solve(realised.p_injection_kw, realised.q_injection_kvar)
        except VerificationError as error:
            failed = failed or str(error)
            continue
        asked = np.asarray(decision.dispatch.served[decision.row], dtype=bool)
        why = f"{shed} shed: {failed}" if failed else ""
        return Settled(realised, result, np.zeros(len(realised.charge_kw)),
                       asked & ~realised.served, ac_failed=why)
    raise VerificationError(failed)


def _reduced(scenario: Scenario, t: int,
             decision: Decision) -> Iterator[tuple[str, Decision]]:
    """The decision, then without ever more tiers, then without any power at all."""
    yield "nobody", decision
    served = np.array(decision.dispatch.served[decision.row], dtype=bool)
    for tier in reversed(scenario.tiers):
        served = served & (scenario.customers.tier != tier)
        yield f"{tier} and below", _with_served(decision, served)
    plan = decision.dispatch
    row = decision.row
    still: dict[str, Any] = {
        name: _with_row(getattr(plan, name), row, 0.0) for name in
        ("charge_kw", "discharge_kw", "batt_q_kvar", "pv_q_kvar")}
    still["pv_curtailed_kw"] = _with_row(plan.pv_curtailed_kw, row, scenario.pv_kw[t])
    empty = _with_served(decision, served)
    yield "everything", replace(empty, dispatch=replace(empty.dispatch, **still))


def _with_served(decision: Decision, served: Flags) -> Decision:
    rows = np.array(decision.dispatch.served, dtype=bool)
    rows[decision.row] = served
    return replace(decision, dispatch=replace(decision.dispatch, served=rows))


def _with_row(values: Floats, row: int, value: Floats | float) -> Floats:
    changed = np.array(values, dtype=float)
    changed[row] = value
    return changed

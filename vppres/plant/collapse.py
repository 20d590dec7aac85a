"""Collapse where the AC power flow has no solution: the lowest tier is shed until it has.

Only evidence sheds: where no solution was found and none was shown to be missing, all customers
stay on, and the record says by what its best answer misses.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from vppres.contract.decision import Decision
from vppres.contract.dispatch import Dispatch
from vppres.core.errors import VerificationError
from vppres.kinds.export.plant import within_export_limit
from vppres.physics.feeder import PowerFlow
from vppres.physics.powerflow import ACResult, NoSolutionError, NotFoundError
from vppres.plant.island import Settled
from vppres.plant.plant import NOBODY, BatteryState, Plant, Realised
from vppres.scenario.scenario import Scenario


def realise(
    plant: Plant, flow: PowerFlow, t: int, decision: Decision, state: BatteryState
) -> Settled:
    """Carry out a decision; where its power flow has no solution, shed tiers from the lowest up.

    A feeder whose power flow has no solution loses its voltage, and undervoltage relays drop load.
    If not even the empty feeder has a solution with PV, sets and batteries running, they stop too.
    A power flow that was merely not found sheds no customer: its best answer is recorded as such.
    """
    failed = ""
    for shed, tried in _with_less_load(plant.scenario, t, decision.step):
        realised = plant.apply(t, Decision(tried), state)
        try:
            realised, result = within_export_limit(plant, flow, t, realised, state)
        except NoSolutionError as error:
            failed = failed or f": {error}"
            continue
        except NotFoundError as error:
            return _settled(decision, realised, error.best, f"{shed} shed{failed}: {error}")
        return _settled(decision, realised, result, f"{shed} shed{failed}" if failed else "")
    raise VerificationError(failed.removeprefix(": "))


def _settled(decision: Decision, realised: Realised, ac: ACResult, ac_failed: str) -> Settled:
    """A connected step as it came out; customers planned as supplied that are not were shed."""
    asked = np.asarray(decision.dispatch.served[decision.row], dtype=bool)
    return Settled.of(
        realised,
        ac=ac,
        mismatch_kw=np.zeros(len(realised.battery_kw)),
        shed=asked & ~realised.served,
        ac_failed=ac_failed,
    )


def _with_less_load(scenario: Scenario, t: int, asked: Dispatch) -> Iterator[tuple[str, Dispatch]]:
    """The step as planned, then without vehicles, machines and ever more tiers, then any power."""
    yield NOBODY, asked
    flexible = {
        kind: np.zeros_like(taken_kw)
        for kind, taken_kw in asked.taken_kw.items()
        if kind not in asked.running
    }
    if flexible:
        asked = replace(asked, taken_kw={**asked.taken_kw, **flexible})
        yield NOBODY, asked
    served = np.array(asked.served, dtype=bool)
    for tier in reversed(scenario.tiers):
        served = served & (scenario.customers.tier != tier)
        yield f"{tier} and below", replace(asked, served=served)
    still: dict[str, Any] = {
        name: np.zeros_like(getattr(asked, name))
        for name in ("charge_kw", "discharge_kw", "batt_q_kvar", "pv_q_kvar")
    }
    still["pv_curtailed_kw"] = scenario.pv_kw[[t]]
    for name in ("taken_kw", "running"):
        still[name] = {kind: np.zeros_like(each) for kind, each in getattr(asked, name).items()}
    yield "everything", replace(asked, served=served, **still)

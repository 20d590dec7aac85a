"""Figures of a phased run: voltages by phase, unbalance, and the phases of what held the island."""

from __future__ import annotations

from typing import TYPE_CHECKING

from vppres.scenario.formers import former_kva, island_former
from vppres.scenario.phases import PHASES

if TYPE_CHECKING:
    from vppres.day.trajectory import Trajectory


def phase_figures(trajectory: Trajectory) -> dict[str, float | int | str | None]:
    """Keys of ``summary.json`` that only phased feeders have; nothing for others."""
    nodes, phases = trajectory.nodes, trajectory.scenario.phases
    if nodes is None or not phases:
        return {}
    net, steps = trajectory.scenario.network, trajectory.steps
    v_pu = nodes["v_ac_pu"].dropna()
    former = island_former(trajectory.scenario)
    kva = steps[[f"former_{phase}_kva" for phase in PHASES]].max(axis=1)
    names = steps["former"].where(kva.notna(), former)
    rating_kva = names.map({one: former_kva(trajectory.scenario, one) for one in set(names) if one})
    # The step in which a former is nearest its rating: another device may hold another step.
    share = (kva / rating_kva).astype(float)
    held = share.notna().any()
    at = int(share.argmax()) if held else 0
    unbalance, loading = steps["unbalance_max"], steps["loading_max"]
    fullest = int(loading.argmax()) if loading.notna().any() else None
    return {
        "node_steps": len(v_pu),
        "node_steps_outside_ac": int(((v_pu < net.v_min_ac_pu) | (v_pu > net.v_max_ac_pu)).sum()),
        "unbalance_max": float(unbalance.max()) if unbalance.notna().any() else None,
        "loading_max": None if fullest is None else float(loading.iloc[fullest]),
        "loading_at": None if fullest is None else str(steps["loading_at"].iloc[fullest]),
        "former_phase_rating_kva": None
        if former is None
        else float(rating_kva.iloc[at]) / len(PHASES),
        "former_phase_max_kva": float(kva.iloc[at]) if held else None,
    }

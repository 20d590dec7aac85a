"""Reasons and words of what is exported, and of what can be no more."""

from __future__ import annotations

from vppres.explain.reason import Reason
from vppres.explain.step import Step
from vppres.explain.words import figure, money
from vppres.kinds.kind import MOVE_KW

LIMIT_KW = 1.0
LIMIT_SHARE = 0.01
"""How near to its limit an export counts as limited: losses lie between plan and meter."""


def exported_kw(step: Step) -> float:
    """Export at the slack bus, 0 while the grid is away."""
    return 0.0 if step.outage else max(-step.imported_kw, 0.0)


def earned(step: Step) -> str:
    """Price that a step's export earns, in words; empty if nothing is exported."""
    price = float(step.scenario.export_price[step.t])
    return f"exports earn {money(price)}/kWh" if exported_kw(step) > MOVE_KW else ""


def at_limit(step: Step) -> Reason | None:
    """Reason of curtailment if no more than what is exported could be."""
    most, out_kw = float(step.scenario.export_max_kw[step.t]), exported_kw(step)
    near = LIMIT_KW + LIMIT_SHARE * min(most, out_kw)
    if most <= 0.0 or out_kw <= most - near:
        return None
    return Reason("grid", "grid", f"Curtailed: export is at its limit of {figure(most)} kW.")


def surplus_words(step: Step) -> str:
    """Export of a surplus, in words."""
    out_kw = exported_kw(step)
    if out_kw > MOVE_KW:
        return f"only {figure(out_kw)} kW is exported"
    could = step.scenario.export_max_kw[step.t] > 0.0
    return f"nothing {'is' if could else 'can be'} exported"

"""Devices that can form the grid of an island now, and reasons of those that cannot."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from vppres.contract.decision import OUT
from vppres.scenario.formers import named_units
from vppres.scenario.scenario import Scenario
from vppres.service.of_kind import every

EMPTY = "it is empty"
NOTHING = "nothing can form the grid"


@dataclass(frozen=True)
class FormerState:
    """A device that can form the grid of an island, and why it cannot now; empty if it can."""

    asset: str
    kind: str
    why_not: str


def formers_now(
    scenario: Scenario,
    plan: Mapping[str, Any],
    soc: Mapping[str, float],
    failing: Mapping[str, str],
) -> list[FormerState]:
    """Devices that are there to form the grid.

    The last plan is empty before the first; ``soc`` has states of charge as far as they are known,
    and ``failing`` devices that do not follow, and why.
    """
    units = (
        FormerState(name, kind, failing.get(name, "") or why)
        for kind, of in every().items()
        for name, why in of.formers(scenario, plan)
    )
    return [*_batteries(scenario, plan, soc, failing), *units]


def _batteries(
    scenario: Scenario,
    plan: Mapping[str, Any],
    soc: Mapping[str, float],
    failing: Mapping[str, str],
) -> Iterator[FormerState]:
    """Named ones; where nothing is named, one after another stands in for the largest."""
    b = scenario.batteries
    there = scenario.formers
    if not (b.grid_forming.any() or named_units(scenario)):
        complete = np.ones(len(b), dtype=bool)
        if scenario.phases:
            at = scenario.phases.connection
            complete = np.array([at(str(one)).three_coils for one in b.id])
        there = complete & (b.active_max_kw > 0.0)
    said = plan.get("estimated", ())
    held = np.array([soc.get(str(name), np.inf) for name in b.id], dtype=float)
    empty = ~b.holds_energy(held)
    for i in np.flatnonzero(there):
        name = str(b.id[i])
        why = failing.get(name, "")
        if not why and OUT.format(name) in said:
            why = "it is out"
        if not why and empty[i]:
            why = EMPTY
        yield FormerState(name, "batteries", why)


def why_dark(plan: Mapping[str, Any], formers: Sequence[FormerState], island: bool) -> str:
    """Why no customer is supplied in an island now; empty if something forms its grid, or may.

    A plan says so of itself. Where nothing was decided, and where devices failed since, it follows
    from the ``formers``.
    """
    if not plan or not island:
        return ""
    said = (plan.get("solve") or {}).get("dark_reason") or ""
    decided = plan.get("solve") is not None
    # An empty battery was planned for; how much is left at a moment is not known that exactly.
    able = [one for one in formers if not one.why_not or (decided and one.why_not == EMPTY)]
    if said and any(not one.why_not for one in formers):
        return str(said)
    if said or not able:
        return NOTHING
    return ""

"""Baselines for a dispatch: batteries left alone, and a reserve that is charged by rule.

The third baseline, perfect information, is the full horizon with the actual day as its forecast.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vppres.contract.decision import Decision, SolveInfo
from vppres.contract.observation import Observation
from vppres.contract.operating_point import Centre
from vppres.control.by_part import rule_by_part
from vppres.control.carried import Carried
from vppres.control.step_state import StepState
from vppres.core.arrays import Floats
from vppres.model.site import Site
from vppres.scenario.option_table import check_group
from vppres.scenario.timegrid import TimeGrid


class IdleController:
    """Batteries do nothing; an island is served by tier as far as PV power goes."""

    def __init__(self, site: Site, tiers: Sequence[str], centre: Centre = "lossless") -> None:
        self.site = site
        self.tiers = tiers
        self.centre = centre

    def horizon_steps(self, t0: int) -> range:
        """The current step alone."""
        return range(t0, t0 + 1)

    def decide(self, observation: Observation) -> Decision:
        """Serve what the grid and PV power carry."""
        state = StepState.of(self.site, observation, self.centre).idle()
        return _decision(rule_by_part(state, self.tiers), "idle")


@dataclass(frozen=True)
class ReserveRule:
    """When and how far a reserve is charged."""

    #: State of charge that is kept for an announced outage; the batteries' highest if None.
    soc: float | None = None
    notice_h: float = 6.0  #: how long before an outage it is announced, in h

    def __post_init__(self) -> None:
        check_group("reserve", self)


class ReserveController:
    """Charge to a level when an outage is announced; in the island serve by tier, greedily.

    Without an announcement the batteries rest. Import limits come before charging, and a customer
    before both.
    """

    def __init__(
        self,
        site: Site,
        grid: TimeGrid,
        tiers: Sequence[str],
        rule: ReserveRule | None = None,
        centre: Centre = "lossless",
    ) -> None:
        self.site = site
        self.grid = grid
        self.tiers = tiers
        self.centre = centre
        self.rule = rule or ReserveRule()

    def horizon_steps(self, t0: int) -> range:
        """The steps of which an outage is announced."""
        return self.grid.window(t0, self.rule.notice_h)

    def decide(self, observation: Observation) -> Decision:
        """Charge if an outage is announced, and serve what can be carried."""
        state = StepState.of(self.site, observation, self.centre)
        announced = bool((observation.forecast.grid_limit_kw <= 0.0).any())
        charge_kw = self._missing_kw(state) if announced and not state.island else None
        return _decision(rule_by_part(state, self.tiers, charge_kw), "reserve")

    def _missing_kw(self, state: StepState) -> Floats:
        """Charging power that would reach the level within the step, (B,)."""
        b = self.site.batteries
        level = b.soc_max if self.rule.soc is None else np.minimum(self.rule.soc, b.soc_max)
        return state.batteries_ahead.charge_to_kw(level)


def _decision(carried: Carried, status: str) -> Decision:
    """A rule's dispatch as a decision; what it leaves open is its reason."""
    return Decision(carried, 0, SolveInfo(status=status), reason=carried.shortage)

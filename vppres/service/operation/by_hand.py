"""Check of an operator's set-points before they hold: balance and AC power flow."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vppres.core.errors import InputError, VppresError
from vppres.core.text import named
from vppres.day.options import RunOptions
from vppres.day.recorder import StepRecord
from vppres.scenario.scenario import Scenario
from vppres.service.alarms.conditions import Situation
from vppres.service.plans.document import Left, ordered, ordered_plan, told_at
from vppres.service.plans.world import World

MOVED_KW = 0.5
"""What the power of a battery differs by from its set-point before it is said."""

NAMES_SHOWN = 5


@dataclass(frozen=True, eq=False)
class ByHand:
    """Set-points of an operator, played on the plant as the site is now."""

    asked: Mapping[str, Any]  #: the mode, with its set-points
    now: Scenario  #: the step: what is measured of it, and whether there is grid
    found: Situation  #: how the site is
    options: RunOptions  #: how the plant behaves

    def words(self) -> list[str]:
        """Consequences in sentences.

        Raises
        ------
        InputError
            If they would black out an island that is lit.
        """
        try:
            record, told = self._played()
        except VppresError as error:
            return [f"Not checked: {str(error).splitlines()[0]}"]
        dark = str(record.steps.get("dark_reason") or record.steps.get("ac_failed") or "")
        if dark and self.now.outage[0] and not self.found.why_dark:
            cure = "Disconnect customers, or give a battery or set that forms the grid less to do."
            message = f"would black out the island: {dark}"
            raise InputError.of("mode", message, cure, field="setpoints")
        return [*self._said(record, told)]

    def _played(self) -> tuple[StepRecord, list[dict[str, Any]]]:
        """Realised step of the plant under the set-points, and the set-points."""
        now, found = self.now, self.found
        b = now.batteries
        follows = np.array([str(name) not in found.failing for name in b.id], dtype=bool)
        able = replace(
            b,
            p_max_kw=np.where(follows, b.p_max_kw, 0.0),
            soc_initial=np.clip(found.known_soc, b.soc_min, b.soc_max),
        )
        world = World(replace(now, batteries=able), self.options)
        world.begin_as(found.plan, 0)
        tables = ordered(now, found.plan, self.asked["setpoints"])
        told = told_at(found.plan, now.grid.start)
        left = Left(available=not now.outage[0], told=told)
        plan = ordered_plan(now.grid.start, now, self.asked, tables, {}, left)
        return world.obey(0, plan["setpoints"]), plan["setpoints"]

    def _said(self, record: StepRecord, told: list[dict[str, Any]]) -> Iterator[str]:
        """Sentences on the realised step."""
        c, b = self.now.customers, self.now.batteries
        to_be_on = {one["asset"]: one["served"] for one in told if one["kind"] == "customers"}
        on = dict(zip(map(str, c.id), record.customers["served"], strict=True))
        shed = [name for name, wanted in to_be_on.items() if wanted and not on[name]]
        if shed:
            yield f"Not supplied all the same: {named(shed, NAMES_SHOWN)}."
        asked = {(one["kind"], one["asset"]) for one in self.asked["setpoints"]}
        stays = [k for k, wanted in to_be_on.items() if not (wanted or ("customers", k) in asked)]
        if stays:
            yield f"Off as before: {named(stays, NAMES_SHOWN)}."
        given = record.batteries["charge_kw"] - record.batteries["discharge_kw"]
        wanted = {one["asset"]: one["p_kw"] for one in told if one["kind"] == "batteries"}
        moved = [
            f"{name} {kw:.1f} kW instead of {wanted[name]:.1f}"
            for name, kw in zip(map(str, b.id), given, strict=True)
            if abs(kw - wanted[name]) > MOVED_KW
        ]
        if moved:
            yield f"By the balance of power: {named(moved, NAMES_SHOWN)}."
        yield from self._limits(record)

    def _limits(self, record: StepRecord) -> Iterator[str]:
        """Limits that would not be kept."""
        import_kw, limit_kw = record.steps["p_grid_kw"], float(self.now.grid_limit_kw[0])
        if 0.0 < limit_kw < import_kw:
            yield f"Import {import_kw:.0f} kW, above its limit of {limit_kw:g} kW."
        net = self.now.network
        low, high = record.steps["v_min_ac_pu"], record.steps["v_max_ac_pu"]
        if low < net.v_min_ac_pu or high > net.v_max_ac_pu:
            yield f"Voltages from {low:.3f} to {high:.3f} pu, outside their limits."

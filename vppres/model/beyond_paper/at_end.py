"""Energy of batteries at the end, in a window's problem: a target, or a value of what is left.

Energy that is missing to a target has a variable and a price, and is part of the cost: so it
decides among dispatches of equal service, and no service is given up for it.

A value is the least of a fixed number of lines in the stored energy, so a variable below all of
them and a reward for it state it exactly. In an outage the reward is service; with grid it comes
off the cost. Without either no problem has any of this.
"""

from __future__ import annotations

from collections.abc import Hashable

import cvxpy as cp
import numpy as np

from vppres.contract.ahead import KindsAhead
from vppres.contract.dispatch import Dispatch
from vppres.contract.stored_value import PIECES, StoredValue
from vppres.contract.terminal import Terminal
from vppres.core.arrays import Floats
from vppres.kinds.kind import UnitPlan
from vppres.model.beyond_paper.addition import Addition, AdditionDispatch
from vppres.model.constraints import Named
from vppres.model.data import WindowData
from vppres.model.numerics import write
from vppres.model.site import Site
from vppres.model.variables import Parameters, Variables


class HeldAtEnd(Addition):
    """Energy in kWh that batteries are to hold at the end, what is missing, and its price."""

    of_batteries = ("E_missing",)

    def __init__(self, site: Site, v: Variables, shape: Hashable) -> None:
        B = len(site.batteries)
        self.missing = cp.Variable(B, name="E_missing", nonneg=True)
        self.target_kwh = cp.Parameter(B, name="E_target", nonneg=True)
        self.price = cp.Parameter(name="price_missing", nonneg=True)

    @classmethod
    def shape(cls, site: Site, data: WindowData) -> Hashable | None:
        """No more than whether there is a target."""
        return data.ending == "target" or None

    def families(self, site: Site, v: Variables, p: Parameters) -> Named:
        """The energy at the end of the window, and what is missing to the target."""
        energy_kwh = cp.multiply(site.batteries.energy_kwh, v.SoC[-1])
        return {"held_at_end": energy_kwh + self.missing >= self.target_kwh}

    def terms(self) -> dict[str, cp.Expression]:
        """Cost of the missing energy, in GBP."""
        return {"f2": self.price * cp.sum(self.missing)}

    @classmethod
    def worth(cls, site: Site, data: WindowData, dispatch: Dispatch) -> dict[str, float]:
        """Cost of the missing energy."""
        assert data.terminal is not None
        return {"f2": data.terminal.cost_gbp(site.batteries, dispatch.soc[-1])}

    @classmethod
    def cost_range(
        cls, site: Site, data: WindowData, least_gbp: Floats, dearest_gbp: Floats
    ) -> tuple[Floats, Floats]:
        """Ranges of the parts of the cost, with that of missing energy from none to all."""
        assert data.terminal is not None
        nothing = np.zeros(len(site.batteries))
        most_gbp = data.terminal.cost_gbp(site.batteries, nothing)
        return least_gbp, np.append(dearest_gbp, most_gbp)

    def fill(self, site: Site, data: WindowData) -> None:
        """Write what is to be held and the price of what is missing; nothing without a target."""
        terminal = data.terminal or Terminal(0.0, 0.0)
        target_kwh = terminal.target_kwh(site.batteries)
        write(self.target_kwh, target_kwh if data.terminal else 0.0 * target_kwh)
        write(self.price, terminal.price_gbp_per_kwh)


KEPT_TOLERANCE = 1e-6
"""Share of the capacity by which the energy that a dispatch keeps for later may be missed."""


def left_kwh(site: Site, value: StoredValue, ahead: KindsAhead, dispatch: Dispatch) -> float:
    """Energy of all batteries and tanks at the end of a dispatch, as the value counts it."""
    held_kwh = float(dispatch.soc[-1] @ site.batteries.energy_kwh)
    for kind, kwh_each in value.kwh_each.items():
        units, known = site.kinds[kind], ahead.by_kind[kind].part(slice(dispatch.n_steps))
        taken_kw, running = dispatch.taken_by(kind, units), dispatch.running_of(kind, units)
        connected = units.connected(site.customers, dispatch.served)
        plan = UnitPlan(taken_kw, running, connected)
        held_kwh += known.left_kwh(plan, kwh_each)
    return held_kwh


def kept_range(site: Site, data: WindowData) -> tuple[float, float]:
    """Least and most that the energy at the end can be worth, in weighted customer hours."""
    value, b = data.stored_value, site.batteries
    if value is None:
        return 0.0, 0.0
    charged_kw = float(data.eta_charge @ b.active_max_kw)
    drawn_kw = float((b.active_max_kw / data.eta_discharge).sum())
    held_kwh = float(b.energy_kwh @ data.soc)
    hours = data.n_steps * site.dt_h
    most_kwh = min(held_kwh + charged_kw * hours, max(float(b.energy_kwh @ b.soc_max), held_kwh))
    least_kwh = max(held_kwh - drawn_kw * hours, min(float(b.energy_kwh @ b.soc_min), held_kwh))
    for kind, kwh_each in value.kwh_each.items():
        most_kwh += data.ahead.by_kind[kind].most_left_kwh(kwh_each)
    return value.between(least_kwh, most_kwh)


class ValueAtEnd(Addition):
    """Value of the energy of all batteries and tanks at the end, in weighted customer hours.

    ``slope`` and ``offset`` are its lines. ``gbp`` is what it takes off the cost for each weighted
    customer hour, ``share`` is 1 where it counts as service and otherwise 0.
    """

    # What is left stays worth as much as in a dispatch, and has no part in the cost then.
    by_dispatch = ("kept",)
    in_range = ("E_stored",)
    met = ("value_at_end",)

    def __init__(self, site: Site, v: Variables, shape: Hashable) -> None:
        # A variable, since limits with parameters stand beside it.
        self.stored = cp.Variable(name="E_stored")
        self.kept = cp.Variable(name="kept")
        self.slope = cp.Parameter(PIECES, name="kept_slope")
        self.offset = cp.Parameter(PIECES, name="kept_offset")
        self.gbp = cp.Parameter(name="kept_gbp", nonneg=True)
        self.share = cp.Parameter(name="kept_share", nonneg=True)

    @classmethod
    def shape(cls, site: Site, data: WindowData) -> Hashable | None:
        """No more than whether there is a value."""
        return data.ending == "value" or None

    def families(self, site: Site, v: Variables, p: Parameters) -> Named:
        """The energy at the end of the window, and what it is worth."""
        energy_kwh = cp.sum(cp.multiply(site.batteries.energy_kwh, v.SoC[-1]))
        if p.E_kept_added is not None:
            energy_kwh = energy_kwh + p.E_kept_added
        return {
            "stored_at_end": self.stored == energy_kwh,
            "value_at_end": self.kept <= self.slope * self.stored + self.offset,
        }

    def terms(self) -> dict[str, cp.Expression]:
        """Value of the kept energy: off the cost in GBP, or as later weighted customer hours."""
        return {"f2": -self.gbp * self.kept, "f7": self.share * self.kept}

    @classmethod
    def worth(cls, site: Site, data: WindowData, dispatch: Dispatch) -> dict[str, float]:
        """Value of the energy at the end: off the cost, and the later service that it buys."""
        value = data.stored_value or StoredValue.nothing()
        kept = value.at(left_kwh(site, value, data.ahead, dispatch))
        return {"f2": -value.gbp_as_cost * kept, "f7": kept if value.as_service else 0.0}

    @classmethod
    def cost_range(
        cls, site: Site, data: WindowData, least_gbp: Floats, dearest_gbp: Floats
    ) -> tuple[Floats, Floats]:
        """Ranges of the parts of the cost, with that of the value of what can be kept."""
        each_gbp = -(data.stored_value or StoredValue.nothing()).gbp_as_cost
        least, most = kept_range(site, data)
        return np.append(least_gbp, each_gbp * most), np.append(dearest_gbp, each_gbp * least)

    def of_dispatch(self, site: Site, data: WindowData, dispatch: Dispatch) -> AdditionDispatch:
        """The energies at the end that are worth as much, and what comes off the cost for it."""
        value = data.stored_value or StoredValue.nothing()
        missed_kwh = KEPT_TOLERANCE * float(site.batteries.energy_kwh.sum())
        kept_kwh = left_kwh(site, value, data.ahead, dispatch)
        most_kwh = max(kept_kwh, value.most_kwh(value.at(kept_kwh)))
        gbp = self.worth(site, data, dispatch)["f2"]
        return AdditionDispatch(
            {"kept": 0.0}, {"E_stored": (kept_kwh - missed_kwh, most_kwh + missed_kwh)}, gbp
        )

    def fill(self, site: Site, data: WindowData) -> None:
        """Write the lines and what they count as."""
        value = data.stored_value or StoredValue.nothing()
        write(self.slope, value.slope)
        write(self.offset, value.offset)
        write(self.gbp, value.gbp_as_cost)
        write(self.share, float(value.as_service))

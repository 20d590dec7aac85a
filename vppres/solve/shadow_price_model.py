"""The pricing problem: the window as it was, with service continuous where it was withheld.

It is solved after the day, never in the loop, for its duals: they say what one more kWh, kW, kvar
or kVA would have bought. Service lies between the bounds that are given for each customer and step,
the modes of batteries that moved are those of the record in the first step, everything else is the
paper's problem with the true discs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vppres.core.arrays import Floats
from vppres.model.beyond_paper.lines_out import LinesOut
from vppres.model.beyond_paper.table import Beyond
from vppres.model.data import WindowData
from vppres.model.numerics import disc_sides
from vppres.model.polygons import Polygon
from vppres.model.site import Site
from vppres.solve.cache import shared_cache
from vppres.solve.forms import in_order, sheet_for, total_balance, with_discs
from vppres.solve.network.rows import Rows
from vppres.solve.selection import Family, Selected, Selection, Sheet

RATED = {
    "battery_charge_mode": "battery_charge_rated",
    "battery_discharge_mode": "battery_discharge_rated",
}
"""An inverter has a price of its own: two rows that bind together would share it."""


BALANCES = ("active_power_balance", "reactive_power_balance")
VOLTAGES, FLOWS = frozenset({"u"}), frozenset({"P_flow", "Q_flow"})
"""Letters of the tree of a feeder with phases, which limits no voltage; where no line is out its
flows make one balance of all buses."""


@dataclass(frozen=True, eq=False)
class FixedDecisions:
    """Decisions of the record that the pricing problem holds, for a window of W steps."""

    #: Bounds on the share of each customer that is served, (W, C).
    service_min: Floats
    service_max: Floats
    #: Bounds on the mode of each battery in the first step, (B,): 1 charges, 0 discharges.
    mode_min: Floats
    mode_max: Floats


@dataclass(frozen=True)
class PricedTerms:
    """Objective: weights of f1 (weighted customer hours), f2 (GBP) and f3 (kWh)."""

    service: float
    cost: float
    curtailment: float
    curtailed_max_kwh: float = np.inf


class ShadowPriceModel(Selected):
    """The pricing problem over W steps, compiled once."""

    def __init__(self, site: Site, n_steps: int, beyond: Beyond = ()) -> None:
        self.site = site
        self.n_steps = n_steps
        self.data: WindowData | None = None
        self.phase_rows: list[Rows] = []
        self.lines_out = any(each is LinesOut for each, _ in beyond)
        self.sides = disc_sides(site, n_steps)
        sheet = sheet_for(shared_cache(site), n_steps, beyond)
        super().__init__(sheet, self._selected, conic=True)

    def _selected(self, sheet: Sheet) -> Selection:
        """All families, and what is held.

        A bound of self-consumption would take up a part of the dual that belongs to the service.
        """
        found = Selection(sheet).relax("x_served").relax("P_self").relax("delta")
        found = found.relaxed_to_shares(sheet.statement.named("directions"))
        polygon = Polygon.inscribed(self.sides) if self.sides else None
        names = self._kept(sheet)
        found = with_discs(found, [RATED.get(name, name) for name in names], polygon)
        sums = [total_balance(sheet, name) for name in BALANCES if name not in names]
        found = replace(found, parts=(*found.parts, *sums))
        for name, letter in (("mode", "delta"), ("service", "x_served")):
            found = found.limit(f"{name}_min", {letter: -1.0}).limit(f"{name}_max", {letter: 1.0})
        return found.limit_term("f3").optimise(True, f1=1.0, f2=-1.0, f3=-1.0, f7=1.0, own=1.0)

    def _kept(self, sheet: Sheet) -> list[str]:
        """Families, of a feeder with phases without the letters of its tree."""
        statement, names = sheet.statement, in_order(sheet)
        if not self.site.phases or statement.differs:
            return names
        gone = VOLTAGES if self.lines_out else VOLTAGES | FLOWS
        return [name for name in names if not statement.letters_of(name) & gone]

    def price(self, data: WindowData, held: FixedDecisions, priced: PricedTerms) -> None:
        """Write a window's data, and what is held and priced."""
        self.data = data
        self.fill(data)
        self.compile()
        self.factors.update(f1=priced.service, f2=-priced.cost, f3=-priced.curtailment)
        for name in {"f7", "own"} & self.factors.keys():
            self.factors[name] = priced.service
        # All PV energy of the window is a limit that never binds.
        everything = float(data.pv_kw.sum()) * self.site.dt_h + 1.0
        later = np.ones((self.n_steps - 1, len(self.site.batteries)))
        self.limits = {
            "mode_min": -np.vstack([held.mode_min, 0.0 * later]),
            "mode_max": np.vstack([held.mode_max, later]),
            "service_min": -held.service_min,
            "service_max": held.service_max,
            "f3": min(priced.curtailed_max_kwh, everything),
        }

    def family(self, name: str) -> Family:
        """Rows of the problem by their name."""
        (part,) = (part for part in self.parts if part.name == name)
        return part

    def worth_at_buses(self, balance: str) -> Floats:
        """Gain of one more unit put into each bus in the first step, (N,)."""
        # A demand on the right of the balance costs what an injection gains.
        if balance in self.rows_of:
            return np.asarray(-self.dual(balance)[0])
        return np.full(self.site.network.n_buses, -self.dual(f"total_{balance}")[0])

    def dual(self, name: str) -> Floats:
        """Gain of one more unit of a family's limits, in its rows' shape."""
        return np.reshape(self.duals[self.rows_of[name]], self.family(name).shape, order="F")

"""Value of the energy that is left at the end, in a window's problem.

The value is the least of a fixed number of lines in the stored energy, so a variable below all of
them and a reward for it state it exactly. In an outage the reward is service; with grid it comes
off the cost. Without a value no problem has any of this.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import ClassVar, Self

import cvxpy as cp
import numpy as np

from vppres.contract.ahead import KindsAhead
from vppres.contract.dispatch import Dispatch
from vppres.contract.stored_value import PIECES, StoredValue
from vppres.core.arrays import Floats
from vppres.kinds.kind import UnitPlan
from vppres.model.beyond_paper.addition import Addition, AdditionDispatch
from vppres.model.constraints import Named
from vppres.model.data import WindowData
from vppres.model.numerics import write
from vppres.model.site import Site
from vppres.model.variables import Parameters, Variables

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


@dataclass(frozen=True, eq=False)
class ValueAtEnd(Addition):
    """Variables and parameters of the value of what is stored at the end of a window."""

    #: Energy of all batteries and tanks in kWh; a variable, since limits with parameters stand
    #: beside it.
    stored: cp.Variable
    kept: cp.Variable  #: what it is worth, in weighted customer hours
    #: The lines, (K,).
    slope: cp.Parameter
    offset: cp.Parameter
    gbp: cp.Parameter  #: what it takes off the cost for each weighted customer hour
    share: cp.Parameter  #: 1 where it counts as service, otherwise 0

    # What is left stays worth as much as in a dispatch, and has no part in the cost then.
    by_dispatch: ClassVar[tuple[str, ...]] = ("kept",)
    in_range: ClassVar[tuple[str, ...]] = ("E_stored",)
    met: ClassVar[tuple[str, ...]] = ("value_at_end",)

    @classmethod
    def shape(cls, site: Site, data: WindowData) -> Hashable | None:
        """No more than whether there is a value."""
        return data.ending == "value" or None

    @classmethod
    def create(cls, site: Site, v: Variables, shape: Hashable) -> Self:
        """A value of any window."""
        return cls(
            cp.Variable(name="E_stored"),
            cp.Variable(name="kept"),
            cp.Parameter(PIECES, name="kept_slope"),
            cp.Parameter(PIECES, name="kept_offset"),
            cp.Parameter(name="kept_gbp", nonneg=True),
            cp.Parameter(name="kept_share", nonneg=True),
        )

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
        value = data.require_value()
        kept = value.at(left_kwh(site, value, data.ahead, dispatch))
        return {"f2": -value.gbp_as_cost * kept, "f7": kept if value.as_service else 0.0}

    @classmethod
    def cost_range(
        cls, site: Site, data: WindowData, least_gbp: Floats, dearest_gbp: Floats
    ) -> tuple[Floats, Floats]:
        """Ranges of the parts of the cost, with that of the value of what can be kept."""
        each_gbp = -data.require_value().gbp_as_cost
        least, most = data.kept_range(site)
        return np.append(least_gbp, each_gbp * most), np.append(dearest_gbp, each_gbp * least)

    def of_dispatch(self, site: Site, data: WindowData, dispatch: Dispatch) -> AdditionDispatch:
        """The energies at the end that are worth as much, and what comes off the cost for it."""
        value = data.require_value()
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

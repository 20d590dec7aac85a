"""Lines that are out carry nothing, and parts of the feeder that nothing forms are off.

That alone gives each part its own balance: balances stand at all buses, and flows inside a part
cancel in their sum. A relaxation without flows has the sum of all that is drawn behind a line
instead, which is what the line would carry: 0 where it is out.
"""

from __future__ import annotations

from collections.abc import Hashable

import cvxpy as cp
import numpy as np
import scipy.sparse as sp

from vppres.core.arrays import Flags
from vppres.model.beyond_paper.addition import Addition
from vppres.model.constraints import Named, injected_and_drawn
from vppres.model.data import WindowData
from vppres.model.numerics import write
from vppres.model.parts import at_items
from vppres.model.site import Site
from vppres.model.variables import Parameters, Variables

NO_REACTIVE_FLOW = "no_reactive_flow"
"""Its family of reactive power."""


class LinesOut(Addition):
    """Lines that are out in some step of a window, (K,), and what may be dead in some.

    ``out`` is 1 where a line is out, and ``P_over`` what it would carry: all that is drawn behind
    it, (W, K). ``lit`` is 1 where those ``items`` are not dead that are so in some step, (W, n).
    """

    apart = True
    for_network = ("drawn_behind_line", "nothing_over_line")

    def __init__(self, site: Site, v: Variables, shape: Hashable) -> None:
        assert isinstance(shape, tuple)
        W = v.u.shape[0]
        self.lines, buses = (np.array(each, dtype=int) for each in shape)
        dead = np.isin(np.arange(site.network.n_buses), buses)
        items = {
            name: np.flatnonzero(at_items(dead[None], place)) for name, place in places_of(site)
        }
        self.items = {name: which for name, which in items.items() if len(which)}
        self.out = cp.Parameter((W, len(self.lines)), name="out", nonneg=True)
        self.P_over = cp.Variable((W, len(self.lines)), name="P_over")
        self.lit = {
            name: cp.Parameter((W, len(which)), name=f"lit_{name}", nonneg=True)
            for name, which in self.items.items()
        }

    @classmethod
    def shape(cls, site: Site, data: WindowData) -> Hashable | None:
        """Lines that are out in some step, and buses that are dead in some."""
        if data.parts.whole:
            return None
        out, dead = data.parts.lines.any(axis=0), data.parts.dead.any(axis=0)
        return tuple(np.flatnonzero(out).tolist()), tuple(np.flatnonzero(dead).tolist())

    def families(self, site: Site, v: Variables, p: Parameters) -> Named:
        """No flow over lines that are out; nothing served, given or taken in dead parts."""
        found: Named = {
            "no_active_flow": cp.multiply(self.out, v.P_flow[:, self.lines]) == 0.0,
            NO_REACTIVE_FLOW: cp.multiply(self.out, v.Q_flow[:, self.lines]) == 0.0,
        }
        most_kw = {"pv": site.pv.s_max_kva, "batteries": site.batteries.active_max_kw}
        letters = {
            "customers": {"no_service_in_the_dark": v.x_served},
            "pv": {"no_export_in_the_dark": v.P_exp},
            "batteries": {
                "no_charge_in_the_dark": v.P_ch,
                "no_discharge_in_the_dark": v.P_dch,
            },
        }
        for name, which in self.items.items():
            lit: cp.Expression = self.lit[name]
            if name in most_kw:
                lit = cp.multiply(lit, np.broadcast_to(most_kw[name][which], lit.shape))
            for family, letter in letters[name].items():
                found[family] = letter[:, which] <= lit
        return found

    def implied(self, site: Site, v: Variables, p: Parameters) -> Named:
        """Power over lines, by all that is drawn behind them; nothing where they are out."""
        P_inj, P_load = injected_and_drawn(site, v, p)
        behind = sp.csr_array(site.network.downstream[self.lines])
        return {
            "drawn_behind_line": self.P_over == (P_load - P_inj) @ behind.T,
            "nothing_over_line": cp.multiply(self.out, self.P_over) == 0.0,
        }

    def fill(self, site: Site, data: WindowData) -> None:
        """Write a window's parts."""
        write(self.out, data.parts.lines[:, self.lines].astype(float))
        for name, place in places_of(site):
            if name in self.items:
                dead: Flags = at_items(data.parts.dead, place)[:, self.items[name]]
                write(self.lit[name], 1.0 - dead)


def places_of(site: Site) -> list[tuple[str, sp.csr_array]]:
    """Buses of customers, PV systems and batteries."""
    return [
        ("customers", site.customer_bus),
        ("pv", site.pv_bus),
        ("batteries", site.battery_bus),
    ]

"""Reactive power of one step with active power held: least flows and least use of inverters.

Only one step is looked at, and what the data leaves of every inverter's disc is an interval. So the
problem stays small and feasible where the tie-breakers with all of the window are neither.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from cvxpy.constraints.zero import Equality

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Floats
from vppres.model.beyond_paper.lines_out import NO_REACTIVE_FLOW
from vppres.model.beyond_paper.ratings import limit_kva
from vppres.model.data import WindowData
from vppres.model.numerics import ANY_KW
from vppres.model.site import Site
from vppres.model.variables import FIELDS
from vppres.solve.selection import Selected, Selection, Sheet
from vppres.solve.tie_breakers import SHARPER_VOLTAGE, squares_of

LETTERS = ("Q_pv", "Q_batt", "Q_grid", "Q_flow")
"""Letters that are free."""


class LeastReactive(Selected):
    """Least reactive part of f4 and f5 of a step.

    Families of active power, energy and service are left out, since a dispatch meets them. What
    limits voltage and reactive power gives way to what the dispatch has.
    """

    def __init__(self, site: Site, sheet: Sheet) -> None:
        super().__init__(sheet, self._selected, conic=True)
        self.site = site

    def _selected(self, sheet: Sheet) -> Selection:
        """Reactive balance and voltage of every bus, limits of inverters, lines and the grid."""
        statement = sheet.statement
        holds_voltage = [
            name
            for name, family in statement.families.items()
            if isinstance(family, Equality) and statement.letters_of(name) == {"u"}
        ]
        found = Selection(sheet).hold("x_served", "P_flow").relax("u")
        found = found.keep("reactive_power_balance", *holds_voltage)
        found = found.keep(*(name for name in statement.families if name == NO_REACTIVE_FLOW))
        found = found.scale("delta_lindistflow", SHARPER_VOLTAGE)
        limited = [name for name in LETTERS if name != "Q_flow" or self.site.rated]
        for name in ("u", *limited):
            found = found.limit(f"{name}_min", {name: -1.0}).limit(f"{name}_max", {name: 1.0})
        squares = {name: w for name, w in squares_of(self.site).items() if name in LETTERS}
        return replace(found, squares=squares)

    def hold(self, data: WindowData, dispatch: Dispatch, t: int) -> None:
        """Write step ``t`` of a dispatch."""
        site = self.site
        step = slice(t, t + 1)
        part = data.part(step)
        self.fill(part, dispatch.served[step])
        self.held["P_flow"] = dispatch.p_flow_kw[step]
        kept_kw = part.physics.headroom_kw if part.physics else 0.0
        net_kw = dispatch.charge_kw - dispatch.discharge_kw
        through_kw = dispatch.pv_self_kw + dispatch.pv_export_kw
        rated_kva = np.broadcast_to(limit_kva(part), (1, site.network.n_lines))
        q_flow = _left(rated_kva, dispatch.p_flow_kw[step], dispatch.q_flow_kvar[step])
        most = {
            "Q_pv": _left(site.pv.s_max_kva, through_kw[step], dispatch.pv_q_kvar[step]),
            "Q_batt": _left(
                site.batteries.s_max_kva - kept_kw, net_kw[step], dispatch.batt_q_kvar[step]
            ),
            "Q_grid": part.grid_q_max_kvar(site),
            "Q_flow": np.minimum(q_flow, ANY_KW),
        }
        u = site.network.u_pu2(dispatch.v_pu[step])
        lowest, highest = part.u_limits_pu2(site.network)
        self.limits = {"u_min": -np.minimum(u, lowest), "u_max": np.maximum(u, highest)}
        for name, kvar in most.items():
            self.limits |= {f"{name}_min": kvar, f"{name}_max": kvar}

    def put_into(self, dispatch: Dispatch, t: int) -> Dispatch:
        """The dispatch with the last solution in step ``t``."""
        changed = {FIELDS[name]: self.value_of(name) for name in LETTERS}
        changed["v_pu"] = self.site.network.v_pu(self.value_of("u"))
        arrays = {}
        for field, values in changed.items():
            arrays[field] = getattr(dispatch, field).copy()
            arrays[field][t : t + 1] = values
        return replace(dispatch, **arrays)


def _left(s_max_kva: Floats, p_kw: Floats, q_kvar: Floats) -> Floats:
    """Reactive power that a disc leaves beside active power, at least what the dispatch has."""
    left = np.sqrt(np.maximum(s_max_kva**2 - p_kw**2, 0.0))
    return np.asarray(np.maximum(left, np.abs(q_kvar)))

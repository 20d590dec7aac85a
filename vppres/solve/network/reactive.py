"""Reactive power of one step with active power held: least flows and least use of inverters.

With active power held every inverter's disc leaves an interval, and only one step is looked at, so
the problem stays small and feasible where the tie-breakers with all of the window are neither.
"""

from __future__ import annotations

from dataclasses import replace

import cvxpy as cp
import numpy as np
import scipy.sparse as sp

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Floats
from vppres.model.beyond_paper.physical import at_far_ends
from vppres.model.data import WindowData
from vppres.model.numerics import require_dpp, write
from vppres.model.objective import squares_of_list
from vppres.model.ratings import limit_kva
from vppres.model.site import Site

ANY_KVAR = 1e6
"""Reactive flow that no line has: a limit for those without a rating."""


class ReactiveModel:
    """Minimise the reactive part of f4 and f5 of a step.

    The voltage is held where the dispatch holds it: at the grid's bus, in an island of physical
    mode at its battery's.

    Parameters
    ----------
    site : Site
        Fixed data.
    """

    def __init__(self, site: Site) -> None:
        net = site.network
        pv = len(site.pv)
        batteries = len(site.batteries)
        self.site = site
        self.Q_pv = cp.Variable(pv, name="Q_pv")
        self.Q_batt = cp.Variable(batteries, name="Q_batt")
        self.Q_grid = cp.Variable(name="Q_grid")
        self.Q_flow = cp.Variable(net.n_lines)
        self.u = cp.Variable(net.n_buses, name="u")
        self.Q_load = cp.Parameter(net.n_buses, name="Q_load")
        self.rise = cp.Parameter(net.n_lines, name="rise")
        self.Q_pv_max = cp.Parameter(pv, name="Q_pv_max", nonneg=True)
        self.Q_batt_max = cp.Parameter(batteries, name="Q_batt_max", nonneg=True)
        self.Q_grid_max = cp.Parameter(name="Q_grid_max", nonneg=True)
        self.u_min, self.u_max = (cp.Parameter(net.n_buses, name=n) for n in ("u_min", "u_max"))
        self.Q_flow_max = cp.Parameter(net.n_lines, name="Q_flow_max", nonneg=True)
        self.held = cp.Parameter(net.n_buses, name="held", nonneg=True)
        self.u_held = cp.Parameter(name="u_held", nonneg=True)
        self.problem = cp.Problem(self._objective(), self._constraints())
        require_dpp(self.problem, "reactive power of a step")

    def _objective(self) -> cp.Minimize:
        """Squared reactive flows and squared use of the inverters, in about kW of loss."""
        site = self.site
        w = self.site.weights
        heaviest = max(w.lambda_l, w.lambda_q) or 1.0
        scale = 1.0 / (1000.0 * site.network.base_kv**2 * heaviest)
        flows = squares_of_list(scale * w.lambda_l * site.network.r_ohm, self.Q_flow)
        of_pv = squares_of_list(scale * w.lambda_q / site.pv.s_max_kva**2, self.Q_pv)
        of_batteries = squares_of_list(
            scale * w.lambda_q / site.batteries.s_max_kva**2, self.Q_batt
        )
        return cp.Minimize(flows + of_pv + of_batteries)

    def _constraints(self) -> list[cp.Constraint]:
        """Balance and voltage of every bus, limits of inverters and of the grid."""
        site = self.site
        net = site.network
        slack = sp.csr_array(([1.0], ([0], [0])), shape=(net.n_buses, 1))
        given = (
            site.pv_bus @ self.Q_pv
            + site.battery_bus @ self.Q_batt
            + slack @ cp.reshape(self.Q_grid, (1,), order="C")
        )
        drop = 2.0 * cp.multiply(net.x_pu2_per_kvar, self.Q_flow)
        return [
            given + net.incidence @ self.Q_flow == self.Q_load,
            self.held @ self.u == self.u_held,
            100.0 * (self.u[1:] - self.u[net.parent] + drop) == 100.0 * self.rise,
            self.u >= self.u_min,
            self.u <= self.u_max,
            *self._ratings(),
            self.Q_pv <= self.Q_pv_max,
            self.Q_pv >= -self.Q_pv_max,
            self.Q_batt <= self.Q_batt_max,
            self.Q_batt >= -self.Q_batt_max,
            self.Q_grid <= self.Q_grid_max,
            self.Q_grid >= -self.Q_grid_max,
        ]

    def _ratings(self) -> list[cp.Constraint]:
        """What the ratings of lines leave beside their active flows."""
        if not self.site.rated:
            return []
        return [self.Q_flow <= self.Q_flow_max, self.Q_flow >= -self.Q_flow_max]

    def fill(self, data: WindowData, dispatch: Dispatch, t: int) -> None:
        """Write step ``t`` of a dispatch; a limit that it misses by a tolerance gives way."""
        site = self.site
        net = self.site.network
        u = net.u_pu2(dispatch.v_pu[t])
        load = site.customer_bus @ (data.load_kw[t] * dispatch.served[t] * site.customers.q_per_p)
        if data.drawn is not None:
            load = load + data.drawn.kvar[t]
        rating = site.batteries.s_max_kva
        held = 0
        if data.physics is not None:
            load = load + at_far_ends(data.physics.loss_kvar)[t]
            rating = rating - data.physics.headroom_kw[t]
            held = int(data.physics.reference[t])
        write(self.Q_load, load)
        write(self.held, np.eye(net.n_buses)[held])
        write(self.u_held, u[held])
        write(self.rise, data.delta_pu2[t] - 2.0 * net.r_pu2_per_kw * dispatch.p_flow_kw[t])
        of_pv_kw = dispatch.pv_self_kw[t] + dispatch.pv_export_kw[t]
        write(self.Q_pv_max, _left(site.pv.s_max_kva, of_pv_kw, dispatch.pv_q_kvar[t]))
        rated_kva = np.broadcast_to(limit_kva(data), dispatch.p_flow_kw.shape)[t]
        q_flow_max = _left(rated_kva, dispatch.p_flow_kw[t], dispatch.q_flow_kvar[t])
        write(self.Q_flow_max, np.minimum(q_flow_max, ANY_KVAR))
        net_kw = dispatch.charge_kw[t] - dispatch.discharge_kw[t]
        write(self.Q_batt_max, _left(rating, net_kw, dispatch.batt_q_kvar[t]))
        write(self.Q_grid_max, data.grid_q_max_kvar(site)[t])
        lowest, highest = data.u_limits_pu2(net)
        write(self.u_min, np.minimum(u, lowest[t]))
        write(self.u_max, np.maximum(u, highest[t]))

    def put_into(self, dispatch: Dispatch, t: int) -> Dispatch:
        """The dispatch with the solution of the last solve in step ``t``."""
        changed = {
            "pv_q_kvar": self.Q_pv.value,
            "batt_q_kvar": self.Q_batt.value,
            "q_grid_kvar": self.Q_grid.value,
            "q_flow_kvar": self.Q_flow.value,
            "v_pu": self.site.network.v_pu(self.u.value),
        }
        arrays = {}
        for name, values in changed.items():
            arrays[name] = getattr(dispatch, name).copy()
            arrays[name][t] = values
        return replace(dispatch, **arrays)


def _left(s_max_kva: Floats, p_kw: Floats, q_kvar: Floats) -> Floats:
    """Reactive power that a disc leaves beside active power, at least what the dispatch has."""
    left = np.sqrt(np.maximum(s_max_kva**2 - p_kw**2, 0.0))
    return np.asarray(np.maximum(left, np.abs(q_kvar)))

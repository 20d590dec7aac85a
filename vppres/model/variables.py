"""Variables and parameters of a window, with the paper's letters."""

from __future__ import annotations

from typing import Any

import cvxpy as cp
import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Flags, Floats
from vppres.model.data import WindowData
from vppres.model.numerics import LEFT_KW, write
from vppres.model.site import Site

FIELDS = {
    "P_self": "pv_self_kw",
    "P_exp": "pv_export_kw",
    "P_curt": "pv_curtailed_kw",
    "Q_pv": "pv_q_kvar",
    "P_ch": "charge_kw",
    "P_dch": "discharge_kw",
    "Q_batt": "batt_q_kvar",
    "SoC": "soc",
    "P_grid": "p_grid_kw",
    "Q_grid": "q_grid_kvar",
    "u": "v_pu",
    "P_flow": "p_flow_kw",
    "Q_flow": "q_flow_kvar",
}
"""Field of a dispatch for each letter; voltages of ``u`` squared."""


class Parameters:
    """Parameters that a re-solve may change (W steps).

    What stands at None is nothing of the paper: demand that is added at the buses, (W, N), and
    behind the meters of PV systems, (W, P), power besides import and PV export from which batteries
    charge, (W,), ratings and lowest states of charge that change with the steps, (W, B), and energy
    that is left for later besides that of batteries. What a window has beyond the paper sets them.
    Of a feeder with phases ``by_asset`` is what each asset draws, in kW and kvar, (W, D) each.
    """

    def __init__(self, site: Site, W: int) -> None:
        C, P, B = len(site.customers), len(site.pv), len(site.batteries)
        L = site.network.n_lines

        def number(name: str, *shape: int, signed: bool = False) -> cp.Parameter:
            return cp.Parameter(shape, name=name, nonneg=not signed)

        self.P_load = number("P_load", W, C)
        self.Q_load = number("Q_load", W, C, signed=bool((site.customers.q_per_p < 0).any()))
        self.P_pv = number("P_pv", W, P)
        self.P_self_max = number("P_self_max", W, P)
        self.rho_dt = number("rho_dt", W, signed=True)
        self.P_grid_max = number("P_grid_max", W)
        self.Q_grid_max = number("Q_grid_max", W)
        self.SoC_0 = number("SoC_0", B)
        self.eta_ch = number("eta_ch", W, B)
        self.inv_eta_dch = number("inv_eta_dch", W, B)
        self.delta = number("delta", W, L, signed=True)
        self.u_min = number("u_min", W, L)
        self.u_max = number("u_max", W, L)
        self.P_added: cp.Expression | None = None
        self.Q_added: cp.Expression | None = None
        self.P_self_added: cp.Expression | None = None
        self.P_fed_added: cp.Expression | None = None
        self.S_max: cp.Expression | None = None
        self.SoC_min: cp.Expression | None = None
        self.E_kept_added: cp.Expression | None = None
        self.by_asset: tuple[cp.Expression, cp.Expression] | None = None

    def fill(self, site: Site, data: WindowData) -> None:
        """Write a window's data: all values are computed first, then all are written."""
        W = data.n_steps
        u_min, u_max = data.u_limits_pu2(site.network)
        values = {
            "P_load": data.load_kw,
            "Q_load": data.load_kw * site.customers.q_per_p,
            "P_pv": data.pv_kw,
            "P_self_max": data.self_limit_kw(site),
            "rho_dt": data.price_gbp_per_kwh * site.dt_h,
            "P_grid_max": data.grid_p_max_kw(site),
            "Q_grid_max": data.grid_q_max_kvar(site),
            "SoC_0": data.soc,
            "eta_ch": np.tile(data.eta_charge, (W, 1)),
            "inv_eta_dch": np.tile(1.0 / data.eta_discharge, (W, 1)),
            "delta": data.delta_pu2,
            "u_min": u_min[:, 1:],
            "u_max": u_max[:, 1:],
        }
        for name, value in values.items():
            write(getattr(self, name), value)


class Variables:
    """Decision variables of a window of W steps (paper, Table "Optimization Variables").

    ``u`` is the squared voltage, referred to the slack bus where lines have ratios; bus 0 is the
    slack bus, line ``l`` ends at bus ``l + 1``.
    """

    def __init__(self, site: Site, W: int) -> None:
        C, P, B = len(site.customers), len(site.pv), len(site.batteries)
        N, L = site.network.n_buses, site.network.n_lines

        def nonneg(name: str, *shape: int) -> cp.Variable:
            return cp.Variable(shape, name=name, nonneg=True)

        def free(name: str, *shape: int) -> cp.Variable:
            return cp.Variable(shape, name=name)

        self.P_ch = nonneg("P_ch", W, B)
        self.P_dch = nonneg("P_dch", W, B)
        self.x_served = cp.Variable((W, C), name="x_served", boolean=True)
        self.P_self = nonneg("P_self", W, P)
        self.P_exp = nonneg("P_exp", W, P)
        self.P_curt = nonneg("P_curt", W, P)
        self.Q_pv = free("Q_pv", W, P)
        self.delta = cp.Variable((W, B), name="delta", boolean=True)
        self.P_batt = self.P_ch - self.P_dch  # (1)
        self.Q_batt = free("Q_batt", W, B)
        self.SoC = free("SoC", W + 1, B)
        self.P_grid = nonneg("P_grid", W)
        self.Q_grid = free("Q_grid", W)
        self.u = nonneg("u", W, N)
        self.P_flow = free("P_flow", W, L)
        self.Q_flow = free("Q_flow", W, L)

    def dispatch(self, site: Site, served: Flags | None = None) -> Dispatch:
        """The solution as arrays, cleaned of solver noise."""

        def clean(variable: cp.Expression, lower: float = -np.inf) -> Floats:
            if variable.value is None:  # not part of this form
                return np.full(variable.shape, np.nan)
            # cvxpy drops the second dimension of an empty expression's value.
            value = np.reshape(np.asarray(variable.value, dtype=float), variable.shape)
            return np.maximum(np.where(np.abs(value) < LEFT_KW, 0.0, value), lower)

        b = site.batteries
        values: dict[str, Any] = {
            "served": np.asarray(self.x_served.value) > 0.5 if served is None else served
        }
        for letter, field in FIELDS.items():
            x = getattr(self, letter)
            values[field] = clean(x, 0.0 if x.is_nonneg() else -np.inf)
        values["soc"] = np.clip(values["soc"], b.soc_min, b.soc_max)
        values["v_pu"] = site.network.v_pu(values["v_pu"])
        return Dispatch(**values)

"""What a window's problem is made of: fixed site data, and the data that change at every step."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from vppres.assets import Batteries, Customers, PVSystems
from vppres.errors import ModelError
from vppres.frozen import content_key
from vppres.model.moves import Moves
from vppres.model.switching import SwitchingData
from vppres.network import Network
from vppres.scenario import ObjectiveWeights, Scenario

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Site:
    """What stays the same from step to step: network, assets, weights and step length."""

    network: Network
    customers: Customers
    pv: PVSystems
    batteries: Batteries
    weights: ObjectiveWeights
    dt_h: float

    @classmethod
    def of(cls, scenario: Scenario) -> Site:
        """Site of a scenario."""
        return cls(scenario.network, scenario.customers, scenario.pv, scenario.batteries,
                   scenario.objective, scenario.grid.dt_h)

    @cached_property
    def key(self) -> str:
        """Digest of the content: sites of equal content have equal problems."""
        return f"{self.dt_h} " + content_key(self.weights, self.network, self.customers, self.pv,
                                             self.batteries)

    @cached_property
    def customer_bus(self) -> sp.csr_array:
        """Shape (N, C): places customers on their buses."""
        return self.network.place(self.customers.bus)

    @cached_property
    def battery_bus(self) -> sp.csr_array:
        """Shape (N, B): places batteries on their buses."""
        return self.network.place(self.batteries.bus)

    @cached_property
    def owner(self) -> NDArray[np.int64]:
        """Shape (P,): position of each PV system's customer."""
        return self.pv.owner(self.customers)

    @cached_property
    def pv_customer(self) -> sp.csr_array:
        """Shape (C, P): places PV systems on their customers."""
        count = len(self.pv)
        return sp.csr_array((np.ones(count), (self.owner, np.arange(count))),
                            shape=(len(self.customers), count))

    @cached_property
    def pv_bus(self) -> sp.csr_array:
        """Shape (N, P): places PV systems on their owners' buses."""
        return sp.csr_array(self.customer_bus @ self.pv_customer)


@dataclass(frozen=True, eq=False)
class Physics:
    """What physical mode adds to a window of W steps.

    Parameters
    ----------
    loss_kw, loss_kvar : array, shape (W, L)
        Losses of the lines at the AC points the window is linearised at, not negative.
    reference : array of int, shape (W,)
        Bus that holds the voltage: 0, the grid's, or a grid-forming battery's.
    headroom_kw : array, shape (W, B)
        Power that is kept free in both directions.
    soc_reserve : array, shape (W, B)
        State of charge that is kept above ``soc_min`` at the end of each step.
    """

    loss_kw: Floats
    loss_kvar: Floats
    reference: NDArray[np.int64]
    headroom_kw: Floats
    soc_reserve: Floats

    def first(self, n_steps: int) -> Physics:
        """The first steps."""
        return Physics(*(getattr(self, f.name)[:n_steps] for f in fields(self)))


@dataclass(frozen=True, eq=False)
class WindowData:
    """What changes with every solve, for a window of W steps.

    Parameters
    ----------
    load_kw : array, shape (W, C)
        Forecast demand.
    pv_kw : array, shape (W, P)
        Forecast available PV power.
    price_gbp_per_kwh : array, shape (W,)
        Import price.
    grid_limit_kw : array, shape (W,)
        Largest import, 0 in an outage, may be infinite.
    soc : array, shape (B,)
        State of charge at the beginning of the window.
    eta_charge, eta_discharge : array, shape (B,)
        Efficiencies, held over the window (paper, Section 5.2).
    delta_pu2 : array, shape (W, L)
        Right-hand side of the delta form of LinDistFlow; zero gives plain LinDistFlow.
    physics : Physics, optional
        Losses, island and headroom of physical mode; None is the paper's problem.
    switching : SwitchingData, optional
        Rules on switching customers; None is the paper.
    moves : Moves, optional
        The previous plan, where moves away from it are to be few; None is the paper.
    """

    load_kw: Floats
    pv_kw: Floats
    price_gbp_per_kwh: Floats
    grid_limit_kw: Floats
    soc: Floats
    eta_charge: Floats
    eta_discharge: Floats
    delta_pu2: Floats
    physics: Physics | None = None
    switching: SwitchingData | None = None
    moves: Moves | None = None

    @property
    def physical(self) -> bool:
        """Whether the window's problem is that of physical mode."""
        return self.physics is not None

    def require_physics(self) -> Physics:
        """The physics of a window that must have one.

        Raises
        ------
        ModelError
            If it has none.
        """
        if self.physics is None:
            raise ModelError("A physical problem was filled with a window of the paper's mode.")
        return self.physics

    @property
    def n_steps(self) -> int:
        """Steps W of the window."""
        return len(self.price_gbp_per_kwh)

    def first(self, n_steps: int) -> WindowData:
        """The first steps of the window."""
        cut = {name: getattr(self, name)[:n_steps] for name in
               ("load_kw", "pv_kw", "price_gbp_per_kwh", "grid_limit_kw", "delta_pu2")}
        return replace(self, **cut, physics=self.physics and self.physics.first(n_steps),
                       switching=self.switching and self.switching.first(n_steps),
                       moves=self.moves and self.moves.first(n_steps))

    @property
    def loss_kw(self) -> Floats:
        """Losses of all lines, (W,); zero in the paper's mode."""
        return (np.zeros(self.n_steps) if self.physics is None
                else np.asarray(self.physics.loss_kw.sum(axis=1)))

    def for_service(self, served: NDArray[np.bool_]) -> WindowData:
        """The window with the demand that a service brings about: higher after a restoration."""
        if self.switching is None or not self.switching.steps.cold:
            return self
        return replace(self, load_kw=self.load_kw * self.switching.demand_factor(served))

    def all_cold(self) -> WindowData:
        """The window with the largest demand that any service can bring about."""
        if self.switching is None or not self.switching.steps.cold:
            return self
        return replace(self, load_kw=self.load_kw * self.switching.cold_factor)

    def self_limit_kw(self, site: Site) -> Floats:
        """Self-consumption of each PV system if its owner is served, shape (W, P)."""
        return np.minimum(self.load_kw[:, site.owner], self.pv_kw)

    def grid_p_max_kw(self, site: Site) -> Floats:
        """Largest import that can ever be useful, or the limit where that is smaller, (W,).

        Nothing can be exported, so no more than all demand and all charging is ever imported.
        """
        useful = (self.all_cold().load_kw.sum(axis=1) + site.batteries.p_max_kw.sum()
                  + self.loss_kw)
        return np.asarray(np.minimum(np.maximum(self.grid_limit_kw, 0.0), useful))

    def grid_q_max_kvar(self, site: Site) -> Floats:
        """Largest reactive exchange with the grid that devices and loads allow, (W,)."""
        possible = (self.all_cold().load_kw @ site.customers.q_per_p
                    + site.batteries.s_max_kva.sum() + site.pv.s_max_kva.sum())
        if self.physics is not None:
            possible = possible + self.physics.loss_kvar.sum(axis=1)
        return np.where(self.grid_limit_kw > 0.0, possible, 0.0)


@dataclass(frozen=True, eq=False)
class Dispatch:
    """A dispatch of W steps as plain arrays, after the paper's Table "Optimization Variables".

    ``soc`` has one row more than the steps: row 0 is the state at the beginning of the window. The
    dispatch of a form without network has NaN in place of reactive power, flows and voltages.
    """

    served: NDArray[np.bool_]
    pv_self_kw: Floats
    pv_export_kw: Floats
    pv_curtailed_kw: Floats
    pv_q_kvar: Floats
    charge_kw: Floats
    discharge_kw: Floats
    batt_q_kvar: Floats
    soc: Floats
    p_grid_kw: Floats
    q_grid_kvar: Floats
    v_pu: Floats
    p_flow_kw: Floats
    q_flow_kvar: Floats

    @property
    def n_steps(self) -> int:
        """Number of steps W."""
        return len(self.p_grid_kw)


@dataclass(frozen=True)
class Terms:
    """The terms of the objective (paper, Section 3.3), summed over a window.

    ``f6`` is the price of switching actions in weighted customer hours, which the paper has not.
    """

    f1: float
    f2: float
    f3: float
    f4: float
    f5: float
    f6: float = 0.0

    def total(self, weights: ObjectiveWeights) -> float:
        """The objective F."""
        return (self.upper_levels(weights)
                - weights.lambda_l * self.f4 - weights.lambda_q * self.f5)

    def upper_levels(self, weights: ObjectiveWeights) -> float:
        """F without the two tie-breakers; never below F, since f4 and f5 are not negative."""
        return (self.f1 - weights.lambda_grid * self.f2 - weights.lambda_curt * self.f3
                - self.f6)


def evaluate(site: Site, data: WindowData, dispatch: Dispatch) -> Terms:
    """Objective terms of a dispatch, recomputed from its arrays."""
    flow2 = dispatch.p_flow_kw**2 + dispatch.q_flow_kvar**2
    use = np.square(dispatch.pv_q_kvar / site.pv.s_max_kva).sum()
    use += np.square(dispatch.batt_q_kvar / site.batteries.s_max_kva).sum()
    return Terms(
        f1=float((dispatch.served @ site.customers.weight).sum() * site.dt_h),
        f2=float(data.price_gbp_per_kwh @ dispatch.p_grid_kw * site.dt_h),
        f3=float(dispatch.pv_curtailed_kw.sum() * site.dt_h),
        f4=float((flow2 @ site.network.r_ohm).sum()),
        f5=float(use),
        f6=data.switching.price(dispatch.served) if data.switching else 0.0,
    )

"""Lumped relaxation: all customers and one PV system on one bus, with a fleet of batteries.

The fleet is one lumped battery, or every battery by itself but without its binary: slower, and
exact where batteries differ in efficiency or state.

Every inequality holds for the sums of any feasible dispatch of the true problem, so the optimum is
an upper bound on the true optimum; ``docs/method.md`` has the proof of each.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from fractions import Fraction

import cvxpy as cp
import numpy as np

from vppres.contract.stored_value import Ending
from vppres.contract.switching import RuleSteps
from vppres.core.arrays import Floats
from vppres.model.beyond_paper.ends import end_of_window, f2_at_end, f7_at_end
from vppres.model.beyond_paper.export import ExportToGrid
from vppres.model.beyond_paper.physical import active_room_kw
from vppres.model.beyond_paper.stored_value import ValueAtEnd
from vppres.model.beyond_paper.switching import SwitchingModel, cold_demand
from vppres.model.data import WindowData
from vppres.model.formulas import charge_to_kw, discharge_to_kw
from vppres.model.lumped import counts_of_alike
from vppres.model.numerics import objective_scale, require_dpp, write
from vppres.model.site import Site

LEAST_KW = 1e-3
"""A first step's largest charge or discharge below this has no part in a ratio."""


class AggregateModel:
    """The lumped relaxation over W steps, with one binary for each customer and step.

    Parameters
    ----------
    site : Site
        Fixed data.
    n_steps : int
        Steps W of the window.
    integer : bool
        Whether service is all or nothing; without it the problems are linear and weaker bounds.
    lumped : bool
        Whether the fleet is one battery.
    physical : bool
        Whether losses and headroom are part of it.
    switching : RuleSteps, optional
        Shape of the switching rules; None has none.
    exporting : bool
        Whether export is part of it. Without a binary for its direction more import can always
        meet one more customer.

    Attributes
    ----------
    problem : cvxpy.Problem
        Maximises f1, f2 and f3 as weighted, times the objective's scale.
    cost_problem : cvxpy.Problem
        Minimises the cost (GBP) of all served sets whose f1 and f3 reach ``service_min``.
    grid_problem : cvxpy.Problem
        Maximises f1 and f3 in units of ``grid``, f3 rounded in favour.
    grid : float
        Largest number of which every weight is a multiple, 0 if there is none worth using.
    """

    def __init__(
        self,
        site: Site,
        n_steps: int,
        integer: bool = True,
        lumped: bool = True,
        physical: bool = False,
        switching: RuleSteps | None = None,
        exporting: bool = False,
        ending: Ending = "",
    ) -> None:
        self.site = site
        self.n_steps = n_steps
        self.lumped = lumped
        self.grid = weight_grid(site.customers.weight * site.dt_h)
        self.x = cp.Variable((n_steps, len(site.customers)), name="x_served", boolean=integer)
        self.v = self._variables()
        self.p = self._parameters()
        self.export: ExportToGrid | None = None
        if exporting:
            self.export = ExportToGrid.create(n_steps, "relaxed")
        self.terminal = end_of_window(ending, self._groups)
        self.room = self._room_parameters() if physical else {}
        self.rho_dt = cp.Parameter(n_steps, name="rho_dt")
        self.service_min = cp.Parameter(name="service_min")
        self.switching: SwitchingModel | None = None
        if switching:
            self.switching = SwitchingModel(site, self.x, switching)
        self.energy = self._energy()
        self.constraints = self._power() | self.energy
        if integer:
            self.constraints = self.constraints | counts_of_alike(site, self.x)
        if self.switching is not None:
            self.constraints = self.constraints | self.switching.constraints
        self.problem = self._weighted_problem()
        self.cost_problem = self._cost_problem()
        self.grid_problem = self._grid_problem()
        for problem in (self.problem, self.cost_problem, self.grid_problem):
            require_dpp(problem, f"lumped window of {n_steps} steps")

    @property
    def _groups(self) -> int:
        """Batteries G that the problem tells apart."""
        return 1 if self.lumped else len(self.site.batteries)

    def _variables(self) -> dict[str, cp.Variable]:
        """Powers in kW by their names; stored and drawn are powers at the cells."""
        W = self.n_steps
        G = self._groups
        shapes = {
            "P_ch": (W, G),
            "P_dch": (W, G),
            "stored": (W, G),
            "drawn": (W, G),
            "P_curt": (W,),
            "P_grid": (W,),
        }
        return {name: cp.Variable(shape, name=name, nonneg=True) for name, shape in shapes.items()}

    def _parameters(self) -> dict[str, cp.Parameter]:
        """What a window writes: powers in kW, energies in kWh, shares and efficiencies."""
        W = self.n_steps
        C = len(self.site.customers)
        G = self._groups
        shapes = {
            "P_load": (W, C),
            "self": (W, C),
            "P_pv": (W,),
            "P_grid_max": (W,),
            "curt_min": (W,),
            "E_0": (W, G),
            "x_max": (W, C),
            "x_min": (W, C),
            "eta_lo": (W, G),
            "eta_hi": (W, G),
            "inv_lo": (W, G),
            "inv_hi": (W, G),
            "a": (G,),
            "b": (G,),
            "a_per_b": (G,),
            "b_per_a": (G,),
        }
        found = _nonnegative(shapes)
        if self.site.network.draws:
            found["network_drawn"] = cp.Parameter(W, name="network_drawn")
        return found

    @property
    def network_kw(self) -> cp.Expression | float:
        """Losses, and what the network itself draws; 0 where there is neither."""
        parts = [self.room["loss"]] if self.room else []
        parts += [self.p["network_drawn"]] if "network_drawn" in self.p else []
        return sum(parts[1:], start=parts[0]) if parts else 0.0

    def _room_parameters(self) -> dict[str, cp.Parameter]:
        """What physical mode writes besides: losses, and the batteries' limits less headroom."""
        W = self.n_steps
        G = self._groups
        return _nonnegative({"loss": (W,), "E_min": (W, G), "P_room": (W, G)})

    def cost(self) -> cp.Expression:
        """f2 in GBP."""
        spent = self.rho_dt @ self.v["P_grid"]
        if self.export is not None:
            spent = spent - self.export.f2_revenue
        if self.terminal is not None:
            spent = spent + f2_at_end(self.terminal)
        return spent

    def _curtailment(self) -> cp.Expression:
        """f3 as weighted."""
        weight = self.site.weights.lambda_curt
        return weight * self.site.dt_h * cp.sum(self.v["P_curt"])

    def _service(self) -> cp.Expression:
        """f1 less f3 as weighted, and less the price of switching."""
        f1 = self.site.dt_h * cp.sum(self.x @ self.site.customers.weight)
        service = f1 - self._curtailment()
        if self.switching is not None:
            service = service - self.switching.f6_switching
        if isinstance(self.terminal, ValueAtEnd):
            service = service + f7_at_end(self.terminal)
        return service

    def _weighted_problem(self) -> cp.Problem:
        """Service and cost as weighted."""
        total = self._service() - self.site.weights.lambda_grid * self.cost()
        return cp.Problem(
            cp.Maximize(objective_scale(self.site) * total), list(self.constraints.values())
        )

    def _cost_problem(self) -> cp.Problem:
        """Cost where service is held, in units of the weights' grid: a number near 1."""
        enough = (self._service() - self.service_min) / (self.grid or 1.0) >= 0
        return cp.Problem(cp.Minimize(self.cost()), [*self.constraints.values(), enough])

    def _grid_problem(self) -> cp.Problem:
        """Service in units of the weights' grid, with an objective that is always a whole number.

        Whole numbers let a solver round its bound, which is most of the proof. The penalty of
        curtailment is rounded down to a whole number, so that the optimum stays an upper bound.
        """
        if not self.grid:
            return self.problem
        units = np.round(self.site.customers.weight * self.site.dt_h / self.grid)
        penalty = cp.Variable(name="penalty", integer=self.x.attributes["boolean"], nonneg=True)
        total = cp.sum(self.x @ units) - penalty
        if self.switching is not None:
            # A whole number too, or the problem is not used: see whole_price.
            total = total - self.switching.f6_switching / self.grid
        if isinstance(self.terminal, ValueAtEnd):
            # No whole number where it counts as service: see Binaries.service.
            total = total + f7_at_end(self.terminal) / self.grid
        rounded = penalty >= self._curtailment() / self.grid - 1
        return cp.Problem(cp.Maximize(total), [*self.constraints.values(), rounded])

    def _power(self) -> dict[str, cp.Constraint]:
        """Sums of the power balances and limits."""
        v = self.v
        p = self.p
        x = self.x
        load = cp.sum(cp.multiply(p["P_load"], x), axis=1)
        if self.room or "network_drawn" in self.p:
            load = load + self.network_kw
        own = cp.sum(cp.multiply(p["self"], x), axis=1)
        cold = cold_demand(self.switching)
        if cold is not None:
            load = load + cp.sum(cp.multiply(cold.P_cold, cold.z), axis=1)
            own = own + cp.sum(cp.multiply(cold.P_self_cold, cold.z[:, self.site.owner]), axis=1)
        P_ch = cp.sum(v["P_ch"], axis=1)
        P_dch = cp.sum(v["P_dch"], axis=1)
        connection = {"lumped_grid_limit": v["P_grid"] <= p["P_grid_max"]}
        if self.export is not None:
            load = load + self.export.P_out
            connection = self.export.connection(v["P_grid"], p["P_grid_max"])
        return {
            "lumped_balance": v["P_grid"] + p["P_pv"] - v["P_curt"] + P_dch == load + P_ch,
            "lumped_circular_charging": P_dch <= load - own,
            "lumped_curtailment_max": v["P_curt"] <= p["P_pv"] - own,
            "lumped_curtailment_min": v["P_curt"] >= p["curt_min"],
            **connection,
            "lumped_service": x <= p["x_max"],
            "lumped_connected_service": x >= p["x_min"],
        }

    def _energy(self) -> dict[str, cp.Constraint]:
        """Sums of the SoC recursions and of the limits that exclusivity implies."""
        v = self.v
        p = self.p
        b = self.site.batteries
        dt = self.site.dt_h
        e_min = self._fleet(b.energy_kwh * b.soc_min)[None, :]
        e_max = self._fleet(b.energy_kwh * b.soc_max)[None, :]
        least = e_min
        power_max = self._fleet(b.active_max_kw)[None, :]
        if self.room:
            least = self.room["E_min"]
            power_max = self.room["P_room"]
        triangle = np.tril(np.ones((self.n_steps, self.n_steps)))
        energy = p["E_0"] + dt * (triangle @ (v["stored"] - v["drawn"]))
        before = energy - dt * (v["stored"] - v["drawn"])
        # A fleet misses no more than its batteries do: what one has too much counts for others.
        held = {} if self.terminal is None else self.terminal.reached(energy[-1])
        return held | {
            "lumped_energy_min": energy >= least,
            "lumped_energy_max": energy <= e_max,
            "lumped_room": before + dt * v["stored"] <= e_max,
            "lumped_reserve": before - dt * v["drawn"] >= e_min,
            "lumped_power": v["P_ch"] + v["P_dch"] <= power_max,
            "lumped_stored_min": v["stored"] >= cp.multiply(p["eta_lo"], v["P_ch"]),
            "lumped_stored_max": v["stored"] <= cp.multiply(p["eta_hi"], v["P_ch"]),
            "lumped_drawn_min": v["drawn"] >= cp.multiply(p["inv_lo"], v["P_dch"]),
            "lumped_drawn_max": v["drawn"] <= cp.multiply(p["inv_hi"], v["P_dch"]),
            "lumped_first_charge": v["P_ch"][0] + cp.multiply(p["a_per_b"], v["P_dch"][0])
            <= p["a"],
            "lumped_first_discharge": v["P_dch"][0] + cp.multiply(p["b_per_a"], v["P_ch"][0])
            <= p["b"],
        }

    def _fleet(self, values: Floats) -> Floats:
        """Sum over the batteries where they are lumped, (G,)."""
        return np.atleast_1d(values.sum()) if self.lumped else values

    def _range(self, values: Floats) -> tuple[Floats, Floats]:
        """Smallest and largest value of each group over all steps, (W, G) each."""
        if self.lumped and len(values):
            low = values.min(keepdims=True)
            high = values.max(keepdims=True)
        else:
            low = high = values if not self.lumped else np.ones(1)
        return np.tile(low, (self.n_steps, 1)), np.tile(high, (self.n_steps, 1))

    def fill(self, data: WindowData, all_connected: bool = False) -> None:
        """Write the window's data.

        With ``all_connected`` everyone who can be is served where the import has no limit. That
        loses no service: more import serves them, and no battery notices.
        """
        site = self.site
        b = self.site.batteries
        limit = data.self_limit_kw(site)
        eta_lo, eta_hi = self._range(data.eta_charge)
        inv_lo, inv_hi = self._range(1.0 / data.eta_discharge)
        # An owner whose self-consumption exceeds the inverter's rating cannot be served.
        blocked = (limit > site.pv.s_max_kva + 1e-9) @ site.pv_customer.T > 0
        x_max = np.where(blocked, 0.0, 1.0)
        unlimited = all_connected & np.isinf(data.grid_limit_kw)
        connected = (
            unlimited[:, None] if data.switching is None else data.switching.connected(unlimited)
        )
        values = {
            "P_load": data.load_kw,
            "self": limit @ site.pv_customer.T,
            "P_pv": data.pv_kw.sum(axis=1),
            "P_grid_max": data.grid_p_max_kw(site),
            "curt_min": np.maximum(data.pv_kw - site.pv.s_max_kva, 0.0).sum(axis=1),
            "E_0": np.tile(self._fleet(b.energy_kwh * data.soc), (self.n_steps, 1)),
            "x_max": x_max,
            "x_min": x_max * connected,
            "eta_lo": eta_lo,
            "eta_hi": eta_hi,
            "inv_lo": inv_lo,
            "inv_hi": inv_hi,
            **self._first_step(data),
        }
        if data.drawn is not None:
            values["network_drawn"] = data.drawn.kw.sum(axis=1)
        for name, value in values.items():
            write(self.p[name], value)
        if self.room:
            self._fill_room(data)
        if self.export is not None:
            self.export.fill(site, data)
        if isinstance(self.terminal, ValueAtEnd):
            self.terminal.fill(data.require_value())
        elif self.terminal is not None and data.terminal is not None:
            target_kwh = self._fleet(data.terminal.target_kwh(site.batteries))
            self.terminal.fill(target_kwh, data.terminal.price_gbp_per_kwh)
        write(self.rho_dt, data.price_gbp_per_kwh * site.dt_h)
        if self.switching:
            self.switching.fill(data)

    def _fill_room(self, data: WindowData) -> None:
        """Write losses, and the batteries' limits less their headroom."""
        b = self.site.batteries
        physics = data.require_physics()
        e_min = b.energy_kwh * (b.soc_min + physics.soc_reserve)
        limits = {"E_min": e_min, "P_room": active_room_kw(self.site, physics)}
        write(self.room["loss"], data.loss_kw)
        for name, value in limits.items():
            write(self.room[name], value.sum(axis=1, keepdims=True) if self.lumped else value)

    def _first_step(self, data: WindowData) -> dict[str, Floats]:
        """Limits of the first step, where the SoC is known, (G,) each.

        With ``a`` and ``b`` a battery's largest charge and discharge, exclusivity implies
        ``ch/a + dch/b <= 1``; summed over a group with its smallest ratio it stays valid.
        """
        b = self.site.batteries
        dt_h = self.site.dt_h
        limit = b.active_max_kw
        least = b.soc_min
        if data.physics is not None:
            limit = active_room_kw(self.site, data.physics)[0]
            least = least + data.physics.soc_reserve[0]
        until_full = charge_to_kw(b.soc_max, data.soc, data.eta_charge, b, dt_h)
        until_empty = discharge_to_kw(least, data.soc, data.eta_discharge, b, dt_h)
        charge = np.minimum(limit, until_full)
        discharge = np.minimum(limit, until_empty)
        # A ratio of next to nothing says nothing, and is no number a solver can work with.
        both = (charge > LEAST_KW) & (discharge > LEAST_KW)
        a_per_b = np.divide(charge, discharge, where=both, out=np.zeros_like(charge))
        b_per_a = np.divide(discharge, charge, where=both, out=np.zeros_like(charge))
        if self.lumped:
            a_per_b, b_per_a = (
                np.atleast_1d(r.min(initial=np.inf) if len(r) else 0.0) for r in (a_per_b, b_per_a)
            )
        return {
            "a": self._fleet(charge),
            "b": self._fleet(discharge),
            "a_per_b": a_per_b,
            "b_per_a": b_per_a,
        }


def _nonnegative(shapes: Mapping[str, tuple[int, ...]]) -> dict[str, cp.Parameter]:
    """Parameters of some names and shapes that are never negative."""
    return {name: cp.Parameter(shape, name=name, nonneg=True) for name, shape in shapes.items()}


def whole_price(data: WindowData, grid: float) -> bool:
    """Whether an off/on pair costs a multiple of the weights' grid, or nothing."""
    pair = 0.0 if data.switching is None else data.switching.price_of_pair
    return pair == 0.0 or (grid > 0 and abs(pair / grid - round(pair / grid)) < 1e-9)


MOST_PARTS = 10_000
"""Parts of one that weights may have in common."""

MOST_UNITS = 1e6
"""Units of the largest weight, as in strict priority: beyond it a tolerance reaches a unit."""


def weight_grid(weights: Floats) -> float:
    """Largest number of which all weights are multiples, 0 if the largest needs too many.

    >>> weight_grid(np.array([1.0, 0.1, 0.02]))
    0.02
    """
    parts = [Fraction(float(w)).limit_denominator(MOST_PARTS) for w in np.unique(weights) if w > 0]
    if not parts:
        return 0.0
    common = math.lcm(*(part.denominator for part in parts))
    unit = Fraction(math.gcd(*(int(part * common) for part in parts)), common)
    exact = all(
        math.isclose(float(part), w, rel_tol=1e-12, abs_tol=1e-12)
        for part, w in zip(parts, [w for w in np.unique(weights) if w > 0], strict=True)
    )
    return float(unit) if exact and max(parts) / unit <= MOST_UNITS else 0.0

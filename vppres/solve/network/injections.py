"""The whole problem without lines and buses: devices and balances, and rows for what is left out.

Lossless flows are sums of injections, so squared voltages are linear in them. Few voltage limits
and few inverter discs bind, so their rows are made where a solution violates them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Flags, Floats, Wholes
from vppres.model.beyond_paper.physical import taken_by_network
from vppres.model.data import WindowData
from vppres.model.formulas import lossless_flows
from vppres.model.site import Site
from vppres.solve.network.reactance import Reactance
from vppres.solve.network.rows import PER_PU2, SOLVED, Rows
from vppres.solve.network.rules import LETTERS

SOLVER_KVA = 5e-7
"""By how much a disc may be exceeded in any case: a solver meets its tangents no better, and of an
inverter of 1 W would be asked for ever."""


# Columns of devices, (W, k), their buses, (k,), and what a unit of a column gives in kW or kvar.
Given = tuple[Wholes, Wholes, Floats | float]


@dataclass(frozen=True, eq=False)
class Demand:
    """What customers draw if they are served.

    Parameters
    ----------
    net_kw, kvar : array, shape (W, C)
        Demand at their buses less self-consumption, and reactive demand.
    own_kw : array, shape (W, P)
        Self-consumption of each PV system's owner.
    """

    net_kw: Floats
    kvar: Floats
    own_kw: Floats

    @classmethod
    def of(cls, site: Site, data: WindowData) -> Demand:
        """The demand of a window."""
        own_kw = data.self_limit_kw(site)
        net_kw = data.load_kw - own_kw @ site.pv_customer.T
        return cls(net_kw, data.load_kw * site.customers.q_per_p, own_kw)

    def beyond(self, other: Demand) -> Demand:
        """What this is more than another."""
        return Demand(
            self.net_kw - other.net_kw, self.kvar - other.kvar, self.own_kw - other.own_kw
        )


class Injections:
    """A window's variables as columns, and its constraints as rows.

    The columns are arrays of positions with the paper's letters: ``x`` (W, C); ``P_ch``, ``P_dch``,
    ``energy`` (kWh at the end of the step) and ``Q_batt`` (W, B); ``P_exp`` and ``Q_pv`` (W, P);
    ``P_grid``, ``P_out`` and ``Q_grid`` (W, 1), where ``P_out``, the export, has no column if there
    is none; ``missing`` (1, B), the energy that is missing at the end, or (1, 0) where none is
    asked for; ``kept`` (1, 1), what the energy at the end is worth, or (1, 0); with switching rules
    ``on`` and ``off`` (W, C), who is switched, and ``cold`` (W, C), whose demand is higher for a
    restoration, (W, 0) where it never is; ``beyond`` (W, n), steps beyond the longest time off of
    those that have one. Charging and discharging may overlap, and so may import
    and export.

    Parameters
    ----------
    site : Site
        Fixed data.
    reactance : Reactance
        How voltages depend on injections.
    data : WindowData
        The window; losses of physical mode are a demand of the network.
    rules : Rows, optional
        Rows of its switching rules on the columns of ``LETTERS`` side by side, all steps of a
        customer one after the other.
    """

    def __init__(
        self, site: Site, reactance: Reactance, data: WindowData, rules: Rows | None = None
    ) -> None:
        self.site = site
        self.reactance = reactance
        self.data = data
        self.rules = rules
        b = site.batteries
        self.active_kw = data.active_max_kw(b)
        self.radius_kva: Floats = np.tile(b.s_max_kva, (data.n_steps, 1))
        self.reference: Wholes = np.zeros(data.n_steps, dtype=np.int64)
        if data.physics is not None:
            self.radius_kva = b.s_max_kva - data.physics.headroom_kw
            self.reference = data.physics.reference
        self.drawn = taken_by_network(site, data)
        self.size = 0
        self.at: dict[str, Wholes] = {}
        limits = []
        for name, (shape, low, high) in self._letters().items():
            count = math.prod(shape)
            self.at[name] = self.size + np.arange(count).reshape(shape)
            self.size += count
            limits.append(np.stack([np.broadcast_to(each, shape).ravel() for each in (low, high)]))
        self.lower, self.upper = np.hstack(limits)
        self.usual = Demand.of(site, data)
        self.demands = {"x": self.usual}
        if self.at["cold"].size:
            self.demands["cold"] = Demand.of(site, data.all_cold()).beyond(self.usual)

    def _letters(self) -> dict[str, tuple[tuple[int, int], Floats | float, Floats | float]]:
        """Shapes of the letters, and limits of their columns."""
        site = self.site
        data = self.data
        b = site.batteries
        rules = data.switching
        longest = None if rules is None else rules.longest_off
        W = data.n_steps
        of_customers, of_batteries, of_pv, of_grid = (
            (W, count) for count in (len(site.customers), len(b), len(site.pv), 1)
        )
        switched = of_customers if rules is not None and not rules.only_time_off else (W, 0)
        cold = of_customers if rules is not None and rules.steps.cold else (W, 0)
        q_grid = data.grid_q_max_kvar(site)[:, None]
        missing_kwh = np.zeros(0) if data.terminal is None else data.terminal.target_kwh(b)
        return {
            "x": (of_customers, 0.0, 1.0),
            "P_ch": (of_batteries, 0.0, self.active_kw),
            "P_dch": (of_batteries, 0.0, self.active_kw),
            "energy": (of_batteries, data.soc_min(b) * b.energy_kwh, b.soc_max * b.energy_kwh),
            "Q_batt": (of_batteries, -self.radius_kva, self.radius_kva),
            "P_exp": (of_pv, 0.0, data.pv_kw),
            "Q_pv": (of_pv, -site.pv.s_max_kva, site.pv.s_max_kva),
            "P_grid": (of_grid, 0.0, data.grid_p_max_kw(site)[:, None]),
            "Q_grid": (of_grid, -q_grid, q_grid),
            "P_out": ((W, int(data.exporting)), 0.0, data.export_max_kw(site)[:, None]),
            "on": (switched, 0.0, 1.0),
            "off": (switched, 0.0, 1.0),
            "cold": (cold, 0.0, 1.0),
            "beyond": ((W, 0 if longest is None else len(longest.customer)), 0.0, 1.0),
            "missing": ((1, len(missing_kwh)), 0.0, missing_kwh),
            "kept": ((1, int(data.stored_value is not None)), *data.kept_range(site)),
        }

    @cached_property
    def active(self) -> list[Given]:
        """What devices give of active power."""
        at = self.at
        reach = self.reactance
        return [
            *((at[name], reach.customer, -each.net_kw) for name, each in self.demands.items()),
            (at["P_dch"], reach.battery, 1.0),
            (at["P_ch"], reach.battery, -1.0),
            (at["P_exp"], reach.pv, 1.0),
        ]

    @cached_property
    def reactive(self) -> list[Given]:
        """What they give of reactive power."""
        at = self.at
        reach = self.reactance
        return [
            *((at[name], reach.customer, -each.kvar) for name, each in self.demands.items()),
            (at["Q_batt"], reach.battery, 1.0),
            (at["Q_pv"], reach.pv, 1.0),
        ]

    @property
    def price(self) -> tuple[Wholes, Floats]:
        """Columns of import and export and what they cost for a step, in GBP/kW.

        Behind them what is missing at the end, in GBP/kWh, or what is kept is worth.
        """
        columns = np.hstack([self.at["P_grid"], self.at["P_out"]])
        prices = [self.data.price_gbp_per_kwh]
        if self.data.export is not None:
            prices.append(-self.data.export.price_gbp_per_kwh)
        values = (np.column_stack(prices) * self.site.dt_h).ravel()
        if self.data.stored_value is not None:
            kept = self.at["kept"].ravel()
            return np.append(columns.ravel(), kept), np.append(
                values, -self.data.stored_value.gbp_as_cost
            )
        if self.data.terminal is None:
            return columns.ravel(), values
        missing = self.at["missing"].ravel()
        each = np.full(len(missing), self.data.terminal.price_gbp_per_kwh)
        return np.append(columns.ravel(), missing), np.append(values, each)

    @cached_property
    def parts(self) -> sp.csc_array:
        """Columns as sums of columns that are not negative: reactive power given less taken.

        The columns themselves come first, shape (size, size of the parts).
        """
        signed = np.concatenate([self.at["Q_batt"].ravel(), self.at["Q_pv"].ravel()])
        taken = self.size + np.arange(len(signed))
        values = np.append(np.ones(self.size), -np.ones(len(signed)))
        places = np.append(np.arange(self.size), signed), np.append(np.arange(self.size), taken)
        return sp.csc_array((values, places), shape=(self.size, self.size + len(signed)))

    @property
    def origin(self) -> Wholes:
        """The column whose sum each of the parts enters, (size of the parts,)."""
        return np.asarray(self.parts.indices)

    def feeders(self, of_bus: Wholes) -> Wholes:
        """Feeder of each column by those of the buses, -1 of the grid's and of what all share."""
        reach = self.reactance
        found = np.full(self.size, -1)
        for names, bus in (
            (("x",), reach.customer),
            (("P_ch", "P_dch", "energy", "Q_batt", "missing"), reach.battery),
            (("P_exp", "Q_pv"), reach.pv),
        ):
            for name in names:
                found[self.at[name]] = of_bus[bus] if self.at[name].size else -1
        return found

    def start(self) -> tuple[Wholes, Wholes]:
        """Columns with the rows that determine them where nothing is stored and no sun is lost.

        Rows count as in :meth:`rows`: balances, then PV systems, then energies.
        """
        W = self.data.n_steps
        open_ = np.flatnonzero(self.data.grid_limit_kw > 0.0)
        pv = self.at["P_exp"].ravel()
        energy = self.at["energy"].ravel()
        grid = self.at["P_grid"][open_, 0], self.at["Q_grid"][open_, 0]
        columns = np.concatenate([*grid, pv, energy])
        devices = 3 * W + np.arange(len(pv) + len(energy))
        return columns, np.concatenate([open_, W + open_, devices])

    def rows(self) -> Rows:
        """Balances, circular charging, PV systems and batteries."""
        return Rows.joined(
            [
                *self._balance_rows(),
                self._pv_rows(),
                *self._battery_rows(),
                *self._connection_rows(),
                *self._terminal_rows(),
                *self._value_rows(),
                *self._rule_rows(),
            ]
        )

    def _balance_rows(self) -> list[Rows]:
        """Active and reactive balance, and circular charging."""
        at = self.at
        active = [(columns, each) for columns, _, each in self.active]
        reactive = [(columns, each) for columns, _, each in self.reactive]
        drawn_kw = self.drawn.kw.sum(axis=1)
        drawn_kvar = self.drawn.kvar.sum(axis=1)
        grid = [(at["P_grid"], 1.0), (at["P_out"], -1.0)]
        outside = [(at["P_grid"], 1.0), (at["P_exp"], 1.0), (at["P_ch"], -1.0)]
        return [
            self._sums([*grid, *active], drawn_kw, drawn_kw),
            self._sums([(at["Q_grid"], 1.0), *reactive], drawn_kvar, drawn_kvar),
            self._sums(outside, 0.0, np.inf),
        ]

    def _sums(
        self,
        terms: Sequence[tuple[Wholes, Floats | float]],
        lower: Floats | float,
        upper: Floats | float,
    ) -> Rows:
        """A row for each step over all columns of some letters, with their factors."""
        columns = np.hstack([places for places, _ in terms])
        values = np.hstack([np.broadcast_to(factor, places.shape) for places, factor in terms])
        return Rows.of(columns, values, lower, upper, self.size)

    def _pv_rows(self) -> Rows:
        """What PV systems give and their owners use of it."""
        site = self.site
        pv_kw = self.data.pv_kw
        users = [self.at[name][:, site.owner] for name in self.demands]
        through = [self.at["P_exp"], *users]
        owner = np.stack(through, axis=-1).reshape(-1, len(through))
        own_kw = [demand.own_kw.ravel() for demand in self.demands.values()]
        used = np.column_stack([np.ones(pv_kw.size), *own_kw])
        room = np.minimum(pv_kw, site.pv.s_max_kva).ravel()
        return Rows.of(owner, used, -np.inf, room, self.size)

    def _rule_rows(self) -> list[Rows]:
        """Switching rules."""
        if self.rules is None:
            return []
        columns = [self.at[name].ravel(order="F") for name in LETTERS]
        places = np.concatenate(columns)
        rows = self.rules.matrix.tocoo()
        matrix = sp.csr_array(
            (rows.data, (rows.row, places[rows.col])), shape=(rows.shape[0], self.size)
        )
        return [Rows(matrix, self.rules.lower, self.rules.upper)]

    def _connection_rows(self) -> list[Rows]:
        """Import or export, as far as rows without binaries can say it."""
        most_in = self.data.grid_p_max_kw(self.site)
        most_out = self.data.export_max_kw(self.site)
        both = np.flatnonzero((most_in > 0.0) & (most_out > 0.0))
        if not len(both):
            return []
        columns = np.hstack([self.at["P_grid"][both], self.at["P_out"][both]])
        shares = np.column_stack([1.0 / most_in[both], 1.0 / most_out[both]])
        return [Rows.of(columns, shares, -np.inf, 1.0, self.size)]

    def _terminal_rows(self) -> list[Rows]:
        """Energy at the end, and what is missing of it."""
        if self.data.terminal is None:
            return []
        target_kwh = self.data.terminal.target_kwh(self.site.batteries)
        columns = np.column_stack([self.at["energy"][-1], self.at["missing"][0]])
        return [Rows.of(columns, np.ones(2), target_kwh, np.inf, self.size)]

    def _value_rows(self) -> list[Rows]:
        """What the energy at the end is worth: no more than any of the pieces says."""
        value = self.data.stored_value
        if value is None:
            return []
        pieces = len(value.slope)
        energy = self.at["energy"][-1]
        columns = np.tile(np.append(self.at["kept"][0], energy), (pieces, 1))
        slopes = np.tile(-value.slope[:, None], (1, len(energy)))
        values = np.column_stack([np.ones(pieces), slopes])
        return [Rows.of(columns, values, -np.inf, value.offset, self.size)]

    def _battery_rows(self) -> list[Rows]:
        """Energies, and one active power at a time."""
        at = self.at
        b = self.site.batteries
        data = self.data
        dt = self.site.dt_h
        change = np.stack([at["energy"], at["P_ch"], at["P_dch"]], axis=-1)
        gain = np.stack([np.ones(len(b)), -dt * data.eta_charge, dt / data.eta_discharge], axis=-1)
        held = b.energy_kwh * data.soc
        later = np.concatenate([change[1:], at["energy"][:-1, :, None]], axis=-1).reshape(-1, 4)
        steps = np.tile(np.column_stack([gain, -np.ones(len(b))]), (data.n_steps - 1, 1))
        both = np.stack([at["P_ch"], at["P_dch"]], axis=-1).reshape(-1, 2)
        active = self.active_kw.ravel()
        return [
            Rows.of(change[0], gain, held, held, self.size),
            Rows.of(later, steps, 0.0, 0.0, self.size),
            Rows.of(both, np.ones(2), -np.inf, active, self.size),
        ]

    def u_pu2(self, x: Floats) -> Floats:
        """Squared referred voltages of a solution, (W, N)."""
        p, q = self._injected(x)
        return self._referred(self.reactance.raised(self._empty_u, p, q))

    def _referred(self, u: Floats) -> Floats:
        """Squared voltages (W, N) as they are where another bus than the grid's holds them."""
        if self.data.physics is None:
            return u
        held = self.reference
        return np.asarray(u + (self._held_pu2[held] - u[np.arange(len(u)), held])[:, None])

    @cached_property
    def _held_pu2(self) -> Floats:
        """Squared voltage at which a source at each bus holds it, (N,)."""
        net = self.site.network
        return np.asarray(net.u_pu2(net.held_pu))

    def _injected(self, x: Floats) -> tuple[Floats, Floats]:
        """Active and reactive injections of a solution, the grid's left out, (W, N) each."""
        p, q = (np.zeros((self.data.n_steps, self.site.network.n_buses)) for _ in range(2))
        steps = np.arange(self.data.n_steps)[:, None]
        for power, given in ((p, self.active), (q, self.reactive)):
            for columns, bus, each in given:
                np.add.at(power, (steps, bus[None, :]), each * x[columns])
        return p, q

    @cached_property
    def _empty_u(self) -> Floats:
        """Squared voltages without any device, (W, N)."""
        empty = self.site.network.v_slack_pu**2 + self.reactance.along(self.data.delta_pu2)
        return np.asarray(empty - self.reactance.raised(0.0, self.drawn.kw, self.drawn.kvar))

    @cached_property
    def _u_limits_pu2(self) -> tuple[Floats, Floats]:
        """Lowest and highest squared referred voltages, (W, N) each."""
        return self.data.u_limits_pu2(self.site.network)

    @property
    def near(self) -> list[Rows]:
        """Limits of the network that are stated from the start."""
        return []

    def voltage_rows(self, x: Floats, tolerance_pu2: float) -> list[Rows]:
        """Rows of the violated voltage limits: where no neighbour is further out."""
        net = self.site.network
        u = self.u_pu2(x)
        lowest, highest = self._u_limits_pu2
        found = []
        for sign, beyond in ((1.0, lowest - u), (-1.0, u - highest)):
            beyond[self.reference == 0, 0] = -np.inf
            around = np.full_like(beyond, -np.inf)
            around[:, 1:] = beyond[:, net.parent]
            np.maximum.at(around.T, net.parent, beyond[:, 1:].T)
            worst = (beyond > tolerance_pu2) & (beyond >= around)
            found += [
                self._voltage_row(int(t), int(bus), sign)
                for t, bus in zip(*np.nonzero(worst), strict=True)
            ]
        return found

    def _voltage_row(self, t: int, bus: int, sign: float) -> Rows:
        """A lower (1) or upper (-1) limit, in thousandths of pu²."""
        r, x = self.reactance.row(bus)
        empty = self._referred(self._empty_u)[t, bus]
        if self.reference[t] > 0:
            r, x = (
                per - of_held
                for per, of_held in zip(
                    (r, x), self.reactance.row(int(self.reference[t])), strict=True
                )
            )
        columns, values = self._sum_of_injections(t, r, x)
        limit = self._u_limits_pu2[0 if sign > 0 else 1][t, bus]
        scale = PER_PU2 * sign
        return Rows.of(columns, scale * values, scale * (limit - empty), np.inf, self.size)

    def _sum_of_injections(self, t: int, per_kw: Floats, per_kvar: Floats) -> tuple[Wholes, Floats]:
        """Columns (1, k) and values (k,) of a sum of what a step's buses are given, (N,) each."""
        parts = [
            (columns[t], per[bus] * np.broadcast_to(each, columns.shape)[t])
            for per, given in ((per_kw, self.active), (per_kvar, self.reactive))
            for columns, bus, each in given
        ]
        columns, values = (np.concatenate(each) for each in zip(*parts, strict=True))
        used = values != 0.0
        return columns[used][None, :], values[used]

    def flow_rows(self, x: Floats) -> list[Rows]:
        """Tangents of the lines' flows that exceed their limits, as shares of these."""
        most = self.data.flow_max_kva
        if most is None:
            return []
        net = self.site.network
        p, q = self._injected(x)
        p_flow = lossless_flows(net, p - self.drawn.kw)
        q_flow = lossless_flows(net, q - self.drawn.kvar)
        size = np.hypot(p_flow, q_flow)
        found = []
        for t, line in zip(*np.nonzero(size > most * (1.0 + SOLVED)), strict=True):
            cos, sin = p_flow[t, line] / size[t, line], q_flow[t, line] / size[t, line]
            fed = net.downstream[[int(line)]].toarray()[0]
            columns, values = self._sum_of_injections(int(t), -cos * fed, -sin * fed)
            drawn = fed @ (cos * self.drawn.kw[t] + sin * self.drawn.kvar[t])
            limit = most[t, line]
            found.append(
                Rows.of(columns, values / limit, -np.inf, (limit - drawn) / limit, self.size)
            )
        return found

    def disc_rows(self, x: Floats, tolerance: float) -> list[Rows]:
        """Tangents of the inverters' discs that are exceeded by more than a share of the radius."""
        at = self.at
        owner = self.site.owner
        net = [(at["P_ch"], 1.0), (at["P_dch"], -1.0)]
        own = [(at[name][:, owner], demand.own_kw) for name, demand in self.demands.items()]
        return [
            *self._tangents(x, tolerance, net, at["Q_batt"], self.radius_kva),
            *self._tangents(
                x, tolerance, [(at["P_exp"], 1.0), *own], at["Q_pv"], self.site.pv.s_max_kva
            ),
        ]

    def _tangents(
        self,
        x: Floats,
        tolerance: float,
        active: Sequence[tuple[Wholes, Floats | float]],
        reactive: Wholes,
        radius: Floats,
    ) -> list[Rows]:
        """The same of discs of sums of active columns with factors, and of reactive columns."""
        p = np.sum([factor * x[columns] for columns, factor in active], axis=0)
        size = np.hypot(p, x[reactive])
        out = size > np.maximum(radius * (1.0 + tolerance), radius + SOLVER_KVA)
        if not out.any():
            return []
        cos = p[out] / size[out]
        sin = x[reactive][out] / size[out]
        columns = np.column_stack([*(each[out] for each, _ in active), reactive[out]])
        factors = [cos * np.broadcast_to(factor, p.shape)[out] for _, factor in active]
        limit = np.broadcast_to(radius, p.shape)[out]
        return [Rows.of(columns, np.column_stack([*factors, sin]), -np.inf, limit, self.size)]

    def clipped(self, x: Floats, tolerance_pu2: float) -> Floats | None:
        """A solution with what exceeds the discs moved to other inverters and the grid.

        None where that breaks a balance or, by more than a tolerance, a voltage limit.
        """
        at = self.at
        q_pv, q_batt = at["Q_pv"], at["Q_batt"]
        owner = at["x"][:, self.site.owner]
        through = x[at["P_exp"]] + self.usual.own_kw * x[owner]
        net_kw = x[at["P_ch"]] - x[at["P_dch"]]
        inverters = np.hstack([q_pv, q_batt])
        squared = np.hstack(
            [self.site.pv.s_max_kva**2 - through**2, self.radius_kva**2 - net_kw**2]
        )
        most = np.hstack([np.sqrt(np.maximum(squared, 0.0)), self._grid_q_max_kvar])
        places = np.hstack([inverters, at["Q_grid"]])
        q = np.clip(x[places], -most, most)
        moved = (x[places] - q).sum(axis=1, keepdims=True)
        room = np.where(moved > 0.0, most - q, most + q)
        total = room.sum(axis=1, keepdims=True)
        if (np.abs(moved) > total).any():
            return None
        found = x.copy()
        found[places] = q + moved * room / np.where(total > 0.0, total, 1.0)
        carried = not self.voltage_rows(found, tolerance_pu2) and not self.flow_rows(found)
        return found if carried else None

    @property
    def _grid_q_max_kvar(self) -> Floats:
        """Largest reactive power of the grid, (W, 1)."""
        return np.asarray(self.data.grid_q_max_kvar(self.site)[:, None])

    def exchange_kw(self, x: Floats) -> tuple[Floats, Floats]:
        """Import and export of a solution, (W,) each."""
        imported = np.maximum(x[self.at["P_grid"]][:, 0], 0.0)
        exported = np.maximum(x[self.at["P_out"]].sum(axis=1), 0.0)
        return imported, exported

    def dispatch(self, x: Floats, served: Flags) -> Dispatch:
        """A solution as a dispatch of a served set; flows and voltages follow from it.

        The window must know the demand of the set: it is one without rules.
        """
        at = self.at
        data = self.data
        net = self.site.network
        own = self.usual.own_kw * served[:, self.site.owner]
        export = np.clip(x[at["P_exp"]], 0.0, data.pv_kw - own)
        imported, exported = self.exchange_kw(x)
        p, q = self._injected(x)
        return Dispatch(
            served=served,
            pv_self_kw=own,
            pv_export_kw=export,
            pv_curtailed_kw=data.pv_kw - own - export,
            pv_q_kvar=x[at["Q_pv"]],
            charge_kw=np.maximum(x[at["P_ch"]], 0.0),
            discharge_kw=np.maximum(x[at["P_dch"]], 0.0),
            batt_q_kvar=x[at["Q_batt"]],
            soc=np.vstack([data.soc, x[at["energy"]] / self.site.batteries.energy_kwh]),
            p_grid_kw=imported - exported,
            q_grid_kvar=x[at["Q_grid"]][:, 0],
            v_pu=net.v_pu(self.u_pu2(x)),
            p_flow_kw=lossless_flows(net, p - self.drawn.kw),
            q_flow_kvar=lossless_flows(net, q - self.drawn.kvar),
        )

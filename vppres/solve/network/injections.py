"""The whole problem without lines and buses: devices and balances, and rows for what is left out.

Devices and balances are a selection of the statement. Lossless flows are sums of injections, so
squared voltages are linear in them. Few voltage limits and few inverter discs bind, so their rows
are made where a solution violates them.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Flags, Floats, Wholes
from vppres.model.beyond_paper.at_end import kept_range
from vppres.model.beyond_paper.lines_out import LinesOut
from vppres.model.data import WindowData
from vppres.model.numerics import cost_scale
from vppres.model.site import Site
from vppres.solve.cache import ModelCache
from vppres.solve.forms import (
    DISCS,
    MODES,
    OF_PV,
    in_order,
    one_mode_at_a_time,
    sheet_of,
    total_balance,
)
from vppres.solve.lumping import eliminated
from vppres.solve.network.buses import Buses, Reactance
from vppres.solve.network.rows import ColumnPowers, Rows
from vppres.solve.phases import PhaseLimits
from vppres.solve.programs import Program, with_limits_of_columns
from vppres.solve.selection import Selected, Selection, Sheet

SOLVER_KVA = 5e-7
"""By how much a disc may be exceeded in any case: a solver meets its tangents no better, and of an
inverter of 1 W would be asked for ever."""

LINES = frozenset({"P_flow", "Q_flow", "u"})
"""Letters that follow from what is injected at the buses."""

BALANCES = ("active_power_balance", "reactive_power_balance")
RATINGS = ("battery_charge_rating", "battery_discharge_rating", "pv_active_rating")

LETTERS = ("x_served", "P_ch", "P_dch", "SoC", "Q_batt", "P_curt", "Q_pv", "P_grid", "Q_grid")
"""The order of the columns; what is not named comes behind."""


def select_devices(sheet: Sheet) -> Selection:
    """Devices, rules and the sums of the balances; balances of buses and discs to make rows of.

    Left out are modes of batteries and families of lines and voltages: a relaxation until the rows
    of all limits that a solution violates are there.
    """
    statement = sheet.statement
    elsewhere = {*BALANCES, *DISCS, *MODES, *OF_PV}
    of_devices = [
        name
        for name in in_order(sheet)
        if name not in elsewhere and not LINES & statement.letters_of(name)
    ]
    found = Selection(sheet).relax("x_served", 0.0, 1.0).hold("P_flow", "Q_flow")
    found = found.relaxed_to_shares(statement.named("directions"))
    # Each part of a balanced feeder has a balance of its own here, and phases have it in theirs.
    in_parts = () if sheet.site.phases else LinesOut.for_network
    beyond = [name for name in statement.implied_beyond if name not in in_parts]
    found = found.keep(*of_devices, *beyond, *RATINGS, *BALANCES, *DISCS)
    sums = [total_balance(sheet, name) for name in BALANCES]
    parts = [*sums, *found.parts, one_mode_at_a_time(sheet)]
    if len(sheet.site.pv):
        parts.append(sheet.limit_of("export_min", {"P_exp": -1.0}))
        by = [sheet.family(name) for name in OF_PV]
        parts = eliminated(sheet, parts, ("P_self", "P_exp"), by)
    found = replace(found, parts=tuple(parts), order=LETTERS)
    # Service is a set's own, but for what energy that is left buys later.
    gbp = cost_scale(sheet.site)
    return found.optimise(f2=1.0, f3=gbp * sheet.site.weights.lambda_curt, f7=-gbp)


def devices(site: Site, sheet: Sheet) -> Selected:
    """Problem of the selection."""
    return Selected(sheet, select_devices)


class Injections:
    """A window's program without lines and buses, and the rows of what it leaves out.

    Charging and discharging may overlap, and so may import and export.

    Losses of physical mode are a demand of the network.

    Attributes
    ----------
    program : Program
        Devices, rules and the sums of the balances; least cost, with that of curtailment.
    """

    def __init__(self, cache: ModelCache, data: WindowData) -> None:
        self.site = cache.site
        self.data = data
        self.reactance = cache.table(Reactance)
        self.problem = cache.problem(devices, sheet=sheet_of(cache, data))
        self.problem.fill(data)
        self.problem.held |= {"P_flow": 0.0, "Q_flow": 0.0}
        numbers = self.problem.numbers()
        every = Rows(
            sp.csr_array(numbers.rows), self.problem.row_lower(numbers.limit), numbers.limit
        )
        named = self.problem.rows_of
        shape = data.n_steps, self.site.network.n_buses
        by_step = np.arange(np.prod(shape)).reshape(shape, order="F").ravel()
        p, q = (every.part(named[name]).part(by_step) for name in BALANCES)
        injected = ColumnPowers(
            p.matrix, q.matrix, -p.upper.reshape(shape), -q.upper.reshape(shape)
        )
        self.buses = Buses(self.reactance, data, injected)
        phased = data.phased
        self.limits = PhaseLimits(self.site, data, self.problem) if phased else self.buses
        self.discs = Rows.joined([every.part(named[name]) for name in DISCS])
        inside = np.ones(len(numbers.limit), dtype=bool)
        for name in (*BALANCES, *DISCS):
            inside[named[name]] = False
        rows = Rows.joined([every.part(inside), *self._of_parts(injected)])
        program = Program(
            numbers.cost,
            *self._limits(),
            rows.matrix.tocsc(),
            rows.lower,
            rows.upper,
            np.arange(0),
        )
        self.program, kept = with_limits_of_columns(program)
        inside[inside] = kept[: int(inside.sum())]
        self._place = np.where(inside, np.cumsum(inside) - 1, -1)

    def _of_parts(self, injected: ColumnPowers) -> list[Rows]:
        """Balances of all parts but the grid's, which has what is left of the sums."""
        of_bus = self.data.parts.of_bus
        steps, buses = np.nonzero(of_bus)
        if self.data.phased or not len(steps):
            return []
        N = of_bus.shape[1]
        numbers, row = np.unique(steps * N + of_bus[steps, buses], return_inverse=True)
        inside = np.zeros((len(numbers), N))
        inside[row, buses] = 1.0
        found = []
        for per_kw, per_kvar in ((inside, 0.0 * inside), (0.0 * inside, inside)):
            rows, kw, kvar = injected.sums(numbers // N, per_kw, per_kvar)
            found.append(Rows(rows, -(kw + kvar), -(kw + kvar)))
        return found

    def _limits(self) -> tuple[Floats, Floats]:
        """Limits of the columns: the page's, and what no column exceeds in a dispatch.

        A bound by weak duality needs a number for each.
        """
        lower, upper = self.problem.x_lower.copy(), self.problem.x_upper.copy()
        site = self.site
        data = self.data
        held_kwh = site.batteries.energy_kwh.sum()
        missing_kwh = 0.0 if data.terminal is None else data.terminal.target_kwh(site.batteries)
        limits: dict[str, tuple[Floats | float, Floats | float]] = {
            "P_grid": (0.0, data.grid_p_max_kw(site)),
            "P_out": (0.0, data.export_max_kw(site)),
            "P_beyond": (0.0, data.beyond_limit_kw),
            "P_curt": (0.0, data.pv_kw),
            "P_self": (0.0, data.pv_kw),
            "P_exp": (0.0, data.pv_kw),
            "E_missing": (0.0, missing_kwh),
            "E_stored": (0.0, held_kwh),
            "kept": kept_range(site, data),
            "P_over": (-self._all_kw, self._all_kw),
        }
        for name in limits.keys() & self.problem.first.keys():
            lower[self.at(name)], upper[self.at(name)] = limits[name]
        of_discs = np.column_stack([self.at("Q_batt"), self.at("Q_pv")])
        radius = self.discs.upper[::3].reshape(of_discs.shape, order="F")
        lower[of_discs], upper[of_discs] = -radius, radius
        return lower, upper

    @property
    def _all_kw(self) -> Floats:
        """Power that no line exceeds: all that is ever taken and given, (W, 1)."""
        data, site = self.data, self.site
        all_kw: Floats = data.most_load_kw(site).sum(axis=1) + data.pv_kw.sum(axis=1)
        all_kw = all_kw + 2.0 * site.batteries.p_max_kw.sum()
        all_kw = sum(data.ahead.most_taken_kw(), start=all_kw)
        all_kw = sum(data.ahead.most_given_kw(), start=all_kw)
        if data.drawn:
            all_kw = all_kw + np.abs(data.drawn.kw).sum(axis=1)
        return np.asarray(all_kw)[:, None]

    @property
    def size(self) -> int:
        """Columns of the program."""
        return len(self.program.cost)

    def at(self, name: str) -> Wholes:
        """Columns of a letter in its shape; none if the window has none of it."""
        if name in self.problem.first:
            return self.problem.at(name)
        return np.zeros((self.data.n_steps, 0), dtype=np.int64)

    @cached_property
    def parts(self) -> sp.csc_array:
        """Columns as sums of columns that are not negative: reactive power given less taken.

        The columns themselves come first, shape (size, size of the parts).
        """
        signed = np.concatenate([self.at("Q_batt").ravel(), self.at("Q_pv").ravel()])
        taken = self.size + np.arange(len(signed))
        values = np.append(np.ones(self.size), -np.ones(len(signed)))
        places = np.append(np.arange(self.size), signed), np.append(np.arange(self.size), taken)
        return sp.csc_array((values, places), shape=(self.size, self.size + len(signed)))

    def feeders(self, of_bus: Wholes) -> Wholes:
        """Feeder of each column by those of the buses, -1 of the grid's and of what all share."""
        reach = self.reactance
        found = np.full(self.size, -1)
        for names, bus in (
            (("x_served",), reach.customer),
            (("P_ch", "P_dch", "SoC", "Q_batt", "E_missing"), reach.battery),
            (("P_curt", "Q_pv"), reach.pv),
        ):
            for name in names:
                columns = self.at(name)
                found[columns] = of_bus[bus] if columns.size else -1
        return found

    def start(self) -> tuple[Wholes, Wholes]:
        """Columns with the rows that determine them where nothing is stored and no sun is lost."""
        open_ = np.flatnonzero(self.data.grid_limit_kw > 0.0)
        named = self.problem.rows_of
        grid = [self._place[named[f"total_{name}"]][open_] for name in BALANCES]
        energy = self._place[named["battery_soc_dynamics"]]
        later = self.at("SoC")[1:].ravel(order="F")
        columns = [self.at("P_grid")[open_], self.at("Q_grid")[open_], later]
        return np.concatenate(columns), np.concatenate([*grid, energy])

    # Discs of inverters.

    def _in_discs(self, x: Floats) -> tuple[Floats, Floats, Floats]:
        """Radius, active and reactive power of each inverter, those of a step together."""
        radius, p, q = (self.discs.upper - self.discs.matrix @ x).reshape(-1, 3).T
        return radius, p, q

    def disc_rows(self, x: Floats, tolerance: float) -> list[Rows]:
        """Tangents of the inverters' discs that are exceeded by more than a share of the radius."""
        radius, p, q = self._in_discs(x)
        size = np.hypot(p, q)
        out = np.flatnonzero(size > np.maximum(radius * (1.0 + tolerance), radius + SOLVER_KVA))
        if not len(out):
            return []
        cos, sin = p[out] / size[out], q[out] / size[out]
        factors = np.stack([np.ones(len(out)), -cos, -sin], axis=-1)
        begins = 3 * np.arange(len(out) + 1)
        columns = 3 * out[:, None] + np.arange(3)
        R = sp.csr_array((factors.ravel(), columns.ravel(), begins), shape=(len(out), 3 * len(p)))
        none = np.full(len(out), -np.inf)
        return [Rows(sp.csr_array(R @ self.discs.matrix), none, R @ self.discs.upper)]

    def clipped(self, x: Floats, tolerance_pu2: float) -> Floats | None:
        """A solution with what exceeds the discs moved to other inverters and the grid.

        None where that breaks a balance or, by more than a tolerance, a voltage limit.
        """
        radius, p, _ = self._in_discs(x)
        W = self.data.n_steps
        left = np.sqrt(np.maximum(radius**2 - p**2, 0.0)).reshape(-1, W).T
        most = np.column_stack([left, self.data.grid_q_max_kvar(self.site)])
        places = np.column_stack([self.at("Q_batt"), self.at("Q_pv"), self.at("Q_grid")])
        q = np.clip(x[places], -most, most)
        moved = (x[places] - q).sum(axis=1, keepdims=True)
        room = np.where(moved > 0.0, most - q, most + q)
        total = room.sum(axis=1, keepdims=True)
        if (np.abs(moved) > total).any():
            return None
        found = x.copy()
        found[places] = q + moved * room / np.where(total > 0.0, total, 1.0)
        return None if self.limits.exceeded(found, tolerance_pu2) else found

    # What a solution says.

    def dispatch(self, x: Floats, served: Flags) -> Dispatch:
        """A solution as a dispatch of a supply schedule; flows and voltages follow from it.

        The window must know the demand of the set: it is one without rules.
        """
        data = self.data
        p_flow, q_flow = self.buses.flows(x)
        own_kw = data.self_limit_kw(self.site) * served[:, self.site.owner]
        self.problem.put(x)
        sun_kw = data.pv_kw - own_kw - self.problem.value_of("P_curt")
        self.problem.statement.put(
            {
                "P_self": own_kw,
                "P_exp": np.maximum(sun_kw, 0.0),
                "u": self.buses.u_pu2(x),
                "P_flow": p_flow,
                "Q_flow": q_flow,
            }
        )
        return self.problem.dispatch(served)

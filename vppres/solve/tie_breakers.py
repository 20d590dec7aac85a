"""The last level: least f4 and f5 with service, battery modes, cost and curtailment held.

No row of the statement is left out: what service and modes decide is put in as numbers. One signed
power stands for a battery's charge, discharge and mode, self-consumption is data, and where nothing
is curtailed PV export is data too, so that a PV inverter's disc leaves a plain interval.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Flags, Floats, Wholes
from vppres.model.data import WindowData
from vppres.model.numerics import Polygon, disc_sides
from vppres.model.objective import f4_squares, f5_squares
from vppres.model.site import Site
from vppres.solve.compiled import Numbers
from vppres.solve.forms import DISCS, MODES, OF_PV, in_order
from vppres.solve.lumping import eliminated
from vppres.solve.network.chains import Chains
from vppres.solve.network.injections import BALANCES
from vppres.solve.selection import Selected, Selection, Sheet, diagonal_of

SHARPER_VOLTAGE = 1e2
SHARPER_ENERGY = 1e4
"""Factors on both sides of rows in pu² and in shares of a capacity. An interior-point solver allows
residuals in proportion to the largest value of the solution, thousands of kW here; what is a
fraction of one needs smaller units to be met as sharply."""

BY_DATA = (*MODES, *OF_PV)
"""Families that hold by what is put in."""

SHARPER = {
    "delta_lindistflow": SHARPER_VOLTAGE,
    "battery_soc_start": SHARPER_ENERGY,
    "battery_soc_dynamics": SHARPER_ENERGY,
    "battery_soc_min": SHARPER_ENERGY,
    "battery_soc_max": SHARPER_ENERGY,
}


class TieBreakers(Selected):
    """Tie-breakers over W steps; feasible exactly if the held values can be had in the network.

    With ``curtailing`` PV power may be curtailed, up to the held sum; with ``moves`` batteries are
    to stay near the plan before.

    Attributes
    ----------
    in_chains : bool
        Whether it has chains of lines instead of these, and no voltages: with rows of phases
        nothing else follows from lines.
    """

    def __init__(self, site: Site, sheet: Sheet, curtailing: bool, moves: bool) -> None:
        super().__init__(sheet, self._selected, conic=True)
        self.site = site
        self.curtailing = curtailing
        self.moves = moves and len(site.batteries) > 0
        self.in_chains = bool(site.phases) and not sheet.statement.differs

    def _selected(self, sheet: Sheet) -> Selection:
        """All families, scaled, with the limits that are written with a window."""
        site = self.site
        named = sheet.statement.named
        # A page of your own may multiply by parameters what is put in otherwise.
        of_paper = not sheet.statement.differs
        puts_in = len(site.pv) > 0 and of_paper
        out = {
            *(BY_DATA if of_paper else ()),
            *sheet.statement.rules,
            *named("met"),
        }
        found = Selection(sheet).hold("x_served", "delta")
        found = found.hold(*named("by_service"), *named("by_dispatch"))
        found = found.hold(*sheet.own_whole)
        sides = disc_sides(site, sheet.n_steps)
        chains = Chains.of(site) if self.in_chains else None
        for name in sorted(in_order(sheet), key=_rank):
            if chains is not None and name in BALANCES:
                found = replace(found, parts=(*found.parts, chains.of_balance(sheet, name)))
            elif chains is not None and "u" in sheet.statement.letters_of(name):
                pass  # no voltage of the tree has a limit
            elif name in DISCS:
                found = self._disc(found, name, sides)
            elif name in SHARPER:
                found = found.scale(name, SHARPER[name])
            elif name not in out:
                found = found.keep(name)
        if self.curtailing:
            found = found.limit("pv_export", {"P_exp": -1.0})
        else:
            found = found.hold("P_curt")
        found = found.limit("battery_power_min", {"P_ch": -1.0, "P_dch": 1.0})
        found = found.limit("battery_power_max", {"P_ch": 1.0, "P_dch": -1.0})
        for name in named("in_range"):
            found = found.limit(f"{name}_min", {name: -1.0}).limit(f"{name}_max", {name: 1.0})
        found = found.limit_term("f2").limit_term("f3")
        if "own" in sheet.statement.terms:
            found = found.limit_term("own", -1.0)
        found = found.relax("P_ch").relax("P_dch")  # their limits hold by what is put in
        parts = found.parts
        if puts_in:
            by = [sheet.family(name) for name in OF_PV]
            parts = tuple(eliminated(sheet, parts, ("P_self", "P_exp"), by))
        order = ("P_grid", "P_curt")
        calm = {name: np.ones(sheet.columns[name].shape[-1]) for name in named("calm")}
        squares = squares_of(site)
        squares = squares if chains is None else chains.squares(squares)
        return replace(found, parts=parts, squares=squares | calm, order=order)

    def _disc(self, found: Selection, name: str, sides: int) -> Selection:
        """Discs, or polygons for large windows; what data leaves of a disc is an interval."""
        changed = found.sheet.statement.changed
        if name == "pv_inverter_capacity" and not self.curtailing and name not in changed:
            found = found.limit("pv_reactive_min", {"Q_pv": -1.0})
            return found.limit("pv_reactive_max", {"Q_pv": 1.0})
        if not sides:
            return found.keep(name)
        polygon = Polygon.inscribed(sides)
        if name == "battery_inverter_capacity":
            return found.polygon(name, polygon.right_half, of_size=True)
        return found.polygon(name, polygon)

    # What a window writes.

    def hold(self, data: WindowData, dispatch: Dispatch, f2_gbp: float, f3_kwh: float) -> None:
        """Write a window's data, and what is held of a dispatch."""
        self.fill(data, dispatch.served)
        site = self.site
        b = site.batteries
        charging = charging_modes(dispatch)
        beyond = self.statement.held(data, dispatch)
        most_kw = np.broadcast_to(b.active_max_kw, charging.shape)
        left_kvar = np.sqrt(np.maximum(site.pv.s_max_kva**2 - data.pv_kw**2, 0.0))
        self._own_kw = data.self_limit_kw(site) * dispatch.served[:, site.owner]
        self._pv_kw = data.pv_kw
        self._charging = charging
        self.limits = {
            "battery_power_min": np.where(charging, 0.0, most_kw),
            "battery_power_max": np.where(charging, most_kw, 0.0),
            "pv_export": 0.0,
            "pv_reactive_min": left_kvar,
            "pv_reactive_max": left_kvar,
            "f2": f2_gbp,
            "f3": f3_kwh,
        }
        for name, (least, most) in beyond.ranges.items():
            self.limits |= {f"{name}_min": -least, f"{name}_max": most}
        self.held |= {"delta": charging.astype(float), "P_curt": 0.0, **beyond.values}
        self._near = None
        if self.moves and data.moves is not None:
            self._near = data.moves.targets(b.p_max_kw)

    def hold_own(self, letters: Mapping[str, Floats], least: float) -> None:
        """Write the whole numbers that only the page has, and the least of its term."""
        self.held |= letters
        self.limits["own"] = -least

    def numbers(self) -> Numbers:
        """The numbers with what is held put in, and one signed power for each battery."""
        n = super().numbers()
        diagonal = n.squares.diagonal()[self._y]
        cost = np.zeros(len(diagonal))
        if self._near is not None:
            # The squared distance (factor P_batt - value)**2 from the previous plan.
            factor, value = self._near
            P_batt = (np.cumsum(self._y) - 1)[self.at("P_ch")]
            diagonal[P_batt] += 2.0 * factor**2
            cost[P_batt] -= 2.0 * factor * value
        rows = self.shown(n.rows.tocsr()).tocsc()
        return Numbers(diagonal_of(diagonal), cost, n.offset, rows, n.limit)

    @cached_property
    def _y(self) -> Flags:
        """Columns of the problem that is solved, a battery's power in that of its charging."""
        found = np.ones(len(self.x_lower), dtype=bool)
        if "P_dch" in self.first:
            found[self.at("P_dch")] = False
        return found

    @property
    def _signed(self) -> tuple[Floats, Wholes]:
        """Of each of the problem's columns, a column that is solved and its factor.

        A battery's power is that of charging or, negative, of discharging, whichever is its mode.
        """
        weight = np.ones(len(self._y))
        places = np.cumsum(self._y) - 1
        if "P_ch" in self.first:
            charging, discharging = self.at("P_ch"), self.at("P_dch")
            weight[charging] = self._charging
            weight[discharging] = self._charging - 1.0
            places[discharging] = places[charging]
        return weight, places

    def shown(self, rows: sp.csr_array) -> sp.csr_array:
        """Rows on its columns with one signed power for each battery."""
        weight, places = self._signed
        entries = rows.tocoo()
        values = weight[entries.col] * entries.data
        at = entries.row, places[entries.col]
        # What is zero in this mode keeps its place, so that all modes are solved alike.
        return sp.coo_array((values, at), shape=(rows.shape[0], self._y.sum())).tocsr()

    def put(self, x: Floats) -> None:
        """Give the statement's letters the values of a solution, exactly in its modes."""
        weight, places = self._signed
        super().put(weight * x[places])
        P_exp = self._pv_kw - self._own_kw - self.value_of("P_curt")
        self.statement.put({"P_self": self._own_kw, "P_exp": P_exp})


def squares_of(site: Site) -> dict[str, Floats]:
    """f4 and f5 as weighted, scaled: f4 over the squared base voltage is about kW of loss."""
    w = site.weights
    heaviest = max(w.lambda_l, w.lambda_q) or 1.0
    scale = 1.0 / (1000.0 * site.network.base_kv**2 * heaviest)
    terms = ((w.lambda_l, f4_squares(site)), (w.lambda_q, f5_squares(site)))
    return {name: scale * weight * of for weight, squares in terms for name, of in squares.items()}


def _rank(name: str) -> int:
    """Balances and voltages come before the discs, and stored energy after them."""
    last = ("battery_soc_start", "battery_soc_dynamics", "battery_soc_min", "battery_soc_max")
    return 2 if name in last else 1 if name in DISCS else 0


def charging_modes(dispatch: Dispatch) -> Flags:
    """Mode of every battery and step; an idle battery takes the fleet's."""
    net: Floats = dispatch.charge_kw - dispatch.discharge_kw
    fleet = net.sum(axis=1, keepdims=True) >= 0
    return np.where(np.abs(net) > 1e-6, net > 0, fleet)

"""Shadow prices: the pricing problem, and its duals read in the units of the record.

The problem is the window as it was, with service continuous where it was withheld. It is solved
after the day, never in the loop, for its duals: they say what one more kWh, kW, kvar or kVA would
have bought. Service lies between the bounds that are given for each customer and step, the modes of
batteries that moved are those of the record in the first step, everything else is the paper's
problem with the true discs.

A shadow price is the slope of the optimum: what the objective would gain if one more unit of
something had been there. All of them belong to the first step of the window, but for the limits of
stored energy, which count over the whole window.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vppres.core.arrays import Floats
from vppres.core.errors import LimitError
from vppres.model.beyond_paper.lines_out import LinesOut
from vppres.model.beyond_paper.ratings import FAMILY, rated_lines
from vppres.model.beyond_paper.table import Beyond
from vppres.model.data import WindowData
from vppres.model.numerics import ROUNDING, Polygon, disc_sides
from vppres.model.phases import GRID, phased_model
from vppres.model.site import Site
from vppres.scenario.assets import NO_POWER_KW
from vppres.solve.cache import shared_cache
from vppres.solve.forms import in_order, sheet_for, total_balance, with_discs
from vppres.solve.limits import run_within_limits
from vppres.solve.network.rows import PER_PU2, Rows
from vppres.solve.phases import HIGH, LOW, OF_FORMER, OF_RATING, PhaseRows
from vppres.solve.result import Status
from vppres.solve.selection import Family, Selected, Selection, Sheet
from vppres.solve.turns import one_at_a_time

RATED = {
    "battery_charge_mode": "battery_charge_rated",
    "battery_discharge_mode": "battery_discharge_rated",
}
"""An inverter has a price of its own: two rows that bind together would share it."""


BALANCES = ("active_power_balance", "reactive_power_balance")
VOLTAGES, FLOWS = frozenset({"u"}), frozenset({"P_flow", "Q_flow"})
"""Letters of the tree of a feeder with phases, which limits no voltage; where no line is out its
flows make one balance of all buses."""


@dataclass(frozen=True, eq=False)
class FixedDecisions:
    """Decisions of the record that the pricing problem holds, for a window of W steps."""

    #: Bounds on the share of each customer that is served, (W, C).
    service_min: Floats
    service_max: Floats
    #: Bounds on the mode of each battery in the first step, (B,): 1 charges, 0 discharges.
    mode_min: Floats
    mode_max: Floats


@dataclass(frozen=True)
class PricedTerms:
    """Objective: weights of f1 (weighted customer hours), f2 (GBP) and f3 (kWh)."""

    service: float
    cost: float
    curtailment: float
    curtailed_max_kwh: float = np.inf


class ShadowPriceModel(Selected):
    """The pricing problem over W steps, compiled once."""

    def __init__(self, site: Site, n_steps: int, beyond: Beyond = ()) -> None:
        self.site = site
        self.n_steps = n_steps
        self.data: WindowData | None = None
        self.phase_rows: list[Rows] = []
        self.lines_out = any(each is LinesOut for each, _ in beyond)
        self.sides = disc_sides(site, n_steps)
        sheet = sheet_for(shared_cache(site), n_steps, beyond)
        super().__init__(sheet, self._selected, conic=True)

    def _selected(self, sheet: Sheet) -> Selection:
        """All families, and what is held.

        A bound of self-consumption would take up a part of the dual that belongs to the service.
        """
        found = Selection(sheet).relax("x_served").relax("P_self").relax("delta")
        found = found.relaxed_to_shares(sheet.statement.named("directions"))
        polygon = Polygon.inscribed(self.sides) if self.sides else None
        names = self._kept(sheet)
        found = with_discs(found, [RATED.get(name, name) for name in names], polygon)
        sums = [total_balance(sheet, name) for name in BALANCES if name not in names]
        found = replace(found, parts=(*found.parts, *sums))
        for name, letter in (("mode", "delta"), ("service", "x_served")):
            found = found.limit(f"{name}_min", {letter: -1.0}).limit(f"{name}_max", {letter: 1.0})
        return found.limit_term("f3").optimise(True, f1=1.0, f2=-1.0, f3=-1.0, f7=1.0, own=1.0)

    def _kept(self, sheet: Sheet) -> list[str]:
        """Families, of a feeder with phases without the letters of its tree."""
        statement, names = sheet.statement, in_order(sheet)
        if not self.site.phases or statement.differs:
            return names
        gone = VOLTAGES if self.lines_out else VOLTAGES | FLOWS
        return [name for name in names if not statement.letters_of(name) & gone]

    def price(self, data: WindowData, held: FixedDecisions, priced: PricedTerms) -> None:
        """Write a window's data, and what is held and priced."""
        self.data = data
        self.fill(data)
        self.compile()
        self.factors.update(f1=priced.service, f2=-priced.cost, f3=-priced.curtailment)
        for name in {"f7", "own"} & self.factors.keys():
            self.factors[name] = priced.service
        # All PV energy of the window is a limit that never binds.
        everything = float(data.pv_kw.sum()) * self.site.dt_h + 1.0
        later = np.ones((self.n_steps - 1, len(self.site.batteries)))
        self.limits = {
            "mode_min": -np.vstack([held.mode_min, 0.0 * later]),
            "mode_max": np.vstack([held.mode_max, later]),
            "service_min": -held.service_min,
            "service_max": held.service_max,
            "f3": min(priced.curtailed_max_kwh, everything),
        }

    def family(self, name: str) -> Family:
        """Rows of the problem by their name."""
        (part,) = (part for part in self.parts if part.name == name)
        return part

    def worth_at_buses(self, balance: str) -> Floats:
        """Gain of one more unit put into each bus in the first step, (N,)."""
        # A demand on the right of the balance costs what an injection gains.
        if balance in self.rows_of:
            return np.asarray(-self.dual(balance)[0])
        return np.full(self.site.network.n_buses, -self.dual(f"total_{balance}")[0])

    def dual(self, name: str) -> Floats:
        """Gain of one more unit of a family's limits, in its rows' shape."""
        return np.reshape(self.duals[self.rows_of[name]], self.family(name).shape, order="F")


@dataclass(frozen=True, eq=False)
class PhasePrices:
    """Part of limits of a phased feeder in the price of 1 kW or 1 kvar at each of D assets."""

    #: Phases of the formers, (K, D).
    active: Floats
    reactive: Floats
    #: Ratings of lines and coils, (k, D).
    rated_active: Floats
    rated_reactive: Floats
    #: Limits of voltages, (D,).
    by_voltage: Floats
    by_voltage_kvar: Floats


@dataclass(frozen=True, eq=False)
class ShadowPrices:
    """Gain of the objective for one more unit, in its unit: weighted customer hours or GBP."""

    stored_energy: Floats  #: for 1 kWh more in each battery at the beginning of the step, (B,)
    kept_energy: Floats  #: for 1 kWh more in each battery at the end of the step, (B,)
    #: For 1 kWh more that may be taken out or put in, over the whole window, (B,).
    energy_floor: Floats
    energy_ceiling: Floats
    #: For 1 kW more rated power of a battery that charges or discharges, (B,).
    battery_charging: Floats
    battery_discharging: Floats
    #: For 1 kVA more of the inverter, (B,) and (P,).
    battery_inverter: Floats
    pv_inverter: Floats
    #: For a limit that lies 0.001 pu further out, at each bus, with phases at all its nodes, (N,).
    voltage_floor: Floats
    voltage_ceiling: Floats
    #: For 1 kVA more through each line, (L,); of a phased feeder through each phase of one, (k,).
    line_rating: Floats
    #: For 1 kVA more on each phase of the formers, (K,); none of a balanced feeder.
    former_phase: Floats
    #: What ratings of lines make of the price of 1 kW or 1 kvar at each bus, (N,).
    line_active: Floats
    line_reactive: Floats
    grid: float  #: for 1 kW more that may be imported, less its price
    #: For 1 kW or 1 kvar put into each bus throughout the step, (N,).
    active: Floats
    reactive: Floats
    #: For serving each customer in the step, (C,): its weight less what its supply is worth to
    #: others.
    service: Floats
    #: What phases make of these prices; None for a balanced feeder.
    phases: PhasePrices | None = None


@dataclass(frozen=True, eq=False)
class PricedWindow:
    """The pricing problem's answer."""

    value: float  #: the objective: weighted customer hours, or GBP where the cost is priced
    served_share: Floats  #: share of each customer that is served, (W, C)
    curtailed_kwh: float  #: PV energy curtailed in the window
    battery_kw: Floats  #: power of each battery, charging positive, (W, B)
    soc: Floats  #: state of charge, the first row at the beginning, (W + 1, B)
    prices: ShadowPrices  #: what one more unit would have bought
    solver_s: float  #: time in the solver in s


@one_at_a_time
def price_window(
    model: ShadowPriceModel,
    data: WindowData,
    held: FixedDecisions,
    priced: PricedTerms,
    time_s: float = 20.0,
) -> PricedWindow | None:
    """Solve a window's pricing problem; None where it has no answer that the solver vouches for.

    ``held`` is held of the record, and ``priced`` is maximised.

    Raises
    ------
    LimitError
        If time ran out.
    """
    model.price(data, held, priced)
    assert model.data is not None
    model.phase_rows = []
    outcome = run_within_limits(model.site, model.data, model, time_s, model.phase_rows)
    if outcome.status in (Status.NO_ANSWER, Status.TIME_LIMIT):
        raise LimitError("A step's shadow prices were not found in time.")
    if outcome.status != Status.OPTIMAL:
        return None
    value = model.value_of
    return PricedWindow(
        value=outcome.value,
        served_share=np.clip(value("x_served"), 0.0, 1.0),
        curtailed_kwh=float(value("P_curt").sum()) * model.site.dt_h,
        battery_kw=value("P_ch") - value("P_dch"),
        soc=value("SoC"),
        prices=_prices(model),
        solver_s=outcome.solve_s,
    )


def _prices(model: ShadowPriceModel) -> ShadowPrices:
    """The duals in the record's units; the signs are those of a gain."""
    site = model.site
    energy_kwh = site.batteries.energy_kwh
    mode = model.value_of("delta")[0]
    dual = model.dual
    active, reactive = (model.worth_at_buses(balance) for balance in BALANCES)
    of_network = _of_phases if site.phases else _of_lines
    rho_dt = -model.factors["f2"] * model.statement.p.rho_dt.value[0]
    return ShadowPrices(
        stored_energy=dual("battery_soc_start") / energy_kwh,
        kept_energy=dual("battery_soc_dynamics")[0] / energy_kwh,
        energy_floor=dual("battery_soc_min").sum(axis=0) / energy_kwh,
        energy_ceiling=dual("battery_soc_max").sum(axis=0) / energy_kwh,
        battery_charging=dual("battery_charge_rated")[0] * mode,
        battery_discharging=dual("battery_discharge_rated")[0] * (1.0 - mode),
        battery_inverter=_of_discs(model, "battery_inverter_capacity"),
        pv_inverter=_of_discs(model, "pv_inverter_capacity"),
        # In an outage the limit meets the bound of 0 from the other side, and its own dual is not
        # unique; what an injection at the slack bus gains is.
        grid=max(float(active[0] - rho_dt), 0.0),
        active=active,
        reactive=reactive,
        service=(dual("service_max") - dual("service_min"))[0],
        **of_network(model),
    )


def _per_milli_pu(per_pu2: Floats | float, limit_pu: float) -> Any:
    """From a squared limit to one 0.001 pu further out."""
    return per_pu2 * 2.0 * limit_pu * 1e-3


def _of_lines(model: ShadowPriceModel) -> dict[str, Floats]:
    """Prices of a balanced network: its voltages, and of the slack bus none, and its lines."""
    net = model.site.network
    per_pu = [
        _per_milli_pu(model.dual(name)[0], limit) / net.bus_ratio[1:] ** 2
        for name, limit in (("voltage_min", net.v_min_pu), ("voltage_max", net.v_max_pu))
    ]
    floor, ceiling = (np.concatenate([[0.0], each]) for each in per_pu)
    rating = np.zeros(net.n_lines)
    if FAMILY in model.rows_of:
        of_rated = model.dual(FAMILY)[0].reshape(-1, model.n_steps)[:, 0]
        rating[rated_lines(model.site)] = np.maximum(of_rated, 0.0)
    flow = np.stack([model.value_of(name)[0] for name in ("P_flow", "Q_flow")])
    # No rating limits a flow without direction.
    direction = flow / np.maximum(np.hypot(*flow), ROUNDING)
    active, reactive = (rating * direction) @ net.downstream
    return {
        "voltage_floor": floor,
        "voltage_ceiling": ceiling,
        "line_rating": rating,
        "former_phase": np.zeros(0),
        "line_active": active,
        "line_reactive": reactive,
    }


def _of_phases(model: ShadowPriceModel) -> dict[str, Any]:
    """Prices of a network with phases, whose rows are in squares and shares."""
    assert model.data is not None
    net = model.site.feeder
    phased = phased_model(model.site)
    source = int(phased.sources(model.data)[0])
    own = slice(len(phased.supplies[max(source, GRID)].forms))
    room_kva = model.data.phased.room_kva[0, own]
    duals, costs = _by_side(model)
    of_former = costs[OF_FORMER][own].swapaxes(0, 1)
    of_rating = costs[OF_RATING].swapaxes(0, 1)
    by_voltage = costs[LOW].sum(axis=0) + costs[HIGH].sum(axis=0)
    return {
        "voltage_floor": duals[LOW] * _per_milli_pu(PER_PU2, net.v_min_pu),
        "voltage_ceiling": duals[HIGH] * _per_milli_pu(PER_PU2, net.v_max_pu),
        "line_rating": duals[OF_RATING] * (1.0 / phased.rated_kva),
        "former_phase": duals[OF_FORMER][own] * (1.0 / np.maximum(room_kva, NO_POWER_KW)),
        "line_active": np.zeros(net.n_buses),
        "line_reactive": np.zeros(net.n_buses),
        "phases": PhasePrices(*of_former, *of_rating, *by_voltage),
    }


def _of_discs(model: ShadowPriceModel, name: str) -> Floats:
    """Value of one more kVA in the first step, from cones or from the sides of polygons."""
    W = model.n_steps
    dual = model.dual(name)
    if not model.sides:
        return np.asarray(dual[0].reshape(-1, W)[:, 0])
    per_side = dual.reshape(model.sides, W, -1)
    return np.asarray(per_side[:, 0].sum(axis=0) * np.cos(np.pi / model.sides))


def _by_side(model: ShadowPriceModel) -> tuple[dict[int, Floats], dict[int, Floats]]:
    """Duals of the first step by side, added up by place; and by place, kW or kvar, and asset."""
    assert model.data is not None
    phased = phased_model(model.site)
    n_buses = model.site.feeder.n_buses
    n_former = model.data.phased.room_kva.shape[1]
    n_rated = len(phased.rated_kva)
    sizes = {LOW: n_buses, HIGH: n_buses, OF_FORMER: n_former, OF_RATING: n_rated}
    assets = len(phased.at_bus_of_assets)
    duals = {side: np.zeros(size) for side, size in sizes.items()}
    costs = {side: np.zeros((size, 2, assets)) for side, size in sizes.items()}
    found = [rows for rows in model.phase_rows if isinstance(rows, PhaseRows)]
    first = len(model.duals) - sum(len(rows.steps) for rows in found)
    for rows in found:
        dual = np.maximum(model.duals[first : first + len(rows.steps)], 0.0)
        first += len(rows.steps)
        dual = np.where(rows.steps == 0, dual, 0.0)
        places = phased.at_bus[rows.places] if rows.side in (LOW, HIGH) else rows.places
        np.add.at(duals[rows.side], places, dual)
        by_asset = -np.stack([rows.by_p, rows.by_q], axis=1) * dual[:, None, None]
        np.add.at(costs[rows.side], places, by_asset)
    return duals, costs

"""Data of a window's problem: fixed ones of the site, and those that change at every step."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace

import numpy as np

from vppres.contract.ahead import KindsAhead
from vppres.contract.moves import Moves
from vppres.contract.observation import Observation
from vppres.contract.operating_point import Centre
from vppres.contract.stored_value import Ending, StoredValue
from vppres.contract.terminal import Terminal
from vppres.core.arrays import ByStep, Complexes, Flags, Floats, Wholes
from vppres.kinds.batteries.physics import BatteriesAhead
from vppres.kinds.customer.physics import Owed, SwitchingData
from vppres.kinds.export.physics import Export
from vppres.model.linearise import Drawn, delta_offset, drawn_by
from vppres.model.parts import Parts, at_items, held_by_units, parts_of
from vppres.model.site import Site
from vppres.scenario.assets import Batteries
from vppres.scenario.network import Network


@dataclass(frozen=True, eq=False)
class Physics(ByStep):
    """Losses and headroom of physical mode in a window of W steps."""

    #: Losses of the lines at the AC points the window is linearised at, not negative, (W, L).
    loss_kw: Floats
    loss_kvar: Floats
    #: Bus that holds the voltage, (W,): 0, the grid's, or a grid-forming battery's.
    reference: Wholes
    headroom_kw: Floats  #: power that is kept free in both directions, (W, B)
    #: State of charge that is kept above ``soc_min`` at the end of each step, (W, B).
    soc_reserve: Floats


@dataclass(frozen=True, eq=False)
class Unspent(ByStep):
    """Limits that keep stored energy while PV power is curtailed, in a window of W steps."""

    discharge_kw: Floats  #: largest discharging power, (W, B): none where PV power is enough
    curtailed_kw: Floats  #: largest curtailed power, (W,): none where it is not


@dataclass(frozen=True, eq=False)
class PhasedWindow(ByStep):
    """Linearisation of a window of W steps on a phased feeder; m voltages have limits."""

    u_offset: Floats  #: squared voltages with nothing drawn that meet the AC points, (W, m)
    #: The same of the sources' power by phase in kVA, one source after another, (W, K).
    former_offset: Complexes
    #: Limits, (W, m).
    u_min: Floats
    u_max: Floats
    room_kva: Floats  #: what each phase of a former may carry, (W, K)
    bound: Flags  #: lower and upper limits that bound the last candidate, (W, 2, m)
    former_kva: Complexes  #: the sources' power by phase at the AC points, (W, K)
    #: Currents that have a rating, as shares of it, with nothing drawn that meet the AC points, (W,
    #: k).
    current_offset: Complexes
    current_max: Floats  #: their limits, (W, k); infinite where nothing limits them
    current_own: Floats  #: what they are without control, where ratings give way to it, (W, k)


ROWS = (
    *("load_kw", "pv_kw", "price_gbp_per_kwh", "grid_limit_kw"),
    *("delta_pu2", "own_u_pu2", "flow_max_kva"),
)
"""Arrays of a window that have a row for each of its steps."""


@dataclass(frozen=True, eq=False)
class WindowData:
    """Data that change with every solve, for a window of W steps."""

    load_kw: Floats  #: forecast demand, (W, C)
    pv_kw: Floats  #: forecast available PV power, (W, P)
    price_gbp_per_kwh: Floats  #: import price, (W,)
    grid_limit_kw: Floats  #: largest import, 0 in an outage, may be infinite, (W,)
    soc: Floats  #: state of charge at the beginning of the window, (B,)
    #: Efficiencies, held over the window (paper, Section 5.2), (B,).
    eta_charge: Floats
    eta_discharge: Floats
    #: Right-hand side of the delta form of LinDistFlow, (W, L); zero gives plain LinDistFlow.
    delta_pu2: Floats
    #: Losses, island and headroom of physical mode; absent in the paper's problem.
    physics: Physics = field(default_factory=Physics.absent)
    switching: SwitchingData | None = None  #: rules on switching customers; None is the paper
    #: The previous plan, where moves away from it are to be few; None is the paper.
    moves: Moves | None = None
    #: What the grid takes back; absent in the paper, whose connection imports only.
    export: Export = field(default_factory=Export.absent)
    #: What the network itself draws; absent where it has no shunt, charging or fixed demand.
    drawn: Drawn = field(default_factory=Drawn.absent)
    #: Who was on supply just before the window, (C,); None if it is not known.
    on_before: Flags | None = None
    open_ended: bool = False  #: whether outages may last longer than the window says
    #: Whether the run is known to end with the window, so that no outage goes on behind it.
    ends: bool = False
    #: What batteries are to hold at the end; None, the paper, lets them end empty.
    terminal: Terminal | None = None
    #: What is left in the batteries at the end is worth; None, the paper, sees nothing behind.
    stored_value: StoredValue | None = None
    #: Squared referred voltages that the feeder has without control, to which its limits give way,
    #: (W, N); NaN where they do not. No row, the paper, has hard limits.
    own_u_pu2: Floats = field(default_factory=lambda: np.empty((0, 0)))
    #: Largest flow of each line, (W, L); no row, the paper, has no ratings.
    flow_max_kva: Floats = field(default_factory=lambda: np.empty((0, 0)))
    #: Voltages and former by phase; absent of a balanced feeder.
    phased: PhasedWindow = field(default_factory=PhasedWindow.absent)
    #: Customers that cannot be dimmed, (C,); None where all that the site dims can be.
    whole: Flags | None = None
    owed: Owed = field(kw_only=True)  #: what dimmed customers may catch up from before the window
    parts: Parts = field(kw_only=True)  #: parts into which lines that are out cut the feeder
    #: What keeps stored energy while PV power is curtailed; absent in the paper.
    unspent: Unspent = field(default_factory=Unspent.absent)
    #: Vehicles, rooms and generating sets; none if not given.
    ahead: KindsAhead = field(default_factory=KindsAhead)

    @classmethod
    def of(cls, observation: Observation, site: Site, centre: Centre) -> WindowData:
        """The window that an observation shows, linearised at its last AC point."""
        forecast = observation.window
        n_steps = len(forecast.price_gbp_per_kwh)
        point = observation.operating_point
        offset = np.tile(delta_offset(site.network, point, centre), (n_steps, 1))
        island = forecast.grid_limit_kw <= 0.0
        parts = parts_of(site, forecast.out, observation.soc, island, False)
        if point is not None:
            # Across a line that was out there is no drop of a line.
            back = point.lines_out & ~parts.lines
            offset = np.where(back | np.isnan(offset), 0.0, offset)
        stores = len(site.batteries) > 0
        rules = observation.rules
        found = cls(
            load_kw=forecast.load_kw,
            pv_kw=forecast.pv_kw,
            price_gbp_per_kwh=forecast.price_gbp_per_kwh,
            grid_limit_kw=forecast.grid_limit_kw,
            soc=observation.soc,
            eta_charge=observation.eta_charge,
            eta_discharge=observation.eta_discharge,
            delta_pu2=offset,
            switching=None if rules is None else rules.priced(site.hour_beyond, site.dt_h),
            moves=observation.moves,
            export=forecast.export or Export.absent(),
            drawn=drawn_by(
                site.network,
                None if point is None else point.v_pu,
                island,
                parts.of_bus,
            ),
            on_before=observation.served,
            open_ended=observation.open_ended,
            ends=observation.ends and observation.stored_value is None,
            terminal=observation.end if stores else None,
            stored_value=observation.stored_value if stores else None,
            whole=observation.whole,
            owed=observation.owed,
            ahead=observation.ahead.part(slice(n_steps)),
            parts=parts,
        )
        return found.in_parts(site, parts)

    def in_parts(self, site: Site, parts: Parts) -> WindowData:
        """The window in a feeder that is cut into parts, with nothing in dead ones."""
        places = {kind: site.unit_bus[kind] for kind in self.ahead.by_kind}
        lit = {kind: ~at_items(parts.dead, place) for kind, place in places.items()}
        held = held_by_units(site, parts)
        of_units = {kind: held[:, place.tocsc().indices] for kind, place in places.items()}
        off = at_items(parts.dead, site.customer_bus)
        return replace(
            self,
            parts=parts,
            ahead=self.ahead.in_dead_parts(lit).holding(of_units),
            switching=self.switching and self.switching.in_the_dark(off),
            drawn=self.drawn and self.drawn.at(~parts.dead),
        )

    @property
    def n_steps(self) -> int:
        """Steps W of the window."""
        return len(self.price_gbp_per_kwh)

    def formed(self, site: Site, dark: Flags, headroom: float) -> tuple[WindowData, Flags]:
        """Window with the units of kinds that form dark steps, (W,), and the steps that stay dark.

        ``headroom`` is the share of a rating that is left free above and below the plan.
        """
        ahead, dark = self.ahead.formed(dark, headroom)
        return replace(self, ahead=ahead), dark

    def first(self, n_steps: int) -> WindowData:
        """The first steps of the window."""
        return self.part(slice(n_steps))

    def part(self, steps: slice) -> WindowData:
        """Some steps of the window; ``soc`` stays that of its beginning."""
        tables = {f.name: getattr(self, f.name) for f in fields(self)}
        cut = {name: each.part(steps) for name, each in tables.items() if hasattr(each, "part")}
        begin, end, _ = steps.indices(self.n_steps)
        to_the_end = end == self.n_steps
        return replace(
            self,
            **{name: tables[name][steps] for name in ROWS},
            **cut,
            on_before=None if begin else self.on_before,
            ends=self.ends and to_the_end,
            terminal=self.terminal if to_the_end else None,
            stored_value=self.stored_value if to_the_end else None,
        )

    def u_limits_pu2(self, network: Network) -> tuple[Floats, Floats]:
        """Lowest and highest squared referred voltages, (W, N) each."""
        shape = (self.n_steps, network.n_buses)
        limits = (network.u_min_pu2, network.u_max_pu2)
        lowest, highest = (np.broadcast_to(each, shape) for each in limits)
        if not len(self.own_u_pu2):
            return lowest, highest
        return np.fmin(lowest, self.own_u_pu2), np.fmax(highest, self.own_u_pu2)

    @property
    def ending(self) -> Ending:
        """Condition at the window's end."""
        if self.stored_value is not None:
            return "value"
        return "" if self.terminal is None else "target"

    @property
    def keeps_service(self) -> bool:
        """Whether later service is weighed against service: then service is no whole number."""
        return self.stored_value is not None and self.stored_value.as_service

    def soc_path(self, site: Site, charge_kw: Floats, discharge_kw: Floats) -> Floats:
        """State of charge before every step and after the last, limits left out, (W + 1, B)."""
        return BatteriesAhead.of(site.batteries, self, site.dt_h).path(charge_kw, discharge_kw)

    def active_max_kw(self, batteries: Batteries) -> Floats:
        """Largest active power that a plan may ask of each battery, (W, B)."""
        most_kw = np.tile(batteries.active_max_kw, (self.n_steps, 1))
        return most_kw - self.physics.headroom_kw if self.physics else most_kw

    def soc_min(self, batteries: Batteries) -> Floats:
        """Least state of charge at the end of each step, (W, B)."""
        least = np.tile(batteries.soc_min, (self.n_steps, 1))
        return least + self.physics.soc_reserve if self.physics else least

    @property
    def loss_kw(self) -> Floats:
        """Losses of all lines, (W,); zero in the paper's mode."""
        return self.physics.loss_kw.sum(axis=1) if self.physics else np.zeros(self.n_steps)

    @property
    def network_kw(self) -> Floats:
        """Losses of all lines and what the network itself draws, (W,)."""
        return self.loss_kw + self.drawn.kw.sum(axis=1) if self.drawn else self.loss_kw

    @property
    def limits_time_off(self) -> bool:
        """Whether any customer may be off for so long only."""
        return self.switching is not None and len(self.switching.longest_off) > 0

    def for_service(self, served: Flags) -> WindowData:
        """The window with the demand that a service brings about: higher after a restoration."""
        if self.switching is None or not self.switching.steps.cold:
            return self
        return replace(self, load_kw=self.load_kw * self.switching.demand_factor(served))

    @property
    def dark(self) -> Flags:
        """Steps without any import, (W,)."""
        return np.asarray(self.grid_limit_kw <= 0.0)

    def all_cold(self) -> WindowData:
        """The window with the largest demand that any service can bring about."""
        if self.switching is None or not self.switching.steps.cold:
            return self
        return replace(self, load_kw=self.load_kw * self.switching.cold_factor)

    def most_load_kw(self, site: Site) -> Floats:
        """Largest demand of each customer, just restored or catching up, (W, C)."""
        return np.asarray(self.all_cold().load_kw * site.customers.most_share)

    def self_limit_kw(self, site: Site) -> Floats:
        """Self-consumption of each PV system if its owner is served, shape (W, P)."""
        return np.minimum(site.behind_meter(self.load_kw), self.pv_kw)

    def grid_p_max_kw(self, site: Site) -> Floats:
        """Largest import that can ever be useful, or the limit where that is smaller, (W,).

        Nothing is exported at the same time, so no more than all demand, with what is caught up,
        and all charging is ever imported.
        """
        load_kw = self.most_load_kw(site).sum(axis=1)
        useful = load_kw + site.batteries.p_max_kw.sum() + self.network_kw
        useful = sum(self.ahead.most_taken_kw(), start=useful)
        return np.maximum(np.minimum(self.grid_limit_kw, useful), 0.0)

    @property
    def network_gives_kw(self) -> Floats:
        """Power that the network gives on balance, as a fixed demand may be negative, (W,)."""
        if not self.drawn:
            return np.zeros(self.n_steps)
        return np.asarray(np.maximum(-self.drawn.kw.sum(axis=1), 0.0))

    @property
    def beyond_limit_kw(self) -> Floats:
        """The most of what the network gives that is beyond the limit of export, (W,).

        Nothing holds it back, and the grid takes it all the same where there is one.
        """
        limit_kw = self.export.limit_kw if self.export else 0.0
        beyond_kw = np.maximum(self.network_gives_kw - limit_kw, 0.0)
        return np.asarray(np.where(self.grid_limit_kw > 0.0, beyond_kw, 0.0))

    @property
    def in_island(self) -> Flags:
        """Buses of islands, (W, N)."""
        return ~self.with_grid

    @property
    def with_grid(self) -> Flags:
        """Buses that the grid reaches, (W, N)."""
        return ~self.dark[:, None] & ~self.parts.beyond

    def export_max_kw(self, site: Site) -> Floats:
        """Largest export that there can ever be, or the limit where that is smaller, (W,).

        No more than all PV power and all discharging; nothing where the grid is away.
        """
        if not self.export:
            return np.zeros(self.n_steps)
        possible = self.pv_kw.sum(axis=1) + site.batteries.p_max_kw.sum() + self.network_gives_kw
        possible = sum(self.ahead.most_given_kw(), start=possible)
        connected = self.grid_limit_kw > 0.0
        return np.where(connected, np.minimum(self.export.limit_kw, possible), 0.0)

    def grid_q_max_kvar(self, site: Site) -> Floats:
        """Largest reactive exchange with the grid that devices and loads allow, (W,)."""
        possible = (
            self.most_load_kw(site) @ np.abs(site.customers.q_per_p)
            + site.batteries.s_max_kva.sum()
            + site.pv.s_max_kva.sum()
        )
        if self.physics:
            possible = possible + self.physics.loss_kvar.sum(axis=1)
        if self.drawn:
            possible = possible + np.abs(self.drawn.kvar).sum(axis=1)
        return np.where(self.grid_limit_kw > 0.0, possible, 0.0)

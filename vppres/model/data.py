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
from vppres.core.arrays import Complexes, Flags, Floats, Wholes
from vppres.core.errors import ModelError
from vppres.kinds.batteries.physics import BatteriesAhead
from vppres.kinds.customer.physics import Owed, SwitchingData
from vppres.kinds.export.physics import Export
from vppres.model.linearise import Drawn, delta_offset, drawn_by
from vppres.model.parts import Parts, at_items, held_by_units, parts_of
from vppres.model.site import Site
from vppres.scenario.assets import SOC_ROUNDING, Batteries
from vppres.scenario.network import Network


@dataclass(frozen=True, eq=False)
class Physics:
    """Losses and headroom of physical mode in a window of W steps."""

    #: Losses of the lines at the AC points the window is linearised at, not negative, (W, L).
    loss_kw: Floats
    loss_kvar: Floats
    #: Bus that holds the voltage, (W,): 0, the grid's, or a grid-forming battery's.
    reference: Wholes
    headroom_kw: Floats  #: power that is kept free in both directions, (W, B)
    #: State of charge that is kept above ``soc_min`` at the end of each step, (W, B).
    soc_reserve: Floats

    def part(self, steps: slice) -> Physics:
        """Some of the steps."""
        return Physics(*(getattr(self, f.name)[steps] for f in fields(self)))


@dataclass(frozen=True, eq=False)
class Unspent:
    """Limits that keep stored energy while PV power is curtailed, in a window of W steps."""

    discharge_kw: Floats  #: largest discharging power, (W, B): none where PV power is enough
    curtailed_kw: Floats  #: largest curtailed power, (W,): none where it is not

    def part(self, steps: slice) -> Unspent:
        """Some of the steps."""
        return Unspent(self.discharge_kw[steps], self.curtailed_kw[steps])


@dataclass(frozen=True, eq=False)
class PhasedWindow:
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

    def part(self, steps: slice) -> PhasedWindow:
        """Some of the steps."""
        return PhasedWindow(*(getattr(self, f.name)[steps] for f in fields(self)))


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
    #: Losses, island and headroom of physical mode; None is the paper's problem.
    physics: Physics | None = None
    switching: SwitchingData | None = None  #: rules on switching customers; None is the paper
    #: The previous plan, where moves away from it are to be few; None is the paper.
    moves: Moves | None = None
    #: What the grid takes back; None is the paper's connection, which imports only.
    export: Export | None = None
    #: What the network itself draws; None where it has no shunt, charging or fixed demand.
    drawn: Drawn | None = None
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
    phased: PhasedWindow | None = None  #: voltages and former by phase; None for a balanced feeder
    #: Customers that cannot be dimmed, (C,); None where all that the site dims can be.
    whole: Flags | None = None
    owed: Owed = field(kw_only=True)  #: what dimmed customers may catch up from before the window
    parts: Parts = field(kw_only=True)  #: parts into which lines that are out cut the feeder
    #: What keeps stored energy while PV power is curtailed; None, the paper, for nothing.
    unspent: Unspent | None = None
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
            export=forecast.export,
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

    def with_sound_soc(self, batteries: Batteries) -> WindowData:
        """The window with states of charge at their limits that miss them by rounding.

        A state outside leaves a battery that may not move no dispatch, however little it is.
        """
        inside = np.clip(self.soc, batteries.soc_min, batteries.soc_max)
        rounding = np.abs(self.soc - inside) <= SOC_ROUNDING
        return replace(self, soc=np.where(rounding, inside, self.soc))

    @property
    def asks_for_sooner(self) -> bool:
        """Whether the paper is silent on which of equal plans is taken (``docs/method.md``)."""
        return self.physical or self.open_ended

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

    def require_phased(self) -> PhasedWindow:
        """The phases of a window that must have them.

        Raises
        ------
        ModelError
            If it has none.
        """
        if self.phased is None:
            raise ModelError("A window of a balanced feeder has no phases.")
        return self.phased

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
        cut = {
            name: getattr(self, name)[steps]
            for name in (
                *("load_kw", "pv_kw", "price_gbp_per_kwh", "grid_limit_kw", "delta_pu2"),
                *("own_u_pu2", "flow_max_kva"),
            )
        }
        to_the_end = steps.indices(self.n_steps)[1] == self.n_steps
        return replace(
            self,
            **cut,
            physics=self.physics and self.physics.part(steps),
            switching=self.switching and self.switching.part(steps),
            moves=self.moves and self.moves.part(steps),
            export=self.export and self.export.part(steps),
            drawn=self.drawn and self.drawn.part(steps),
            on_before=None if steps.indices(self.n_steps)[0] else self.on_before,
            ends=self.ends and to_the_end,
            terminal=self.terminal if to_the_end else None,
            stored_value=self.stored_value if to_the_end else None,
            phased=self.phased and self.phased.part(steps),
            parts=self.parts.steps(steps),
            unspent=self.unspent and self.unspent.part(steps),
            ahead=self.ahead.part(steps),
        )

    def u_limits_pu2(self, network: Network) -> tuple[Floats, Floats]:
        """Lowest and highest squared referred voltages, (W, N) each."""
        shape = (self.n_steps, network.n_buses)
        lowest = np.broadcast_to(network.u_min_pu2, shape)
        highest = np.broadcast_to(network.u_max_pu2, shape)
        if not len(self.own_u_pu2):
            return lowest, highest
        return np.fmin(lowest, self.own_u_pu2), np.fmax(highest, self.own_u_pu2)

    @property
    def ending(self) -> Ending:
        """Condition at the window's end."""
        if self.stored_value is not None:
            return "value"
        return "" if self.terminal is None else "target"

    def require_value(self) -> StoredValue:
        """The value of a window that must have one.

        Raises
        ------
        ModelError
            If it has none.
        """
        if self.stored_value is None:
            raise ModelError("A problem with a value was filled with a window without.")
        return self.stored_value

    @property
    def keeps_service(self) -> bool:
        """Whether later service is weighed against service: then service is no whole number."""
        return self.stored_value is not None and self.stored_value.as_service

    def soc_path(self, site: Site, charge_kw: Floats, discharge_kw: Floats) -> Floats:
        """State of charge before every step and after the last, limits left out, (W + 1, B)."""
        return BatteriesAhead.of(site.batteries, self, site.dt_h).path(charge_kw, discharge_kw)

    def kept_range(self, site: Site) -> tuple[float, float]:
        """Least and most that the energy at the end can be worth, in weighted customer hours."""
        if self.stored_value is None:
            return 0.0, 0.0
        b = site.batteries
        charged_kw = float(self.eta_charge @ b.active_max_kw)
        drawn_kw = float((b.active_max_kw / self.eta_discharge).sum())
        held_kwh = float(b.energy_kwh @ self.soc)
        hours = self.n_steps * site.dt_h
        most_kwh = min(
            held_kwh + charged_kw * hours, max(float(b.energy_kwh @ b.soc_max), held_kwh)
        )
        least_kwh = max(held_kwh - drawn_kw * hours, min(float(b.energy_kwh @ b.soc_min), held_kwh))
        for kind, kwh_each in self.stored_value.kwh_each.items():
            most_kwh += self.ahead.by_kind[kind].most_left_kwh(kwh_each)
        return self.stored_value.between(least_kwh, most_kwh)

    def active_max_kw(self, batteries: Batteries) -> Floats:
        """Largest active power that a plan may ask of each battery, (W, B)."""
        most_kw = np.tile(batteries.active_max_kw, (self.n_steps, 1))
        return most_kw if self.physics is None else most_kw - self.physics.headroom_kw

    def soc_min(self, batteries: Batteries) -> Floats:
        """Least state of charge at the end of each step, (W, B)."""
        least = np.tile(batteries.soc_min, (self.n_steps, 1))
        return least if self.physics is None else least + self.physics.soc_reserve

    @property
    def loss_kw(self) -> Floats:
        """Losses of all lines, (W,); zero in the paper's mode."""
        return (
            np.zeros(self.n_steps)
            if self.physics is None
            else np.asarray(self.physics.loss_kw.sum(axis=1))
        )

    @property
    def network_kw(self) -> Floats:
        """Losses of all lines and what the network itself draws, (W,)."""
        if self.drawn is None:
            return self.loss_kw
        return np.asarray(self.loss_kw + self.drawn.kw.sum(axis=1))

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
        if self.drawn is None:
            return np.zeros(self.n_steps)
        return np.asarray(np.maximum(-self.drawn.kw.sum(axis=1), 0.0))

    @property
    def beyond_limit_kw(self) -> Floats:
        """The most of what the network gives that is beyond the limit of export, (W,).

        Nothing holds it back, and the grid takes it all the same where there is one.
        """
        limit_kw = 0.0 if self.export is None else self.export.limit_kw
        beyond_kw = np.maximum(self.network_gives_kw - limit_kw, 0.0)
        return np.asarray(np.where(self.grid_limit_kw > 0.0, beyond_kw, 0.0))

    @property
    def in_island(self) -> Flags:
        """Buses of islands, (W, N)."""
        return ~self.with_grid

    @property
    def lines_in_island(self) -> Flags:
        """Lines of islands, (W, L)."""
        return self.in_island[:, 1:]

    @property
    def with_grid(self) -> Flags:
        """Buses that the grid reaches, (W, N)."""
        return ~self.dark[:, None] & ~self.parts.beyond

    @property
    def both_ways_earn(self) -> bool:
        """Whether importing and exporting at once would earn in a step with grid."""
        return self.export is not None and self.export.earns_both_ways(
            self.price_gbp_per_kwh, self.grid_limit_kw
        )

    def export_max_kw(self, site: Site) -> Floats:
        """Largest export that there can ever be, or the limit where that is smaller, (W,).

        No more than all PV power and all discharging; nothing where the grid is away.
        """
        if self.export is None:
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
        if self.physics is not None:
            possible = possible + self.physics.loss_kvar.sum(axis=1)
        if self.drawn is not None:
            possible = possible + np.abs(self.drawn.kvar).sum(axis=1)
        return np.where(self.grid_limit_kw > 0.0, possible, 0.0)

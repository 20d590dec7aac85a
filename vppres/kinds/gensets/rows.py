"""Generating sets: on and off, starts, ramps, least times, and a tank of fuel.

A set has one binary for each step. Its starts follow from it and are whole by themselves. Fuel is a
line over the power, so its level is exact. What is burnt costs its price and what is left does not:
the price is the worth of a litre at the end of a window. Without sets no problem has any of this.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import cvxpy as cp
import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.contract.stored_value import StoredValue
from vppres.core.arrays import Flags, Floats, Wholes
from vppres.kinds.gensets import steps_of
from vppres.kinds.kind import UnitPlan
from vppres.model.beyond_paper.addition import Addition, AdditionDispatch, Taken
from vppres.model.constraints import Named
from vppres.model.data import WindowData
from vppres.model.numerics import write
from vppres.model.parts import at_items
from vppres.model.site import Site
from vppres.model.variables import Parameters, Variables


@dataclass(frozen=True, eq=False)
class GensetsModel(Addition):
    """Variables and parameters of G sets over W steps."""

    by_dispatch: ClassVar[tuple[str, ...]] = ("gs_on", "gs_start", "gs_power", "gs_fuel")
    met: ClassVar[tuple[str, ...]] = (
        "gs_most",
        "gs_least",
        "gs_starts",
        "gs_can_start",
        "gs_can_run",
        "gs_must_run",
        "gs_in_use",
        "gs_min_on",
        "gs_min_off",
        "gs_ramp_up",
        "gs_ramp_down",
        "gs_fuel_level",
        "gs_tank",
    )

    of_network: ClassVar[tuple[str, ...]] = ("gs_reactive",)

    site: Site  #: fixed data
    on: cp.Variable  #: 1 for a set that runs, (W, G)
    start: cp.Variable  #: 1 for a set that starts, (W, G)
    #: Power in kW, (W, G); fuel at the end of the step in litres.
    power: cp.Variable
    fuel: cp.Variable
    #: See :class:`vppres.kinds.gensets.physics.SetsAhead`, (W, G).
    can_run: cp.Parameter
    can_start: cp.Parameter
    must_run: cp.Parameter
    was_on: cp.Parameter
    was_kw: cp.Parameter
    added: cp.Parameter
    #: Energy in a battery that a litre stands for at the end, where such energy has a value, (G,).
    stands_for: cp.Parameter
    #: Reactive power as a share of the largest, (W, G); none where no set can form the grid.
    reactive: cp.Variable | None = None
    #: What a set that forms the grid leaves free in kW, its largest reactive power, and by how much
    #: it moves beyond its ramps in kW, (W, G): it follows the load.
    headroom: cp.Parameter | None = None
    q_most: cp.Parameter | None = None
    at_once: cp.Parameter | None = None
    holding: bool = False  #: whether a set that need not run gives its part reactive power

    @classmethod
    def shape(cls, site: Site, data: WindowData) -> Hashable | None:
        """Whether there are any, and whether one can form the grid, or holds a part."""
        if KIND not in data.ahead.by_kind:
            return None
        if data.ahead.known(KIND).holds.any():
            return "holding"
        return "forming" if site.gensets.grid_forming.any() else "following"

    @classmethod
    def create(cls, site: Site, v: Variables, shape: Hashable) -> Self:
        """Sets of a window."""
        size = (v.x_served.shape[0], len(site.gensets))
        names = ("can_run", "can_start", "must_run", "was_on", "was_kw", "added")
        forming: dict[str, Any] = {}
        if shape != "following":
            forming = {
                "holding": shape == "holding",
                "reactive": cp.Variable(size, name="gs_reactive", bounds=[-1.0, 1.0]),
                "headroom": cp.Parameter(size, name="gs_headroom_by_step", nonneg=True),
                "q_most": cp.Parameter(size, name="gs_q_most_by_step", nonneg=True),
                "at_once": cp.Parameter(size, name="gs_at_once_by_step", nonneg=True),
            }
        return cls(
            site,
            cp.Variable(size, name="gs_on", boolean=True),
            cp.Variable(size, name="gs_start", nonneg=True),
            cp.Variable(size, name="gs_power", nonneg=True),
            cp.Variable(size, name="gs_fuel", nonneg=True),
            **{name: cp.Parameter(size, name=f"gs_{name}_by_step", nonneg=True) for name in names},
            stands_for=cp.Parameter(size[1], name="gs_kwh_per_litre", nonneg=True),
            **forming,
        )

    def parameters(self, site: Site) -> dict[str, cp.Expression]:
        """Power of sets, from which batteries may charge, and what their fuel stands for."""
        return {
            "P_fed_added": cp.sum(self.power, axis=1),
            "E_kept_added": self.stands_for @ self.fuel[-1],
        }

    def taken(self, site: Site) -> dict[str, Taken]:
        """Power that sets give, and reactive power of those that can form the grid."""
        return {KIND: (-self.power, None if self.reactive is None else -self._given_kvar)}

    def families(self, site: Site, v: Variables, p: Parameters) -> Named:
        """Switching, powers and fuel, and what a set that forms the grid leaves free."""
        return switching(self) | powers(self) | fuel(self) | forming(self)

    @property
    def _given_kvar(self) -> cp.Expression:
        """Reactive power of each set, (W, G), of sites where one can form the grid."""
        assert self.reactive is not None
        return cp.multiply(self.q_most, self.reactive)

    @property
    def litres(self) -> cp.Expression:
        """Fuel burnt in each step, (W, G)."""
        sets = self.site.gensets
        of_power = _times(self.power, self.site.dt_h * sets.litres_per_kwh)
        return of_power + _times(self.on, self.site.dt_h * sets.litres_per_h_idle)

    def terms(self) -> dict[str, cp.Expression]:
        """Cost of fuel and starts."""
        sets = self.site.gensets
        fuel = cp.sum(_times(self.litres, sets.fuel_price_gbp_per_litre))
        return {"f2": fuel + cp.sum(_times(self.start, sets.start_cost_gbp))}

    def fill(self, site: Site, data: WindowData) -> None:
        """Write the sets of a window."""
        ahead = data.ahead.known(KIND)
        write(self.can_run, ahead.can_run.astype(float))
        outage = at_items(data.in_island, site.unit_bus[KIND])
        may_start = ahead.rested & ahead.can_run & (outage | ~site.gensets.only_in_outage)
        write(self.can_start, may_start.astype(float))
        write(self.must_run, ahead.must_run.astype(float))
        write(self.was_on, ahead.was_on)
        write(self.was_kw, ahead.was_kw)
        write(self.added, ahead.added_litres)
        if self.headroom is not None and self.q_most is not None and self.at_once is not None:
            write(self.headroom, ahead.headroom_kw)
            write(self.at_once, np.where(ahead.forms, site.gensets.p_max_kw, 0.0))
            write(self.q_most, np.where(ahead.forms | ahead.holds, site.gensets.q_max_kvar, 0.0))
        value = data.stored_value or StoredValue.nothing()
        write(self.stands_for, value.kwh_each.get(KIND, np.zeros(len(site.gensets))))

    @classmethod
    def worth(cls, site: Site, data: WindowData, dispatch: Dispatch) -> dict[str, float]:
        """Cost of fuel and starts."""
        sets = site.gensets
        on, power_kw = running(site, dispatch)
        litres = sets.litres(on, power_kw, site.dt_h)
        starts = data.ahead.known(KIND).starts(on)
        cost = litres @ sets.fuel_price_gbp_per_litre + starts @ sets.start_cost_gbp
        return {"f2": float(cost.sum())}

    @classmethod
    def cost_range(
        cls, site: Site, data: WindowData, least_gbp: Floats, dearest_gbp: Floats
    ) -> tuple[Floats, Floats]:
        """All sets at their largest power, and started, in every step."""
        sets = site.gensets
        litres = sets.litres(np.ones(len(sets), dtype=bool), sets.p_max_kw, site.dt_h)
        most_gbp = litres @ sets.fuel_price_gbp_per_litre + sets.start_cost_gbp.sum()
        return least_gbp, dearest_gbp + float(most_gbp)

    def of_dispatch(self, site: Site, data: WindowData, dispatch: Dispatch) -> AdditionDispatch:
        """Switching, power and fuel of every set."""
        ahead = data.ahead.known(KIND)
        on, power_kw = running(site, dispatch)
        fuel = ahead.fuel_litres(UnitPlan(-power_kw, on, on))
        letters = (on.astype(float), ahead.starts(on).astype(float), power_kw, fuel)
        return AdditionDispatch(dict(zip(self.by_dispatch, letters, strict=True)))

    def read(self, found: Dispatch) -> Dispatch:
        """Which sets run, and what each gives."""
        on = np.reshape(np.asarray(self.on.value, dtype=float), self.on.shape) > 0.5
        power_kw = np.reshape(np.asarray(self.power.value, dtype=float), self.power.shape)
        sets = self.site.gensets
        within_kw = np.clip(power_kw, sets.p_min_kw, sets.p_max_kw)
        found = found.acting(KIND, -np.where(on, within_kw, 0.0), on)
        if self.reactive is None or self.reactive.value is None:
            return found
        given_kvar = np.reshape(self._given_kvar.value, on.shape)
        return replace(found, given_kvar={KIND: given_kvar})


def switching(m: GensetsModel) -> Named:
    """Starts, least times on and off, and the steps in which a set may be on."""
    sets = m.site.gensets
    young = _recent_starts(m, sets.min_on_h)
    # 1 where a set that could form the grid cannot run: its fuel ends its least time on.
    spent = 0.0 if m.reactive is None else 1.0 - m.can_run
    return {
        "gs_starts": m.on - _before(m.on, m.was_on) <= m.start,
        "gs_can_start": m.start <= m.can_start,
        "gs_can_run": m.on <= m.can_run,
        "gs_must_run": m.on >= m.must_run,
        "gs_in_use": m.on <= m.can_start + m.must_run + young,
        "gs_min_on": young <= m.on + spent,
        "gs_min_off": _recent_starts(m, sets.min_off_h) + _on_then(m) <= 1.0,
    }


def powers(m: GensetsModel) -> Named:
    """Largest and least power, and ramps; a set may stop from any power."""
    sets, dt_h = m.site.gensets, m.site.dt_h
    rise_kw, fall_kw = (
        np.minimum(ramp_kw_per_h * dt_h, sets.p_max_kw)
        for ramp_kw_per_h in (sets.ramp_up_kw_per_h, sets.ramp_down_kw_per_h)
    )
    on_before = _before(m.on, m.was_on)
    rise = m.power - _before(m.power, m.was_kw)
    stop = on_before - m.on + m.start
    at_once = 0.0 if m.at_once is None else m.at_once
    return {
        "gs_most": m.power <= _times(m.on, sets.p_max_kw),
        "gs_least": m.power >= _times(m.on, sets.p_min_kw),
        "gs_ramp_up": rise
        <= _times(on_before, rise_kw)
        + _times(m.start, np.maximum(sets.p_min_kw, rise_kw))
        + at_once,
        "gs_ramp_down": -rise <= _times(m.on, fall_kw) + _times(stop, sets.p_max_kw) + at_once,
    }


def fuel(m: GensetsModel) -> Named:
    """Fuel from step to step; what does not fit into the tank is not delivered."""
    filled = m.fuel + m.litres
    before = np.eye(m.fuel.shape[0], k=-1) @ m.fuel
    tank = np.broadcast_to(m.site.gensets.tank_litres, m.fuel.shape)
    return {"gs_fuel_level": filled <= before + m.added, "gs_tank": filled <= tank}


def forming(m: GensetsModel) -> Named:
    """Headroom, and fuel for a step of it, where a set forms the grid."""
    if m.reactive is None:
        return {}
    assert m.headroom is not None
    sets = m.site.gensets
    kept = _times(m.headroom, m.site.dt_h * sets.litres_per_kwh)
    of_running: Named = {}
    if m.holding:
        of_running = {
            "gs_reactive_most": m.reactive <= m.on,
            "gs_reactive_least": -m.reactive <= m.on,
        }
    return of_running | {
        "gs_room_above": m.power + m.headroom <= _times(m.on, sets.p_max_kw),
        "gs_room_below": m.power - m.headroom >= _times(m.on, sets.p_min_kw),
        "gs_fuel_kept": m.fuel >= kept,
    }


def _before(x: cp.Variable, first: cp.Parameter) -> cp.Expression:
    """Values of the step before, (W, G)."""
    return np.eye(x.shape[0], k=-1) @ x + first


def _recent_starts(m: GensetsModel, hours: Floats) -> cp.Expression:
    """Starts in a step and the steps before it, as many as a least time has, (W, G)."""
    W = m.start.shape[0]
    columns = [
        (np.tri(W) - np.tri(W, k=-int(n))) @ m.start[:, g] for g, n in enumerate(_steps(m, hours))
    ]
    return cp.vstack(columns).T


def _on_then(m: GensetsModel) -> cp.Expression:
    """Whether sets were on before the steps in which a start is too early, (W, G)."""
    W = m.on.shape[0]
    columns = []
    for g, n in enumerate(_steps(m, m.site.gensets.min_off_h)):
        before = (np.arange(W) < n).astype(float) * m.was_on[0, g]
        columns.append(np.eye(W, k=-int(n)) @ m.on[:, g] + before)
    return cp.vstack(columns).T


def _steps(m: GensetsModel, hours: Floats) -> Wholes:
    """Steps of least times, at least one."""
    return np.maximum(steps_of(hours, m.site.dt_h), 1)


def running(site: Site, dispatch: Dispatch) -> tuple[Flags, Floats]:
    """Sets that run, and what each gives in kW, (W, G) each."""
    sets = site.gensets
    return dispatch.running_of(KIND, sets), -dispatch.taken_by(KIND, sets)


def _times(x: cp.Expression, factors: Floats) -> cp.Expression:
    """The columns of x, (W, G), times their factors, (G,)."""
    return x @ np.diag(factors)


KIND, ROWS = "gensets", GensetsModel

"""Generating sets with a tank of fuel: a frozen table, and the state of each set.

A site without sets has a table of length 0.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from vppres.core.arrays import Flags, Floats, Names, Wholes, given_or, no_items
from vppres.core.text import counted
from vppres.kinds.kind import Kind, KindTable
from vppres.scenario.assets import Customers
from vppres.scenario.timegrid import TimeGrid

RATED_POWER_FACTOR = 0.8
"""Rated power factor of the sets that are sold."""

ROUNDING_H = 1e-9
"""By how much a time on or off may miss a least time."""


@dataclass(frozen=True, eq=False)
class Gensets(KindTable):
    """Generating sets, shape (G,) each.

    A running set burns ``litres_per_h_idle``, and ``litres_per_kwh`` for what it gives. Ramps are
    infinite where there is none. ``on_before_h`` says how long a set has been on at the first step,
    or, negative, off. Sets have a power factor of 1, but one that forms the grid of an island gives
    reactive power too, as its rated ``power_factor`` allows.
    """

    key = "gensets"
    model = "GensetRow"
    about = "A generating set with a tank of fuel."
    limits = (("p_min_kw", "p_max_kw", ""), ("fuel_level_litres", "tank_litres", ""))
    may_be_infinite = ("ramp_up_kw_per_h", "ramp_down_kw_per_h")

    id: Names = field(default_factory=no_items)
    bus: Names = field(default_factory=no_items)
    p_max_kw: Floats = field(default_factory=no_items)
    p_min_kw: Floats = field(default_factory=no_items)
    ramp_up_kw_per_h: Floats = field(default_factory=no_items)
    ramp_down_kw_per_h: Floats = field(default_factory=no_items)
    min_on_h: Floats = field(default_factory=no_items)
    min_off_h: Floats = field(default_factory=no_items)
    on_before_h: Floats = field(default_factory=no_items)
    start_cost_gbp: Floats = field(default_factory=no_items)
    fuel_price_gbp_per_litre: Floats = field(default_factory=no_items)
    litres_per_kwh: Floats = field(default_factory=no_items)
    litres_per_h_idle: Floats = field(default_factory=no_items)
    tank_litres: Floats = field(default_factory=no_items)
    fuel_level_litres: Floats = field(default_factory=no_items)
    only_in_outage: Flags = field(default_factory=no_items)
    grid_forming: Flags = field(default_factory=no_items)
    power_factor: Floats = field(default_factory=no_items)

    @classmethod
    def of_columns(cls, columns: dict[str, Any], tiers: Mapping[str, float]) -> Gensets:
        """Generating sets: a full tank, no ramps, and off for long, where nothing is said."""
        unsaid = {
            "ramp_up_kw_per_h": np.inf,
            "ramp_down_kw_per_h": np.inf,
            "fuel_level_litres": columns["tank_litres"],
            "on_before_h": [-hours for hours in columns["min_off_h"]],
        }
        return cls(**columns | {name: given_or(columns[name], v) for name, v in unsaid.items()})

    @property
    def unsaid(self) -> tuple[str, ...]:
        """Columns of sets that form the grid, which a file leaves out where none does."""
        return () if self.grid_forming.any() else ("grid_forming", "power_factor")

    def __post_init__(self) -> None:
        unsaid = {"grid_forming": np.zeros(len(self.id), dtype=bool)}
        unsaid["power_factor"] = np.full(len(self.id), RATED_POWER_FACTOR)
        for name, values in unsaid.items():
            if len(getattr(self, name)) == 0:
                object.__setattr__(self, name, values)
        super().__post_init__()

    def most_taken_kw(self, scenario: Any) -> Floats:
        """None, (T, G): sets give."""
        return np.zeros((scenario.grid.n_steps, len(self)))

    def fuelled(self, scenario: Any) -> Flags:
        """Sets that have fuel for a step, or get it, (G,)."""
        litres = self.fuel_level_litres + scenario.refuelled_litres.sum(axis=0)
        return np.asarray(litres >= self.least_litres(scenario.grid.dt_h))

    def owner(self, customers: Customers) -> Wholes:
        """No owner: sets stand alone, (G,)."""
        return np.zeros(len(self), dtype=int)

    def buses(self, customers: Customers) -> Names:
        """Bus of each set, (G,): sets stand alone."""
        return self.bus

    @property
    def largest_kw(self) -> Floats:
        """Largest power of each set."""
        return self.p_max_kw

    def connected(self, customers: Customers, served: Flags) -> Flags:
        """All of them, of customers that are served or not, (..., G) for (..., C)."""
        return np.ones((*served.shape[:-1], len(self)), dtype=bool)

    @property
    def s_max_kva(self) -> Floats:
        """Apparent power of each generator, (G,): all of its power at its power factor."""
        return np.asarray(np.hypot(self.p_max_kw, self.q_max_kvar))

    @property
    def q_max_kvar(self) -> Floats:
        """Reactive power that each can give or take at any power while it forms the grid, (G,)."""
        return np.asarray(self.p_max_kw * np.tan(np.arccos(self.power_factor)))

    def litres(self, on: Flags, power_kw: Floats, dt_h: float) -> Floats:
        """Fuel burnt in a step, (..., G).

        >>> one = Gensets(litres_per_kwh=[0.246], litres_per_h_idle=[8.415])
        >>> one.litres(np.array([True]), np.array([100.0]), dt_h=1.0)
        array([33.015])
        """
        return dt_h * (self.litres_per_kwh * power_kw + self.litres_per_h_idle * on)

    @property
    def kwh_per_litre(self) -> Floats:
        """Most energy that a litre gives, (G,): that of a set at its largest power.

        >>> Gensets(p_max_kw=[100.0], litres_per_kwh=[0.25], litres_per_h_idle=[0.0]).kwh_per_litre
        array([4.])
        """
        return self.p_max_kw / (self.litres_per_kwh * self.p_max_kw + self.litres_per_h_idle)

    def least_litres(self, dt_h: float) -> Floats:
        """Fuel that each set burns in a step at its least power, (G,)."""
        return self.litres(np.ones(len(self), dtype=bool), self.p_min_kw, dt_h)


@dataclass(frozen=True, eq=False)
class Refuels(KindTable):
    """Deliveries of fuel that are known ahead, shape (D,) each; times are timestamps."""

    key = "refuel"
    model = "RefuelRow"
    about = "A delivery of fuel that is known ahead."
    references = (("genset", "gensets", "set"),)
    names = ""

    genset: Names = field(default_factory=no_items)
    time: Names = field(default_factory=no_items)
    litres: Floats = field(default_factory=no_items)

    def to_come(self, now: Any) -> Refuels:
        """Deliveries that are not in the tanks yet at a time."""
        return self.rows(np.array([time > now for time in self.time], dtype=bool))

    def by_step(self, sets: Gensets, grid: TimeGrid) -> Floats:
        """Fuel that is delivered at the beginning of each step, (T, G).

        A delivery within a step counts from the next one on.
        """
        found = np.zeros((grid.n_steps, len(sets)))
        column = {name: g for g, name in enumerate(sets.id)}
        for name, time, litres in zip(self.genset, self.time, self.litres, strict=True):
            step = int(steps_of(np.array((time - grid.start).total_seconds() / 3600.0), grid.dt_h))
            if time >= grid.start and step < grid.n_steps:
                found[step, column[name]] += litres
        return found


@dataclass(frozen=True, eq=False)
class GensetState:
    """Sets at the beginning of a step, (G,) each.

    ``hours`` says how long each has been on, or off; a set that is off gives 0 kW.
    """

    on: Flags
    hours: Floats
    power_kw: Floats
    fuel_litres: Floats

    @classmethod
    def at_first(cls, sets: Gensets) -> GensetState:
        """Before the first step: sets that are on give their least power."""
        on = sets.on_before_h > 0.0
        least_kw = np.where(on, sets.p_min_kw, 0.0)
        return cls(on, np.abs(sets.on_before_h), least_kw, sets.fuel_level_litres)


def steps_of(hours: Floats, dt_h: float) -> Wholes:
    """Steps that a time takes up, rounded up."""
    return np.ceil(np.maximum(hours - ROUNDING_H, 0.0) / dt_h).astype(int)


KIND = Kind(
    {"gensets": Gensets, "refuels": Refuels},
    what="generating sets",
    table="gensets",
    item="genset",
    subject="genset",
    sign="generating set",
    element=("sgen", "set"),
    gives=True,
    forms=True,
    store=(("fuel_end_litres", "tank_litres"),),
)


def contents(content: Mapping[str, Any]) -> str:
    """Generating sets in words, from the numbers of what a scenario holds."""
    return counted(content["gensets"], "generating set")

"""Customers, PV systems and batteries: frozen tables, one array per attribute.

Absent assets are tables of length 0. The attributes' units, bounds and defaults are those of
:mod:`vppres.io.schema`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from vppres.core.arrays import Flags, Floats, Items, Names, Wholes, freeze, no_items
from vppres.core.errors import InputError, Problem
from vppres.kinds.customer.data import MOST_SHARE, steps_within

# Telemetry in single precision or with six digits: further outside, a limit or a reading is wrong.
SOC_ROUNDING = 1e-6

NO_POWER_KW = 1e-3
"""A battery of no more power than this, the smallest that files may give, is no battery."""


TIER_WEIGHTS = {"critical": 1.0, "high": 0.1, "low": 0.02}
"""The paper's tiers and their weights (Parameter Selection)."""

OF_TIME_OFF = ("max_off_h", "own_backup_h")
"""Columns of customers that say how long they may be off."""

OF_HOURS = (*OF_TIME_OFF, "recover_h")
"""Columns of customers that are NaN if not given, and empty if no customer has one."""

OPTIONAL = ("share_min", *OF_HOURS)
"""Columns of customers that are empty if no customer has one."""


@dataclass(frozen=True, eq=False)
class Customers(Items):
    """Customers, shape (C,) each.

    ``weight`` is the priority weight w_c of the objective's f1; ``power_factor`` is negative where
    the load feeds reactive power (leading); ``shed_steps`` are the equal parts that may be switched
    apart, 1 (all or nothing) if not given. ``homes`` are the customers that a connection stands for
    in interruptions and minutes lost, 1 if not given. ``max_off_h`` is how long a customer may be
    off at a time, ``own_backup_h`` how long its own backup supplies it, in h; NaN if not given, and
    empty if no customer has one. ``share_min`` is the least share of its demand with which a
    customer may be supplied, 1 if it may not be dimmed, and empty if none may; ``recover_h`` the
    hours in which it catches up what it was not given, NaN if it does not, and empty if none does.

    Raises
    ------
    InputError
        If a customer with a longest time off may be dimmed to nothing, which would count as on, or
        one that is not dimmed is to catch up.
    """

    id: Names
    bus: Names
    tier: Names
    weight: Floats
    power_factor: Floats
    shed_steps: Wholes = field(default_factory=no_items)
    homes: Wholes = field(default_factory=no_items)
    max_off_h: Floats = field(default_factory=no_items)
    own_backup_h: Floats = field(default_factory=no_items)
    share_min: Floats = field(default_factory=no_items)
    recover_h: Floats = field(default_factory=no_items)

    def __post_init__(self) -> None:
        for name in ("shed_steps", "homes"):
            if len(getattr(self, name)) == 0:
                object.__setattr__(self, name, np.ones(len(self.id), dtype=int))
        for name in OF_HOURS:
            if np.isnan(np.asarray(getattr(self, name), dtype=float)).all():
                object.__setattr__(self, name, np.empty(0))
        if (np.asarray(self.share_min, dtype=float) == 1.0).all():
            object.__setattr__(self, "share_min", np.empty(0))
        super().__post_init__()
        problems = [
            Problem(
                f"customer {self.id[i]}",
                "must be above 0 for a customer with a longest time off",
                "Give the least share with which it counts as on, or leave its longest time out.",
                field="share_min",
                value=0.0,
            )
            for i in np.flatnonzero((self.least_share == 0.0) & np.isfinite(self.longest_off_h))
        ]
        problems += [
            Problem(
                f"customer {self.id[i]}",
                "has no meaning for a customer that is not dimmed",
                "Give a share_min below 1, or leave recover_h out.",
                field="recover_h",
                value=float(self.recovery_h[i]),
            )
            for i in np.flatnonzero((self.recovery_h > 0.0) & ~self.dimmable)
        ]
        if problems:
            raise InputError(problems)

    @property
    def by_bus(self) -> dict[Any, list[str]]:
        """Names of the customers of each bus that has some."""
        found: dict[Any, list[str]] = {}
        for bus, name in zip(self.bus, self.id, strict=True):
            found.setdefault(bus, []).append(str(name))
        return found

    @property
    def q_per_p(self) -> Floats:
        """Reactive load in kvar per kW of active load: ``tan(arccos(pf))``, negative if leading."""
        return np.tan(np.arccos(self.power_factor))

    @property
    def least_share(self) -> Floats:
        """Least share of its demand with which each may be supplied, (C,)."""
        return self.share_min if len(self.share_min) else np.ones(len(self))

    def least_share_but(self, whole: Flags | None) -> Floats:
        """The least shares where some customers cannot be dimmed now, (C,); none if not given."""
        return self.least_share if whole is None else np.where(whole, 1.0, self.least_share)

    @property
    def dimmable(self) -> Flags:
        """Customers that may be supplied with a part of their demand, (C,)."""
        return np.asarray(self.least_share < 1.0)

    @property
    def recovery_h(self) -> Floats:
        """Hours in which each catches up what it was not given, 0 if it does not, (C,)."""
        return np.nan_to_num(self.recover_h) if len(self.recover_h) else np.zeros(len(self))

    def recovery_steps(self, dt_h: float) -> Wholes:
        """Whole steps in which each catches up, 0 if it does not, (C,)."""
        return steps_within(self.recovery_h, dt_h)

    @property
    def most_share(self) -> Floats:
        """Largest share of its demand that each can take, (C,)."""
        return np.where(self.recovery_h > 0.0, MOST_SHARE, 1.0)

    @property
    def longest_off_h(self) -> Floats:
        """How long each may be off at a time in h, (C,): own backup and what it bears beyond it.

        Infinite for a customer that says neither.

        >>> c = Customers(["a", "b"], [1, 1], ["x", "x"], [1, 1], [1, 1], own_backup_h=[4, np.nan])
        >>> c.longest_off_h
        array([ 4., inf])
        """
        given = [getattr(self, name) for name in OF_TIME_OFF if len(getattr(self, name))]
        if not given:
            return np.full(len(self), np.inf)
        said = np.stack(given)
        return np.where(np.isnan(said).all(axis=0), np.inf, np.nansum(said, axis=0))

    @property
    def hour_beyond(self) -> Floats:
        """Price of an hour beyond the longest time off in weighted customer hours, (C,).

        It counts as an hour off of all customers in its tier, each with its weight: nothing
        that others of the tier gain in that hour is worth it.
        """
        _, tier, count = np.unique(self.tier.astype(str), return_inverse=True, return_counts=True)
        return self.weight * count[tier]

    def tier_weight(self, tier: str) -> float:
        """The weight that most customers of a tier have; the paper's, or 1, without customers."""
        found, count = np.unique(self.weight[self.tier == tier], return_counts=True)
        return float(found[np.argmax(count)]) if len(found) else TIER_WEIGHTS.get(tier, 1.0)


class Owned(Items):
    """Assets behind the switch of a ``customer``, or without one (empty text) at their ``bus``."""

    customer: Names
    bus: Any = None

    @property
    def alone(self) -> Flags:
        """Assets without a customer, (n,)."""
        return np.array([owner == "" for owner in self.customer], dtype=bool)

    def owner(self, customers: Customers) -> Wholes:
        """Position of each asset's customer, (n,); 0 for one that stands alone (:attr:`alone`)."""
        position = {"": 0, **{c: i for i, c in enumerate(customers.id)}}
        return np.array([position[owner] for owner in self.customer], dtype=int)

    def buses(self, customers: Customers) -> Names:
        """Bus of each, (n,): its own or its customer's."""
        owners = customers.bus[self.owner(customers)]
        return np.where(self.alone, self.bus, owners).astype(object)

    def connected(self, customers: Customers, served: Flags) -> Flags:
        """Assets that stand alone or whose customer is served, (..., n) for (..., C)."""
        return self.alone | served[..., self.owner(customers)]


PV = "pv"
"""Kind of a photovoltaic system."""


def kind_label(kind: str) -> str:
    """A kind of generator in a sentence.

    >>> kind_label("pv"), kind_label("wind")
    ('PV', 'wind')
    """
    return "PV" if kind == PV else kind


@dataclass(frozen=True, eq=False)
class PVSystems(Owned):
    """PV systems and other generators with a series of available power, shape (P,) each.

    ``customer`` is the owner's identifier. A system that stands alone has none (empty text) and
    names its ``bus``; owned systems have None there and are at their owner's bus. ``kind`` is
    ``pv``, ``wind`` or another word; ``pv`` if not given.
    """

    id: Names
    customer: Names
    p_max_kw: Floats
    s_max_kva: Floats
    kind: Names = field(default_factory=no_items)
    bus: Names = field(default_factory=no_items)

    def __post_init__(self) -> None:
        for name, value in (("kind", PV), ("bus", None)):
            if len(getattr(self, name)) == 0:
                object.__setattr__(self, name, np.full(len(self.id), value, dtype=object))
        super().__post_init__()

    @property
    def word(self) -> str:
        """Word for the power in a sentence: PV where all systems are PV, else generation."""
        return kind_label(PV) if (self.kind == PV).all() else "generation"

    def counted(self) -> str:
        """Number of systems of each kind.

        >>> kinds = ["pv", "wind"]
        >>> PVSystems(["a", "b"], ["", ""], [1.0, 1.0], [1.0, 1.0], kinds, [1, 2]).counted()
        '1 PV system, 1 wind system'
        """
        kinds = dict.fromkeys(self.kind) or {PV: None}
        count = {kind: int((self.kind == kind).sum()) for kind in kinds}
        return ", ".join(
            f"{n} {kind_label(kind)} system{'' if n == 1 else 's'}" for kind, n in count.items()
        )


@dataclass(frozen=True, eq=False)
class Batteries(Items):
    """Batteries, shape (B,) each: ratings, limits, nominal efficiencies and thermal constants.

    The thermal constants are those of the paper's Table "Battery electro-thermal efficiency
    parameters"; ``t_initial_c`` may be NaN, which means the ambient temperature of the first step.
    ``grid_forming`` marks the batteries that are named to hold an island; see :attr:`formers`.
    A state of charge at the start that is outside its limits by at most 1e-6 is taken to the limit,
    and :attr:`notes` says so.

    Raises
    ------
    InputError
        If a state of charge at the start is farther outside its limits.
    """

    id: Names
    bus: Names
    energy_kwh: Floats
    p_max_kw: Floats
    s_max_kva: Floats
    soc_min: Floats
    soc_max: Floats
    soc_initial: Floats
    eta_charge: Floats
    eta_discharge: Floats
    r_theta_c_per_kw: Floats
    c_theta_kwh_per_c: Floats
    alpha_charge_per_c2: Floats
    alpha_discharge_per_c2: Floats
    r_int_ohm: Floats
    beta_per_c: Floats
    u_batt_v: Floats
    t_ref_c: Floats
    t_initial_c: Floats
    grid_forming: Flags = field(default_factory=no_items)

    def __post_init__(self) -> None:
        if len(self.grid_forming) == 0:
            object.__setattr__(self, "grid_forming", np.zeros(len(self.id), dtype=bool))
        super().__post_init__()
        object.__setattr__(self, "_notes", self._take_soc_into_limits())

    def _take_soc_into_limits(self) -> tuple[str, ...]:
        """Clip rounding errors of the state of charge at the start, and say so."""
        low = self.soc_min
        high = self.soc_max
        given = self.soc_initial
        sound = (low >= 0.0) & (low < high) & (high <= 1.0)  # other limits have their own check
        outside = np.where(sound, np.maximum(low - given, given - high), 0.0)
        problems = [
            Problem(
                f"battery {self.id[i]}",
                f"must lie between soc_min ({low[i]:g}) and soc_max ({high[i]:g})",
                "Correct the state of charge at the start or the limits.",
                field="soc_initial",
                value=float(given[i]),
            )
            for i in np.flatnonzero(~(outside <= SOC_ROUNDING))
        ]
        if problems:
            raise InputError(problems)
        clipped = np.where(sound, np.clip(given, low, high), given)
        object.__setattr__(self, "soc_initial", freeze(clipped))
        return tuple(
            f"The state of charge of battery {self.id[i]} at the start, {given[i]:.9g}, is a "
            f"rounding error outside its limits: {clipped[i]:g} is used."
            for i in np.flatnonzero(clipped != given)
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """Corrections that were made when the table was built, in sentences."""
        notes: tuple[str, ...] = self.__dict__["_notes"]
        return notes

    @property
    def active_max_kw(self) -> Floats:
        """Largest active power, by rating and by inverter, (B,); none if that is 1 W or less."""
        active_kw = np.minimum(self.p_max_kw, self.s_max_kva)
        return np.where(active_kw > NO_POWER_KW, active_kw, 0.0)

    @property
    def idle(self) -> bool:
        """Whether none has any power, or there is none."""
        return not self.active_max_kw.any()

    def holds_energy(self, soc: Floats) -> Flags:
        """Batteries that hold more than rounding above their lowest state of charge, (B,).

        What a plan is forgiven (:data:`SOC_ROUNDING`) forms no grid.
        """
        return np.asarray(soc - self.soc_min > 1.5 * SOC_ROUNDING)

    @property
    def formers(self) -> Flags:
        """Batteries that form an island's grid, (B,): those named so, else the largest inverter.

        None does whose power is no more than the 1 W below which equipment is not there.
        """
        able = self.active_max_kw > 0.0
        if self.grid_forming.any() or not able.any():
            return self.grid_forming & able
        largest = np.zeros(len(self), dtype=bool)
        largest[np.argmax(np.where(able, self.s_max_kva, 0.0))] = True
        return largest

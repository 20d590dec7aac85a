"""Interface of a kind of flexible power: names, windows, units of the plant.

Power is what the n units of a kind take, negative where they give.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar, Literal, Protocol, Self

import numpy as np

from vppres.core.arrays import ByStep, Flags, Floats, Items, Names, Wholes
from vppres.core.errors import InputError, Problem

ROUNDING_H = 1e-9
"""By how much times that are added up may be off."""

EARLY_SHARE = 0.1
"""Share of a step by which clocks may be off: those of readings, and our own that is set back."""


class KindTable(Items):
    """A file of a kind in a scenario's folder: arrays by column.

    ``attributes.csv`` in the kind's folder has a line for each column.
    """

    key: ClassVar[str]  #: name of the file without its ending, which is its key under ``[files]``
    #: Name of the model of a row, and what a row is, for the documentation.
    model: ClassVar[str]
    about: ClassVar[str]
    #: Columns with identifiers of another table: the column, the key of that table, what it holds.
    references: ClassVar[tuple[tuple[str, str, str], ...]] = ()
    #: Columns that must not exceed another one of their row, with the cure where it is special.
    limits: ClassVar[tuple[tuple[str, str, str], ...]] = ()
    names: ClassVar[str] = "id"  #: column of names that are shown; empty if there is none
    #: Columns that may have no value, and those that may have no limit.
    may_be_nan: ClassVar[tuple[str, ...]] = ()
    may_be_infinite: ClassVar[tuple[str, ...]] = ()
    #: Series of its rows, and what each is, for the documentation. Each is a file with a column for
    #: each row, by its identifier, and an array of the scenario by step, (T, n): the name is the
    #: file's, the array's, and that of the number in ``attributes.csv``.
    series: ClassVar[Mapping[str, str]] = {}

    @classmethod
    def of_columns(cls, columns: dict[str, Any], tiers: Mapping[str, float]) -> Self:
        """The table of what a file says; numbers that it does not say are NaN."""
        return cls(**columns)

    @classmethod
    def problems(cls, table: Any, rows: Mapping[int, Any]) -> list[Problem]:
        """Problems of rows of the file beside one another."""
        return []

    def to_come(self, now: Any) -> Self:
        """The table as a window that begins at a time is to know it."""
        return self

    def remark(self, scenario: Any) -> str:
        """Doubts about the rows, in a sentence; empty if there are none."""
        return ""

    @property
    def unsaid(self) -> tuple[str, ...]:
        """Columns that need not be written."""
        return ()


@dataclass(frozen=True)
class Kind:
    """Names of a kind."""

    #: Its files by field of the scenario, that of its units first.
    tables: Mapping[str, type[KindTable]]
    what: str  #: what a controller plans, in words
    #: Table of a run, and its column of units.
    table: str
    item: str
    subject: str  #: item of the explanations that reasons are about
    sign: str  #: what a sign in the feeder's diagram stands for
    #: Table of a pandapower net in which units stand, and the word before their identifiers there.
    element: tuple[Literal["load", "sgen", "storage"], str]
    #: Whether units only give power: the column ``p_kw`` of that table is what they give, and
    #: batteries may charge from it.
    gives: bool = False
    #: Whether units can form the grid of an island; they have ``grid_forming`` and ``q_max_kvar``.
    forms: bool = False
    #: Whether units take less where an island lacks power, before a battery gives more or a
    #: customer is shed; those of later kinds first.
    takes_less: bool = False
    #: State by which customers' units draw more after an outage, in words; empty if there is none.
    recovers_by: str = ""
    #: Column of a run with what units hold at a step's end, and that of their table with the most,
    #: of a kind whose store is worth energy later; empty otherwise.
    store: tuple[tuple[str, str], ...] = ()

    @property
    def file(self) -> str:
        """File of its units in a scenario's folder."""
        return f"{next(iter(self.tables.values())).key}.csv"

    @property
    def word(self) -> str:
        """A unit in a sentence."""
        return self.item.replace("_", " ")


class Units(Protocol):
    """The units of a kind in a scenario, a table of n rows."""

    @property
    def id(self) -> Names:
        """Names, (n,)."""

    @property
    def largest_kw(self) -> Floats:
        """Largest power of each, (n,)."""

    def __len__(self) -> int: ...

    def most_taken_kw(self, scenario: Any) -> Floats:
        """Most that each takes in each step, (T, n)."""

    def owner(self, customers: Any) -> Wholes:
        """Position of each unit's customer, (n,); 0 for one that stands alone."""

    def buses(self, customers: Any) -> Names:
        """Bus of each, (n,)."""

    def connected(self, customers: Any, served: Flags) -> Flags:
        """Units that have voltage if these customers are served, (..., n) for (..., C)."""


@dataclass(frozen=True, eq=False)
class EnergyHeld:
    """Energy in a battery that stands for what the units of a kind hold."""

    #: What a unit of the store stands for, a litre of fuel for example, (n,); 0 where it is no use.
    kwh_each: Floats
    #: Largest power of all, and their energy now.
    power_kw: float
    held_kwh: float
    #: What comes at the beginning of each step, that of the present one left out, (T,).
    delivered_kwh: Floats


@dataclass(frozen=True, eq=False)
class UnitPlan:
    """Plan for the units of a kind over W steps, (W, n) each."""

    taken_kw: Floats
    running: Flags  #: units that are on, of a kind that is started and stopped
    connected: Flags  #: units whose customers are served, or that stand alone


@dataclass(frozen=True, eq=False)
class UnitsAhead(ByStep):
    """Window data of the units of a kind, (W, n) each; ``WINDOW`` of its physics.

    A kind that is started and stopped is ``switched``.
    """

    switched: ClassVar[bool] = False

    units: Any  #: their table in the scenario
    dt_h: float  #: length of a step in h

    def part(self, steps: slice) -> Self:
        """The first steps of the window, by a slice."""
        known = self.units, self.dt_h
        return type(self)(*known, *(getattr(self, name)[steps] for name in self._by_step))

    @property
    def _by_step(self) -> list[str]:
        return [field.name for field in fields(self)[2:]]

    @property
    def shape(self) -> tuple[int, int]:
        """Number of steps and of units."""
        n_steps, n_units = getattr(self, self._by_step[0]).shape
        return n_steps, n_units

    @classmethod
    def past_days(cls, scenario: Any, seed: int) -> Any:
        """Days before a run that a window is expected to be like; None where nothing is learned."""
        return None

    def in_the_dark(self, lit: Flags) -> Any:
        """Window without power except in the lit steps, (W, 1)."""
        raise NotImplementedError

    def without_duties(self) -> Any:
        """Window without units that have to stay on."""
        return self

    def holding(self, part: Wholes) -> Any:
        """Window with the units that hold parts by number, (W, n), -1 where units form none."""
        return self

    def forming_steps(self) -> Flags:
        """Steps in which each forms the grid of an island, (W, n)."""
        return np.zeros(self.shape, dtype=bool)

    def holding_steps(self) -> Flags:
        """Steps in which each holds a part of the feeder if it runs, (W, n)."""
        return np.zeros(self.shape, dtype=bool)

    def formed(self, dark: Flags, headroom: float) -> tuple[Any, Flags]:
        """Window with what forms dark steps, (W,), as far as it can, and the steps that it forms.

        ``headroom`` is the share of a rating that is left free above and below the plan.
        """
        return self, np.zeros_like(dark)

    def kept_kw(self) -> Floats:
        """Power that each leaves free above and below its plan where it forms the grid, (W, n)."""
        return np.zeros(self.shape)

    def able_to_form(self) -> Flags:
        """Units that form an island if nothing else does and they run, (n,)."""
        return np.asarray(self.forming_steps()[0])

    def by_rule(self, lacking_kw: float, island: bool) -> Sequence[tuple[Floats, Flags]]:
        """Powers of the first step without a plan, and which units run, the best first.

        Each gives way to the next; ``lacking_kw`` is the demand that PV leaves. At last all rest.
        """
        none = np.zeros(self.shape[1])
        return [(none, none > 0.0)]

    def beside(self, wanted_kw: Floats, island: bool) -> tuple[Floats, Flags]:
        """Power of the first step of units that form the grid or run, near what they are to give.

        With it goes which of them run.
        """
        raise NotImplementedError

    def here_kw(self, taken_kw: Floats) -> Floats:
        """Planned powers of the first step, (n,), of the units that are there."""
        return taken_kw

    def store(self, scenario: Any, steps: range, eta_discharge: float) -> EnergyHeld:
        """Energy in a battery of what units hold, and of deliveries in the steps."""
        return EnergyHeld(np.zeros(self.shape[1]), 0.0, 0.0, np.zeros(len(steps)))

    def left_kwh(self, plan: UnitPlan, kwh_each: Floats) -> float:
        """Energy in a battery that stands for what units hold at the end of a plan.

        ``kwh_each`` says what a unit of their store stands for, (n,).
        """
        return 0.0

    def most_left_kwh(self, kwh_each: Floats) -> float:
        """Most energy that what units hold at the end can stand for."""
        return 0.0

    def wrongly_switched(self, running: Flags, outage: Flags) -> Flags:
        """Steps in which a unit is on or off against a rule, (W, n).

        ``outage`` says in which steps the grid does not reach its bus, (W, n).
        """
        return np.zeros_like(running)

    def switched_early(self, running: Flags, outage: Flags) -> Flags:
        """Steps in which a unit starts before it may, or runs where it must not, (W, n).

        ``outage`` is as for :meth:`wrongly_switched`.
        """
        return np.zeros_like(running)

    def q_most_kvar(self) -> Floats:
        """Largest reactive power of each, (W, n)."""
        return np.zeros(self.shape)

    def most_taken_kw(self) -> Floats:
        """Most that all take together, (W,)."""
        return np.zeros(self.shape[0])

    def most_given_kw(self) -> Floats:
        """Most that all give together, (W,)."""
        return np.zeros(self.shape[0])

    def power_beyond_kw(self, plan: UnitPlan) -> Floats:
        """Excess of powers beyond what units can do, (W, n)."""
        raise NotImplementedError

    def stored_beyond_kw(self, plan: UnitPlan) -> Floats:
        """Excess of stored energy beyond its limits, as a power over the step, (W, n)."""
        return np.zeros_like(plan.taken_kw)


class Followers:
    """The units of a kind in the plant, what they do of what is asked; ``PLANT`` of its physics.

    ``state`` is what a step leaves to the next.
    """

    def __init__(self, scenario: Any, units: Any, state: Any) -> None:
        self.scenario, self.units, self.state = scenario, units, state
        self.dt_h: float = scenario.grid.dt_h
        nobody = np.zeros(len(scenario.customers), dtype=bool)
        self._owner: Wholes = units.owner(scenario.customers)
        self._alone: Flags = units.connected(scenario.customers, nobody)

    def at(self, t: int) -> Any:
        """State at the beginning of a step."""
        return self.state

    def on(self, served: Flags) -> Flags:
        """Units that are connected, if these customers are served, (n,)."""
        return self._alone | served[self._owner]

    def possible_kw(self, t: int, wanted_kw: Floats, served: Flags) -> Floats:
        """Power nearest to what is wanted, of units that are not started, (n,)."""
        raise NotImplementedError

    def follow(
        self, t: int, wanted_kw: Floats, running: Flags, served: Flags
    ) -> tuple[Floats, Flags]:
        """Power nearest to what is wanted, and which units run, of a kind that is started."""
        return self.possible_kw(t, wanted_kw, served), running

    def spare_kw(self, taken_kw: Floats, running: Flags) -> Floats:
        """Power that each can give less without stopping, (n,)."""
        return np.maximum(-taken_kw, 0.0)

    def after(self, t: int, taken_kw: Floats, running: Flags) -> Any:
        """State at the end of a step with these powers."""
        raise NotImplementedError

    def advance(self, t: int, taken_kw: Floats, running: Flags) -> None:
        """Go on to the end of a step."""
        self.state = self.after(t, taken_kw, running)


@dataclass(frozen=True, eq=False)
class Moment:
    """A step that a live controller decides now."""

    known: Any  #: what was known, the steps since the last decision included
    row: int  #: the step's row in it
    served: Flags  #: customers that were supplied since the last decision, (C,)
    at_h: float  #: the moment, in h since the controller's first step
    window: Any  #: the step and those ahead, as they are measured and expected

    def begun_since(self, since_h: float) -> range:
        """Rows of the steps that have begun since a time."""
        dt_h = self.window.grid.dt_h
        steps = int(self.at_h / dt_h + ROUNDING_H) - int(since_h / dt_h + ROUNDING_H)
        return range(max(self.row - steps, -1) + 1, self.row + 1)

    def held_h(self, since_h: float, ago_h: Floats | float = 0.0) -> Floats:
        """How long set-points from a time on have held, up to some time ago, in h.

        They hold up to the end of their step.
        """
        dt_h = self.window.grid.dt_h
        end_h = (np.floor(since_h / dt_h + ROUNDING_H) + 1.0) * dt_h
        return np.asarray(np.maximum(np.minimum(self.at_h - ago_h, end_h) - since_h, 0.0))


@dataclass(frozen=True, eq=False)
class UnitsNow:
    """The units of a kind in the step that is decided now; what ``now`` of its live part makes."""

    state: Any  #: the estimate of their state, as the plant has it
    #: Power that all took since the last decision, as metered or else as set, and by how much that
    #: may be off.
    taken_kw: float
    taken_off_kw: float
    #: Readings that are missing or frozen, and units that are out, in words.
    estimated: tuple[str, ...]

    def able(self, ahead: UnitsAhead) -> UnitsAhead:
        """A window without units that are out."""
        return ahead

    def believed(self, scenario: Any) -> Any:
        """A scenario in which units that are out form no grid."""
        return scenario

    def columns(self) -> dict[str, Any]:
        """Columns of set-points that only a live step has."""
        return {}

    def after(self, day: Any, state: Any, columns: Mapping[str, Any]) -> Any:
        """State of the units after the first step of a day, by its record."""
        raise NotImplementedError


DEARER = 2.0
"""How much dearer a missed kWh must be than any energy that could be given instead."""


def refuse_dear_energy(scenario: Any, what: str, worth: float) -> None:
    """Refuse prices of energy beside which what units miss would count nothing.

    ``what`` is missed, in words, with so many that share its price; ``worth`` is the least worth of
    a missed kWh in weighted customer hours, infinite if none is missed.

    Raises
    ------
    InputError
        If a missed kWh is not dearer than any energy.
    """
    dearest = float(np.abs(scenario.price_gbp_per_kwh).max())
    if worth < DEARER * scenario.objective.lambda_grid * dearest:
        raise InputError.of(
            "scenario.toml",
            f"makes energy dearer than what {what} may count",
            f"Give at most {worth / DEARER / dearest:.1e}, or fewer of them.",
            field="objective.lambda_grid",
            value=scenario.objective.lambda_grid,
        )


NAMES_SHOWN = 6
"""Units that a sentence names."""

MOVE_KW = 1.0
"""Smallest power of a unit, or of curtailment, that counts as an action."""

Why = tuple[str, str, str]
"""Reason of an action: its driver, what was at its limit (empty if nothing), and a sentence."""


def price_scale(weight: Floats, most: Floats, least_weight: float, dt_h: float) -> float:
    """Price of a unit that is missed at weight 1, in weighted customer hours: kWh, or K h.

    All that can be missed at most counts half a step of the customer of this least weight: no
    service is given up for it.

    >>> price_scale(np.array([1.0, 2.0]), np.array([50.0, 25.0]), least_weight=1.0, dt_h=0.5)
    0.0025
    """
    total = float((weight * most).sum())
    return 0.5 * least_weight * dt_h / total if total else 0.0

"""Imported feeder: a radial network, its loads and generators, and notes on simplifications."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Protocol

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats, Items, Names, freeze_arrays
from vppres.scenario.assets import TIER_WEIGHTS
from vppres.scenario.network import BusId, Network
from vppres.scenario.phases import PhaseConnection, Phases
from vppres.scenario.source import SourceDeviation
from vppres.scenario.switches import Switches


def highest_tier(tiers: Iterable[str]) -> str:
    """The tier of a customer that merges loads: that of the most important one; empty for none.

    What is no tier comes first, so that nothing hides it from the check of the names.

    >>> highest_tier(["low", "", "critical"]), highest_tier([""])
    ('critical', '')
    """
    order = {tier: k for k, tier in enumerate(TIER_WEIGHTS)}
    return min(filter(None, tiers), key=lambda tier: order.get(tier, -1), default="")


@dataclass(frozen=True, eq=False)
class Generators(Items):
    """Generators that the source has, shape (G,) each; injection is positive.

    ``kind`` is the source's word, ``gen`` for a machine that holds its voltage; see
    :func:`vppres.feeders.new.kinds.kind_of`. ``p_kw`` and ``q_kvar`` are the operating point that
    the source gives, ``p_max_kw`` the largest active power and ``p_min_kw`` the least while it runs
    (NaN if it gives none), ``s_kva`` the rating. ``grid_forming`` says whether it can form the grid
    of an island, None where the source does not say.
    """

    id: Names
    bus: Names
    kind: Names
    p_kw: Floats
    q_kvar: Floats
    s_kva: Floats
    p_max_kw: Floats
    p_min_kw: Floats
    grid_forming: Names


@dataclass(frozen=True, eq=False)
class Loads(Items):
    """Single loads of the source, shape (E,) each: as they are given, drawn power is positive.

    ``tier`` is what the source's column names; empty where it names none.
    """

    id: Names
    bus: Names
    p_kw: Floats
    q_kvar: Floats
    tier: Names


@dataclass(frozen=True, eq=False)
class Profile:
    """Series of one element or asset, as it was given."""

    where: str  #: file or source, for messages
    name: str  #: the element or asset, as the source names it
    #: Indexed by times in UTC; by the number of the row where the source has no times.
    values: pd.Series[float]
    #: ``kw``, ``mw``, ``pu`` of the element's power; of energy until the next value ``wh``, ``kwh``
    #: or ``mwh``; empty where nothing says.
    unit: str = ""
    factor: float = 1.0  #: what the values are multiplied by, before the unit
    column: str = ""  #: column of the file; empty where the name stands in rows


@dataclass(frozen=True, eq=False)
class Storages(Items):
    """Batteries that the source has, shape (S,) each.

    ``p_kw`` (charging is positive) and ``q_kvar`` (drawn is positive) are the operating point that
    the source gives; the others are named as in ``batteries.csv``.
    """

    id: Names
    bus: Names
    p_kw: Floats
    q_kvar: Floats
    energy_kwh: Floats
    p_max_kw: Floats
    s_max_kva: Floats
    soc_min: Floats
    soc_max: Floats
    soc_initial: Floats
    eta_charge: Floats
    eta_discharge: Floats


@dataclass(frozen=True)
class Deviation:
    """AC power flow of the feeder against that of the source."""

    #: Largest difference of a bus voltage with the loads and generators of the source.
    v_max_pu: float
    #: Active losses of the source and of the feeder, shunts included.
    losses_source_kw: float
    losses_kw: float
    #: Largest difference of a bus voltage without them; None where it is not known.
    no_load_pu: float | None = None

    def __str__(self) -> str:
        return (
            f"{SourceDeviation(self.no_load_pu, self.v_max_pu)} Losses as given are "
            f"{self.losses_kw:.3f} kW, in the source {self.losses_source_kw:.3f} kW."
        )


class SourceFlow(Protocol):
    """AC power flow of a source, its branches and shunts as they are, for powers at its buses."""

    def v_pu(
        self, buses: Names, p_kw: Floats, q_kvar: Floats, v_slack_pu: float | None = None
    ) -> dict[int, float] | None:
        """Voltage of every bus of the source for net injections at buses of the feeder.

        None where it does not converge.
        """
        ...


@dataclass(frozen=True)
class PhasedLoad:
    """A load or generator of a phased source, at a bus of the feeder, with its connection."""

    kind: str
    bus: BusId
    p_kw: float
    q_kvar: float
    connection: PhaseConnection
    tier: str = ""


@dataclass(frozen=True, eq=False)
class PhasedSource:
    """The three phases of a source, without assets, and what is connected to them.

    ``difference_pu`` is the largest one of the own power flow from that of the source, ``causes``
    what it may come from.
    """

    phases: Phases
    loads: tuple[PhasedLoad, ...]
    v_pu: float
    difference_pu: float | None = None
    notes: tuple[str, ...] = ()
    causes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class ImportedFeeder:
    """A feeder from another tool."""

    name: str  #: name of the source
    network: Network  #: ``N`` buses; all impedances refer to its ``base_kv``
    #: Load of each bus, in the network's bus order, (N,).
    p_load_kw: Floats
    q_load_kvar: Floats
    generators: Generators  #: generators of the source
    #: Bus of the network for every supplied bus of the source; joined buses share one.
    bus_of: Mapping[int, BusId]
    notes: tuple[str, ...]  #: what was simplified, one sentence each; empty if nothing was
    #: Those of the notes that say what has no supply; they hold for phases too.
    left_out: tuple[str, ...] = ()
    #: What the simplifications change; None if its own power flow or the source's has no solution.
    deviation: Deviation | None = None
    source_solves: bool = True  #: whether the source's own power flow has a solution
    storages: Storages = field(default_factory=Storages.none)  #: batteries of the source
    loads: Loads = field(default_factory=Loads.none)  #: loads one by one, as far as they are known
    profiles: tuple[Profile, ...] = ()  #: series that come with the source
    causes: tuple[str, ...] = ()  #: what the voltages may differ by, the largest first
    source_flow: SourceFlow | None = None  #: AC power flow of the source for other powers
    #: What of the source is not balanced and was spread over three phases; empty if nothing.
    unbalanced: str = ""
    #: Closed switches on its lines, and open ones beside them.
    switches: Switches = field(default_factory=Switches.none)
    #: Whether customers are the loads, and they, generators and batteries keep their names.
    named: bool = False
    phased: PhasedSource | None = None  #: the three phases; None for a feeder that is balanced
    title: str = ""  #: the network's own name; empty if it has none
    #: Largest change of a voltage by opening loops; None without loops, or where it is not known.
    opened_pu: float | None = None

    def __post_init__(self) -> None:
        freeze_arrays(self)
        object.__setattr__(self, "bus_of", MappingProxyType(dict(self.bus_of)))

    @property
    def tier(self) -> Names:
        """Highest tier of each bus's loads, (N,); empty where the source names none."""
        tiers: dict[BusId, list[str]] = {}
        for bus, tier in zip(self.loads.bus, self.loads.tier, strict=True):
            tiers.setdefault(bus, []).append(tier)
        buses = self.network.buses
        return np.array([highest_tier(tiers.get(bus, ())) for bus in buses], dtype=object)

    @property
    def injection(self) -> tuple[Floats, Floats]:
        """Net injection of every bus in kW and kvar, shape (N,) each."""
        given = self.network.place(self.generators.bus)
        drawn = self.network.place(self.storages.bus)
        return (
            given @ self.generators.p_kw - drawn @ self.storages.p_kw - self.p_load_kw,
            given @ self.generators.q_kvar - drawn @ self.storages.q_kvar - self.q_load_kvar,
        )

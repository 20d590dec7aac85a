"""Inversions: a customer off supply in an outage that a lower tier's energy would have supplied."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from vppres.core.arrays import Flags, Floats, Wholes
from vppres.core.text import named
from vppres.day.trajectory import LINES_OUT, Trajectory
from vppres.kinds.table import KINDS, units_of
from vppres.scenario.formers import forming_batteries
from vppres.scenario.priority import STRICT
from vppres.scenario.scenario import Scenario

TOLERANCE_KW = 1e-3
NOBODY = -1
NAMES = 3
"""Names that a sentence has of each kind."""


@dataclass(frozen=True, eq=False)
class Inversion:
    """A customer off supply in a step, and who of lower tiers was supplied."""

    #: Step and customer.
    t: int
    customer: int
    kw: float  #: its demand
    lower: Wholes  #: customers of lower tiers that drew power in the step, or later in the outage
    lower_kw: float  #: the most that they drew in a step
    kept: bool  #: whether what was left in the batteries would have sufficed by itself
    #: Whether it would not have sufficed for the headroom of grid-forming batteries besides.
    by_headroom: bool


def inversions(run: Trajectory) -> list[Inversion]:
    """Customers off supply whose demand lower tiers would have left power and energy for.

    It is reckoned for the batteries as one, without the network: had lower tiers been off supply
    from the step on, what they took and what was left in the batteries would have sufficed until
    the end of the outage, in every step, within the power of the batteries. Where a line is out
    until then nothing is said: no energy reaches across it.
    """
    return [one for one in _could_have_been_on(run) if len(one.lower)]


def _could_have_been_on(run: Trajectory) -> list[Inversion]:
    """Inversions, and customers that the energy left would have supplied by itself."""
    found: list[Inversion] = []
    fleet = _Fleet.of(run)
    out = run.steps["outage"].to_numpy(bool)
    cut = run.steps[LINES_OUT].ne("") if LINES_OUT in run.steps else np.zeros(len(out))
    last = len(out)
    for t in range(len(out) - 1, -1, -1):
        if not out[t]:
            last = t
        elif not cut[t:last].any():
            found += _in_step(run, fleet, t, last)
    return found[::-1]


@dataclass(frozen=True, eq=False)
class _Fleet:
    """The record of a run as arrays of steps."""

    rank: Wholes
    served: Flags
    load_kw: Floats
    drawn_kw: Floats
    kept_kwh: Floats
    free_kw: Floats
    dark: Flags
    headroom_kw: float

    @classmethod
    def of(cls, run: Trajectory) -> _Fleet:
        steps = len(run.steps)
        day = run.scenario
        b = day.batteries
        position = {tier: k for k, tier in enumerate(day.tiers)}
        table = run.batteries
        tile = np.tile
        usable = np.maximum(table["soc_end"] - tile(b.soc_min, steps), 0.0)
        kept = usable * tile(b.energy_kwh, steps) * table["eta_discharge"]
        free = tile(b.active_max_kw, steps) + table["charge_kw"] - table["discharge_kw"]
        served, load_kw = (run.by_step("customers", name) for name in ("served", "p_load_kw"))
        dark = run.steps["dark"] > 0 if "dark" in run.steps else np.zeros(steps)
        return cls(
            rank=np.array([position[tier] for tier in day.customers.tier]),
            served=served,
            load_kw=load_kw,
            drawn_kw=load_kw * served + _behind_customers(run),
            kept_kwh=kept.to_numpy(float).reshape(steps, -1).sum(axis=1),
            free_kw=free.to_numpy(float).reshape(steps, -1).sum(axis=1),
            dark=np.asarray(dark, dtype=bool),
            headroom_kw=_headroom_kw(run),
        )


def _behind_customers(run: Trajectory) -> Floats:
    """Power of vehicles, rooms and tanks of each customer, (T, C); negative where they gave."""
    day = run.scenario
    customers = day.customers
    drawn_kw = np.zeros((len(run.steps), len(customers)))
    for kind, units in units_of(day).items():
        alone = units.connected(customers, np.zeros(len(customers), dtype=bool))
        owner = np.where(alone, NOBODY, units.owner(customers))
        p_kw = run.by_step(KINDS[kind].table, "p_kw")
        drawn_kw += p_kw @ (owner[:, None] == np.arange(len(customers)))
    return drawn_kw


def _in_step(run: Trajectory, fleet: _Fleet, t: int, last: int) -> Iterator[Inversion]:
    """Inversions of one step of an outage that ends before step ``last``."""
    dt_h = run.scenario.grid.dt_h
    for customer in np.flatnonzero(~fleet.served[t] & ~fleet.dark[t]):
        drawn_kw = fleet.drawn_kw[t:last]
        # A customer whose vehicle gives more than it draws takes nothing from others.
        lower = (drawn_kw > TOLERANCE_KW) & (fleet.rank > fleet.rank[customer])
        lower_kw = (drawn_kw * lower).sum(axis=1)
        kw = float(fleet.load_kw[t, customer])
        spare_kw = fleet.free_kw[t] + lower_kw[0] - kw
        left_kwh = fleet.kept_kwh[t:last] + dt_h * (lower_kw.cumsum() - kw)
        kept = bool(fleet.free_kw[t] >= kw and fleet.kept_kwh[t:last].min() >= dt_h * kw)
        if spare_kw >= -TOLERANCE_KW and left_kwh.min() >= -dt_h * TOLERANCE_KW:
            now = lower[:1] if lower[0].any() else lower
            who = np.flatnonzero(now.any(axis=0))
            lower_now_kw = float(lower_kw[: len(now)].max())
            kept_kw = np.inf if run.options.get("priority") == STRICT else left_kwh[-1] / dt_h
            denied = min(spare_kw, kept_kw) < fleet.headroom_kw - TOLERANCE_KW
            yield Inversion(t, int(customer), kw, who, lower_now_kw, kept, denied)


def _headroom_kw(run: Trajectory) -> float:
    """Headroom of the grid-forming batteries in an island by the options of the run."""
    if run.options.get("mode") != "physical":
        return 0.0
    b = run.scenario.batteries
    share = float(run.options.get("headroom") or 0.0)
    return float(
        np.minimum(share * b.s_max_kva, b.active_max_kw)[forming_batteries(run.scenario)].sum()
    )


def headroom_words(run: Trajectory) -> list[str]:
    """Customers that headroom of grid-forming batteries cost supply, in a sentence, if any."""
    found = [one for one in _could_have_been_on(run) if one.by_headroom]
    if not found:
        return []
    c = run.scenario.customers
    names = list(dict.fromkeys(f"{c.id[one.customer]} ({c.tier[one.customer]})" for one in found))
    share = float(run.options["headroom"])
    return [
        f"Headroom of {share:.0%} keeps {_headroom_kw(run):,.1f} kW of the grid-forming batteries "
        f"free, and their energy: without it {named(names, NAMES)} would have been on supply."
    ]


def inversion_words(run: Trajectory) -> list[str]:
    """Inversions in sentences, with names and kW; empty if there is none."""
    found = inversions(run)
    needed = [one for one in found if not one.kept]
    kept = [one for one in found if one.kept]
    words = []
    if needed:
        words.append(
            f"Tier order was not kept in {_count_words(run, needed)}: the energy of lower tiers "
            f"would have sufficed. {_worst_words(run, needed)}"
        )
    if kept:
        uncertain = run.options.get("outages", "known") != "known"
        why = ": it was kept in case the outage lasted longer" if uncertain else ""
        words.append(
            f"What batteries had left at the end would have sufficed for {_count_words(run, kept)} "
            f"off supply while lower tiers had some{why}."
        )
    return words


def _count_words(run: Trajectory, found: list[Inversion]) -> str:
    """How many inversions there are, and whose."""
    ids = run.scenario.customers.id
    names = list(dict.fromkeys(str(ids[one.customer]) for one in found))
    count = "1 customer-step" if len(found) == 1 else f"{len(found)} customer-steps"
    return f"{count} ({named(names, NAMES)})"


def _worst_words(run: Trajectory, found: list[Inversion]) -> str:
    """The inversion of the most important and largest customer."""
    c = run.scenario.customers
    position = {tier: k for k, tier in enumerate(run.scenario.tiers)}
    worst = min(found, key=lambda one: (position[c.tier[one.customer]], -one.kw))
    off = f"{c.id[worst.customer]} ({c.tier[worst.customer]}, {worst.kw:,.1f} kW)"
    lower = named([str(c.id[i]) for i in worst.lower], NAMES)
    when = run.scenario.grid.in_words(run.steps["time"].iloc[worst.t])
    return f"At {when} {off} was off supply, while {lower} had up to {worst.lower_kw:,.1f} kW."


def lower_tiers_now(
    scenario: Scenario,
    served: Flags,
    load_kw: Floats,
    charge_kw: float = 0.0,
    later: Flags | None = None,
) -> dict[str, str]:
    """The most important customer off supply while lower tiers are on, in a sentence.

    Of a step it is known who is supplied and what all would take, (C,) each, and what batteries
    take; ``later``, (W - 1, C), is who is meant to be supplied in the steps that follow. It is
    ``inverted`` where lower tiers and charging batteries take its demand now, else ``shorter``: for
    how long what they take would do for it. Both say for how many of the later steps it waits.
    Empty if no lower tier is on.
    """
    c = scenario.customers
    rank = {tier: k for k, tier in enumerate(scenario.tiers)}
    position = np.array([rank[tier] for tier in c.tier])
    on = np.asarray(served, dtype=bool)
    found: dict[str, str] = {}
    for customer in sorted(np.flatnonzero(~on), key=lambda i: (position[i], -load_kw[i])):
        lower = on & (position > position[customer])
        lower_kw, kw = float(load_kw[lower].sum()), float(load_kw[customer])
        if lower_kw <= TOLERANCE_KW:
            continue
        off = f"{c.id[customer]} ({c.tier[customer]}, {kw:,.1f} kW)"
        have = "of a lower tier has" if lower.sum() == 1 else "of lower tiers have"
        others = f"{named(c.id[lower], NAMES)} {have} {lower_kw:,.1f} kW"
        if charge_kw > TOLERANCE_KW:
            others += f" and batteries charge with {charge_kw:,.1f} kW"
        words, waits = f"{off} is off supply, while {others}", _waiting_words(later, int(customer))
        if lower_kw + charge_kw >= kw:
            return {"inverted": f"{words}{waits}"}
        minutes = scenario.grid.step_minutes * (lower_kw + charge_kw) / kw
        short = f"enough for it for {minutes:.0f} of {scenario.grid.step_minutes:g} min"
        found.setdefault("shorter", f"{words}, {short}{waits}")
    return found


def _waiting_words(later: Flags | None, customer: int) -> str:
    """Phrase: in how many of the next steps a plan supplies the customer; empty without any."""
    if later is None or not len(later):
        return ""
    on = np.asarray(later, dtype=bool)[:, customer]
    steps = "the next step" if len(on) == 1 else f"the next {len(on)} steps"
    if not on.any():
        return f"; the plan does not supply it in {steps} either"
    return f"; the plan supplies it in {steps if on.all() else f'{on.sum()} of {steps}'}"

"""Windows whose steps nothing joins, solved one by one (``docs/method.md``, *Steps apart*).

Batteries carry energy, and switching rules carry duties, from one step to another. Where there is
neither, the objective is a sum over the steps, and so are the best dispatch and its bound. Solved
together, such a window is one knapsack for each step at the same time, and a search multiplies
their branches. Batteries of next to no power join the steps by watts: there each step is bounded
from any state of charge, and dispatched with the energy that the steps before have left.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields, replace

import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.contract.stored_value import PIECES, StoredValue
from vppres.core.arrays import Flags
from vppres.core.errors import SolveError
from vppres.model.data import WindowData
from vppres.model.formulas import cell_kw, soc_after
from vppres.model.site import Site
from vppres.model.terms import Terms
from vppres.solve.deadline import LEAST_S, Deadline
from vppres.solve.result import SolveLimits, Status, WindowSolution

SolveStep = Callable[[WindowData, SolveLimits], WindowSolution]

TWICE = 2.0
"""Factor of the energy of batteries that are to start anywhere between full and empty."""

SHARES = 2.0
"""Shares of the time left that a step may take: most need less than theirs."""

LAST_SHARE = 0.25
"""Share of a window's time that a second bound may take, in which what is stored has a price."""

HALF = 0.5
"""State of charge of a battery that may start anywhere, between its limits."""


def falls_apart(site: Site, data: WindowData) -> bool:
    """Whether a window has several steps and nothing that joins them."""
    return data.n_steps > 1 and len(site.batteries) == 0 and data.switching is None


def hardly_joined(site: Site, data: WindowData) -> bool:
    """Whether a window has several steps that are joined by batteries of next to no power alone."""
    idle = len(site.batteries) > 0 and site.batteries.idle
    plain = data.switching is None and data.terminal is None and not data.physical
    return data.n_steps > 1 and idle and plain and data.stored_value is None


def with_room_both_ways(site: Site) -> Site:
    """The site with batteries of twice the energy.

    Half full, they can take or give in one step whatever those of the site can from any state.
    """
    b = site.batteries
    return replace(site, batteries=replace(b, energy_kwh=TWICE * b.energy_kwh))


def solve_in_turn(
    site: Site, data: WindowData, limits: SolveLimits, solve: SolveStep, relaxed: SolveStep
) -> WindowSolution:
    """Solve a window step by step, each from the energy that the one before has left.

    Parameters
    ----------
    site : Site
        Fixed data.
    data : WindowData
        A window that is hardly joined.
    limits : SolveLimits
        Of the whole window: a step gets its share of the absolute gap and of the time left.
    solve, relaxed : callable
        Solve the window of one step, and the same from any state of charge.

    Raises
    ------
    SolveError
        If a step has no dispatch.
    """
    deadline = Deadline(limits.time_s)
    b = site.batteries
    soc = data.soc
    half = b.soc_min + HALF * (b.soc_max - b.soc_min)
    steps: list[WindowSolution] = []
    for k, alone in enumerate(_shares(data.n_steps, limits, deadline)):
        step = data.part(slice(k, k + 1))
        free = relaxed(replace(step, soc=half), alone)
        carried = _from_soc(site, replace(step, soc=soc), free)
        if carried is None:
            found = solve(replace(step, soc=soc), alone)
            # Any dispatch of the step is one from any state too.
            stages = free.stages + found.stages
            bound = max(free.bound, found.objective)
            solver_s = free.solver_s + found.solver_s
            carried = replace(found, bound=bound, stages=stages, solver_s=solver_s)
        steps.append(carried)
        soc = np.clip(carried.dispatch.soc[-1], b.soc_min, b.soc_max)
    found = _joined(steps, limits, deadline)
    missing = found.gap_abs - limits.gap_at(found.objective)
    if found.status == Status.OPTIMAL or deadline.passed or missing > _most_priced(site, data):
        return found
    bound = _bound_with_price(site, data, steps, limits.within(LAST_SHARE), relaxed)
    met = limits.met(bound, found.objective)
    return replace(found, bound=bound, status=Status.OPTIMAL if met else found.status)


def _bound_with_price(
    site: Site,
    data: WindowData,
    steps: Sequence[WindowSolution],
    limits: SolveLimits,
    relaxed: SolveStep,
) -> float:
    """Bound on the window where steps in a row would fill batteries that soon are full.

    From any state of charge each of them stores what it can of sun that is lost otherwise. What a
    run of steps stores together finds room in the batteries. So the run is worth no more than its
    steps if every kWh stored has a price, and that price for all the room there is: a Lagrangian
    bound. At the price of a lost kWh nothing gains by being stored.
    """
    b = site.batteries
    price = _price_of_lost(site, data)
    full_kwh = float(b.energy_kwh @ b.soc_max)
    wasted = np.array([step.terms.f3 for step in steps]) > 0.0
    deadline = Deadline(limits.time_s)
    shares = _shares(data.n_steps, limits, deadline)
    bound = sum(step.bound for step in steps)
    for first, end in _runs(data.dark | wasted):
        soc = data.soc if first == 0 else b.soc_min
        room_kwh = full_kwh - float(b.energy_kwh @ soc)
        priced = price * room_kwh
        for k in range(first, end):
            priced += _with_price(site, data.part(slice(k, k + 1)), price, relaxed, next(shares))
        bound -= max(sum(step.bound for step in steps[first:end]) - priced, 0.0)
    return bound


def _most_priced(site: Site, data: WindowData) -> float:
    """By how much a price of what is stored can lower the bounds of all steps at most."""
    most_kwh = float(site.batteries.active_max_kw.sum()) * site.dt_h * data.n_steps
    return _price_of_lost(site, data) * most_kwh


def _price_of_lost(site: Site, data: WindowData) -> float:
    """What a kWh in a battery is worth that would be lost otherwise."""
    return site.weights.lambda_curt / float(data.eta_charge.min())


def _with_price(
    site: Site, step: WindowData, price: float, relaxed: SolveStep, alone: SolveLimits
) -> float:
    """Bound on a step from any state of charge in which what is stored has a price."""
    b = site.batteries
    half = b.soc_min + HALF * (b.soc_max - b.soc_min)
    held_kwh = TWICE * float(b.energy_kwh @ half)
    stored_kwh = np.arange(PIECES + 1.0) - PIECES / 2
    value = StoredValue(held_kwh + stored_kwh, -price * stored_kwh, 1.0, as_service=True)
    try:
        return relaxed(replace(step, soc=half, stored_value=value), alone).bound
    except SolveError:
        return np.inf


def _runs(flags: Flags) -> list[tuple[int, int]]:
    """First step and end of every run of steps.

    >>> _runs(np.array([True, True, False, True]))
    [(0, 2), (3, 4)]
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    return [(int(first), int(end)) for first, end in edges.reshape(-1, 2)]


def better(one: WindowSolution, other: WindowSolution, limits: SolveLimits) -> WindowSolution:
    """The better of two answers to the same window, with what both prove and took."""
    best = one if one.objective >= other.objective else other
    bound = min(one.bound, other.bound)
    met = limits.met(bound, best.objective)
    return replace(
        best,
        bound=bound,
        status=Status.OPTIMAL if met else one.status,
        service_gap=min(one.service_gap, other.service_gap),
        solve_s=one.solve_s + other.solve_s,
        solver_s=one.solver_s + other.solver_s,
        stages=other.stages + one.stages,
    )


def _from_soc(site: Site, step: WindowData, free: WindowSolution) -> WindowSolution | None:
    """The answer from any state of charge as one from the step's, None where that forbids it."""
    b = site.batteries
    found = free.dispatch
    stored_kw = cell_kw(found.charge_kw, found.discharge_kw, step.eta_charge, step.eta_discharge)
    soc = np.vstack([step.soc, soc_after(step.soc, stored_kw, b, site.dt_h)])
    if (soc < b.soc_min).any() or (soc > b.soc_max).any():
        return None
    return replace(free, dispatch=replace(found, soc=soc))


def solve_apart(data: WindowData, limits: SolveLimits, solve: SolveStep) -> WindowSolution:
    """Solve a window step by step.

    Parameters
    ----------
    data : WindowData
        A window that falls apart.
    limits : SolveLimits
        Of the whole window: a step gets its share of the absolute gap and of the time left.
    solve : callable
        Solves the window of one step.

    Raises
    ------
    SolveError
        If a step has no dispatch.
    """
    deadline = Deadline(limits.time_s)
    parts = [data.part(slice(k, k + 1)) for k in range(data.n_steps)]
    shares = _shares(data.n_steps, limits, deadline)
    steps = [solve(part, alone) for part, alone in zip(parts, shares, strict=True)]
    found = _joined(steps, limits, deadline)
    if found.status == Status.OPTIMAL:
        return found
    closer = replace(limits, gap_abs=limits.gap_at(found.objective) / data.n_steps)
    again = [
        _closer(part, step, closer.at_most(deadline.left_s), solve)
        for part, step in zip(parts, steps, strict=True)
    ]
    return _joined(again, limits, deadline)


def _closer(
    part: WindowData, step: WindowSolution, limits: SolveLimits, solve: SolveStep
) -> WindowSolution:
    """A step's answer, sought once more where it leaves more open than its share.

    What some steps gain and others lose adds up to less than any of them is worth, and a gap that
    is small beside each may be large beside all.
    """
    if step.bound - step.objective <= limits.gap_abs or limits.time_s <= LEAST_S:
        return step
    try:
        return better(solve(part, limits), step, limits)
    except SolveError:
        return step


def _shares(n_steps: int, limits: SolveLimits, deadline: Deadline) -> Iterator[SolveLimits]:
    """Limits of each step, of the time as it is left when the step begins.

    Where earlier ones have used it up, a step has its grace for an answer.
    """
    for k in range(n_steps):
        share = min(SHARES / (n_steps - k), 1.0)
        yield SolveLimits(
            gap_rel=limits.gap_rel,
            gap_abs=limits.gap_abs / n_steps,
            time_s=max(share * deadline.left_s, LEAST_S),
        )


def _joined(
    steps: Sequence[WindowSolution], limits: SolveLimits, deadline: Deadline
) -> WindowSolution:
    """The window of these steps: all figures are sums.

    So the gap of cost is that of sets that serve as much in each step, not in all together.
    """
    objective = sum(step.objective for step in steps)
    bound = sum(step.bound for step in steps)
    losses = [step.loss_kw for step in steps if step.loss_kw is not None]
    return WindowSolution(
        dispatch=_one_dispatch([step.dispatch for step in steps]),
        terms=Terms(
            **{f.name: sum(getattr(step.terms, f.name) for step in steps) for f in fields(Terms)}
        ),
        objective=objective,
        bound=bound,
        status=_status(steps, limits.met(bound, objective)),
        service_gap=sum(step.service_gap for step in steps),
        cost_gap_gbp=sum(step.cost_gap_gbp for step in steps),
        solve_s=deadline.spent_s,
        solver_s=sum(step.solver_s for step in steps),
        stages=tuple(stage for step in steps for stage in step.stages),
        loss_kw=np.concatenate(losses) if losses else None,
    )


def _status(steps: Sequence[WindowSolution], met: bool) -> Status:
    """What the whole window's dispatch is worth."""
    if met:
        return Status.OPTIMAL
    late = any(step.status == Status.TIME_LIMIT for step in steps)
    return Status.TIME_LIMIT if late else Status.GAP_OPEN


def _one_dispatch(parts: Sequence[Dispatch]) -> Dispatch:
    """The dispatches of consecutive steps as one; ``soc`` has a row more than the steps."""
    rows = {
        f.name: np.concatenate([getattr(part, f.name) for part in parts])
        for f in fields(Dispatch)
        if f.name != "soc"
    }
    soc = np.concatenate([parts[0].soc[:1], *(part.soc[1:] for part in parts)])
    return Dispatch(**rows, soc=soc)

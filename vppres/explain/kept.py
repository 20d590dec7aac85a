"""Why energy is kept: for later hours of an outage, and for a possible outage at what cost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vppres.core.errors import SolveError
from vppres.core.text import in_pounds, named
from vppres.explain.room import limits_in_full
from vppres.explain.step import Step
from vppres.explain.words import figure
from vppres.kinds.table import KINDS

POSSIBLE = 0.2
"""Probability from which a step of an outage counts as one that energy is kept for."""

LEAST_GBP = 0.5
"""Amounts below it are no pound."""

NAMED = 2
"""Customers that are named; of more their number and tier."""

NAMES_SHOWN = 3
"""Customers named of those whose later hours energy is kept for."""

MOSTLY = 0.5
"""Share of its demand from which the relaxed window counts a customer as on."""


def kept_for(step: Step, customer: int) -> str:
    """The customers for which energy is kept that another could have now; empty if that is not so.

    They count at least as much per kW in a later step of the outage, in strict order by tier.
    """
    service = step.levels.service
    demand_kw = float(step.load_kw[customer])
    if service is None or step.spare.dark_steps < 2 or step.spare.now_kw < demand_kw:
        return ""
    if limits_in_full(step, customer, "energy") not in ([], ["energy"]):
        return ""
    later = slice(1, step.spare.dark_steps)
    c = step.site.customers
    if step.site.ranks is None:
        per_kw = c.weight / np.maximum(step.levels.window.load_kw[later], 1e-9)
        first = per_kw >= c.weight[customer] / max(demand_kw, 1e-9)
    else:
        tier = step.site.ranks.tier
        first = np.broadcast_to(tier <= tier[customer], service.served_share[later].shape)
    on = first & (service.served_share[later] >= MOSTLY)
    if not on.any():
        return ""
    rank = [step.scenario.tiers.index(tier) for tier in c.tier]
    who = sorted(np.flatnonzero(on.any(axis=0)).tolist(), key=lambda one: rank[one])
    highest = str(c.tier[who[0]])
    names = [str(c.id[one]) for one in who if c.tier[one] == highest]
    lower = len(who) - len(names)
    more = f" and {lower} of lower tiers" if lower else ""
    last = int(np.flatnonzero(on.any(axis=1))[-1]) + 1
    grid = step.scenario.grid
    until = grid.local(grid.times[step.t] + (last + 1) * grid.step)
    grid_back = last + 1 == step.spare.dark_steps < step.levels.window.n_steps
    then = "when the grid is expected" if grid_back else "before which no grid is expected"
    return (
        f"kept for later hours of {named(names, NAMES_SHOWN)} ({highest}){more} "
        f"up to {until:%H:%M}, {then}"
    )


def why_kept(step: Step) -> str:
    """Why a step keeps energy for a possible outage; empty if it keeps none, or for the price."""
    window = step.levels.window
    worth = step.later_worth_gbp
    if window.stored_value is None or worth is None:
        return ""
    if not step.outage and worth <= step.dearest_gbp:
        return ""
    ahead = step.windows.believed[step.t, step.t + 1 :]
    possible = np.flatnonzero(np.nan_to_num(ahead) >= POSSIBLE)
    b = step.site.batteries
    held_kwh = float(b.energy_kwh @ (step.soc_end - b.soc_min))
    most_kwh = float(b.energy_kwh @ (b.soc_max - b.soc_min))
    for kind, kwh_each in window.stored_value.kwh_each.items():
        for left, most in KINDS[kind].store:
            held_kwh += float(step.of_items(KINDS[kind].table, left) @ kwh_each)
            most_kwh += float(getattr(step.site.kinds[kind], most) @ kwh_each)
    first = step.site.customers.tier == step.scenario.tiers[0]
    needed_kw = float(step.scenario.load_kw[step.t :][: len(ahead) + 1, first].mean(axis=0).sum())
    gbp = _costs_gbp(step)
    if not len(possible) or gbp is None or held_kwh <= 0.01 * most_kwh or needed_kw <= 0.0:
        return ""
    names = [str(name) for name in step.site.customers.id[first]]
    the_many = f"the {len(names)} customers of tier {step.scenario.tiers[0]}"
    covers = " and ".join(names) if len(names) <= NAMED else the_many
    hours = held_kwh * float(b.eta_discharge.mean()) / needed_kw
    # The latest time, of those with a probability of ``POSSIBLE``, up to which there is an outage.
    last, grid = int(possible[-1]), step.scenario.grid
    end, until = (
        f"{grid.local(grid.times[step.t] + steps * grid.step):%H:%M}" for steps in (1, last + 2)
    )
    may = "the outage may last to" if step.outage else "an outage is possible up to"
    costs = in_pounds(gbp, ",.0f") if gbp >= LEAST_GBP else "nothing"
    return (
        f"{held_kwh / most_kwh:.0%} of the usable energy is kept until {end} because {may} {until} "
        f"with {ahead[last]:.0%}; it costs {costs} in this step; it covers {covers} for "
        f"{figure(hours)} h."
    )


def _costs_gbp(step: Step) -> float | None:
    """Saving of the step if nothing were kept: import, and supply at the value of lost load.

    It is solved again without the value.
    """
    window = step.levels.window.first(1)
    value = step.levels.window.stored_value
    assert value is not None
    try:
        alone = step.windows.solver.solve(replace(window, stored_value=None)).dispatch
    except SolveError:
        return None
    dt_h = step.site.dt_h
    weight = step.site.customers.weight
    lost = float((alone.served[0].astype(float) - step.served) @ weight) * dt_h
    imported_kw = 0.0 if step.outage else step.imported_kw
    spent = step.price_gbp_per_kwh * (imported_kw - float(alone.p_grid_kw[0])) * dt_h
    return max(value.gbp_per_service * lost + spent, 0.0)

"""The site that the controllers of a run plan for: the order of its tiers, soft or hard limits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from vppres.core.arrays import Floats
from vppres.model.site import Site
from vppres.scenario.priority import STRICT, Ranks
from vppres.scenario.scenario import LIMIT, SOFT, Scenario


def site_of(scenario: Scenario, options: Mapping[str, Any]) -> Site:
    """The site of a scenario as the controllers of a run weigh and limit it."""
    soft = options.get("voltage_limits") == SOFT
    feeder = scenario.phases or scenario.network
    ratings = options.get("ratings")
    site = replace(
        Site.of(scenario),
        soft_voltages=soft,
        rated=ratings in (LIMIT, SOFT) and feeder.has_ratings,
        soft_ratings=ratings == SOFT and feeder.has_ratings,
    )
    ranks = ranks_of(scenario, options)
    return site if ranks is None else site.ranked(ranks, longest_window(scenario, options))


def weighed(site: Site, scenario: Scenario, options: Mapping[str, Any], weight: Floats) -> Site:
    """A site with other weights of its customers, (C,), in the run's order of the tiers."""
    customers = replace(scenario.customers, weight=weight)
    other = site_of(replace(scenario, customers=customers), options)
    return replace(site, customers=other.customers, weights=other.weights, ranks=other.ranks)


def ranks_of(scenario: Scenario, options: Mapping[str, Any]) -> Ranks | None:
    """Ranks of the customers in a run; None where tiers are weighed against each other."""
    if options.get("priority") != STRICT:
        return None
    price = float(options["switching"]["price_per_action"])
    steps = longest_window(scenario, options)
    return Ranks.of(scenario.customers, scenario.tiers, steps, price / scenario.grid.dt_h)


def longest_window(scenario: Scenario, options: Mapping[str, Any]) -> int:
    """Steps of the longest window that a run solves."""
    if options["controller"] == "mpc":
        return scenario.grid.steps_in_horizon(float(options["horizon_h"]))
    return scenario.grid.n_steps

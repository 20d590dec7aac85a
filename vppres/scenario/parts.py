"""Customers that may be switched in parts: each part becomes a customer before the run."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from vppres.core.arrays import Floats, Names, Wholes
from vppres.scenario.assets import OPTIONAL
from vppres.scenario.scenario import Scenario


def split_sheddable(scenario: Scenario) -> Scenario:
    """The scenario with every customer of K ``shed_steps`` as K customers.

    The parts of ``C7`` are ``C7/1`` to ``C7/K``. Each has a K-th of the demand and of the weight,
    and a K-th of the PV system in power, rating and series. The served share of the customer is
    the mean over its parts. Where all customers are all or nothing it is the same object.
    """
    customers = scenario.customers
    pv = scenario.pv
    history = scenario.history
    parts = customers.shed_steps
    if (parts == 1).all():
        return scenario
    names_of = dict(zip(customers.id, map(_names_of, customers.id, parts), strict=True))
    pv_parts = np.where(pv.alone, 1, parts[pv.owner(customers)])
    split_customers = replace(
        customers,
        id=_part_names(customers.id, parts),
        weight=_shared(customers.weight, parts),
        **{
            name: np.repeat(getattr(customers, name), parts)
            for name in ("bus", "tier", "power_factor", "homes", *OPTIONAL)
            if len(getattr(customers, name))
        },
        shed_steps=np.ones(parts.sum(), dtype=int),
    )
    split_pv = replace(
        pv,
        id=_part_names(pv.id, pv_parts),
        customer=_part_names(pv.customer, pv_parts),
        p_max_kw=_shared(pv.p_max_kw, pv_parts),
        s_max_kva=_shared(pv.s_max_kva, pv_parts),
        kind=np.repeat(pv.kind, pv_parts),
        bus=np.repeat(pv.bus, pv_parts),
    )
    return replace(
        scenario,
        customers=split_customers,
        pv=split_pv,
        load_kw=_shared(scenario.load_kw, parts),
        pv_kw=_shared(scenario.pv_kw, pv_parts),
        interruptions=tuple(
            replace(one, customer=name)
            for one in scenario.interruptions
            for name in names_of.get(one.customer, [one.customer])
        ),
        history=None
        if history is None
        else replace(
            history,
            load_kw=_shared(history.load_kw, parts),
            pv_kw=_shared(history.pv_kw, pv_parts),
        ),
    )


def parts_record(scenario: Scenario) -> dict[str, Any]:
    """Customers in several parts and how many, for the record of a run; empty without any.

    Examples
    --------
    >>> from vppres.io import find_scenario, read_scenario
    >>> parts_record(read_scenario(find_scenario("uk-heatwave-2022")))
    {}
    """
    parts = {
        str(name): int(count)
        for name, count in zip(scenario.customers.id, scenario.customers.shed_steps, strict=True)
        if count > 1
    }
    return {"parts": parts} if parts else {}


def part_names(customer: str, count: int) -> list[str]:
    """Identifiers of a customer's parts.

    >>> part_names("C7", 2)
    ['C7/1', 'C7/2']
    """
    return [f"{customer}/{k}" for k in range(1, count + 1)]


def _part_names(names: Names, parts: Wholes) -> Names:
    """Names of all parts in order; a customer without parts keeps its name."""
    split = map(_names_of, names, parts)
    return np.array([name for group in split for name in group], dtype=object)


def _names_of(name: str, count: int) -> list[str]:
    return [name] if count == 1 else part_names(name, count)


def _shared(values: Floats, parts: Wholes) -> Floats:
    """Values divided among the parts, along the last axis."""
    return np.repeat(values / parts, parts, axis=-1)

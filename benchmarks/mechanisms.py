"""The mechanisms of the solver, each with the patch that switches it off and the code it needs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

import vppres.solve.ladder  # noqa: F401 (the names below are looked up in what it imports)
from vppres.core.arrays import Floats
from vppres.model.data import WindowData
from vppres.solve.programs import PROOF
from vppres.solve.result import Outcome, Status

SOLVE = "vppres.solve."


@dataclass(frozen=True)
class Mechanism:
    """Something that can be left out."""

    name: str  #: of the line in the table
    #: What replaces an attribute, by its name below the package of the solver.
    switches: Mapping[str, Any]
    code: Sequence[str] = ()  #: names of the sources that nothing else needs


def no(*_: object) -> bool:
    """Never."""
    return False


def nothing(*_: object) -> None:
    """Does nothing, finds nothing."""


def nothing_proven(*_: object) -> tuple[float, None]:
    """No bound of one battery, and no set."""
    return np.inf, None


def none_held(master: Any, *_: object) -> Floats:
    """No customer that a feeder's own search has decided."""
    return np.full(master.units.size, np.nan)


def every_battery(data: WindowData) -> tuple[bool, ...]:
    """Every battery by itself from the beginning; a fleet of none is one."""
    return (len(data.soc) == 0,)


def no_search(*_: object) -> tuple[Outcome, None]:
    """Finds no set, and proves nothing."""
    return Outcome(Status.NO_ANSWER, np.nan, np.nan, 0.0), None


def no_options(*_: object) -> Mapping[str, Any]:
    """HiGHS as it comes."""
    return {}


def one_set(*_: object) -> Mapping[str, Any]:
    """The same options of HiGHS for every search."""
    return PROOF


def no_groups(*_: object) -> list[Any]:
    """No sums to branch on."""
    return []


MECHANISMS = (
    Mechanism("everyone first", {"ladder.worth_everyone": no}, ("fleet.reach",)),
    Mechanism("steps apart", {"ladder.falls_apart": no}, ("apart",)),
    Mechanism("recursion", {"fleet.masters.most_units": nothing_proven}, ("fleet.recursion",)),
    Mechanism(
        "equivalent battery first",
        {"ladder.fleets_of": every_battery, "fleet.all_terms.fleets_of": every_battery},
        ("fleet.masters.fleets_of",),
    ),
    Mechanism("all terms of the fleet", {"ladder.all_terms": nothing}, ("fleet.all_terms",)),
    Mechanism(
        "battery modes",
        {"ladder.with_modes_of_batteries": nothing},
        ("fleet.rungs.with_modes_of_batteries", "fleet.rungs._search_modes"),
    ),
    Mechanism(
        "service in the network",
        {"network.decide.network_master": nothing, "ladder.network_master": nothing},
        ("network.master", "network.cheapest", "network.large"),
    ),
    Mechanism(
        "cuts of feeders",
        {"network.large.LargeMaster._by_feeders": none_held},
        ("network.large.Feeders", "network.large.LargeMaster._by_feeders"),
    ),
    Mechanism(
        "cheaper set in the network",
        {"network.master.NetworkMaster.cheaper": no_search},
        ("network.master.NetworkMaster.cheaper",),
    ),
    Mechanism(
        "options of HiGHS",
        {
            "network.master.search_options": no_options,
            "fleet.masters.search_options": no_options,
            "fleet.all_terms.search_options": no_options,
            "programs.PROOF": {},
            "network.large.SEARCH": {},
        },
    ),
    Mechanism(
        "sums to branch on",
        {"network.master.columns_of_alike": no_groups},
        ("programs.columns_of_alike", "programs.with_sums"),
    ),
    Mechanism(
        "options by kind of window",
        {
            "network.master.search_options": one_set,
            "fleet.masters.search_options": one_set,
            "fleet.all_terms.search_options": one_set,
        },
        ("programs.search_options",),
    ),
    Mechanism("whole problem", {"ladder.with_binaries": nothing}, ("whole.with_binaries",)),
    Mechanism(
        "whole problem without binaries",
        {"ladder.without_binaries": nothing},
        ("whole.without_binaries",),
    ),
)

GROUPS: dict[str, tuple[str, ...]] = {
    "the fleet": ("recursion", "all terms of the fleet", "battery modes"),
}
"""Mechanisms that are switched off together."""

"""Changes to a net that its user asks for, before it is reduced to a feeder."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from vppres.feeders.net.balance import balance_net
from vppres.feeders.net.grids import one_grid
from vppres.feeders.net.loops import Opening, open_loops
from vppres.feeders.net.reduce import open_named
from vppres.feeders.net.stand_ins import stand_ins
from vppres.scenario.network import BusId


@dataclass(frozen=True)
class PermittedChanges:
    """Changes that are permitted so that a net becomes a balanced radial feeder.

    As the parameters of :func:`vppres.feeders.import_network`.
    """

    open_branches: Sequence[str] = ()
    open_loops: bool = False
    slack: str | None = None
    balance: bool = False
    names: bool = False


def changed(
    net: Any, name: str, changes: PermittedChanges, bus_ids: Mapping[int, BusId] | None = None
) -> tuple[Any, Opening]:
    """A changed copy of a net, and notes on what was changed, with the effect of opened loops."""
    net = copy.deepcopy(net)
    notes = [*one_grid(net, name, changes.slack, bus_ids)]
    open_named(net, name, changes.open_branches)
    notes += stand_ins(net)
    if changes.balance:
        notes += balance_net(net)
    opening = open_loops(net, name) if changes.open_loops else Opening()
    return net, Opening((*notes, *opening.notes), opening.moved_pu)

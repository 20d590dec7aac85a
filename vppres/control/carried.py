"""A dispatch of one step as it follows from the powers of devices, and what it leaves open."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.control.step_state import StepState, network_state
from vppres.core.arrays import Flags, Floats, Wholes
from vppres.model.formulas import bus_injections

POWER_TOLERANCE_KW = 1e-6
VOLTAGE_TOLERANCE_PU = 1e-6

S = TypeVar("S")


@dataclass(frozen=True, eq=False)
class Carried(Dispatch):
    """A dispatch of one step, and what it leaves open."""

    reactive_short_kvar: float = 0.0  #: reactive power that no device can supply
    #: How far the worst bus lies outside the limits of the AC voltages.
    voltage_excess_pu: float = 0.0
    surplus_kw: float = 0.0  #: what generating sets give and no customer takes

    @property
    def shortage(self) -> str:
        """Shortage that is left, in words; empty if nothing is."""
        words = []
        if self.reactive_short_kvar > POWER_TOLERANCE_KW:
            words.append(f"{self.reactive_short_kvar:.1f} kvar short")
        if self.voltage_excess_pu > VOLTAGE_TOLERANCE_PU:
            words.append(f"voltage {self.voltage_excess_pu:.4f} pu outside the AC limits")
        return ", ".join(words)

    def no_worse_than(self, other: Carried) -> bool:
        """Whether neither reactive power nor voltage is further off than in another dispatch."""
        return self.reactive_short_kvar <= max(
            other.reactive_short_kvar, POWER_TOLERANCE_KW
        ) and self.voltage_excess_pu <= max(other.voltage_excess_pu, VOLTAGE_TOLERANCE_PU)


def with_more(
    served: Flags,
    best: S,
    blocks: Iterable[Wholes],
    carried: Callable[[Flags, S], S | None],
) -> S:
    """A schedule with as many more customers as are carried, block by block, as their order has it.

    ``best`` is the schedule of those that are served, ``carried`` says if others are beside it.
    A block that is not carried is tried in halves.
    """
    left = [*blocks][::-1]
    while left:
        block = left.pop()
        tried = served.copy()
        tried[block] = True
        found = carried(tried, best)
        if found is not None:
            served, best = tried, found
        elif len(block) > 1:
            left += np.array_split(block, 2)[::-1]
    return best


def in_proportion(total: float, room: Floats) -> Floats:
    """A total, or as much of it as there is room for, in proportion to the room."""
    space = float(room.sum())
    return room * min(total / space, 1.0) if space > 0 and total > 0 else np.zeros_like(room)


def dispatch_of(
    state: StepState,
    served: Flags,
    pv: tuple[Floats, Floats, Floats],
    battery_kw: Floats,
    battery_kvar: Floats,
    grid_kw: float,
    given_kvar: Mapping[str, Floats],
) -> Carried:
    """One step in which customers are supplied, (C,), with its flows, voltages and storage.

    ``pv`` is own use, export and reactive power. Batteries charge with ``battery_kw``, negative to
    discharge, and give ``battery_kvar``; ``grid_kw`` is negative for export; ``given_kvar`` is what
    units give by kind, (n,).
    """
    site = state.site
    own, export, pv_kvar = pv
    load_kw = state.load_kw * served
    load_kvar = load_kw * site.customers.q_per_p
    given = {"pv": own + export, "batteries": -battery_kw, "customers": -load_kw}
    p = bus_injections(site, given | {kind: -kw for kind, kw in state.taken_kw.items()})
    of_devices = {"pv": pv_kvar, "batteries": battery_kvar, "customers": -load_kvar}
    q = bus_injections(site, of_devices | dict(given_kvar))
    p_flow, q_flow, v_pu = network_state(state, p, q)
    charge = np.maximum(battery_kw, 0.0)
    discharge = np.maximum(-battery_kw, 0.0)
    carried = Carried.one_step(
        served=served,
        pv_self_kw=own,
        pv_export_kw=export,
        pv_curtailed_kw=state.pv_kw - own - export,
        pv_q_kvar=pv_kvar,
        charge_kw=charge,
        discharge_kw=discharge,
        batt_q_kvar=battery_kvar,
        p_grid_kw=grid_kw,
        q_grid_kvar=0.0 if state.island else float(state.drawn_kvar.sum() - q.sum()),
        v_pu=v_pu,
        p_flow_kw=p_flow,
        q_flow_kvar=q_flow,
        soc=state.batteries_ahead.path(charge[np.newaxis], discharge[np.newaxis]),
        given_kvar={kind: kvar[np.newaxis] for kind, kvar in given_kvar.items()},
    )
    for kind, kw in state.taken_kw.items():
        on = state.running.get(kind)
        carried = carried.acting(kind, kw[np.newaxis], None if on is None else on[np.newaxis])
    return carried

"""Losses and voltages of a candidate dispatch, step by step, as the model takes them in.

A line's loss is linearised at an AC point of its step: active and reactive loss enter the balance
at the line's far end as the values that they have there, and the voltage drop gets the offset that
makes the linear voltages meet the AC ones. How the losses change with the flows is left to the next
pass (``docs/decisions/islands.md`` says why); the flows' own cost is in the tie-breakers' f4.

The AC points come from backward and forward sweeps over all steps at once. The verifier solves
Newton's equations in pandapower and shares no function with this module.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Complexes, Flags, Floats, freeze_arrays
from vppres.model.data import Physics, WindowData
from vppres.model.formulas import bus_injections, voltage_offset_pu2
from vppres.model.linearise import Drawn, drawn_at
from vppres.model.site import Site
from vppres.scenario.network import Network

TOLERANCE_PU = 1e-10
LOSS_MARGIN = 0.01
"""Share of an island's losses that plans count on top."""

_MAX_SWEEPS = 60
_LOWEST_PU = 0.5  # no feeder runs below; the sweeps there are beyond their solution


@dataclass(frozen=True, eq=False)
class ACPoints:
    """AC points of W steps: voltages (W, N), flows at the lines' upper ends and losses (W, L).

    Voltages are those of the buses; a line's own charging stands at its ends and is in no flow.
    """

    v_pu: Floats
    p_flow_kw: Floats
    q_flow_kvar: Floats
    loss_kw: Floats
    loss_kvar: Floats
    converged: Flags

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def where(self, chosen: Flags, other: ACPoints) -> ACPoints:
        """These points with those of ``other`` in the chosen steps, (W,)."""
        rows = np.flatnonzero(chosen)
        values = {f.name: np.array(getattr(self, f.name)) for f in fields(self)}
        for name, value in values.items():
            value[rows] = getattr(other, name)[rows]
        return ACPoints(**values)

    def offset_pu2(self, network: Network) -> Floats:
        """Offset of each line's voltage drop that meets these points, (W, L)."""
        u_pu2 = network.u_pu2(self.v_pu)
        return voltage_offset_pu2(network, u_pu2, self.p_flow_kw, self.q_flow_kvar)


class Sweeps:
    """Backward and forward sweeps of a radial network from one reference bus.

    Parameters
    ----------
    network : Network
        The feeder.
    reference : int
        Position of the bus that is held at ``v_slack_pu``.

    Examples
    --------
    >>> net = Network([1], [2], [1.0], [1.0], slack_bus=1, base_kv=10.0)
    >>> points = Sweeps(net, 0).solve(np.array([[0.0, -100.0]]), np.zeros((1, 2)))
    >>> round(float(points.v_pu[0, 1]), 5), round(float(points.loss_kw[0, 0]), 4)
    (0.999, 0.1002)
    """

    def __init__(self, network: Network, reference: int = 0) -> None:
        self.network = network
        self.reference = reference

    @cached_property
    def _downstream(self) -> sp.csr_array:
        """Shape (L, N): +1 where a line feeds a bus, -1 where it does so against its direction."""
        net = self.network
        if self.reference == 0:
            return net.downstream
        turned = replace(net, slack_bus=net.buses[self.reference])
        line_at = {
            frozenset(ends): line
            for line, ends in enumerate(zip(net.from_bus, net.to_bus, strict=True))
        }
        lines = [
            line_at[frozenset(ends)] for ends in zip(turned.from_bus, turned.to_bus, strict=True)
        ]
        signs = np.where(turned.to_bus == net.to_bus[lines], 1.0, -1.0)
        columns = [turned.bus_index[bus] for bus in net.buses]
        by_turned = sp.diags_array(signs) @ turned.downstream[:, columns]
        return sp.csr_array(by_turned[np.argsort(lines)])

    def solve(self, p_kw: Floats, q_kvar: Floats) -> ACPoints:
        """AC points of the injections, shape (W, N) each; the reference bus supplies the rest."""
        net = self.network
        feeds = self._downstream
        z = (net.r_pu2_per_kw + 1j * net.x_pu2_per_kvar)[:, None]
        drawn = -(p_kw - net.p_fixed_kw + 1j * (q_kvar - net.q_fixed_kvar)).T
        shunt = (net.shunt_kw - 1j * net.shunt_kvar)[:, None]
        v_source = float(net.held_pu[self.reference] / net.bus_ratio[self.reference])
        v: Complexes = np.full(drawn.shape, v_source, dtype=complex)
        change = np.full(drawn.shape[1], np.inf)
        with np.errstate(all="ignore"):
            for _ in range(_MAX_SWEEPS):
                current = np.asarray(feeds @ (np.conj(drawn / v) + shunt * v))
                updated = v_source - feeds.T @ (z * current)
                change = np.abs(updated - v).max(axis=0)
                v = updated
                if not (change > TOLERANCE_PU).any():
                    break
            current = np.asarray(feeds @ (np.conj(drawn / v) + shunt * v))
            flow = (v[net.parent] * np.conj(current)).T
            loss = (z * np.abs(current) ** 2).T
        sound = (change <= TOLERANCE_PU) & (np.abs(v).min(axis=0) > _LOWEST_PU)
        v_pu = np.abs(v).T * net.bus_ratio
        return ACPoints(v_pu, flow.real, flow.imag, loss.real, loss.imag, sound)


def injections(site: Site, data: WindowData, dispatch: Dispatch) -> tuple[Floats, Floats]:
    """Net injections of a dispatch at all buses, without the grid's supply, (W, N) each."""
    load = data.load_kw * dispatch.supplied
    through = dispatch.pv_self_kw + dispatch.pv_export_kw
    load_kvar = load * site.customers.q_per_p
    battery_kw = dispatch.discharge_kw - dispatch.charge_kw
    given = {"pv": through, "customers": -load, "batteries": battery_kw}
    given |= {kind: -taken_kw for kind, taken_kw in dispatch.taken_kw.items()}
    p_kw = bus_injections(site, given)
    given_kvar = {
        "pv": dispatch.pv_q_kvar,
        "batteries": dispatch.batt_q_kvar,
        "customers": -load_kvar,
    }
    q_kvar = bus_injections(site, given_kvar | dispatch.given_kvar)
    return p_kw, q_kvar


def lit_steps(data: WindowData) -> Flags:
    """Steps in which anything can be served, generated or drawn, (W,)."""
    lit = data.load_kw.any(axis=1) | data.pv_kw.any(axis=1)
    if data.drawn:
        lit = lit | data.drawn.kw.any(axis=1) | data.drawn.kvar.any(axis=1)
    return np.asarray(lit, dtype=bool)


def linearised(data: WindowData, network: Network, points: ACPoints) -> WindowData:
    """The window with losses, draws and voltages as at these points; steps without keep theirs.

    In an island losses are counted with a margin: what forms it has to have them, whatever else
    the next plan moves.
    """
    old = data.physics
    margin = 1.0 + LOSS_MARGIN * data.in_island[:, 1:]
    sound = points.converged[:, None]
    drawn = data.drawn
    if network.draws or network.has_ratios:
        # In a blackout nothing is drawn or lost, and no voltage is too high, whatever a flow says.
        sound = sound & lit_steps(data)[:, None]
    if drawn:
        # Points that are not sound may have no voltage at all.
        new = drawn_at(network, np.where(sound, points.v_pu, 1.0), data.in_island)
        drawn = Drawn(np.where(sound, new.kw, drawn.kw), np.where(sound, new.kvar, drawn.kvar))
        drawn = drawn.at(~data.parts.dead)
    physics = replace(
        old,
        loss_kw=np.where(sound, points.loss_kw * margin, old.loss_kw),
        loss_kvar=np.where(sound, points.loss_kvar, old.loss_kvar),
    )
    offset = np.where(sound, points.offset_pu2(network), data.delta_pu2)
    return replace(data, physics=physics, delta_pu2=offset, drawn=drawn)


def lossless(data: WindowData, physics: Physics) -> WindowData:
    """The window with the same island and headroom, without losses, in plain LinDistFlow."""
    none = np.zeros_like(physics.loss_kw)
    return replace(
        data,
        physics=replace(physics, loss_kw=none, loss_kvar=none),
        delta_pu2=np.zeros_like(data.delta_pu2),
    )

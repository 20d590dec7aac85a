"""Linearisations of a site's windows: what its network takes and holds, by AC points of the steps.

A plan is made in a linear network that meets AC at one point of each step. Passes move these
points until they are the plan's own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import ClassVar, Protocol, TypeVar

import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.contract.observation import Observation
from vppres.core.arrays import Flags, Floats
from vppres.model.beyond_paper.losses import (
    ACPoints,
    Sweeps,
    injections,
    linearised,
    lit_steps,
)
from vppres.model.data import WindowData
from vppres.model.linearise import Drawn, drawn_at
from vppres.model.parts import parts_of
from vppres.model.site import Site

VOLTAGE_TOLERANCE_PU = 1e-4
LOSS_TOLERANCE_KW = 1.0

SHORT_KW = 1e-6
"""Losses that an island's plan may lack: its former may have no more, and then a customer is shed
for it."""

DEFAULT_PASSES = 4


class Points(Protocol):
    """AC points of a window: whether there is one of each step."""

    @property
    def converged(self) -> Flags:
        """Steps whose power flow has a solution, (W,)."""


P = TypeVar("P", bound=Points)


class Linearisation(Protocol[P]):
    """A network that is linear at AC points, which a balanced and a phased feeder have each.

    ``passes`` is the largest number of solves and power flows of a window, and ``open_kw`` what
    they may leave open between a plan and AC: a former has it left to the end of an outage.
    """

    passes: ClassVar[int]
    open_kw: ClassVar[float]

    def observed(self, observation: Observation) -> WindowData:
        """The observed window, with what the network draws."""

    def at_rest(self, data: WindowData) -> WindowData:
        """The window in the linearisation that is known without any plan."""

    def known(self, data: WindowData, dispatch: Dispatch) -> tuple[Floats, ...]:
        """Rows of each step of a plan to remember, (W, .) each."""

    def at_known(self, data: WindowData, rows: tuple[Floats, ...], steps: Flags) -> WindowData:
        """The window at rest linearised in some steps at what was remembered of such steps."""

    def points(self, data: WindowData, dispatch: Dispatch) -> P:
        """AC points of a candidate."""

    def agrees(self, data: WindowData, dispatch: Dispatch, points: P) -> bool:
        """Whether a candidate's window is what AC says of steps with power, which have points."""

    def closer(self, data: WindowData, dispatch: Dispatch, points: P, passes: int) -> WindowData:
        """The window linearised at a candidate's AC points, after so many passes."""

    def finished(self, data: WindowData, dispatch: Dispatch) -> Dispatch:
        """A plan with its voltages."""


@dataclass(frozen=True, eq=False)
class BalancedLinearisation:
    """Linearisation of a balanced feeder: losses of lines and offsets of their voltage drops."""

    site: Site
    _sweeps: dict[tuple[int, bool, bytes], Sweeps] = field(default_factory=dict)

    passes: ClassVar[int] = DEFAULT_PASSES
    open_kw: ClassVar[float] = 0.0

    def observed(self, observation: Observation) -> WindowData:
        """The observed window, with what the network draws.

        In an island too, for only batteries can supply it there.
        """
        data = WindowData.of(observation, self.site, "none")
        out = observation.window.out
        parts = parts_of(self.site, out, data.soc, data.dark, needs_former=True)
        data = data.in_parts(self.site, parts)
        network = self.site.network
        if not network.draws:
            return replace(data, drawn=Drawn.absent())
        point = observation.operating_point
        v_pu = network.v_slack_pu * network.bus_ratio
        if point is not None:
            v_pu = np.where(np.isnan(point.v_pu), v_pu, point.v_pu)
        everywhere = np.tile(v_pu, (data.n_steps, 1))
        drawn = drawn_at(network, everywhere, data.in_island)
        return replace(data, drawn=drawn.at(~data.parts.dead))

    def at_rest(self, data: WindowData) -> WindowData:
        """The window in plain LinDistFlow, without losses.

        Where there is no power every bus has the slack bus's voltage, ratios or not.
        """
        net = self.site.network
        if not net.has_ratios:
            return data
        u_pu2 = net.u_pu2(np.full(net.n_buses, net.v_slack_pu))
        flat = u_pu2[1:] - u_pu2[net.parent]
        return replace(data, delta_pu2=np.where(lit_steps(data)[:, None], data.delta_pu2, flat))

    def known(self, data: WindowData, dispatch: Dispatch) -> tuple[Floats, ...]:
        """Offset and losses of each line, and the draw of each bus."""
        return _rows(data)

    def at_known(self, data: WindowData, rows: Sequence[Floats], steps: Flags) -> WindowData:
        """The window with remembered offsets, losses and draws in some steps."""
        pairs = zip(rows, _rows(data), strict=True)
        offset_pu2, loss_kw, loss_kvar, *drawn = (np.where(steps[:, None], *pair) for pair in pairs)
        physics = replace(data.physics, loss_kw=loss_kw, loss_kvar=loss_kvar)
        return replace(
            data,
            delta_pu2=offset_pu2,
            physics=physics,
            drawn=Drawn(*drawn) if drawn else data.drawn,
        )

    def points(self, data: WindowData, dispatch: Dispatch) -> ACPoints:
        """AC points of a candidate, in an island with its reference at the battery's bus."""
        physics = data.physics
        network = self.site.network
        p, q = injections(self.site, data.for_service(dispatch.served), dispatch)
        found = None
        for bus, island in sorted(
            {*zip(physics.reference.tolist(), data.dark.tolist(), strict=True)}
        ):
            if (bus, island, b"") not in self._sweeps:
                now = network.islanded if island else network
                self._sweeps[bus, island, b""] = Sweeps(now, bus)
            part = self._sweeps[bus, island, b""].solve(p, q)
            these = (physics.reference == bus) & (data.dark == island)
            found = part if found is None else found.where(these, part)
        assert found is not None
        return self._in_parts(data, found, p, q)

    def _sweeps_of(self, bus: int, island: bool, buses: Flags, lines: Flags) -> Sweeps:
        """Sweeps from a bus, where nothing draws but these buses and lines, made once."""
        network = self.site.network
        inside = buses.tobytes() + lines.tobytes() if network.draws else b""
        key = bus, island, inside
        if key not in self._sweeps:
            now = network.islanded if island else network
            self._sweeps[key] = Sweeps(now.drawing_inside(buses, lines) if inside else now, bus)
        return self._sweeps[key]

    def _in_parts(
        self, data: WindowData, points: ACPoints, p_kw: Floats, q_kvar: Floats
    ) -> ACPoints:
        """AC points of a window whose steps in which lines are out are solved part by part.

        Nothing outside of a part draws then. Nothing holds a dead part, nor draws in it: its
        voltages are those before the line that is out.
        """
        values = {f.name: np.array(getattr(points, f.name)) for f in fields(points)}
        parts = data.parts
        for t in np.flatnonzero(parts.cut):
            values["converged"][t] = True
            for number in np.unique(parts.of_bus[t]):
                reference = int(parts.reference[t, number])
                if number and reference < 0:
                    continue
                buses = parts.of_bus[t] == number
                lines = buses[1:] & ~parts.lines[t]
                island = bool(data.in_island[t, number])
                sweeps = self._sweeps_of(max(reference, 0), island, buses, lines)
                found = sweeps.solve(*(np.where(buses, kw[[t]], 0.0) for kw in (p_kw, q_kvar)))
                for name, value in values.items():
                    if name == "converged":
                        value[t] &= found.converged[0]
                    elif number == 0:
                        value[t] = getattr(found, name)[0]
                    else:
                        inside = buses if name == "v_pu" else lines
                        value[t, inside] = getattr(found, name)[0, inside]
        return ACPoints(**values)

    def agrees(self, data: WindowData, dispatch: Dispatch, points: ACPoints) -> bool:
        """Whether voltages, losses and what the network draws agree in every step with power."""
        lit = lit_steps(data)
        off_pu = np.abs(dispatch.v_pu - points.v_pu)[lit].max()
        missing_kw = points.loss_kw.sum(axis=1) - data.loss_kw
        if (self._short_kw(data, points)[lit] > SHORT_KW).any():
            return False
        off_kw = np.abs(missing_kw)[lit].max()
        if data.drawn:
            found = drawn_at(self.site.network, points.v_pu[lit], data.in_island[lit])
            found = found.at(~data.parts.dead[lit])
            off = [found.kw - data.drawn.kw[lit], found.kvar - data.drawn.kvar[lit]]
            off_kw = off_kw + max(np.abs(each.sum(axis=1)).max() for each in off)
        return bool(off_pu <= VOLTAGE_TOLERANCE_PU and off_kw <= LOSS_TOLERANCE_KW)

    def _short_kw(self, data: WindowData, points: ACPoints) -> Floats:
        """Losses that the plans of island parts lack, (W, N) by the number of the part."""
        of_bus = data.parts.of_bus
        missing_kw = (points.loss_kw - data.physics.loss_kw) * data.in_island[:, 1:]
        found = np.zeros(of_bus.shape)
        steps = np.broadcast_to(np.arange(data.n_steps)[:, None], missing_kw.shape)
        np.add.at(found, (steps, of_bus[:, 1:]), missing_kw)
        return found

    def closer(
        self, data: WindowData, dispatch: Dispatch, points: ACPoints, passes: int
    ) -> WindowData:
        """The window linearised at AC points."""
        return linearised(data, self.site.network, points)

    def finished(self, data: WindowData, dispatch: Dispatch) -> Dispatch:
        """The plan, whose voltages are columns of its problem."""
        return dispatch


def _rows(data: WindowData) -> tuple[Floats, ...]:
    """Linearisation of each step: offset and losses of each line, and the draw of each bus."""
    physics = data.physics
    drawn = (data.drawn.kw, data.drawn.kvar) if data.drawn else ()
    return data.delta_pu2, physics.loss_kw, physics.loss_kvar, *drawn

"""The cheapest dispatch of a supply schedule in the network, within the true discs."""

from __future__ import annotations

from dataclasses import replace

import highspy
import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Flags, Wholes
from vppres.model.data import WindowData
from vppres.model.parts import at_items
from vppres.model.site import Site
from vppres.model.violations import POWER_TOLERANCE_REL
from vppres.solve.cache import ModelCache
from vppres.solve.deadline import HALF, Deadline, Stopwatch
from vppres.solve.netting import net_modes
from vppres.solve.network.program import NetworkProgram
from vppres.solve.programs import SOLVED, ProgramSolution
from vppres.solve.result import Outcome, Status

EXACT_DISC = HALF * POWER_TOLERANCE_REL
"""The same in a dispatch: half of what its check allows."""


RESTING_SHARE = 1e-3
"""Power up to which a battery counts as resting, as a share of the largest that it gives."""

BOTH_WAYS_KW = 1e-4
"""Import and export of the same step above which a dispatch goes on one way in each step."""


class CheapestDispatch:
    """Finds the cheapest dispatch of supply schedules of a window without rules.

    Limits that are found here are not added to those of the ``network``.
    """

    def __init__(self, site: Site, data: WindowData, network: NetworkProgram) -> None:
        self.site = site
        self.data = data
        self.network = network.apart()
        self.model = network.model

    @classmethod
    def of_set(cls, cache: ModelCache, data: WindowData, served: Flags) -> CheapestDispatch:
        """For a schedule that meets the rules of a window, with the demand that it brings about."""
        data = replace(data.for_service(served), switching=None)
        return cls(cache.site, data, NetworkProgram(cache, data))

    def of(
        self,
        served: Flags,
        deadline: Deadline,
        charges: Flags | None = None,
        kept: Dispatch | None = None,
    ) -> tuple[Outcome, Dispatch | None]:
        """Cheapest dispatch of a supply schedule, within the discs.

        Those of ``charges``, (W, B), charge and others discharge where batteries waste energy; if
        a plan's turns are ``kept``, all batteries take these everywhere.
        """
        watch = Stopwatch()
        program = self.network.of_set(served)
        solver = self.network.loaded(program)
        if kept is not None:
            self._hold(solver, self._out_of_turn(kept), 0.0)
        found = self.network.until_carried(solver, deadline, EXACT_DISC)
        done = found.status == Status.OPTIMAL
        unused = self._unused(found, served, charges) if done else np.arange(0)
        if len(unused):
            self._hold(solver, unused, 0.0)
            turned = self.network.until_carried(solver, deadline, EXACT_DISC)
            # With phases, a window without an answer in these turns may have one in others.
            if not self.data.phased or turned.status == Status.OPTIMAL:
                found = turned
        return found.outcome(watch.spent_s), self._dispatch(found, served)

    def _dispatch(self, found: ProgramSolution, served: Flags) -> Dispatch | None:
        """A solution as a dispatch of a set.

        Of a large window whose time ran out it is the last one, made to meet the discs.
        """
        if found.status == Status.OPTIMAL:
            return self.model.dispatch(self.network.columns(found), served)
        last = self.network.unfinished if self.network.is_large else None
        columns = None if last is None else self.model.clipped(last, SOLVED)
        return None if columns is None else self.model.dispatch(columns, served)

    def _hold(self, solver: highspy.Highs, columns: Wholes, value: float) -> None:
        """Hold columns of a solver at a value."""
        held = np.full(columns.size, value)
        solver.changeColsBounds(len(held), columns.ravel().astype(np.int32), held, held)

    def _unused(self, answer: ProgramSolution, served: Flags, charges: Flags | None) -> Wholes:
        """Columns to be left unused where a solution goes two ways at once: the lesser of each two.

        Import and export, where it has both in a step; charging and discharging of a large window,
        or one with phases, where they waste more than a battery could store, if it is not known
        which charge. In others modes are decided by binaries.
        """
        at = self.model.at
        exported = answer.x[at("P_out")].reshape(self.data.n_steps, -1).sum(axis=1)
        imported, exported = np.maximum(answer.x[at("P_grid")], 0.0), np.maximum(exported, 0.0)
        unused = []
        if (np.minimum(imported, exported) > BOTH_WAYS_KW).any():
            unused += [at("P_out")[imported >= exported], at("P_grid")[imported < exported]]
        in_turns = self.network.is_large or self.data.phased
        if in_turns:
            dispatch = self.model.dispatch(self.network.columns(answer), served)
            _, storable = net_modes(self.site, self.data, dispatch)
            if charges is None:
                charges = answer.x[at("P_ch")] >= answer.x[at("P_dch")]
            unused += [] if storable else [at("P_dch")[charges], at("P_ch")[~charges]]
        return np.concatenate([np.arange(0), *(columns.ravel() for columns in unused)])

    def _out_of_turn(self, plan: Dispatch) -> Wholes:
        """Columns that a plan's turns leave unused.

        Batteries that rest beside the grid go on resting: in hours of the same price it is all the
        same which of them discharge when, and each plan would choose anew.
        """
        b, at = self.site.batteries, self.model.at
        given_kw = plan.discharge_kw - plan.charge_kw
        rests = np.abs(given_kw) <= RESTING_SHARE * b.p_max_kw
        rests &= at_items(self.data.with_grid, self.site.battery_bus)
        unused = at("P_dch")[rests | (given_kw < 0.0)], at("P_ch")[rests | (given_kw >= 0.0)]
        return np.concatenate(unused)

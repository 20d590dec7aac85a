"""The cheapest dispatch of a served set in the network, within the true discs."""

from __future__ import annotations

from dataclasses import dataclass, replace

import highspy
import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Flags, Floats, Wholes
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.solve.deadline import Deadline, Stopwatch
from vppres.solve.dispatch import net_modes
from vppres.solve.network.program import DISC, VOLTAGE_PU2, NetworkProgram
from vppres.solve.network.rows import Rows
from vppres.solve.programs import Program, ProgramSolution
from vppres.solve.result import Outcome, Status

EXACT_DISC = 5e-6
"""The same in a dispatch, whose discs are checked."""


INSIDE = (3e-4, 0.0)
"""Shares by which a dispatch's tangents are tried to lie within the discs: with the first few
solutions leave them, the second is for sets that need all of the inverters."""


LARGE_INSIDE = (DISC, *INSIDE)
"""The same in large windows: the further inside, the fewer tangents."""


WASTED_KW = 1e-3
"""PV power of a dispatch, summed over its steps, that may be lost before it gets a price."""


BOTH_WAYS_KW = 1e-4
"""Import and export of the same step above which a dispatch goes on one way in each step."""


SUN_OVER_PRICE = 10.0
"""By how many times the highest price a kW of PV power is worth more than import in a dispatch."""


PRIMAL, DUAL = 4, 1
"""HiGHS's ways of simplex steps."""


@dataclass(frozen=True, eq=False)
class Within:
    """An optimum within the discs, the share by which its tangents lie inside, and its solver."""

    answer: ProgramSolution
    inside: float
    solver: highspy.Highs
    limits: list[Rows]

    @property
    def is_optimal(self) -> bool:
        """Whether there is one."""
        return self.answer.status == Status.OPTIMAL


class CheapestDispatch:
    """Finds the cheapest dispatch of served sets of a window without rules.

    Parameters
    ----------
    site : Site
        Fixed data.
    data : WindowData
        The window.
    network : NetworkProgram
        Its problem, with the limits that are known.
    near : HighsBasis, optional
        Basis of a solution with these limits that serves such a set: few primal steps lead from it
        to the cheapest dispatch.
    """

    def __init__(
        self,
        site: Site,
        data: WindowData,
        network: NetworkProgram,
        near: highspy.HighsBasis | None = None,
    ) -> None:
        self.site = site
        self.data = data
        self.network = network
        self.model = network.model
        self.near = near

    def of(
        self, served: Flags, deadline: Deadline, shares: tuple[float, ...] = ()
    ) -> tuple[Outcome, Dispatch | None]:
        """Cheapest dispatch of a served set, within the discs.

        Tangents are put well within the discs first, which ends sooner, or else at them, unless
        other shares are given.
        """
        watch = Stopwatch()
        self.network.unfinished = None
        program = self.network.of_set(served)
        sun = self.model.at["P_exp"]
        if self.network.is_large:
            program.cost[sun] -= self._worth_of_sun
        shares = shares or (LARGE_INSIDE if self.network.is_large else INSIDE)
        found = self._within_discs(program, deadline, shares)
        if not self.network.is_large and found.is_optimal and self._wastes(found.answer, served):
            program.cost[sun] -= self._worth_of_sun
            keeping = self._within_discs(program, deadline, shares)
            found = keeping if keeping.is_optimal else found
        found = self._one_way(found, served, deadline)
        return found.answer.outcome(watch.spent_s), self._dispatch(found, served)

    def _by_primal_steps(
        self, solver: highspy.Highs, begin: highspy.HighsBasis | None, deadline: Deadline
    ) -> None:
        """Solve by primal steps from a basis; dual ones go on from there where limits follow."""
        if begin is not None:
            solver.setBasis(begin)
        solver.setOptionValue("simplex_strategy", PRIMAL)
        ProgramSolution.of(solver, deadline)
        solver.setOptionValue("simplex_strategy", DUAL)

    def _dispatch(self, found: Within, served: Flags) -> Dispatch | None:
        """A solution as a dispatch of a set, or what is left of one whose time ran out."""
        columns = self.network.columns(found.answer) if found.is_optimal else self._clipped()
        return None if columns is None else self.model.dispatch(columns, served)

    def _within_discs(
        self, program: Program, deadline: Deadline, shares: tuple[float, ...]
    ) -> Within:
        """The optimum of a set's program within the discs, by one share after the other."""
        known = self.network.found
        self.network.found = list(known)
        solver = self.network.loaded(program)
        if self.near is not None:
            self._by_primal_steps(solver, self.near, deadline)
        for inside in shares:
            self.network.let_out(solver, inside)
            answer = self.network.until_carried(solver, deadline, EXACT_DISC, inside)
            stricter = len(self.network.found) > len(known)
            if answer.status == Status.OPTIMAL or not stricter:
                break
        within = self.network.found
        self.network.found = known  # tangents within the discs hold for no other problem
        return Within(answer, inside, solver, within)

    def _go_on(self, found: Within, deadline: Deadline) -> Within:
        """The optimum of a problem that was changed, from the solution that its solver has."""
        known = self.network.found
        self.network.found = found.limits
        answer = self.network.until_carried(found.solver, deadline, EXACT_DISC, found.inside)
        self.network.found = known
        return replace(found, answer=answer)

    def _hold(self, solver: highspy.Highs, columns: Wholes, value: float) -> None:
        """Hold columns of a solver at a value."""
        held = np.full(columns.size, value)
        solver.changeColsBounds(len(held), columns.ravel().astype(np.int32), held, held)

    def _wastes(self, answer: ProgramSolution, served: Flags) -> bool:
        """Whether a solution loses PV power that its inverters could pass on.

        Where that has no price, any dispatch of a set is the cheapest.
        """
        own_kw = self.model.usual.own_kw * served[:, self.site.owner]
        room_kw = np.minimum(self.data.pv_kw, self.site.pv.s_max_kva) - own_kw
        return bool((room_kw - answer.x[self.model.at["P_exp"]]).sum() > WASTED_KW)

    def _clipped(self) -> Floats | None:
        """Of a large window whose time ran out, the last solution made to meet the discs."""
        last = self.network.unfinished if self.network.is_large else None
        return None if last is None else self.model.clipped(last, VOLTAGE_PU2)

    @property
    def _worth_of_sun(self) -> float:
        """What a kW of PV power is worth in a dispatch, in GBP: more than any saving by losing it.

        Without it, any dispatch would be the cheapest where nothing has a price.
        """
        return float(
            self.site.dt_h * (1.0 + SUN_OVER_PRICE * np.abs(self.model.price[1]).max(initial=0.0))
        )

    def _one_way(self, found: Within, served: Flags, deadline: Deadline) -> Within:
        """The optimum without what goes two ways at once, if anything does."""
        unused = self._unused(found.answer, served) if found.is_optimal else np.arange(0)
        if not len(unused):
            return found
        self._hold(found.solver, unused, 0.0)
        return self._go_on(found, deadline)

    def _unused(self, answer: ProgramSolution, served: Flags) -> Wholes:
        """Columns to be left unused where a solution goes two ways at once: the lesser of each two.

        Import and export, where it has both in a step; charging and discharging of a large window,
        where they waste more than a battery could store. In others modes are decided by binaries.
        """
        at = self.model.at
        imported, exported = self.model.exchange_kw(answer.x)
        unused = []
        if (np.minimum(imported, exported) > BOTH_WAYS_KW).any():
            unused += [at["P_out"][imported >= exported], at["P_grid"][imported < exported]]
        if self.network.is_large and not self._storable(answer, served):
            charges = answer.x[at["P_ch"]] >= answer.x[at["P_dch"]]
            unused += [at["P_dch"][charges], at["P_ch"][~charges]]
        return np.concatenate([np.arange(0), *(columns.ravel() for columns in unused)])

    def _storable(self, answer: ProgramSolution, served: Flags) -> bool:
        """Whether batteries can store what a solution charges less what it discharges."""
        dispatch = self.model.dispatch(self.network.columns(answer), served)
        return net_modes(self.site, self.data, dispatch)[1]

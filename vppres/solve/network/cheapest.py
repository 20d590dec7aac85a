"""The cheapest dispatch of a served set in the network, within the true discs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import highspy
import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Flags, Floats
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.solve.deadline import Deadline, Stopwatch
from vppres.solve.network.program import DISC, VOLTAGE_PU2, NetworkProgram
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
"""Import and export of the same step above which a dispatch is made anew, one way in each step."""


SUN_OVER_PRICE = 10.0
"""By how many times the highest price a kW of PV power is worth more than import in a dispatch."""


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
    near : callable
        Basis of the most service, from which the way to a dispatch of a large window is short.
    """

    def __init__(
        self,
        site: Site,
        data: WindowData,
        network: NetworkProgram,
        near: Callable[[], highspy.HighsBasis],
    ) -> None:
        self.site = site
        self.data = data
        self.network = network
        self.model = network.model
        self.near = near

    def of(
        self, served: Flags, deadline: Deadline, quickly: bool = False
    ) -> tuple[Outcome, Dispatch | None]:
        """Cheapest dispatch of a served set, within the discs.

        Tangents are put well within the discs first, which ends sooner, or else at them: not where
        it is looked for quickly.
        """
        watch = Stopwatch()
        self.network.unfinished = None
        program = self.network.of_set(served)
        sun = self.model.at["P_exp"]
        if self.network.is_large:
            program.cost[sun] -= self._worth_of_sun
        shares = LARGE_INSIDE if self.network.is_large else INSIDE
        answer, inside = self._within_discs(program, deadline, shares[:1] if quickly else shares)
        if (
            not self.network.is_large
            and answer.status == Status.OPTIMAL
            and self._wastes(answer, served)
        ):
            program.cost[sun] -= self._worth_of_sun
            keeping = self._within_discs(program, deadline, shares)
            answer, inside = keeping if keeping[0].status == Status.OPTIMAL else (answer, inside)
        if answer.status == Status.OPTIMAL and self._both_ways(answer).any():
            answer = self._one_way(program, answer, deadline, inside)
        done = answer.status == Status.OPTIMAL
        columns = self.network.columns(answer) if done else self._clipped()
        dispatch = None if columns is None else self.model.dispatch(columns, served)
        return answer.outcome(watch.spent_s), dispatch

    def _within_discs(
        self, program: Program, deadline: Deadline, shares: tuple[float, ...]
    ) -> tuple[ProgramSolution, float]:
        """The optimum of a set's program within the discs, and by which share it lies inside.

        In a large window limits that the search for the set has found are left behind where the
        way begins anew: few of them bind, and they are found again.
        """
        known = self.network.found
        anew = self.network.is_large and self._import_has_a_price
        limits = [] if anew else known
        begin = None
        for inside in shares:
            self.network.found = list(limits)
            solver = self.network.loaded(program)
            if self.network.is_large:
                begin = self._begun(solver, begin, deadline)
            answer = self.network.until_carried(solver, deadline, EXACT_DISC, inside)
            stricter = len(self.network.found) > len(limits)
            self.network.found = known  # tangents within the discs hold for no other problem
            if answer.status == Status.OPTIMAL or not stricter:
                break
        return answer, inside

    @property
    def _import_has_a_price(self) -> bool:
        """Whether import that is possible costs anything."""
        columns, price = self.model.price
        return bool((price * self.network.program.x_upper[columns]).any())

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

    def _begun(
        self, solver: highspy.Highs, begin: highspy.HighsBasis | None, deadline: Deadline
    ) -> highspy.HighsBasis:
        """Let a solver of a set's cost begin at a basis, or find the one without tangents.

        Where nothing costs anything, that of the service is near. Where import has its price, it
        is far, and the way back takes longer than one from the start.
        """
        if begin is not None:
            solver.setBasis(begin)
            return begin
        basis = None if self._import_has_a_price else self.near()
        if basis is None or not basis.valid:
            self.network.start(solver)
        else:
            added = solver.getNumRow() - len(basis.row_status)
            basic = highspy.HighsBasisStatus.kBasic
            basis.row_status = [*basis.row_status, *[basic] * added]
            solver.setBasis(basis)
        ProgramSolution.of(solver, deadline)
        found: highspy.HighsBasis = solver.getBasis()
        return found

    def _both_ways(self, answer: ProgramSolution) -> Flags:
        """Steps in which a solution imports and exports, (W,)."""
        return np.minimum(*self.model.exchange_kw(answer.x)) > BOTH_WAYS_KW

    def _one_way(
        self, program: Program, answer: ProgramSolution, deadline: Deadline, inside: float
    ) -> ProgramSolution:
        """The cheapest dispatch that imports or exports, as a solution does on balance."""
        at = self.model.at
        imported, exported = self.model.exchange_kw(answer.x)
        one_way = replace(program, x_upper=program.x_upper.copy())
        one_way.x_upper[at["P_out"][imported >= exported]] = 0.0
        one_way.x_upper[at["P_grid"][imported < exported]] = 0.0
        known = self.network.found
        self.network.found = list(known)
        found = self.network.until_carried(
            self.network.loaded(one_way), deadline, EXACT_DISC, inside
        )
        self.network.found = known
        return found

"""Operations of switches that are proposed to an operator; plans are of the feeder as it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vppres.contract.decision import Decision
from vppres.contract.observation import Observation
from vppres.control.operations import Operations
from vppres.control.search import Search
from vppres.control.switching import Switching


class Proposing(Switching):
    """Decides in the configuration that is observed, and proposes what would serve more.

    Operations begin after its decision is carried out, with all faults of the step there.
    """

    def taken(self, search: Search, t0: int) -> Decision:
        """The decision in the present configuration, with the operations that are proposed."""
        found, decision = search.best, search.stay.decision
        if found is search.stay:
            return replace(search.certified(), switched=search.record)
        closed = None if found.waits else found.candidate.closed
        proposed = replace(search.reasoned(), proposed=closed, order=found.order)
        return replace(decision, switched=proposed)

    def operations(self, observation: Observation) -> Operations:
        """Operations that begin as the decision leaves the feeder."""
        out = observation.forecast.out.part(slice(1))
        here = self.controller_in(self.closed)
        dead = here.day.at_buses(self.state_in(here, observation).now.parts.dead[0])
        return Operations(self, observation, out, out, ~np.asarray(dead), self.within)

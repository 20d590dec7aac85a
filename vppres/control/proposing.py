"""Operations of switches that are proposed to an operator; plans are of the feeder as it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vppres.contract.decision import Decision
from vppres.contract.observation import Observation
from vppres.control.switching import Begin, Search, Switching


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
        proposed = replace(self.reasoned(search), proposed=closed, order=found.order)
        return replace(decision, switched=proposed)

    def begin(self, observation: Observation, stay: Decision) -> Begin:
        """State in which the decision leaves the feeder."""
        here = self.controller_in(self.closed)
        dead = here.day.at_buses(self.step_state(here, observation).parts.dead[0])
        out = observation.forecast.out.part(slice(1))
        return Begin(out, out, ~np.asarray(dead))

"""Operations of switches that a plan proposes."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from vppres.contract.decision import Switched
from vppres.day.recorder import StepRecord
from vppres.day.trajectory import SWITCHING_AHEAD, SWITCHING_WHY
from vppres.scenario.configuration import Branches


@dataclass(frozen=True)
class Proposal:
    """Switches to move, for an operator to decide on; empty where none would serve more."""

    #: States of the switches that are to move now, by name; empty where it is for later.
    closed: dict[str, bool] = field(default_factory=dict)
    operations: str = ""  #: operations in words, those of lines without a switch among them
    order: tuple[str, ...] = ()  #: one after another, each with the least margin after it
    why: str = ""  #: what they serve, or why no switch is to move
    gain: float = 0.0  #: their worth over the window, in weighted customer hours

    @classmethod
    def of(cls, branches: Branches, switched: Switched | None, record: StepRecord) -> Proposal:
        """The proposal of a decision with its record; empty where switches are not decided on."""
        if switched is None:
            return cls()
        target = switched.closed if switched.proposed is None else switched.proposed
        now, then = branches.states(switched.closed), branches.states(target)
        return cls(
            {name: state for name, state in then.items() if state != now[name]},
            str(record.steps[SWITCHING_AHEAD]),
            switched.order,
            str(record.steps[SWITCHING_WHY]),
            float(np.nan_to_num(switched.gain)),
        )

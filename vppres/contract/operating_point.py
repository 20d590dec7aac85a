"""An AC operating point, around which the next window is linearised."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from vppres.core.arrays import Flags, Floats

Centre = Literal["lossless", "literal", "none"]


@dataclass(frozen=True, eq=False)
class OperatingPoint:
    """An AC solution: voltages, sending-end flows, and the net injections that caused it."""

    v_pu: Floats  #: voltage magnitudes, (N,)
    #: Sending-end flows, losses included, (L,).
    p_flow_kw: Floats
    q_flow_kvar: Floats
    #: Net injections of all buses but the slack bus's supply, (N,).
    p_injection_kw: Floats
    q_injection_kvar: Floats
    island: bool = False  #: whether the feeder was an island: some shunts are switched off there
    #: Lines that were out, (L,); voltages are NaN where nothing held them.
    lines_out: Flags = field(kw_only=True)

"""An AC operating point, around which the next window is linearised."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from vppres.core.arrays import Flags, Floats

Centre = Literal["lossless", "literal", "none"]


@dataclass(frozen=True, eq=False)
class OperatingPoint:
    """An AC solution: voltages, sending-end flows, and the net injections that caused it.

    Parameters
    ----------
    v_pu : array, shape (N,)
        Voltage magnitudes.
    p_flow_kw, q_flow_kvar : array, shape (L,)
        Sending-end flows, losses included.
    p_injection_kw, q_injection_kvar : array, shape (N,)
        Net injections of all buses but the slack bus's supply.
    island : bool, optional
        Whether the feeder was an island: some shunts are switched off there.
    lines_out : array of bool, shape (L,)
        Lines that were out; voltages are NaN where nothing held them.
    """

    v_pu: Floats
    p_flow_kw: Floats
    q_flow_kvar: Floats
    p_injection_kw: Floats
    q_injection_kvar: Floats
    island: bool = False
    lines_out: Flags = field(kw_only=True)

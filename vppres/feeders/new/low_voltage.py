"""Voltage limits of low-voltage feeders: those of the country, where its clocks tell it."""

from __future__ import annotations

from dataclasses import dataclass

from vppres.scenario.network import LOW_VOLTAGE_KV, Network

MARGIN_PU = round(Network.v_min_pu - Network.v_min_ac_pu, 6)
"""By how much limits of plans are tighter than those of the AC voltages."""


@dataclass(frozen=True)
class VoltageLimits:
    """Limits of the AC voltages in pu, and where they come from; plans keep a margin to them."""

    v_min_ac_pu: float
    v_max_ac_pu: float
    origin: str

    @property
    def v_min_pu(self) -> float:
        """Lowest voltage of plans."""
        return round(self.v_min_ac_pu + MARGIN_PU, 6)

    @property
    def v_max_pu(self) -> float:
        """Highest voltage of plans."""
        return round(self.v_max_ac_pu - MARGIN_PU, 6)


OWN = VoltageLimits(Network.v_min_ac_pu, Network.v_max_ac_pu, "")
EUROPE = VoltageLimits(0.90, 1.10, "EN 50160: 10% below and above the nominal voltage")
GREAT_BRITAIN = VoltageLimits(
    0.94,
    1.10,
    "Great Britain: 6% below and 10% above 230 V, regulation 27 of the Electricity Safety, Quality "
    "and Continuity Regulations 2002",
)
BRITISH_ZONES = ("Europe/London", "GB")


def limits_of(network: Network, zone: str | None) -> VoltageLimits:
    """Limits of a feeder by its nominal voltage, and the zone of its clocks.

    Examples
    --------
    >>> lane = Network([1], [2], [0.1], [0.1], slack_bus=1, base_kv=0.4)
    >>> limits_of(lane, "Europe/London").v_min_ac_pu, limits_of(lane, None).v_min_ac_pu
    (0.94, 0.9)
    """
    if network.base_kv > LOW_VOLTAGE_KV:
        return OWN
    return GREAT_BRITAIN if zone in BRITISH_ZONES else EUROPE

"""An island as it really is: batteries that form its grid, what they cannot carry, and darkness.

The set of grid-forming batteries holds the voltage and takes up what generation and demand differ
by, losses included, in proportion to its ratings. What is beyond the set is cut off by rules that
need no communication: surplus PV power is curtailed, customers are shed from the least important
tier upwards. Where no battery of the set is able, the island is dark.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vppres.core.arrays import Flags, Floats
from vppres.core.errors import VerificationError
from vppres.physics.powerflow import (
    ACPowerFlow,
    ACResult,
    NoSolutionError,
    NotFoundError,
)
from vppres.plant.plant import NOBODY, BatteryState, Plant, Powers, Realised
from vppres.scenario.scenario import Scenario

BALANCE_TOLERANCE_KW = 1e-6
"""Largest power that the source of the power flow may still give once the set has shared it; more
only where the power flow itself is less exact (``ACPowerFlow.tolerance_kva``)."""

COLLAPSE_PU = 0.7
"""A voltage below which motors stall and inverters trip: the island is dark."""

CUT_MARGIN_KW = 1e-3
"""What is cut beyond the need, so that the set has something left to settle with."""

TAKE_LESS = ("thermal_loads", "chargers")
"""Kinds that take less where an island lacks power, in this order: before batteries and customers.
"""

_MAX_SHARINGS = 50
NO_FORMER = "no battery forms the grid"
NO_ENERGY = "no grid-forming battery has energy left"
NO_SOLUTION = "the lines cannot carry the power: no AC solution"
COLLAPSE = f"a voltage fell below {COLLAPSE_PU} pu"
NO_BALANCE = "the grid-forming batteries cannot balance the island"


@dataclass(frozen=True, eq=False)
class Settled:
    """One step of an island once everything has settled.

    Parameters
    ----------
    realised : Realised
        What really happened; nobody is served in the dark.
    ac : ACResult
        AC power flow with exactly zero import; voltages are NaN in the dark.
    mismatch_kw : array, shape (B,)
        What each battery gave beyond its set-point (negative: took).
    shed : array of bool, shape (C,)
        Who was to be served and was cut off.
    dark_reason : str
        Why the island is dark, empty if it is not.
    ac_failed : str
        What was shed because the AC power flow had no solution, and why; that nobody was, because
        it was only not found; empty if it was.
    """

    realised: Realised
    ac: ACResult
    mismatch_kw: Floats
    shed: Flags
    dark_reason: str = ""
    ac_failed: str = ""

    @property
    def dark(self) -> bool:
        """Whether nobody formed the grid."""
        return self.dark_reason != ""


@dataclass(frozen=True, eq=False)
class Balance:
    """Powers with the mismatch shared, and what the set could not carry: deficits are positive.

    ``not_found`` says why ``ac`` is only the best answer; the mismatch is then that without losses.
    """

    powers: Powers
    ac: ACResult
    left_kw: float
    excess_kvar: float
    not_found: str = ""


class IslandPlant:
    """What happens in an island's step.

    Parameters
    ----------
    plant : Plant
        The actual day.
    flow : ACPowerFlow
        Power flow of its network.
    """

    def __init__(self, plant: Plant, flow: ACPowerFlow) -> None:
        self.plant = plant
        self.flow = flow
        self.formers = plant.scenario.batteries.formers
        self.tolerance_kw = max(BALANCE_TOLERANCE_KW, flow.tolerance_kva)

    def settle(self, t: int, planned: Realised, state: BatteryState) -> Settled:
        """Share the mismatch of step ``t``, cut what the set cannot carry, or go dark.

        Parameters
        ----------
        t : int
            The step.
        planned : Realised
            Set-points as far as the devices can follow them.
        state : BatteryState
            State before the step.
        """
        _, most_discharge = self.plant.battery_limits_kw(state)
        able = self.formers & (most_discharge > BALANCE_TOLERANCE_KW)
        if not able.any():
            reason = NO_ENERGY if self.formers.any() else NO_FORMER
            return self._dark(t, planned, state, reason)
        set_points = powers = powers_of(planned)
        # Every round sheds, stops or curtails something, so this is more than can be needed.
        devices = len(planned.served) + len(planned.pv_self_kw)
        devices += sum(len(taken_kw) for taken_kw in planned.taken_kw.values())
        for _ in range(2 * devices + 20):
            try:
                found = self._balance(t, powers, state, able)
            except NoSolutionError:
                return self._dark(t, planned, state, NO_SOLUTION)
            except VerificationError:
                break
            if not found.not_found and found.ac.v_pu.min() < COLLAPSE_PU:
                return self._dark(t, planned, state, COLLAPSE)
            if abs(found.left_kw) <= self.tolerance_kw and found.excess_kvar <= 0.0:
                realised = self.plant.realise(t, found.powers, state, planned.clipped_kw)
                gave = np.where(able, set_points.battery_kw - found.powers.battery_kw, 0.0)
                return Settled(
                    realised,
                    found.ac,
                    gave,
                    planned.served & ~realised.served,
                    ac_failed=found.not_found,
                )
            cut = self._cut(t, powers, found)
            if cut is None:
                break
            powers = cut
        return self._dark(t, planned, state, NO_BALANCE)

    def _balance(self, t: int, powers: Powers, state: BatteryState, able: Flags) -> Balance:
        """Solve, share what the source gave among the set, and solve again until it gives nothing.

        The battery with the largest inverter is the reference: all reactive mismatch is its own.
        """
        b = self.plant.scenario.batteries
        reference = int(np.argmax(np.where(able, b.s_max_kva, -1.0)))
        bus = int(self.plant.battery_bus[reference])
        batt_q = powers.batt_q_kvar.copy()
        deficit_kw = 0.0
        for _ in range(_MAX_SHARINGS):
            shared, left_kw = self._share(powers, state, able, batt_q, deficit_kw)
            realised = self.plant.realise(t, shared, state)
            try:
                ac = self.flow.solve(realised.p_injection_kw, realised.q_injection_kvar, bus)
            except NotFoundError as error:
                # Nothing shows that the lines cannot carry it: what is known is the balance.
                deficit_kw += left_kw - float(realised.p_injection_kw.sum())
                shared, left_kw = self._share(powers, state, able, batt_q, deficit_kw)
                return Balance(shared, error.best, left_kw, 0.0, f"{NOBODY} shed: {error}")
            change_kw = ac.p_slack_kw - left_kw
            change_kvar = ac.q_slack_kvar
            if max(abs(change_kw), abs(change_kvar)) <= self.tolerance_kw:
                return Balance(shared, ac, left_kw, self._excess_kva(reference, batt_q, ac))
            deficit_kw += change_kw
            batt_q = batt_q.copy()
            batt_q[reference] += change_kvar
        raise VerificationError("the sharing of the mismatch does not converge")

    def _excess_kva(self, reference: int, batt_q_kvar: Floats, ac: ACResult) -> float:
        """By how much the battery that holds the island is beyond its rating."""
        rating = self.plant.scenario.batteries.s_max_kva[reference]
        return float(abs(batt_q_kvar[reference]) - rating)

    def _order(self, t: int, powers: Powers, ac: ACResult) -> list[int]:
        """Customers that are on in the order in which they are shed."""
        return [c for c in shedding_order(self.plant.scenario, t) if powers.served[c]]

    def _share(
        self, powers: Powers, state: BatteryState, able: Flags, batt_q: Floats, deficit_kw: float
    ) -> tuple[Powers, float]:
        """A deficit shared among the set, and what the set cannot take of it."""
        b = self.plant.scenario.batteries
        most_charge, most_discharge = self.plant.battery_limits_kw(state)
        disc_kw = np.sqrt(np.maximum(b.s_max_kva**2 - batt_q**2, 0.0))
        lowest = -np.minimum(most_discharge, disc_kw)
        highest = np.minimum(most_charge, disc_kw)
        base_kw = np.clip(powers.battery_kw, lowest, highest)
        room = base_kw - lowest if deficit_kw > 0 else highest - base_kw
        given = np.copysign(
            share_out(abs(deficit_kw), np.where(able, room, 0.0), b.s_max_kva), deficit_kw
        )
        shared = replace(powers, battery_kw=base_kw - given, batt_q_kvar=batt_q)
        return shared, float(deficit_kw - given.sum())

    def _cut(self, t: int, powers: Powers, found: Balance) -> Powers | None:
        """One more protective action, None if there is none left."""
        need_kw = max(found.left_kw, found.excess_kvar) + CUT_MARGIN_KW
        others = ~self.formers
        if found.left_kw >= -self.tolerance_kw:
            for kind in TAKE_LESS if found.left_kw > self.tolerance_kw else ():
                taken_kw = powers.taken_kw.get(kind, np.zeros(0))
                taking_kw = np.maximum(taken_kw, 0.0)
                if taking_kw.sum() > 0:
                    return taking(powers, kind, taken_kw - part_of(taking_kw, need_kw))
            charging = np.where(others, np.maximum(powers.battery_kw, 0.0), 0.0)
            if found.left_kw > self.tolerance_kw and charging.sum() > 0:
                return replace(powers, battery_kw=powers.battery_kw - part_of(charging, need_kw))
            return self._shed(t, powers, need_kw, found.ac)
        surplus_kw = -found.left_kw + CUT_MARGIN_KW
        for kind, spare_kw in spare(self.plant, powers).items():
            if spare_kw.sum() > self.tolerance_kw:
                return taking(powers, kind, powers.taken_kw[kind] + part_of(spare_kw, surplus_kw))
        if (powers.pv_export_kw + powers.pv_self_kw).sum() > 0:
            return curtailed(powers, surplus_kw)
        discharging = np.where(others, np.maximum(-powers.battery_kw, 0.0), 0.0)
        if discharging.sum() > 0:
            return replace(powers, battery_kw=powers.battery_kw + part_of(discharging, surplus_kw))
        for kind, taken_kw in powers.taken_kw.items():
            if taken_kw.sum() < 0:
                off = np.zeros(len(taken_kw), dtype=bool)
                stopped = replace(powers, running={**powers.running, kind: off})
                return taking(stopped, kind, 0.0 * taken_kw)
        return None

    def _shed(self, t: int, powers: Powers, need_kw: float, ac: ACResult) -> Powers | None:
        """Customers off until the need is met, those whose service is worth least per kW first."""
        load_kw = self.plant.load_kw(t, powers.served) * powers.share
        order = self._order(t, powers, ac)
        if not order:
            return None
        reached = np.cumsum(load_kw[order]) >= need_kw
        count = int(np.argmax(reached)) + 1 if reached.any() else len(order)
        served = powers.served.copy()
        served[order[:count]] = False
        # The PV systems of those who are off feed the island with all they have.
        own = np.where(served[self.plant.owner], powers.pv_self_kw, 0.0)
        return replace(
            powers,
            taken_kw=self.plant.connected_kw(powers.taken_kw, served),
            served=served,
            pv_self_kw=own,
            pv_export_kw=powers.pv_export_kw + powers.pv_self_kw - own,
        )

    def _dark(self, t: int, planned: Realised, state: BatteryState, reason: str) -> Settled:
        """Nobody is served, nothing generates, nothing flows."""
        net = self.plant.scenario.network
        pv = np.zeros(len(planned.pv_self_kw))
        batteries = np.zeros(len(planned.charge_kw))
        off = Powers(
            np.zeros_like(planned.served),
            pv,
            pv,
            self.plant.scenario.pv_kw[t],
            pv,
            batteries,
            batteries,
        )
        lines = np.zeros(net.n_lines)
        ac = ACResult(np.full(net.n_buses, np.nan), lines, lines, lines, lines, 0.0, 0.0, 0.0)
        return Settled(self.plant.realise(t, off, state), ac, batteries, planned.served, reason)


def shedding_order(scenario: Scenario, t: int) -> list[int]:
    """Customers in the order in which they are shed at step ``t``.

    Tier by tier from the least important, within a tier by weight per kW: most kW for the least
    weight first.
    """
    rank = {tier: i for i, tier in enumerate(scenario.tiers)}
    tier = np.array([rank[name] for name in scenario.customers.tier])
    per_kw = scenario.customers.weight / np.maximum(scenario.load_kw[t], 1e-9)
    return [int(c) for c in np.lexsort((per_kw, -tier))]


def share_out(power_kw: float, room_kw: Floats, rating: Floats) -> Floats:
    """Parts of a power in proportion to the ratings; what one cannot take goes to the others.

    >>> share_out(30.0, np.array([5.0, 100.0, 100.0]), np.array([1.0, 1.0, 2.0]))
    array([ 5.        ,  8.33333333, 16.66666667])
    """
    taken = np.zeros(len(room_kw))
    left = power_kw
    free = room_kw > 0
    while left > 1e-12 and free.any():
        part = np.where(free, rating, 0.0)
        step = np.minimum(left * part / part.sum(), room_kw - taken)
        taken += step
        left -= float(step.sum())
        free &= taken < room_kw - 1e-12
    return taken


def powers_of(realised: Realised) -> Powers:
    """The powers of a step that happened."""
    return Powers(
        realised.served,
        realised.pv_self_kw,
        realised.pv_export_kw,
        realised.pv_curtailed_kw,
        realised.pv_q_kvar,
        realised.charge_kw - realised.discharge_kw,
        realised.batt_q_kvar,
        realised.share,
        realised.taken_kw,
        realised.running,
    )


def taking(powers: Powers, kind: str, taken_kw: Floats) -> Powers:
    """The same with the units of a kind taking these powers, (n,)."""
    return replace(powers, taken_kw={**powers.taken_kw, kind: taken_kw})


def spare(plant: Plant, powers: Powers) -> dict[str, Floats]:
    """By how much units can give less without stopping, (n,) by kind; sets come first."""
    return {
        kind: plant.units[kind].spare_kw(powers.taken_kw[kind], powers.running[kind])
        for kind in reversed(plant.units)
    }


def part_of(powers_kw: Floats, need_kw: float) -> Floats:
    """So much of each power, in proportion, that their sum meets the need."""
    return powers_kw * min(1.0, need_kw / float(powers_kw.sum()))


def curtailed(powers: Powers, surplus_kw: float) -> Powers:
    """PV power off until the surplus is gone, exports in proportion first."""
    exports = powers.pv_export_kw if powers.pv_export_kw.sum() > 0 else powers.pv_self_kw
    off = part_of(exports, surplus_kw)
    from_export = off if exports is powers.pv_export_kw else np.zeros_like(off)
    return replace(
        powers,
        pv_export_kw=powers.pv_export_kw - from_export,
        pv_self_kw=powers.pv_self_kw - (off - from_export),
        pv_curtailed_kw=powers.pv_curtailed_kw + off,
    )

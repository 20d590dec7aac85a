"""An island as it really is: what forms its grid, what that cannot carry, and darkness.

The set of grid-forming batteries holds the voltage and takes up what generation and demand differ
by, losses included, in proportion to its ratings. Where no battery of the set is able, or they
cannot hold the island, a grid-forming generating set does. What is beyond that is cut off by rules
that need no communication: surplus PV power is curtailed; what is missing is first given by the
other batteries, then customers are shed from the least important tier upwards. Where nothing is
able, the island blacks out.

On a feeder with phases the former takes what each phase lacks. Where one of its phases is beyond
its part of the rating, the same is done for what is on that phase first
(:mod:`vppres.plant.relief`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vppres.core.arrays import Complexes, Flags, Floats, Names
from vppres.core.errors import VerificationError
from vppres.kinds.gensets.physics import Engines
from vppres.physics.feeder import PowerFlow
from vppres.physics.places import Places
from vppres.physics.powerflow import ACResult, NoSolutionError, NotFoundError
from vppres.plant.changes import (
    CUT_MARGIN_KW,
    TAKE_LESS,
    curtailed,
    forms,
    part_of,
    spare,
    taking,
    taking_less,
)
from vppres.plant.formers import Former, FormingBatteries, FormingSet
from vppres.plant.plant import NOBODY, BatteryState, Plant, Powers, Realised
from vppres.plant.relief import OnPhases
from vppres.scenario.formers import forming_batteries
from vppres.scenario.scenario import Scenario

BALANCE_TOLERANCE_KW = 1e-6
"""Largest power that the source of the power flow may still give once the set has shared it; more
only where the power flow itself is less exact (``tolerance_kva`` of a power flow)."""

COLLAPSE_PU = 0.7
"""A voltage below which motors stall and inverters trip: the island blacks out."""

LITTLE_KW = 2.0 * CUT_MARGIN_KW
"""Mismatch that an island without room for the margin of a cut may keep: two watts."""

_MAX_SHARINGS = 50
NO_FORMER = "no battery forms the grid"
NO_ENERGY = "no grid-forming battery has energy left"
NO_SOLUTION = "the lines cannot carry the power: no AC solution"
COLLAPSE = f"a voltage fell below {COLLAPSE_PU} pu"
NO_BALANCE = "the grid-forming batteries cannot balance the island"
NO_SET = "no grid-forming generating set can run"
SET_NO_BALANCE = "the grid-forming generating set cannot balance the island"


@dataclass(frozen=True, eq=False, kw_only=True)
class Settled(Realised):
    """One step once everything has settled; no customer is supplied in a blackout."""

    ac: ACResult  #: AC power flow with exactly zero import; voltages are NaN in a blackout
    mismatch_kw: Floats  #: what each battery gave beyond its set-point (negative, (B,): took)
    shed: Flags  #: who was to be served and was cut off, (C,)
    dark_reason: str = ""  #: why the island is blacked out, empty if it is not
    #: What was shed because the AC power flow had no solution, and why; that none was, because it
    #: was only not found; empty if it was.
    ac_failed: str = ""
    by_set_kw: float = 0.0  #: what the generating set gave so that forms the grid
    former: str = ""  #: the device that was the source; empty where none was, and with grid
    #: Why the part of each customer is blacked out if lines are out, (C,); empty otherwise.
    off: Names | None = None
    #: What the former of a part gives on each phase if lines are out, (phases,).
    former_kva: Complexes | None = None

    @classmethod
    def of(cls, realised: Realised, **settled: Any) -> Settled:
        """Step as it happened, with what the network and its protection made of it."""
        return cls(**vars(realised), **settled)

    @property
    def dark(self) -> bool:
        """Whether no device formed the grid."""
        return self.dark_reason != ""


@dataclass(frozen=True, eq=False)
class PartOfPlant:
    """Buses, lines, places and devices of a part of the feeder; (n,) of each kind of unit."""

    buses: Flags
    lines: Flags
    places: Flags
    customers: Flags
    pv: Flags
    batteries: Flags
    units: Mapping[str, Flags]

    @classmethod
    def of(cls, places: Places, buses: Flags, lines: Flags) -> PartOfPlant:
        """Devices at these buses, (N,), which lines join, (L,)."""
        inside = buses[places.bus]
        units = {kind: inside[at] for kind, at in places.units.items()}
        customers, pv, batteries = (
            inside[at] for at in (places.customers, places.pv, places.batteries)
        )
        return cls(buses, lines, inside, customers, pv, batteries, units)


@dataclass(frozen=True, eq=False)
class Balance:
    """Powers with the mismatch shared, and what the set could not carry: deficits are positive.

    ``not_found`` says why ``ac`` is only the best answer; the mismatch is then that without losses.
    """

    powers: Powers
    former: Former
    ac: ACResult
    left_kw: float
    excess_kva: float
    not_found: str = ""


class IslandPlant:
    """Plant of an island's step.

    Of a part of the feeder it has the devices ``inside``; ``where`` says in words which part it is.
    """

    def __init__(
        self, plant: Plant, flow: PowerFlow, inside: PartOfPlant | None = None, where: str = ""
    ) -> None:
        self.plant = plant
        self.flow = flow
        self.inside = inside
        self.where = where
        self.formers = forming_batteries(plant.scenario)
        self._on = OnPhases.of(plant, flow)
        self.tolerance_kw = max(BALANCE_TOLERANCE_KW, flow.tolerance_kva)

    def settle(self, t: int, planned: Realised, state: BatteryState) -> Settled:
        """Share the mismatch of step ``t``, cut what the set cannot carry, or go dark.

        ``planned`` are set-points as far as the devices can follow them.
        """
        dark = None
        for former in self._possible_formers(t, planned, state):
            settled = self._with_former(t, planned, state, former)
            if not settled.dark:
                return settled
            dark = dark or settled
        return dark or self.dark(t, planned, state, self._why_dark())

    def _possible_formers(self, t: int, planned: Realised, state: BatteryState) -> Iterator[Former]:
        """Devices able to form the grid: batteries first, then one generating set after another."""
        _, most_discharge = self.plant.batteries_ahead(state).most_kw()
        holds = self.plant.scenario.batteries.holds_energy(state.soc)
        able = self.formers & holds & (most_discharge > BALANCE_TOLERANCE_KW)
        if able.any():
            yield FormingBatteries(self.plant, state, able)
        if "gensets" in planned.running:
            for one in self.plant.of(Engines).able_to_form(t, planned.running["gensets"]):
                if self.inside is None or self.inside.units["gensets"][one]:
                    yield FormingSet(self.plant, t, one)

    def _why_dark(self) -> str:
        """Why nothing forms the grid."""
        sets = self.plant.scenario.gensets.grid_forming
        if (sets if self.inside is None else sets & self.inside.units.get("gensets", sets)).any():
            return NO_SET
        return NO_ENERGY if self.formers.any() else NO_FORMER

    def _with_former(
        self, t: int, planned: Realised, state: BatteryState, former: Former
    ) -> Settled:
        """The step with this former, dark if it cannot hold the island.

        Other batteries discharge beyond their set-points before a customer is shed. What relieves
        one phase may overload another, and then the step without that help is the other choice.
        """
        others = ~former.batteries
        if self.inside is not None:
            others = others & self.inside.batteries
        helped = self._held(t, planned, state, former, others)
        if self._on.n_phases == 1 or not (helped.dark or helped.shed.any()):
            return helped
        alone = self._held(t, planned, state, former, np.zeros_like(others))
        return max(helped, alone, key=self._supplied)

    def _supplied(self, settled: Settled) -> tuple[int, ...]:
        """How many customers of each tier are on, those of the first tier first."""
        s = self.plant.scenario
        on = s.customers.tier[settled.served]
        return (int(not settled.dark), *(int((on == tier).sum()) for tier in s.tiers))

    def _held(
        self, t: int, planned: Realised, state: BatteryState, former: Former, helpers: Flags
    ) -> Settled:
        """The step with this former and the help of some batteries, (B,)."""
        set_points = powers = former.begin(planned)
        # Every round sheds, stops or curtails something, so this is more than can be needed.
        devices = len(planned.served) + len(planned.pv_self_kw)
        devices += sum(len(taken_kw) for taken_kw in planned.taken_kw.values())
        near: Balance | None = None
        for _ in range(2 * devices + 20):
            try:
                found = self._balance(t, powers, state, former)
            except NoSolutionError:
                return self.dark(t, planned, state, NO_SOLUTION)
            except VerificationError:
                break
            if not found.not_found and found.ac.v_pu.min() < COLLAPSE_PU:
                return self.dark(t, planned, state, COLLAPSE)
            if abs(found.left_kw) <= self.tolerance_kw and found.excess_kva <= 0.0:
                return self._settled(t, planned, state, set_points, found)
            if abs(found.left_kw) <= LITTLE_KW and found.excess_kva <= 0.0:
                near = found
            cut = self._protective_action(t, powers, found, state, helpers)
            if cut is None:
                break
            powers = cut
        # A former without room for the margin of a cut has too much and too little by turns.
        if near is not None:
            return self._settled(t, planned, state, set_points, near)
        reason = NO_BALANCE if former.batteries.any() else SET_NO_BALANCE
        return self.dark(t, planned, state, reason)

    def _settled(
        self, t: int, planned: Realised, state: BatteryState, set_points: Powers, found: Balance
    ) -> Settled:
        """The step with a balance that its former carries."""
        former = found.former
        realised = self.plant.realise(t, found.powers, state, planned.clipped_kw)
        gave = set_points.battery_kw - found.powers.battery_kw
        return Settled.of(
            realised,
            ac=found.ac,
            mismatch_kw=np.where(former.batteries, gave, 0.0),
            shed=planned.served & ~realised.served,
            ac_failed=found.not_found,
            by_set_kw=_given_beyond_kw(set_points, found.powers),
            former=former.name,
        )

    def _balance(self, t: int, powers: Powers, state: BatteryState, former: Former) -> Balance:
        """Solve, let the former take up what the source gave, until the source gives nothing."""
        deficit_kw = 0.0
        for _ in range(_MAX_SHARINGS):
            shared, left_kw = former.share(powers, deficit_kw)
            realised = self.plant.realise(t, shared, state)
            try:
                ac = self.flow.solve(
                    realised.p_injection_kw, realised.q_injection_kvar, former.place
                )
            except NotFoundError as error:
                # Nothing shows that the lines cannot carry it: what is known is the balance.
                deficit_kw += left_kw - float(realised.p_injection_kw.sum())
                shared, left_kw = former.share(powers, deficit_kw)
                not_found = f"{NOBODY} shed: {error}"
                return Balance(shared, former, error.best, left_kw, 0.0, not_found)
            change_kw = ac.p_slack_kw - left_kw
            change_kvar = ac.q_slack_kvar
            if max(abs(change_kw), abs(change_kvar)) <= self.tolerance_kw:
                excess_kva = self._excess_kva(former, powers, ac)
                return Balance(shared, former, ac, left_kw, excess_kva)
            deficit_kw += change_kw
            powers = former.feeding(powers, change_kvar)
        raise VerificationError("the sharing of the mismatch does not converge")

    def _excess_kva(self, former: Former, powers: Powers, ac: ACResult) -> float:
        """Power of the island's former beyond its rating.

        What is cut on a phase comes off that phase alone, so its excess counts for all of them.
        What the power flow itself may miss is none.
        """
        own_kva = former.excess_kva(powers)
        of_phases_kva = ac.fullest_kva - former.rating_kva
        if self._on.n_phases == 1 or own_kva > 0.0 or of_phases_kva <= self.tolerance_kw:
            return own_kva
        return of_phases_kva

    def _order(self, t: int, powers: Powers, ac: ACResult) -> list[int]:
        """Customers that are on in the order in which they are shed; those off the phase last."""
        on_phase = self._on.customers[ac.fullest]
        order = [c for c in shedding_order(self.plant.scenario, t) if powers.served[c]]
        return sorted(order, key=lambda c: not on_phase[c])

    def _room_kw(self, powers: Powers, state: BatteryState, helpers: Flags, ac: ACResult) -> Floats:
        """Further discharge that batteries can give as a help, (B,)."""
        _, most_discharge = self.plant.batteries_ahead(state).most_kw()
        s_max_kva = self.plant.scenario.batteries.s_max_kva
        disc_kw = np.sqrt(np.maximum(s_max_kva**2 - powers.batt_q_kvar**2, 0.0))
        room_kw = np.minimum(most_discharge, disc_kw) + np.minimum(powers.battery_kw, 0.0)
        return self._on.room_kw(np.where(helpers, np.maximum(room_kw, 0.0), 0.0), ac)

    def _protective_action(
        self, t: int, powers: Powers, found: Balance, state: BatteryState, helpers: Flags
    ) -> Powers | None:
        """One more protective action, None if there is none left.

        Reactive power beyond the former's rating sheds customers; what others give or take in its
        place would not relieve it. It leaves the former no room to balance what is very little.
        """
        need_kw = max(found.left_kw, found.excess_kva) + CUT_MARGIN_KW
        lack_kw = found.left_kw + CUT_MARGIN_KW
        if self._on.n_phases > 1 and abs(found.left_kw) <= self.tolerance_kw:
            relieved = None
            if found.former.excess_kva(found.powers) <= 0.0:
                room_kw = self._room_kw(powers, state, helpers, found.ac)
                relieved = self._on.relieved(t, powers, found.ac, need_kw, room_kw, found.former)
            return (
                relieved
                or self._shed(t, powers, need_kw, found.ac)
                or self._on.without_any(powers, found.former)
            )
        if found.excess_kva > 0.0 and abs(found.left_kw) <= LITTLE_KW:
            shed = self._shed(t, powers, need_kw, found.ac)
            if shed is not None:
                return shed
        others = ~found.former.batteries
        if found.left_kw >= -self.tolerance_kw:
            for kind in TAKE_LESS if found.left_kw > self.tolerance_kw else ():
                taken_kw = powers.taken_kw.get(kind, np.zeros(0))
                taking_kw = np.maximum(taken_kw, 0.0)
                if taking_kw.sum() > 0:
                    off_kw = part_of(taking_kw, lack_kw)
                    less = taking_less(self.plant, t, powers, kind, off_kw)
                    if less is not None:
                        return less
            charging = np.where(others, np.maximum(powers.battery_kw, 0.0), 0.0)
            if found.left_kw > self.tolerance_kw and charging.sum() > 0:
                return replace(powers, battery_kw=powers.battery_kw - part_of(charging, lack_kw))
            room_kw = self._room_kw(powers, state, helpers, found.ac)
            if found.left_kw > self.tolerance_kw and room_kw.sum() > self.tolerance_kw:
                return replace(powers, battery_kw=powers.battery_kw - part_of(room_kw, lack_kw))
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
            stops = (taken_kw < 0.0) & ~forms(powers, kind)
            if stops.any():
                running = {**powers.running, kind: powers.running[kind] & ~stops}
                stopped = replace(powers, running=running)
                return taking(stopped, kind, np.where(stops, 0.0, taken_kw))
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

    def dark(self, t: int, planned: Realised, state: BatteryState, reason: str) -> Settled:
        """No customer is supplied, nothing generates, nothing flows."""
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
        realised = self.plant.realise(t, off, state)
        return Settled.of(
            realised,
            ac=self.flow.dead(),
            mismatch_kw=batteries,
            shed=planned.served,
            dark_reason=f"{reason} {self.where}".rstrip(),
        )


def shedding_order(scenario: Scenario, t: int) -> list[int]:
    """Customers in the order in which they are shed at step ``t``.

    Tier by tier from the least important, within a tier by weight per kW: most kW for the least
    weight first.
    """
    rank = {tier: i for i, tier in enumerate(scenario.tiers)}
    tier = np.array([rank[name] for name in scenario.customers.tier])
    per_kw = scenario.customers.weight / np.maximum(scenario.load_kw[t], 1e-9)
    return [int(c) for c in np.lexsort((per_kw, -tier))]


def _given_beyond_kw(set_points: Powers, powers: Powers) -> float:
    """Power of the set that forms the grid, if one does, beyond its set-point."""
    beyond_kw = 0.0
    for one in powers.forming:
        asked_kw, taken_kw = (each.taken_kw["gensets"] for each in (set_points, powers))
        beyond_kw += float(asked_kw[one.genset] - taken_kw[one.genset])
    return beyond_kw

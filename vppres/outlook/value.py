"""Value of stored energy under a belief: dynamic programming backwards over (energy, state).

The fleet is one battery, in which the fuel of generating sets is energy that is held already;
customers are shares of the cheapest service, and the network is not there. Of all that the belief
knows the chain of its states; what is charged or drawn is decided anew in each step and state. So
the value is a lumped one, and nothing certifies it: a window that is solved for it is certified for
*this* value (``docs/uncertain-outages.md``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from math import ceil, floor

import numpy as np

from vppres.contract.stored_value import PIECES, StoredValue
from vppres.core.arrays import Floats
from vppres.kinds.export.physics import Export
from vppres.outlook.belief import OutageBelief

MOST_CELLS = 240
"""Cells of stored energy at most, for batteries that take days to empty."""

CELLS_PER_MOVE = 2.0
"""Cells that the least of a step's largest moves must span."""

LEAST_KW = 1e-9
"""Power below which there is none."""


@dataclass(frozen=True)
class EquivalentBattery:
    """All batteries as one."""

    #: Energy that may be held, reserves left out.
    least_kwh: float
    most_kwh: float
    p_max_kw: float  #: largest charging and discharging power with grid
    p_out_kw: float  #: the same in an outage, less the headroom of those that form the grid
    #: Mean efficiencies.
    eta_charge: float
    eta_discharge: float
    sets_kw: float = 0.0  #: largest power of all generating sets, which they give in an outage
    #: Energy in a battery that stands for all fuel that they have or will get.
    fuel_kwh: float = 0.0
    #: Energy that a unit of what each asset of a kind holds stands for, (n,) by kind.
    kwh_each: dict[str, Floats] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Ahead:
    """Expected demand, power and prices of the present step and the ``T - 1`` behind it."""

    load_kw: Floats  #: demand of each customer if served, (T, C)
    #: PV power of all systems, import price, (T,).
    pv_kw: Floats
    price_gbp_per_kwh: Floats
    import_kw: Floats  #: largest import while there is grid, may be infinite, (T,)
    export: Export | None  #: what the grid takes back while it is there
    weight: Floats  #: weights of the customers, (C,)
    lambda_curt: float  #: weight of curtailed energy, in weighted customer hours per kWh
    dt_h: float  #: length of a step in h
    #: Energy in a battery that stands for the fuel that comes at the beginning of each step, (T,).
    delivered_kwh: Floats

    @property
    def n_steps(self) -> int:
        """Steps T."""
        return len(self.pv_kw)

    @property
    def kwh_per_service(self) -> float:
        """Mean energy of a weighted customer hour in kWh."""
        return float(self.load_kw.sum(axis=1).mean() / self.weight.sum())

    @cached_property
    def total_kw(self) -> Floats:
        """Demand of all customers, (T,)."""
        return np.asarray(self.load_kw.sum(axis=1))

    @cached_property
    def _served_first(self) -> tuple[Floats, Floats]:
        """Demand and weight of those who are served first, summed up, (T, C + 1) each."""
        order = np.argsort(-self.weight / np.maximum(self.load_kw, LEAST_KW), axis=1, kind="stable")
        load = np.take_along_axis(self.load_kw, order, axis=1).cumsum(axis=1)
        weight = self.weight[order].cumsum(axis=1)
        nothing = np.zeros((self.n_steps, 1))
        return np.hstack([nothing, load]), np.hstack([nothing, weight])

    def service(self, t: int, power_kw: Floats) -> Floats:
        """Most service that a power buys in step ``t``, shares of customers allowed.

        In weighted customer hours; minus infinity for a negative power.
        """
        load, weight = self._served_first
        found = self.dt_h * np.interp(power_kw, load[t], weight[t])
        return np.where(power_kw < -LEAST_KW, -np.inf, found)

    def worth_in_outage(self, t: int, charge_kw: Floats) -> Floats:
        """Service less curtailment of step ``t`` in an outage, (M,), for charging powers (M,)."""
        power_kw = self.pv_kw[t] - charge_kw
        lost_kw = np.maximum(power_kw - self.total_kw[t], 0.0)
        return np.asarray(self.service(t, power_kw) - self.lambda_curt * self.dt_h * lost_kw)

    def worth_with_grid(self, t: int, charge_kw: Floats, gbp_per_service: float) -> Floats:
        """Worth of a step with grid: minus cost, curtailment and denied import, as service."""
        net_kw = self.total_kw[t] - self.pv_kw[t] + charge_kw
        most_kw = float(self.import_kw[t])
        imported_kw = np.clip(net_kw, 0.0, most_kw)
        surplus_kw = np.maximum(-net_kw, 0.0)
        gbp = self.price_gbp_per_kwh[t] * imported_kw
        if self.export is not None:
            out_kw = np.minimum(surplus_kw, self.export.limit_kw[t])
            gbp = gbp - self.export.price_gbp_per_kwh[t] * out_kw
            surplus_kw = surplus_kw - out_kw
        worth = -gbp * self.dt_h / gbp_per_service - self.lambda_curt * self.dt_h * surplus_kw
        if np.isinf(most_kw):
            return np.asarray(worth)
        denied = np.where(net_kw > most_kw, self.total_kw[t] - (net_kw - most_kw), np.inf)
        everyone = self.dt_h * float(self.weight.sum())
        return np.asarray(worth + np.minimum(self.service(t, denied) - everyone, 0.0))


def stored_value(
    belief: OutageBelief,
    fleet: EquivalentBattery,
    ahead: Ahead,
    gbp_per_kwh_lost: float,
    end_gbp: Callable[[Floats], Floats],
) -> StoredValue:
    """Value of what is stored behind the present step.

    It is concave, 0 for empty batteries and tanks, and has ``PIECES`` pieces. ``end_gbp`` says what
    energies in kWh, (n,), are worth behind the last step.

    Notes
    -----
    With J the value of an energy E at the beginning of step t in a state s, and r what the step is
    worth, ``J_t(E, s) = max over E' of r_t(E' - E, s) + sum over s' of P(s' | s) J_{t+1}(E', s')``.
    """
    gbp_per_service = gbp_per_kwh_lost * ahead.kwh_per_service
    energy = _cells(fleet, ahead.dt_h)
    problem = _Problem(energy, fleet, ahead, gbp_per_service)
    worth = _behind_present(belief, problem, end_gbp(energy) / gbp_per_service)
    points = np.linspace(energy[0], energy[-1], PIECES + 1)
    concave = np.interp(points, energy, concave_above(worth))
    service = concave - concave[0]
    return StoredValue(points, service, gbp_per_service, belief.out, fleet.kwh_each)


def concave_above(values: Floats) -> Floats:
    """The least concave function above values at equal distances.

    >>> concave_above(np.array([0.0, 0.0, 2.0, 3.0]))
    array([0., 1., 2., 3.])
    """
    kept = [0]
    for i in range(1, len(values)):
        while len(kept) > 1 and (values[i] - values[kept[-1]]) * (kept[-1] - kept[-2]) >= (
            values[kept[-1]] - values[kept[-2]]
        ) * (i - kept[-1]):
            kept.pop()
        kept.append(i)
    return np.interp(np.arange(len(values)), kept, values[kept])


def _cells(fleet: EquivalentBattery, dt_h: float) -> Floats:
    """Energies in equal distances, close enough that the least move of a step spans some."""
    usable_kwh = max(fleet.most_kwh + fleet.fuel_kwh - fleet.least_kwh, LEAST_KW)
    move_kwh = fleet.eta_charge * max(fleet.p_out_kw, LEAST_KW) * dt_h
    cells = int(np.clip(ceil(CELLS_PER_MOVE * usable_kwh / move_kwh), PIECES, MOST_CELLS))
    return np.linspace(fleet.least_kwh, fleet.least_kwh + usable_kwh, cells + 1)


@dataclass(frozen=True, eq=False)
class _Moves:
    """Energy to store or draw in a step, in cells of energy (M,), and its worth, (M,).

    Cells may be broken: the largest powers, and those that leave nothing to import or to curtail,
    are no whole number of cells.
    """

    cells: Floats
    worth: Floats

    def best(self, later: Floats) -> Floats:
        """Best of all moves for what is behind the step, (R, n) each."""
        n = later.shape[1]
        found = np.full_like(later, -np.inf)
        for cells, worth in zip(self.cells, self.worth, strict=True):
            low = floor(cells)
            part = cells - low
            first = max(0, -low)
            last = min(n, n - low - (1 if part else 0))
            if last <= first:
                continue
            reached = later[:, first + low : last + low]
            if part:
                reached = (1.0 - part) * reached + part * later[:, first + low + 1 : last + low + 1]
            into = found[:, first:last]
            np.maximum(into, reached + worth, out=into)
        return found


@dataclass(frozen=True, eq=False)
class _Problem:
    """Energies (n,) and what is expected: everything but the belief."""

    energy: Floats
    fleet: EquivalentBattery
    ahead: Ahead
    gbp_per_service: float

    def with_grid(self, t: int) -> _Moves:
        """Moves of step ``t`` while there is grid."""
        most_kw = self.fleet.p_max_kw
        unmet_kw = self.ahead.total_kw[t] - self.ahead.pv_kw[t]
        charge_kw = self._powers(-most_kw, most_kw, -unmet_kw)
        worth = self.ahead.worth_with_grid(t, charge_kw, self.gbp_per_service)
        return _Moves(self._cells(charge_kw), worth)

    def out(self, t: int) -> _Moves:
        """Moves of step ``t`` in an outage."""
        pv_kw = self.ahead.pv_kw[t]
        most_kw = self.fleet.p_out_kw
        least_kw = -most_kw - self.fleet.sets_kw
        charge_kw = self._powers(least_kw, most_kw, pv_kw - self.ahead.total_kw[t], pv_kw)
        charge_kw = charge_kw[charge_kw <= pv_kw]
        return _Moves(self._cells(charge_kw), self.ahead.worth_in_outage(t, charge_kw))

    def before_delivery(self, t: int, worth: Floats) -> Floats:
        """Worth of energies to which the fuel of step ``t`` is still to come, (R, n) each."""
        delivered_kwh = self.ahead.delivered_kwh[t]
        if not delivered_kwh:
            return worth
        with_fuel = np.minimum(self.energy + delivered_kwh, self.energy[-1])
        return np.array([np.interp(with_fuel, self.energy, each) for each in worth])

    def _powers(self, least_kw: float, most_kw: float, *special_kw: float) -> Floats:
        """Charging powers within two: those of whole cells, and others to be tried too."""
        whole_kw = self._whole_kw[(self._whole_kw > least_kw) & (self._whole_kw < most_kw)]
        others_kw = np.clip([least_kw, most_kw, *special_kw], least_kw, most_kw)
        return np.append(whole_kw, others_kw)

    @cached_property
    def _whole_kw(self) -> Floats:
        """Charging powers that move whole cells."""
        cells = np.arange(1.0 - len(self.energy), len(self.energy))
        change_kw = cells * self._cell_kwh / self.ahead.dt_h
        return np.where(
            change_kw > 0.0,
            change_kw / self.fleet.eta_charge,
            change_kw * self.fleet.eta_discharge,
        )

    def _cells(self, charge_kw: Floats) -> Floats:
        """Cells that charging powers move."""
        cell_kw = self._cell_kwh / self.ahead.dt_h
        stored_kw = np.where(
            charge_kw > 0.0,
            charge_kw * self.fleet.eta_charge,
            charge_kw / self.fleet.eta_discharge,
        )
        cells = stored_kw / cell_kw
        whole = np.round(cells)
        return np.where(np.abs(cells - whole) < 1e-9, whole, cells)

    @property
    def _cell_kwh(self) -> float:
        return float(self.energy[1] - self.energy[0])


def _behind_present(belief: OutageBelief, problem: _Problem, end: Floats) -> Floats:
    """Expected value behind the present step, (n,), of the state that it is in."""
    kinds = belief.n_announced + 1
    T = belief.n_steps
    restored = belief.restored
    possible = np.flatnonzero(np.append(belief.hazard > 0.0, belief.onset.any(axis=1)))
    places = {int(kind): place for place, kind in enumerate(possible)}
    # By the outages that have come; by kind and length so far; and of the one that is seen now.
    waiting = np.tile(end, (kinds, 1))
    lasting = np.tile(end, (len(possible), T, 1))
    present = end
    for t in range(T - 1, -1, -1):
        begins = _begins(belief, t + 1)
        left = 1.0 - begins.sum(axis=1, keepdims=True)
        later_waiting = left * waiting + begins[:, possible] @ lasting[:, 0]
        over = restored[belief.kind, min(belief.elapsed + t, restored.shape[1] - 1)]
        # Behind an outage another one may last, which began in it.
        behind = waiting.copy()
        for kind in range(1, kinds):
            for other, began in reversed(belief.behind(kind, t + 1)):
                goes_on = began[: t + 1] @ lasting[places[other], : t + 1]
                behind[kind] = (1.0 - began.sum()) * behind[kind] + goes_on
        later_present = over * behind[belief.kind] + (1.0 - over) * present
        if t == 0:
            break
        ends = restored[possible][:, np.minimum(np.arange(t), restored.shape[1] - 1), None]
        stays = lasting[:, 1 : t + 1]
        later_lasting = ends * behind[possible][:, None] + (1.0 - ends) * stays
        waiting = problem.before_delivery(t, problem.with_grid(t).best(later_waiting))
        states = np.vstack([later_lasting.reshape(-1, len(end)), later_present])
        best = problem.before_delivery(t, problem.out(t).best(states))
        lasting = best[:-1].reshape(later_lasting.shape)
        present = best[-1]
    return np.asarray(later_present if belief.out else later_waiting[0])


def _begins(belief: OutageBelief, t: int) -> Floats:
    """Probability of each kind to begin at step ``t``, by the outages that have come."""
    kinds = belief.n_announced + 1
    if t >= belief.n_steps:
        return np.zeros((kinds, kinds))
    return np.array([belief.onsets_from(come, t) for come in range(kinds)])

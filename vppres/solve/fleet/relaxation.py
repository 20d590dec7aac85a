"""The fleet's relaxation: all customers and one PV system on one bus, with a fleet of batteries.

It is a selection of the statement. Families of the network are left out, balances are added up over
the buses and PV systems over their kind. The fleet is one lumped battery, or every battery by
itself but without its binary: slower, and exact for batteries that differ in efficiency or state.
What is left out or added up only widens what is allowed, so the optimum is an upper bound on the
true optimum; ``docs/method.md`` has the proof of each.
"""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction
from functools import cached_property, partial
from typing import Literal

import numpy as np
import scipy.sparse as sp

from vppres.core.arrays import Flags, Floats
from vppres.kinds.batteries.physics import BatteriesAhead
from vppres.model.data import WindowData
from vppres.model.numerics import ROUNDING, SAME, cost_scale, objective_scale
from vppres.model.parts import at_items
from vppres.model.site import Site
from vppres.scenario.assets import NO_POWER_KW
from vppres.solve.cache import ModelCache
from vppres.solve.compiled import Linear
from vppres.solve.forms import MODES, OF_PV, one_mode_at_a_time, sheet_of, total_balance
from vppres.solve.lumping import Lumping, eliminated
from vppres.solve.netting import eased_soc
from vppres.solve.selection import EQUAL, MOST, Family, Selected, Selection, Sheet

Goal = Literal["weighted", "service", "cost", "dispatch", "sooner"]

OF_ENERGY = (
    "battery_soc_start",
    "battery_soc_dynamics",
    "battery_soc_min",
    "battery_soc_max",
    "battery_room",
    "battery_reserve",
)
"""Families in shares of a capacity: as energies they can be added up."""


class Fleet:
    """Rows of the fleet for W steps, of which its problems take what they need.

    ``lumped`` has the fleet as one battery.

    Attributes
    ----------
    families : dict
        Rows by their names, equalities that are solved for their letters not among them.
    grid : float
        Largest number of which every weight is a multiple, 0 if there is none worth using.
    """

    def __init__(self, site: Site, sheet: Sheet, lumped: bool) -> None:
        self.site = site
        self.sheet = sheet
        self.lumped = lumped
        self.left_out = sheet.statement.network_letters | {"Q_grid"}
        self.grid = weight_grid(site.customers.weight * site.dt_h)
        b = site.batteries
        apart = any(addition.apart for addition in sheet.statement.additions)
        pv = np.ones(0 if apart else len(site.pv))
        letters = {name: pv for name in ("P_self", "P_exp", "P_curt") if len(pv)}
        if lumped and len(b):
            letters |= {"P_ch": np.ones(len(b)), "P_dch": np.ones(len(b)), "SoC": b.energy_kwh}
            of_batteries = sheet.statement.named("of_batteries")
            letters |= dict.fromkeys(of_batteries, np.ones(len(b)))
        self.lumping = Lumping(sheet, letters)
        self.joined = self._joined({family.name: family for family in self._summed()})
        solved = self.put_in(self.joined, OF_PV, ("P_self", "P_exp"))
        self.families = {family.name: family for family in solved}
        lumped_terms = {name: self.lumping.of(sheet.term(name)) for name in sheet.statement.terms}
        self.terms = {
            name: term
            for name, term in lumped_terms.items()
            if term is not None and not set(term.letters) & self.left_out
        }
        # Factors of sums, then ratios of the first step, as a window has them.
        self.extras = self.lumping.extras + 2 * self.groups

    @property
    def groups(self) -> int:
        """Batteries that the relaxation tells apart."""
        return min(1, len(self.site.batteries)) if self.lumped else len(self.site.batteries)

    def name_of(self, letter: str) -> str:
        """A letter, or that of its sum."""
        return f"all {letter}" if letter in self.lumping.names else letter

    # Rows.

    def _summed(self) -> list[Family]:
        """All families without letters of the network, on sums; what tells devices apart goes."""
        sheet = self.sheet
        statement = sheet.statement
        found = [total_balance(sheet)]
        for name in statement.families | statement.implied:
            used = statement.letters_of(name)
            beyond = name in statement.families or name in statement.implied_beyond
            if (used & self.left_out) or not (beyond or name in OF_ENERGY) or name in MODES:
                continue
            if name in statement.own and not self._puts_in(name):
                continue
            for family in sheet.parts(name):
                found.append(self._over_devices(family))
        if len(self.site.batteries):
            found.append(self._over_devices(one_mode_at_a_time(sheet)))
        lumped = (self.lumping.of(family) for family in found)
        return [family for family in lumped if family is not None]

    def _puts_in(self, name: str) -> bool:
        """Whether what is put in for letters has constant factors in a family's rows."""
        sheet = self.sheet
        letters = ("P_self", "P_exp", "SoC")
        columns = np.concatenate([sheet.columns[each].ravel() for each in letters])
        every = [part.rows for part in sheet.parts(name)]
        inside = (rows.by[np.isin(rows.column, columns)] for rows in every)
        return all((by.indices == sheet.width - 1).all() for by in inside)

    def _over_devices(self, family: Family) -> Family:
        """A family of rows for each device, added up over those that are lumped."""
        b = self.site.batteries
        if family.name in OF_ENERGY and not self.lumped:
            return family
        if family.name in OF_ENERGY:
            return self.lumping.over_devices(family, b.energy_kwh)
        lumped = [name for name in family.letters if name in self.lumping.names]
        if lumped and self._has_a_row_for_each(family, lumped):
            return self.lumping.over_devices(family, np.ones(family.shape[-1]))
        return family

    def _has_a_row_for_each(self, family: Family, letters: list[str]) -> bool:
        """Whether the last axis of a family is that of devices: no row uses two of them."""
        columns = [self.sheet.columns[name] for name in letters]
        if {each.shape[-1] for each in columns} != {family.shape[-1] if family.shape else 0}:
            return False
        device = np.full(self.sheet.size + 1, -1)
        for each in columns:
            device[each] = np.arange(each.shape[-1])
        rows = family.rows.wider(self.sheet.size)
        used = device[rows.column] >= 0
        pairs = np.unique(np.stack([rows.row[used], device[rows.column[used]]]), axis=1)
        alone = len(np.unique(pairs[0])) == pairs.shape[1]
        return alone and (len(family.shape) > 1 or family.shape[-1] > 1)

    def _joined(self, named: dict[str, Family]) -> dict[str, Family]:
        """Rows with those that keep export above zero, and circular charging in other words."""
        if "circular_charging" in named:
            # With the balance it says that no battery discharges into another.
            circle, balance = named["circular_charging"], named["total_active_power_balance"]
            rows = circle.rows.plus(balance.rows)
            letters = tuple(dict.fromkeys((*balance.letters, *circle.letters)))
            named["circular_charging"] = replace(circle, rows=rows, letters=letters)
        if len(self.site.pv):
            exports = {self.name_of("P_exp"): -1.0}
            named["curtailment_max"] = self.sheet.limit_of("curtailment_max", exports)
        return named

    def put_in(
        self, named: dict[str, Family], by: tuple[str, ...], letters: tuple[str, ...]
    ) -> list[Family]:
        """Families without some letters, and without the energy of one battery."""
        names = [self.name_of(letter) for letter in letters] if len(self.site.pv) else []
        equal = list(by) if len(self.site.pv) else []
        if self.lumped and len(self.site.batteries):
            names.append(self.name_of("SoC"))
            equal += ["battery_soc_start", "battery_soc_dynamics"]
        if not names:
            return list(named.values())
        rest = [family for name, family in named.items() if name not in equal]
        return eliminated(self.sheet, rest, names, [named[name] for name in equal])

    def limits(self) -> list[Family]:
        """Limits that no family of the statement has: of curtailment, sums and the first step."""
        found = self.lumping.range_rows()
        if len(self.site.pv):
            curtailed = {self.name_of("P_curt"): -1.0}
            found.append(self.sheet.limit_of("curtailment_min", curtailed))
        if self.groups:
            found += self._first_step()
        return found

    # First step.

    def _first_step(self) -> tuple[Family, Family]:
        """Limits of the first step, in which the SoC is known; ratios and limits are a window's."""
        letters = (self.name_of("P_ch"), self.name_of("P_dch"))
        G = self.groups
        width = self.sheet.width + self.extras
        number = np.arange(G)
        ch, dch = (np.atleast_1d(self.sheet.columns[name][0]) for name in letters)
        found = []
        for which, (own, other) in enumerate(((ch, dch), (dch, ch))):
            one = (np.ones(G), (number, np.full(G, self.sheet.width - 1)))
            ratio = (np.ones(G), (number, width - 2 * G + which * G + number))
            by = sp.vstack([sp.csr_array(each, shape=(G, width)) for each in (one, ratio)])
            rows = Linear(
                np.tile(number, 2), np.append(own, other), sp.csr_array(by), (G, self.sheet.size)
            )
            name = ("first_charge", "first_discharge")[which]
            found.append(Family(name, rows, MOST, (G,), letters))
        return found[0], found[1]

    def first_limits(
        self, data: WindowData, missed_soc: Floats
    ) -> tuple[dict[str, Floats], Floats]:
        """The limits, (G,) each, and the ratios one after the other.

        With ``a`` and ``b`` a battery's largest charge and discharge, exclusivity implies
        ``ch/a + dch/b <= 1``; summed over a group with its smallest ratio it stays valid.
        """
        b = self.site.batteries
        limit = data.active_max_kw(b)[0]
        least = data.soc_min(b)[0] - missed_soc
        known = BatteriesAhead.of(b, data, self.site.dt_h)
        charge = np.minimum(limit, known.charge_to_kw(b.soc_max))
        discharge = np.minimum(limit, known.discharge_to_kw(least))
        # A ratio of next to nothing says nothing, and is no number a solver can work with.
        both = (charge > NO_POWER_KW) & (discharge > NO_POWER_KW)
        a_per_b = np.divide(charge, discharge, where=both, out=np.zeros_like(charge))
        b_per_a = np.divide(discharge, charge, where=both, out=np.zeros_like(charge))
        if self.lumped and len(b):
            charge, discharge = (np.atleast_1d(each.sum()) for each in (charge, discharge))
            a_per_b, b_per_a = (np.atleast_1d(each.min()) for each in (a_per_b, b_per_a))
        limits = {"first_charge": charge, "first_discharge": discharge}
        return limits, np.concatenate([a_per_b, b_per_a])

    def written(
        self, data: WindowData, values: Floats, eased: bool = False
    ) -> tuple[dict[str, Floats], Floats]:
        """Limits that a window writes, and all that it writes behind the statement's values.

        With ``eased`` each battery may be emptied by a little more than its lowest state of charge.
        That takes no dispatch away, whereas more energy at first would leave less room.
        """
        b = self.site.batteries
        missed_soc = eased_soc(b) if eased else np.zeros(len(b))
        limits, ratios = self.first_limits(data, missed_soc)
        if eased and self.groups:
            each = np.atleast_1d(b.energy_kwh @ missed_soc) if self.lumped else missed_soc
            missed = np.tile(each, (data.n_steps, 1))
            limits |= {"battery_soc_min": missed, "battery_reserve": missed}
        lost = np.maximum(data.pv_kw - self.site.pv.s_max_kva, 0.0)
        lumped = "P_curt" in self.lumping.names
        limits["curtailment_min"] = -(lost.sum(axis=1) if lumped else lost)
        return limits, np.concatenate([values, self.lumping.written(values), ratios])

    def able(self, data: WindowData) -> Floats:
        """1 for who can be served: not an owner whose self-consumption exceeds its inverter."""
        too_much = data.self_limit_kw(self.site) > self.site.pv.s_max_kva + ROUNDING
        return np.where(too_much @ self.site.pv_customer.T > 0, 0.0, 1.0)

    def sum_of_terms(self, name: str, kind: str, *terms: tuple[str, float]) -> Family:
        """A row of terms with factors, those that there are, on sums."""
        there = [(t, f) for t, f in terms if t in self.terms]
        parts = [self.terms[t] for t, _ in there]
        size = self.sheet.size
        factors = sp.csr_array(np.array([[f for _, f in there]]))
        rows = Linear.stacked([part.rows.wider(size) for part in parts]).times(factors)
        letters = tuple(dict.fromkeys(x for part in parts for x in part.letters))
        return Family(name, rows, kind, (1,), letters)

    @cached_property
    def service(self) -> tuple[tuple[str, float], ...]:
        """f1 less f3 as weighted, less the price of switching, with later service."""
        curtailed = ("f3", -self.site.weights.lambda_curt)
        return ("f1", 1.0), curtailed, ("f6", -1.0), ("f7", 1.0), ("own", 1.0)


class FleetProblem(Selected):
    """A problem of the fleet, with one binary for each customer and step.

    Parameters
    ----------
    site : Site
        Fixed data.
    fleet : Fleet
        Its rows.
    integer : bool
        Whether service is all or nothing; without it the problem is linear and a weaker bound.
    goal : {"weighted", "service", "cost", "dispatch", "sooner"}
        ``weighted`` maximises all linear terms as weighted, times the objective's scale;
        ``service`` maximises f1 and f3 in units of the weights' grid, f3 rounded in favour;
        ``cost`` minimises the cost (GBP) of all sets whose service reaches ``service_min``;
        ``dispatch`` minimises in GBP all that a supply schedule leaves to decide, see :meth:`hold`;
        ``sooner`` has all sets whose service reaches ``service_min`` at a cost that a window
        writes, and no objective of its own.
    """

    def __init__(self, site: Site, fleet: Fleet, integer: bool, goal: Goal) -> None:
        select = partial(_select, fleet=fleet, integer=integer, goal=goal)
        super().__init__(fleet.sheet, select, without=fleet.left_out)
        self.fleet = fleet
        self.grid = fleet.grid
        self.service_min = 0.0
        self.extras = fleet.extras

    def hold(self, served: Flags) -> None:
        """Hold a supply schedule in the window that was written last."""
        self.limits |= {"service_max": served.astype(float), "service_min": -served.astype(float)}

    def write(self, data: WindowData, all_connected: bool = False, eased: bool = False) -> None:
        """Write the window's data, ``eased`` for sets that live on exactly the energy there is.

        With ``all_connected`` all customers that can be are supplied in steps without a limit of
        import. That loses no service: more import serves them, and no battery notices.
        """
        fleet = self.fleet
        limits, self.values = fleet.written(data, fleet.sheet.statement.write(data), eased)
        unlimited = all_connected & np.isinf(data.grid_limit_kw)
        connected = (
            unlimited[:, None] if data.switching is None else data.switching.connected(unlimited)
        )
        able = fleet.able(data)
        connected = connected & ~at_items(data.parts.beyond, fleet.site.customer_bus)
        self.limits = {
            **limits,
            "service_max": able,
            "service_min": -able * connected,
            "service_enough": -self.service_min / (self.grid or 1.0),
        }


def _select(sheet: Sheet, fleet: Fleet, integer: bool, goal: Goal) -> Selection:
    """The fleet's rows with a goal."""
    parts = [*fleet.families.values()]
    parts.append(sheet.limit_of("service_max", {"x_served": 1.0}))
    parts.append(sheet.limit_of("service_min", {"x_served": -1.0}))
    parts += fleet.limits()
    found = Selection(sheet).relaxed_to_shares(sheet.statement.named("directions"))
    if integer:
        parts += counts_of_alike(fleet)
    else:
        found = found.relax("x_served", 0.0, 1.0)
    found = replace(found, parts=tuple(sorted(parts, key=rank)))
    return _most_service(found, fleet) if goal == "service" else _with_terms(found, fleet, goal)


def _order(fleet: Fleet, *first: str) -> tuple[str, ...]:
    """The order of columns: some letters, then those of batteries and counts."""
    names = (fleet.name_of(name) for name in first)
    return (*names, fleet.name_of("P_ch"), "range P_ch", "range P_dch", "counts")


def _with_terms(found: Selection, fleet: Fleet, goal: Goal) -> Selection:
    """Selection with the terms of a goal, and rows for enough service and for the cost."""
    w, unit = fleet.site.weights, fleet.grid or 1.0
    terms = {
        "weighted": (*fleet.service, ("f2", -w.lambda_grid)),
        "cost": (("f2", 1.0),),
        "dispatch": (("f2", w.lambda_grid), ("f3", w.lambda_curt), ("f7", -1.0), ("own", -1.0)),
    }
    scales = {"weighted": objective_scale(fleet.site), "dispatch": cost_scale(fleet.site)}
    parts = list(found.parts)
    if goal in ("cost", "sooner"):
        lack = [(name, -factor / unit) for name, factor in fleet.service]
        parts.append(fleet.sum_of_terms("service_enough", MOST, *lack))
    if goal == "sooner":
        parts.append(fleet.sum_of_terms("cost_most", MOST, ("f2", 1.0)))
    by_cost = goal in ("cost", "dispatch")
    first = ("P_grid", "P_curt", "P_dch", "x_served")
    order = _order(fleet, *(first if by_cost else ("x_served", "P_curt", "P_grid", "P_dch")))
    found = replace(found, parts=tuple(parts), maximises=goal == "weighted", order=order)
    if goal not in terms:
        return found
    term = fleet.sum_of_terms(goal, EQUAL, *terms[goal])
    return replace(found, terms=((term, scales.get(goal, 1.0)),))


def _most_service(found: Selection, fleet: Fleet) -> Selection:
    """The most service in units, less a whole penalty of curtailment.

    The penalty is rounded down, so that the optimum stays an upper bound and a solver may round its
    own, which is most of the proof.
    """
    sheet = fleet.sheet
    unit = fleet.grid or 1.0
    (penalty,) = sheet.new_letter("penalty", (1,), whole=True)
    if "x_served" in found.relaxed:
        found = found.relax("penalty", 0.0)
    lost = fleet.sum_of_terms("penalty", MOST, ("f3", fleet.site.weights.lambda_curt / unit))
    rounded = lost.with_column(int(penalty), -1.0, "penalty", limit=1.0)
    units = _rounded(fleet.sum_of_terms("units", EQUAL, ("f1", 1.0 / unit)))
    terms = [(units.with_column(int(penalty), -1.0, "penalty"), 1.0)]
    others = [(name, factor / unit) for name, factor in fleet.service if name in ("f6", "f7")]
    if any(name in sheet.statement.terms for name, _ in others):
        terms.append((fleet.sum_of_terms("others", EQUAL, *others), 1.0))
    parts = (*found.parts, rounded)
    order = _order(fleet, "x_served", "penalty", "P_grid", "P_curt", "P_dch")
    return replace(found, parts=parts, terms=tuple(terms), maximises=True, order=order)


ORDER = (
    "circular_charging",
    "curtailment_max",
    "curtailment_min",
    "grid_active_limit",
    "grid_export_limit",
    "service_max",
    "service_min",
    "held_at_end",
    "value_at_end",
    "battery_soc_min",
    "battery_soc_max",
    "battery_room",
    "battery_reserve",
    "battery_power",
    "least P_ch",
    "largest P_ch",
    "least P_dch",
    "largest P_dch",
    "first_charge",
    "first_discharge",
)
"""The order of rows; what is not named comes behind."""


def rank(family: Family) -> int:
    """Place of a family among the rows."""
    return ORDER.index(family.name) if family.name in ORDER else len(ORDER)


def _rounded(family: Family) -> Family:
    """A row with factors that are whole numbers but for rounding."""
    by = family.rows.by.copy()
    by.data = np.round(by.data)
    return replace(family, rows=replace(family.rows, by=by))


def counts_of_alike(fleet: Fleet) -> list[Family]:
    """How many of each weight are served in each step, as whole numbers to branch on.

    They say nothing new, but one branch on such a number says of many customers what else takes one
    for each.
    """
    sheet = fleet.sheet
    weights, kind = np.unique(fleet.site.customers.weight, return_inverse=True)
    alike = kind[:, None] == np.arange(len(weights))
    shared = alike[:, alike.sum(axis=0) > 1].astype(float)
    if not shared.size:
        return []
    W, K = sheet.n_steps, shared.shape[1]
    sheet.new_letter("counts", (W, K), -np.inf, whole=True)
    served = sheet.limit_of("served", {"x_served": -1.0}).rows
    served = served.times(sp.kron(shared.T, sp.eye_array(W)))
    rows = served.plus(sheet.limit_of("counts", {"counts": 1.0}).rows)
    return [Family("counts_of_alike", rows, EQUAL, (W, K), ("x_served", "counts"))]


def fleet_of(cache: ModelCache, data: WindowData, lumped: bool) -> Fleet:
    """Rows of the fleet for the window's length, lumped or with every battery."""
    return cache.problem(Fleet, sheet=sheet_of(cache, data), lumped=lumped)


def fleet_problem(
    cache: ModelCache, data: WindowData, lumped: bool, integer: bool, goal: Goal
) -> FleetProblem:
    """A problem of the fleet for the window's length."""
    fleet = fleet_of(cache, data, lumped)
    return cache.problem(FleetProblem, fleet=fleet, integer=integer, goal=goal)


def whole_price(data: WindowData, grid: float) -> bool:
    """Whether an off/on pair costs a multiple of the weights' grid, or nothing."""
    pair = 0.0 if data.switching is None else data.switching.price_of_pair
    return pair == 0.0 or (grid > 0 and abs(pair / grid - round(pair / grid)) < ROUNDING)


MOST_PARTS = 10_000
"""Parts of one that weights may have in common."""

MOST_UNITS = 1e6
"""Units of the largest weight, as in strict priority: beyond it a tolerance reaches a unit."""


def weight_grid(weights: Floats) -> float:
    """Largest number of which all weights are multiples, 0 if the largest needs too many.

    >>> weight_grid(np.array([1.0, 0.1, 0.02]))
    0.02
    """
    positive = [float(w) for w in np.unique(weights) if w > 0]
    parts = [Fraction(w).limit_denominator(MOST_PARTS) for w in positive]
    if not parts:
        return 0.0
    common = math.lcm(*(part.denominator for part in parts))
    unit = Fraction(math.gcd(*(int(part * common) for part in parts)), common)
    exact = all(
        math.isclose(float(part), w, rel_tol=SAME, abs_tol=SAME)
        for part, w in zip(parts, positive, strict=True)
    )
    return float(unit) if exact and max(parts) / unit <= MOST_UNITS else 0.0

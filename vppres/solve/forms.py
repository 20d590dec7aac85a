"""The whole problem in its forms, and its relaxation without the network, as selections."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np
import scipy.sparse as sp

from vppres.model.beyond_paper.lines_out import LinesOut
from vppres.model.beyond_paper.table import Beyond, beyond_paper
from vppres.model.data import WindowData
from vppres.model.numerics import Polygon, cost_scale, objective_scale
from vppres.model.problem import page
from vppres.model.site import Site
from vppres.solve.cache import ModelCache
from vppres.solve.selection import EQUAL, MOST, ORDER, Family, Selected, Selection, Sheet

Level = Literal["service", "cost"]
Mode = Literal["integer", "relaxed", "fixed"]

DISCS = ("battery_inverter_capacity", "pv_inverter_capacity")
MODES = ("battery_charge_mode", "battery_discharge_mode")
OF_PV = ("pv_balance", "pv_self_consumption")

WITHOUT_NETWORK = (
    "battery_charge_rating",
    "battery_discharge_rating",
    "pv_active_rating",
    "battery_room",
    "battery_reserve",
)
"""Implied families that stand for what is left out."""


@dataclass(frozen=True)
class Form:
    """Which variant of the problem is meant."""

    #: ``service`` maximises f1, f2 and f3 as weighted; ``cost`` minimises f2 and f3 as weighted.
    level: Level = "service"
    service: Mode = "integer"  #: what the binaries x_served are
    exclusivity: Mode = "integer"  #: what the binaries of batteries and of the connection are
    polygon_sides: int = 0  #: 0 states the inverters as cones, otherwise as polygons
    #: Whether polygons contain the discs, for bounds, or lie inside them, for dispatches.
    outer: bool = False
    #: Whether flows, reactive power and voltages are part of the problem; without them it is a
    #: relaxation.
    network: bool = True

    @property
    def polygon(self) -> Polygon | None:
        """Polygon instead of the inverters' discs, None for the discs themselves."""
        if not self.polygon_sides:
            return None
        shape = Polygon.around if self.outer else Polygon.inscribed
        return shape(self.polygon_sides)


def select_form(sheet: Sheet, form: Form) -> Selection:
    """The rows and terms of a form; the terms are scaled to numbers that solvers like.

    A supply schedule meets the rules or does not, so a form of a set has no rows of them. f4 and f5
    are too small to be solved with the rest: the tie-breakers have them.
    """
    statement = sheet.statement
    names = in_order(sheet)
    found = Selection(sheet)
    if form.service == "fixed":
        names = [name for name in names if name not in statement.rules]
        found = found.hold("x_served", *statement.named("by_service"))
    if form.service == "relaxed":
        found = found.relax("x_served", 0.0, 1.0)
    if form.exclusivity == "relaxed":
        found = found.relax("delta")
        found = found.relaxed_to_shares(statement.named("directions"))
    if form.network:
        found = with_discs(found, names, form.polygon)
    else:
        found = without_network(found, names)
    w, cost = sheet.site.weights, form.level == "cost"
    s = cost_scale(sheet.site) if cost else objective_scale(sheet.site)
    f2, f3 = s * w.lambda_grid, s * w.lambda_curt
    if cost:
        return found.optimise(f2=f2, f3=f3, f7=-s, own=-s)
    return found.optimise(True, f1=s, f6=-s, f2=-f2, f3=-f3, f7=s, own=s)


def in_order(sheet: Sheet) -> list[str]:
    """Names of all families in the solvers' order."""
    families = sheet.statement.families
    return [*(n for n in ORDER if n in families), *(n for n in families if n not in ORDER)]


def with_discs(found: Selection, names: list[str], polygon: Polygon | None) -> Selection:
    """All rows of some families, with polygons for the discs if there are any."""
    for name in names:
        if polygon is not None and name in DISCS:
            found = found.polygon(name, polygon)
        else:
            found = found.keep(name)
    return found


def without_network(found: Selection, names: list[str]) -> Selection:
    """A relaxation: families that use a letter of the network are left out.

    What follows from them for sums and for active power stays.
    """
    sheet = found.sheet
    left_out = sheet.statement.network_letters
    kept = [name for name in names if not left_out & sheet.statement.letters_of(name)]
    known = [name for name in kept if name in ORDER]
    found = found.keep(*known)
    found = replace(found, parts=(*found.parts, total_balance(sheet)))
    found = found.keep(*WITHOUT_NETWORK, *sheet.statement.named("for_network"))
    return found.keep(*(n for n in kept if n not in ORDER))


def total_balance(sheet: Sheet, name: str = "active_power_balance") -> Family:
    """Sum of the balances over the buses: flows cancel."""
    family = sheet.family(name)
    W, N = family.shape
    rows = family.rows.times(sp.csr_array(np.tile(np.eye(W), N)))
    letters = tuple(each for each in family.letters if sheet.used(each, rows))
    return Family(f"total_{name}", rows, EQUAL, (W,), letters)


def one_mode_at_a_time(sheet: Sheet) -> Family:
    """Charging and discharging share a battery's power; with its mode they cancel."""
    charge, discharge = (sheet.family(name) for name in MODES)
    rows = charge.rows.plus(discharge.rows)
    return Family("battery_power", rows, MOST, charge.shape, ("P_ch", "P_dch"))


def form_problem(site: Site, sheet: Sheet, form: Form, conic: bool) -> Selected:
    """A form of the problem as a solver is asked for it."""
    without = frozenset() if form.network else sheet.statement.network_letters
    return Selected(sheet, partial(select_form, form=form), conic, without)


def sheet_of(cache: ModelCache, data: WindowData) -> Sheet:
    """The compiled statement of the window's length and of what it has beyond the paper."""
    return sheet_for(cache, data.n_steps, beyond_paper(cache.site, data))


def sheet_of_draws(cache: ModelCache, data: WindowData) -> Sheet:
    """The compiled statement of one step with what draws power, and lines that are out."""
    found = beyond_paper(cache.site, data)
    kept = tuple((each, shape) for each, shape in found if each.draws or each is LinesOut)
    return sheet_for(cache, 1, kept)


def sheet_for(cache: ModelCache, n_steps: int, beyond: Beyond) -> Sheet:
    """The compiled statement of so many steps and of what is beyond the paper."""
    return cache.problem(Sheet, n_steps=n_steps, beyond=beyond, page=page())


def window_problem(
    cache: ModelCache, data: WindowData, form: Form, conic: bool = False
) -> Selected:
    """The window's problem in a form, for interior points or for a solver that knows limits."""
    return cache.problem(form_problem, sheet=sheet_of(cache, data), form=form, conic=conic)

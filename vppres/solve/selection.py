"""Problems as selections of the one statement: rows, sums of rows, held letters and terms.

The statement is compiled family by family, once for each site and number of steps and only as far
as it is asked for. A problem takes rows and columns of it, so what a window writes into it is one
sparse product.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Set
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import cvxpy as cp
import numpy as np
import scipy.sparse as sp
from cvxpy.constraints.nonpos import Inequality
from cvxpy.constraints.zero import Equality

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Flags, Floats, Wholes
from vppres.model.beyond_paper.table import Beyond
from vppres.model.data import WindowData
from vppres.model.numerics import Polygon
from vppres.model.site import Site
from vppres.model.statement import Statement
from vppres.solve.compiled import Affine, Linear, Numbers, affine, checked, joined

ORDER = (
    "battery_charge_mode",
    "battery_discharge_mode",
    "battery_soc_start",
    "battery_soc_dynamics",
    "battery_soc_min",
    "battery_soc_max",
    "circular_charging",
    "pv_balance",
    "pv_self_consumption",
    "grid_active_limit",
    "grid_reactive_max",
    "grid_reactive_min",
    "battery_inverter_capacity",
    "pv_inverter_capacity",
    "active_power_balance",
    "reactive_power_balance",
    "voltage_slack",
    "delta_lindistflow",
    "voltage_min",
    "voltage_max",
    "grid_export_limit",
)
"""The order in which solvers get the paper's rows; what is not named comes behind. Which of several
optima that are equally good comes out depends on it, so it stays as it is."""

EQUAL, MOST, CONE = "equal", "most", "cone"


@dataclass(frozen=True, eq=False)
class Family:
    """Rows of a family: their kind, their shape and the letters in the order of their use."""

    name: str
    rows: Linear
    kind: str
    shape: tuple[int, ...]
    letters: tuple[str, ...]

    def with_column(self, column: int, value: float, letter: str, limit: float = 0.0) -> Family:
        """Copy with a column more in each row, and an addition to each limit."""
        count, size = self.rows.shape
        places = np.arange(count), np.full(count, column)
        matrix = sp.coo_array((np.full(count, value), places), shape=(count, max(size, column + 1)))
        more = Linear.constant(matrix, np.full(count, limit), self.rows.by.shape[1])
        return replace(self, rows=self.rows.plus(more), letters=(*self.letters, letter))


class Sheet:
    """The statement of a site and number of steps, compiled as far as it is asked for.

    It is that of the page as it is, of which ``page`` has the functions: others are another sheet.

    Attributes
    ----------
    statement : Statement
        The statement.
    columns : dict
        Columns of each letter in its shape.
    """

    def __init__(
        self, site: Site, n_steps: int, beyond: Beyond = (), page: tuple[object, ...] = ()
    ) -> None:
        self.statement = Statement(site, n_steps, beyond)
        self.site = site
        self.n_steps = n_steps
        sizes = [q.size for q in self.statement.parameters]
        starts = np.cumsum([0, *sizes])
        self._parameters = {
            q.id: start for q, start in zip(self.statement.parameters, starts, strict=False)
        }
        self.width = int(starts[-1]) + 1
        self.columns: dict[str, Wholes] = {}
        self.lower = np.zeros(0)
        self.upper = np.zeros(0)
        self.whole: dict[str, bool] = {}
        statement = self.statement
        terms = {_of_term(name): term == 0.0 for name, term in statement.terms.items()}
        self._constraints = {**statement.families, **statement.implied, **statement.drawn, **terms}
        self._families: dict[str, tuple[Family, ...]] = {}
        for name, x in self.statement.letters.items():
            self._add_letter(name, x.shape, *_bounds(x), _is_whole(x))

    @cached_property
    def own_whole(self) -> tuple[str, ...]:
        """Letters that are whole numbers and that only the page has."""
        known = {"x_served", "delta", *self.statement.named("directions")}
        return tuple(
            name
            for name, x in self.statement.letters.items()
            if name in self.statement.own_letters - known and _is_whole(x)
        )

    @property
    def size(self) -> int:
        """Columns so far: those that cvxpy makes of a family come with it."""
        return len(self.lower)

    def _add_letter(
        self, name: str, shape: tuple[int, ...], lower: Floats, upper: Floats, whole: bool
    ) -> None:
        count = int(np.prod(shape))
        self.columns[name] = self.size + np.arange(count).reshape(shape, order="F")
        self.lower = np.append(self.lower, lower)
        self.upper = np.append(self.upper, upper)
        self.whole[name] = whole

    def new_letter(
        self,
        name: str,
        shape: tuple[int, ...],
        lower: float = 0.0,
        whole: bool = False,
    ) -> Wholes:
        """Columns of a letter that the statement has not; those there are if it has it by now."""
        if name not in self.columns:
            count = int(np.prod(shape))
            self._add_letter(name, shape, np.full(count, lower), np.full(count, np.inf), whole)
        return self.columns[name]

    def longer_letter(self, name: str) -> int:
        """One more column, not negative, of such a letter."""
        before = self.columns.get(name, np.zeros(0, dtype=np.int64))
        self._add_letter(name, (1,), np.zeros(1), np.full(1, np.inf), False)
        self.columns[name] = np.append(before, self.columns[name])
        return int(self.columns[name][-1])

    def parts(self, name: str) -> tuple[Family, ...]:
        """A family's rows, equalities apart from limits."""
        if name not in self._families:
            self._compile_with(name)
        return self._families[name]

    def family(self, name: str) -> Family:
        """A family all of whose rows are of a kind."""
        (found,) = self.parts(name)
        return found

    def _compile_with(self, name: str) -> None:
        """Compile a family, and in one go all others: a call of cvxpy takes longer than their rows.

        One that is not affine gets columns of its own, and is compiled alone.
        """
        constraint = self._constraints[name]
        if not _joins(constraint):
            self._families[name] = self._alone(name, constraint)
            return
        named = {each: other for each, other in self._constraints.items() if _joins(other)}
        rows = self._placed(name, affine(joined([c for c in named.values() if c.size])))
        first = 0
        for each, other in named.items():
            size = other.size
            part = rows.between(first, first + size)
            self._families[each] = (Family(each, part, *_kind(other), _letters(other)),)
            first += size

    def _alone(self, name: str, constraint: cp.Constraint) -> tuple[Family, ...]:
        """Rows of a constraint that is compiled by itself."""
        found = affine(constraint)
        rows = self._placed(name, found)
        letters = _letters(constraint)
        letters += tuple(each for each in self.columns if each.startswith(f"{name} "))
        total = rows.shape[0]
        equal, most = np.arange(found.equalities), np.arange(found.equalities, total)
        if not len(most) or not len(equal):
            kind = MOST if len(most) else EQUAL
            shape = constraint.shape if constraint.size == total else (total,)
            return (Family(name, rows, kind, tuple(shape), letters),)
        return (
            Family(name, rows.taken(equal), EQUAL, (len(equal),), letters),
            Family(name, rows.taken(most), MOST, (len(most),), letters),
        )

    def _placed(self, name: str, found: Affine) -> Linear:
        """A compiled part on the columns and parameters of all of them."""
        columns = np.full(found.rows.shape[1] + 1, -1, dtype=np.int64)
        letters = self.statement.letters
        ids = {x.id: key for key, x in letters.items()}
        for own, first in found.first.items():
            if own in ids:
                size = letters[ids[own]].size
                columns[first : first + size] = self.columns[ids[own]].ravel(order="F")
        new = np.flatnonzero(columns[:-1] < 0)
        if len(new):
            columns[new] = self.size + np.arange(len(new))
            self._add_letter(f"{name} own", (len(new),), found.lower[new], found.upper[new], False)
        columns[-1] = self.size
        places = np.full(found.width, self.width - 1, dtype=np.int64)
        for parameter, first in found.parameters:
            at = self._parameters[parameter.id]
            places[first : first + parameter.size] = at + np.arange(parameter.size)
        by = found.rows.by.tocoo()
        moved = sp.csr_array((by.data, (by.row, places[by.col])), shape=(by.shape[0], self.width))
        shape = (found.rows.shape[0], self.size)
        return Linear(found.rows.row, columns[found.rows.column], moved, shape)

    def used(self, name: str, rows: Linear) -> bool:
        """Whether any of the rows uses a letter."""
        return bool(np.isin(rows.column, self.columns[name]).any())

    def term(self, name: str) -> Family:
        """A linear term of the objective as one row; its limit is what it has besides, negative."""
        return replace(self.family(_of_term(name)), name=name, shape=(1,))

    def limit_of(self, name: str, sums: Mapping[str, float]) -> Family:
        """Rows that limit a sum of letters with factors; a window writes the limits."""
        columns = [_flat(self.columns[letter]) for letter in sums]
        count = len(columns[0])
        values = np.repeat(list(sums.values()), count)
        places = np.tile(np.arange(count), len(columns)), np.concatenate(columns)
        matrix = sp.coo_array((values, places), shape=(count, self.size))
        rows = Linear.constant(matrix, np.zeros(count), self.width)
        return Family(name, rows, MOST, self.columns[next(iter(sums))].shape, tuple(sums))


@dataclass(frozen=True, eq=False)
class Selection:
    """Selection of the statement that a method takes.

    A selection is made by steps, each of which gives another one.
    """

    sheet: Sheet  #: the compiled statement
    #: Rows, sums of rows among them, in the solver's order but for their kind.
    parts: tuple[Family, ...] = ()
    terms: tuple[tuple[Family, float], ...] = ()  #: terms, one row each, with their factors
    maximises: bool = False  #: whether the sum of the terms is maximised
    held: Set[str] = frozenset()  #: letters that are no columns: a window writes their values
    #: Limits of letters that are no whole numbers here.
    relaxed: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    #: Weight of the square of each entry, by letters; they are minimised.
    squares: Mapping[str, Floats] = field(default_factory=dict)
    order: tuple[str, ...] = ()  #: letters that come before the others

    def keep(self, *names: str) -> Selection:
        """Copy with all rows of some families."""
        more = [part for name in names for part in self.sheet.parts(name)]
        return replace(self, parts=(*self.parts, *more))

    def combine(self, name: str, R: Any, kind: str, shape: tuple[int, ...]) -> Selection:
        """Copy with combinations of a family's rows."""
        family = self.sheet.family(name)
        rows = family.rows.times(R)
        letters = tuple(each for each in family.letters if self.sheet.used(each, rows))
        part = Family(name, rows, kind, shape, letters)
        return replace(self, parts=(*self.parts, part))

    def scale(self, name: str, factor: float) -> Selection:
        """Copy with a family's rows multiplied, to have them met as sharply as others."""
        family = self.sheet.family(name)
        count = family.rows.shape[0]
        return self.combine(name, factor * sp.eye_array(count), family.kind, family.shape)

    def limit(self, name: str, sums: Mapping[str, float]) -> Selection:
        """Copy with rows that limit a sum of letters from above; a window writes the limits."""
        return replace(self, parts=(*self.parts, self.sheet.limit_of(name, sums)))

    def limit_term(self, name: str, sign: float = 1.0) -> Selection:
        """Copy with a row that limits a term from above; a window writes the limit.

        With the sign -1 what is limited is the term's negative.
        """
        term = self.sheet.term(name)
        rows = term.rows.times(sp.csr_array([[sign]])) if sign < 0.0 else term.rows
        part = replace(term, rows=rows, kind=MOST)
        return replace(self, parts=(*self.parts, part))

    def polygon(self, name: str, polygon: Polygon, of_size: bool = False) -> Selection:
        """Copy with polygons for a family of discs, a block of rows for each angle.

        Those of exclusive modes may stand for the size of the battery's power, which is the sum of
        charging and discharging: then half of the sides say what all of them do.
        """
        _, cones = self.sheet.family(name).shape
        sides = len(polygon.angles)
        W = self.sheet.n_steps
        item, angle, t = (
            each.ravel() for each in np.indices((cones // max(W, 1), sides, W), dtype=np.int64)
        )
        first = 3 * (item * W + t)
        columns = np.stack([first, first + 1, first + 2], axis=-1)
        values = np.stack(
            [
                np.full(len(first), polygon.reach),
                -np.cos(polygon.angles)[angle],
                -np.sin(polygon.angles)[angle],
            ],
            axis=-1,
        )
        begins = 3 * np.arange(len(first) + 1)
        R = sp.csr_array((values.ravel(), columns.ravel(), begins), shape=(len(first), 3 * cones))
        found = self.combine(name, R, MOST, (sides * W, cones // max(W, 1)))
        if not of_size:
            return found
        *others, part = found.parts
        turned = np.ones(part.rows.shape[1] + 1)
        turned[_flat(self.sheet.columns["P_dch"])] = -1.0
        count = part.rows.shape[0]
        rows = part.rows.times(sp.eye_array(count), sp.csr_array(sp.diags_array(turned)))
        return replace(self, parts=(*others, replace(part, rows=rows)))

    def hold(self, *names: str) -> Selection:
        """Copy with letters held, those that there are, at values that a window writes."""
        there = {name for name in names if name in self.sheet.columns}
        return replace(self, held=self.held | there)

    def relax(self, name: str, lower: float = -np.inf, upper: float = np.inf) -> Selection:
        """Copy with a letter relaxed to real numbers, within other limits."""
        return replace(self, relaxed={**self.relaxed, name: (lower, upper)})

    def relaxed_to_shares(self, names: Sequence[str]) -> Selection:
        """Copy with binaries relaxed to shares."""
        return replace(self, relaxed={**self.relaxed, **dict.fromkeys(names, (0.0, 1.0))})

    def optimise(self, maximises: bool = False, **terms: float) -> Selection:
        """Copy with factors of the terms that there are; others are left out."""
        there = [(n, f) for n, f in terms.items() if n in self.sheet.statement.terms]
        found = tuple((self.sheet.term(name), factor) for name, factor in there)
        return replace(self, terms=found, maximises=maximises)

    @cached_property
    def letters(self) -> list[str]:
        """Letters in the order of their use by terms and rows, those that are held behind them."""
        used = [name for term, _ in self.terms for name in term.letters]
        rows = [name for part in self.parts for name in part.letters]
        inside = {*self.squares, *used, *rows}
        first = (name for name in self.order if name in inside)
        used = [*self.squares, *first, *used, *rows]
        there = [name for name in dict.fromkeys(used) if self.sheet.columns[name].size]
        return sorted(there, key=lambda name: name in self.held)

    def columns(self, limits_first: bool) -> list[str]:
        """Letters that are columns; those with limits come before the others if these are rows."""
        letters = [name for name in self.letters if name not in self.held]
        if not limits_first:
            return letters
        first = {*self.squares, *(name for term, _ in self.terms for name in term.letters)}
        limited = {name for name in letters if np.isfinite(self.limits_of(name)[0]).any()}
        return sorted(letters, key=lambda name: 0 if name in first else 2 - (name in limited))

    def limits_of(self, name: str) -> tuple[Floats, Floats]:
        """Limits of a letter's columns."""
        columns = _flat(self.sheet.columns[name])
        if name in self.relaxed:
            low, high = self.relaxed[name]
            return np.full(len(columns), low), np.full(len(columns), high)
        return self.sheet.lower[columns], self.sheet.upper[columns]

    def limits_as_rows(self) -> Family:
        """Limits of columns as rows, letter by letter."""
        columns, signs, limits = [], [], []
        for name in self.letters:
            if name in self.held:
                continue
            place = _flat(self.sheet.columns[name])
            for sign, limit in zip((-1.0, 1.0), self.limits_of(name), strict=True):
                there = np.isfinite(limit)
                columns.append(place[there])
                signs.append(np.full(there.sum(), sign))
                limits.append(sign * limit[there])
        column = np.concatenate(columns)
        entries = (np.concatenate(signs), (np.arange(len(column)), column))
        matrix = sp.coo_array(entries, shape=(len(column), self.sheet.size))
        rows = Linear.constant(matrix, np.concatenate(limits), self.sheet.width)
        return Family("limits of columns", rows, MOST, (len(column),), ())


class Selected:
    """A selection as a problem: what of it stays the same, and how its numbers are written.

    It is composed when it is asked for the first time.

    ``select`` says what it takes of the statement. A ``conic`` one has limits of columns as rows,
    for a solver that knows no others. ``without`` names letters that it has not, to know how large
    it is before it is composed.
    """

    def __init__(
        self,
        sheet: Sheet,
        select: Callable[[Sheet], Selection],
        conic: bool = False,
        without: Set[str] = frozenset(),
    ) -> None:
        self.sheet = sheet
        self.conic = conic
        self.without = without
        self._select = select
        self.values = np.zeros(0)
        self.value: float = np.nan
        self.duals = np.zeros(0)
        self.limits: dict[str, Floats | float] = {}
        self.held: dict[str, Floats | float] = {}
        self.extras = 0
        self.is_compiled = False
        self._numbers: Numbers | None = None
        self._at: dict[str, Wholes] = {}
        self.added: tuple[sp.csr_array, Floats] | None = None
        """More rows for interior points, on its columns, and the least of each."""

    # What of it stays the same.

    @cached_property
    def selection(self) -> Selection:
        """Selection of the statement that was compiled."""
        return self._select(self.sheet)

    @property
    def statement(self) -> Statement:
        """The statement that it is a selection of."""
        return self.sheet.statement

    def compile(self) -> None:
        """Compose it, if it is not yet."""
        if self.is_compiled:
            return
        selection = self.selection
        ranked = {kind: [p for p in selection.parts if p.kind == kind] for kind in (EQUAL, MOST)}
        cones = [part for part in selection.parts if part.kind == CONE]
        self._keep_columns()
        bounds = [selection.limits_as_rows()] if self.conic else []
        # From all columns, and the limits behind them, to those of the problem.
        size = len(self._global)
        places = (np.append(self._global, self.sheet.size), np.arange(size + 1))
        T = sp.csr_array((np.ones(size + 1), places), shape=(self.sheet.size + 1, size + 1))
        self.parts = [*ranked[EQUAL], *bounds, *ranked[MOST], *cones]
        stacked = [self._ready(part) for part in self.parts]
        rows = Linear.stacked(stacked).times(sp.eye_array(sum(r.shape[0] for r in stacked)), T)
        zero = sum(part.rows.shape[0] for part in ranked[EQUAL])
        discs = [3] * sum(part.shape[1] for part in cones)
        self.dims = Dims(zero, rows.shape[0] - zero - 3 * len(discs), discs)
        self._keep_rows(rows)
        ends = np.cumsum([part.rows.shape[0] for part in self.parts])
        self.rows_of = {
            part.name: slice(int(end) - part.rows.shape[0], int(end))
            for part, end in zip(self.parts, ends, strict=True)
        }
        self.factors = {term.name: factor for term, factor in selection.terms}
        one = sp.csr_array(np.ones((1, 1)))
        self._terms = {term.name: self._ready(term).times(one, T) for term, _ in selection.terms}
        self.is_compiled = True

    def _ready(self, part: Family) -> Linear:
        """Rows on all columns and on all that a window writes."""
        return part.rows.wider(self.sheet.size).written(self.sheet.width + self.extras)

    def _keep_columns(self) -> None:
        """Letters in the solver's order, with their limits and which are whole numbers."""
        sheet = self.sheet
        selection = self.selection
        held = [name for name in selection.letters if name in selection.held]
        letters = selection.columns(limits_first=self.conic)
        places = [sheet.columns[name] for name in (*letters, *held)]
        self._global = np.concatenate([np.zeros(0, dtype=np.int64), *(_flat(p) for p in places)])
        starts = np.cumsum([0, *(place.size for place in places)])
        self.first = {name: int(at) for name, at in zip(letters, starts, strict=False)}
        self._held = held
        lower, upper = ([selection.limits_of(name)[k] for name in letters] for k in (0, 1))
        self.x_lower = np.concatenate([np.zeros(0), *lower])
        self.x_upper = np.concatenate([np.zeros(0), *upper])
        self.binaries = [n for n in letters if sheet.whole[n] and n not in selection.relaxed]
        whole = (_flat(self.at(name)) for name in self.binaries)
        self.whole = np.concatenate([np.zeros(0, dtype=np.int64), *whole])

    def _keep_rows(self, rows: Linear) -> None:
        """The pattern of the rows, and the map from parameters to their numbers.

        What is held goes to the limits, number by number: their sums keep the order of parameters.
        """
        count = rows.shape[0]
        free = len(self.x_lower)
        inside = rows.column < free
        self._entries = sp.csr_array(rows.by[inside])
        begins = np.searchsorted(rows.column[inside], np.arange(free + 1)).astype(np.int32)
        places = rows.row[inside].astype(np.int32)
        self._pattern = sp.csc_array((np.ones(len(places)), places, begins), shape=(count, free))
        by = rows.by[~inside].tocoo()
        row, column = rows.row[~inside][by.row], rows.column[~inside][by.row]
        order = np.lexsort((by.col, row))
        ends = np.searchsorted(row[order], np.arange(count + 1))
        entries = (by.data[order], by.col[order], ends)
        self._limits_by = sp.csr_array(entries, shape=(count, by.shape[1]))
        # The limits themselves stand behind all letters.
        self._limits_of = column[order] - free

    @property
    def entries(self) -> int:
        """Numbers that it has as columns and in rows, before it is composed."""
        statement = self.sheet.statement
        families = statement.families.items()
        own = sum(int(c.size) for n, c in families if not statement.letters_of(n) & self.without)
        kept = (x for name, x in statement.letters.items() if name not in self.without)
        return own + sum(int(x.size) for x in kept)

    def row_lower(self, limit: Floats) -> Floats:
        """Lower ends of the rows of a problem without cones, (m,): its equalities come first."""
        lower = np.full(len(limit), -np.inf)
        lower[: self.dims.zero] = limit[: self.dims.zero]
        return lower

    # What a window writes.

    def fill(self, data: WindowData, served: Flags | None = None) -> None:
        """Write a window's data, and a supply schedule where service is held.

        What a restoration adds to its demand is in the data then.
        """
        self.values = self.statement.write(data)
        if served is not None:
            by_service = self.statement.named("by_service")
            self.held |= {"x_served": served.astype(float), **dict.fromkeys(by_service, 0.0)}

    def numbers(self) -> Numbers:
        """The numbers of the window that was written last.

        Raises
        ------
        NumericalError
            If they are no numbers.
        """
        self.compile()
        rows = copy(self._pattern)
        rows.data = self._entries @ self.values
        shapes = ((name, self.sheet.columns[name].shape) for name in self._held)
        of_held = (_flat(np.broadcast_to(self.held[name], shape)) for name, shape in shapes)
        held = np.concatenate([np.zeros(0), *of_held])
        limits = copy(self._limits_by)
        limits.data = limits.data * np.append(-held, 1.0)[self._limits_of]
        limit = np.asarray(limits @ self.values)
        for name, value in self.limits.items():
            if name in self.rows_of:
                limit[self.rows_of[name]] += np.ravel(value, order="F")
        cost = np.zeros(len(self._global))
        offset = 0.0
        sign = -1.0 if self.selection.maximises else 1.0
        for name, term in self._terms.items():
            entries = sign * self.factors[name] * (term.by @ self.values)
            inside = term.column < len(cost)
            cost[term.column[inside]] += entries[inside]
            offset -= float(np.sum(entries[~inside]))
        offset += float(cost[len(cost) - len(held) :] @ held)
        cost = cost[: len(cost) - len(held)]
        self._numbers = checked(Numbers(self._squares, cost, offset, rows, limit))
        return self._numbers

    def numbers_of(self, name: str) -> tuple[sp.csr_array, Floats]:
        """A family on the problem's columns, whether it has it or not: rows, and what is known.

        They are those of the window that was written last, with what is held put in: what has to
        be 0, or no more, is ``rows @ x + known``.
        """
        part = self._ready(self.sheet.family(name))
        size = self.sheet.size
        x = np.zeros(size + 1)
        x[-1] = -1.0
        place = np.full(size + 1, -1)
        for letter, columns in self.sheet.columns.items():
            if letter in self.first:
                place[columns] = self.at(letter)
            elif letter in self.held:
                x[columns] = self.held[letter]
        values = part.by @ self.values
        free = place[part.column] >= 0
        entries = (values[free], (part.row[free], place[part.column[free]]))
        rows = sp.csr_array(sp.coo_array(entries, shape=(part.shape[0], len(self.x_lower))))
        known = values[~free] * x[part.column[~free]]
        return rows, np.bincount(part.row[~free], known, part.shape[0]).astype(float)

    @property
    def offset(self) -> float:
        """Constant of the objective of the window that was written last, as a minimum."""
        assert self._numbers is not None
        return self._numbers.offset

    def shown(self, rows: sp.csr_array) -> sp.csr_array:
        """Rows on its columns as the solver has these."""
        return rows

    @cached_property
    def _absent(self) -> dict[str, Floats]:
        """No values of the letters that are no columns."""
        letters = self.statement.letters.items()
        return {name: np.full(x.shape, np.nan) for name, x in letters if name not in self.first}

    @cached_property
    def _squares(self) -> sp.csc_array:
        """Twice the weights of squares, by columns."""
        weights = np.zeros(len(self.x_lower))
        for name, weight in self.selection.squares.items():
            weights[self.at(name)] = 2.0 * weight
        return diagonal_of(weights)

    # What a solution says.

    def at(self, name: str) -> Wholes:
        """Columns of a letter in its shape."""
        if name not in self._at:
            shape = self.sheet.columns[name].shape
            size = int(np.prod(shape))
            first = self.first[name] if size else 0
            self._at[name] = first + np.arange(size).reshape(shape, order="F")
        return self._at[name]

    def value_of(self, name: str) -> Floats:
        """Values of a letter in the last solution, in its shape."""
        return np.asarray(self.statement.letters[name].value)

    def dispatch(self, served: Flags | None = None) -> Dispatch:
        """The last solution, of a supply schedule if service is held."""
        return self.statement.dispatch(served)

    def own_value(self) -> float:
        """Value of the page's own term of F in the last solution."""
        term = self.statement.terms.get("own")
        return 0.0 if term is None else float(term.value)

    def own_letters(self) -> dict[str, Floats]:
        """Values of the whole numbers that only the page has in the last solution."""
        return {name: self.value_of(name) for name in self.sheet.own_whole}

    def both_ways_kw(self) -> Floats:
        """Power that the last solution imports and exports at the same time, (W,)."""
        imported = np.maximum(self.value_of("P_grid"), 0.0)
        found = [each.both_ways_kw(imported) for each in self.statement.additions]
        return np.sum(found, axis=0) if found else np.zeros_like(imported)

    def put(self, x: Floats) -> None:
        """Give the statement's letters, and the problem, the values of a solution."""
        n = self._numbers
        assert n is not None
        least = float(n.cost @ x + n.squares.diagonal() @ (x * x) / 2.0) + self.offset
        self.value = -least if self.selection.maximises else least
        self.x = x
        within = np.clip(x, self.x_lower, self.x_upper)
        within[self.whole] = np.round(within[self.whole])
        values = dict(self._absent)
        for name in self.first:
            if name in self.statement.letters:
                values[name] = within[self.at(name)]
        for name, value in self.held.items():
            if name in self._absent:
                values[name] = np.broadcast_to(value, self._absent[name].shape).astype(float)
        self.statement.put(values)


@dataclass(frozen=True)
class Dims:
    """Rows of each kind: equalities, limits, and the sizes of second-order cones."""

    zero: int
    nonneg: int
    soc: list[int]


def diagonal_of(values: Floats) -> sp.csc_array:
    """A square array with values on its diagonal, those that are not zero."""
    there = np.flatnonzero(values)
    begins = np.append(0, np.cumsum(values != 0.0))
    return sp.csc_array((values[there], there, begins), shape=(len(values), len(values)))


def _of_term(name: str) -> str:
    """Name of the row of a term: no family has it."""
    return f"term {name}"


def _letters(constraint: cp.Constraint) -> tuple[str, ...]:
    """Letters in the order of their use."""
    return tuple(dict.fromkeys(x.name() for x in constraint.variables()))


def _joins(constraint: cp.Constraint) -> bool:
    """Whether a constraint is compiled with others: all of its columns are letters."""
    known = isinstance(constraint, cp.SOC | Equality | Inequality)
    return known and all(each.is_affine() for each in constraint.args)


def _kind(constraint: cp.Constraint) -> tuple[str, tuple[int, ...]]:
    """Kind and shape of its rows."""
    if isinstance(constraint, cp.SOC):
        return CONE, (3, constraint.args[0].size)
    kind = EQUAL if isinstance(constraint, Equality) else MOST
    return kind, tuple(constraint.shape)


def _flat(columns: Wholes) -> Wholes:
    """Columns in cvxpy's order."""
    return np.ravel(columns, order="F")


def _bounds(x: cp.Variable) -> tuple[Floats, Floats]:
    """Limits of a variable's entries by its attributes."""
    lower = np.full(x.size, -np.inf)
    upper = np.full(x.size, np.inf)
    if x.attributes["nonneg"] or x.attributes["boolean"]:
        lower[:] = 0.0
    if x.attributes["boolean"]:
        upper[:] = 1.0
    if x.attributes["bounds"]:
        low, high = (np.broadcast_to(each, x.shape) for each in x.attributes["bounds"])
        lower, upper = low.ravel(order="F").astype(float), high.ravel(order="F").astype(float)
    return lower, upper


def _is_whole(x: cp.Variable) -> bool:
    """Whether a variable's entries are whole numbers."""
    return bool(x.attributes["boolean"] or x.attributes["integer"])

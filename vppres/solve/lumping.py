"""Rows of single devices added up, and one column for each sum of theirs.

A row that is added up over the devices holds for their sum wherever it holds for each. A sum whose
terms have the same factor in a row is a column. Where factors differ, as those of efficiencies do,
``s = sum(a_i x_i)`` is a column of its own between the least and the largest factor times the sum,
which holds since no ``x_i`` is negative. So what is lumped is a relaxation of what is not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import maximum_bipartite_matching

from vppres.core.arrays import Flags, Floats, Wholes
from vppres.model.numerics import SAME
from vppres.solve.compiled import Linear
from vppres.solve.selection import MOST, Family, Sheet

DIGITS = 14
"""Digits of a factor that its products keep."""


@dataclass(frozen=True, eq=False)
class Lump:
    """Columns of k devices in n places, (k, n), the columns of their sums, (n,), and weights."""

    members: Wholes
    sums: Wholes
    weight: Floats


class Lumping:
    """Adds up the rows and columns of devices.

    The sheet gets a letter for each sum. ``letters`` are added up over their last axis, with the
    weights of the devices in the sum.

    Attributes
    ----------
    ranges : list of str
        Letters of sums with factors that differ.
    """

    def __init__(self, sheet: Sheet, letters: Mapping[str, Floats]) -> None:
        self.sheet = sheet
        self.lumps: list[Lump] = []
        self.names = list(letters)
        for name, weight in letters.items():
            members = np.moveaxis(sheet.columns[name], -1, 0).reshape(len(weight), -1)
            free = not (sheet.lower[members] == 0.0).all()
            sums = sheet.new_letter(f"all {name}", members.shape[1:], -np.inf if free else 0.0)
            self.lumps.append(Lump(members, sums.ravel(), weight))
        self.ranges: list[str] = []
        self._known: dict[tuple[object, ...], tuple[int, float]] = {}
        self._ranges: list[ScaledSum] = []
        self._written: list[tuple[bool, sp.csr_array]] = []
        self.extras = 0

    def over_devices(self, family: Family, weight: Floats) -> Family:
        """A family added up over its last axis with weights."""
        n = int(np.prod(family.shape[:-1]))
        R = sp.csr_array(sp.kron(weight[None, :], sp.eye_array(n)))
        rows = _tidy(family.rows.times(R))
        limited = rows.column == rows.shape[1]
        if (np.diff(rows.by.indptr)[limited] > 1).any():
            rows = self._with_written_limits(rows, limited)
        elif limited.any() and (rows.by[limited].indices == self.sheet.width - 1).all():
            # As numpy adds up, which decides the last bit.
            before = family.rows
            last = before.column == before.shape[1]
            each = np.zeros(before.shape[0])
            each[before.row[last]] = before.by[last][:, [self.sheet.width - 1]].toarray().ravel()
            sums = np.ascontiguousarray(each.reshape(len(weight), n).T * weight).sum(axis=1)
            rows.by.data[rows.by.indptr[:-1][limited]] = sums[rows.row[limited]]
        return replace(family, rows=rows, shape=(n, 1))

    def _with_written_limits(self, rows: Linear, limited: Flags) -> Linear:
        """Sums of the devices' data as one number each, which a window writes."""
        number = np.flatnonzero(limited)
        first = self._write(False, *(sp.csr_array(rows.by[[entry]]) for entry in number))
        places = (number, self.sheet.width + first + np.arange(len(number)))
        width = self.sheet.width + self.extras
        sums = sp.csr_array((np.ones(len(number)), places), shape=(len(limited), width))
        others = sp.csr_array(sp.diags_array((~limited).astype(float)) @ rows.by)
        others.eliminate_zeros()
        wider = replace(rows, by=others).written(width)
        return replace(wider, by=sp.csr_array(wider.by + sums))

    def _write(self, is_range: bool, *factors: sp.csr_array) -> int:
        """Place of the first number of some that a window writes behind the statement's values."""
        first = self.extras
        self._written += [(is_range, each) for each in factors]
        self.extras += len(factors) * (2 if is_range else 1)
        return first

    def of(self, family: Family) -> Family | None:
        """A family on the sums; None if some row tells devices apart that a sum does not."""
        rows = family.rows
        letters = [name for name in family.letters if name not in self.names]
        for name, lump in zip(self.names, self.lumps, strict=True):
            before = rows
            lumped = self._lumped(rows, name, lump)
            if lumped is None:
                return None
            rows = lumped
            if rows is not before:
                new = (f"all {name}", f"range {name}")
                there = (each for each in new if each in self.sheet.columns)
                letters += [each for each in there if self.sheet.used(each, rows)]
        return replace(family, rows=rows, letters=tuple(letters))

    def _blocks(self, rows: Linear, lump: Lump) -> tuple[Wholes, Wholes] | None:
        """Entries of each sum, (blocks, k), and its place; None if a row lacks some device."""
        k, n = lump.members.shape
        place = np.full(rows.shape[1] + 1, -1, dtype=np.int64)
        place[lump.members.T.ravel()] = np.arange(k * n)
        where = place[rows.column]
        inside = np.flatnonzero(where >= 0)
        if len(inside) % k:
            return None
        blocks = inside[np.lexsort((where[inside], rows.row[inside]))].reshape(-1, k)
        group = where[blocks] // k
        row = rows.row[blocks]
        same = (group == group[:, :1]).all() and (row == row[:, :1]).all()
        return (blocks, group[:, 0]) if same else None

    def _lumped(self, rows: Linear, name: str, lump: Lump) -> Linear | None:
        """Rows with the sums of one letter; None if some row tells devices apart."""
        rows = rows.wider(self.sheet.size)
        found = self._blocks(rows, lump)
        if found is None:
            return None
        blocks, group = found
        if not len(blocks):
            return rows
        k = len(lump.members)
        weights = sp.diags_array(np.tile(1.0 / lump.weight, len(blocks)))
        by = sp.csr_array(weights @ rows.by[blocks.ravel()])
        uniform = _uniform(by, len(blocks), k, self.sheet.width - 1)
        if not uniform.all() and (self.sheet.lower[lump.members] < 0.0).any():
            return None
        signs = np.ones(len(blocks))
        columns = lump.sums[group]
        for number in np.flatnonzero(~uniform).tolist():
            part = sp.csr_array(by[number * k : (number + 1) * k])
            columns[number], signs[number] = self._range(name, int(columns[number]), part)
        first = sp.csr_array(by[np.arange(len(blocks)) * k])
        places = np.arange(len(signs)), np.full(len(signs), self.sheet.width - 1)
        one = sp.csr_array((signs, places), shape=(len(signs), rows.by.shape[1]))
        new = sp.csr_array(
            sp.diags_array(uniform.astype(float)) @ first
            + sp.diags_array((~uniform).astype(float)) @ one
        )
        others = np.setdiff1d(np.arange(len(rows.row)), blocks)
        rest = rows.wider(self.sheet.size)
        return Linear(
            np.append(rest.row[others], rows.row[blocks[:, 0]]),
            np.append(rest.column[others], columns),
            sp.csr_array(sp.vstack([rows.by[others], new])),
            rest.shape,
        )

    def _range(self, name: str, of: int, factors: sp.csr_array) -> tuple[int, float]:
        """Column of a sum with factors of its own, and the sign with which it stands for them."""
        factors.sort_indices()
        sign = 1.0 if factors.data[0] > 0.0 else -1.0
        data = sign * factors.data
        digits = np.round(data / np.abs(data).max(), 10)
        key = (of, factors.indices.tobytes(), digits.tobytes(), round(float(data[0]), 12))
        if key not in self._known:
            letter = f"range {name}"
            column = self.sheet.longer_letter(letter)
            if letter not in self.ranges:
                self.ranges.append(letter)
            self._known[key] = column, sign
            first = self._write(True, sp.csr_array(sign * factors))
            self._ranges.append(ScaledSum(letter, column, of, first))
        return self._known[key][0], sign

    def range_rows(self) -> list[Family]:
        """Sums between the least and the largest factor; the factors are a window's."""
        found = []
        for letter in self.ranges:
            ranges = [each for each in self._ranges if each.letter == letter]
            found.append(self._limits("least", ranges, 0))
            found.append(self._limits("largest", ranges, 1))
        return found

    def _limits(self, name: str, ranges: Sequence[ScaledSum], which: int) -> Family:
        """Sums of a letter at least, or at most, so many times the letter's sum."""
        count = len(ranges)
        width = self.sheet.width
        sign = 2.0 * which - 1.0
        factor = [width + each.first + which for each in ranges]
        places = (np.arange(2 * count), np.append(np.full(count, width - 1), factor))
        values = np.repeat([sign, -sign], count)
        by = sp.csr_array((values, places), shape=(2 * count, width + self.extras))
        columns = np.array([each.column for each in ranges] + [each.of for each in ranges])
        rows = Linear(np.tile(np.arange(count), 2), columns, by, (count, self.sheet.size))
        letter = ranges[0].letter.removeprefix("range ")
        letters = (ranges[0].letter, f"all {letter}")
        return Family(f"{name} {letter}", rows, MOST, (count,), letters)

    def written(self, values: Floats) -> Floats:
        """Values that a window writes behind the statement's: sums, and ranges of factors."""
        found = []
        for is_range, factors in self._written:
            data = factors.data * values[factors.indices]
            if is_range:
                each = np.add.reduceat(data, factors.indptr[:-1])
                found += [each.min(), each.max()]
            else:
                found.append(data.sum())
        return np.array(found)


@dataclass(frozen=True)
class ScaledSum:
    """A sum with factors of its own: its column, that of the sum itself, where they are written."""

    letter: str
    column: int
    of: int
    first: int


def _tidy(rows: Linear) -> Linear:
    """Rows whose factors lost the last bit of a weight and its inverse."""
    by = rows.by.copy()
    size = 10.0 ** (DIGITS - np.ceil(np.log10(np.abs(by.data))))
    by.data = np.round(by.data * size) / size
    return replace(rows, by=by)


def _uniform(by: sp.csr_array, blocks: int, k: int, last: int) -> Flags:
    """Blocks of k entries that are the same number, whatever the parameters."""
    constant = by[:, [last]].toarray().ravel().reshape(blocks, k)
    alone = (np.diff(by.indptr) == 1).reshape(blocks, k).all(axis=1)
    alone &= (constant != 0.0).all(axis=1)
    size = np.abs(constant).max(axis=1, initial=0.0)
    same: Flags = alone & (np.ptp(constant, axis=1) <= SAME * size)
    return same


def eliminated(
    sheet: Sheet, families: Sequence[Family], names: Sequence[str], by: Sequence[Family]
) -> list[Family]:
    """Families without some letters, which equalities determine one after the other.

    Each equality has a constant factor for the letter that it determines.
    """
    columns = np.concatenate([np.ravel(sheet.columns[name], order="F") for name in names])
    size = sheet.size
    equal = Linear.stacked([family.rows.wider(size) for family in by])
    gone = np.zeros(size + 1, dtype=bool)
    gone[columns] = True
    determining = equal.constants(sheet.width - 1)[:, columns]
    own = maximum_bipartite_matching(determining, perm_type="column")
    determining = determining[:, own]
    factor = sp.diags_array(1.0 / determining.diagonal())
    before = sp.csr_array(sp.triu(determining, 1) + sp.tril(determining, -1))
    every = [name for family in (*families, *by) for name in family.letters if name not in names]
    letters = list(dict.fromkeys(every))
    found = []
    for family in families:
        rows = family.rows.wider(size)
        left = rows.constants(sheet.width - 1)[:, columns[own]]
        if left.nnz:
            R = sp.csr_array(left.shape)
            while left.nnz:
                times = sp.csr_array(left @ factor)
                R = R - times
                left = sp.csr_array(-(times @ before))
                left.eliminate_zeros()
            both = sp.hstack([sp.eye_array(rows.shape[0], format="csr"), R])
            result = Linear.stacked([rows, equal]).times(both)
            # What cancels but for rounding.
            stays = ~gone[result.column]
            by_row = sp.csr_array(result.by[stays])
            rows = Linear(result.row[stays], result.column[stays], by_row, result.shape)
            used = tuple(name for name in letters if sheet.used(name, rows))
            family = replace(family, rows=rows, letters=used)
        found.append(family)
    return found

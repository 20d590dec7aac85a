"""Switching rules as rows of arrays: families of the statement on service alone."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from vppres.model.data import WindowData
from vppres.solve.cache import ModelCache
from vppres.solve.forms import sheet_of
from vppres.solve.linear import Linear
from vppres.solve.network.rows import Rows
from vppres.solve.selection import EQUAL

LETTERS = {
    "x": "x_served",
    "on": "y_on",
    "off": "y_off",
    "cold": "z_cold",
    "beyond": "beyond",
}
"""The statement's letters of the columns of a window in the network that rules join."""


def rows_of_rules(cache: ModelCache, data: WindowData) -> Rows | None:
    """Rows of a window's switching rules on the columns of ``LETTERS`` side by side, if any.

    The steps of a customer come in turn.
    """
    if data.switching is None:
        return None
    sheet = sheet_of(cache, data)
    values = sheet.statement.write(data)
    names = [name for name in sheet.statement.families if name in sheet.statement.rules]
    parts = [part for name in names for part in sheet.parts(name)]
    parts.sort(key=lambda part: part.kind != EQUAL)
    rows = Linear.stacked([part.rows.wider(sheet.size) for part in parts])
    inside = rows.column < rows.shape[1]
    entries = rows.by @ values
    matrix = sp.csr_array(
        (entries[inside], (rows.row[inside], rows.column[inside])), shape=rows.shape
    )
    upper = np.zeros(rows.shape[0])
    upper[rows.row[~inside]] = entries[~inside]
    equal = np.concatenate([np.full(p.rows.shape[0], p.kind == EQUAL) for p in parts])
    letters = [name for name in LETTERS.values() if name in sheet.columns]
    places = np.concatenate([np.ravel(sheet.columns[name], order="F") for name in letters])
    return Rows(sp.csr_array(matrix[:, places]), np.where(equal, upper, -np.inf), upper)

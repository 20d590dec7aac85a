"""MATLAB's binary files in a process of their own: the tables of a MATPOWER case, and no more.

The format holds data only, but its writer chooses how deep and how large it unpacks.
"""

from __future__ import annotations

import base64
import io
from typing import Any

import numpy as np
import scipy.io

TABLES = ("baseMVA", "bus", "gen", "branch")
MORE = ("dcline",)
"""Tables that a case may have; of texts it has ``genfuel``, the generators' fuels."""


def answer(job: dict[str, Any]) -> dict[str, Any]:
    """The tables of the struct ``mpc``, or why there are none."""
    content: Any = io.BytesIO(base64.b64decode(job["content"]))
    try:
        case = scipy.io.loadmat(
            content, squeeze_me=True, struct_as_record=False, variable_names=["mpc"]
        )["mpc"]
        names = (*TABLES, *(name for name in MORE if hasattr(case, name)))
        tables = {name: np.asarray(getattr(case, name), dtype=float).tolist() for name in names}
        fuels = [str(one) for one in np.atleast_1d(getattr(case, "genfuel", []))]
        return {"version": str(case.version), "tables": tables, "fuels": fuels}
    except Exception as error:  # whatever the reader stumbles over, the file is the cause
        return {"error": f"{type(error).__name__}: {error}"}

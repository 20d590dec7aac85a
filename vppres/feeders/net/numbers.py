"""Numbers that elements of a net must have: without one, an element would vanish in a sum."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.errors import Problem
from vppres.feeders.net.elements import in_service, label

_BY_PHASE = ("p_a_mw", "q_a_mvar", "p_b_mw", "q_b_mvar", "p_c_mw", "q_c_mvar")
_WINDINGS = ("hv", "mv", "lv")
NEEDED = {
    "bus": ("vn_kv",),
    "ext_grid": ("vm_pu",),
    "load": ("p_mw", "q_mvar", "scaling"),
    "sgen": ("p_mw", "q_mvar", "scaling"),
    "gen": ("p_mw", "vm_pu", "scaling"),
    "storage": ("p_mw", "q_mvar", "scaling"),
    "motor": ("pn_mech_mw", "loading_percent", "efficiency_percent", "cos_phi"),
    "ward": ("ps_mw", "qs_mvar", "pz_mw", "qz_mvar"),
    "shunt": ("p_mw", "q_mvar"),
    "asymmetric_load": _BY_PHASE,
    "asymmetric_sgen": _BY_PHASE,
    "line": ("length_km", "r_ohm_per_km", "x_ohm_per_km", "c_nf_per_km"),
    "trafo": (
        "sn_mva",
        "vn_hv_kv",
        "vn_lv_kv",
        "vk_percent",
        "vkr_percent",
        "pfe_kw",
        "i0_percent",
    ),
    "trafo3w": (
        *(
            f"{name}_{side}_{unit}"
            for name, unit in (("sn", "mva"), ("vn", "kv"))
            for side in _WINDINGS
        ),
        *(f"{name}_{side}_percent" for name in ("vk", "vkr") for side in _WINDINGS),
        "pfe_kw",
        "i0_percent",
    ),
    "impedance": ("rft_pu", "xft_pu", "rtf_pu", "xtf_pu", "sn_mva"),
}
"""Columns of each table that must be finite numbers for elements in service."""

ROUNDING = 1e-9

POSITIVE = ("vn_kv", "vn_hv_kv", "vn_mv_kv", "vn_lv_kv", "vm_pu")
"""Those that must be above zero too."""


BUS_COLUMNS = ("bus", "from_bus", "to_bus", "hv_bus", "mv_bus", "lv_bus")
"""Columns that name buses."""


def unknown_buses(net: Any, name: str) -> Iterator[Problem]:
    """Elements in service at a bus that the net lacks; parameters as of :func:`missing_numbers`."""
    for table in (*NEEDED, "switch"):
        frame = in_service(net, table) if table in net and table != "bus" else pd.DataFrame()
        for column in frame.columns.intersection([*BUS_COLUMNS]):
            for i in frame.index[~frame[column].isin(net.bus.index)]:
                yield Problem(
                    name,
                    "is not a bus of the net",
                    "Correct it in the source, or take the element out of service.",
                    field=f"{label(net, table, i)}, {column}",
                    value=frame[column].at[i],
                )


def impossible_numbers(net: Any, name: str) -> Iterator[Problem]:
    """Elements in service whose numbers contradict each other; parameters as above.

    A transformer needs an impedance that is no less than its resistance, and a load has shares of
    impedance and current of at most all of it.
    """
    pairs = [("trafo", "vk_percent", "vkr_percent")]
    pairs += [("trafo3w", f"vk_{side}_percent", f"vkr_{side}_percent") for side in _WINDINGS]
    for table, impedance, resistance in pairs:
        rows = in_service(net, table)
        vk, vkr = (rows[column].astype(float) for column in (impedance, resistance))
        for i in rows.index[(vk == 0) | (vk.abs() * (1.0 + ROUNDING) < vkr.abs())]:
            yield Problem(
                name,
                f"is no impedance for {resistance} = {vkr[i]:g}",
                f"Give {impedance} above 0, and at least {resistance}.",
                field=f"{label(net, table, i)}, {impedance}",
                value=vk[i],
            )
    loads = in_service(net, "load")
    for power in ("p", "q"):
        columns = [f"const_{kind}_{power}_percent" for kind in "zi"]
        share = loads.reindex(columns=columns).astype(float).fillna(0.0).sum(axis=1)
        for i in loads.index[share > 100.0]:
            yield Problem(
                name,
                "are more than all of the load",
                "Give shares that add up to 100 at most.",
                field=f"{label(net, 'load', i)}, {' + '.join(columns)}",
                value=share[i],
            )


def missing_numbers(net: Any, name: str) -> Iterator[Problem]:
    """Cells of elements in service that hold no finite number, or none above zero.

    ``name`` is the source's, for messages.
    """
    for table, columns in NEEDED.items():
        frame = in_service(net, table) if table in net else pd.DataFrame()
        for column in frame.columns.intersection([*columns]):
            values = pd.to_numeric(frame[column], errors="coerce").astype(float)
            least = 0.0 if column in POSITIVE else -np.inf
            for i in frame.index[~(np.isfinite(values) & (values > least))]:
                yield Problem(
                    name,
                    f"is not a {'positive' if column in POSITIVE else 'finite'} number",
                    "Correct it in the source, or take the element out of service.",
                    field=f"{label(net, table, i)}, {column}",
                    value=frame[column].at[i],
                )

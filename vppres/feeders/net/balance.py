"""Loads and generators of single phases spread over three, and how far they are from it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.units import mw_to_kw
from vppres.feeders.net.elements import in_service, tier_column, tiers_of

PHASES = ("a", "b", "c")
# Table of phases, the balanced one in its place, and what it holds.
TABLES = (("asymmetric_load", "load", "loads"), ("asymmetric_sgen", "sgen", "static generators"))
CURE = (
    "The model is balanced: --balance spreads every load over three phases, and says how far from "
    "that the source is."
)


@dataclass(frozen=True, eq=False)
class PhasePowers:
    """Active power that each bus draws on each phase, columns ``a``, ``b`` and ``c``.

    ``what`` is not balanced, as ``12 of 15 loads``.
    """

    what: str
    p_kw: pd.DataFrame


def balanced(found: PhasePowers) -> str:
    """The note on what balancing leaves out."""
    return f"Balanced on request (--balance): {found.what}. {unbalance(found.p_kw)}"


def unbalance(p_kw: pd.DataFrame) -> str:
    """Active power of the phases, and the bus where they differ most.

    Examples
    --------
    >>> print(unbalance(pd.DataFrame({"a": [5.0, 0.0], "b": [2.0, 1.0], "c": [2.0, 1.0]}, [7, 8])))
    Phases draw 5.0, 3.0 and 3.0 kW in all; they differ most at bus 7, by 3.0 kW: 5.0, 2.0 and 2.0.
    """
    p_kw = p_kw.groupby(level=0, sort=False).sum()
    spread = (p_kw.max(axis=1) - p_kw.min(axis=1)).to_numpy()
    worst = int(np.argmax(spread))
    return (
        f"Phases draw {_three(p_kw.sum())} kW in all; they differ most at bus "
        f"{p_kw.index[worst]}, by {spread[worst]:.1f} kW: {_three(p_kw.iloc[worst])}."
    )


def _three(values: pd.Series[float]) -> str:
    a, b, c = (f"{values[phase]:.1f}" for phase in PHASES)
    return f"{a}, {b} and {c}"


def phase_powers(net: Any) -> PhasePowers | None:
    """Power of loads and generators of single phases; None if a net has none."""
    words = []
    powers = []
    for table, plain, plural in TABLES:
        frame = _by_phase(net, table)
        if frame.empty:
            continue
        words.append(
            f"{len(frame)} {plural} by phase beside {len(in_service(net, plain))} of three"
        )
        sign = 1.0 if plain == "load" else -1.0
        powers.append(sign * _phase_kw(frame))
    return PhasePowers(", ".join(words), pd.concat(powers)) if words else None


def balance_net(net: Any) -> Iterator[str]:
    """Replace loads and generators of single phases in place, and say what that leaves open."""
    found = [(table, plain, _by_phase(net, table)) for table, plain, _ in TABLES]
    for table, plain, frame in found:
        if not frame.empty:
            _replace(net, frame, plain)
            net[table].loc[frame.index, "in_service"] = False
    if not all(frame.empty for _, _, frame in found):
        yield "Voltages are compared with the net so balanced, not with its flow phase by phase."


def _by_phase(net: Any, table: str) -> pd.DataFrame:
    """Elements of a table of phases that are in service."""
    return in_service(net, table) if table in net else pd.DataFrame()


def _phase_kw(frame: pd.DataFrame) -> pd.DataFrame:
    """Active power of each element on each phase, by bus."""
    scaling = frame["scaling"].fillna(1.0)
    columns = {phase: mw_to_kw(frame[f"p_{phase}_mw"] * scaling) for phase in PHASES}
    return pd.DataFrame(columns, index=frame["bus"].to_numpy())


def _replace(net: Any, frame: pd.DataFrame, plain: str) -> None:
    """Replace powers by phase by their sums."""
    import pandapower as pp

    create = pp.create_load if plain == "load" else pp.create_sgen
    column = tier_column(net[plain]) or "tier"
    for tier, (i, row) in zip(tiers_of(frame), frame.iterrows(), strict=True):
        new = create(
            net,
            int(row["bus"]),
            p_mw=float(sum(row[f"p_{phase}_mw"] for phase in PHASES)),
            q_mvar=float(sum(row[f"q_{phase}_mvar"] for phase in PHASES)),
            scaling=float(row["scaling"]),
            name=row["name"] if isinstance(row["name"], str) else f"{plain} by phase {i}",
            **({"type": row["type"]} if plain == "sgen" else {}),
        )
        if tier:
            net[plain].loc[new, column] = tier

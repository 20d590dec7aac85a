"""Generators and batteries of a pandapower net, with what was assumed where it says nothing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.text import named
from vppres.core.units import mw_to_kw
from vppres.feeders.feeder import Generators, Loads, Storages
from vppres.feeders.net.elements import NetCase, label, supplied, tiers_of
from vppres.scenario.network import BusId

HOURS_OF_STORAGE = 2.0
"""Energy over power where the source gives one of the two (the ratio of the paper's fleet)."""

ETA = 0.95
"""Efficiency each way where the source gives none (the format's default)."""


def generators_of(net: Any, case: NetCase, ids: Mapping[int, BusId]) -> Generators:
    """Static generators, and generators with the reactive power that the last flow gave them."""
    tables = [_generators(net, table, case, ids) for table in ("sgen", "gen")]
    # An empty frame has no say in the types of the columns.
    filled = [table for table in tables if len(table)] or tables[:1]
    columns = pd.concat(filled, ignore_index=True)
    return Generators(**{str(name): columns[name].to_numpy() for name in columns})


def _generators(net: Any, table: str, case: NetCase, ids: Mapping[int, BusId]) -> pd.DataFrame:
    """One table of generators; an element without a word of its own is known by its name."""
    frame = supplied(net, table, case)
    scaling = frame["scaling"].fillna(1.0)
    p_mw = frame["p_mw"] * scaling
    if table == "sgen":
        q_mvar = frame["q_mvar"] * scaling
    else:
        q_mvar = net.res_gen.reindex(frame.index)["q_mvar"].astype(float).fillna(0.0)
    rating_mva = _positive(frame, "sn_mva")
    largest_mw = _positive(frame, "max_p_mw")
    return pd.DataFrame(
        {
            "id": [label(net, table, i) for i in frame.index],
            "bus": frame["row"].map(ids).to_numpy(dtype=object),
            "kind": _words(frame, table),
            "p_kw": mw_to_kw(p_mw),
            "q_kvar": mw_to_kw(q_mvar),
            "s_kva": mw_to_kw(rating_mva.fillna(pd.Series(np.hypot(p_mw, q_mvar), frame.index))),
            "p_max_kw": mw_to_kw(largest_mw.fillna(p_mw.where(p_mw > 0)).fillna(p_mw)),
            "p_min_kw": mw_to_kw(_positive(frame, "min_p_mw")),
        }
    )


def _words(frame: pd.DataFrame, table: str) -> pd.Series[str]:
    """The source's word for each generator."""
    if "type" not in frame:
        return pd.Series(table, frame.index, dtype=object)
    words = frame["type"].fillna("").astype(str)
    return words if table == "sgen" else words.where(words != "", "gen")


def loads_of(net: Any, case: NetCase, ids: Mapping[int, BusId]) -> Loads:
    """Loads and motors one by one."""
    loads = supplied(net, "load", case)
    motors = motors_as_loads(net, case)
    labels = [label(net, "load", i) for i in loads.index]
    labels += [label(net, "motor", i) for i in motors.index]
    rows = [*loads["row"], *motors["row"]]
    scaling = loads["scaling"].fillna(1.0)
    p_mw = [*(loads["p_mw"] * scaling), *motors["p_mw"]]
    q_mvar = [*(loads["q_mvar"] * scaling), *motors["q_mvar"]]
    return Loads(
        np.array(labels, dtype=object),
        np.array([ids[row] for row in rows], dtype=object),
        mw_to_kw(p_mw),
        mw_to_kw(q_mvar),
        np.array([*tiers_of(loads), *tiers_of(supplied(net, "motor", case))], dtype=object),
    )


def motors_as_loads(net: Any, case: NetCase) -> pd.DataFrame:
    """Motors as the constant power that they draw, columns ``row``, ``p_mw`` and ``q_mvar``."""
    frame = supplied(net, "motor", case)
    loading = frame["loading_percent"] / frame["efficiency_percent"] * frame["scaling"].fillna(1.0)
    p_mw = (frame["pn_mech_mw"] * loading).astype(float)
    q_mvar: pd.Series[float] = p_mw * np.tan(np.arccos(frame["cos_phi"].astype(float)))
    return pd.DataFrame({"row": frame["row"], "p_mw": p_mw, "q_mvar": q_mvar})


def storages_of(
    net: Any, case: NetCase, ids: Mapping[int, BusId]
) -> tuple[Storages, tuple[str, ...]]:
    """Batteries, and what was assumed of those that the source describes in part.

    Power is the smaller of ``max_p_mw`` and ``-min_p_mw``, else what ``p_mw`` or ``sn_mva`` says;
    energy is ``max_e_mwh``. Of power and energy one may be missing: it follows from the other with
    :data:`HOURS_OF_STORAGE`. Without both there is no battery to speak of.
    """
    frame = supplied(net, "storage", case)
    names = pd.Series([label(net, "storage", i) for i in frame.index], frame.index, dtype=object)
    told = _Told(names)
    scaling = frame["scaling"].fillna(1.0)
    given_mw = (frame["p_mw"] * scaling).fillna(0.0)
    energy_kwh = pd.Series(mw_to_kw(_positive(frame, "max_e_mwh")), frame.index)
    power_kw = pd.Series(mw_to_kw(_power_mw(frame, given_mw, told)), frame.index)
    known = energy_kwh.notna() | power_kw.notna()
    told.say(~known, "Batteries without power and energy are left out")
    told.say(
        known & power_kw.isna(),
        f"Batteries without power are charged and emptied in {HOURS_OF_STORAGE:g} h",
    )
    ratings = _ratings(frame, power_kw.fillna(energy_kwh / HOURS_OF_STORAGE), told)
    told.say(
        known & energy_kwh.isna(),
        f"Batteries without energy hold their power for {HOURS_OF_STORAGE:g} h",
    )
    energy_kwh = energy_kwh.fillna(HOURS_OF_STORAGE * ratings["p_max_kw"])
    columns = {
        "id": names,
        "bus": frame["row"].map(ids).astype(object),
        "p_kw": pd.Series(mw_to_kw(given_mw), frame.index),
        "q_kvar": pd.Series(mw_to_kw(frame["q_mvar"].fillna(0.0) * scaling), frame.index),
        "energy_kwh": energy_kwh,
        **ratings,
        **_charge(frame, energy_kwh, told),
        **_efficiency(frame, told),
    }
    storages = Storages(**{name: column[known].to_numpy() for name, column in columns.items()})
    return storages, tuple(told.notes)


class _Told:
    """Collects sentences on batteries, by name."""

    def __init__(self, names: pd.Series[str]) -> None:
        self.names = names
        self.notes: list[str] = []

    def say(self, which: pd.Series[bool], words: str) -> None:
        """A sentence, if it holds for any battery."""
        if which.any():
            self.notes.append(f"{words}: {named(self.names[which])}.")


def _power_mw(frame: pd.DataFrame, given_mw: pd.Series[float], told: _Told) -> pd.Series[float]:
    """Largest power of each battery, one number for both directions."""
    charge = _positive(frame, "max_p_mw")
    discharge = _positive(-frame.reindex(columns=["min_p_mw"]), "min_p_mw")
    told.say(
        (charge - discharge).abs() > 0,
        "Batteries with one limit for charging and another for discharging keep the smaller one",
    )
    limit = pd.concat([charge, discharge], axis=1).min(axis=1)
    return limit.fillna(_positive(frame, "sn_mva")).fillna(given_mw.abs().where(given_mw != 0))


def _ratings(
    frame: pd.DataFrame, power_kw: pd.Series[float], told: _Told
) -> dict[str, pd.Series[float]]:
    """Active power within the inverter's rating; without a rating it is the power."""
    rating_kva = pd.Series(mw_to_kw(_positive(frame, "sn_mva")), frame.index).fillna(power_kw)
    told.say(
        power_kw > rating_kva,
        "Batteries with more power than their inverter carries have the inverter's rating",
    )
    return {"p_max_kw": power_kw.clip(upper=rating_kva), "s_max_kva": rating_kva}


def _charge(
    frame: pd.DataFrame, energy_kwh: pd.Series[float], told: _Told
) -> dict[str, pd.Series[float]]:
    """Limits of the state of charge, from the least energy up to all of it, and its start."""
    least = _numbers(frame, "min_e_mwh").fillna(0.0)
    low = (pd.Series(mw_to_kw(least), frame.index) / energy_kwh).clip(lower=0.0)
    told.say(low >= 1, "Batteries whose least energy is all they hold may be emptied")
    low = low.where(low < 1, 0.0)
    start = _numbers(frame, "soc_percent") / 100.0
    told.say(start.isna(), "Batteries without a state of charge begin at their lowest")
    told.say(
        (start < low) | (start > 1),
        "Batteries with a state of charge outside their limits begin at the limit",
    )
    start = start.fillna(low).clip(low, 1.0)
    return {"soc_min": low, "soc_max": 1.0 + 0.0 * low, "soc_initial": start}


def _efficiency(frame: pd.DataFrame, told: _Told) -> dict[str, pd.Series[float]]:
    """Efficiency each way; SimBench writes the share into the column of percents."""
    given = _positive(frame, "efficiency_percent")
    each_way = given.where(given <= 1, given / 100.0)
    told.say(each_way.isna(), f"Batteries without an efficiency have {ETA:g} each way")
    told.say(each_way.notna(), "`efficiency_percent` is taken for charging and discharging each")
    losing = _positive(frame, "self-discharge_percent_per_day")
    told.say(losing.notna(), "The self-discharge of batteries is left out")
    each_way = each_way.fillna(ETA).clip(0.01, 1.0)
    return {"eta_charge": each_way, "eta_discharge": each_way}


def _numbers(frame: pd.DataFrame, column: str) -> pd.Series[float]:
    """A column as numbers; NaN where the net has no such column."""
    if column not in frame:
        return pd.Series(np.nan, frame.index)
    return pd.to_numeric(frame[column], errors="coerce").astype(float)


def _positive(frame: pd.DataFrame, column: str) -> pd.Series[float]:
    """A column as numbers; NaN where there is none that is positive and finite."""
    values = _numbers(frame, column)
    return values.where((values > 0) & np.isfinite(values))

"""The first page: the day, customers off supply and why, energy, limits, price."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.text import named
from vppres.core.units import h_to_minutes
from vppres.day.metrics import line_current_a, line_loading, service_by_customer
from vppres.day.phase_figures import phase_figures
from vppres.day.reliability import reliability_by_tier
from vppres.day.series import demand_kw, per_step, pv_available_kw, stored_energy_kwh
from vppres.day.trajectory import Trajectory, supplied
from vppres.explain.reason import DRIVERS
from vppres.kinds.table import KINDS, parts
from vppres.report.clock import Clock
from vppres.report.findings import LIMIT_TOLERANCE_PU
from vppres.report.key_figures import amount, number
from vppres.scenario.configuration import Branches
from vppres.scenario.phases import PHASES
from vppres.scenario.remarks import former_words
from vppres.scenario.scenario import DEFAULT_VOLL_GBP_PER_KWH

NAMES_SHOWN = 5
REASONS_SHOWN = 4
NOTES_SHOWN = 8


@dataclass(frozen=True)
class TierRow:
    """One tier's supply in words; the last row is that of all customers."""

    tier: str
    customers: str
    interrupted: str
    interruptions: str
    minutes: str
    longest: str
    gini: str
    unserved: str
    share: str


@dataclass(frozen=True)
class LimitRow:
    """How near a quantity came to its limit."""

    what: str
    value: str
    where: str
    limit: str
    exceeded: bool


def supply_rows(run: Trajectory, summary: Mapping[str, Any]) -> list[TierRow]:
    """Interruptions, minutes lost and energy not supplied, by tier and in all."""
    table = reliability_by_tier(run)
    rows = [
        _tier_row(
            str(tier),
            row,
            summary["served_share"].get(tier),
            summary.get("minutes_off_max", {}).get(tier),
            summary.get("minutes_off_gini", {}).get(tier),
        )
        for tier, row in table.iterrows()
    ]
    if len(rows) > 1:
        dark = run.steps.loc[run.steps["outage"], "time"]
        everyone = supplied(run.customers).clip(upper=1)[run.customers["time"].isin(dark)]
        share = float(everyone.mean()) if len(everyone) else None
        rows.append(_tier_row("all", table.sum(), share))
    return rows


def _tier_row(
    tier: str,
    row: pd.Series[Any],
    share: float | None,
    longest: float | None = None,
    gini: float | None = None,
) -> TierRow:
    customers = max(float(row["customers"]), 1e-9)
    return TierRow(
        tier,
        number(row["customers"], ",.6g"),
        number(row["interrupted"], ",.6g"),
        number(100.0 * row["interruptions"] / customers, ",.1f"),
        number(row["minutes_lost"] / customers, ",.1f"),
        number(longest, ",.0f"),
        number(gini, ".2f"),
        number(row["unserved_kwh"], ",.1f"),
        number(share, ".1%"),
    )


def who_and_why(run: Trajectory) -> list[str]:
    """Customers without supply for longest, and the reasons."""
    table = service_by_customer(run).assign(weight=run.scenario.customers.weight)
    lost = table[table["unserved_h"] > 0]
    if lost.empty:
        return [f"All {len(table)} customers were supplied at all times."]
    longest = lost.sort_values(["weight", "unserved_h"], ascending=False, kind="stable")
    names = [
        f"{row['id']} ({row['tier']}) {_duration(row['unserved_h'])}"
        for row in longest.to_dict("records")
    ]
    return [
        f"{len(lost)} of {len(table)} customers lost supply. Most important first: "
        f"{named(names, NAMES_SHOWN)}.",
        *_reasons(run),
    ]


def _reasons(run: Trajectory) -> Iterator[str]:
    """Reasons why customers were not supplied, most frequent first."""
    if run.explanations is None:
        yield "No reasons recorded: the run used --no-explain."
        return
    out = run.explanations[run.explanations["action"] == "not_served"]
    counts = out["driver"].value_counts()
    told = [f"{DRIVERS[str(driver)]} {count}" for driver, count in counts.items()]
    if told:
        yield f"Reasons ({len(out):,} customer-steps): {named(told, REASONS_SHOWN)}."


def energy_rows(run: Trajectory, summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Sources and uses of energy, in kWh."""
    dt_h = run.scenario.grid.dt_h
    demand_kwh = float(demand_kw(run).sum()) * dt_h
    unserved_kwh = summary["energy_not_supplied_kwh"]
    rows = [
        ("Demand", demand_kwh),
        ("Not supplied", unserved_kwh),
        ("Supplied", demand_kwh - unserved_kwh),
        ("Imported", summary["import_kwh"]),
    ]
    if summary.get("export_kwh"):
        rows.append(("Exported", summary["export_kwh"]))
    if len(run.scenario.pv):
        rows.append(("PV available", float(pv_available_kw(run).sum()) * dt_h))
        rows.append(("PV curtailed", summary["pv_curtailed_kwh"]))
    if len(run.scenario.batteries):
        charged = per_step(run, run.batteries["charge_kw"], run.batteries)
        given = per_step(run, run.batteries["discharge_kw"], run.batteries)
        stored = stored_energy_kwh(run)
        rows.append(("Batteries charged", float(charged.sum()) * dt_h))
        rows.append(("Batteries discharged", float(given.sum()) * dt_h))
        rows.append(("Stored at the start", float(stored[0])))
        rows.append(("Stored at the end", float(stored[-1])))
    for kind, part in parts("words").items():
        if figures := summary.get(KINDS[kind].table):
            rows += part.energies(figures)
    rows.append(("Line losses", float(run.steps["losses_kw"].sum()) * dt_h))
    return [(words, number(value, ",.0f")) for words, value in rows]


def limit_rows(run: Trajectory) -> list[LimitRow]:
    """Lowest and highest voltage, and the line nearest to its rating."""
    lines = _phase_rows if run.scenario.phases else _line_rows
    return [*_voltage_rows(run), *lines(run)]


def _phase_rows(run: Trajectory) -> Iterator[LimitRow]:
    """The phase of a line or transformer that is nearest to its rating, and that of the former."""
    found = phase_figures(run)
    loading = run.steps["loading_max"]
    if found["loading_max"] is not None:
        t = int(loading.argmax())
        yield LimitRow(
            "Largest loading of a phase",
            f"{loading.iloc[t]:.0%}",
            f"{found['loading_at']}, {Clock.of(run).words(run.steps['time'].iloc[t])}",
            "rating",
            bool(loading.iloc[t] > 1.0),
        )
    most, rating = found["former_phase_max_kva"], found["former_phase_rating_kva"]
    if most is not None and rating is not None:
        kva = run.steps[[f"former_{phase}_kva" for phase in PHASES]].max(axis=1)
        t = int(kva.argmax())
        yield LimitRow(
            "Largest power of a former's phase",
            f"{kva.iloc[t]:,.0f} kVA",
            Clock.of(run).words(run.steps["time"].iloc[t]),
            f"{rating:,.0f} kVA",
            bool(kva.iloc[t] > float(rating) + 1.0),
        )


def _voltage_rows(run: Trajectory) -> Iterator[LimitRow]:
    net = run.scenario.network
    clock = Clock.of(run)
    # Of a bus with phases the record of buses has the node farthest from 1 pu alone.
    table = run.buses if run.nodes is None else run.nodes
    live = table[table["v_ac_pu"] > 0]
    if live.empty:
        yield LimitRow("Voltage", "none", "no live bus", "", exceeded=False)
        return
    v = live["v_ac_pu"].to_numpy(float)
    for what, at, limit, sign in (
        ("Lowest voltage", int(v.argmin()), net.v_min_ac_pu, 1.0),
        ("Highest voltage", int(v.argmax()), net.v_max_ac_pu, -1.0),
    ):
        row = live.iloc[at]
        node = f"bus {row['bus']}" + (f", phase {row['phase']}" if "phase" in row else "")
        yield LimitRow(
            what,
            f"{v[at]:.4f} pu",
            f"{node}, {clock.words(row['time'])}",
            f"{limit:g} pu",
            bool(sign * (limit - v[at]) > LIMIT_TOLERANCE_PU),
        )


def _line_rows(run: Trajectory) -> Iterator[LimitRow]:
    lines = Branches.of(run.scenario)
    rated = run.scenario.network.has_ratings
    values = np.nan_to_num(line_loading(run) if rated else line_current_a(run))
    if not values.size:
        return
    t, line = np.unravel_index(int(values.argmax()), values.shape)
    largest = float(values[t, line])
    yield LimitRow(
        "Largest line loading" if rated else "Largest line current",
        f"{largest:.0%}" if rated else f"{largest:,.1f} A",
        f"{lines.from_bus[line]} to {lines.to_bus[line]}, "
        f"{Clock.of(run).words(run.steps['time'].iloc[int(t)])}",
        f"{lines.rating_a[line]:,.0f} A" if rated else "no line has a rating",
        rated and largest > 1.0,
    )


def price_sentence(summary: Mapping[str, Any]) -> str:
    """The price of the energy not supplied, and its source."""
    voll = summary["voll_gbp_per_kwh"]
    origin = (
        "homes and small businesses in Great Britain, winter peak, prices of 2013; London "
        "Economics for Ofgem and DECC, 2013"
        if voll == DEFAULT_VOLL_GBP_PER_KWH
        else "given by the scenario or with --voll"
    )
    return (
        f"{summary['energy_not_supplied_kwh']:,.0f} kWh not supplied at {voll:g} GBP/kWh, the "
        f"value of lost load ({origin}): £{summary['energy_not_supplied_gbp']:,.0f}."
    )


def money_sentence(summary: Mapping[str, Any]) -> str:
    """Cost of the exchange with the grid."""
    text = f"{summary['import_kwh']:,.0f} kWh imported for {amount(summary['cost_gbp'])}"
    if summary.get("export_kwh"):
        text += (
            f", {summary['export_kwh']:,.0f} kWh exported for "
            f"{amount(summary['export_revenue_gbp'])}"
        )
    return f"{text}."


def foundations(run: Trajectory) -> list[str]:
    """Assumptions that carry the result: what forms the island, headroom, outages, the source."""
    source = run.scenario.source
    said = [*island_words(run), *([str(source)] if source else [])]
    return [*said, *source.told[:NOTES_SHOWN]]


def further_notes(run: Trajectory) -> tuple[str, ...]:
    """Notes of the source beyond those of the first page."""
    return run.scenario.source.told[NOTES_SHOWN:]


def island_words(run: Trajectory) -> Iterator[str]:
    """Formers of the island and foreknowledge of outages, in words."""
    day, options = run.scenario, run.options
    if not day.outage.any():
        return
    former = former_words(day, str(options.get("mode", "paper")))
    if former:
        headroom = float(options.get("headroom") or 0.0)
        kept = f" {headroom:.0%} of the rating stays free as headroom." if headroom else ""
        yield f"{former}{kept}"
    if options.get("outages", "known") == "known":
        yield ("The controller knows when each outage begins and ends once its horizon reaches it.")


def _duration(hours: float) -> str:
    """Hours without supply, or minutes below one."""
    return f"{hours:g} h" if hours >= 1.0 else f"{h_to_minutes(hours):g} min"

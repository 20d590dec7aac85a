"""Output of the command line: tables for people, records for machines. Nothing here prints."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from vppres.core.errors import Problem
from vppres.core.text import counted, visible

if TYPE_CHECKING:
    from vppres.day.trajectory import Trajectory
    from vppres.scenario.scenario import Scenario
    from vppres.studies.compare import ComparedFigure
    from vppres.studies.sweep import SweepRow

REMARKS_SHOWN = 20

FIGURES = (
    "resilience",
    "cost_gbp",
    "import_kwh",
    "export_kwh",
    "export_revenue_gbp",
    "pv_curtailed_kwh",
    "v_min_ac_pu",
    "v_max_ac_pu",
    "v_error_max_pu",
    "corrections",
    "fallbacks",
    "gap_max",
)
"""Keys of the figures of a run that a terminal shows."""


def content_of(day: Scenario) -> dict[str, Any]:
    """Contents of a sound scenario, in numbers."""
    from vppres.kinds.export import data as export
    from vppres.kinds.table import KINDS
    from vppres.physics.uncontrolled import without_control
    from vppres.scenario.remarks import remarks, source_words, unknown_phases

    return {
        "name": day.name,
        "title": day.title,
        "buses": day.network.n_buses,
        "customers": len(day.customers),
        "pv_systems": len(day.pv),
        "generators": day.pv.counted(),
        "batteries": len(day.batteries),
        **{kind: len(getattr(day, kind)) for kind in KINDS},
        "ev_sessions": len(day.sessions),
        "steps": day.grid.n_steps,
        "step_minutes": float(day.grid.step_minutes),
        "outage_steps": int(day.outage.sum()),
        "faults": len(day.faults),
        "export": export.words(day),
        "mode": day.controller.mode,
        "source": asdict(day.source),
        "remarks": [
            *unknown_phases(day),
            *without_control(day),
            *source_words(day),
            *remarks(day),
        ],
    }


def problem_record(problem: Problem | str) -> dict[str, Any]:
    """A problem as JSON can hold it; the value as text, since it may be anything."""
    if isinstance(problem, str):
        return {
            "file": None,
            "row": None,
            "field": None,
            "value": None,
            "message": problem,
            "cure": None,
            "more": 0,
            "rows": [],
        }
    return {
        "file": problem.where,
        "row": problem.row,
        "field": problem.field,
        "value": None if problem.value is None else str(problem.value),
        "message": problem.message,
        "cure": problem.cure,
        "more": problem.more,
        "rows": [*problem.rows],
    }


def validation_text(
    folder: str, problems: Sequence[Problem | str], content: Mapping[str, Any] | None
) -> str:
    """One line per problem and their number, or what the sound scenario holds."""
    if content is None:
        number = sum(1 if isinstance(one, str) else 1 + one.more for one in problems)
        return "\n".join([*map(str, problems), f"{counted(number, 'problem')}."])
    from vppres.kinds.table import parts

    held = [
        counted(content["buses"], "bus", "buses"),
        counted(content["customers"], "customer"),
        content["generators"],
        counted(content["batteries"], "battery", "batteries"),
    ]
    held += [data.contents(content) for kind, data in parts().items() if content[kind]]
    faults = (
        f", {counted(content['faults'], 'fault')} of lines or buses" if content["faults"] else ""
    )
    steps = f"{counted(content['steps'], 'step')} of {content['step_minutes']:g} min"
    holds = (
        f"{folder} is valid: {', '.join([*held, steps])}, {content['outage_steps']} of them "
        f"without grid{faults}; {content['export']}; islands in {content['mode']} mode."
    )
    return "\n".join([holds, *(f"- {remark}" for remark in content["remarks"])])


def order_told(run: Trajectory) -> list[str]:
    """Sentence on customers off over time, and the operating order, a line for each time."""
    from vppres.report.operating_order import off_sentence, shown_orders

    said = off_sentence(run)
    return [visible(line) for line in ([said, *shown_orders(run)] if said else [])]


def remarks_told(run: Trajectory) -> list[str]:
    """Remarks beside the figures of a run, a line each; of very many the first."""
    from vppres.report.first_page import island_words
    from vppres.scenario.remarks import former_words, remarks

    mode = str(run.options["mode"])
    # The words of the island say what forms it, with the headroom.
    former = former_words(run.scenario, mode)
    words = [*island_words(run), *(one for one in remarks(run.scenario, mode) if one != former)]
    more = len(words) - REMARKS_SHOWN
    rest = [f"{more} more in the report."] if more > 0 else []
    return [f"- {remark}" for remark in [*words[:REMARKS_SHOWN], *rest]]


def error_panel(message: str) -> Panel:
    """An error for a terminal, in the style of those of wrong usage."""
    return Panel(Text(message), title="Error", title_align="left", border_style="red")


def _plain(text: str) -> Text:
    """Others' words as they are: brackets are no markup, control characters are written out."""
    return Text(visible(text))


def figures_table(summary: dict[str, Any], title: str) -> Table:
    """Key figures of a run; what is not defined is left out."""
    from vppres.report.key_figures import key_figures

    table = Table(title=_plain(title), show_header=False)
    table.add_column()
    table.add_column(justify="right")
    table.add_column()
    shown = {key: summary[key] for key in FIGURES if summary[key] is not None}
    for row in key_figures(shown):
        table.add_row(*row)
    for tier, share in summary["served_share"].items():
        if share is not None:
            table.add_row(_plain(f"Share served in the outage, {tier}"), f"{share:.1%}", "")
    table.add_row("Time for all decisions", f"{summary['solve_s']['total']:.1f}", "s")
    return table


def comparison_table(labels: Sequence[str], figures: Sequence[ComparedFigure]) -> Table:
    """Every figure of every run, with the difference to the first run below it."""
    table = Table()
    table.add_column("")
    for label in labels:
        table.add_column(_plain(label), justify="right", overflow="fold")
    table.add_column("")
    for row in figures:
        (first, _), *others = row.texts
        changes = [f"{value}\n({change})" for value, change in others]
        table.add_row(_plain(row.words), first, *changes, row.unit)
    return table


def sweep_table(name: str, outcomes: Sequence[SweepRow]) -> Table:
    """The figures of each run that are most asked for; failures are reported after it."""
    from vppres.studies.sweep_parameters import value_text

    table = Table()
    table.add_column(_plain(name), justify="right", no_wrap=True)
    for words in ("resilience", "cost (GBP)", "import (kWh)", "lowest AC voltage (pu)", "time (s)"):
        table.add_column(words, justify="right", overflow="fold")
    for outcome in outcomes:
        if outcome.summary is None:
            table.add_row(value_text(outcome.value), "failed")
            continue
        figures = outcome.summary
        resilience = figures["resilience"]
        table.add_row(
            value_text(outcome.value),
            "" if resilience is None else f"{resilience:.4f}",
            f"{figures['cost_gbp']:,.2f}",
            f"{figures['import_kwh']:,.1f}",
            f"{figures['v_min_ac_pu']:.4f}",
            f"{figures['solve_s']['total']:.1f}",
        )
    return table


def survival_table(rows: Any, sampled: bool) -> Table:
    """Share of onsets, hours and energy of each variant, length and tier."""
    table = Table()
    for words in ("variant", "tier"):
        table.add_column(words, overflow="fold")
    words = "throughout (95%)" if sampled else "throughout"
    for name in ("length (h)", words, "expected (h)", "not supplied (kWh)"):
        table.add_column(name, justify="right", overflow="fold")
    for row in rows.itertuples():
        interval = f" ({row.low:.0%} to {row.high:.0%})" if sampled else ""
        table.add_row(
            _plain(row.variant),
            _plain(row.tier),
            f"{row.length_h:g}",
            f"{row.throughout:.1%}{interval}",
            f"{row.expected_h:.2f}",
            f"{row.not_supplied_kwh:,.1f}",
        )
    return table


PHASE_COLUMNS = (
    ("buses", "buses", ".0f"),
    ("difference_max_pu", "largest difference", ".4f"),
    ("difference_mean_pu", "mean difference", ".4f"),
    ("v_min_pu", "lowest voltage", ".4f"),
    ("v_min_plan_pu", "in the plan", ".4f"),
)


def phases_table(summary: Mapping[str, Any]) -> Table:
    """Voltages per phase of a recheck, in steps with grid."""
    table = Table(title="Original feeder against the plan, steps with grid (pu)")
    table.add_column("phase")
    for _, words, _ in PHASE_COLUMNS:
        table.add_column(words, justify="right")
    for phase, row in summary["phases"].items():
        cells = [
            "-" if row[key] is None else format(row[key], form) for key, _, form in PHASE_COLUMNS
        ]
        table.add_row(phase, *cells)
    return table


def reconfiguration_table(record: Mapping[str, Any]) -> Table:
    """Configurations before and after a reconfiguration; without limits too, if these cost."""
    before, after, free = (record[name] for name in ("before", "after", "without_limits"))
    shown = {"before": before, "after": after}
    if free["open"] != after["open"]:
        shown["without limits"] = free
    table = Table()
    table.add_column("")
    for name in shown:
        table.add_column(name)
    rows: dict[str, Callable[[Mapping[str, Any]], str]] = {
        "losses (kW)": lambda one: f"{one['losses_kw']:,.3f}",
        "lowest voltage (pu)": lambda one: f"{one['v_min_pu']:.5f} at bus {one['bus_min']}",
        "within limits": lambda one: "yes" if one["keeps_limits"] else "no",
        "open": lambda one: ", ".join(one["open"]),
    }
    for words, cell in rows.items():
        cells = [
            "no power flow found" if one["losses_kw"] is None and words != "open" else cell(one)
            for one in shown.values()
        ]
        table.add_row(words, *map(_plain, cells))
    return table


def recheck_lines(summary: Mapping[str, Any]) -> list[str]:
    """The largest difference, its cause, and what the comparison assumes."""
    largest = summary["largest"]
    head = (
        "No step with grid can be compared."
        if largest is None
        else f"Largest difference: {largest['difference_pu']:+.4f} pu at bus {largest['bus']}, "
        f"phase {largest['phase']}, {largest['time']}: {largest['v_pu']:.4f} in OpenDSS, "
        f"{largest['v_plan_pu']:.4f} in the plan."
    )
    return [visible(line) for line in (head, summary["cause"], *summary["notes"])]


def simulation_lines(found: Mapping[str, Any]) -> list[str]:
    """Figures of a simulation, one a line."""
    lines = []
    for name, value in found.items():
        if isinstance(value, list):
            lines += [f"{name}: {_pairs(each)}" for each in value]
        else:
            lines.append(f"{name}: {_pairs(value) if isinstance(value, dict) else value}")
    return lines


def _pairs(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} {value}" for name, value in values.items())

"""The report's first section, one page on paper: what happened, why, and at what price."""

from __future__ import annotations

from typing import Any

from vppres.report.answer import answer
from vppres.report.events import opening_of
from vppres.report.findings import doubts, remarks
from vppres.report.first_page import (
    energy_rows,
    foundations,
    limit_rows,
    money_sentence,
    price_sentence,
    supply_rows,
    who_and_why,
)
from vppres.report.operating_order import off_sentence, shown_orders
from vppres.report.sections.base import Run


def overview_of(run: Run) -> dict[str, Any]:
    """The answer, why it is so, the operating order, four small tables, and what else to know."""
    trajectory = run.trajectory
    return {
        "answer": answer(trajectory, run.summary),
        "doubts": doubts(trajectory),
        "remarks": remarks(trajectory),
        "sentences": [
            *opening_of(trajectory, run.summary),
            *filter(None, [off_sentence(trajectory)]),
            *who_and_why(trajectory),
        ],
        "strip": run.figure("timeline"),
        "supply": supply_rows(trajectory, run.summary),
        "off": bool(run.summary.get("minutes_off_max")),
        "outage": bool(trajectory.steps["outage"].any()),
        "energy": energy_rows(trajectory, run.summary),
        "limits": limit_rows(trajectory),
        "money": money_sentence(run.summary),
        "price": price_sentence(run.summary),
        "foundations": foundations(trajectory),
        "orders": shown_orders(trajectory),
    }

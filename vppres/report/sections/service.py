"""Supply by customer."""

from __future__ import annotations

from typing import Any

from vppres.day.metrics import service_by_customer, service_by_tier
from vppres.day.trajectory import Trajectory
from vppres.report.clock import Clock
from vppres.report.key_figures import number
from vppres.report.sections.base import FOLDED_ABOVE, Run, Section, section


def service_section(run: Run) -> Section:
    """Shares of the tiers, customers without supply, and the shares step by step."""
    unserved = service_by_customer(run.trajectory)
    shares = {
        "Supplied in the outage": run.summary["served_share"],
        "Supplied with grid": run.summary["served_share_connected"],
    }
    return section(
        "service",
        "Supply by customer",
        {
            "shares": {
                words: by_tier
                for words, by_tier in shares.items()
                if any(share is not None for share in by_tier.values())
            },
            "tiers": _tiers(run.trajectory),
            "unserved": unserved[unserved["unserved_h"] > 0].to_dict("records"),
            "n_customers": len(unserved),
            "folded_above": FOLDED_ABOVE,
            "service": _service_rows(run.trajectory),
            "number": number,
            "figures": [run.figure("service_by_tier")],
        },
    )


def _tiers(trajectory: Trajectory) -> list[str]:
    """Tiers that have customers, in their order."""
    return [str(tier) for tier in service_by_tier(trajectory).columns]


def _service_rows(trajectory: Trajectory) -> list[dict[str, Any]]:
    """Time, outage and the share served of each tier, one row per step."""
    shares = service_by_tier(trajectory)
    clock = Clock.of(trajectory)
    return [
        {
            "time": clock.words(time),
            "outage": bool(outage),
            "shares": [row[tier] for tier in _tiers(trajectory)],
        }
        for time, outage, row in zip(
            trajectory.steps["time"],
            trajectory.steps["outage"],
            shares.to_dict("records"),
            strict=True,
        )
    ]

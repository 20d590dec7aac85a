"""Supply by customer."""

from __future__ import annotations

from typing import Any

import pandas as pd

from vppres.day.metrics import service_by_customer, service_by_tier
from vppres.day.trajectory import Trajectory
from vppres.report.clock import Clock
from vppres.report.sections.base import Run


def service_of(run: Run) -> dict[str, Any]:
    """Shares of the tiers, customers without supply, and the shares step by step."""
    unserved = service_by_customer(run.trajectory)
    each = service_by_tier(run.trajectory)
    shares = {
        "Supplied in the outage": run.summary["served_share"],
        "Supplied with grid": run.summary["served_share_connected"],
    }
    return {
        "shares": {
            words: by_tier
            for words, by_tier in shares.items()
            if any(share is not None for share in by_tier.values())
        },
        "tiers": [*map(str, each.columns)],
        "unserved": unserved[unserved["unserved_h"] > 0].to_dict("records"),
        "n_customers": len(unserved),
        "service": _service_rows(run.trajectory, each),
        "figures": [run.figure("service_by_tier")],
    }


def _service_rows(run: Trajectory, each: pd.DataFrame) -> list[dict[str, Any]]:
    """Time, outage and the share served of each tier, one row per step."""
    clock = Clock.of(run)
    steps = zip(run.steps["time"], run.steps["outage"], each.to_numpy(float).tolist(), strict=True)
    return [
        {"time": clock.words(time), "outage": bool(outage), "shares": shares}
        for time, outage, shares in steps
    ]

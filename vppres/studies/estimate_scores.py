"""Estimates of restoration against what came: how long outages last of what was said of them.

A message that is issued while an outage lasts is an estimate of its whole length, or a notice that
it ends soon. What was learned is written as ``[outage_statistics]`` has it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from vppres.outlook.outlook import HOUR, SeenOutage
from vppres.scenario.outage_warnings import OutageWarning

LEAST = 10
"""Outages with an estimate from which on their spread is learned: the p10 is one of them."""

WRONG = 0.25
"""Share of its length by which an estimate must miss the outage to be counted as wrong."""

PARTS_H = (1.0, 4.0)
"""Estimates are grouped by how long the outage had lasted: up to the first, the second, more."""

QUANTILES = {"estimate_p10": 0.1, "estimate_p50": 0.5, "estimate_p90": 0.9}


@dataclass(frozen=True, eq=False)
class EstimateScores:
    """Estimates made during outages, and the ends that came."""

    #: One row for each estimate: number of its ``outage``, hours ``after_h`` since it began, length
    #: ``said_h``, and ``ratio`` of the outage's length to it.
    estimates: pd.DataFrame
    #: One row for each outage with any notice: whether the last one was ``right``, hours ``lead_h``
    #: from it to the end, and the number of those given in ``vain``.
    notices: pd.DataFrame
    hours: float  #: length of these outages together in h

    @classmethod
    def of(cls, warnings: Iterable[OutageWarning], outages: Sequence[SeenOutage]) -> EstimateScores:
        """Scores of messages by outages that are over."""
        messages = sorted(warnings, key=lambda one: one.issued_at)
        estimates: list[dict[str, float]] = []
        notices: list[dict[str, Any]] = []
        hours = 0.0
        over = ((one.start, one.end, one.hours) for one in outages if one.end)
        for number, (start, end, length_h) in enumerate(over):
            told = [one for one in messages if start <= one.issued_at < end]
            said = [(one.issued_at, _said_h(one, start)) for one in told]
            estimates += [
                {
                    "outage": number,
                    "after_h": (at - start) / HOUR,
                    "said_h": said_h,
                    "ratio": length_h / said_h,
                }
                for at, said_h in said
                if said_h and said_h > 0.0
            ]
            ends = [(one.issued_at, one.restored_by) for one in told if one.restored_by]
            if ends:
                right = [at for at, by in ends if end <= by]
                last = right[0] if right else ends[-1][0]
                lead_h = (end - last) / HOUR
                vain = len(ends) - len(right)
                notices.append({"right": bool(right), "lead_h": lead_h, "vain": vain})
                hours += length_h
        columns = ["outage", "after_h", "said_h", "ratio"]
        return cls(
            pd.DataFrame(estimates, columns=columns),
            pd.DataFrame(notices, columns=["right", "lead_h", "vain"]),
            hours,
        )

    @property
    def table(self) -> pd.DataFrame:
        """Quantiles of the ratio by how long the outage had lasted, and the share that was wrong.

        An outage counts once in each row, with the last estimate of its part.
        """
        edges = [-np.inf, *PARTS_H, np.inf]
        names = [f"up to {PARTS_H[0]:g} h", f"up to {PARTS_H[1]:g} h", f"after {PARTS_H[1]:g} h"]
        part = pd.cut(self.estimates["after_h"], edges, labels=names)
        rows = [
            {"said": name, **_figures(self.estimates[part == name])}
            for name in names
            if (part == name).any()
        ]
        if len(self.estimates):
            rows.append({"said": "all", **_figures(self.estimates)})
        return pd.DataFrame(rows, columns=["said", "outages", *QUANTILES, "wrong"])

    @property
    def learned(self) -> dict[str, float]:
        """Figures for ``[outage_statistics]``; empty of fewer outages than ``LEAST``."""
        found: dict[str, float] = {}
        if self.estimates["outage"].nunique() >= LEAST:
            figures = _figures(self.estimates)
            found |= {name: round(figures[name], 2) for name in QUANTILES}
        if len(self.notices) >= LEAST:
            right = self.notices[self.notices["right"]]
            others_h = max(self.hours - len(self.notices), 1.0)
            found |= {
                "notice_h": round(float(right["lead_h"].median()), 2) if len(right) else 1.0,
                "notice_share": round(min(float(self.notices["right"].mean()), 0.99), 2),
                "notice_false_share": round(float(self.notices["vain"].sum()) / others_h, 2),
            }
        return found

    def summary(self) -> dict[str, Any]:
        """All figures as JSON can hold them."""
        return {"table": self.table.to_dict("records"), "learned": self.learned}


def _figures(estimates: pd.DataFrame) -> dict[str, float]:
    """Quantiles of the last ratio of each outage, and the share of those that are far off."""
    ratio = estimates.groupby("outage")["ratio"].last().to_numpy(float)
    shares = {name: float(np.quantile(ratio, share)) for name, share in QUANTILES.items()}
    return {"outages": len(ratio), **shares, "wrong": float((np.abs(ratio - 1.0) > WRONG).mean())}


def _said_h(message: OutageWarning, start: pd.Timestamp) -> float | None:
    """The length that a message expects of an outage, None if it says none."""
    if message.restored_likely:
        return float((message.restored_likely - start) / HOUR)
    return message.duration_p50_h

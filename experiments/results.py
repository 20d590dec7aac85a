"""What is kept of a simulated day: its summary and one number for each step and quantity."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from vppres.core.arrays import Floats


@dataclass(frozen=True)
class DayResult:
    """A simulated day in short."""

    summary: Mapping[str, Any]  #: the figures of :func:`vppres.day.metrics.summarise`
    #: One value per step and quantity; ``energy_kwh`` has one more, the end of the day.
    steps: Mapping[str, list[Any]]
    #: Of a full-horizon plan, like ``steps``: ``energy_kwh``, ``p_grid_kw``, ``served_forecast_kw``
    #: and ``served_actual_kw``, the demand of the customers whom the plan serves as it was forecast
    #: and as it came. Empty without a plan.
    planned: Mapping[str, list[float]]

    @property
    def edges(self) -> Floats:
        """Hours of the day at which steps begin, and the end of the last."""
        return np.arange(len(self.steps["outage"]) + 1, dtype=float)

    @property
    def resilience(self) -> float:
        """Weighted share of service in the outage."""
        return float(self.summary["resilience"])

    @property
    def corrected_hours(self) -> list[int]:
        """Steps in which the plan was overruled."""
        return [hour for hour, was in enumerate(self.steps["corrected"]) if was]

    def why_corrected(self) -> str:
        """Which hours were corrected, and why the first one was."""
        reasons = [text for text in self.steps["correction_reason"] if text]
        first = f" (first: {reasons[0]})" if reasons else ""
        return f"Corrected hours: {', '.join(map(str, self.corrected_hours)) or 'none'}{first}."

    def evidence(self) -> str:
        """Figures that help to see why a day came out as it did."""
        shares = ", ".join(
            f"{tier} {share:.0%}" for tier, share in self.summary["served_share"].items()
        )
        stored_kwh = self.steps["energy_kwh"][self.steps["outage"].index(True)]
        return (
            f"Served in the outage: {shares}; stored at its beginning: {stored_kwh:,.0f} kWh. "
            f"{self.why_corrected()}"
        )

    def series(self, name: str) -> Floats:
        """One quantity of every step."""
        return np.array(self.steps[name], dtype=float)

    def to_json(self) -> str:
        """The day as JSON text."""
        return json.dumps(asdict(self), allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> DayResult:
        """A day from its JSON text."""
        return cls(**json.loads(text))

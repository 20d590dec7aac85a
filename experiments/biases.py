"""What the two figures of biases share: directions of charging, cost and resilience (R16, R17)."""

from __future__ import annotations

from experiments import ideal
from experiments.battery_energy import energy_limits_kwh
from experiments.config import Config
from experiments.drawing import FULL
from experiments.forecast_errors import Point, cost_gbp, points, resilience, stored_kwh
from experiments.results import DayResult
from experiments.rows import Row, asserted
from experiments.runner import Results


def underprepared(
    config: Config, results: Results, id: str, sign: int, costs_less: bool
) -> list[Row]:
    """Biases that make the plan expect too little need: less charging, less cost, less service."""
    perfect = results[ideal.FULL_HORIZON]
    rows = []
    for point in _on_side(config, results, sign):
        facts = {"charges less": point.mean(stored_kwh) < stored_kwh(perfect)}
        if costs_less:
            facts["costs less"] = point.mean(cost_gbp) < cost_gbp(perfect)
        facts["lower resilience"] = point.mean(resilience) < resilience(perfect)
        rows.append(_row(id, facts, point, perfect))
    return rows


def overprepared(config: Config, results: Results, id: str, sign: int) -> list[Row]:
    """Biases that make the plan expect too much need: more cost, and less service all the same."""
    perfect = results[ideal.FULL_HORIZON]
    return [
        _row(
            id,
            {
                "costs more": point.mean(cost_gbp) > cost_gbp(perfect),
                "lower resilience": point.mean(resilience) < resilience(perfect),
            },
            point,
            perfect,
        )
        for point in _on_side(config, results, sign)
    ]


def _on_side(config: Config, results: Results, sign: int) -> list[Point]:
    return [point for point in points(config, results, FULL) if point.level * sign > 0]


def _row(id: str, facts: dict[str, bool], point: Point, perfect: DayResult) -> Row:
    numbers = (
        f"plan stores {point.mean(stored_kwh):,.0f} kWh for the outage (ideal "
        f"{stored_kwh(perfect):,.0f}), costs GBP {point.mean(cost_gbp):,.0f} (ideal "
        f"{cost_gbp(perfect):,.0f}), R {point.mean(resilience):.3f} "
        f"(ideal {resilience(perfect):.3f})"
    )
    return asserted(
        id, facts, numbers, f"{point.level:+.0%}", lambda: _reason(facts, point, perfect)
    )


def _reason(facts: dict[str, bool], point: Point, perfect: DayResult) -> str:
    """What was measured where a direction does not hold."""
    parts = []
    if not facts.get("charges less", True):
        parts.append(
            f"The ideal plan already fills the batteries ({stored_kwh(perfect):,.0f} of "
            f"{energy_limits_kwh()[1]:,.0f} kWh): capacity limits the service, not the "
            "forecast."
        )
    if not (facts.get("costs less", True) and facts.get("costs more", True)):
        parts.append(_import_text(point.days[0], perfect))
    return " ".join(parts)


def _import_text(day: DayResult, perfect: DayResult) -> str:
    """Where the import differs from the ideal day's: losses, corrected and uncorrected hours."""
    connected = perfect.series("outage") == 0
    change_kwh = (day.series("p_grid_kw") - perfect.series("p_grid_kw")) * connected
    losses_kwh = ((day.series("losses_kw") - perfect.series("losses_kw")) * connected).sum()
    corrected = day.series("corrected") > 0
    early = [hour for hour in day.corrected_hours if connected[hour]]
    return (
        f"The import differs by {change_kwh.sum():+,.0f} kWh, {losses_kwh:+,.0f} of them "
        f"losses and {change_kwh[corrected].sum():+,.0f} in corrected hours with grid "
        f"({', '.join(map(str, early)) or 'none'})."
    )

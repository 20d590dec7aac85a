"""What the two figures of random forecast errors share: R14b and R15."""

from __future__ import annotations

import numpy as np

from experiments.config import Config
from experiments.drawing import FULL
from experiments.forecast_errors import planned, points, resilience, selection_text
from experiments.rows import Row, asserted, numbers
from experiments.runner import Results


def actual_row(config: Config, results: Results, case: str) -> Row:
    """R14b: whether what is reached falls as the error grows."""
    found = points(config, results, FULL)
    values = [point.mean(resilience) for point in found]

    def reason() -> str:
        number = [np.mean([len(day.corrected_hours) for day in point.days]) for point in found]
        return (
            "Any error fires the checks, and one-step decisions then do not depend on the size of "
            f"the error: {numbers(number, '.1f')} of 24 hours are corrected."
        )

    return asserted(
        "R14b",
        {"falls with every level": bool((np.diff(values) < 0).all())},
        f"{numbers(values)} at {numbers([p.level for p in found], 'g')}",
        case,
        reason,
    )


def planned_row(config: Config, results: Results, case: str) -> Row:
    """R15: whether the plan's own resilience falls as the error grows."""
    found = points(config, results, FULL)
    values = [point.mean(planned) for point in found]

    def reason() -> str:
        evidence = "; ".join(selection_text(point) for point in found[1:])
        return (
            "Errors are drawn for each customer, so a plan picks those whose forecast came out "
            f"low, and promises more than perfect foresight gives: {evidence}."
        )

    return asserted(
        "R15",
        {"falls with every level": bool((np.diff(values) < 0).all())},
        f"{numbers(values)} at {numbers([p.level for p in found], 'g')}",
        case,
        reason,
    )

"""Frozen readings: how often the guard notices them, and how often it takes true ones for frozen.

``python -m experiments.studies.alarms --days 200``
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import typer

from benchmarks.frame.pages import markdown_table
from benchmarks.frame.seeds import Study, report
from experiments.report import machine
from experiments.studies.random_days import small_day
from vppres.contract.forecast import ForecastErrors
from vppres.core.arrays import Flags, Floats
from vppres.day.assembly import make_controller
from vppres.day.faults import (
    QUANTITIES,
    FaultInjector,
    FaultPlan,
    MeasurementFault,
    Quantity,
)
from vppres.day.options import RunOptions
from vppres.day.recorder import StepRecord
from vppres.day.simulate import Day
from vppres.scenario.scenario import Scenario

MATERIAL = 0.05
"""Frozen readings further off than this share (of demand, PV power or capacity) do harm."""

HEADINGS = (
    "reading",
    "steps read right",
    "false alarms",
    "share",
    "steps read wrong",
    "missed",
    "share",
    "after the first of the day",
    "missed",
    "share",
    "wrong by more than 5 %",
    "missed",
    "share",
)


@dataclass(frozen=True)
class Alarms:
    """Steps of one quantity, by whether its readings were right and an alarm was raised."""

    #: Steps with true readings, and those of them with an alarm.
    right: int = 0
    false: int = 0
    #: Steps with frozen readings that are no longer true, and those of them without an alarm.
    wrong: int = 0
    missed: int = 0
    #: The same, with readings that are off by more than ``MATERIAL``.
    material: int = 0
    material_missed: int = 0

    def __add__(self, other: Alarms) -> Alarms:
        return Alarms(
            *(a + b for a, b in zip(asdict(self).values(), asdict(other).values(), strict=True))
        )

    @classmethod
    def of(cls, off: Floats, alarm: Flags) -> Alarms:
        """Count the steps of a day.

        Parameters
        ----------
        off : array, shape (T,)
            How far readings are off in each step, as a share.
        alarm : array of bool, shape (T,)
            Whether they were called frozen.

        Examples
        --------
        >>> Alarms.of(np.array([0.0, 0.0, 0.01, 0.2]), np.array([False, True, False, True]))
        Alarms(right=2, false=1, wrong=2, missed=1, material=1, material_missed=0)
        """
        wrong = off > 0.0
        material = off > MATERIAL
        return cls(
            *(
                int(np.sum(flags))
                for flags in (
                    ~wrong,
                    ~wrong & alarm,
                    wrong,
                    wrong & ~alarm,
                    material,
                    material & ~alarm,
                )
            )
        )


@dataclass(frozen=True)
class AlarmDay:
    """What a day says about alarms: its seed, what froze, and counts by quantity."""

    seed: int
    frozen: str
    counts: dict[str, Alarms]


def counted(
    scenario: Scenario, faults: FaultPlan, records: Sequence[StepRecord]
) -> dict[str, Alarms]:
    """Alarms of a day with faults, by quantity.

    Parameters
    ----------
    scenario : Scenario
        The actual day.
    faults : FaultPlan
        What went wrong in it.
    records : sequence of StepRecord
        Its steps, as far as it went.
    """
    return {
        quantity: Alarms.of(
            readings_off(scenario, faults, records, quantity),
            np.array(
                [_alarm(record.steps["estimated"], quantity) for record in records], dtype=np.bool_
            ),
        )
        for quantity in QUANTITIES
    }


def readings_off(
    scenario: Scenario, faults: FaultPlan, records: Sequence[StepRecord], quantity: Quantity
) -> Floats:
    """How far frozen readings are from the truth in each step, as a share, shape (T,).

    Of the day's largest total for demand and PV power; of capacity, and of the worst battery, for
    the state of charge.
    """
    soc = np.array([record.batteries["soc_start"] for record in records])
    true = {"soc": soc, "load": scenario.load_kw, "pv": scenario.pv_kw}[quantity]
    off = np.zeros(len(records))
    scale = 1.0 if quantity == "soc" else max(float(true.sum(axis=1).max(initial=0.0)), 1e-9)
    for fault in faults.measurements:
        if fault.quantity != quantity or not fault.frozen or fault.start >= len(records):
            continue
        items = slice(None) if fault.items is None else np.array(fault.items, dtype=int)
        for t in range(fault.start, min(fault.end, len(records))):
            apart = np.abs(true[t, items] - true[fault.start, items])
            off[t] = float(apart.max(initial=0.0) if quantity == "soc" else apart.sum()) / scale
    return np.where(off > 1e-9, off, 0.0)


def _alarm(estimated: str, quantity: str) -> bool:
    return any(
        text.startswith(f"{quantity} ") and "(frozen" in text for text in estimated.split("; ")
    )


def alarm_rows(counts: Iterable[dict[str, Alarms]]) -> list[tuple[object, ...]]:
    """Rows of the table of rates, one for each quantity."""
    days = list(counts)
    rows: list[tuple[object, ...]] = []
    for quantity in QUANTITIES:
        total = sum((day[quantity] for day in days), Alarms())
        rows.append(
            (
                quantity,
                total.right,
                total.false,
                _share(total.false, total.right),
                total.wrong,
                total.missed,
                _share(total.missed, total.wrong),
                *_later(day[quantity] for day in days),
                total.material,
                total.material_missed,
                _share(total.material_missed, total.material),
            )
        )
    return rows


def _later(days: Iterable[Alarms]) -> tuple[int, int, str]:
    """Wrong steps after the first of each day, and those missed: before it is no evidence."""
    frozen = [day for day in days if day.wrong]
    wrong = sum(day.wrong - 1 for day in frozen)
    missed = sum(max(day.missed - 1, 0) for day in frozen)
    return wrong, missed, _share(missed, wrong)


def _share(part: int, whole: int) -> str:
    return f"{part / whole:.2%}" if whole else "none"


def run_one(seed: int) -> AlarmDay:
    """A day in which one kind of reading freezes for 2 to 6 h, under forecast errors of any size.

    On every other day all readings of the kind freeze, on the others about half of them.
    """
    rng = np.random.default_rng([seed, 60870])
    scenario = small_day(rng, seed)
    quantity = QUANTITIES[seed % len(QUANTITIES)]
    count = {
        "soc": len(scenario.batteries),
        "load": len(scenario.customers),
        "pv": len(scenario.pv),
    }[quantity]
    start = int(rng.integers(0, scenario.grid.n_steps - 3))
    some = tuple(int(i) for i in np.flatnonzero(rng.random(count) < 0.5))
    fault = MeasurementFault(
        quantity, True, start, start + int(rng.integers(2, 7)), None if rng.random() < 0.5 else some
    )
    faults = FaultPlan(measurements=(fault,))
    load_bias, pv_bias = (float(x) for x in rng.uniform(-0.3, 0.3, 2))
    load_alpha, pv_alpha = (float(x) for x in rng.uniform(0.0, 0.3, 2))
    options = RunOptions(
        horizon_h=2.0, seed=seed, errors=ForecastErrors(load_bias, load_alpha, pv_bias, pv_alpha)
    )
    injector = FaultInjector(faults, scenario)
    guard = make_controller(scenario, options, injector)
    day = Day(scenario, options, injector)
    for t in range(scenario.grid.n_steps):
        day.step(guard, t)
    return AlarmDay(seed, quantity, counted(scenario, faults, day.recorder.records))


def write_report(days: Sequence[AlarmDay], wall_s: float, folder: Path) -> Path:
    """Write ``alarms.json``, ``.md`` and ``.html``; returns the Markdown file."""
    text = "\n\n".join(
        [
            markdown_table(HEADINGS, alarm_rows(day.counts for day in days)),
            f"{len(days)} days of twelve hours on random feeders; one kind of reading freezes on "
            "each, "
            f"for two to six hours, all readings or about half of them. Forecasts are off by up to "
            f"30 % and 30 % an hour. {wall_s / 60:.1f} min; {machine()}.",
        ]
    )
    return report(folder / "alarms", "Frozen readings", text, days, wall_s)


STUDY = Study(run_one, write_report)


main = STUDY.command(
    days=200, words="Freeze readings on random days, and count alarms that are false or missing."
)


if __name__ == "__main__":
    typer.run(main)

"""Windows of the kinds that users bring: each row of ``hard.csv`` determines one completely.

``python -m benchmarks.hard KIND SEED ...`` tells a window; rows were chosen from windows sampled by
seed, the slowest of each kind (``docs/benchmarks.md``).
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path

import pandas as pd

from benchmarks.hard_days import TRAITS, HardWindow, hard_window
from vppres.core.errors import InputError, Problem

FILE = Path(__file__).with_name("hard.csv")
GROUP = "hard"


@dataclass(frozen=True)
class HardInstance:
    """One window of a random day."""

    name: str  #: unique name
    kind: str  #: trait of the day, a name in :data:`benchmarks.hard_days.TRAITS`
    seed: int  #: makes day and window again
    #: First step and number of steps, and size of the feeder: what the seed must make.
    t0: int
    steps: int
    buses: int
    before_s: float  #: seconds of a processor that it took when it was chosen, compiling included
    before: str  #: how it ended then, at a limit of 10 s

    group = GROUP

    @property
    def reason(self) -> str:
        """Why it is here."""
        return TRAITS[self.kind]

    @cached_property
    def window(self) -> HardWindow:
        """The window that the row stands for.

        Raises
        ------
        InputError
            If the seed makes another.
        """
        window = hard_window(self.kind, self.seed)
        made = (window.t0, window.steps, window.site.network.n_buses)
        if made != (self.t0, self.steps, self.buses):
            raise InputError(
                Problem(
                    FILE.name,
                    f"makes a window of t0, steps, buses {made}",
                    "Draw the table anew: the sampler has changed.",
                    field="seed",
                    value=self.seed,
                )
            )
        return window

    @property
    def place(self) -> str:
        """Where the window lies."""
        return "inside" if (self.window.data.grid_limit_kw <= 0.0).all() else "across"


def read_hard(file: Path = FILE) -> list[HardInstance]:
    """All rows of the table.

    Raises
    ------
    InputError
        If columns or kinds are not those of an instance, or a name is given twice.
    """
    table = pd.read_csv(file)
    expected = [field.name for field in fields(HardInstance)]
    if list(table.columns) != expected:
        raise InputError(
            Problem(
                file.name,
                "has other columns than an instance",
                f"Write exactly: {', '.join(expected)}.",
            )
        )
    unknown = sorted(set(table["kind"]) - set(TRAITS))
    if unknown or table["name"].duplicated().any():
        raise InputError(
            Problem(
                file.name,
                "has a kind that is not known, or a name twice",
                f"Kinds are {', '.join(TRAITS)}.",
                field="kind",
                value=", ".join(unknown),
            )
        )
    return [
        HardInstance(**{str(name): value for name, value in row.items()})
        for row in table.to_dict("records")
    ]

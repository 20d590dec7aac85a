"""Arguments and options of the command `sweep` alone."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Param = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        help="An option of run without its hyphens (horizon, load-bias, ...), or "
        "a number of the scenario: outage.hours; scale.load, .pv, .batteries, .price (factors); "
        "tiers.TIER; network., objective. or batteries. with the name of a field.",
    ),
]
Out = Annotated[
    Path, typer.Option(metavar="DIR", help="Folder for the run folders, the table and the page.")
]
Values = Annotated[str | None, typer.Option(metavar="A,B,C", help="Values, separated by commas.")]
Range = Annotated[
    str | None,
    typer.Option(
        "--range", metavar="START:STOP:N", help="N equidistant values, both ends included."
    ),
]
Jobs = Annotated[int | None, typer.Option(min=1, help="Runs at a time; one per core if not given.")]
Scheduler = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS|FILE|local",
        envvar="DASK_SCHEDULER_ADDRESS",
        help="Run on a Dask cluster: the address of its scheduler (tcp://...), its file, or "
        "local to start one on this machine. "
        "DIR must be a folder that all machines see.",
    ),
]

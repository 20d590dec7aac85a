"""Arguments and options of `vppres backtest`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

HistoryName = Annotated[
    str,
    typer.Argument(
        metavar="HISTORY",
        help="A folder with load_kw and pv_kw as CSV or Parquet, a file of demand alone, or a "
        "scenario with a history or several days.",
    ),
]
Out = Annotated[Path, typer.Option(metavar="DIR", help="Where to write page and tables.")]
Horizon = Annotated[
    float, typer.Option(metavar="HOURS", min=1.0, max=336.0, help="Length of a forecast.")
]
Every = Annotated[
    float,
    typer.Option(
        metavar="HOURS",
        min=0.25,
        help="Time between two forecasts; one that does not divide 24 h has every lead at every "
        "hour.",
    ),
]
Forecasts = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Your own quantiles to score, with the series load and pv; the seasonal "
        "forecaster if not given.",
    ),
]
Warnings = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Outage warnings to score, like warnings.csv of a scenario; the scenario's own if not "
        "given. Needs --outages.",
    ),
]
Outages = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Actual outages, a table with start and end, to score the warnings against.",
    ),
]
First = Annotated[
    str | None,
    typer.Option(
        "--from",
        metavar="TIME",
        help="First issue, ISO 8601; as soon as there is enough history if not given.",
    ),
]
Last = Annotated[
    str | None, typer.Option("--to", metavar="TIME", help="Last issue; as late as possible.")
]
Zone = Annotated[
    str | None,
    typer.Option(
        metavar="ZONE",
        help="Local time zone, for example Europe/London; the scenario's, or UTC, if not given.",
    ),
]

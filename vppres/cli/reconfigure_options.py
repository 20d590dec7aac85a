"""Options of `vppres reconfigure`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Source = Annotated[
    str,
    typer.Argument(
        metavar="NETWORK",
        help="A network as for `new`, or a scenario: the name of a packaged one, or a folder.",
    ),
]

Switch = Annotated[
    list[str] | None,
    typer.Option(
        "--switch",
        metavar="NAME",
        help="A switch or line (7-8) that may move; may be repeated. All may if not given.",
    ),
]
VMin = Annotated[
    float | None,
    typer.Option(
        "--v-min", metavar="PU", min=0.0, help="Lowest voltage; the feeder's limit if not given."
    ),
]
VMax = Annotated[
    float | None,
    typer.Option(
        "--v-max", metavar="PU", min=0.0, help="Highest voltage; the feeder's limit if not given."
    ),
]
Ratings = Annotated[
    bool, typer.Option("--ratings/--no-ratings", help="Keep currents within ratings.")
]
Most = Annotated[
    int,
    typer.Option(
        min=1, help="Number of radial configurations up to which all are solved, which is exact."
    ),
]
Attempts = Annotated[int, typer.Option(min=1, help="Starts of the search where there are more.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of the search.")]
At = Annotated[
    str | None,
    typer.Option(
        metavar="TIME",
        help="Time of the loads of a scenario; that of the largest demand if not given.",
    ),
]
AnyLine = Annotated[
    bool,
    typer.Option(
        "--any-line", help="Lines of a scenario without a switch may be opened too, as in studies."
    ),
]
Out = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR", help="Write the scenario with the configuration found, into a new folder."
    ),
]

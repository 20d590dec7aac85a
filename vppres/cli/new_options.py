"""Arguments and options of the command `new`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

NetworkName = Annotated[
    str,
    typer.Argument(
        metavar="NETWORK",
        help="case33bw, case69, cigre-mv, cigre-mv-der, a file (.json of "
        "pandapower, .m or .mat of MATPOWER, .dss of OpenDSS), or a SimBench code.",
    ),
]
NewFolder = Annotated[Path, typer.Argument(metavar="OUT_DIR", help="The scenario's folder.")]
From = Annotated[
    Literal["pandapower", "matpower", "opendss", "simbench"] | None,
    typer.Option("--from", help="Where the network comes from; by the file's suffix if not given."),
]
Open = Annotated[
    list[str] | None,
    typer.Option(
        "--open",
        metavar="BRANCH",
        help="Open a branch, as 'line 7' or by its name; may be repeated.",
    ),
]
OpenLoops = Annotated[
    bool,
    typer.Option(
        "--open-loops",
        help="Open the branches with the least current until the network is radial.",
    ),
]
Slack = Annotated[
    str | None,
    typer.Option(
        metavar="GRID",
        help="The grid connection of several, by its name or bus, or 'all' to join them.",
    ),
]
Balance = Annotated[
    bool, typer.Option("--balance", help="Spread loads of single phases over three.")
]
SourceNames = Annotated[
    bool,
    typer.Option(
        "--source-names",
        help="Names of the network for everything, and a customer for each of its loads.",
    ),
]
Outages = Annotated[
    list[str] | None,
    typer.Option(
        "--outage",
        metavar="START..END",
        help="12:00..18:00 on the first day, or dates with time zones; may be repeated.",
    ),
]
Start = Annotated[
    str | None,
    typer.Option(metavar="TIME", help="Beginning of the first day; 2025-07-01T00:00Z by default."),
]
Date = Annotated[
    str | None,
    typer.Option(
        metavar="YYYY-MM-DD", help="First day, from midnight to midnight on the feeder's clocks."
    ),
]

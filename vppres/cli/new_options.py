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
Outages = Annotated[
    list[str] | None,
    typer.Option(
        "--outage",
        metavar="START..END",
        help="12:00..18:00 on the first day, or dates with time zones; may be repeated.",
    ),
]
Start = Annotated[str, typer.Option(metavar="DATE", help="Beginning of the first day.")]
StepMinutes = Annotated[float, typer.Option(metavar="M", help="Length of a step.")]
Days = Annotated[int, typer.Option(help="Number of days.")]
DrawSeed = Annotated[int, typer.Option(help="Seed of the drawn tiers and PV buses.")]
TierShares = Annotated[
    tuple[float, float, float], typer.Option(help="Shares of critical, high and low customers.")
]
PV = Annotated[
    Literal["auto", "existing", "sized", "none"],
    typer.Option(
        help="The network's PV, PV by the rule of size, the former if there is any (auto), or none."
    ),
]
PVShareOfPeak = Annotated[
    float, typer.Option(help="kW of sized PV per kW of a customer's peak load.")
]
PVShareOfBuses = Annotated[float, typer.Option(help="Share of the customers with sized PV.")]
BatterySize = Annotated[
    float, typer.Option(help="kWh of battery per kW of a customer's peak load; 0 for no batteries.")
]
Price = Annotated[Literal["time-of-use", "flat"], typer.Option(help="Import price.")]
SlackVoltage = Annotated[
    float | None,
    typer.Option(metavar="PU", help="Voltage of the slack bus; the network's if not given."),
]

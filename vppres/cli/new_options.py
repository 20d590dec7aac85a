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
Start = Annotated[
    str | None,
    typer.Option(metavar="TIME", help="Beginning of the first day; 2025-07-01T00:00Z by default."),
]
StepMinutes = Annotated[float, typer.Option(metavar="M", help="Length of a step.")]
Days = Annotated[int, typer.Option(help="Number of days.")]
DrawSeed = Annotated[int, typer.Option(help="Seed of the drawn tiers and PV buses.")]
DrawTiers = Annotated[
    bool,
    typer.Option(
        "--draw-tiers", help="Draw a tier for every customer that the network gives none."
    ),
]
TierShares = Annotated[
    tuple[float, float, float] | None,
    typer.Option(
        help="Shares of critical, high and low customers that --draw-tiers draws; 0.2 0.3 0.5 if "
        "not given."
    ),
]
PV = Annotated[
    Literal["existing", "sized", "none"],
    typer.Option(
        help="The network's PV, wind and other generators; PV invented by size instead of "
        "the network's PV; or no generator."
    ),
]
PVShareOfPeak = Annotated[
    float | None,
    typer.Option(help="kW of sized PV per kW of a customer's peak load; 0.5 if not given."),
]
AddBatteries = Annotated[
    bool,
    typer.Option("--add-batteries", help="Invent a battery at every customer, sized by its load."),
]
BatterySize = Annotated[
    float | None,
    typer.Option(
        help="kWh of an added battery per kW of the customer's peak load; 0.625 if not given."
    ),
]
TimeZone = Annotated[
    str | None,
    typer.Option(
        metavar="ZONE",
        help="Zone of the feeder's clocks, for example Europe/London: of its days, and of times "
        "without offset.",
    ),
]
Date = Annotated[
    str | None,
    typer.Option(
        metavar="YYYY-MM-DD", help="First day, from midnight to midnight on the feeder's clocks."
    ),
]
Profiles = Annotated[
    str | None,
    typer.Option(
        metavar="PATH|source",
        help="Series of load and generation: a folder or file, or 'source' for the network's own.",
    ),
]
ProfileUnit = Annotated[
    Literal["kw", "mw", "pu"] | None,
    typer.Option(help="Unit of series without a unit in column or file name."),
]
ProfileStep = Annotated[
    float | None,
    typer.Option(metavar="M", help="Minutes of a row of series that have no times."),
]
MaxGap = Annotated[
    float, typer.Option(metavar="M", help="Minutes of the longest gap of a series that is filled.")
]
ExportLimit = Annotated[
    float, typer.Option(metavar="KW", help="Largest export; inf for no limit, 0 imports only.")
]
ExportPrice = Annotated[float, typer.Option(metavar="GBP", help="What an exported kWh earns.")]
AcceptDeviation = Annotated[
    bool,
    typer.Option(
        "--accept-deviation",
        help="Import even if voltages are more than 0.005 pu from the source's.",
    ),
]
SlackVoltage = Annotated[
    float | None,
    typer.Option(metavar="PU", help="Voltage of the slack bus; the network's if not given."),
]

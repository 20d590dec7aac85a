"""Arguments and options of single commands, as types."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

# `new`

NetworkName = Annotated[
    str,
    typer.Argument(
        metavar="NETWORK",
        help="case16, case33bw, case69, cigre-mv, cigre-mv-der, a file (.json of "
        "pandapower, .m or .mat of MATPOWER, .dss of OpenDSS), or a SimBench code.",
    ),
]
NewFolder = Annotated[Path, typer.Argument(metavar="OUT_DIR", help="The scenario's folder.")]
NewOutages = Annotated[
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

# `reconfigure`

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
ReconfigureSeed = Annotated[int, typer.Option(min=0, help="Seed of the search.")]
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
ReconfigureOut = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR", help="Write the scenario with the configuration found, into a new folder."
    ),
]

# `serve`

Host = Annotated[
    str, typer.Option(help="Address to listen on; others than this machine's need tokens and TLS.")
]
Port = Annotated[int, typer.Option(min=1, max=65535, help="Port to listen on.")]
State = Annotated[
    str | None,
    typer.Option(
        metavar="PLACE",
        envvar="VPPRES_STATE",
        help="Where the service keeps its state: a folder, SCENARIO.live if not given, or "
        "postgresql://USER@HOST/DATABASE.",
    ),
]
Rehearse = Annotated[
    bool, typer.Option(help="Play the scenario's own steps, each when POST /v1/steps asks for it.")
]
Paced = Annotated[
    bool,
    typer.Option(
        help="Let the clock be set by PUT /v1/clock, as `vppres serve simulate` does. "
        "A step is decided when POST /v1/steps asks for it, not by itself."
    ),
]
KeepDays = Annotated[
    float, typer.Option(min=1.0, help="How long readings and plans are kept, in days.")
]
Notify = Annotated[
    list[str] | None,
    typer.Option(
        metavar="URL",
        envvar="VPPRES_NOTIFY",
        help="Where alarms are sent: https://HOST/PATH or smtp://USER@HOST:PORT/TO?from=FROM; "
        "may be given several times.",
    ),
]
AddToken = Annotated[
    str | None,
    typer.Option(
        metavar="NAME:SCOPES",
        help="Make a token, print it and end; scopes: read, telemetry, events, operator.",
    ),
]
TokenDays = Annotated[
    float | None, typer.Option(min=0.0, help="With --add-token: days after which it ends.")
]
RemoveToken = Annotated[str | None, typer.Option(metavar="NAME", help="Remove a token and end.")]
Certificate = Annotated[
    Path | None, typer.Option(help="Certificate for TLS, a PEM file; needs --key.")
]
Key = Annotated[Path | None, typer.Option(help="Its private key, a PEM file.")]
BehindProxy = Annotated[
    bool, typer.Option(help="A proxy in front does TLS; other machines need TLS.")
]
ProxyName = Annotated[
    list[str] | None,
    typer.Option(help="A name under which a proxy calls; may be given several times."),
]

# `serve export`

Begin = Annotated[str, typer.Option("--from", metavar="TIME", help="Beginning, ISO 8601.")]
End = Annotated[str, typer.Option("--to", metavar="TIME", help="End, ISO 8601.")]
RunFolder = Annotated[Path, typer.Option(metavar="DIR", help="Folder of the run.")]
ReadState = Annotated[
    str | None,
    typer.Option(
        metavar="PLACE",
        envvar="VPPRES_STATE",
        help="Of the service; SCENARIO.live if not given.",
    ),
]
Explain = Annotated[bool, typer.Option(help="Add reasons for customers and batteries.")]

# `serve simulate`

SiteName = Annotated[str, typer.Argument(metavar="SITE", help="The site that is served.")]
WorldName = Annotated[
    str | None,
    typer.Argument(
        metavar="SCENARIO", help="The scenario to play; the site's own days if not given."
    ),
]
ServeSpeed = Annotated[
    float, typer.Option(min=0.0, help="Simulated over real time; 0: as fast as it decides.")
]
ServeUrl = Annotated[
    str | None,
    typer.Option(help="A service started with --paced or --rehearse; its own if not given."),
]
AccessToken = Annotated[
    str | None, typer.Option(envvar="VPPRES_TOKEN", help="Token for that service.")
]
OwnPort = Annotated[
    int | None, typer.Option(min=1, max=65535, help="Port of its own service; a free one.")
]
OwnState = Annotated[
    Path | None,
    typer.Option(metavar="DIR", help="State of its own service; dropped if not given."),
]
AnnouncedBefore = Annotated[
    float, typer.Option(min=0.0, help="How long before an outage it is announced, in h.")
]
LostShare = Annotated[float, typer.Option(min=0.0, max=1.0, help="Share of readings lost.")]
DelayedShare = Annotated[
    float, typer.Option(min=0.0, max=1.0, help="Share of readings up to three steps late.")
]
ClockSkew = Annotated[float, typer.Option(help="Clock error of sources, in s.")]
Repeats = Annotated[bool, typer.Option(help="Send every reading twice.")]
ServeSeed = Annotated[int, typer.Option(min=0, help="Seed of what is lost, late or skewed.")]

# `feeds` and `feeds replay`

Which = Annotated[
    str | None,
    typer.Argument(metavar="[FEED]", help="ukpn, ssen or nged; all are listed if none is named."),
]
Played = Annotated[str, typer.Argument(metavar="FEED", help="ukpn, ssen or nged.")]
Folder = Annotated[Path, typer.Argument(metavar="FOLDER", help="Recorded answers, a file each.")]
Postcodes = Annotated[
    list[str] | None,
    typer.Option(
        "--postcode",
        metavar="AREA",
        help="A postcode, sector or district of the site; may be given several times.",
    ),
]
FeedsUrl = Annotated[
    str | None,
    typer.Option("--service", metavar="URL", help="The service; changes are only shown without."),
]
FeedsEvery = Annotated[float, typer.Option(help="Minutes between two requests, 1 at least.")]
Record = Annotated[
    Path | None, typer.Option(metavar="DIR", help="Keep every answer in a folder, for a replay.")
]
FeedsSpeed = Annotated[
    float, typer.Option(min=0.0, help="Recorded over real time; 0: one after another.")
]

# `sweep`

Param = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        help="An option of run without its hyphens (horizon, load-bias, ...), or "
        "a number of the scenario: outage.hours; scale.load, .pv, .batteries, .price (factors); "
        "tiers.TIER; network., objective. or batteries. with the name of a field.",
    ),
]
SweepOut = Annotated[
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

# `survival`

SurvivalOut = Annotated[
    Path,
    typer.Option(metavar="DIR", help="Folder for the tables, the page and what is finished."),
]
Lengths = Annotated[
    str | None,
    typer.Option(
        metavar="A,B,C", help="Lengths of the outages in h; 1,2,4,8,12,24,48 if not given."
    ),
]
Onsets = Annotated[
    int,
    typer.Option(min=1, help="Beginnings to try, drawn by chance; every step if it has no more."),
]
Charged = Annotated[
    float | None,
    typer.Option(
        metavar="SHARE",
        min=0.0,
        max=1.0,
        help="State of charge when an outage begins; that of operation without outages if not "
        "given.",
    ),
]
Scale = Annotated[
    str | None,
    typer.Option(
        metavar="NAME=A,B,C",
        help="Variants beside each other: batteries, pv or load times each factor.",
    ),
]

# `backtest`

HistoryName = Annotated[
    str,
    typer.Argument(
        metavar="HISTORY",
        help="A folder with load_kw and pv_kw as CSV or Parquet, a file of demand alone, or a "
        "scenario with a history or several days.",
    ),
]
BacktestOut = Annotated[Path, typer.Option(metavar="DIR", help="Where to write page and tables.")]
Horizon = Annotated[
    float, typer.Option(metavar="HOURS", min=1.0, max=336.0, help="Length of a forecast.")
]
BacktestEvery = Annotated[
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
BacktestOutages = Annotated[
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

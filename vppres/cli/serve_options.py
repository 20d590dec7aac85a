"""Arguments and options of `vppres serve`, `serve export` and `serve simulate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

# serve

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

# serve export

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

# serve simulate

SiteName = Annotated[str, typer.Argument(metavar="SITE", help="The site that is served.")]
WorldName = Annotated[
    str | None,
    typer.Argument(
        metavar="SCENARIO", help="The scenario to play; the site's own days if not given."
    ),
]
Speed = Annotated[
    float, typer.Option(min=0.0, help="Simulated over real time; 0: as fast as it decides.")
]
Url = Annotated[
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
Seed = Annotated[int, typer.Option(min=0, help="Seed of what is lost, late or skewed.")]

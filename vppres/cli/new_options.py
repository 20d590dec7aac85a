"""Arguments of the command `new`, and options of its days."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

NetworkName = Annotated[
    str,
    typer.Argument(
        metavar="NETWORK",
        help="case16, case33bw, case69, cigre-mv, cigre-mv-der, a file (.json of "
        "pandapower, .m or .mat of MATPOWER, .dss of OpenDSS), or a SimBench code.",
    ),
]
NewFolder = Annotated[Path, typer.Argument(metavar="OUT_DIR", help="The scenario's folder.")]
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

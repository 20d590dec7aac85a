"""Arguments and options of `vppres feeds` and `feeds replay`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

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
Url = Annotated[
    str | None,
    typer.Option("--service", metavar="URL", help="The service; changes are only shown without."),
]
Every = Annotated[float, typer.Option(help="Minutes between two requests, 1 at least.")]
Record = Annotated[
    Path | None, typer.Option(metavar="DIR", help="Keep every answer in a folder, for a replay.")
]
Speed = Annotated[
    float, typer.Option(min=0.0, help="Recorded over real time; 0: one after another.")
]

"""Options of `vppres survival`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Out = Annotated[
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

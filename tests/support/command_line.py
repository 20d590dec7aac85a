"""The command line, called in the tests' own process."""

from __future__ import annotations

from pathlib import Path

from typer.testing import CliRunner, Result

from vppres.cli import commands as cli


def call(*arguments: str | Path) -> Result:
    """Run the command in this process; stdout and stderr are kept apart."""
    return CliRunner().invoke(cli.app, [str(a) for a in arguments], prog_name="vppres")

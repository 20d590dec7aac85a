"""The command line, called in the tests' own process."""

from __future__ import annotations

import shlex

from typer.testing import CliRunner, Result

from vppres.cli import commands as cli


def call(words: str, *arguments: object) -> Result:
    """Run the command in this process; stdout and stderr are kept apart.

    ``words`` is a command with options as it is typed; further arguments are taken as they are.
    """
    line = [*shlex.split(words), *map(str, arguments)]
    return CliRunner().invoke(cli.app, line, prog_name="vppres")

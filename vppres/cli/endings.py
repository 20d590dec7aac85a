"""How a command ends that does not succeed: a sentence on stderr and an exit status."""

from __future__ import annotations

import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NoReturn

import typer
from rich.console import Console

from vppres.cli.tables import error_panel
from vppres.core.errors import InputError, VppresError

# The shell's convention: 128 and the number of the signal.
INTERRUPTED = 130
TERMINATED = 143


class Terminated(KeyboardInterrupt):
    """SIGTERM came: batch systems and service managers end a command with it."""


@contextmanager
def extra(name: str) -> Iterator[None]:
    """Say which extra brings a package that is missing."""
    try:
        yield
    except ImportError as error:
        raise InputError.of(
            name,
            f"needs the package {error.name}",
            f'Install the extra: pip install "vppres[{name}]".',
        ) from error


@contextmanager
def plain_errors(debug: bool) -> Iterator[None]:
    """Turn every exception into a sentence on stderr and an exit status."""
    try:
        yield
    except Terminated as error:
        _fail(f"Terminated; {_left(error)}", TERMINATED, debug)
    except KeyboardInterrupt as error:
        _fail(f"Interrupted; {_left(error)}", INTERRUPTED, debug)
    except VppresError as error:
        _fail(str(error), error.exit_status, debug)
    except (BrokenPipeError, typer.Exit):
        raise  # the reader of the output has seen enough, as `head` has, or all is said
    except Exception as error:
        _fail(
            f"Unexpected {type(error).__name__}: {error}. Run again with --debug for the "
            "traceback.",
            1,
            debug,
        )


def _left(interrupt: KeyboardInterrupt) -> str:
    """Remains of an interrupted command: nothing, unless a note of the interrupt says more."""
    notes: list[str] = getattr(interrupt, "__notes__", [])
    return notes[0] if notes else "nothing was written."


def _fail(message: str, status: int, debug: bool) -> NoReturn:
    """End the command; with ``debug`` the traceback replaces the bare message."""
    console = Console(stderr=True)
    if console.is_terminal and not debug:
        console.print(error_panel(message))
    else:
        typer.echo(traceback.format_exc() if debug else message, err=True)
    raise typer.Exit(status)

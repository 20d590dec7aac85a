"""The command line: the only module that prints.

Libraries that are slow to load are imported inside the commands, so that ``vppres --help`` answers
at once.
"""

from __future__ import annotations

import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NoReturn

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from vppres.errors import VppresError

if TYPE_CHECKING:
    from vppres.scenario import Scenario
    from vppres.simulate import RunOptions
    from vppres.trajectory import Trajectory

INTERRUPTED = 130  # the shell's convention: 128 + SIGINT
RESULTS = Path("results")

# Key of the summary, words, format, unit; in the order of the printed table.
FIGURES = (
    ("resilience", "resilience", ".4f", ""),
    ("cost_gbp", "cost of the import", ",.2f", "GBP"),
    ("import_kwh", "imported energy", ",.1f", "kWh"),
    ("pv_curtailed_kwh", "curtailed PV energy", ",.2f", "kWh"),
    ("v_min_ac_pu", "lowest AC voltage", ".4f", "pu"),
    ("v_max_ac_pu", "highest AC voltage", ".4f", "pu"),
    ("v_error_max_pu", "largest voltage error of the model", ".4f", "pu"),
    ("corrections", "corrected steps", "d", ""),
    ("gap_max", "largest optimality gap", ".2e", ""),
)

app = typer.Typer(add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False,
                  help="Dispatch a virtual power plant through an outage.")


def main() -> None:
    """Entry point of the console script and of ``python -m vppres``."""
    app(prog_name="vppres")


def _print_version(wanted: bool) -> None:
    if wanted:
        import vppres

        typer.echo(f"vppres {vppres.__version__}")
        raise typer.Exit


def _positive(value: float) -> float:
    """Refuse what the bounds of an option let pass, NaN and infinity."""
    if not (isfinite(value) and value > 0):
        raise typer.BadParameter(f"{value} is not a positive number.")
    return value


@app.callback()
def common(
    version: Annotated[bool, typer.Option(
        "--version", callback=_print_version, is_eager=True, help="Print the version and end."),
    ] = False,
) -> None:
    """Dispatch a virtual power plant through an outage."""


# The arguments of a typer command are its options, hence their number.
@app.command()
def run(
    scenario: Annotated[str, typer.Argument(help="A packaged scenario's name, or a folder.")],
    controller: Annotated[str | None, typer.Option(
        help="mpc or full-horizon; the scenario's if not given.")] = None,
    horizon: Annotated[float | None, typer.Option(
        metavar="HOURS",
        help="Prediction horizon of the MPC; the scenario's if not given.")] = None,
    solver: Annotated[str, typer.Option(help="Solver of the mixed-integer problems.")] = "highs",
    method: Annotated[str, typer.Option(help="decomposed or monolithic.")] = "decomposed",
    load_bias: Annotated[float, typer.Option(
        help="Share by which the load forecast is too high.")] = 0.0,
    load_error: Annotated[float, typer.Option(
        help="Random error of the load forecast: growth of sigma per hour ahead.")] = 0.0,
    pv_bias: Annotated[float, typer.Option(
        help="Share by which the PV forecast is too high.")] = 0.0,
    pv_error: Annotated[float, typer.Option(
        help="Random error of the PV forecast: growth of sigma per hour ahead.")] = 0.0,
    thermal: Annotated[Literal["off", "exact", "euler"], typer.Option(
        help="Battery heating, and its time integration.")] = "off",
    seed: Annotated[int, typer.Option(help="Seed of the random forecast errors.")] = 0,
    out: Annotated[Path | None, typer.Option(
        metavar="DIR", help="Run folder; results/SCENARIO-CONTROLLER if not given.")] = None,
    time_limit: Annotated[float, typer.Option(
        metavar="S", callback=_positive, help="Time limit of one window in seconds.")] = 60.0,
    gap: Annotated[float, typer.Option(
        callback=_positive, help="Relative optimality gap at which a window is done.")] = 1e-4,
    quiet: Annotated[bool, typer.Option("--quiet", help="No progress bar.")] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks of errors.")] = False,
) -> None:
    """Run a scenario's day and write a run folder."""
    with _plain_errors(debug):
        from vppres.forecast import ForecastErrors
        from vppres.io.atomic import check_target
        from vppres.io.find import find_scenario
        from vppres.io.scenario_folder import read_scenario
        from vppres.report import write_run
        from vppres.simulate import RunOptions
        from vppres.solve.result import SolveLimits

        day = read_scenario(find_scenario(scenario))
        options = RunOptions(
            controller=controller or day.controller.kind,
            horizon_h=day.controller.horizon_h if horizon is None else horizon,
            solver=solver, method=method, thermal=thermal, seed=seed,
            errors=ForecastErrors(load_bias, load_error, pv_bias, pv_error),
            limits=SolveLimits(gap_rel=gap, time_s=time_limit))
        folder = out or RESULTS / f"{day.name}-{options.controller}"
        check_target(folder)  # before the work, not after it
        trajectory = _run_with_bar(day, options, quiet)
        _print_figures(write_run(trajectory, folder), day.title)
        typer.echo(f"Written to {folder}")


@app.command()
def scenarios() -> None:
    """List the scenarios that come with the package."""
    with _plain_errors(debug=False):
        from vppres.io.find import packaged_scenarios

        for name in packaged_scenarios():
            typer.echo(name)


@contextmanager
def _plain_errors(debug: bool) -> Iterator[None]:
    """Turn every exception into a sentence on stderr and an exit status."""
    try:
        yield
    except KeyboardInterrupt:
        _fail("Interrupted; nothing was written.", INTERRUPTED, debug)
    except VppresError as error:
        _fail(str(error), error.exit_status, debug)
    except Exception as error:
        _fail(f"Unexpected {type(error).__name__}: {error}. Run again with --debug for the "
              "traceback.", 1, debug)


def _fail(message: str, status: int, debug: bool) -> NoReturn:
    """End the command; with ``debug`` the traceback takes the place of the bare message."""
    typer.echo(traceback.format_exc() if debug else message, err=True)
    raise typer.Exit(status)


def _run_with_bar(day: Scenario, options: RunOptions, quiet: bool) -> Trajectory:
    """Run the day with a progress bar on stderr, if that is a terminal."""
    from vppres.simulate import run_day

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(),
               TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True,
                  disable=quiet or not console.is_terminal) as bar:
        task = bar.add_task(options.controller, total=day.grid.n_steps)

        def show(step: int, total: int) -> None:
            bar.update(task, completed=step, total=total)

        return run_day(day, options, progress=show)


def _print_figures(summary: dict[str, Any], title: str) -> None:
    """Key figures of a run as a table on stdout; what is not defined is left out."""
    table = Table(title=title, show_header=False)
    table.add_column()
    table.add_column(justify="right")
    table.add_column()
    for key, words, form, unit in FIGURES:
        if summary[key] is not None:
            table.add_row(words, format(summary[key], form), unit)
    for tier, share in summary["served_share"].items():
        if share is not None:
            table.add_row(f"served in the outage, {tier}", f"{share:.1%}", "")
    table.add_row("solve time", f"{summary['solve_s']['total']:.1f}", "s")
    Console().print(table)

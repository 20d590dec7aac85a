"""The commands, one function each: input, calls of other packages, output.

Libraries that are slow to load are imported inside the commands, so that ``vppres --help`` answers
at once.
"""

from __future__ import annotations

import gc
import json
import signal
import sys
import threading
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer
from rich.console import Console
from rich.table import Table

from vppres.cli import arguments as of
from vppres.cli.endings import TERMINATED, Terminated, extra
from vppres.cli.options import (
    CommandGroup,
    DayCommand,
    Figures,
    ImportCommand,
    Json,
    LiveCommand,
    NewCommand,
    Quiet,
    RunCommand,
    RunFolder,
    SafeCommand,
    ScenarioName,
    fields_of,
    figure_kinds,
    run_options,
)
from vppres.cli.progress import progress_bar
from vppres.cli.tables import (
    comparison_table,
    content_of,
    figures_table,
    order_told,
    phases_table,
    problem_record,
    recheck_lines,
    reconfiguration_table,
    remarks_told,
    simulation_lines,
    survival_table,
    sweep_table,
    validation_text,
)
from vppres.core.errors import InputError, Problem, VerificationError
from vppres.scenario.option_table import IMPORT_OPTIONS, NEW_OPTIONS

if TYPE_CHECKING:
    from vppres.day.trajectory import Trajectory
    from vppres.feeders.cross_check import CrossCheck
    from vppres.feeders.phased_check import PhasedCheck
    from vppres.feeds.follow import Follower
    from vppres.scenario.scenario import Scenario

RESULTS = Path("results")
MOST_DRAWN = 4_500
"""Steps of the longest run that gets figures and a report: half a year of hours. A year's page took
more memory than a machine has."""
# Libraries make a million objects that stay; Python's 700 looks through them again and again,
# which takes a tenth of the time to load.
OBJECTS_BETWEEN_COLLECTIONS = 100_000

app = typer.Typer(
    cls=CommandGroup,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Dispatch a virtual power plant through an outage.",
)


def main() -> None:
    """Entry point of the console script and of ``python -m vppres``."""
    gc.set_threshold(OBJECTS_BETWEEN_COLLECTIONS)
    asked: list[int] = []

    def terminate(number: int, _frame: object) -> NoReturn:
        """End like Ctrl-C, so that what is half written goes; once is enough."""
        signal.signal(number, signal.SIG_IGN)
        asked.append(number)
        raise Terminated

    signal.signal(signal.SIGTERM, terminate)
    try:
        app(prog_name="vppres")
    except Terminated:
        sys.exit(TERMINATED)
    except SystemExit as end:
        # Outside of a command's own block typer takes the exception for Ctrl-C; and an import that
        # is cut off may turn it into an error of its own.
        if asked and end.code:
            sys.exit(TERMINATED)
        raise
    except Exception:
        if asked:
            sys.exit(TERMINATED)
        raise


def _print_version(wanted: bool) -> None:
    if wanted:
        import vppres

        typer.echo(f"vppres {vppres.__version__}")
        raise typer.Exit


@app.callback()
def common(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version and end."
        ),
    ] = False,
) -> None:
    """Dispatch a virtual power plant through an outage."""


# The arguments of a typer command are its options, hence their number.
@app.command(
    cls=RunCommand, epilog="Example: vppres run uk-heatwave-2022 --horizon 3 --load-bias 0.1"
)
def run(
    context: typer.Context,
    scenario: ScenarioName,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Run folder; results/SCENARIO-CONTROLLER if not given."),
    ] = None,
    explain: Annotated[
        bool,
        typer.Option(help="Find a reason for every action and the shadow prices after the day."),
    ] = True,
    figures: Figures = "svg",
    no_figures: Annotated[
        bool,
        typer.Option(
            "--no-figures",
            help="Write tables alone; report draws the figures and writes the page later.",
        ),
    ] = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Run a scenario's day and write a run folder."""
    from vppres.day.simulate import run_day
    from vppres.io.atomic import check_target
    from vppres.io.find import find_scenario
    from vppres.io.scenario_folder import read_scenario
    from vppres.report.run_folder import write_run

    kinds = figure_kinds(figures)
    source = find_scenario(scenario)
    day = read_scenario(source)
    too_long = not no_figures and day.grid.n_steps > MOST_DRAWN
    options = run_options(day, context.obj)
    folder = out or RESULTS / f"{source.resolve().name}-{options.controller}"
    check_target(folder)  # before the work, not after it
    with progress_bar(options.controller, quiet) as bar:
        done = run_day(day, options, progress=bar)
    if explain:
        done = _explained(done, quiet)
    summary = write_run(done, folder, not (no_figures or too_long), kinds)
    without = (
        f"Without figures and report: {day.grid.n_steps} steps are more than the "
        f"{MOST_DRAWN} that a page can hold. The tables hold them all."
    )
    _show(
        {"folder": str(folder), "summary": summary} if as_json else None,
        *(typer.style(f"- {caution}", fg=typer.colors.RED) for caution in summary["cautions"]),
        figures_table(summary, day.title),
        *order_told(done),
        *remarks_told(done),
        *([without] if too_long else []),
        f"Written to {folder}",
    )


@app.command(cls=SafeCommand, epilog="Example: vppres validate ./my-feeder")
def validate(
    scenario: ScenarioName,
    power_flow: Annotated[
        bool,
        typer.Option(
            "--power-flow",
            help="Also compare the AC power flow with pandapower's; of a phased feeder, show its "
            "own by phase. The status is 1 if they differ, or currents do not add up.",
        ),
    ] = False,
    as_json: Json = False,
) -> None:
    """Check a scenario and list all its problems with their fixes; the status is 2 if it has any.

    The problems are sorted by file and row.
    """
    from vppres.io.find import find_scenario
    from vppres.io.scenario_folder import read_scenario, unread_words

    folder = find_scenario(scenario)
    problems: tuple[Problem | str, ...] = ()
    content: dict[str, Any] | None = None
    check: CrossCheck | PhasedCheck | None = None
    try:
        day = read_scenario(folder)
        content = content_of(day)
        content["remarks"] += unread_words(folder)
    except InputError as error:
        problems = error.problems
    if power_flow and not problems:
        check = _cross_check(day)
    record = {
        "folder": str(folder),
        "valid": not problems,
        "content": content,
        "problems": [problem_record(problem) for problem in problems],
        **({} if check is None else {"power_flow": asdict(check)}),
    }
    _show(
        record if as_json else None,
        validation_text(folder.resolve().name, problems, content),
        *([] if check is None else [f"- {check}"]),
    )
    if problems:
        raise typer.Exit(InputError.exit_status)
    if check is not None and not check.agrees:
        raise typer.Exit(VerificationError.exit_status)


def _cross_check(day: Scenario) -> CrossCheck | PhasedCheck:
    """The scenario's AC power flow against pandapower's, which is loaded for it; else by phase."""
    if day.phases:
        from vppres.feeders.phased_check import phased_check

        return phased_check(day, day.phases)
    from vppres.feeders.cross_check import cross_check

    return cross_check(day)


@app.command(
    cls=SafeCommand, epilog="Example: vppres report results/uk-heatwave-2022-mpc --out report.html"
)
def report(
    run_folder: RunFolder,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="HTML file; report.html in the run folder if not given."),
    ] = None,
    pdf: Annotated[
        bool, typer.Option("--pdf", help="Print it as PDF beside the HTML file, with a browser.")
    ] = False,
    voll: Annotated[
        float | None,
        typer.Option(
            metavar="GBP_PER_KWH",
            min=0.0,
            help="Value of lost load for energy not supplied; the scenario's if not given.",
        ),
    ] = None,
    utc: Annotated[
        bool, typer.Option("--utc", help="Show times in UTC, not as the site's clocks do.")
    ] = False,
    figures: Figures = "none",
) -> None:
    """Draw the figures of a finished run again and write its report as one HTML file."""
    from vppres.io.atomic import check_file
    from vppres.report.finished import in_zone, priced, read_finished, rewrite_report
    from vppres.report.pdf import find_browser
    from vppres.report.run_folder import REPORT_FILE

    file = out or run_folder / REPORT_FILE
    if out is not None:
        check_file(out, ".html")  # before the work, not after it
    browser = find_browser() if pdf else ""
    done = read_finished(run_folder)
    done = done if voll is None else priced(done, voll)
    done = in_zone(done) if utc else done
    for written in rewrite_report(done, file, browser, figure_kinds(figures)):
        typer.echo(f"Written to {written}")


@app.command(
    cls=SafeCommand,
    epilog="Example: vppres compare results/mpc results/plan --out mpc-or-plan.html",
)
def compare(
    run_folders: Annotated[
        list[Path],
        typer.Argument(
            metavar="RUN_FOLDER RUN_FOLDER...", help="Two to five folders that run wrote."
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            metavar="FILE|DIR", help="A file that ends in .html, or a folder for comparison.html."
        ),
    ] = RESULTS,
    as_json: Json = False,
) -> None:
    """Compare runs of the same day in one HTML file, with differences to the first."""
    from vppres.io.atomic import check_file
    from vppres.report.pages import write_page
    from vppres.studies.compare import (
        COMPARISON_FILE,
        compared_figures,
        comparison_record,
        read_runs,
        render_comparison,
        same_scenario,
    )

    file = out if out.suffix == ".html" else out / COMPARISON_FILE
    check_file(file)  # before the work, not after it
    runs = read_runs(run_folders)
    write_page(file, render_comparison(runs))
    differing = [row for row in compared_figures(runs) if row.differs]
    _show(
        {"report": str(file), **comparison_record(runs)} if as_json else None,
        comparison_table(list(runs), differing) if differing else "All figures are equal.",
        *([] if same_scenario(runs) else ["The runs differ in their scenario."]),
        f"Written to {file}",
    )


@app.command(
    cls=DayCommand,
    epilog="Example: vppres sweep uk-heatwave-2022 --param horizon --range 0:5:6 "
    "--out results/horizons",
)
def sweep(
    context: typer.Context,
    scenario: ScenarioName,
    param: of.Param,
    out: of.SweepOut,
    values: of.Values = None,
    range_: of.Range = None,
    jobs: of.Jobs = None,
    scheduler: of.Scheduler = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Run a scenario for several values of one parameter, in parallel.

    Each run is a run folder; a table (summary.csv) and a page (sweep.html) hold all of them.
    """
    from vppres.io.atomic import check_target
    from vppres.io.find import load_scenario
    from vppres.studies.side_by_side import Where
    from vppres.studies.sweep import cases_of, outcome_records, run_cases
    from vppres.studies.sweep_page import write_sweep_page
    from vppres.studies.sweep_parameters import chosen_values, find_parameter

    day = load_scenario(scenario)
    parameter = find_parameter(param, day)
    cases = cases_of(
        parameter, chosen_values(parameter, values, range_), day, run_options(day, context.obj)
    )
    check_target(out)
    with progress_bar(parameter.name, quiet) as bar:
        outcomes = run_cases(
            cases,
            out,
            Where(jobs, scheduler),
            bar,
            lambda found, folder: write_sweep_page(parameter.name, day, found, folder),
        )
    record = {"folder": str(out), "parameter": parameter.name, **outcome_records(outcomes)}
    _show(
        record if as_json else None,
        sweep_table(parameter.name, outcomes),
        f"Written to {out}",
    )
    failed = [outcome for outcome in outcomes if outcome.error is not None]
    for outcome in failed:
        typer.echo(f"{parameter.name} = {outcome.value}: {outcome.error}", err=True)
    if failed:
        raise typer.Exit(1)


@app.command(
    cls=DayCommand,
    epilog="Example: vppres survival uk-heatwave-2022 --lengths 1,2,4 --onsets 12 "
    "--scale batteries=1,2 --out results/survival",
)
def survival(
    context: typer.Context,
    scenario: ScenarioName,
    out: of.SurvivalOut,
    lengths: of.Lengths = None,
    onsets: of.Onsets = 200,
    charged: of.Charged = None,
    scale: of.Scale = None,
    jobs: of.Jobs = None,
    scheduler: of.Scheduler = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Estimate how likely customers keep supply, by an outage's beginning and length.

    Tables and a page are written into DIR. What is finished is kept there: the same command goes on
    where it was interrupted.
    """
    from vppres.io.find import load_scenario
    from vppres.studies.side_by_side import Where
    from vppres.studies.survival import Tried, kept_in, lengths_of, variants_of
    from vppres.studies.survival import survival as run_survival
    from vppres.studies.survival_page import answers, write_survival

    site = load_scenario(scenario)
    options = run_options(site, context.obj)
    tried = Tried(lengths_of(lengths, site.grid.dt_h), onsets, charged, options.seed)
    variants = variants_of(site, options, scale)
    with progress_bar("onsets", quiet) as bar:
        study = run_survival(variants, tried, out, Where(jobs, scheduler), bar)
    with kept_in(out):
        record = {"folder": str(out), **write_survival(study, out)}
    _show(
        record if as_json else None,
        survival_table(study.table(), not study.every_step),
        *answers(study, study.table()),
        f"Written to {out}",
    )


@app.command(
    cls=NewCommand, epilog="Example: vppres new case33bw ./my-feeder --outage 12:00..18:00"
)
def new(
    context: typer.Context,
    network: of.NetworkName,
    folder: of.NewFolder,
    outage: of.NewOutages = None,
    start: of.Start = None,
    date: of.Date = None,
) -> None:
    """Make an editable scenario folder from a network."""
    from vppres.feeders import import_network
    from vppres.feeders.new.options import NewScenarioOptions, first_day, parse_outage
    from vppres.feeders.new.scenario import write_new_scenario
    from vppres.io.atomic import check_target

    check_target(folder)  # before the work, not after it
    rules = fields_of(NEW_OPTIONS, context.obj)
    begin = first_day(start, date, rules.get("time_zone"))
    outages = tuple(parse_outage(text, begin) for text in outage or ())
    options = NewScenarioOptions(start=begin, outages=outages, **rules)
    feeder = import_network(network, **fields_of(IMPORT_OPTIONS, context.obj))
    for note in write_new_scenario(feeder, options, folder):
        typer.echo(f"- {note}")
    typer.echo(f"Written to {folder}")


@app.command(
    cls=ImportCommand,
    epilog="Example: vppres reconfigure ./my-feeder --at 2025-07-01T18:00Z --out ./reconfigured",
)
def reconfigure(
    context: typer.Context,
    network: of.Source,
    switch: of.Switch = None,
    v_min: of.VMin = None,
    v_max: of.VMax = None,
    ratings: of.Ratings = True,
    at: of.At = None,
    any_line: of.AnyLine = False,
    out: of.ReconfigureOut = None,
    most: of.Most = 1_000_000,
    attempts: of.Attempts = 100,
    seed: of.ReconfigureSeed = 0,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Find the radial configuration of a feeder with the least losses within its limits."""
    from vppres.feeders.reconfiguration import ConfigurationLimits, least_loss
    from vppres.feeders.reconfiguration.folder import with_configuration
    from vppres.feeders.reconfiguration.loops import switched_network
    from vppres.feeders.reconfiguration.sources import feeder_of_network, feeder_of_scenario
    from vppres.feeders.reconfiguration.words import (
        count_words,
        order_record,
        order_words,
        outcome_words,
        reconfiguration_record,
    )
    from vppres.io.atomic import check_target
    from vppres.io.find import is_scenario, load_scenario
    from vppres.io.scenario_writer import write_scenario

    importing = fields_of(IMPORT_OPTIONS, context.obj)
    if out is not None:
        check_target(out)  # before the work, not after it
    if is_scenario(network):
        day = load_scenario(network)
        source = feeder_of_scenario(day, at, importing)
    else:
        day, any_line = None, True
        source = feeder_of_network(network, importing, {"at": at, "out": out})
    switched = switched_network(source.network, source.switches, switch or (), any_line)
    limits = ConfigurationLimits(
        source.limits_pu[0] if v_min is None else v_min,
        source.limits_pu[1] if v_max is None else v_max,
        ratings,
    )
    if not as_json:
        for words in filter(None, (source.words, f"{source.name}: {count_words(switched, most)}")):
            typer.echo(words)
    with progress_bar("configurations" if switched.count <= most else "attempts", quiet) as bar:
        found = least_loss(
            switched,
            *source.injection,
            limits,
            most=most,
            attempts=attempts,
            seed=seed,
            progress=bar,
        )
    order = source.order_to(switched, found.best, limits)
    record = {
        "feeder": source.name,
        **source.record,
        **reconfiguration_record(switched, found, limits),
        "order": order_record(order),
    }
    written = []
    if out is not None and day is not None:
        write_scenario(with_configuration(day, switched, found.best), out)
        record["folder"], written = str(out), [f"Written to {out}"]
    _show(
        record if as_json else None,
        reconfiguration_table(record),
        *outcome_words(switched, found),
        *order_words(order),
        *written,
    )


@app.command(
    cls=SafeCommand, epilog="Example: vppres recheck results/my-feeder-mpc feeder/Master.dss"
)
def recheck(
    run_folder: RunFolder,
    source: Annotated[
        Path, typer.Argument(metavar="SOURCE", help="The .dss file that the scenario is made from.")
    ],
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Where to write; RUN_FOLDER/recheck if not given."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Solve a run's set-points on the original, unbalanced feeder in OpenDSS."""
    from vppres.io.atomic import check_target
    from vppres.report.finished import read_finished
    from vppres.report.rechecked import recheck_run, write_recheck

    folder = out or run_folder / "recheck"
    check_target(folder)  # before the work, not after it
    run = read_finished(run_folder).trajectory
    summary = write_recheck(run, recheck_run(run, source), folder)
    _show(
        {"folder": str(folder), **summary} if as_json else None,
        phases_table(summary),
        *recheck_lines(summary),
        f"Written to {folder}",
    )


@app.command(cls=LiveCommand, epilog="Example: vppres serve ./my-feeder")
def serve(
    context: typer.Context,
    scenario: ScenarioName,
    host: of.Host = "127.0.0.1",
    port: of.Port = 8420,
    state: of.State = None,
    rehearse: of.Rehearse = False,
    paced: of.Paced = False,
    keep_days: of.KeepDays = 400.0,
    notify: of.Notify = None,
    add_token: of.AddToken = None,
    token_days: of.TokenDays = None,
    remove_token: of.RemoveToken = None,
    certificate: of.Certificate = None,
    key: of.Key = None,
    behind_proxy: of.BehindProxy = False,
    name: of.ProxyName = None,
) -> None:
    r"""Run the controller of a scenario's site as an HTTP service.

    Needs the extra: pip install "vppres\[serve]".
    """
    from vppres.io.find import load_scenario

    with extra("serve"):
        from vppres.service.http import serve as service
        from vppres.service.operation.site import Service
    day = load_scenario(scenario)
    served = Service(day, run_options(day, context.obj), rehearse, paced, keep_days)
    folder = _state_place(scenario, state)
    if add_token is not None:
        typer.echo(service.add_token(served, folder, add_token, token_days))
        return
    if remove_token is not None:
        service.remove_token(served, folder, remove_token)
        return
    names = tuple(name or ())
    address = service.Address(host, port, behind_proxy, names, certificate, key)
    service.serve(served, folder, address, typer.echo, notify or ())


def _state_place(scenario: str, state: str | None) -> str:
    """Place of a service's state: as given, beside the scenario's folder, or with the user's.

    Packaged scenarios have no folder that is written to. Unless a folder is given, the place does
    not depend on the directory of the start.
    """
    from vppres.io.find import packaged_scenarios

    if state is not None:
        address = state.startswith("postgresql://")
        return state if address else str(Path(state).resolve())
    if scenario in packaged_scenarios():
        return str(Path(typer.get_app_dir("vppres"), f"{scenario}.live"))
    folder = Path(scenario).resolve()
    return str(folder.with_name(f"{folder.name}.live"))


@app.command(
    "serve export",
    cls=LiveCommand,
    epilog="Example: vppres serve export ./my-feeder --from 2026-11-21 --to 2026-11-22 --out day",
)
def export(
    context: typer.Context,
    scenario: ScenarioName,
    begin: of.Begin,
    end: of.End,
    out: of.RunFolder = RESULTS / "live",
    state: of.ReadState = None,
    explain: of.Explain = False,
    as_json: Json = False,
) -> None:
    """Export a service's readings and plans as a run folder, for reports and what-ifs.

    The service may run meanwhile. Times without an offset are those of the clocks at the site.
    """
    from vppres.io.atomic import check_target
    from vppres.io.find import load_scenario
    from vppres.report.run_folder import write_run

    with extra("serve"):
        from vppres.service.operation.site import Service
        from vppres.service.replay import export as past
    check_target(out)
    day = load_scenario(scenario)
    served = Service(day, run_options(day, context.obj))
    run = past.export(served, _state_place(scenario, state), begin, end)
    if explain:
        run = _explained(run, quiet=True)
    summary = write_run(run, out, figures=False)
    _show(
        {"folder": str(out), **summary} if as_json else None,
        figures_table(summary, run.scenario.name),
        f"Written to {out}",
    )


@app.command(
    "serve simulate",
    cls=LiveCommand,
    epilog="Example: vppres serve simulate uk-heatwave-2022 --speed 600",
)
def simulate(
    context: typer.Context,
    scenario: of.SiteName,
    world: of.WorldName = None,
    speed: of.ServeSpeed = 0.0,
    url: of.ServeUrl = None,
    token: of.AccessToken = None,
    port: of.OwnPort = None,
    state: of.OwnState = None,
    announced: of.AnnouncedBefore = 24.0,
    lost: of.LostShare = 0.0,
    delayed: of.DelayedShare = 0.0,
    skew: of.ClockSkew = 0.0,
    repeats: of.Repeats = False,
    seed: of.ServeSeed = 0,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    r"""Test a service over HTTP against a simulated plant.

    Needs the extra: pip install "vppres\[serve]".
    """
    from vppres.io.find import load_scenario

    with extra("serve"):
        from vppres.service import simulate as player
        from vppres.service.operation.site import Service
    site = load_scenario(scenario)
    comes = site if world is None else load_scenario(world)
    served = Service(site, run_options(site, context.obj), world is None, world is not None)
    faults = player.TelemetryFaults(lost, delayed, skew, repeats, seed)
    how = player.Play(speed, announced, world is not None, faults)
    where = player.Place(url, token, port, state)
    told = (lambda _: None) if as_json else typer.echo
    with progress_bar("steps", quiet) as bar:
        found = player.simulate(served, comes, how, where, told, bar)
    _show(found if as_json else None, *simulation_lines(found))


@app.command(
    cls=SafeCommand,
    epilog='Example: vppres feeds ukpn --postcode "CM4 0" --service http://127.0.0.1:8420',
)
def feeds(
    feed: of.Which = None,
    postcode: of.Postcodes = None,
    service: of.FeedsUrl = None,
    token: of.AccessToken = None,
    every: of.FeedsEvery = 5.0,
    record: of.Record = None,
) -> None:
    """Follow a public feed of outages as events of a service, until Ctrl-C.

    Without a feed the feeds are listed, and nothing is asked.
    """
    from vppres.feeds.adapters import FEEDS
    from vppres.feeds.follow import Asker, follow

    if feed is None:
        for one in FEEDS.values():
            typer.echo(f"{one.name}: {one.operator}, {one.licence}, {one.url}")
        return
    follower = _follower(feed, postcode, service, token)
    follow(follower, Asker(follower.feed, 60.0 * every), threading.Event(), record)


@app.command(
    "feeds replay",
    cls=SafeCommand,
    epilog='Example: vppres feeds replay day ukpn --postcode "CM4 0" --speed 600',
)
def replay_feed(
    folder: of.Folder,
    feed: of.Played,
    postcode: of.Postcodes = None,
    service: of.FeedsUrl = None,
    token: of.AccessToken = None,
    speed: of.FeedsSpeed = 0.0,
) -> None:
    """Play recorded answers of a feed: events come, change and go.

    With --service they go to a service that was started with --paced, and its clock is set.
    """
    from vppres.feeds.follow import recorded, replay

    follower = _follower(feed, postcode, service, token)
    wrong = replay(follower, recorded(folder, follower.feed), speed, threading.Event().wait)
    if wrong:
        typer.echo(f"Answers that could not be read: {wrong}.", err=True)


def _follower(
    feed: str, postcodes: list[str] | None, service: str | None, token: str | None
) -> Follower:
    """Follower that turns a feed into events of a service, each told in a line."""
    from vppres.feeds.adapters import feed_named
    from vppres.feeds.follow import Follower, events_at
    from vppres.feeds.incidents import check_areas

    source = feed_named(feed)
    areas = check_areas(postcodes or ())
    return Follower(source, areas, events_at(service, token), typer.echo)


@app.command(
    cls=SafeCommand,
    epilog="Example: vppres backtest data/homes --zone Etc/GMT+8 --out results/backtest",
)
def backtest(
    history: of.HistoryName,
    out: of.BacktestOut = RESULTS / "backtest",
    forecasts: of.Forecasts = None,
    warnings: of.Warnings = None,
    outages: of.BacktestOutages = None,
    horizon: of.Horizon = 48.0,
    every: of.BacktestEvery = 7.0,
    first: of.First = None,
    last: of.Last = None,
    zone: of.Zone = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Score forecasts of load and PV power: tables and a page."""
    from vppres.io.atomic import check_target
    from vppres.io.times import option_time
    from vppres.studies.backtest import Plan, forecasts_in, measured_in
    from vppres.studies.backtest import backtest as run_backtest
    from vppres.studies.backtest_page import backtest_findings, write_backtest
    from vppres.studies.warning_scores import warnings_scored

    warned = warnings_scored(history, warnings, outages)
    measured = measured_in(history, zone)
    begin, end = (None if text is None else option_time(text) for text in (first, last))
    plan = Plan(horizon, every, begin, end)
    check_target(out)  # before the work, not after it
    own = None if forecasts is None else forecasts_in(forecasts, measured)
    name = "seasonal" if forecasts is None else forecasts.stem
    with progress_bar("forecasts", quiet) as bar:
        result = run_backtest(measured, plan, own, name, progress=bar)
    summary = write_backtest(result, out, Path(history).name, warned)
    _show(
        {"folder": str(out), "summary": summary} if as_json else None,
        *(f"- {words}" for words in backtest_findings(result, warned)),
        f"Written to {out}",
    )


@app.command(cls=SafeCommand, epilog="Example: vppres schema > my-feeder/scenario.schema.json")
def schema() -> None:
    """Print the JSON Schema of scenario.toml, for editors that complete it."""
    from vppres.io.editor import schema_text

    typer.echo(schema_text(), nl=False)


@app.command(cls=SafeCommand, epilog="Example: vppres scenarios --json")
def scenarios(as_json: Json = False) -> None:
    """List the scenarios that come with the package."""
    from vppres.io.find import find_scenario, packaged_scenarios

    names = packaged_scenarios()
    records = [{"name": name, "folder": str(find_scenario(name))} for name in names]
    _show(records if as_json else None, *names)


def _explained(done: Trajectory, quiet: bool) -> Trajectory:
    """A finished day with the reasons of its actions and the shadow prices."""
    from vppres.explain.day import explain_day

    with progress_bar("explained", quiet) as bar:
        return explain_day(done, bar)


def _show(record: object, *shown: Table | str) -> None:
    """Print a record as JSON for machines, or without one what people read."""
    if record is not None:
        typer.echo(json.dumps(record, indent=2, allow_nan=False))
        return
    for each in shown:
        if isinstance(each, Table):
            Console().print(each)
        else:
            typer.echo(each)

"""Arguments and options of the command line, as types; those that several commands share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from typer.core import TyperCommand

if TYPE_CHECKING:
    from vppres.day.options import RunOptions
    from vppres.scenario.scenario import Scenario


def _positive(value: float) -> float:
    """Refuse what the bounds of an option let pass, NaN and infinity."""
    if not (isfinite(value) and value > 0):
        raise typer.BadParameter(f"{value} is not a positive number.")
    return value


def _complete_scenario(start: str) -> list[str]:
    """Packaged names for the shell; it offers folders itself where none of them fits."""
    from vppres.io.find import packaged_scenarios

    return [name for name in packaged_scenarios() if name.startswith(start)]


FORECAST, SOLVER, SWITCHING = "Forecast errors", "Solver", "Switching"  # headings of the help
GUARD = "Guard and baselines"

ScenarioName = Annotated[str, typer.Argument(
    metavar="SCENARIO", help="A packaged scenario's name, or a folder.",
    autocompletion=_complete_scenario)]
RunFolder = Annotated[Path, typer.Argument(metavar="RUN_FOLDER", help="A folder that run wrote.")]
Json = Annotated[bool, typer.Option("--json", help="Print JSON for machines.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="No progress bar.")]
Debug = Annotated[bool, typer.Option("--debug", help="Show tracebacks of errors.")]

# The options of a day's run, which `run` and `sweep` share.
Controller = Annotated[str | None, typer.Option(
    help="mpc, full-horizon, perfect (full horizon without forecast errors), idle or reserve; the "
    "scenario's if not given.")]
Horizon = Annotated[float | None, typer.Option(
    metavar="HOURS", help="Prediction horizon of the MPC; the scenario's if not given.")]
Solver = Annotated[str, typer.Option(
    help="Solver of the mixed-integer problems.", rich_help_panel=SOLVER)]
Method = Annotated[str, typer.Option(
    help="decomposed or monolithic.", rich_help_panel=SOLVER)]
LoadBias = Annotated[float, typer.Option(
    help="Share by which the load forecast is too high.", rich_help_panel=FORECAST)]
LoadError = Annotated[float, typer.Option(
    help="Random error of the load forecast: growth of sigma per hour ahead.",
    rich_help_panel=FORECAST)]
PVBias = Annotated[float, typer.Option(
    help="Share by which the PV forecast is too high.", rich_help_panel=FORECAST)]
PVError = Annotated[float, typer.Option(
    help="Random error of the PV forecast: growth of sigma per hour ahead.",
    rich_help_panel=FORECAST)]
Thermal = Annotated[Literal["off", "exact", "euler"], typer.Option(
    help="Battery heating, and its time integration.")]
Mode = Annotated[str | None, typer.Option(
    help="paper, or physical: islands that batteries hold; the scenario's if not given.")]
Seed = Annotated[int, typer.Option(
    help="Seed of the random forecast errors.", rich_help_panel=FORECAST)]
TimeLimit = Annotated[float, typer.Option(
    metavar="S", callback=_positive, help="Time limit of one window in seconds.",
    rich_help_panel=SOLVER)]
Gap = Annotated[float, typer.Option(
    callback=_positive, help="Relative optimality gap at which a window is done.",
    rich_help_panel=SOLVER)]
Guard = Annotated[bool, typer.Option(
    "--guard/--no-guard", help="Check every decision and fall back where it cannot be carried out.",
    rich_help_panel=GUARD)]
ProtectCritical = Annotated[bool, typer.Option(
    "--protect-critical", help="Serve the first tier in every step that can serve it.",
    rich_help_panel=GUARD)]
ReserveSoc = Annotated[float | None, typer.Option(
    metavar="SHARE", help="State of charge that reserve charges to; the highest if not given.",
    rich_help_panel=GUARD)]
Notice = Annotated[float, typer.Option(
    metavar="HOURS", help="How long before an outage reserve is told of it.",
    rich_help_panel=GUARD)]


MinServed = Annotated[float | None, typer.Option(
    "--min-served-h", metavar="HOURS", help="Shortest time served after a restoration; for this "
    "and the other rules of switching the scenario's if not given.", rich_help_panel=SWITCHING)]
MinUnserved = Annotated[float | None, typer.Option(
    "--min-unserved-h", metavar="HOURS", help="Shortest time switched off.",
    rich_help_panel=SWITCHING)]
SwitchingPrice = Annotated[float | None, typer.Option(
    help="Price of switching a customer off or on, in weighted customer hours.",
    rich_help_panel=SWITCHING)]
MaxActions = Annotated[int | None, typer.Option(
    help="Most actions of a customer in a day; an off/on pair is two.",
    rich_help_panel=SWITCHING)]
StayRestored = Annotated[bool | None, typer.Option(
    help="Never switch a restored customer off again.", rich_help_panel=SWITCHING)]
ColdLoadFactor = Annotated[float | None, typer.Option(
    help="Demand after a restoration as a multiple of the usual one.",
    rich_help_panel=SWITCHING)]
ColdLoadH = Annotated[float | None, typer.Option(
    "--cold-load-h", metavar="HOURS", help="How long that lasts, at least one step.",
    rich_help_panel=SWITCHING)]
MoveWeight = Annotated[float | None, typer.Option(
    help="Line losses in kW that moving a battery by its rated power away from the previous plan "
    "is worth.", rich_help_panel=SWITCHING)]
RULE_OF = {"min_served_h": "min_served_h", "min_unserved_h": "min_unserved_h",
           "switching_price": "price_per_action", "max_actions": "max_actions_per_customer",
           "stay_restored": "stay_restored", "cold_load_factor": "cold_load_factor",
           "cold_load_h": "cold_load_h", "move_weight": "move_weight"}
"""Option to field of the switching rules."""


def day_options(
    controller: Controller = None,
    horizon: Horizon = None,
    solver: Solver = "highs",
    method: Method = "decomposed",
    load_bias: LoadBias = 0.0,
    load_error: LoadError = 0.0,
    pv_bias: PVBias = 0.0,
    pv_error: PVError = 0.0,
    thermal: Thermal = "off",
    mode: Mode = None,
    seed: Seed = 0,
    time_limit: TimeLimit = 60.0,
    gap: Gap = 1e-4,
    min_served_h: MinServed = None,
    min_unserved_h: MinUnserved = None,
    switching_price: SwitchingPrice = None,
    max_actions: MaxActions = None,
    stay_restored: StayRestored = None,
    cold_load_factor: ColdLoadFactor = None,
    cold_load_h: ColdLoadH = None,
    move_weight: MoveWeight = None,
    guard: Guard = True,
    protect_critical: ProtectCritical = False,
    reserve_soc: ReserveSoc = None,
    notice: Notice = 6.0,
) -> None:
    """Options of a day's run with their defaults, read off by :class:`DayCommand` alone."""


@cache
def _day_parameters() -> tuple[Any, ...]:
    """The options of :func:`day_options` as typer makes them for a command of its own."""
    app = typer.Typer(add_completion=False)
    app.command()(day_options)
    return tuple(typer.main.get_command(app).params)


class DayCommand(TyperCommand):
    """A command with the options of a day's run besides its own.

    Its function does not take them: it finds them in ``context.obj``, by name.
    """

    def get_params(self, ctx: Any) -> list[Any]:
        """All arguments and options, those that must be given first."""
        both = [*_day_parameters(), *super().get_params(ctx)]
        return sorted(both, key=lambda parameter: not parameter.required)

    def invoke(self, ctx: Any) -> Any:
        """Call the function with its own options."""
        ctx.obj = {option.name: ctx.params.pop(option.name) for option in _day_parameters()}
        return super().invoke(ctx)


def run_options(day: Scenario, given: Mapping[str, Any]) -> RunOptions:
    """The options of a run from those of a :class:`DayCommand`; the scenario has the defaults."""
    from vppres.contract.forecast import ForecastErrors
    from vppres.control.baselines import ReserveRule
    from vppres.day.options import RunOptions
    from vppres.solve.result import SolveLimits

    horizon_h = given["horizon"]
    rules = {field: given[name] for name, field in RULE_OF.items() if given[name] is not None}
    return RunOptions(
        controller=given["controller"] or day.controller.kind,
        horizon_h=day.controller.horizon_h if horizon_h is None else horizon_h,
        solver=given["solver"], method=given["method"], thermal=given["thermal"],
        mode=given["mode"] or day.controller.mode,
        seed=given["seed"],
        errors=ForecastErrors(given["load_bias"], given["load_error"], given["pv_bias"],
                              given["pv_error"]),
        limits=SolveLimits(gap_rel=given["gap"], time_s=given["time_limit"]),
        switching=replace(day.switching, **rules),
        guard=given["guard"], protect_critical=given["protect_critical"],
        reserve=ReserveRule(given["reserve_soc"], given["notice"]))

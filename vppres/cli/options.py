"""Arguments and options of the command line, as types; those that several commands share."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from functools import cache
from inspect import Parameter, signature
from math import isfinite
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from typer.core import TyperCommand, TyperGroup

from vppres.cli.endings import plain_errors
from vppres.core.errors import InputError
from vppres.scenario.option_table import IMPORT_OPTIONS, NEW_OPTIONS, OPTIONS, RANGES, Option

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


ScenarioName = Annotated[
    str,
    typer.Argument(
        metavar="SCENARIO",
        help="A packaged scenario's name, or a folder.",
        autocompletion=_complete_scenario,
    ),
]
RunFolder = Annotated[Path, typer.Argument(metavar="RUN_FOLDER", help="A folder that run wrote.")]


def figure_kinds(text: str) -> tuple[str, ...]:
    """Kinds of files of figures, as ``--figures`` names them; others are an InputError.

    >>> figure_kinds("png,svg"), figure_kinds("none")
    (('png', 'svg'), ())
    """
    kinds = tuple(kind.strip() for kind in text.split(","))
    if kinds in (("none",), ("",)):
        return ()
    wrong = [kind for kind in kinds if kind not in ("png", "svg")]
    if wrong:
        raise InputError(
            f"--figures {text}: {wrong[0]!r} is not a kind of figure. Give svg, png, svg,png or "
            "none."
        )
    return kinds


Figures = Annotated[
    str,
    typer.Option(
        metavar="KINDS",
        help="Files of the figures beside the report: svg, png, svg,png or none.",
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON for machines.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="No progress bar.")]
Debug = Annotated[bool, typer.Option("--debug", help="Show tracebacks of errors.")]

METAVARS = {
    "h": "HOURS",
    "min": "M",
    "s": "SECONDS",
    "kW": "KW",
    "GBP": "GBP",
    "pu": "PU",
    "share": "SHARE",
    "zone": "ZONE",
    "path": "PATH|source",
    "branch": "BRANCH",
    "grid": "GRID",
}
"""Placeholder for the value of an option with a unit."""


def help_text(option: Option) -> str:
    """An option of the table in the words of the help.

    >>> help_text(next(option for option in OPTIONS if option.name == "horizon"))
    "Prediction horizon of the MPC; 0 is one step; the scenario's if not given."
    """
    text = option.meaning[0].upper() + option.meaning[1:]
    if option.unit and option.unit not in METAVARS:
        text += f", in {option.unit}"
    if option.words:
        text += f": {option.words}"
    unset = "the scenario's" if option.scenario_key else option.unset
    return f"{text}; {unset} if not given." if unset else f"{text}."


def short_help(option: Option) -> str:
    """Help of an option without explanations of the choices.

    >>> short_help(next(option for option in OPTIONS if option.name == "priority"))
    'Order of the tiers: weights or strict.'
    """
    text = option.meaning[0].upper() + option.meaning[1:]
    choices = " or ".join(filter(None, (", ".join(option.choices[:-1]), *option.choices[-1:])))
    return f"{text}: {choices}." if choices else f"{text}."


def _declared(option: Option) -> Parameter:
    """An option of the table as a parameter of a typer command.

    What a scenario can set has no default here, and its words are checked where both meet, by
    ``RunOptions``.
    """
    names = f"--{option.name}"
    if option.kind is bool and (option.default is not False or option.scenario_key):
        names += f"/--no-{option.name}"
    default = None if option.scenario_key else option.default
    kind: Any = option.kind
    if option.choices and not option.scenario_key:
        kind = Literal[option.choices]
    if default is None:
        kind = kind | None
    info = typer.Option(
        names,
        help=help_text(option),
        metavar=METAVARS.get(option.unit),
        callback=_positive if option.range is RANGES["positive"] else None,
        rich_help_panel=option.group or None,
    )
    return Parameter(
        _key(option), Parameter.KEYWORD_ONLY, default=default, annotation=Annotated[kind, info]
    )


def _key(option: Option) -> str:
    return option.field.rpartition(".")[2]


DAY_OPTIONS = tuple(option for option in OPTIONS if option.command_line)
"""The options that `run` and `sweep` share."""


WHOLE = "vppres.whole_help"
"""Set in the context while the help shows every option."""


def _show_all(context: typer.Context, wanted: bool) -> None:
    """Print the help with every option."""
    if wanted:
        context.meta[WHOLE] = True
        typer.echo(context.get_help())
        raise typer.Exit


HelpAll = Annotated[
    bool,
    typer.Option(
        "--help-all",
        callback=_show_all,
        is_eager=True,
        expose_value=False,
        help="Show all options and exit.",
    ),
]


@cache
def _parameters(options: tuple[Option, ...]) -> tuple[Any, ...]:
    """``--debug``, ``--help-all`` and the options of a table, as typer makes them."""

    def declared(debug: Debug = False, help_all: HelpAll = False) -> None:
        """Have the options of the table as its parameters too."""

    own = signature(declared, eval_str=True)
    parameters = [*own.parameters.values(), *map(_declared, options)]
    declared.__signature__ = own.replace(parameters=parameters)  # type: ignore[attr-defined]
    app = typer.Typer(add_completion=False)
    app.command()(declared)
    return tuple(typer.main.get_command(app).params)


class CommandGroup(TyperGroup):
    """Commands of one word or two: ``vppres serve simulate`` stands beside ``vppres serve``."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The longer name first."""
        two = " ".join(args[:2])
        if two in self.commands:
            return super().resolve_command(ctx, [two, *args[2:]])
        return super().resolve_command(ctx, args)


class SafeCommand(TyperCommand):
    """A command that ends in a sentence and an exit status, whatever happens.

    It has the options of its ``table`` besides those of its function, which finds them in
    ``context.obj``, by name; and ``--debug``.
    """

    table: tuple[Option, ...] = ()

    rare: tuple[str, ...] = ("debug",)
    """Options that the short help leaves out besides those of the table that are not usual."""

    @property
    def _is_long(self) -> bool:
        """Whether the help of all options needs more than a screen."""
        return any(option.usual for option in self.table)

    def get_params(self, ctx: Any) -> list[Any]:
        """All arguments and options, those that must be given first."""
        both = [*_parameters(self.table), *super().get_params(ctx)]
        last = ["debug", "help", "help_all"]
        both = [one for one in both if self._is_long or one.name != "help_all"]
        return sorted(
            both,
            key=lambda p: (not p.required, p.name in last, p.name in last and last.index(p.name)),
        )

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """The help: of a long command the usual options, unless all are asked for."""
        if not self._is_long or WHOLE in ctx.meta:
            return super().format_help(ctx, formatter)
        brief = copy(self)
        of_table = {_key(option): option for option in self.table}
        brief.get_params = lambda ctx: [  # type: ignore[method-assign]
            _shortened(one, of_table.get(one.name))
            for one in self.get_params(ctx)
            if one.name not in self.rare and (one.name not in of_table or of_table[one.name].usual)
        ]
        return super(SafeCommand, brief).format_help(ctx, formatter)

    def invoke(self, ctx: Any) -> Any:
        """Call the function with its own options."""
        names = [one.name for one in _parameters(self.table) if one.expose_value]
        debug, *table = (ctx.params.pop(name) for name in names)
        ctx.obj = {_key(option): value for option, value in zip(self.table, table, strict=True)}
        with plain_errors(debug):
            return super().invoke(ctx)


def _shortened(parameter: Any, option: Option | None) -> Any:
    """A parameter of the table as the short help shows it."""
    if option is None:
        return parameter
    shown = copy(parameter)
    shown.help = short_help(option)
    shown.rich_help_panel = None
    return shown


class DayCommand(SafeCommand):
    """A command with the options of a day's run."""

    table = DAY_OPTIONS


class RunCommand(DayCommand):
    """The command ``run``."""

    rare = ("explain", "no_figures", "debug")


class LiveCommand(SafeCommand):
    """A command with the options of ``run`` that do not describe a simulated day."""

    table = tuple(option for option in DAY_OPTIONS if option.live)


class ImportCommand(SafeCommand):
    """A command with the options of an import."""

    table = IMPORT_OPTIONS


class NewCommand(SafeCommand):
    """A command with the options of a new scenario."""

    table = NEW_OPTIONS + IMPORT_OPTIONS


def fields_of(table: tuple[Option, ...], given: Mapping[str, Any]) -> dict[str, Any]:
    """Fields that a command's options of a table fill; those without a value are left out."""
    values = {option.field: given[_key(option)] for option in table}
    return {field: value for field, value in values.items() if value is not None}


def run_options(day: Scenario, given: Mapping[str, Any]) -> RunOptions:
    """The options of a run from those of a command; the scenario has the defaults."""
    from vppres.day.options import RunOptions

    values = {}
    for option in DAY_OPTIONS:
        value = given.get(_key(option), option.run_default)
        if value is None and option.scenario_key:
            value = attrgetter(option.scenario_key)(day)
        values[option.field] = value
    return RunOptions().having(values)

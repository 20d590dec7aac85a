"""The options of a run, one row each.

A row states an option's name, kind, default, bounds, unit and meaning once. From it come the checks
and defaults of :class:`vppres.day.options.RunOptions`, the command line of ``run`` and ``sweep``,
the parameters of a sweep, two sections of scenario.toml with their JSON Schema, and the table in
``docs/command-line.md``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import inf, isfinite
from typing import Any

from vppres.core.errors import Problem

Value = str | float | int | bool


@dataclass(frozen=True)
class Range:
    """Numbers that an option takes; infinity and NaN are in none.

    Parameters
    ----------
    least, most : float
        Bounds, which belong to the range unless it is open there.
    message, cure : str
        What to say of a number outside.
    open_least, open_most : bool
        Whether the bound itself is outside.

    Examples
    --------
    >>> POSITIVE.holds(0.0), POSITIVE.holds(float("nan")), POSITIVE.holds(0.1)
    (False, False, True)
    """

    least: float
    most: float
    message: str
    cure: str
    open_least: bool = False
    open_most: bool = False

    def holds(self, value: float) -> bool:
        """Whether a number is in the range."""
        above = self.least < value if self.open_least else self.least <= value
        below = value < self.most if self.open_most else value <= self.most
        return isfinite(value) and above and below


HOURS = Range(0, inf, "must be zero or positive", "Give hours.")
COUNT = Range(0, inf, "must not be negative", "Give a whole number from zero.")
NOT_NEGATIVE = Range(0, inf, "must be zero or positive", "Give a number from 0.")
POSITIVE = Range(0, inf, "must be positive", "Give a number above 0.", open_least=True)
AT_LEAST_ONE = Range(1, inf, "must be at least 1", "Give a factor, for example 1.5.")
SHARE = Range(0, 1, "must lie between 0 and 1", "Give a share, for example 0.8.")
ERROR_BIAS = Range(-1, inf, "must be a number not below -1", "Give a share, for example 0.05.")
ERROR_GROWTH = Range(0, inf, "must be a number not below 0", "Give a share, for example 0.05.")
HEADROOM = Range(
    0,
    1,
    "must be a share from 0 to below 1",
    "Give a share of the inverter's rating, for example 0.1.",
    open_most=True,
)

# Headings of the help.
FORECAST = "Forecasts"
SOLVER = "Solver"
SWITCHING = "Switching"
GUARD = "Guard and baselines"

LONGEST_HORIZON_H = 366 * 24
"""As long as the longest day that a scenario folder may hold."""
MOST_WEIGHT = 1e6  # a million customers of weight 1 for an hour
MOST_ACTIONS = 1_000_000  # more than a day has steps
MOST_COLD_LOAD = 20.0  # measured factors of cold load are 1 to 5


@dataclass(frozen=True)
class Option:
    """One option of a run.

    Parameters
    ----------
    name : str
        Name on the command line without its hyphens in front, and of a sweep's parameter.
    field : str
        Field of ``RunOptions`` that it fills; ``group.field`` for one of a group in it.
    kind : type
        ``str``, ``float``, ``int`` or ``bool``.
    default : str, float, int, bool or None
        Value where neither the command line nor a scenario says otherwise.
    meaning : str
        What it is, as a phrase that can begin a sentence; of a switch, what it does.
    words : str
        The choices in words, where their names do not say enough.
    page : str
        What the documentation adds, in Markdown.
    unit : str
        Unit, if it has one.
    choices : tuple of str
        Words that it takes; empty for numbers, and for names that another table checks.
    hidden : tuple of str
        Words that it takes besides, for studies; neither offered nor documented.
    range : Range, optional
        Numbers that it takes.
    unset : str
        What None means.
    group : str
        Heading in the help.
    scenario_key : str
        Key of scenario.toml that sets it, ``section.key``; empty if a scenario cannot.
    follows_scenario : bool
        Whether it is the scenario's in Python too, unless it is given there.
    file_most : float
        Largest number that scenario.toml may hold.
    command_line : bool
        Whether ``run`` and ``sweep`` have it; Python always has.
    sweep : bool
        Whether a sweep can vary it.
    """

    name: str
    field: str
    kind: type
    default: Value | None
    meaning: str
    words: str = ""
    page: str = ""
    unit: str = ""
    choices: tuple[str, ...] = ()
    hidden: tuple[str, ...] = ()
    range: Range | None = None
    unset: str = ""
    group: str = ""
    scenario_key: str = ""
    follows_scenario: bool = False
    file_most: float = inf
    command_line: bool = True
    sweep: bool = True

    @property
    def run_default(self) -> Value | None:
        """Default of its field in ``RunOptions``; None where the scenario decides."""
        return None if self.follows_scenario else self.default

    @property
    def label(self) -> str:
        """Name in messages: the field, or the option where the field is inside a group."""
        return self.name if "." in self.field else self.field

    def problems(self, value: Any) -> Iterator[Problem]:
        """What is wrong with a value; nothing is wrong with None where it has a meaning."""
        if value is None and self.run_default is None:
            return
        if self.choices and value not in (*self.choices, *self.hidden):
            yield Problem(
                "options",
                "is not known",
                f"Use one of: {', '.join(self.choices)}.",
                field=self.label,
                value=value,
            )
        elif self.range is not None and not self.range.holds(value):
            yield Problem(
                "options", self.range.message, self.range.cure, field=self.label, value=value
            )


OPTIONS: tuple[Option, ...] = (
    Option(
        "controller",
        "controller",
        str,
        "mpc",
        "controller",
        words="mpc, full-horizon, perfect (full horizon without forecast errors), idle "
        "(batteries do nothing) or reserve (charge when an outage is announced)",
        choices=("mpc", "full-horizon", "perfect", "idle", "reserve"),
        scenario_key="controller.kind",
    ),
    Option(
        "horizon",
        "horizon_h",
        float,
        5.0,
        "prediction horizon of the MPC; 0 is one step",
        unit="h",
        range=HOURS,
        scenario_key="controller.horizon_h",
        file_most=LONGEST_HORIZON_H,
    ),
    Option(
        "solver",
        "solver",
        str,
        "highs",
        "solver of the mixed-integer problems",
        words="highs, scip, or gurobi, copt, xpress if they are installed",
        group=SOLVER,
    ),
    Option(
        "method",
        "method",
        str,
        "decomposed",
        "method of solving a window",
        words="decomposed or monolithic, which solve term by term, or weighted, which does not",
        page="see {doc}`decisions/weighted-objective`",
        group=SOLVER,
    ),
    Option(
        "forecaster",
        "forecaster",
        str,
        "paper",
        "forecaster of load and PV power",
        words="paper (the actual day with the errors below), seasonal (from what was measured "
        "before), climatology (the same hours of the last days) or file (of one's own)",
        page="see {doc}`forecasts`",
        choices=("paper", "seasonal", "climatology", "file"),
        group=FORECAST,
    ),
    Option(
        "forecast-file",
        "forecast_file",
        str,
        None,
        "CSV or Parquet file of quantiles for the forecaster file",
        unset="none",
        group=FORECAST,
        sweep=False,
    ),
    Option(
        "load-bias",
        "errors.load_bias",
        float,
        0.0,
        "share by which the load forecast is too high",
        page="negative: too low",
        range=ERROR_BIAS,
        group=FORECAST,
    ),
    Option(
        "load-error",
        "errors.load_alpha_per_h",
        float,
        0.0,
        "random error of the load forecast, as growth of its relative standard deviation per "
        "hour ahead",
        range=ERROR_GROWTH,
        group=FORECAST,
    ),
    Option(
        "pv-bias",
        "errors.pv_bias",
        float,
        0.0,
        "share by which the PV forecast is too high",
        page="negative: too low",
        range=ERROR_BIAS,
        group=FORECAST,
    ),
    Option(
        "pv-error",
        "errors.pv_alpha_per_h",
        float,
        0.0,
        "random error of the PV forecast, as growth of its relative standard deviation per "
        "hour ahead",
        range=ERROR_GROWTH,
        group=FORECAST,
    ),
    Option(
        "thermal",
        "thermal",
        str,
        "off",
        "battery heating",
        words="off, exact (solution over the step) or euler (the paper's formula)",
        choices=("off", "exact", "euler"),
        hidden=("exact-joule-kw", "euler-joule-kw"),
    ),
    Option(
        "mode",
        "mode",
        str,
        "physical",
        "way of islands, the paper's or held by batteries",
        words="paper or physical",
        page="see {doc}`islands`",
        choices=("paper", "physical"),
        scenario_key="controller.mode",
        follows_scenario=True,
    ),
    Option(
        "soc-end",
        "soc_end",
        float,
        None,
        "state of charge that batteries keep at the end of the last day",
        page="bought or kept where that is possible, without giving up service; see "
        "{doc}`howto/rolling`",
        unit="share",
        range=SHARE,
        unset="they may end empty",
        scenario_key="controller.soc_end",
        file_most=1.0,
    ),
    Option(
        "keep-stored",
        "keep_stored",
        bool,
        False,
        "of plans that serve the same without grid, take the one that leaves most in store",
        page="the paper leaves it open; see {doc}`method`",
        sweep=False,
    ),
    Option(
        "outages",
        "outages",
        str,
        "known",
        "what is known of outages ahead",
        words="known (their exact times), likely (the most likely one as if it were known), belief "
        "(probabilities, from warnings and statistics) or none (nothing until they are there)",
        page="see {doc}`uncertain-outages`",
        choices=("known", "likely", "belief", "none"),
        scenario_key="controller.outages",
        follows_scenario=True,
    ),
    Option(
        "seed", "seed", int, 0, "seed of the random forecast errors", range=COUNT, group=FORECAST
    ),
    Option(
        "time-limit",
        "limits.time_s",
        float,
        60.0,
        "time limit of one window",
        unit="s",
        range=POSITIVE,
        group=SOLVER,
    ),
    Option(
        "gap",
        "limits.gap_rel",
        float,
        1e-4,
        "relative optimality gap at which a window is done",
        range=POSITIVE,
        group=SOLVER,
    ),
    Option(
        "unit-kw",
        "weighted.unit_kw",
        float,
        1.0,
        "unit of power of a weighted solve: 1000 is MW, the base power is per unit",
        unit="kW",
        range=POSITIVE,
        group=SOLVER,
    ),
    Option(
        "tolerance",
        "weighted.tolerance",
        float,
        1e-7,
        "optimality tolerance of a weighted solve",
        range=POSITIVE,
        group=SOLVER,
    ),
    Option(
        "solver-seed",
        "weighted.seed",
        int,
        0,
        "seed of the solver in a weighted solve",
        range=COUNT,
        group=SOLVER,
    ),
    Option(
        "isolate",
        "isolate",
        bool,
        None,
        "solve in a process of its own, which is killed and replaced when it hangs or crashes",
        page="see [operation](operation.md); a live controller does it by default",
        unset="off",
        group=SOLVER,
        sweep=False,
    ),
    Option(
        "min-served-h",
        "switching.min_served_h",
        float,
        0.0,
        "shortest time served after a restoration",
        page="this and the following are the {doc}`switching` rules",
        unit="h",
        range=HOURS,
        group=SWITCHING,
        scenario_key="switching.min_served_h",
        file_most=LONGEST_HORIZON_H,
    ),
    Option(
        "min-unserved-h",
        "switching.min_unserved_h",
        float,
        0.0,
        "shortest time switched off",
        unit="h",
        range=HOURS,
        group=SWITCHING,
        scenario_key="switching.min_unserved_h",
        file_most=LONGEST_HORIZON_H,
    ),
    Option(
        "switching-price",
        "switching.price_per_action",
        float,
        0.0,
        "price of switching a customer off or on",
        unit="weighted customer hours",
        range=NOT_NEGATIVE,
        group=SWITCHING,
        scenario_key="switching.price_per_action",
        file_most=MOST_WEIGHT,
    ),
    Option(
        "max-actions",
        "switching.max_actions_per_customer",
        int,
        None,
        "most actions of a customer in a day",
        words="an off/on pair is two",
        range=COUNT,
        unset="no limit",
        group=SWITCHING,
        scenario_key="switching.max_actions_per_customer",
        file_most=MOST_ACTIONS,
    ),
    Option(
        "stay-restored",
        "switching.stay_restored",
        bool,
        False,
        "never switch a restored customer off again",
        page="`--no-stay-restored`: allow it",
        group=SWITCHING,
        scenario_key="switching.stay_restored",
        sweep=False,
    ),
    Option(
        "cold-load-factor",
        "switching.cold_load_factor",
        float,
        1.0,
        "demand after a restoration as a multiple of the usual one",
        range=AT_LEAST_ONE,
        group=SWITCHING,
        scenario_key="switching.cold_load_factor",
        file_most=MOST_COLD_LOAD,
    ),
    Option(
        "cold-load-h",
        "switching.cold_load_h",
        float,
        0.0,
        "how long demand is higher after a restoration, at least one step",
        unit="h",
        range=HOURS,
        group=SWITCHING,
        scenario_key="switching.cold_load_h",
        file_most=LONGEST_HORIZON_H,
    ),
    Option(
        "move-weight",
        "switching.move_weight",
        float,
        0.0,
        "line losses that moving a battery by its rated power away from the previous plan is worth",
        unit="kW",
        range=NOT_NEGATIVE,
        group=SWITCHING,
        scenario_key="switching.move_weight",
        file_most=MOST_WEIGHT,
    ),
    Option(
        "guard",
        "guard",
        bool,
        True,
        "check every decision and fall back where it cannot be carried out",
        page="see [operation](operation.md); `--no-guard` ends the run with the solver's error "
        "instead",
        group=GUARD,
        sweep=False,
    ),
    Option(
        "protect-critical",
        "protect_critical",
        bool,
        False,
        "serve the first tier in every step that can serve it, whatever the plan would save the "
        "energy for",
        group=GUARD,
        sweep=False,
    ),
    Option(
        "reserve-soc",
        "reserve.soc",
        float,
        None,
        "state of charge that reserve charges to",
        unit="share",
        range=SHARE,
        unset="the batteries' highest",
        group=GUARD,
    ),
    Option(
        "notice",
        "reserve.notice_h",
        float,
        6.0,
        "how long before an outage reserve is told of it",
        unit="h",
        range=HOURS,
        group=GUARD,
    ),
    Option(
        "centre",
        "centre",
        str,
        "lossless",
        "linearisation centre of the voltages",
        choices=("lossless", "literal", "none"),
        command_line=False,
    ),
    Option(
        "pv-check",
        "pv_check",
        str,
        "absorbing",
        "reading of the full horizon's PV check",
        choices=("absorbing", "literal"),
        command_line=False,
    ),
    Option(
        "gap-abs",
        "limits.gap_abs",
        float,
        5e-3,
        "absolute optimality gap at which a window is done",
        range=POSITIVE,
        command_line=False,
        sweep=False,
    ),
    Option(
        "polygon-sides",
        "polygon_sides",
        int,
        16,
        "sides of an inverter's polygon where the solver needs one",
        command_line=False,
        sweep=False,
    ),
    Option(
        "headroom",
        "headroom",
        float,
        0.1,
        "share of a grid-forming battery's inverter that plans leave free in an island",
        range=HEADROOM,
        command_line=False,
        sweep=False,
    ),
    Option(
        "passes",
        "passes",
        int,
        4,
        "largest number of linearisations of a window",
        range=COUNT,
        command_line=False,
        sweep=False,
    ),
)

_BY_FIELD = {option.field: option for option in OPTIONS}


def default_of(field: str) -> Any:
    """Default of the option that fills a field of ``RunOptions``.

    >>> default_of("horizon_h")
    5.0
    """
    return _BY_FIELD[field].default


def choices_of(field: str) -> tuple[str, ...]:
    """Words that the option of a field takes.

    >>> choices_of("mode")
    ('paper', 'physical')
    """
    return _BY_FIELD[field].choices


def section_options(section: str) -> dict[str, Option]:
    """Options that a section of scenario.toml sets, by their keys.

    >>> list(section_options("controller"))
    ['kind', 'horizon_h', 'mode', 'soc_end', 'outages']
    """
    parted = [(option.scenario_key.partition("."), option) for option in OPTIONS]
    return {key: option for (name, _, key), option in parted if name == section}

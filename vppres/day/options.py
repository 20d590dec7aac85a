"""The options of a run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from operator import attrgetter
from typing import Any

from vppres.contract.forecast import ForecastErrors
from vppres.contract.operating_point import Centre
from vppres.control.baselines import ReserveRule
from vppres.control.full_horizon import PVCheck
from vppres.core.errors import InputError, Problem
from vppres.kinds.customer.data import SwitchingRules
from vppres.physics.thermal import ThermalScheme
from vppres.scenario.option_table import OPTIONS, default_of
from vppres.scenario.scenario import Scenario
from vppres.solve.result import SolveLimits

PERFECT = "perfect"

RULES = ("idle", "reserve")
"""Controllers that follow a rule: they plan nothing and prove nothing."""

_GROUPS = {
    "errors": ForecastErrors,
    "limits": SolveLimits,
    "switching": SwitchingRules,
    "reserve": ReserveRule,
}


@dataclass(frozen=True)
class RunOptions:
    """How a day is run; defaults and checks are those of :mod:`vppres.scenario.option_table`.

    Parameters
    ----------
    controller : {"mpc", "full-horizon", "perfect", "idle", "reserve"}
        The controller; ``perfect`` is the full horizon without forecast errors, whatever
        ``errors`` is.
    horizon_h : float
        Prediction horizon of the MPC in h.
    soc_end : float or None
        Target state of charge of batteries at the end of the known steps, 0 to 1; the scenario's
        if not given, otherwise none.
    outages : {"known", "likely", "belief", "none"} or None
        Knowledge of outages ahead; None uses the scenario's.
    solver, method : str
        Solver of the mixed-integer problems, and method of solving a window.
    forecaster : {"paper", "seasonal", "climatology", "file"}
        Forecaster of load and PV power.
    forecast_file : str or None
        File of quantiles for the forecaster ``file``.
    errors : ForecastErrors
        Forecast errors of the paper's forecaster.
    priority : {"weights", "strict"} or None
        Order of the tiers; None uses the scenario's.
    thermal : ThermalScheme
        Battery heating.
    seed : int
        Seed of the forecast errors and of past days of vehicles.
    limits : SolveLimits
        Gaps and time limit of a window.
    polygon_sides : int
        Sides of the polygon for an inverter's capability, if the solver needs one.
    centre : {"lossless", "literal", "none"}
        Linearisation centre of the voltages.
    pv_check : {"absorbing", "literal"}
        Full horizon: whether a step needs a correction if the actual PV power is not the planned
        one (``literal``), or only if batteries, inverters or the balance do not allow it
        (``absorbing``).
    mode : {"paper", "physical"} or None
        The paper's island, or one with grid-forming batteries and losses in the plan; None uses
        the scenario's.
    voltage_limits : {"soft", "hard"} or None
        Whether voltage limits give way, with grid, to what the feeder has without control; None
        uses the scenario's.
    ratings : {"limit", "soft", "report"} or None
        Whether plans keep the currents of lines within their ratings, or within those and what the
        feeder carries without control; None uses the scenario's.
    headroom : float or None
        Physical mode: share of a grid-forming battery's inverter rating that plans reserve in
        an island; None uses the scenario's.
    rotation, turn_h, minimum_on_h : float or None
        How supply is shared within a tier, fields of ``Fairness``; None uses the scenario's.
    isolate : bool or None
        Whether windows are solved in a separate process; None: yes for live controllers, no for
        runs.
    switching : SwitchingRules or None
        Rules on switching customers, ``SwitchingRules()`` for none; None uses the scenario's.
    move_switches : bool
        Whether switches of the feeder move where that serves more.
    guard : bool
        Whether decisions are checked, and replaced by a fallback if they fail.
    protect_critical : bool
        Whether the guard supplies the first tier in every step that can.
    reserve : ReserveRule
        When and how far the controller ``reserve`` charges.

    Raises
    ------
    InputError
        With every option that is unknown or out of its range.
    """

    controller: str = default_of("controller")
    horizon_h: float = default_of("horizon_h")
    soc_end: float | None = default_of("soc_end")
    outages: str | None = None
    solver: str = default_of("solver")
    method: str = default_of("method")
    forecaster: str = default_of("forecaster")
    forecast_file: str | None = default_of("forecast_file")
    errors: ForecastErrors = field(default_factory=ForecastErrors)
    priority: str | None = None
    thermal: ThermalScheme = default_of("thermal")
    seed: int = default_of("seed")
    limits: SolveLimits = field(default_factory=SolveLimits)
    polygon_sides: int = default_of("polygon_sides")
    centre: Centre = default_of("centre")
    pv_check: PVCheck = default_of("pv_check")
    mode: str | None = None
    voltage_limits: str | None = None
    ratings: str | None = None
    headroom: float | None = None
    rotation: float | None = None
    turn_h: float | None = None
    minimum_on_h: float | None = None
    isolate: bool | None = default_of("isolate")
    switching: SwitchingRules | None = None
    move_switches: bool = default_of("move_switches")
    guard: bool = default_of("guard")
    protect_critical: bool = default_of("protect_critical")
    reserve: ReserveRule = field(default_factory=ReserveRule)

    def __post_init__(self) -> None:
        problems = [
            problem
            for option in OPTIONS
            if "." not in option.field  # groups check their own
            for problem in option.problems(getattr(self, option.field))
        ]
        problems += [
            Problem(
                "options",
                "is of another kind",
                f"Give {kind.__name__}(...).",
                field=group,
                value=getattr(self, group),
            )
            for group, kind in _GROUPS.items()
            if not isinstance(getattr(self, group), kind)
            and (group, getattr(self, group)) != ("switching", None)
        ]
        if self.forecast_file is not None and self.forecaster != "file":
            problems.append(
                Problem(
                    "options",
                    f"is not read by the forecaster {self.forecaster}",
                    "Add --forecaster file.",
                    field="forecast_file",
                    value=self.forecast_file,
                )
            )
        if problems:
            raise InputError(problems)

    def having(self, values: Mapping[str, Any]) -> RunOptions:
        """The options with other values, by the fields of the table of options.

        Parameters
        ----------
        values : mapping
            Field to value; ``group.field`` for one of a group.

        Raises
        ------
        InputError
            If a value is out of its range.

        Examples
        --------
        >>> RunOptions().having({"horizon_h": 2.0, "errors.pv_bias": 0.1}).errors.pv_bias
        0.1
        """
        new: dict[str, Any] = {}
        groups: dict[str, dict[str, Any]] = {}
        for path, value in values.items():
            group, _, inner = path.rpartition(".")
            if group:
                groups.setdefault(group, {})[inner] = value
            else:
                new[path] = value
        for group, inside in groups.items():
            new[group] = replace(getattr(self, group) or SwitchingRules(), **inside)
        return replace(self, **new)

    def on(self, scenario: Scenario) -> RunOptions:
        """The options with the scenario's where they leave it the choice."""
        left = {
            option.field: attrgetter(option.scenario_key)(scenario)
            for option in OPTIONS
            if option.run_default is None
            and option.scenario_key
            and getattr(self, option.field, "") is None
        }
        return self.having({"switching": self.switching or scenario.switching, **left})

    @property
    def rules(self) -> SwitchingRules:
        """Rules on switching customers; none where they are the scenario's."""
        return self.switching or SwitchingRules()

    @property
    def shares_supply(self) -> bool:
        """Whether supply is shared within tiers."""
        return bool(self.rotation or self.minimum_on_h)

    def as_record(self) -> dict[str, Any]:
        """The options as JSON can hold them."""
        return asdict(replace(self, switching=self.rules))

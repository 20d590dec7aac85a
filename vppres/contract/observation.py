"""Observation: all that a controller may know at the beginning of a step."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import inf

from vppres.contract.ahead import KindsAhead
from vppres.contract.forecast import Forecast
from vppres.contract.moves import Moves
from vppres.contract.operating_point import OperatingPoint
from vppres.contract.stored_value import StoredValue
from vppres.contract.terminal import Terminal
from vppres.core.arrays import Flags, Floats, Wholes
from vppres.kinds.customer.physics import Owed, SwitchingData, SwitchingState


@dataclass(frozen=True, eq=False)
class Told:
    """Set-points of batteries from a time on, where it was not what was decided."""

    before_h: float  #: how long before now, in h
    battery_kw: Floats  #: charging power, negative to discharge, (B,)


@dataclass(frozen=True, eq=False)
class SupplyTurns:
    """Customers whose turn it is to be on supply."""

    due: Flags  #: who they are in each step of a window, (W, C)
    rank: Wholes  #: position of every customer's tier, 0 for the most important, (C,)


@dataclass(frozen=True, eq=False)
class Observation:
    """Forecasts and measurements at the beginning of a step, and no future truth.

    The guard's estimate of a step is another one, in which every measurement is plausible.
    """

    t0: int  #: the step to decide on
    forecast: Forecast  #: forecast of the window; its first step is the actual one
    #: Measured state of charge and efficiencies, (B,).
    soc: Floats
    eta_charge: Floats
    eta_discharge: Floats
    switching: SwitchingState  #: switching rules and what was really served so far
    owed: Owed  #: what dimmed customers may still catch up
    #: Batteries that report to be able to work, (B,); of an estimate, those that can be used.
    online: Flags
    estimated: str = ""  #: what was not measured, in words; empty if everything was
    operating_point: OperatingPoint | None = None  #: last AC operating point, None before the first
    moves: Moves | None = None  #: the plan before, where the controller is to stay near it
    #: Measured charging power of the step before, negative where discharged, (B,).
    battery_kw: Floats | None = None
    #: Measured import of the step before, losses included; in an island of the paper what its
    #: balance lacks.
    import_kw: float | None = None
    #: Who was really served in the step before, (C,); as decided if not given.
    served: Flags | None = None
    #: What batteries are to hold at the end of the window, where nothing is known behind it.
    terminal: Terminal | None = None
    #: What energy is worth behind the present step, where the steps behind it are believed and not
    #: known. The window is then the present step alone.
    stored_value: StoredValue | None = None
    #: Whether the run ends with the window, and its outages are known: nothing is kept behind it.
    ends: bool = False
    #: Whether outages in ``forecast`` may last longer or shorter than it says.
    open_ended: bool = False
    #: Whether outages ahead in ``forecast`` are the likely ones and not known.
    guessed: bool = False
    #: Customers that the first n steps must serve, (n, C); none if not given.
    kept_on: Flags | None = None
    #: Customers that are to be served in the window, if no higher tier loses by it.
    turns: SupplyTurns | None = None
    #: Which messages about outages the belief in ``forecast`` and ``stored_value`` follows, where
    #: several speak of one.
    outage_messages: str = ""
    #: How much of the step is over, where it is decided anew; states are those of that moment.
    elapsed_h: float = 0.0
    soc_age_h: Floats | None = None  #: how old the state of charge is, (B,); of now if not given
    #: Set-points of batteries since the last decision, where these differ from it.
    told: tuple[Told, ...] = ()
    #: Vehicles, rooms and generating sets over the window; none if not given.
    ahead: KindsAhead = field(default_factory=KindsAhead)
    #: Measured power of vehicles, machines that cool or heat and generating sets together in the
    #: step before, negative where they give.
    flexible_kw: float | None = None
    #: By how much that may be off, where it is what they were to take and no meter's.
    flexible_off_kw: float = 0.0
    #: What the site's own series say of demand and PV power in this step, (C,) and (P,); where not
    #: given, they are those of ``forecast``.
    profile_kw: Floats | None = None
    profile_pv_kw: Floats | None = None
    #: Lines and ties that are closed, (E,), where switches may have been moved by others; as the
    #: controller left them if not given.
    closed: Flags | None = None
    #: Customers that cannot be dimmed in the window, (C,); none if not given.
    whole: Flags | None = None
    #: Time in s that a plan of it may take, where that is less than the limit of a window.
    within_s: float = inf

    def counted(self, times: float) -> Observation:
        """Copy in which a weighted customer hour of an outage counts as so many."""
        value = self.stored_value
        if value is None or not value.as_service:
            return self
        return replace(self, stored_value=value.counted(times))

    @property
    def end(self) -> Terminal | None:
        """Target of the batteries at the window's end; None where a stored value replaces it."""
        return None if self.stored_value is not None else self.terminal

    @property
    def window(self) -> Forecast:
        """Forecast of the steps that are decided together: with a value, of the present one."""
        return self.forecast if self.stored_value is None else self.forecast.first(1)

    @property
    def rules(self) -> SwitchingData | None:
        """Switching rules of the window, None where they say nothing in it.

        Steps that only such rules would join are solved one by one.
        """
        rules = self.switching.window(len(self.window.price_gbp_per_kwh))
        if self.kept_on is not None:
            rules = rules.keeping(self.kept_on)
        return None if rules.idle else rules

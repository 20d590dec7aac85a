"""Observation: all that a controller may know at the beginning of a step."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from vppres.contract.ahead import KindsAhead
from vppres.contract.forecast import Forecast
from vppres.contract.moves import Moves
from vppres.contract.operating_point import OperatingPoint
from vppres.contract.owed import Owed
from vppres.contract.stored_value import StoredValue
from vppres.contract.terminal import Terminal
from vppres.core.arrays import Flags, Floats, Wholes
from vppres.kinds.customer.physics import SwitchingData, SwitchingState


@dataclass(frozen=True, eq=False)
class Told:
    """Set-points of batteries from a time on, where it was not what was decided.

    Parameters
    ----------
    before_h : float
        How long before now, in h.
    battery_kw : array, shape (B,)
        Charging power, negative to discharge.
    """

    before_h: float
    battery_kw: Floats


@dataclass(frozen=True, eq=False)
class SupplyTurns:
    """Customers whose turn it is to be on supply.

    Parameters
    ----------
    due : array of bool, shape (W, C)
        Who they are in each step of a window.
    rank : array of int, shape (C,)
        Position of every customer's tier, 0 for the most important.
    """

    due: Flags
    rank: Wholes


@dataclass(frozen=True, eq=False)
class Observation:
    """Forecasts and measurements at the beginning of a step, and no future truth.

    Parameters
    ----------
    t0 : int
        The step to decide on.
    forecast : Forecast
        Forecast of the window; its first step is the actual one.
    soc, eta_charge, eta_discharge : array, shape (B,)
        Measured state of charge and efficiencies.
    operating_point : OperatingPoint or None
        Last AC operating point, None before the first.
    switching : SwitchingState, optional
        Switching rules and what was really served so far; None without rules.
    moves : Moves, optional
        The plan before, where the controller is to stay near it.
    battery_kw : array, shape (B,), optional
        Measured charging power of the step before, negative where discharged.
    online : array of bool, shape (B,), optional
        Batteries that report to be able to work; all if not given.
    import_kw : float, optional
        Measured import of the step before, losses included; in an island of the paper what its
        balance lacks.
    served : array of bool, shape (C,), optional
        Who was really served in the step before; as decided if not given.
    flexible_kw : float, optional
        Measured power of vehicles, machines that cool or heat and generating sets together in the
        step before, negative where they give.
    flexible_off_kw : float
        By how much that may be off, where it is what they were to take and no meter's.
    terminal : Terminal, optional
        What batteries are to hold at the end of the window, where nothing is known behind it.
    stored_value : StoredValue, optional
        What energy is worth behind the present step, where the steps behind it are believed and not
        known. The window is then the present step alone.
    ends : bool
        Whether the run ends with the window, and its outages are known: nothing is kept behind it.
    open_ended : bool
        Whether outages in ``forecast`` may last longer or shorter than it says.
    guessed : bool
        Whether outages ahead in ``forecast`` are the likely ones and not known.
    kept_on : array of bool, shape (n, C), optional
        Customers that the first n steps must serve; none if not given.
    turns : SupplyTurns, optional
        Customers that are to be served in the window, if no higher tier loses by it.
    outage_messages : str
        Which messages about outages the belief in ``forecast`` and ``stored_value`` follows, where
        several speak of one.
    elapsed_h : float
        How much of the step is over, where it is decided anew; states are those of that moment.
    soc_age_h : array, shape (B,), optional
        How old the state of charge is; of now if not given.
    owed : Owed, optional
        What dimmed customers may still catch up; None if none does.
    ahead : KindsAhead, optional
        Vehicles, rooms and generating sets over the window; none if not given.
    told : tuple of Told
        Set-points of batteries since the last decision, where these differ from it.
    profile_kw, profile_pv_kw : array, shape (C,) and (P,), optional
        What the site's own series say of demand and PV power in this step; where not given, they
        are those of ``forecast``.
    """

    t0: int
    forecast: Forecast
    soc: Floats
    eta_charge: Floats
    eta_discharge: Floats
    operating_point: OperatingPoint | None = None
    switching: SwitchingState | None = None
    moves: Moves | None = None
    battery_kw: Floats | None = None
    online: Flags | None = None
    import_kw: float | None = None
    served: Flags | None = None
    terminal: Terminal | None = None
    stored_value: StoredValue | None = None
    ends: bool = False
    open_ended: bool = False
    guessed: bool = False
    kept_on: Flags | None = None
    turns: SupplyTurns | None = None
    outage_messages: str = ""
    elapsed_h: float = 0.0
    soc_age_h: Floats | None = None
    told: tuple[Told, ...] = ()
    owed: Owed | None = None
    ahead: KindsAhead = field(default_factory=KindsAhead)
    flexible_kw: float | None = None
    flexible_off_kw: float = 0.0
    profile_kw: Floats | None = None
    profile_pv_kw: Floats | None = None

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
        n_steps = len(self.window.price_gbp_per_kwh)
        rules = None if self.switching is None else self.switching.window(n_steps)
        if self.kept_on is not None:
            rules = rules or SwitchingData.without_rules(n_steps, self.kept_on.shape[1])
            rules = rules.keeping(self.kept_on)
        return None if rules is None or rules.idle else rules

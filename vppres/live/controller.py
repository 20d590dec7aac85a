"""The controller for your own plant: measure, ``step``, apply the set-points."""

from __future__ import annotations

import threading
from dataclasses import replace
from typing import Any

import pandas as pd

from vppres.contract.ahead import past_days_of
from vppres.contract.decision import Decider, Decision
from vppres.contract.forecast import ForecastErrors
from vppres.control.remembered import memory_of, put_back
from vppres.core.arrays import Flags, Floats
from vppres.core.errors import SolveError, VppresError
from vppres.day.assembly import make_controller
from vppres.day.options import RunOptions
from vppres.day.outages import KNOWN, LOOKAHEAD_H, OutageView
from vppres.live.feed import Feed, extended
from vppres.live.foreseen import Foreseen
from vppres.live.measurement import Measurement, row_of, step_at
from vppres.live.past import Past
from vppres.live.present import Present
from vppres.live.proposal import Proposal
from vppres.live.set_points import SetPoints
from vppres.live.state import WHERE, Standing, given_by, restored, saved_state, state_of
from vppres.outlook.outlook import OutageOutlook
from vppres.scenario.faults import LineFault
from vppres.scenario.history import History
from vppres.scenario.outage_warnings import OutageWarning
from vppres.scenario.scenario import Scenario
from vppres.solve.isolated import SUPPORTED

ENDLESS = 2**40
"""Steps that a controller may be fed with in its life."""


class Controller:
    """A controller of a site, to be put behind a SCADA system or a simulator.

    Make it with :meth:`of`; then call :meth:`step` at the beginning of every step. Between two
    steps it keeps the compiled problems, the plan of a full horizon, and the AC operating point of
    its last set-points, around which it linearises the voltages.

    Attributes
    ----------
    last : Decision or None
        The last decision, with its whole plan and what it took for true (``seen``); None before the
        first, and where a state is gone on from.

    Examples
    --------
    >>> import vppres
    >>> day = vppres.load_scenario("uk-heatwave-2022")
    >>> controller = Controller.of(day, vppres.RunOptions(horizon_h=0))
    >>> now = Measurement(controller.times[0], soc=dict.fromkeys(day.batteries.id, 0.5))
    >>> decision = controller.step(now)
    >>> bool(decision.customers["served"].all())
    True
    """

    def __init__(
        self,
        scenario: Scenario,
        options: RunOptions,
        decider: Decider,
        state: Any = None,
        history: History | None = None,
    ) -> None:
        start = Past.before_the_day(scenario, options)
        if start.history and history:
            start = replace(start, history=history)
        at = Standing(scenario, 0, start)
        if state is not None:
            at = restored(state, scenario, decider, options, start)
        # Measurements are remembered in the past, once.
        self.scenario = replace(at.known, history=None)
        self.options = options
        self._record = options.as_record()
        self._decider = decider
        # Steps of controllers count on from the very first one; the scenario begins later.
        self._forgotten = at.forgotten
        self._past = at.past
        self.last: Decision | None = None
        self._step_before: tuple[dict[str, Any] | None, Past] | None = at.before
        self._given = given_by(scenario, options)
        self._past_days = past_days_of(scenario, options.seed)
        self._turn = threading.Lock()

    @classmethod
    def of(
        cls,
        scenario: Scenario,
        options: RunOptions | None = None,
        *,
        state: Any = None,
        history: History | None = None,
    ) -> Controller:
        """The controller of a scenario's site.

        Parameters
        ----------
        scenario : Scenario
            The site, its time grid, and the series that replace missing measurements.
        options : RunOptions, optional
            As for :func:`vppres.day.simulate.run_day`; forecast errors and heating have no
            effect here. Windows are solved in a separate process unless the options have
            ``isolate=False`` (``docs/operation.md``).
        state : dict, optional
            The value of :meth:`state`, from this process or another: the controller resumes from
            it. Only the site of the scenario is used; the known steps are those of the state.
        history : History, optional
            Earlier measurements for a forecaster that learns, if neither the scenario nor the
            state has them; in the scenario's steps.

        Raises
        ------
        InputError
            If an option is unknown, or the state is damaged or belongs to another version, site
            or kind of controller.
        SolverLostError
            If the solver process does not start.
        """
        exact = replace(
            (options or RunOptions()).on(scenario), errors=ForecastErrors(), thermal="off"
        )
        if exact.isolate is None:
            exact = replace(exact, isolate=SUPPORTED)
        endless = replace(scenario.grid, n_steps=ENDLESS)
        decider = make_controller(scenario, exact, grid=endless, measured=True)
        return cls(scenario, exact, decider, state, history)

    def state(self) -> dict[str, Any]:
        """The whole state of the controller, as a plain value for JSON.

        A controller made from it, in another process or after a restart, makes the same decisions
        to the last bit; it may also decide the last step again. The state has the known steps, the
        AC operating point, switching duties and cold load, the plan, the guard's measurements and
        estimates, a layout ``version`` and a ``digest``.

        Examples
        --------
        >>> import json, vppres
        >>> day = vppres.load_scenario("uk-heatwave-2022")
        >>> options = vppres.RunOptions(horizon_h=0, isolate=False)
        >>> saved = json.dumps(Controller.of(day, options).state())
        >>> Controller.of(day, options, state=json.loads(saved)).times[0].hour
        0
        """
        with self._turn:
            at = Standing(self.scenario, self._forgotten, self._past, self._step_before)
            return state_of(at, self._decider, self.options)

    def saved(self) -> str:
        """The state as JSON text, in a short form to store after every step.

        It differs from :meth:`state` in two ways: of the last step you can decide the rest again
        from it, but not the whole, and you must store the measurements for a forecaster that learns
        separately (``history`` of :meth:`of`).
        """
        with self._turn:
            at = Standing(self.scenario, self._forgotten, self._past, self._step_before)
            return saved_state(at, self._decider, self.options)

    @property
    def measured(self) -> History | None:
        """Measurements of the last step, one row; None if no forecaster learns from them."""
        history = self._past.history
        return history and history.rows(history.n_steps - 1, history.n_steps)

    @property
    def times(self) -> pd.DatetimeIndex:
        """Start times of the known steps: future ones, and the past that is kept."""
        return self.scenario.grid.times

    @property
    def decided(self) -> pd.Timestamp | None:
        """Start time of the last decided step; None before the first."""
        return None if self._past.t < 0 else self.times[self._past.t - self._forgotten]

    def window(self, time: pd.Timestamp | str) -> pd.DatetimeIndex:
        """Times for which the decision at ``time`` uses forecasts, ``time`` itself included.

        A window ends with the known steps.
        """
        steps = self._window(step_at(self.scenario.grid, time))
        return self.times[steps.start : steps.stop]

    def ahead(self, time: pd.Timestamp | str) -> pd.DatetimeIndex:
        """All times that the decision at ``time`` may use.

        Those of its window; with outage probabilities also those for which energy may be stored.
        """
        steps = self._ahead(step_at(self.scenario.grid, time))
        return self.times[steps.start : steps.stop]

    def _window(self, row: int) -> range:
        """Rows of the scenario that a decision looks at, cut where it ends."""
        stop = self._decider.horizon_steps(row + self._forgotten).stop - self._forgotten
        return range(row, min(stop, self.scenario.grid.n_steps))

    def _ahead(self, row: int) -> range:
        """Rows that a belief of outages looks at; without one, those of the window."""
        window = self._window(row)
        if self.options.outages == KNOWN:
            return window
        grid = self.scenario.grid
        stop = max(row + grid.steps_in_horizon(LOOKAHEAD_H), window.stop)
        return range(row, min(stop, grid.n_steps))

    def warn(self, *warnings: OutageWarning, replacing: bool = False) -> None:
        """Add outage warnings.

        Parameters
        ----------
        *warnings : OutageWarning
            Warnings, in any order; for each outage the last issued one counts, whatever its name.
        replacing : bool, optional
            Whether they replace all earlier warnings.

        Examples
        --------
        >>> import pandas as pd
        >>> import vppres
        >>> day = vppres.load_scenario("uk-heatwave-2022")
        >>> controller = Controller.of(day, vppres.RunOptions(outages="belief"))
        >>> at = controller.times[0]
        >>> onset = at + pd.Timedelta(hours=3)
        >>> controller.warn(OutageWarning(at, onset_likely=onset, preset="rota"))
        >>> len(controller.scenario.warnings)
        1
        """
        with self._turn:
            before = () if replacing else self.scenario.warnings
            self.scenario = replace(self.scenario, warnings=(*before, *warnings))

    def report(self, *faults: LineFault, replacing: bool = False) -> None:
        """Add faults of lines and buses; plans from the next step on know them.

        A fault whose end changes, or that is repaired, is reported anew with all others.

        Parameters
        ----------
        *faults : LineFault
            What is out of service, and until when as far as it is known.
        replacing : bool, optional
            Whether they replace all earlier ones, those of the scenario among them.

        Raises
        ------
        InputError
            For a line or bus that is not there.

        Examples
        --------
        >>> import pandas as pd
        >>> import vppres
        >>> day = vppres.load_scenario("uk-heatwave-2022")
        >>> controller = Controller.of(day)
        >>> noon = pd.Timestamp("2022-07-19T12:00Z")
        >>> controller.report(vppres.LineFault(noon, noon + pd.Timedelta(hours=6), line=7))
        >>> [fault.name(day.network) for fault in controller.scenario.faults]
        ['line 6-7']
        """
        with self._turn:
            before = () if replacing else self.scenario.faults
            self.scenario = replace(self.scenario, faults=(*before, *faults))

    def out_probability(self, time: Any) -> pd.Series:
        """Probability of an outage in each step from a time on, at most 48 h ahead.

        It uses the warnings issued by then, and the state of the grid up to the last decided
        step. If the options have ``outages="known"``, it is 0 or 1 as in the scenario.

        Examples
        --------
        >>> import vppres
        >>> day = vppres.load_scenario("uk-heatwave-2022")
        >>> controller = Controller.of(day, vppres.RunOptions(isolate=False))
        >>> controller.out_probability(day.grid.times[11]).head(3).tolist()
        [0.0, 1.0, 1.0]
        """
        with self._turn:
            grid = self.scenario.grid
            row = step_at(grid, time)
            times = grid.times[row : row + grid.steps_in_horizon(LOOKAHEAD_H)]
            if self.options.outages == KNOWN:
                out = self.scenario.grid_limit_kw[row : row + len(times)] <= 0.0
                return pd.Series(out.astype(float), times)
            decided = self._past.t - self._forgotten
            seen_last = min(decided, row) if self._past.t >= 0 else row - 1
            ahead = range(row - seen_last, row - seen_last + len(times))
            return pd.Series(self._believed(seen_last, row)[ahead], times)

    def replaced(self, time: pd.Timestamp) -> frozenset[str]:
        """Names of warnings that do not count at a time: a later one speaks of the same outage."""
        with self._turn:
            known = self.scenario
            outlook = OutageOutlook(known.warnings, known.outage_statistics, known.grid.dt_h)
            found = outlook.expected(time, self._past.grid_seen.outages)
            return frozenset(name for one in found for name in one.dropped)

    def _believed(self, seen_last: int, said_last: int) -> Floats:
        """Probability of an outage in the steps from the one on that was seen last."""
        scenario = self.scenario
        step = scenario.grid.step
        then = scenario.grid.start + seen_last * step
        messages = [
            replace(one, issued_at=min(one.issued_at, then))
            for one in scenario.warnings
            if one.issued_at <= scenario.grid.start + said_last * step
        ]
        outlook = OutageOutlook(messages, scenario.outage_statistics, scenario.grid.dt_h)
        n_steps = said_last - seen_last + scenario.grid.steps_in_horizon(LOOKAHEAD_H)
        return outlook.at(then, n_steps, self._past.grid_seen.outages).out_probability

    def extend(
        self, more: Scenario | Feed, *, replacing: bool = False, forget: bool = True
    ) -> None:
        """Append known steps, so that the controller can continue; nothing else changes.

        State, duties, plan and operating point carry over. The decisions are the same to the last
        bit for any division of the series into pieces, if the windows are known in time.

        Parameters
        ----------
        more : Scenario or Feed
            Steps that start at the end of the known ones: the series alone, or a scenario of the
            same site, of which only the series are used.
        replacing : bool, optional
            Whether ``more`` may start at any undecided step and replaces all known steps from
            there on.
        forget : bool, optional
            Whether steps before the last decided one are dropped, so that memory stays bounded.

        Raises
        ------
        InputError
            For another site, gaps, overlaps, past steps and wrong values. Then nothing has
            changed.
        """
        with self._turn:
            latest = self._past.t - self._forgotten
            self.scenario = extended(self.scenario, more, latest + 1, replacing=replacing)
            if forget and latest > 0:
                self.scenario = self.scenario.between(latest, self.scenario.grid.n_steps)
                self._forgotten += latest

    def step(self, observation: Measurement) -> SetPoints:
        """Decide on the step that begins now.

        You may decide the last step again with other measurements: the second decision replaces
        the first; with ``now`` it applies to the rest of the step. A call that raises changes
        nothing.

        Parameters
        ----------
        observation : Measurement
            Measured and expected values. A full-horizon controller plans at its first call, which
            must be the first step.

        Returns
        -------
        SetPoints
            The decision, with the AC power flow that it leads to.

        Raises
        ------
        InputError
            With every value of the measurement that does not fit the scenario, and for a step
            before the last one.
        SolveError
            If the window has no solution and the guard is off.
        VerificationError
            If the AC power flow of the set-points does not converge.
        """
        with self._turn:  # steps are decided one after another, for all callers
            return self._step(observation)

    def _step(self, observation: Measurement) -> SetPoints:
        """One step, undone if it fails."""
        latest = memory_of(self._decider, self._given)
        try:
            row, within = row_of(self.scenario.grid, observation)
            start = self._start(row, within, latest)
            self._recall(start[0])
            at = Standing(self.scenario, self._forgotten, start[1])
            rows = self._window(row), self._ahead(row)
            present = Present.of(observation, at, *rows, self.options, self._past_days)
            decision, points, past = self._decision_and_state(present)
        except BaseException as error:  # Ctrl-C too
            self._recall(latest)
            if isinstance(error, Exception) and not isinstance(error, VppresError):
                raise SolveError(f"The step failed: {type(error).__name__}: {error}") from error
            raise
        self.last, self._past = decision, past
        if not (within and self._step_before):
            self._step_before = start
        return points

    def _start(self, row: int, within: bool, latest: dict[str, Any]) -> tuple[dict[str, Any], Past]:
        """Memory and state from which a step goes on: those before it, if it is decided again."""
        again = self._step_before if row + self._forgotten == self._past.t else None
        if not again:
            return latest, self._past
        memory, before = again
        if within:
            return latest, before.within_step(self._past)
        return (latest, self._past) if memory is None else (memory, before)

    def _recall(self, memory: dict[str, Any]) -> None:
        """Let the decider stand where a memory of it was made."""
        put_back(self._decider, memory, self._given, WHERE)

    def _decision_and_state(self, present: Present) -> tuple[Decision, SetPoints, Past]:
        """Decision for the window as it is expected, its tables, and the state to go on from."""
        known_now = present.observation(OutageView.create(self.scenario, self._record))
        decision = _without_disconnected(self._decider.decide(known_now), present.connected)
        words = (*present.estimated, decision.estimated)
        estimated = "; ".join(filter(None, words))
        seen = decision.seen or known_now
        decision = replace(decision, estimated=estimated, seen=seen)
        day = present.day(seen, estimated)
        record = day.settle(0, decision)
        foreseen = Foreseen.of(decision, day.scenario, known_now)
        points = SetPoints.of(
            day.scenario,
            record,
            foreseen,
            day.plant.switching,
            present.kinds,
            present.closed,
            Proposal.of(day.branches, decision.switched, record),
        )
        return decision, points, present.after(day, record)


def _without_disconnected(decision: Decision, connected: Flags) -> Decision:
    """A decision without customers that cannot be supplied; they take nothing in it."""
    if connected.all():
        return decision
    served = decision.dispatch.served & connected
    share = decision.dispatch.share
    given = None if share is None else share * connected
    return replace(decision, dispatch=replace(decision.dispatch, served=served, share=given))

"""The controller for your own plant: measure, ``step``, apply the set-points."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from vppres.contract.ahead import past_days_of
from vppres.contract.decision import Decider, Decision
from vppres.contract.forecast import ForecastErrors
from vppres.control.remembered import memory_of, put_back
from vppres.core.arrays import Flags
from vppres.core.errors import SolveError, VppresError
from vppres.day.assembly import make_controller
from vppres.day.options import RunOptions
from vppres.day.outages import OutageView
from vppres.live.foreseen import Foreseen
from vppres.live.known_ahead import KnownAhead
from vppres.live.measurement import Measurement, row_of
from vppres.live.past import Past
from vppres.live.present import Present
from vppres.live.proposal import Proposal
from vppres.live.set_points import SetPoints
from vppres.live.state import WHERE, Standing, given_by, restored, saved_state, state_of
from vppres.scenario.history import History
from vppres.scenario.scenario import Scenario
from vppres.solve.isolated import SUPPORTED

ENDLESS = 2**40
"""Steps that a controller may be fed with in its life."""


class Controller(KnownAhead):
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
        super().__init__(at, options, decider)
        self._record = options.as_record()
        self.last: Decision | None = None
        self._step_before: tuple[dict[str, Any] | None, Past] | None = at.before
        self._given = given_by(scenario, options)
        self._past_days = past_days_of(scenario, options.seed)

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

"""A controller's knowledge of the steps ahead: series, outages, faults of lines."""

from __future__ import annotations

import threading
from dataclasses import replace
from typing import Any

import pandas as pd

from vppres.contract.decision import Decider
from vppres.core.arrays import Floats
from vppres.day.options import RunOptions
from vppres.day.outages import KNOWN, LOOKAHEAD_H
from vppres.live.feed import Feed, extended
from vppres.live.measurement import step_at
from vppres.live.state import Standing
from vppres.outlook.outlook import OutageOutlook
from vppres.scenario.faults import LineFault
from vppres.scenario.outage_warnings import OutageWarning
from vppres.scenario.scenario import Scenario


class KnownAhead:
    """Steps that a controller looks ahead to, with their outages and faults of lines."""

    def __init__(self, at: Standing, options: RunOptions, decider: Decider) -> None:
        # Measurements are remembered in the past, once.
        self.scenario = replace(at.known, history=None)
        self.options = options
        self._decider = decider
        # Steps of controllers count on from the very first one; the scenario begins later.
        self._forgotten = at.forgotten
        self._past = at.past
        self._turn = threading.Lock()

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
        >>> controller = vppres.Controller.of(day, vppres.RunOptions(outages="belief"))
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
        >>> controller = vppres.Controller.of(day)
        >>> noon = pd.Timestamp("2022-07-19T12:00Z")
        >>> controller.report(vppres.LineFault(noon, noon + pd.Timedelta(hours=6), line=7))
        >>> [fault.name(day.network) for fault in controller.scenario.faults]
        ['line 6-7']
        """
        with self._turn:
            before = () if replacing else self.scenario.faults
            self.scenario = replace(self.scenario, faults=(*before, *faults))

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

    def out_probability(self, time: Any) -> pd.Series:
        """Probability of an outage in each step from a time on, at most 48 h ahead.

        It uses the warnings issued by then, and the state of the grid up to the last decided
        step. If the options have ``outages="known"``, it is 0 or 1 as in the scenario.

        Examples
        --------
        >>> import vppres
        >>> day = vppres.load_scenario("uk-heatwave-2022")
        >>> controller = vppres.Controller.of(day, vppres.RunOptions(isolate=False))
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

"""The plan of a step: by the controller, by an operator, by default, or by the rule."""

from __future__ import annotations

import json
import logging
import re
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from vppres.core.errors import InputError, StorageError
from vppres.day.forecasting import FORECASTERS
from vppres.day.outages import KNOWN
from vppres.live.controller import Controller
from vppres.live.measurement import Measurement
from vppres.service.alarms.conditions import BY_HAND
from vppres.service.operation.site import FAILED, OperatedSite, Span
from vppres.service.plans.document import (
    Left,
    defaults_of,
    ordered,
    ordered_plan,
    plan_of,
    tables_of,
    told_at,
)
from vppres.service.plans.gate import refusals
from vppres.service.plans.ruled import ruled
from vppres.service.storage.records import After
from vppres.service.telemetry.knowledge import Grid, Latest, StepInputs, grid_at, known_at
from vppres.service.telemetry.learned import learned

LAST_PLAN = "last plan"
"""Who says whether there is grid where nothing else does."""

MOST_KNOWN = 24
"""Steps of which it is remembered what was expected when they were decided."""

NUMBERS = re.compile(r" [-+.\d]+")
"""What changes from step to step in words about the same."""

Plan = dict[str, Any]

log = logging.getLogger(__name__)


class Deciding:
    """Plans steps of a site with a controller that goes on where its stored state left it.

    Attributes
    ----------
    heard : list of dict
        How old the readings of the last decision were.
    expected : dict of str
        Inputs of the last decisions, by the plan's identifier.
    """

    def __init__(self, site: OperatedSite) -> None:
        self.site = site
        self.heard: list[dict[str, Any]] = []
        self.expected: OrderedDict[str, Measurement] = OrderedDict()
        self._odd = set[str]()
        self._state = ""

    def restore(self) -> None:
        """Go on from the last stored state that is whole."""
        self._state = self._last_state()
        self.resume()

    def resume(self) -> None:
        """The controller where the last state that was kept left it."""
        site = self.site
        known, begun = site.scenario, site.begun(site.clock.now())
        if site.profile:
            known = site.profile.steps(begun, site.n_ahead)
        state = json.loads(self._state) if self._state else None
        history = None
        if site.options.forecaster in FORECASTERS:
            history = learned(site.store, site.scenario, begun)
        self.controller = Controller.of(known, site.options, state=state, history=history)

    @property
    def has_decided(self) -> bool:
        """Whether there is a state to go on from."""
        return self._state != ""

    def _last_state(self) -> str:
        """The last state that is whole; empty where nothing was decided yet."""
        states = self.site.store.states()
        for text in states:
            try:
                json.loads(text)
                return text
            except ValueError:
                log.error("the last state of the controller is cut: the one before it is taken")
        if states:
            cure = "Put a copy of the database in its place, or remove it."
            raise InputError.of(self.site.store.place, "has no whole state of the controller", cure)
        return ""

    def after(self) -> After:
        """State and measurements behind the last decision, as they are stored."""
        return After(self.controller.saved(), self.controller.measured)

    def keep(self, plan: Plan, known: StepInputs, after: After) -> None:
        """The plan is stored with the state behind it."""
        self._log_odd(plan)
        self._state = after.state
        self.expected[plan["id"]] = known.measurement
        while len(self.expected) > MOST_KNOWN:
            self.expected.popitem(last=False)

    def planned(self, span: Span, mode: Mapping[str, Any]) -> tuple[Plan, StepInputs | None]:
        """A plan as the mode has it, and on what the controller decided it, if it did."""
        if mode["mode"] == "off":
            left = self.left(span, self._grid(span))
            reason = mode["reason"] or "switched off"
            return defaults_of(span.begin, self.site.scenario, "off", reason, left), None
        if mode["mode"] in BY_HAND:
            return self._by_hand(span, mode), None
        return self._decided(span)

    def _decided(self, span: Span) -> tuple[Plan, StepInputs | None]:
        """The controller's plan, and on what; by rule on nothing, whatever it is that fails."""
        site = self.site
        known: StepInputs | None = None
        try:
            self._feed(span)
            now = span.since if span.why else None
            known = known_at(span.begin, self.controller, site.store, site.rehearsal, now)
            self.heard = known.latest.heard
            decision = self.controller.step(known.measurement)
            # What was decided on, not what was read: the gate checks this decision.
            tables = tables_of(decision, site.scenario)
            refused = refusals(tables, site.scenario, dict(decision.batteries["soc"]))
        except StorageError:
            raise
        except Exception as error:
            # A step without an answer is worse than any of it.
            log.exception("step")
            return self._ruled(span, known, error), None
        plan = plan_of(decision, site.scenario, known, refused, self.left(span, known.grid))
        return {**plan, "outage_probability": self._believed(known)}, known

    def _by_hand(self, span: Span, mode: Mapping[str, Any]) -> Plan:
        """The plan of an operator, through the gate as any other."""
        site = self.site
        tables = ordered(site.scenario, site.last, mode.get("setpoints", []))
        soc = Latest.at(span.begin, site.scenario, site.store).soc
        refused = refusals(tables, site.scenario, soc)
        left = self.left(span, self._grid(span))
        return ordered_plan(span.begin, site.scenario, mode, tables, refused, left)

    def _ruled(self, span: Span, known: StepInputs | None, error: Exception) -> Plan:
        """The plan of a rule that needs no solver, for a step in which everything else failed."""
        site = self.site
        now = replace(site.profile_of(span.begin), faults=site.faults(span.since))
        now = site.in_configuration(now, span.since)
        left = self.left(span, known.grid if known else None)
        latest = known.latest if known else Latest.at(span.begin, site.scenario, site.store)
        lost = known.lost if known else {}
        if not left.available:
            now = replace(now, grid_limit_kw=np.zeros(1))
        words = str(error).splitlines()[:1] or [type(error).__name__]
        mode = {"mode": FAILED, "reason": f"by rule: {words[0]}"}
        physical = site.options.mode == "physical"
        tables = ruled(now, latest.soc, lost, ordered(site.scenario, site.last, []), physical)
        return ordered_plan(span.begin, site.scenario, mode, tables, {}, left)

    def _grid(self, span: Span) -> Grid | None:
        """Whether there is grid in a step that the controller does not decide; None if unknown."""
        try:
            self._feed(span)
            return grid_at(span.begin, self.controller, self.site.store, span.since)
        except StorageError:
            raise
        except Exception:
            log.exception("whether there is grid at %s", span.begin)
            return None

    def left(self, span: Span, grid: Grid | None) -> Left:
        """Last set-points of devices and state of the grid, which is as before if it is unknown."""
        told = told_at(self.site.last, span.since)
        if grid:
            return Left(grid.available, grid.known_by, told)
        before = self.site.last.get("grid") or {"available": True}
        return Left(before["available"], LAST_PLAN, told)

    def _feed(self, span: Span) -> None:
        """Let the controller know the steps up to the horizon's end and one more, and messages."""
        site = self.site
        if site.profile:
            end = self.controller.scenario.grid.end
            missing = round((span.begin - end) / site.length) + site.n_ahead
            if missing > 0:
                self.controller.extend(site.profile.steps(end, missing))
        self.controller.warn(*site.warnings(span.begin), replacing=True)
        self.controller.report(*site.faults(span.since), replacing=True)

    def _believed(self, known: StepInputs) -> list[float]:
        """Probability of an outage in the present step and those behind it."""
        if self.site.options.outages == KNOWN:
            return [float(limit_kw <= 0.0) for limit_kw in known.grid.limits_kw]
        found = self.controller.out_probability(known.measurement.time)
        return [round(float(each), 6) for each in found]

    def _log_odd(self, plan: Plan) -> None:
        """A line for what is odd, when it begins; readings that are only missing are late.

        Several messages speak of one outage, or a device is not as its readings or sessions say.
        """
        said = [plan["solve"]["outage_messages"] or "", *plan["estimated"]]
        odd = {NUMBERS.sub("", words): words for words in said if not words.endswith("(missing)")}
        for key, words in odd.items():
            if key and key not in self._odd:
                log.warning("%s: %s", plan["start"], words)
        self._odd = set(odd)

"""How a site stands now: its alarms, its switches, and what an operator's set-points lead to."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.errors import StorageError
from vppres.scenario.scenario import Scenario
from vppres.service.alarms.conditions import Situation, conditions, situation
from vppres.service.alarms.notify import Notifier
from vppres.service.alarms.state import Alarms
from vppres.service.as_told import closed_by, expected_by
from vppres.service.of_kind import told_by_plans
from vppres.service.operation.by_hand import ByHand
from vppres.service.operation.site import OperatedSite
from vppres.service.operation.switching import SWITCHING, Switchgear
from vppres.service.plans.document import PROPOSED, points_at
from vppres.service.telemetry.knowledge import CLOSED, states_of
from vppres.service.telemetry.learned import InSteps


class Watch:
    """Looks at a site as it is now, between two plans too.

    Attributes
    ----------
    notifier : Notifier or None
        Sender of alarms to webhooks and by mail, if there is one.
    """

    def __init__(self, site: OperatedSite) -> None:
        self.site = site
        self.alarms = Alarms(site.store)
        self.notifier: Notifier | None = None

    def situation(self, now: pd.Timestamp) -> Situation:
        """How the site is, with the last plan and what that does not know."""
        site = self.site
        return situation(
            now,
            site.scenario,
            site.store,
            site.last,
            site.ahead_s,
            site.changes.reasons,
            site.options.mode,
        )

    def check_alarms(self) -> None:
        """Raise, change and clear alarms by what is wrong now."""
        now = self.site.clock.now()
        with suppress(StorageError):  # /readyz says so, and the next look comes soon
            found = self.situation(now)
            unreached = self.notifier.unreached() if self.notifier else ()
            stopped = self.switchgear().stopped if self.is_switching else ""
            found = replace(found, unreached=unreached, switching_stopped=stopped)
            self.alarms.look(conditions(found), now)

    def checked(self, asked: Mapping[str, Any]) -> list[str]:
        """Consequences of an operator's set-points now, by balance and AC power flow.

        Raises
        ------
        InputError
            If they would black out an island that is lit.
        """
        now = self.site.clock.now()
        found = self.situation(now)
        step = self.site.in_configuration(self._measured(now, found.is_dark), now)
        step = told_by_plans(step, [found.plan])
        return ByHand(asked, step, found, self.site.options).words()

    @property
    def is_switching(self) -> bool:
        """Whether states of switches are asked for or proposed, or an operation was confirmed."""
        asked = self.site.store.setting(SWITCHING)[0]
        return bool(asked.get("closed") or asked.get("issued") or self.site.last.get(PROPOSED))

    def switchgear(self, asked: Mapping[str, Any] | None = None) -> Switchgear:
        """Switches as they were read last, and as an operator asked for them, or asks now."""
        site, now = self.site, self.site.clock.now()
        given = site.store.setting(SWITCHING)[0] if asked is None else asked
        found = self.situation(now)
        has_grid = not found.is_dark
        return Switchgear(
            step=self._measured(now, found.is_dark),
            read=states_of(site.scenario, site.store, now),
            of_plan=closed_by(site.last, site.branches),
            proposed=site.last.get(PROPOSED, {}),
            soc=found.known_soc,
            asked=given,
            carried_out=self._carried_out(given.get("issued")),
            set_points=points_at(site.last, now),
            has_grid=has_grid,
            source=has_grid or found.formers is None,
            is_lit=not found.why_dark,
            now=now,
        )

    def _carried_out(self, issued: Mapping[str, Any] | None) -> bool:
        """Whether an operation was seen in a reading after it was confirmed."""
        if issued is None:
            return False
        confirmed = pd.Timestamp(issued["confirmed_at"])
        since = self.site.store.between(confirmed, self.site.until, [CLOSED])
        told = (one for one in since if one.asset == issued["switch"])
        return any(one.value == float(issued["closed"]) for one in told)

    def _measured(self, now: pd.Timestamp, is_dark: bool) -> Scenario:
        """The present step, with its readings and what is known to be out."""
        site = self.site
        step = site.profile_of(site.begun(now))
        measured = InSteps(site.store, step.grid)
        limit_kw = expected_by(site.last).get("grid_limit_kw")
        known_kw = np.inf if limit_kw in (None, 0.0) else limit_kw
        return replace(
            step,
            load_kw=measured.laid("load_kw", step.customers.id, step.load_kw),
            pv_kw=np.minimum(measured.laid("pv_kw", step.pv.id, step.pv_kw), step.pv.p_max_kw),
            grid_limit_kw=np.array([0.0 if is_dark else known_kw]),
            faults=site.faults(now),
        )

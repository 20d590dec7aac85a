"""The live service over many days of bad telemetry, with the plant as the world.

``python -m experiments.studies.live_days`` plays days with outages against a service, once with all
that devices say and then with readings lost, late, off in time and repeated, separately and
together; and a week in a row over HTTP with a process of its own, to see whether anything grows. It
prints JSON. Whoever of the first tier was off is judged by ``experiments/studies/shedding.py``:
what counts is who need not have been off by what was known then.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from contextlib import closing
from dataclasses import asdict, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd

import vppres
from experiments.studies.shedding import Judge
from experiments.studies.within import Within
from vppres.day.options import RunOptions
from vppres.live.profile import ClockProfile
from vppres.scenario.scenario import Scenario
from vppres.service.access import Access
from vppres.service.clock import SetClock
from vppres.service.http.app import make_app
from vppres.service.http.serve import opened
from vppres.service.operation.site import Service
from vppres.service.plans.world import World
from vppres.service.simulate import Place, Play, Player, TelemetryFaults, simulate

SITES = ("uk-heatwave-2022", "two-outages-cigre-mv")
WORST = TelemetryFaults(lost=0.3, delayed=0.1, skew_s=90.0, repeats=True)
FAULTS = {
    "none": TelemetryFaults(),
    "lost": TelemetryFaults(lost=0.3),
    "delayed": TelemetryFaults(delayed=0.1),
    "skewed": TelemetryFaults(skew_s=90.0),
    "repeated": TelemetryFaults(repeats=True),
    "all": WORST,
}
SPEED = 600.0


def days_of(site: Scenario, days: int, seed: int) -> Scenario:
    """Days of a site: its profile, with demand and sun that differ from it, and its outages.

    Every item is off by up to a tenth for a whole day, and by up to a twentieth for an hour.
    """
    steps_a_day = round(24 / site.grid.dt_h)
    start = site.grid.start.tz_convert(site.grid.zone).normalize().tz_convert("UTC")
    come = ClockProfile.of(site).steps(start, days * steps_a_day)
    row = ((come.grid.times - site.grid.start) // pd.Timedelta(minutes=site.grid.step_minutes)).map(
        lambda step: step % site.grid.n_steps
    )
    random = np.random.default_rng(seed)

    def moved(values: Any) -> Any:
        day = random.uniform(0.9, 1.1, (days, values.shape[1])).repeat(steps_a_day, axis=0)
        return values * day * random.uniform(0.95, 1.05, values.shape)

    return replace(
        come,
        load_kw=moved(come.load_kw),
        pv_kw=np.minimum(moved(come.pv_kw), site.pv.p_max_kw),
        grid_limit_kw=site.grid_limit_kw[row.to_numpy()],
        warnings=(),
    )


def faults_study(names: Sequence[str], days: int, horizon_h: float) -> list[dict[str, Any]]:
    """Every kind of fault on the same days."""
    found = []
    for name in names:
        site = vppres.load_scenario(name)
        service = Service(site, RunOptions(horizon_h=horizon_h), paced=True)
        for kind, faults in FAULTS.items():
            come = days_of(site, days, seed=1)
            result = judged(service, come, Play(faults=faults))
            found.append({"site": name, "faults": kind, **result})
    return found


def judged(service: Service, come: Scenario, play: Play) -> dict[str, Any]:
    """Days against a service in this process, and who was off that need not have been."""
    with (
        TemporaryDirectory() as folder,
        opened(service, Path(folder), SetClock(come.grid.start)) as runner,
        closing(Within(make_app(runner, Access()))) as http,
    ):
        player = _Judged(World(come, service.options), http, play)
        player.judge = Judge(runner)
        found = player.play().summary()
    shed = player.judge.found
    return {
        **{name: value for name, value in found.items() if not name.endswith("_s")},
        "critical_let_go": sum(each.now for each in shed),
        "critical_let_go_avoidably": sum(each.avoidable for each in shed),
        "shed": [asdict(each) for each in shed],
    }


class _Judged(Player):
    """A player whose plans are judged."""

    judge: Judge

    def _step(self, t: int) -> None:
        super()._step(t)
        plan = self.judge.runner.last
        self.judge.look(plan)


def week(days: int, horizon_h: float) -> dict[str, Any]:
    """Days in a row with all faults over HTTP; and judged, with all of them and without any."""
    site = vppres.load_scenario(SITES[0])
    service = Service(site, RunOptions(horizon_h=horizon_h), paced=True)
    come = days_of(site, days, seed=2)
    found = simulate(service, come, Play(faults=WORST), Place())
    step_s = site.grid.dt_h * 3600.0 / SPEED
    return {
        "days": days,
        f"in_time_at_{SPEED:g}": found["slowest_answer_s"] < step_s,
        **found,
        "judged": {
            kind: judged(service, come, Play(faults=FAULTS[kind])) for kind in ("none", "all")
        },
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--days", type=int, default=7, help="days of the week")
    parser.add_argument("--fault-days", type=int, default=2, help="days of each kind of fault")
    parser.add_argument("--horizon", type=float, default=5.0, help="horizon in h")
    parser.add_argument("--sites", nargs="*", default=SITES, help="packaged scenarios")
    chosen = parser.parse_args(arguments)
    found = {
        "faults": faults_study(chosen.sites, chosen.fault_days, chosen.horizon),
        "week": week(chosen.days, chosen.horizon) if chosen.days else None,
    }
    sys.stdout.write(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()

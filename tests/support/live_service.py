"""A live service of the tiny feeder, asked without a network in between."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import vppres
from tests.support.asgi import Caller
from tests.support.homes import homes
from tests.support.long_days import repeated
from tests.support.sets import gensets
from tests.support.vans import van
from vppres.day.options import RunOptions
from vppres.scenario.scenario import Scenario
from vppres.scenario.timegrid import TimeGrid
from vppres.service.access import Access
from vppres.service.clock import SetClock, TimeSource, written
from vppres.service.http.app import make_app
from vppres.service.http.serve import opened
from vppres.service.operation.runner import Runner
from vppres.service.operation.site import Service
from vppres.service.storage.records import Reading, seconds

HERE = RunOptions(horizon_h=2.0, isolate=False)
NOON = pd.Timestamp("2026-11-21T12:00Z")

Live = tuple[Caller, SetClock]
"""What asks a live service, and its clock."""

Running = tuple[Caller, SetClock, Runner]
"""The same with the service itself."""


def site(tiny: Scenario, minutes: int = 60) -> Scenario:
    """A day of steps from local midnight, without outage."""
    n_steps = 24 * 60 // minutes
    day = repeated(tiny, n_steps)
    grid = TimeGrid(pd.Timestamp("2025-07-01T00:00Z"), float(minutes), n_steps)
    return replace(day, grid=grid, grid_limit_kw=np.full(n_steps, np.inf))


def with_units(tiny: Scenario, **more: Any) -> Scenario:
    """The site with a van, a home that is cooled, and a set that runs in an outage."""
    day = site(tiny)
    charger, vehicle = van(NOON.floor("1D"), NOON.floor("1D") + pd.Timedelta("22h"))
    units = {"chargers": charger, "sessions": vehicle, "gensets": gensets(1)}
    home = homes(str(day.customers.id[0]))
    return replace(day, **units, thermal_loads=home, **more)


@contextmanager
def serving(
    service: Service,
    folder: Path | str,
    clock: TimeSource | None = None,
    access: Access | None = None,
) -> Iterator[tuple[Caller, Runner]]:
    """A service that is asked without a network in between, and itself."""
    with opened(service, folder, clock) as runner:
        yield Caller(make_app(runner, access or Access())), runner


@contextmanager
def client(
    service: Service,
    folder: Path | str,
    clock: TimeSource | None = None,
    access: Access | None = None,
) -> Iterator[Caller]:
    """A service that is asked without a network in between."""
    with serving(service, folder, clock, access) as (http, _):
        yield http


@contextmanager
def running(tiny: Scenario, folder: Path) -> Iterator[Running]:
    """A service of the tiny feeder at noon that has decided nothing yet."""
    clock = SetClock(NOON)
    with serving(Service(site(tiny), HERE), folder, clock) as (http, runner):
        yield http, clock, runner


@contextmanager
def at_noon(tiny: Scenario, folder: Path) -> Iterator[Live]:
    """Running service at noon, and its clock."""
    with running(tiny, folder) as (http, clock, _):
        yield http, clock


def reading(
    asset: str,
    quantity: str,
    time: pd.Timestamp,
    *values: float | None,
    lasts: str = "PT1H",
    source: str = "scada",
) -> dict[str, Any]:
    """Readings of an asset one after another, of an hour each, as they are sent."""
    what = {"source": source, "asset": asset, "quantity": quantity}
    return {**what, "start": written(time), "resolution": lasts, "values": list(values)}


def readings(
    time: pd.Timestamp, quantity: str, values: Mapping[str, float | None], lasts: str = "PT1H"
) -> list[Any]:
    """One reading of each asset, for an hour."""
    return [reading(asset, quantity, time, value, lasts=lasts) for asset, value in values.items()]


def heard(time: pd.Timestamp, soc: float = 0.5) -> dict[str, Any]:
    """Telemetry of both batteries."""
    return {"series": readings(time, "soc", {"big": soc, "small": soc})}


def said(plan: dict[str, Any], kind: str) -> dict[str, Any]:
    """Set-points of a kind by asset."""
    return {one["asset"]: one for one in plan["setpoints"] if one["kind"] == kind}


def told(run: vppres.Trajectory, t: int) -> dict[str, Any]:
    """Readings that a SCADA system would send before a step of a run."""
    time = run.scenario.grid.times[t]
    b = run.batteries[run.batteries["time"] == time]
    series = readings(time, "soc", dict(zip(b["id"], b["soc_start"], strict=True)))
    series += readings(
        time, "load_kw", dict(zip(run.scenario.customers.id, run.scenario.load_kw[t], strict=True))
    )
    series += readings(
        time, "pv_kw", dict(zip(run.scenario.pv.id, run.scenario.pv_kw[t], strict=True))
    )
    if t > 0:
        begun = run.scenario.grid.times[t - 1]
        before = run.batteries[run.batteries["time"] == begun]
        power = before["charge_kw"] - before["discharge_kw"]
        series += readings(begun, "battery_kw", dict(zip(before["id"], power, strict=True)))
        series += readings(begun, "import_kw", {"grid": float(run.steps["p_grid_kw"][t - 1])})
    return {"series": series}


def decided(http: Caller, clock: SetClock, time: pd.Timestamp, soc: float = 0.5) -> dict[str, Any]:
    """The plan of a step for which both batteries were heard."""
    clock.set(time)
    assert http.post("/v1/telemetry", heard(time, soc)).status == 200
    plan: dict[str, Any] = http.post("/v1/steps").json()
    return plan


def decide(runner: Runner, time: pd.Timestamp, soc: float = 0.5) -> dict[str, Any]:
    """The plan of a step of which both batteries were heard, without a request."""
    assert isinstance(runner.clock, SetClock)
    runner.clock.set(time)
    values = [Reading(b, "soc", seconds(time), "scada", 3600, soc) for b in ("big", "small")]
    runner.store.write_readings(values, time)
    return runner.step(time)

"""Sensors that lie in every way that was met, and a service that hears them beside true ones.

A lie changes what one sensor, or all of a kind, say from a step on. The plant behind them goes on
as it is: a step counts a customer of the first tier as off if it was so there, while there is grid.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Iterable, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tests.support.homes import homes
from tests.support.live_service import reading, serving
from tests.support.sets import gensets
from tests.support.tiny_day import tiny_scenario
from tests.support.vans import chargers, plugged_in
from vppres.day.options import RunOptions
from vppres.scenario.assets import Customers, PVSystems
from vppres.scenario.network import Network
from vppres.scenario.scenario import ControllerDefaults, Scenario
from vppres.scenario.timegrid import TimeGrid
from vppres.service.clock import SetClock, written
from vppres.service.operation.site import Service
from vppres.service.plans.world import Series, World, critical_off

Told = Callable[[Sequence[float], int], float | None]
"""What is told, of all true values up to now and the step from which on the sensor lies."""


def times(factor: float) -> Told:
    """Another unit, or another transformer's ratio."""
    return lambda true, since: factor * true[-1]


def always(value: float | None) -> Told:
    """Reading that is the same whatever the true value is."""
    return lambda true, since: value


def noisy(true: Sequence[float], since: int) -> float:
    """Anything from nothing to ten times."""
    return true[-1] * float(np.random.default_rng(len(true)).uniform(0.0, 10.0))


POWERS: dict[str, Told] = {
    "in W": times(1000.0), "in MW": times(0.001), "nine times": times(9.0),
    "a ninth": times(1.0 / 9.0), "three times": times(3.0), "wrong sign": times(-1.0),
    "zero": always(0.0), "stuck": lambda true, since: true[since], "drifting": lambda true, since: true[-1] * 1.33 ** (len(true) - since), "noisy": noisy,
    "missing": always(None), "late": lambda true, since: true[max(len(true) - 3, 0)], "huge": always(9e5), "spiking": lambda true, since: true[-1] * (50.0 if (len(true) - since) % 2 else 1.0),
}  # fmt: skip


def _some(*names: str) -> dict[str, Told]:
    return {name: POWERS[name] for name in names}


OF_ALL = _some("in W", "nine times", "a ninth", "zero", "stuck", "missing")
OF_SUN = _some("in W", "nine times", "wrong sign", "zero", "stuck", "drifting", "noisy", "missing",
               "late") | {"at its rating": always(30.0)}  # fmt: skip
OF_MEANS = _some("in W", "nine times", "wrong sign", "zero", "stuck", "noisy", "missing", "late")
OTHERS: dict[str, dict[str, Told]] = {
    "soc": {"empty": always(0.0), "full": always(1.0), "in percent": times(100.0),
        "upside down": lambda true, since: 1.0 - true[-1],
        **_some("stuck", "drifting", "noisy", "missing", "late")},
    "battery_kw": OF_MEANS,
    "import_kw": OF_MEANS,
    "grid_on": {"lost once": lambda true, since: 0.0 if len(true) == since + 1 else true[-1],
        "lost": always(0.0), "there": always(1.0), "missing": always(None)},
    "online": {"gone": always(0.0)},
    "indoor_c": {"fahrenheit": lambda true, since: 1.8 * true[-1] + 32.0, "zero": always(0.0),
        "stuck": POWERS["stuck"]},
    "plugged": {"gone": always(0.0), "there": always(1.0)},
    "ev_soc": {"in percent": times(100.0), "empty": always(0.0)},
    "energy_needed_kwh": {"in Wh": times(1000.0)},
    "departure": {"an hour ago": lambda true, since: true[since] - 36000.0},
    "running": {"stands": always(0.0), "runs": always(1.0)},
    "genset_kw": {"in W": times(1000.0)},
    "fuel_litres": {"empty": always(0.0), "in ml": times(1000.0)},
    "start_fault": {"failed": always(1.0)},
}  # fmt: skip


@dataclass(frozen=True)
class Lie:
    """False reading of a quantity from a step on, of some assets or of all.

    ``instead`` has whose truth is told.
    """

    quantity: str
    name: str
    told: Told
    assets: tuple[str, ...] = ()
    instead: tuple[tuple[str, str], ...] = ()
    since: int = 0

    def __str__(self) -> str:
        return f"{self.quantity} of {', '.join(self.assets) or 'all'}: {self.name}"

    def is_of(self, one: Series) -> bool:
        """Whether it is told in place of a reading."""
        return one["quantity"] == self.quantity and (not self.assets or one["asset"] in self.assets)


def lies_of(site: Scenario) -> list[Lie]:
    """Every lie that the sensors of a site can tell."""
    c = site.customers
    first = [str(name) for name in c.id[np.asarray(c.tier == site.tiers[0])]]
    others = [str(name) for name in c.id if str(name) not in first]
    found = [Lie("load_kw", name, told, (first[0],)) for name, told in POWERS.items()]
    found += [
        Lie("load_kw", name, told, (others[0],))
        for name, told in _some("in W", "nine times", "zero", "noisy").items()
    ]
    found += [Lie("load_kw", name, told) for name, told in OF_ALL.items()]
    found.append(_swapped("load_kw", first[0], others[-1]))
    one_of: dict[str, Sequence[Any]] = {
        "pv_kw": site.pv.id,
        "soc": site.batteries.id,
        "battery_kw": site.batteries.id,
        "online": site.batteries.id,
        "import_kw": ["grid"],
        "grid_on": ["grid"],
        "indoor_c": site.thermal_loads.id,
        **dict.fromkeys(("plugged", "ev_soc", "energy_needed_kwh", "departure"), site.chargers.id),
        **dict.fromkeys(("running", "genset_kw", "fuel_litres", "start_fault"), site.gensets.id),
    }
    for quantity, ids in one_of.items():
        if len(ids):
            kinds = OF_SUN if quantity == "pv_kw" else OTHERS[quantity]
            found += [Lie(quantity, name, told, (str(ids[0]),)) for name, told in kinds.items()]
    if len(site.batteries) > 1:
        found.append(_swapped("soc", *map(str, site.batteries.id[:2])))
    return found


def _swapped(quantity: str, one: str, other: str) -> Lie:
    """Two sensors at each other's place."""
    pair = ((one, other), (other, one))
    return Lie(quantity, "swapped", lambda true, since: true[-1], (one, other), pair)


@dataclass
class Way:
    """Readings as they arrive when some sensors lie."""

    lies: Sequence[Lie]
    true: dict[tuple[str, str, str], list[float]] = field(default_factory=dict)

    def arriving(self, t: int, sent: Iterable[Series]) -> list[Series]:
        """Readings that arrive at a service."""
        sent = list(sent)
        for one in sent:
            self.true.setdefault(_key(one), []).append(float(one["values"][0]))
        return [self._told(t, one) for one in sent]

    def _told(self, t: int, one: Series) -> Series:
        value: float | None = float(one["values"][0])
        for lie in self.lies:
            if t >= lie.since and lie.is_of(one):
                asset, quantity, phase = _key(one)
                of_whom = (dict(lie.instead).get(asset, asset), quantity, phase)
                true = self.true.get(of_whom, [value or 0.0])
                value = lie.told(true, max(len(true) - 1 - (t - lie.since), 0))
        return {**one, "values": [value]}


def _key(one: Series) -> tuple[str, str, str]:
    return str(one["asset"]), str(one["quantity"]), str(one.get("phase", ""))


@dataclass(frozen=True)
class Place:
    """A site, what comes there, and how it is decided."""

    site: Scenario
    come: Scenario
    options: RunOptions


AGAIN = pd.Timedelta("5s")
"""After which the substation answers what it is asked again."""


Setpoints = list[dict[str, Any]]


@dataclass(frozen=True)
class Begun:
    """Some steps of a place in which every sensor was true, before the service begins again."""

    place: Place
    folder: Path  #: state that the service left behind
    true: dict[tuple[str, str, str], list[float]]  #: readings that have arrived
    told: list[Setpoints]  #: what the plant was told, by step


def begun(place: Place, since: int, folder: Path) -> Begun:
    """The steps before the first in which sensors may lie, which are alike for all lies."""
    found = Begun(place, folder, {}, [])
    if since:
        assert _played(found, Way([], found.true), range(since)) == []
    return found


def off_with_grid(begun: Begun, lies: Sequence[Lie]) -> list[str]:
    """Customers of the first tier that were off while there was grid, step by step.

    What the service asks again is answered by the same sensors, the liars among them.
    """
    since = len(begun.told)
    assert all(lie.since >= since for lie in lies)
    with tempfile.TemporaryDirectory() as folder:
        if since:
            shutil.copytree(begun.folder, folder, dirs_exist_ok=True)
        goes_on = replace(begun, folder=Path(folder), told=[*begun.told])
        way = Way(lies, deepcopy(begun.true))
        return _played(goes_on, way, range(since, begun.place.come.grid.n_steps))


def _played(begun: Begun, way: Way, steps: range) -> list[str]:
    place, times = begun.place, begun.place.come.grid.times
    world = World(place.come, place.options)
    for t, setpoints in enumerate(begun.told):
        world.obey(t, setpoints)
    clock = SetClock(times[steps[0]])
    found = []
    service = Service(place.site, place.options, paced=True)
    with serving(service, begun.folder, clock) as (http, runner):
        for t in steps:
            clock.set(times[t])
            sent = way.arriving(t, world.readings(t))
            assert http.post("/v1/telemetry", {"series": sent}).status == 200
            plan = http.post("/v1/steps").json()
            if plan.get("asked_again"):
                clock.set(times[t] + AGAIN)
                again = way.arriving(t, _again(place.come, t))
                http.post("/v1/telemetry", {"series": again})
                plan = runner.anew() or plan
            begun.told.append(http.get("/v1/setpoints").json()["setpoints"])
            record = world.obey(t, begun.told[t])
            off = critical_off(place.come, record)
            if off.any() and place.come.grid_limit_kw[t] > 0.0:
                names = ", ".join(map(str, place.come.customers.id[off]))
                why = (plan["solve"] or plan).get("fallback_reason", "")
                found.append(f"{written(times[t])}: {names} off; {plan['estimated']} {why}")
    return found


def _again(come: Scenario, t: int) -> list[Series]:
    """Second readings of the substation: the grid, and the seconds since."""
    now = come.grid.times[t]
    there = come.grid_limit_kw[t] > 0.0
    import_kw = float(come.load_kw[t].sum() - come.pv_kw[t].sum()) * there
    again = partial(reading, "grid", lasts="PT5S", source="substation")
    return [again("grid_on", now + AGAIN, float(there)), again("import_kw", now, import_kw)]


def low_voltage_site() -> Scenario:
    """A street of six customers at 0.4 kV with one device of each kind, a day of it.

    What is stored holds no outage of an hour.
    """
    hours = np.arange(24)
    phase = np.array([0.0, 1.5, 2.5, 3.5, 5.0, 6.0])
    usual_kw = np.array([4.0, 5.0, 6.0, 7.0, 8.0, 9.0])
    load_kw = usual_kw * (1.0 + 0.3 * np.sin(hours[:, np.newaxis] / 4.0 + phase))
    sun = np.clip(np.sin((hours - 5) * np.pi / 15.0), 0.0, None)[:, np.newaxis]
    day = replace(
        tiny_scenario(),
        name="street",
        title="Six customers at 0.4 kV",
        grid=TimeGrid(pd.Timestamp("2025-07-01T00:00Z"), 60.0, 24),
        controller=ControllerDefaults(),
        network=Network(
            [0, 1, 2, 1, 4],
            [1, 2, 3, 4, 5],
            [0.002, 0.004, 0.006, 0.006, 0.006],
            [0.002, 0.003, 0.003, 0.003, 0.003],
            slack_bus=0,
            base_kv=0.4,
            i_max_a=[900.0, 500.0, 300.0, 300.0, 300.0],
        ),
        customers=Customers(
            id=["H1", "H2", "H3", "H4", "H5", "H6"],
            bus=[1, 2, 3, 4, 5, 5],
            tier=["critical", "high", "low", "low", "critical", "high"],
            weight=[1.0, 0.1, 0.02, 0.02, 1.0, 0.1],
            power_factor=[0.97] * 6,
        ),
        pv=PVSystems(id=["P1", "P2"], customer=["H2", "H4"], p_max_kw=[2.0, 1.0], s_max_kva=[3.0, 2.0]),
        batteries=replace(
            tiny_scenario().batteries,
            id=np.array(["B1", "B2"], dtype=object),
            bus=np.array([1, 5], dtype=object),
            energy_kwh=np.array([30.0, 10.0]),
            p_max_kw=np.array([20.0, 4.0]),
            s_max_kva=np.array([25.0, 5.0]),
            soc_initial=np.array([0.2, 0.2]),
        ),
        load_kw=load_kw,
        pv_kw=sun * [2.0, 1.0],
        price_gbp_per_kwh=np.where((hours >= 16) & (hours < 21), 0.2, 0.1),
        temperature_c=20.0 + 10.0 * sun[:, 0],
        grid_limit_kw=np.full(24, np.inf),
        chargers=chargers(2, bus=[2, 4], p_charge_kw=[7.4, 11.0]),
        gensets=gensets(bus=[1], p_max_kw=6.0, p_min_kw=2.0, litres_per_h_idle=1.5, tank_litres=60.0,
                        fuel_level_litres=40.0),
        thermal_loads=homes("H2", "H5"),
        objective=replace(tiny_scenario().objective, lambda_grid=1e-7),
    )  # fmt: skip
    return plugged_in(day, (8.0, 20.0), (0.0, 23.0), energy_needed_kwh=[20.0, np.nan])


def place_of(site: Scenario, first: int, steps: int, dark: int, horizon_h: float = 1.0) -> Place:
    """Some steps of a site, of which one is an outage that is not announced."""
    come = site.between(first, first + steps)
    most_kw = float(np.where(site.outage, np.inf, site.grid_limit_kw).min())
    limit_kw = np.full(steps, most_kw)
    limit_kw[dark] = 0.0
    come = replace(come, grid_limit_kw=limit_kw)
    return Place(site, come, RunOptions(horizon_h=horizon_h, isolate=False))


AGREE = {"zero", "missing"}
"""What an import tells that bears out a contact that says the grid is lost: two that agree so are
what a true loss looks like."""


def pairs_of(
    lies: Sequence[Lie], count: int, seed: int, starts: Sequence[int] = (0,)
) -> list[tuple[Lie, Lie]]:
    """Some pairs of lies of different sensors, without those that look like a true loss.

    Each lie of a pair begins at a step of its own of ``starts``.
    """
    rng = np.random.default_rng([seed, 57])
    every = [
        (one, other)
        for one, other in combinations(lies, 2)
        if (one.quantity, one.assets) != (other.quantity, other.assets)
        and not _look_like_a_loss({one.quantity: one.name, other.quantity: other.name})
    ]
    drawn = rng.choice(len(every), min(count, len(every)), replace=False)
    since = rng.choice(starts, (len(drawn), 2))
    return [
        (replace(every[i][0], since=int(one)), replace(every[i][1], since=int(other)))
        for i, (one, other) in zip(drawn, since, strict=True)
    ]


def _look_like_a_loss(told: dict[str, str]) -> bool:
    return told.get("grid_on") == "lost" and told.get("import_kw") in AGREE

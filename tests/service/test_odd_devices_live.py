"""Devices that do not do what is expected: a set that does not start, a car, a thermometer.

An operator sees each of them named, and nobody is off needlessly.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tests.support.homes import hot
from tests.support.live_service import (
    HERE,
    NOON,
    client,
    decided,
    readings,
    site,
)
from tests.support.played_service import Here, crowded
from tests.support.sets import gensets
from tests.support.small_windows import DARK
from vppres import Controller, Measurement, RunOptions
from vppres.scenario.scenario import Scenario
from vppres.service.clock import SetClock
from vppres.service.operation.site import Service
from vppres.service.plans.world import Series, World
from vppres.service.simulate import Play, Player

REAL = RunOptions(mode="physical", horizon_h=2.0, isolate=False)
HOUR = pd.Timedelta(hours=1)


class Odd(World):
    """A world in which the van is gone at noon, the thermometer stands still, and no set starts."""

    def readings(self, t: int) -> list[Series]:
        """What devices say of it."""
        gone = self.scenario.grid.times[t] >= self.scenario.grid.start + 2 * HOUR
        found = []
        for one in super().readings(t):
            if one["quantity"] == "plugged" and gone:
                one = {**one, "values": [0.0]}
            if one["quantity"] in ("ev_soc", "departure") and gone:
                continue
            if one["quantity"] == "indoor_c":
                one = {**one, "values": [24.0]}
            found.append(one)
        return found

    def obey(self, t: int, setpoints: Any) -> Any:
        """What becomes of set-points for sets, and for a van that is not there."""
        odd = ("gensets", "chargers")
        return super().obey(t, [one for one in setpoints if one["kind"] not in odd])


@pytest.mark.nightly
def test_what_is_odd_is_named_and_nobody_is_off_for_it(
    tiny: Scenario, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Customers are on for as long as without the set and the van, in an island of batteries."""
    day = crowded(tiny)
    nobody = type(day.sessions)()
    plain = replace(day, gensets=gensets(0), sessions=nobody)
    players = []
    for name, there, world in (("odd", day, Odd(day, REAL)), ("plain", plain, World(plain, REAL))):
        caplog.clear()
        service = Service(there, REAL, rehearsal=True)
        with client(service, tmp_path / name) as http, caplog.at_level(logging.WARNING):
            player = Player(world, Here(http), Play(announced=False))
            assert player.play().statuses == {"ok": 6}
            alarms = http.get("/v1/alarms?since=2022-07-19T00:00:00Z").json()["alarms"]
        of_devices = [one for one in alarms if one["subject"] is not None]
        assert bool(of_devices) == (name == "odd") and player.tally.off_needlessly == 0
        logged = [record.getMessage() for record in caplog.records]
        named = [
            "indoor_c h0",
            "vehicle van is not at k0",
            "genset g0 is out",
            "g0 did not follow",
        ]
        found = [any(words in line for line in logged) for words in named]
        assert found == [name == "odd"] * len(named)
        players.append([each.customers["served"] for each in world.records])
    # Of equal plans, which step a customer is on in depends on where the search begins.
    assert np.array_equal(*np.sum(players, axis=1))
    assert not np.all(players[0])


def test_a_thermometer_that_stands_still_while_the_room_swings_is_found() -> None:
    """Without power it becomes 24.7, 23.9 and 23.2 °C: never 1 K from the reading."""
    day = hot([DARK] * 4, c_kwh_per_c=1.0)
    day = replace(day, temperature_c=np.array([25.5, 17.5, 17.5, 21.5]))
    controller = Controller.of(day, RunOptions(mode="paper", isolate=False))
    words = []
    for time in day.grid.times:
        step = controller.step(Measurement(time, indoor_c={"h0": 24.0}))
        words.append(step.solve["estimated"])
    assert words == ["", "", "", "indoor_c h0 23.2 (frozen)"]


def test_a_thermometer_whose_clock_is_ahead_does_not_stand_still_when_its_next_reading_is_lost() -> (
    None
):
    """A reading is dated 90 s after the decision that knew it: a step later it is no new one."""
    day = hot([DARK] * 4, c_kwh_per_c=0.5)
    controller = Controller.of(day, RunOptions(mode="paper", isolate=False))
    first, second, third = day.grid.times[:3]

    def words(now: pd.Timestamp, read: pd.Timestamp) -> str:
        at = {"indoor_c": {"h0": read}}
        told = Measurement(now, indoor_c={"h0": 24.0}, read_at=at)
        return str(controller.step(told).solve["estimated"])

    ahead = first + pd.Timedelta("90s")
    assert words(first, ahead) == ""
    assert words(second, ahead).endswith("(missing)")
    # One that is sent anew and still says the same does stand still.
    assert words(third, third).endswith("(frozen)")


def dimming_shop(tiny: Scenario, shop_kw: float, homes_kw: float) -> Scenario:
    """A shop that may have a quarter of its demand, and homes."""
    day = site(tiny)
    c = day.customers
    share_min = np.where(c.id == "shop", 0.25, 1.0)
    load_kw = np.tile([0.0, shop_kw, homes_kw], (len(day.load_kw), 1))
    return replace(
        day, customers=replace(c, share_min=share_min), load_kw=load_kw, pv_kw=0.0 * day.pv_kw
    )


@pytest.mark.daily
def test_the_price_of_energy_counts_on_no_dimming_that_was_refused(
    tiny: Scenario, tmp_path: Path
) -> None:
    """A battery holds 10.3 kWh in an island; homes of 1 kW count 0.02, the shop of 10 kW 0.1.

    One more kWh of 95% goes to the shop, which is dimmed; to the homes, if that gets all.
    """
    day = dimming_shop(tiny, shop_kw=10.0, homes_kw=1.0)
    soc = 0.15 + 10.3 / 0.95 / 60.0
    clock = SetClock(NOON)
    prices, shares = [], []
    with client(Service(day, replace(HERE, horizon_h=0.0)), tmp_path, clock) as http:
        for hours in (0, 1):
            time = NOON + hours * HOUR
            clock.set(time)
            series = readings(time, "grid_on", {"grid": 0.0}) + readings(time, "online", {"big": 0})
            http.post("/v1/telemetry", {"series": series})
            plan = decided(http, clock, time, soc)
            shop = next(one for one in plan["setpoints"] if one["asset"] == "shop")
            shares.append(shop["share"])
            told = http.get("/v1/explanations").json()["price"]
            prices.append({one["asset"]: one["weighted_h"] for one in told}["small"])
            no = {"status": "rejected", "reason": "no relay"}
            http.post(f"/v1/setpoints/{shop['id']}/status", no)
    assert shares == pytest.approx([0.93, 1.0], abs=1e-4)
    assert prices == pytest.approx([0.95 * 0.1 / 10.0, 0.95 * 0.02 / 1.0], rel=1e-3)

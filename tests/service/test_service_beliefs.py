"""Outages that nobody knows exactly, over HTTP: what is believed, seen and decided."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from tests.support.asgi import Caller
from tests.support.live_service import HERE, NOON, client, decided, readings, said, site
from vppres.outlook.durations import of_length
from vppres.outlook.outlook import OutageOutlook, seen_outages
from vppres.scenario.outage_warnings import OnsetShares, OutageLength, OutageStatistics
from vppres.scenario.scenario import Scenario
from vppres.service.clock import SetClock
from vppres.service.events.announced import warnings
from vppres.service.operation.site import Service
from vppres.service.storage.records import Event, seconds

HOUR = pd.Timedelta("1h")
TWO_ONSETS = {"start": "2026-11-21T13:00:00Z", "resolution": "PT1H", "probabilities": [0.5, 0.5]}
TWO_HOURS = {"family": "discrete", "hours": [2.0], "probabilities": [1.0]}
STORM = {
    "type": "outage_belief",
    "issued_at": "2026-11-21T09:00:00Z",
    "source": "operator-notice",
    "probability": 0.6,
    "onset": TWO_ONSETS,
    "duration": TWO_HOURS,
}


@contextmanager
def believing(tiny: Scenario, folder: Path, outages: str | None = "belief") -> Iterator[Any]:
    """A service of a feeder where every outage is announced, at noon."""
    quiet = replace(site(tiny), outage_statistics=OutageStatistics("none"))
    clock = SetClock(NOON)
    options = replace(HERE, outages=outages, horizon_h=6.0)
    with client(Service(quiet, options), folder, clock) as http:
        yield http, clock


def grid_on(http: Caller, time: pd.Timestamp, on: bool) -> None:
    series = readings(time, "grid_on", {"grid": float(on)})
    assert http.post("/v1/telemetry", {"series": series}).status == 200


def test_the_more_likely_an_outage_the_more_is_kept(tiny: Scenario, tmp_path: Path) -> None:
    charged = []
    for place, probability in enumerate((0.0, 0.05, 0.9)):
        with believing(tiny, tmp_path / str(place)) as (http, clock):
            http.put("/v1/events/storm", {**STORM, "probability": probability})
            plan = decided(http, clock, NOON, soc=0.3)
            charged.append(sum(one["p_kw"] for one in said(plan, "batteries").values()))
    assert charged == sorted(charged)
    assert charged[0] < 0.5 * charged[2]


@pytest.mark.nightly
def test_a_certain_outage_is_the_special_case(tiny: Scenario, tmp_path: Path) -> None:
    """As an event or as a belief, with beliefs or with known outages: one decision."""
    outage = {"type": "outage", "start": "2026-11-21T13:20:00Z", "end": "2026-11-21T15:00:00Z"}
    sure = {**STORM, "probability": 1.0, "onset": {**TWO_ONSETS, "probabilities": [1.0]},
            "duration": {"family": "until", "until": "2026-11-21T14:30:00Z"}}  # fmt: skip
    found = []
    for place, (outages, event) in enumerate(
        (o, e) for o in ("known", "belief", "likely") for e in (outage, sure)
    ):
        with believing(tiny, tmp_path / str(place), outages) as (http, clock):
            assert http.put("/v1/events/storm", event).status == 201
            plans = [decided(http, clock, NOON + hours * HOUR, 0.3) for hours in range(4)]
            found.append([(plan["setpoints"], plan["grid"]["available"]) for plan in plans])
            assert plans[0]["outage_probability"][:4] == [0.0, 1.0, 1.0, 0.0]
    assert all(one == found[0] for one in found)
    assert [available for _, available in found[0]] == [True, False, False, True]


BEGUN = {"start": "2026-11-21T14:00:00Z", "resolution": "PT1H", "probabilities": [1.0]}


def lasting(hours: float) -> dict[str, Any]:
    """An estimate of restoration for the outage that began at two."""
    return {**STORM, "probability": 1.0, "onset": BEGUN,
            "duration": {"family": "lognormal", "median_h": hours, "sigma": 0.2}}  # fmt: skip


def told_of_it(
    tiny: Scenario, folder: Path, name: str, estimates: dict[int, dict[str, Any]]
) -> list[dict[str, Any]]:
    """Plans from noon on; the storm begins at two, and estimates come at their hours."""
    vague = {"family": "lognormal", "median_h": 5.0, "sigma": 0.9}
    with believing(tiny, folder) as (http, clock):
        http.put("/v1/events/storm", {**STORM, "duration": vague})
        plans = []
        for hours in range(1, 6):
            now = NOON + hours * HOUR
            clock.set(now)
            grid_on(http, now, hours < 2)
            if hours in estimates:
                assert http.put(f"/v1/events/{name}", estimates[hours]).status in (200, 201)
            plans.append(decided(http, clock, now, max(0.9 - 0.1 * hours, 0.3)))
        return plans


SEQUENCES = {
    "right": {2: 6.0},
    "wrong": {2: 2.0},
    "corrected": {2: 2.0, 4: 6.0},
    "outlasted": {2: 1.0},
}
"""Lengths of the outage that began at two, as they are estimated at an hour."""


@pytest.mark.nightly
@pytest.mark.parametrize("sequence", SEQUENCES)
def test_an_estimate_counts_whatever_its_name(
    tiny: Scenario, tmp_path: Path, sequence: str
) -> None:
    """Under another name than the storm's it gives what it gives under that, to the last bit."""
    estimates = {hour: lasting(length) for hour, length in SEQUENCES[sequence].items()}
    named = {
        name: told_of_it(tiny, tmp_path / name, name, estimates) for name in ("storm", "INC-1")
    }
    same, other = (
        [(plan["outage_probability"], plan["setpoints"]) for plan in plans]
        for plans in named.values()
    )
    assert same == other
    words = [plan["solve"]["outage_messages"] for plan in named["INC-1"]]
    assert words[0] is None
    assert all(each.startswith("INC-1 counts, not storm") for each in words[1:])
    # Of the hour two after the one at which it is said, from two on.
    after_two = [plan[0][2] for plan in other[1:]]
    at_three, at_four = after_two[1:3]
    if sequence == "right":
        assert after_two[0] > 0.99 > after_two[3] > 0.5
    elif sequence == "wrong":
        assert after_two[0] < 0.2 and at_three < 0.01
    elif sequence == "corrected":
        assert at_three < 0.01 < 0.5 < at_four
    else:
        # What is outlasted does not say that it ends now.
        assert after_two[0] < 1e-4 < 0.3 < at_three < at_four
        assert "INC-1 is outlasted, the statistics count" in words[2]


def test_a_message_says_since_when_somebody_knew() -> None:
    noon = seconds(NOON)
    body = {**STORM, "duration": {"family": "lognormal", "median_h": 7.0, "sigma": 1.33,
            "max_h": 24.0}}  # fmt: skip
    first, last = warnings({"storm": Event(3, body, noon - 600, noon - 7200)}, NOON, HOUR)
    assert [first.issued_at, last.issued_at] == [NOON - 2 * HOUR, NOON - pd.Timedelta("10min")]
    assert last.onset == OnsetShares(NOON + HOUR, 1.0, (0.5, 0.5))
    ends = stats.lognorm(s=1.33, scale=7.0).ppf([0.1, 0.5, 0.9])
    assert [last.duration_p10_h, last.duration_p50_h] == pytest.approx(ends[:2])
    assert ends[2] > 24.0 == last.duration_p90_h


def test_lengths_are_those_of_the_textbook() -> None:
    edges = np.array([1.5, 2.5, 3.5])
    for family, law in (
        ("lognormal", stats.lognorm(s=0.8, scale=2.0)),
        ("weibull", stats.weibull_min(c=0.8, scale=2.0)),
    ):
        found = of_length(OutageLength(family, 2.0, 0.8, max_h=4.0), 1.0, 6)
        below = law.cdf(edges)
        expected = [*np.diff(below, prepend=0.0), 1.0 - below[-1], 0.0, 0.0]
        assert found == pytest.approx(np.array(expected), abs=1e-12)


def test_onsets_in_shorter_steps_share_their_interval() -> None:
    shares = OnsetShares(NOON, 1.0, (0.25, 0.75))
    assert shares.begun(np.arange(-1, 6) * 0.5).tolist() == [0, 0, 0.125, 0.25, 0.625, 1, 1]
    assert (shares.likely, shares.end) == (NOON + HOUR, NOON + 2 * HOUR)


MINUTE = pd.Timedelta("1min")


@given(
    st.lists(
        st.tuples(st.integers(1, 400), st.integers(1, 200)),
        min_size=1,
        max_size=5,
    ),
    st.permutations(range(5)),
)
def test_certain_outages_are_dark_in_each_step_that_one_of_them_touches(
    spans: list[tuple[int, int]], order: list[int]
) -> None:
    """Whatever their names, order and lengths, in every step of the day."""
    events: dict[str, Event] = {}
    dark = np.zeros(14, dtype=bool)
    for place, (start, length) in enumerate(spans):
        end = start + length
        times = {"start": NOON + start * MINUTE, "end": NOON + end * MINUTE}
        body = {"type": "outage"} | {key: time.isoformat() for key, time in times.items()}
        told = seconds(NOON) - 3600 + 60 * order[place]
        events[f"event {place}"] = Event(1, body, told, told)
        dark[start // 60 : -(-end // 60)] = True

    times = pd.date_range(NOON, periods=14, freq="h")
    for t, now in enumerate(times):
        outlook = OutageOutlook(warnings(events, now, HOUR), OutageStatistics("none"), 1.0)
        seen = seen_outages(times[: t + 1], [*dark[: t + 1]])
        believed = outlook.at(now, 14 - t, seen).out_probability
        assert believed == pytest.approx(dark[t:].astype(float))

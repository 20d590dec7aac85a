"""Public feeds of outages: recorded answers, garbled ones, and a day replayed into a service."""

from __future__ import annotations

import io
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from email.message import Message
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.asgi import Caller
from tests.support.command_line import call
from tests.support.live_service import HERE, client, decided, site
from vppres.core.errors import InputError
from vppres.feeds.adapters import FEEDS
from vppres.feeds.follow import Asker, Follower, OverHTTP, recorded, replay
from vppres.feeds.incidents import Incident, check_areas
from vppres.scenario.scenario import Scenario
from vppres.service.client import Answer, Client
from vppres.service.clock import SetClock
from vppres.service.runner import Service

ROOT = Path(__file__).parent / "feeds"
AREAS = {"ukpn": "CM4 0", "ssen": "OX26 6JJ", "nged": "TA12"}
ELEVEN = pd.Timestamp("2026-11-21T11:00Z")


class Listed:
    """Events as they are put and withdrawn."""

    def __init__(self) -> None:
        self.events: dict[str, dict[str, Any]] = {}

    def put(self, name: str, body: dict[str, Any]) -> None:
        self.events[name] = body

    def withdraw(self, name: str) -> None:
        del self.events[name]

    def said(self, source: str) -> dict[str, dict[str, Any]]:
        return {name: body for name, body in self.events.items() if body["source"] == source}

    def set_clock(self, now: pd.Timestamp) -> None:
        pass


def after(name: str, n_answers: int) -> tuple[dict[str, Any], list[str]]:
    """Events that hold, and what was told, after some recorded answers of a feed."""
    listed = Listed()
    told: list[str] = []
    follower = Follower(FEEDS[name], [AREAS[name]], listed, told.append)
    answers = list(recorded(ROOT / name, FEEDS[name]))[:n_answers]
    replay(follower, iter(answers), 0.0, lambda _: False)
    return {key: body.get("likely") or body.get("end") for key, body in listed.events.items()}, told


@pytest.mark.parametrize(
    ("name", "holds"),
    [
        (
            "ukpn",
            [
                {"ukpn INCD-1001-P": "18:00"},
                {"ukpn INCD-1001-P": "18:00", "ukpn INCD-2002-G": "15:00"},
                {"ukpn INCD-1001-P": "18:00", "ukpn INCD-2002-G": "17:00"},
                {"ukpn INCD-1001-P": "18:00", "ukpn INCD-2002-G": "17:00"},  # garbled
                {},
                {},
            ],
        ),
        (
            "ssen",
            [
                {"ssen RZ0001": "15:00"},
                {"ssen RZ0001": "16:30"},
                {"ssen RZ0001": "16:30"},
                {"ssen RZ0001": "16:30", "ssen late": None},  # the same as an hour before
                {},
            ],
        ),
        (
            "nged",
            [
                {"nged INCD-501-l": "14:30", "nged INCD-777-j": "13:00"},
                {"nged INCD-501-l": "18:00", "nged INCD-777-j": "13:00"},
                {"nged INCD-501-l": "18:00", "nged INCD-777-j": "13:00"},
                {},
                {},
            ],
        ),
    ],
)
def test_events_come_change_and_go(name: str, holds: list[dict[str, str | None]]) -> None:
    """After each answer of the day; a garbled one leaves what was said, an empty one nothing."""
    for n_answers, expected in enumerate(holds, start=1):
        found, told = after(name, n_answers)
        assert {key: end and end[11:16] for key, end in found.items()} == expected
    words = "\n".join(told)
    assert "(changed)" in words and ": over" in words
    assert "What was said before stays" in words


def test_planned_work_is_an_outage_and_an_estimate_what_a_crew_says() -> None:
    listed = Listed()
    follower = Follower(FEEDS["ukpn"], ["CM4 0AB"], listed, lambda _: None)
    content = next(file for file in (ROOT / "ukpn").iterdir() if "T120000Z" in file.name)
    follower.hear(content.read_bytes(), ELEVEN)
    assert listed.events == {
        "ukpn INCD-1001-P": {
            "type": "outage",
            "source": "ukpn",
            "start": "2026-11-21T16:00:00Z",
            "end": "2026-11-21T18:00:00Z",
        },
        "ukpn INCD-2002-G": {
            "type": "restoration",
            "source": "ukpn",
            "likely": "2026-11-21T15:00:00Z",
        },
    }


@pytest.mark.parametrize("name", FEEDS)
@given(data=st.data())
def test_garbled_answers_are_refused_or_read(name: str, data: st.DataObject) -> None:
    """Whatever arrives: one error that says so, or incidents that make events."""
    files = sorted((ROOT / name).iterdir())
    content = data.draw(st.sampled_from(files)).read_bytes()
    cut = data.draw(st.integers(0, len(content)))
    rubbish = data.draw(st.binary(max_size=20) | st.sampled_from([b"null", b"[", b'{"a": 1}']))
    for garbled in (content[:cut], content[:cut] + rubbish + content[cut + len(rubbish) :]):
        try:
            answer = FEEDS[name].read(garbled)
        except InputError as error:
            assert f"feed {name}" in str(error)
        else:
            for incident in answer.incidents:
                incident.event(name, ELEVEN)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is no JSON"),
        (b'{"total_count": 3}', "has no list of incidents"),
        (b"[1, 2]", "has no row that can be read"),
        (b'[{"incidentreference": "A", "estimatedrestorationdate": "soon"}]', "no row that can"),
        (b"[" * 100_000, "is no JSON"),
    ],
)
def test_what_is_wrong_with_an_answer_is_said(content: bytes, words: str) -> None:
    with pytest.raises(InputError, match=words):
        FEEDS["ukpn"].read(content)


def test_areas_meet_where_one_holds_the_other() -> None:
    for one, other, meets in (
        ("CM40AB", "CM4 0", True),
        ("CM4", "cm4 0ab", True),
        ("CM4 1", "CM4 0", False),
        ("CM40 1AA", "CM4 0", False),
        ("CM4", "CM40 1AA", False),
    ):
        assert Incident("x", (one,)).touches(check_areas([other])) is meets
    for wrong in ("", "CM4 0A", "London"):
        with pytest.raises(InputError, match="no postcode, sector or district"):
            check_areas([wrong])


# Into a service


class Inside(Client):
    """A client of a service that is asked without a network in between."""

    def __init__(self, http: Caller) -> None:
        super().__init__("http://127.0.0.1:8420")
        self.http = http

    def ask(self, method: str, path: str, body: Any = None) -> Answer:
        found = self.http.ask(method, path, body, {})
        return Answer(found.status, found.json(), 0.0)


@contextmanager
def serving(tiny: Scenario, folder: Path) -> Iterator[tuple[Caller, SetClock]]:
    """A service that believes, at eleven."""
    clock = SetClock(ELEVEN)
    options = replace(HERE, outages="belief")
    with client(Service(site(tiny), options, paced=True), folder, clock) as http:
        yield http, clock


def test_a_day_is_replayed_into_a_service(tiny: Scenario, tmp_path: Path) -> None:
    """What was said stays in the history; a follower that begins anew knows what it said."""
    with serving(tiny, tmp_path) as (http, clock):
        place = OverHTTP(Inside(http))
        feed = FEEDS["ukpn"]
        answers = list(recorded(ROOT / "ukpn", feed))
        replay(
            Follower(feed, ["CM4 0"], place, lambda _: None),
            iter(answers[:3]),
            0.0,
            lambda _: False,
        )
        noon = ELEVEN + pd.Timedelta(hours=2)
        plan = decided(http, clock, noon)
        assert min(plan["outage_probability"][3:5]) > 0.99
        told: list[str] = []
        replay(
            Follower(feed, ["CM4 0"], place, told.append), iter(answers[4:]), 0.0, lambda _: False
        )
        assert http.get("/v1/events").json() == {}
        assert [line for line in told if "over" in line] == [
            "ukpn INCD-1001-P: over",
            "ukpn INCD-2002-G: over",
        ]
        history = http.get("/v1/events/ukpn%20INCD-2002-G/versions").json()
        assert [one.get("likely") for one in history] == [
            "2026-11-21T15:00:00Z",
            "2026-11-21T17:00:00Z",
            None,
        ]


def test_a_silent_feed_is_late_and_comes_back() -> None:
    listed = Listed()
    told: list[str] = []
    follower = Follower(FEEDS["ukpn"], ["CM4 0"], listed, told.append)
    content = (ROOT / "ukpn" / "2026-11-21T120000Z.json").read_bytes()
    follower.hear(content, ELEVEN)
    follower.watch(ELEVEN + pd.Timedelta(minutes=30))
    before = dict(listed.events)
    follower.watch(ELEVEN + pd.Timedelta(minutes=31))
    assert listed.events.keys() - before.keys() == {"ukpn late"}
    assert "nothing since 2026-11-21T11:00:00Z" in listed.events["ukpn late"]["text"]
    follower.hear(content, ELEVEN + pd.Timedelta(minutes=40))
    follower.watch(ELEVEN + pd.Timedelta(minutes=40))
    assert listed.events == before
    assert told[-1].endswith("is back.")


# Asking


def test_a_feed_is_asked_once_a_minute_at_most(monkeypatch: pytest.MonkeyPatch) -> None:
    """And with the tag of its last answer, so that an unchanged one is not sent again."""
    asked: list[tuple[float, str | None]] = []
    now = 0.0

    def answer(request: urllib.request.Request, timeout: float) -> Any:
        assert timeout > 0.0
        assert request.get_header("User-agent", "").startswith("vppres/")
        tag = request.get_header("If-none-match")
        asked.append((now, tag))
        if tag is not None:
            raise urllib.error.HTTPError(request.full_url, 304, "", Message(), None)
        found = io.BytesIO(b"[]")
        found.headers = {"ETag": '"one"'}  # type: ignore[attr-defined]
        return found

    def wait(seconds: float) -> bool:
        nonlocal now
        now += seconds
        return False

    monkeypatch.setattr(urllib.request, "urlopen", answer)
    asker = Asker(FEEDS["ukpn"], wait, lambda: now)
    assert [asker.ask() for _ in range(3)] == [b"[]"] * 3
    assert asked == [(0.0, None), (60.0, '"one"'), (120.0, '"one"')]

    def silent(*_: Any, **__: Any) -> Any:
        raise OSError("no route")

    monkeypatch.setattr(urllib.request, "urlopen", silent)
    with pytest.raises(InputError, match="does not answer: no route"):
        asker.ask()


def test_nothing_is_asked_unless_a_feed_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> Any:
        raise AssertionError("asked")

    monkeypatch.setattr(urllib.request, "urlopen", refuse)
    listed = call("feeds")
    assert listed.exit_code == 0
    assert [line.split(":")[0] for line in listed.stdout.splitlines()] == list(FEEDS)
    assert "no postcode" in call("feeds", "ukpn", "--postcode", "London").stderr
    assert "is not known" in call("feeds", "spen", "--postcode", "CM4").stderr


def test_a_recorded_day_is_shown_by_the_command(tmp_path: Path) -> None:
    shown = call("feeds", "replay", str(ROOT / "ukpn"), "ukpn", "--postcode", "CM4 0")
    assert shown.exit_code == 0
    assert (
        "2026-11-21T12:30:00Z\nukpn INCD-2002-G: restoration about 2026-11-21T17:00:00Z (changed)"
        in (shown.stdout)
    )
    assert "Answers that could not be read: 1." in shown.stderr
    empty = call("feeds", "replay", str(tmp_path), "ukpn", "--postcode", "CM4 0")
    assert "holds no recorded answers of ukpn" in empty.stderr

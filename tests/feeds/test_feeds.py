"""Public feeds of outages: recorded answers, garbled ones, and a day replayed into a service."""

from __future__ import annotations

import json
import socket
import threading
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, ClassVar

import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.command_line import call
from tests.support.live_service import HERE, Live, client, decided, site
from tests.support.played_service import Here
from vppres.core.errors import InputError
from vppres.feeds import follow
from vppres.feeds.adapters import FEEDS, PublicFeed
from vppres.feeds.follow import Asker, Follower, OverHTTP, recorded, replay
from vppres.feeds.incidents import Incident, check_areas, time_in
from vppres.scenario.scenario import Scenario
from vppres.service.clock import SetClock
from vppres.service.operation.site import Service

ROOT = Path(__file__).parent
AREAS = {"ukpn": "CM4 0", "ssen": "OX26 6JJ", "nged": "TA12"}
ELEVEN = pd.Timestamp("2026-11-21T11:00Z")


class Listed(follow.EventSink):
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


@pytest.mark.parametrize("text", ["2026-11-21T15:00:0AZ", "21/11/2026 15:00", "soon", "nan"])
def test_what_is_no_time_is_refused(text: str) -> None:
    with pytest.raises(ValueError):
        time_in(text)


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


@pytest.mark.parametrize(("content", "words"), [
    (b"", "is no JSON"),
    (b'{"total_count": 3}', "has no list of incidents"),
    (b"[1, 2]", "has no row that can be read"),
    (b'[{"incidentreference": "A", "estimatedrestorationdate": "soon"}]', "no row that can"),
    (b"[" * 100_000, "is no JSON"),
])  # fmt: skip
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


@contextmanager
def serving(tiny: Scenario, folder: Path) -> Iterator[Live]:
    """A service that believes, at eleven."""
    clock = SetClock(ELEVEN)
    options = replace(HERE, outages="belief")
    with client(Service(site(tiny), options, paced=True), folder, clock) as http:
        yield http, clock


def test_a_day_is_replayed_into_a_service(tiny: Scenario, tmp_path: Path) -> None:
    """What was said stays in the history; a follower that begins anew knows what it said."""
    with serving(tiny, tmp_path) as (http, clock):
        place = OverHTTP(Here(http))
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


class Lines(BaseHTTPRequestHandler):
    """A feed that answers as it is told, and notes how it was asked."""

    answers: ClassVar[list[tuple[int, dict[str, str], bytes]]] = []
    asked: ClassVar[list[str | None]] = []

    def do_GET(self) -> None:
        assert self.headers["User-Agent"].startswith("vppres/")
        self.asked.append(self.headers["If-None-Match"])
        status, headers, body = self.answers.pop(0)
        self.send_response(status)
        for name, value in ({"Content-Length": str(len(body))} | headers).items():
            self.send_header(name, value)
        self.end_headers()
        for byte in body:
            self.wfile.write(bytes([byte]))
            time.sleep(float(headers.get("Pause", 0.0)))

    def log_message(self, format: str, *args: Any) -> None:
        pass


@pytest.fixture
def line(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[PublicFeed, type[Lines]]]:
    """A feed on this machine."""
    monkeypatch.setattr(Lines, "answers", [])
    monkeypatch.setattr(Lines, "asked", [])
    server = ThreadingHTTPServer(("127.0.0.1", 0), Lines)
    threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
    yield replace(FEEDS["ukpn"], url=f"http://127.0.0.1:{server.server_port}/"), Lines
    server.shutdown()
    server.server_close()


def test_a_feed_is_asked_when_it_is_time(line: tuple[PublicFeed, type[Lines]]) -> None:
    """Once in its time, with the tag of its last answer; a silent one twice as late each time."""
    feed, lines = line
    now = 0.0
    asker = Asker(feed, 60.0, lambda: now)
    lines.answers += [(200, {"ETag": '"one"'}, b"[]"), (304, {}, b"")]
    lines.answers += [(503, {}, b"")] * 2 + [(429, {"Retry-After": "7200"}, b"")]
    lines.answers += [(200, {}, b"[1]")]
    found: list[tuple[float, str]] = []
    while lines.answers:
        try:
            content = asker.ask()
        except InputError as error:
            found.append((now, str(error)))
        else:
            found += [] if content is None else [(now, content.decode())]
        now += 10.0
    times = [int(at / 60.0) for at, _ in found]
    assert times == [0, 1, 2, 4, 8, 128]
    assert [words for _, words in found[:2]] == ["[]", "[]"] and found[-1][1] == "[1]"
    assert "feed ukpn: answers 503." in found[2][1]
    assert "answers 429 and wants a pause of 120 min" in found[4][1]
    assert lines.asked == [None, *['"one"'] * 5]
    with pytest.raises(
        InputError, match=r"every = 0\.5: asks a feed more often than once a minute"
    ):
        Asker(feed, 30.0)


def test_what_is_no_answer_is_named(
    line: tuple[PublicFeed, type[Lines]], monkeypatch: pytest.MonkeyPatch
) -> None:
    feed, lines = line
    monkeypatch.setattr(follow, "TIMEOUT_S", 0.2)
    monkeypatch.setattr(follow, "MOST_BYTES", 9)
    here = {"Location": feed.url}
    for answers, words in (
        ([(200, {"Pause": "0.03"}, b"123456789")], r"it is not done within 0\.2 s|timed out"),
        ([(200, {"Content-Length": "12"}, b"[")], "breaks off 11 bytes before the end"),
        ([(200, {}, b"1234567890")], "it sends more than 9 bytes"),
        ([(302, here, b""), (302, here, b"")], "answers 302"),
        ([(302, {"Location": "http://[/"}, b"")], "does not answer"),
        ([(301, {"Location": "file:///etc/passwd"}, b"")], "answers 301"),
        ([(403, {}, b"")], "answers 403"),
    ):
        lines.answers[:] = answers
        with pytest.raises(InputError, match=words):
            Asker(feed, 60.0).ask()
        assert not lines.answers
    lines.answers[:] = [(302, here, b""), (200, {}, b"[]")]
    assert Asker(feed, 60.0).ask() == b"[]"
    nobody = replace(feed, url="http://127.0.0.1:1/")
    with pytest.raises(InputError, match=r"does not answer: .*refused"):
        Asker(nobody, 60.0).ask()
    safe = urllib.request.Request("https://a.org/")
    with pytest.raises(OSError, match=r"http://a\.org/, which has no encryption"):
        follow.Redirected().redirect_request(safe, None, 302, "", {}, "http://a.org/")


def test_a_head_that_drips_is_no_answer_and_late_is_said_beside_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(follow, "TIMEOUT_S", 0.3)
    monkeypatch.setattr(follow, "LATE_S", 0.0)
    monkeypatch.setattr(follow, "LOOK_S", 0.02)
    monkeypatch.setattr(follow, "LATE", pd.Timedelta(milliseconds=100))
    ended = threading.Event()

    def drip() -> None:
        connection, _ = listening.accept()
        with connection, suppress(OSError):
            while not ended.wait(0.05):
                connection.sendall(b"H")

    with socket.create_server(("127.0.0.1", 0)) as listening:
        threading.Thread(target=drip, daemon=True).start()
        feed = replace(FEEDS["ukpn"], url=f"http://127.0.0.1:{listening.getsockname()[1]}/")
        listed, told = Listed(), list[str]()
        follower = Follower(feed, ["CM4 0"], listed, told.append)
        end = threading.Event()
        threading.Timer(0.6, end.set).start()
        follow.follow(follower, Asker(feed, 60.0), end)
        ended.set()
    assert "is late" in told[0]  # before the limit of the answer
    assert "it is not done within 0.3 s" in told[1]
    assert set(listed.events) == {"ukpn late"}


def test_rows_of_one_reference_are_one_incident_with_all_their_postcodes() -> None:
    row = {"incidentreference": "one", "postcodesaffected": "CM4 0AB", "powercuttype": "Unplanned"}
    answer = FEEDS["ukpn"].read(json.dumps([row] * 4_000).encode())
    assert [len(one.postcodes) for one in answer.incidents] == [4_000]


def test_a_feed_that_is_silent_is_late_and_the_service_may_be_gone(
    line: tuple[PublicFeed, type[Lines]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever fails is said; what was said before stays, and what was not put is put again."""
    feed, lines = line
    content = (ROOT / "ukpn" / "2026-11-21T120000Z.json").read_bytes()
    lines.answers += [(200, {}, content), (200, {}, b"<html>"), (200, {}, content)]
    told: list[str] = []
    listed = Listed()
    follower = Follower(feed, ["CM4 0"], listed, told.append)
    now = pd.Timestamp("2026-11-21T11:00Z")

    class End(threading.Event):
        def wait(self, timeout: float | None = None) -> bool:
            nonlocal now
            now += pd.Timedelta(minutes=1)
            listed.put = Listed.put.__get__(listed)  # type: ignore[method-assign]
            if not lines.answers:
                self.set()
            return False

    def gone(*_: Any) -> None:
        raise OSError("the service does not answer")

    monkeypatch.setattr(listed, "put", gone)
    monkeypatch.setattr(follow, "_now", lambda: now)
    monkeypatch.setattr(follow, "_watch", lambda *_: None)  # whose clock is not this one
    asker = Asker(feed, 60.0, lambda: now.timestamp())
    follow.follow(follower, asker, End())
    assert told[0] == "the service does not answer"
    assert "is no JSON" in told[1]
    assert "restoration about" in told[-1] and listed.events


def test_nothing_is_asked_unless_a_feed_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> Any:
        raise AssertionError("asked")

    monkeypatch.setattr(urllib.request.OpenerDirector, "open", refuse)
    listed = call("feeds")
    assert listed.exit_code == 0
    assert [line.split(":")[0] for line in listed.stdout.splitlines()] == list(FEEDS)
    assert "no postcode" in call("feeds", "ukpn", "--postcode", "London").stderr
    told = call("feeds", "ukpnn").stderr
    assert "feed = ukpnn: is not a feed. Did you mean ukpn?" in " ".join(told.split())


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
